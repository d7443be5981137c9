//! The legend of a picture: a swatch and a name for everything that is seen.

use super::colour::{INK, WHITE};
use super::draw::text_width;
use super::edges::EdgeMark;
use super::shade::line_colour;
use super::{Palette, Picture, Rgb, font};
use crate::grid::{MaterialId, Pair};
use crate::mesh::MeshMaterial;

/// Something that a picture shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Entry {
    /// An interface.
    Surface(Pair),
    /// A material in a section.
    Section(MaterialId),
    /// A marked edge.
    Line(EdgeMark),
    /// An interface's outline over a slice.
    Outline(Pair),
    /// A junction point over a slice.
    Dot,
}

/// A legend laid out, ready to be drawn.
pub(super) struct Legend {
    rows: Vec<Row>,
    /// Pixels per dot of the font.
    scale: usize,
}

struct Row {
    /// `None` for a heading.
    swatch: Option<(Rgb, bool)>,
    text: String,
}

/// Dots around the legend and between swatch and text.
const PAD: i64 = 6;
/// Dots a swatch is wide.
const SWATCH: i64 = 14;
/// Dots from one row to the next.
const PITCH: i64 = 12;

impl Legend {
    /// The legend of a picture `height` pixels high, which decides the size of its letters.
    pub(super) fn new(
        entries: &[Entry],
        materials: &[MeshMaterial],
        palette: &Palette,
        height: usize,
    ) -> Self {
        let row = |&e: &Entry| Row { swatch: Some(swatch_of(e, palette)), text: label(e, materials) };
        let scale = ((height as f64 / 500.0).round() as usize).clamp(1, 6);
        Self { rows: entries.iter().map(row).collect(), scale }
    }

    /// The legend with a heading above it.
    pub(super) fn headed(mut self, text: String) -> Self {
        self.rows.insert(0, Row { swatch: None, text });
        self
    }

    /// Width and height in pixels.
    pub(super) fn size(&self) -> [usize; 2] {
        let widest = self.rows.iter().map(|row| text_width(&row.text, 1)).max().unwrap_or(0);
        let dots = [3 * PAD + SWATCH + widest, 2 * PAD - 4 + PITCH * self.rows.len() as i64];
        dots.map(|d| d as usize * self.scale)
    }

    /// Draws it with its upper left corner at `at`.
    pub(super) fn draw(&self, picture: &mut Picture, at: [i64; 2]) {
        picture.fill(at, self.size().map(|n| n as i64), WHITE, 0.82);
        let dot = self.scale as i64;
        for (k, row) in self.rows.iter().enumerate() {
            let (left, top) = (at[0] + PAD * dot, at[1] + (PAD + PITCH * k as i64) * dot);
            let text = match row.swatch {
                None => left,
                Some((colour, is_line)) => {
                    let swatch = SWATCH * dot;
                    if is_line {
                        picture.fill([left, top + 3 * dot], [swatch, 2 * dot], colour, 1.0);
                    } else {
                        let inside = [swatch - 2 * dot, font::HEIGHT as i64 * dot];
                        picture.fill([left, top - dot], [swatch, inside[1] + 2 * dot], INK, 0.6);
                        picture.fill([left + dot, top], inside, colour, 1.0);
                    }
                    left + swatch + PAD * dot
                }
            };
            picture.text([text, top], self.scale, &row.text, INK);
        }
    }

    /// Draws it into the corner of the picture where it hides least; of equal ones the upper left.
    pub(super) fn draw_in_emptiest_corner(&self, picture: &mut Picture) {
        if self.rows.is_empty() {
            return;
        }
        let [width, height] = self.size();
        let right = picture.width().saturating_sub(width);
        let bottom = picture.height().saturating_sub(height);
        let hidden = |&[x0, y0]: &[usize; 2]| {
            let row = |y: usize| (x0..x0 + width).map(move |x| (x, y));
            let is_drawn = |(x, y): (usize, usize)| {
                picture.pixel(x, y).is_some_and(|(colour, alpha)| alpha > 0 && colour != WHITE)
            };
            (y0..y0 + height).flat_map(row).filter(|&p| is_drawn(p)).count()
        };
        let corners = [[0, 0], [right, 0], [0, bottom], [right, bottom]];
        if let Some(at) = corners.into_iter().min_by_key(hidden) {
            self.draw(picture, at.map(|v| v as i64));
        }
    }
}

/// Its colour, and whether it is a line.
fn swatch_of(entry: Entry, palette: &Palette) -> (Rgb, bool) {
    match entry {
        Entry::Surface(pair) => (palette.surface(pair), false),
        Entry::Section(id) => (palette.cut_face(id), false),
        Entry::Line(mark) => (line_colour(mark), true),
        Entry::Outline(pair) => (palette.outline(pair), true),
        Entry::Dot => (super::slice::DOT, false),
    }
}

fn label(entry: Entry, materials: &[MeshMaterial]) -> String {
    let name = |id: MaterialId| match materials.iter().find(|m| m.id == id) {
        Some(material) => material.name.clone(),
        None if id == MaterialId::OUTSIDE => "border".to_owned(),
        None => format!("material {}", id.0),
    };
    match entry {
        Entry::Surface(pair) => match pair.front() {
            MaterialId::BACKGROUND => name(pair.back()),
            MaterialId::OUTSIDE => format!("{} at the volume's border", name(pair.back())),
            front => format!("{} | {}", name(pair.back()), name(front)),
        },
        Entry::Section(id) => format!("{}, section", name(id)),
        Entry::Line(EdgeMark::Border) => "interface at the border".to_owned(),
        Entry::Line(EdgeMark::Junction) => "junction curve".to_owned(),
        Entry::Line(EdgeMark::Open) => "open edge".to_owned(),
        Entry::Outline(pair) => format!("{} | {}", name(pair.back()), name(pair.front())),
        Entry::Dot => "junction".to_owned(),
    }
}
