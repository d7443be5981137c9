//! A shaded picture of a mesh.
//!
//! The picture is drawn in bands, each with a z-buffer of its own: first the triangles, then the caps
//! of a cut, then lines where they are not hidden; each sample is coloured and samples are averaged to pixels.
//! Bands share nothing, and each draws in ascending order: the bytes are the same for any number of threads.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::camera::{Camera, HalfSpace};
use super::colour::INK;
use super::edges::{EdgeMark, MarkedEdge, marked_edges};
use super::legend::{Entry, Legend};
use super::raster::{self, Band, Corner, Seen};
use super::shade::{hatched, line_colour, lit, wire};
use super::{Background, Palette, Picture, PictureError, Rgb};
use crate::grid::{MaterialId, Pair};
use crate::mesh::InterfaceMesh;

/// A plane across a world axis; the part of the mesh on the eye's side of it is not drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cut {
    /// 0, 1, 2: x, y, z.
    pub axis: usize,
    /// Where the plane crosses the axis, mm.
    pub position: f64,
}

/// How a mesh is drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RenderOptions {
    /// Pixels per row. Default 1600.
    pub width: usize,
    /// Rows of pixels. Default 1200.
    pub height: usize,
    /// Where the eye is around the z axis, degrees: 0 looks from -y, 90 from +x. Default 35.
    pub azimuth: f64,
    /// How high the eye is, degrees: 90 looks from +z. Default 25.
    pub elevation: f64,
    /// Show only interfaces of these materials. Empty: all of them, except where air meets the
    /// volume's border, which would hide the rest.
    pub only: Vec<MaterialId>,
    /// Cut the mesh open.
    pub cut: Option<Cut>,
    /// Close the cut, so that it shows the materials in section. Right for a closed mesh only: a hole lets
    /// the wrong material through. Default `false`: the inner surfaces are seen.
    pub caps: bool,
    /// Draw the triangles' edges, too.
    pub wireframe: bool,
    /// Draw junction curves. Default `true`.
    pub junctions: bool,
    /// Draw edges with one triangle only. Default `true`.
    pub open_edges: bool,
    /// Say what the colours are. Default `true`.
    pub legend: bool,
    /// What is behind the mesh.
    pub background: Background,
    /// Samples per pixel and axis, 1 to 8. Default 2.
    pub supersampling: usize,
    /// The colours.
    pub palette: Palette,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            width: 1600,
            height: 1200,
            azimuth: 35.0,
            elevation: 25.0,
            only: Vec::new(),
            cut: None,
            caps: false,
            wireframe: false,
            junctions: true,
            open_edges: true,
            legend: true,
            background: Background::White,
            supersampling: 2,
            palette: Palette::default(),
        }
    }
}

/// Pixel rows per band: a band's z-buffer should stay in a core's cache.
const BAND_ROWS: usize = 16;
/// Triangles that one task sorts into bands.
const BIN_CHUNK: usize = 1 << 16;

/// Draws a mesh, as large as the picture allows.
///
/// # Errors
/// [`PictureError::Size`] and [`PictureError::Option`] for options out of range,
/// [`PictureError::Nothing`] if no triangle is to be shown.
pub fn render(mesh: &InterfaceMesh, options: &RenderOptions) -> Result<Picture, PictureError> {
    let mut picture = Picture::new(options.width, options.height, options.background)?;
    let limit = |what, value: f64, ok: bool, needed| {
        if ok { Ok(()) } else { Err(PictureError::Option { what, value, needed }) }
    };
    limit("the azimuth", options.azimuth, options.azimuth.is_finite(), "a finite number of degrees")?;
    limit("the elevation", options.elevation, options.elevation.is_finite(), "a finite number of degrees")?;
    let samples = options.supersampling;
    limit("the supersampling", samples as f64, (1..=8).contains(&samples), "1 to 8 samples per pixel")?;
    if let Some(Cut { axis, position }) = options.cut {
        limit("the axis of the cut", axis as f64, axis < 3, "0, 1 or 2 (x, y or z)")?;
        limit("the position of the cut", position, position.is_finite(), "a finite number of mm")?;
    }

    let scene = Scene::new(mesh, options)?;
    let bins = scene.bins();
    let drawn: Vec<Vec<Entry>> = picture
        .rgba_mut()
        .par_chunks_mut(4 * options.width * BAND_ROWS)
        .enumerate()
        .map(|(band, pixels)| scene.draw_band(band, &bins, pixels))
        .collect();
    if options.legend {
        let mut entries: Vec<Entry> = drawn.into_iter().flatten().collect();
        entries.sort_unstable();
        entries.dedup();
        let legend = Legend::new(&entries, mesh.materials(), &options.palette, options.height);
        legend.draw_in_emptiest_corner(&mut picture);
    }
    Ok(picture)
}

/// Everything that the bands read.
struct Scene<'a> {
    mesh: &'a InterfaceMesh,
    options: &'a RenderOptions,
    /// Projected vertices.
    corners: Vec<Corner>,
    /// Colour of every triangle in the light, before hatching.
    tones: Vec<Rgb>,
    lines: Vec<Line>,
    keep: Option<HalfSpace>,
}

/// A marked edge on the screen.
struct Line {
    mark: EdgeMark,
    /// Projected.
    ends: [DVec3; 2],
    /// Half its width, in samples.
    radius: f64,
}

/// Which triangles and lines touch which band: ascending within a band.
struct Bins {
    /// Per chunk of triangles, per band.
    triangles: Vec<Vec<Vec<u32>>>,
    /// Per band.
    lines: Vec<Vec<u32>>,
}

impl<'a> Scene<'a> {
    fn new(mesh: &'a InterfaceMesh, options: &'a RenderOptions) -> Result<Self, PictureError> {
        let triangles = mesh.triangles();
        if triangles.len() >= raster::TRIANGLES_END as usize {
            let (what, value) = ("the number of triangles", triangles.len() as f64);
            return Err(PictureError::Option { what, value, needed: "below 2^32 - 512" });
        }
        let shown = |t: usize| is_shown(mesh.pairs()[t], &options.only);
        if !(0..triangles.len()).any(shown) {
            return Err(PictureError::Nothing { triangles: triangles.len() });
        }
        let size = [options.width, options.height].map(|n| n * options.supersampling);
        let points = (0..triangles.len()).filter(|&t| shown(t)).flat_map(|t| mesh.corners(t));
        let camera = Camera::fitted(points, options.azimuth, options.elevation, size);
        let projected: Vec<DVec3> = mesh.positions().par_iter().map(|&p| camera.project(p)).collect();
        let tones = (0..triangles.len())
            .into_par_iter()
            .map(|t| {
                let pair = mesh.pairs()[t];
                let colour = options.palette.surface(pair);
                let shade = lit(colour, mesh.corners(t), &camera);
                // A cut face is a drawing more than a surface: it must stay light from every side.
                if pair.front() == MaterialId::OUTSIDE { shade.mix(colour, 0.6) } else { shade }
            })
            .collect();
        let mut lines: Vec<Line> = if options.junctions || options.open_edges {
            marked_edges(mesh, shown)
                .into_iter()
                .filter(|e| if e.mark == EdgeMark::Open { options.open_edges } else { options.junctions })
                .map(|MarkedEdge { vertices, mark }| Line {
                    mark,
                    ends: vertices.map(|v| projected[v as usize]),
                    radius: 0.5 * line_width(mark, options) * options.supersampling as f64,
                })
                .collect()
        } else {
            Vec::new()
        };
        // What matters more is drawn later, over the rest. (A stable sort: ties keep their order.)
        lines.sort_by_key(|line| line.mark);
        Ok(Self {
            mesh,
            options,
            corners: projected.into_par_iter().map(Corner::new).collect(),
            tones,
            lines,
            keep: options.cut.map(|cut| camera.behind(cut.axis, cut.position)),
        })
    }

    fn corners_of(&self, t: usize) -> [Corner; 3] {
        self.mesh.triangles()[t].map(|v| self.corners[v as usize])
    }

    /// Rows of samples in a picture.
    fn sample_rows(&self) -> usize {
        self.options.height * self.options.supersampling
    }

    /// Rows that a band computes beyond its own on either side, because lines look there.
    fn halo(&self) -> usize {
        self.lines.iter().map(|l| l.radius).fold(0.0, f64::max).ceil() as usize + 2
    }

    fn bins(&self) -> Bins {
        let bands = self.options.height.div_ceil(BAND_ROWS);
        let rows_per_band = (BAND_ROWS * self.options.supersampling) as i64;
        let halo = self.halo() as i64;
        // Bands whose rows, widened by a margin, meet rows `low..high`.
        let touched = move |(low, high): (i64, i64), margin: i64| -> Range<usize> {
            let clamp = |v: i64| v.clamp(0, bands as i64) as usize;
            let first = (low - margin).div_euclid(rows_per_band);
            clamp(first)..clamp((high - 1 + margin).div_euclid(rows_per_band) + 1)
        };
        let count = self.mesh.triangles().len();
        let triangles = (0..count.div_ceil(BIN_CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let mut bins = vec![Vec::new(); bands];
                for t in chunk * BIN_CHUNK..count.min((chunk + 1) * BIN_CHUNK) {
                    let rows = raster::rows_of(self.corners_of(t));
                    if rows.0 < rows.1 && is_shown(self.mesh.pairs()[t], &self.options.only) {
                        touched(rows, halo).for_each(|band| bins[band].push(t as u32));
                    }
                }
                bins
            })
            .collect();
        let mut lines = vec![Vec::new(); bands];
        for (i, Line { ends: [a, b], radius, .. }) in self.lines.iter().enumerate() {
            let low = (a.y.min(b.y) - radius).floor() as i64;
            let high = (a.y.max(b.y) + radius).ceil() as i64;
            touched((low, high), 0).for_each(|band| lines[band].push(i as u32));
        }
        Bins { triangles, lines }
    }

    /// Draws a band's pixels; returns what is seen in them.
    fn draw_band(&self, band: usize, bins: &Bins, pixels: &mut [u8]) -> Vec<Entry> {
        let samples = self.options.supersampling;
        let width = self.options.width * samples;
        let rows = pixels.len() / (4 * self.options.width);
        let own = band * BAND_ROWS * samples..(band * BAND_ROWS + rows) * samples;
        let top = own.start.saturating_sub(self.halo());
        let bottom = (own.end + self.halo()).min(self.sample_rows());
        let mut buffer = Band::new(width, top, bottom - top);
        for &t in bins.triangles.iter().flat_map(|chunk| &chunk[band]) {
            buffer.triangle(t, self.corners_of(t as usize), self.keep.as_ref());
        }
        if let (Some(plane), true) = (&self.keep, self.options.caps) {
            buffer.cap(plane, |seen| self.material_before(seen));
        }
        for &i in &bins.lines[band] {
            let Line { mark, ends, radius } = &self.lines[i as usize];
            buffer.line(*mark as u32, *ends, *radius, own.clone(), self.keep.as_ref());
        }
        self.resolve(&buffer, own.start, pixels)
    }

    /// The material in front of what is seen, if it is a body that is shown.
    fn material_before(&self, seen: Seen) -> Option<u8> {
        let pair = self.mesh.pairs()[seen as usize];
        let is_front = raster::signed_area(self.corners_of(seen as usize)) < 0;
        let id = if is_front { pair.front() } else { pair.back() };
        let is_body = id != MaterialId::BACKGROUND && id != MaterialId::OUTSIDE;
        let only = &self.options.only;
        (is_body && (only.is_empty() || only.contains(&id))).then_some(id.0)
    }

    /// Colours samples and averages them to pixels, over what is there; returns what is seen.
    fn resolve(&self, band: &Band, first_row: usize, pixels: &mut [u8]) -> Vec<Entry> {
        let n = self.options.supersampling;
        let mut entries = Vec::new();
        for (row, line) in pixels.chunks_exact_mut(4 * self.options.width).enumerate() {
            for (x, pixel) in line.chunks_exact_mut(4).enumerate() {
                let (mut sum, mut covered) = ([0u32; 3], 0u32);
                for dy in 0..n {
                    let y = first_row + row * n + dy;
                    for (dx, &seen) in band.row(y)[x * n..(x + 1) * n].iter().enumerate() {
                        if seen == raster::EMPTY {
                            continue;
                        }
                        let Rgb(r, g, b) = self.colour(seen, x * n + dx, y);
                        covered += 1;
                        for (s, c) in sum.iter_mut().zip([r, g, b]) {
                            *s += u32::from(c);
                        }
                    }
                }
                if covered == 0 {
                    continue;
                }
                let entry = self.entry(band.row(first_row + row * n)[x * n]);
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

    fn entry(&self, seen: Seen) -> Option<Entry> {
        match seen {
            raster::EMPTY => None,
            s if s >= raster::LINE => mark_of(s).map(Entry::Line),
            s if s >= raster::CAP => Some(Entry::Section(MaterialId((s - raster::CAP) as u8))),
            t => Some(Entry::Surface(self.mesh.pairs()[t as usize])),
        }
    }

    /// Colour of a sample at column `x` of row `y`.
    fn colour(&self, seen: Seen, x: usize, y: usize) -> Rgb {
        if seen >= raster::LINE {
            return mark_of(seen).map_or(INK, line_colour);
        }
        let per_pixel = self.options.supersampling;
        if seen >= raster::CAP {
            let id = MaterialId((seen - raster::CAP) as u8);
            return hatched(self.options.palette.cut_face(id), id, [x, y], per_pixel, unit(self.options));
        }
        let t = seen as usize;
        let pair = self.mesh.pairs()[t];
        let mut tone = self.tones[t];
        if pair.front() == MaterialId::OUTSIDE {
            tone = hatched(tone, pair.back(), [x, y], per_pixel, unit(self.options));
        }
        if self.options.wireframe {
            let corners = self.corners_of(t).map(Corner::place);
            tone = tone.mix(INK, wire(corners, [x, y], per_pixel, unit(self.options)));
        }
        tone
    }
}

/// Whether triangles of a pair are to be drawn.
fn is_shown(pair: Pair, only: &[MaterialId]) -> bool {
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

/// The mark whose line a sample shows.
fn mark_of(seen: Seen) -> Option<EdgeMark> {
    [EdgeMark::Border, EdgeMark::Junction, EdgeMark::Open]
        .into_iter()
        .find(|m| raster::LINE + *m as u32 == seen)
}

#[cfg(test)]
#[path = "render_tests.rs"]
pub(super) mod tests;
