//! The legend of a picture: a swatch and a name for everything that is seen.

use super::colour::{INK, WHITE};
use super::draw::text_width;
use super::edges::EdgeMark;
use super::render::line_colour;
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

/// Draws the legend into the upper left corner, on a box of dimmed white.
pub(super) fn draw(picture: &mut Picture, materials: &[MeshMaterial], palette: &Palette, entries: &[Entry]) {
    if entries.is_empty() {
        return;
    }
    let scale = ((picture.height() as f64 / 500.0).round() as usize).clamp(1, 6);
    let dot = scale as i64;
    let rows: Vec<(Entry, String)> = entries.iter().map(|&e| (e, label(e, materials))).collect();
    let widest = rows.iter().map(|(_, text)| text_width(text, scale)).max().unwrap_or(0);
    let (pad, swatch, pitch) = (6 * dot, 14 * dot, 12 * dot);
    let at = [pad, pad];
    let size = [3 * pad + swatch + widest, pad + pitch * rows.len() as i64 + pad - 4 * dot];
    picture.fill(at, size, WHITE, 0.82);
    for (row, (entry, text)) in rows.iter().enumerate() {
        let left = at[0] + pad;
        let top = at[1] + pad + pitch * row as i64;
        let (colour, is_line) = swatch_of(*entry, palette);
        if is_line {
            picture.fill([left, top + 3 * dot], [swatch, 2 * dot], colour, 1.0);
        } else {
            picture.fill([left, top - dot], [swatch, 9 * dot], INK, 0.6);
            picture.fill([left + dot, top], [swatch - 2 * dot, font::HEIGHT as i64 * dot], colour, 1.0);
        }
        picture.text([left + swatch + pad, top], scale, text, INK);
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
