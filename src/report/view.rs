//! A view of a mesh: what a camera sees, band by band.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::camera::{Camera, Fit, HalfSpace};
use super::colour::WHITE;
use super::edges::EdgeMark;
use super::legend::Entry;
use super::raster::{self, Band, Corner};
use super::render::RenderOptions;
use super::shade::{hatched, line_colour, lit, wire};
use super::{Rgb, colour::INK};
use crate::grid::{MaterialId, Pair};
use crate::mesh::InterfaceMesh;

/// Triangles that one task sorts into bands.
const BIN_CHUNK: usize = 1 << 16;

/// What a sample shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Look {
    /// What it is; `None` for the background.
    entry: Option<Entry>,
    colour: Rgb,
    /// The body in front of it that is to be shown in a section, if there is one.
    before: Option<MaterialId>,
}

/// Nothing.
const EMPTY: Look = Look { entry: None, colour: WHITE, before: None };

/// All that bands of a picture have in common.
pub(super) struct View<'a> {
    options: &'a RenderOptions,
    camera: Camera,
    keep: Option<HalfSpace>,
    lines: Vec<Line>,
    /// Per band: the lines that touch it.
    lines_of: Vec<Vec<u32>>,
    /// Pixel rows per band.
    band_rows: usize,
}

/// A marked edge on the screen.
struct Line {
    mark: EdgeMark,
    /// Projected.
    ends: [DVec3; 2],
    /// Half its width, in samples.
    radius: f64,
}

/// A mesh, or a piece of one, on the screen.
pub(super) struct Shape<'a> {
    mesh: &'a InterfaceMesh,
    corners: Vec<Corner>,
    /// Which triangles touch which band, ascending: per chunk of triangles, per band.
    bins: Vec<Vec<Vec<u32>>>,
}

impl Shape<'_> {
    fn corners_of(&self, t: usize) -> [Corner; 3] {
        self.mesh.triangles()[t].map(|v| self.corners[v as usize])
    }
}

impl<'a> View<'a> {
    /// The view of what `fit` holds, with lines between points in the world, in bands of so many rows of pixels.
    pub(super) fn new(
        options: &'a RenderOptions,
        fit: &Fit,
        lines: Vec<(EdgeMark, [DVec3; 2])>,
        band_rows: usize,
    ) -> Self {
        let camera = fit.camera([options.width, options.height].map(|n| n * options.supersampling));
        let on_screen = |(mark, ends): (EdgeMark, [DVec3; 2])| Line {
            mark,
            ends: ends.map(|p| camera.project(p)),
            radius: 0.5 * line_width(mark, options) * options.supersampling as f64,
        };
        let mut lines: Vec<Line> = lines.into_iter().map(on_screen).collect();
        // What matters more is drawn later, over the rest. (A stable sort: ties keep their order.)
        lines.sort_by_key(|line| line.mark);
        let keep = options.cut.map(|cut| camera.behind(cut.axis, cut.position));
        let mut view = Self { options, camera, keep, lines, lines_of: Vec::new(), band_rows };
        let mut lines_of = vec![Vec::new(); view.bands()];
        for (i, Line { ends: [a, b], radius, .. }) in view.lines.iter().enumerate() {
            let low = (a.y.min(b.y) - radius).floor() as i64;
            let high = (a.y.max(b.y) + radius).ceil() as i64;
            view.touched((low, high), 0).for_each(|band| lines_of[band].push(i as u32));
        }
        view.lines_of = lines_of;
        view
    }

    fn bands(&self) -> usize {
        self.options.height.div_ceil(self.band_rows)
    }

    /// Rows that a band computes beyond its own on either side, because lines look there.
    fn halo(&self) -> usize {
        self.lines.iter().map(|l| l.radius).fold(0.0, f64::max).ceil() as usize + 2
    }

    /// Bands whose rows, widened by a margin, meet rows `low..high` of samples.
    fn touched(&self, (low, high): (i64, i64), margin: i64) -> Range<usize> {
        let rows_per_band = (self.band_rows * self.options.supersampling) as i64;
        let clamp = |v: i64| v.clamp(0, self.bands() as i64) as usize;
        let first = (low - margin).div_euclid(rows_per_band);
        clamp(first)..clamp((high - 1 + margin).div_euclid(rows_per_band) + 1)
    }

    /// Rows of samples of band `k`, without its halo.
    fn rows(&self, k: usize) -> Range<usize> {
        let samples = self.options.supersampling;
        let low = k * self.band_rows;
        low * samples..(low + self.band_rows).min(self.options.height) * samples
    }

    /// Band `k`, empty.
    pub(super) fn band(&self, k: usize) -> Band<Look> {
        let (own, samples) = (self.rows(k), self.options.supersampling);
        let top = own.start.saturating_sub(self.halo());
        let bottom = (own.end + self.halo()).min(self.options.height * samples);
        Band::new(self.options.width * samples, top, bottom - top, EMPTY)
    }

    /// A mesh, or a piece, of fewer than 2^32 triangles on the screen.
    pub(super) fn project<'m>(&self, mesh: &'m InterfaceMesh) -> Shape<'m> {
        let corner = |&p: &DVec3| Corner::new(self.camera.project(p));
        let mut shape =
            Shape { mesh, corners: mesh.positions().par_iter().map(corner).collect(), bins: Vec::new() };
        let (count, halo) = (mesh.triangles().len(), self.halo() as i64);
        shape.bins = (0..count.div_ceil(BIN_CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let mut bins = vec![Vec::new(); self.bands()];
                for t in chunk * BIN_CHUNK..count.min((chunk + 1) * BIN_CHUNK) {
                    let rows = raster::rows_of(shape.corners_of(t));
                    if rows.0 < rows.1 && is_shown(mesh.pairs()[t], &self.options.only) {
                        self.touched(rows, halo).for_each(|band| bins[band].push(t as u32));
                    }
                }
                bins
            })
            .collect();
        shape
    }

    /// Draws what touches band `k` into it.
    pub(super) fn draw(&self, shape: &Shape<'_>, k: usize, band: &mut Band<Look>) {
        for &t in shape.bins.iter().flat_map(|chunk| &chunk[k]) {
            let t = t as usize;
            let (pair, corners) = (shape.mesh.pairs()[t], shape.corners_of(t));
            let before = self.body_before(pair, corners);
            // Most triangles of a fine mesh are hidden, or cover no sample.
            let mut tone = None;
            band.triangle(corners, self.keep.as_ref(), |x, y| {
                let tone = *tone.get_or_insert_with(|| self.tone(pair, shape.mesh.corners(t)));
                let colour = self.colour(tone, pair, corners, [x, y]);
                Look { entry: Some(Entry::Surface(pair)), colour, before }
            });
        }
    }

    /// Closes the cut of band `k`, draws lines over it and averages its samples to pixels, over what is there;
    /// returns what is seen.
    pub(super) fn finish(&self, k: usize, mut band: Band<Look>, pixels: &mut [u8]) -> Vec<Entry> {
        if let (Some(plane), true) = (&self.keep, self.options.caps) {
            band.cap(plane, |seen, x, y| seen.before.map(|id| self.section(id, [x, y])));
        }
        let own = self.rows(k);
        for &i in &self.lines_of[k] {
            let Line { mark, ends, radius } = &self.lines[i as usize];
            let look = Look { entry: Some(Entry::Line(*mark)), colour: line_colour(*mark), before: None };
            band.line(look, *ends, *radius, own.clone(), self.keep.as_ref());
        }
        self.resolve(&band, own.start, pixels)
    }

    fn resolve(&self, band: &Band<Look>, first_row: usize, pixels: &mut [u8]) -> Vec<Entry> {
        let n = self.options.supersampling;
        let mut entries = Vec::new();
        for (row, line) in pixels.chunks_exact_mut(4 * self.options.width).enumerate() {
            for (x, pixel) in line.chunks_exact_mut(4).enumerate() {
                let (mut sum, mut covered) = ([0u32; 3], 0u32);
                for dy in 0..n {
                    let samples = &band.row(first_row + row * n + dy)[x * n..(x + 1) * n];
                    for look in samples.iter().filter(|look| look.entry.is_some()) {
                        let Rgb(r, g, b) = look.colour;
                        covered += 1;
                        for (s, c) in sum.iter_mut().zip([r, g, b]) {
                            *s += u32::from(c);
                        }
                    }
                }
                if covered == 0 {
                    continue;
                }
                let entry = band.row(first_row + row * n)[x * n].entry;
                if let Some(entry) = entry.filter(|e| !entries.contains(e)) {
                    entries.push(entry);
                }
                // The background is white or clear; clear pixels keep the colour of what covers them.
                let all = (n * n) as u32;
                let missing = if pixel[3] == 255 { all - covered } else { 0 };
                let count = covered + missing;
                for (p, s) in pixel.iter_mut().zip(sum) {
                    *p = ((s + 255 * missing + count / 2) / count) as u8;
                }
                pixel[3] = pixel[3].max((255 * covered / all) as u8);
            }
        }
        entries
    }

    /// The material in front of a triangle, if it is a body that is shown.
    fn body_before(&self, pair: Pair, corners: [Corner; 3]) -> Option<MaterialId> {
        let is_front = raster::signed_area(corners) < 0;
        let id = if is_front { pair.front() } else { pair.back() };
        let is_body = id != MaterialId::BACKGROUND && id != MaterialId::OUTSIDE;
        let only = &self.options.only;
        (is_body && (only.is_empty() || only.contains(&id))).then_some(id)
    }

    /// Colour of a triangle in the light, before hatching.
    fn tone(&self, pair: Pair, corners: [DVec3; 3]) -> Rgb {
        let colour = self.options.palette.surface(pair);
        let shade = lit(colour, corners, &self.camera);
        // A cut face is a drawing more than a surface: it must stay light from every side.
        if pair.front() == MaterialId::OUTSIDE { shade.mix(colour, 0.6) } else { shade }
    }

    /// Colour of a triangle of this tone at a sample.
    fn colour(&self, mut tone: Rgb, pair: Pair, corners: [Corner; 3], at: [usize; 2]) -> Rgb {
        let (samples, unit) = (self.options.supersampling, unit(self.options));
        // Hatching under wires would hide them.
        if pair.front() == MaterialId::OUTSIDE && !self.options.wireframe {
            tone = hatched(tone, pair.back(), at, samples, unit);
        }
        if self.options.wireframe {
            tone = tone.mix(INK, wire(corners.map(Corner::place), at, samples, unit));
        }
        tone
    }

    /// What a material shows at a sample in a section.
    fn section(&self, id: MaterialId, at: [usize; 2]) -> Look {
        let face = self.options.palette.cut_face(id);
        let colour = hatched(face, id, at, self.options.supersampling, unit(self.options));
        Look { entry: Some(Entry::Section(id)), colour, before: None }
    }
}

/// Whether triangles of a pair are to be drawn.
pub(super) fn is_shown(pair: Pair, only: &[MaterialId]) -> bool {
    if only.is_empty() {
        pair.back() != MaterialId::BACKGROUND
    } else {
        only.iter().any(|&id| pair.contains(id))
    }
}

/// The size by which lines and hatching grow with the picture: 1 at 800 pixels.
fn unit(options: &RenderOptions) -> f64 {
    (options.width.min(options.height) as f64 / 800.0).clamp(0.75, 4.0)
}

/// Width of a line in pixels.
fn line_width(mark: EdgeMark, options: &RenderOptions) -> f64 {
    unit(options)
        * match mark {
            EdgeMark::Border => 1.1,
            EdgeMark::Junction => 2.0,
            EdgeMark::Open => 2.4,
        }
}
