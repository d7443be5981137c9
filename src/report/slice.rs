//! A slice of a volume with a mesh's outline over it.

use std::collections::BTreeMap;

use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::colour::INK;
use super::legend::{Entry, Legend};
use super::outline::outline;
use super::{Background, Palette, Picture, PictureError, Rgb};
use crate::grid::cube::other_axes;
use crate::grid::{MaterialId, Pair, VoxelBox};
use crate::mesh::InterfaceMesh;
use crate::volume::VolumeSource;

/// Junction points.
pub(super) const DOT: Rgb = Rgb(255, 32, 32);

/// How a slice is drawn. Columns are the lower of the two axes in the slice, rows (downwards) the higher one:
/// a z slice shows x to the right and y down.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SliceOptions {
    /// Lattice axis across the slice: 0, 1, 2 for x, y, z. Default 2.
    pub axis: usize,
    /// Voxel index along `axis`.
    pub index: usize,
    /// Pixels per voxel along the axis with the finer spacing; the other follows so that the picture
    /// is true to scale. 1 to 64, default 4.
    pub zoom: usize,
    /// The part to show: low and high (exclusive) voxel index of columns, then of rows. `None`: all.
    pub crop: Option<[[usize; 2]; 2]>,
    /// Grey values shown black and white, as percentiles of the part. Default 0.5 and 99.5.
    pub window: [f64; 2],
    /// Show the outlines of these materials only. Empty: all.
    pub only: Vec<MaterialId>,
    /// Draw a dot where three or more materials meet. Default `true`.
    pub junctions: bool,
    /// Say below the slice which one it is and what the colours are. Default `true`.
    pub legend: bool,
    /// The colours.
    pub palette: Palette,
}

impl Default for SliceOptions {
    fn default() -> Self {
        Self {
            axis: 2,
            index: 0,
            zoom: 4,
            crop: None,
            window: [0.5, 99.5],
            only: Vec::new(),
            junctions: true,
            legend: true,
            palette: Palette::default(),
        }
    }
}

/// Draws a slice of a volume, and the outline of `mesh` over it.
///
/// # Errors
/// [`PictureError`] if the slice, its crop or an option does not exist or the picture would be too
/// large; [`PictureError::Volume`] if the volume cannot be read.
pub fn slice_picture(
    volume: &dyn VolumeSource,
    mesh: Option<&InterfaceMesh>,
    options: &SliceOptions,
) -> Result<Picture, PictureError> {
    let frame = Frame::new(volume, options)?;
    let mut picture = Picture::new(frame.pixels[0], frame.pixels[1], Background::White)?;
    let grey = grey_values(volume, &frame, options)?;
    let columns = frame.high[0] - frame.low[0];
    for y in 0..picture.height() {
        let row = frame.voxel(1, y) - frame.low[1];
        for x in 0..picture.width() {
            let value = grey[row * columns + frame.voxel(0, x) - frame.low[0]];
            let i = 4 * (y * picture.width() + x);
            picture.rgba_mut()[i..i + 3].fill(value);
        }
    }
    let entries = match mesh {
        Some(mesh) => draw_outline(&mut picture, volume, mesh, &frame, options),
        None => Vec::new(),
    };
    if !options.legend {
        return Ok(picture);
    }
    let materials = mesh.map_or(&[][..], InterfaceMesh::materials);
    let heading = format!("slice {} = {}", ['x', 'y', 'z'][options.axis], options.index);
    let legend = Legend::new(&entries, materials, &options.palette, picture.height()).headed(heading);
    with_legend(&picture, &legend)
}

/// Which voxels are shown, and where.
struct Frame {
    /// First voxel per axis of the slice.
    low: [usize; 2],
    /// One past the last.
    high: [usize; 2],
    /// Pixels per voxel.
    zoom: [f64; 2],
    /// Size of the picture.
    pixels: [usize; 2],
}

impl Frame {
    fn new(volume: &dyn VolumeSource, options: &SliceOptions) -> Result<Self, PictureError> {
        let bad = |what, value, needed| Err(PictureError::Option { what, value, needed });
        let SliceOptions { axis, index, zoom, window: [black, white], .. } = *options;
        if axis > 2 {
            return bad("the axis of the slice", axis as f64, "0, 1 or 2 (x, y or z)");
        }
        if !(1..=64).contains(&zoom) {
            return bad("the zoom", zoom as f64, "1 to 64 pixels per voxel");
        }
        if !(0.0..=100.0).contains(&black) {
            return bad("the percentile shown black", black, "0 to 100");
        }
        if !(black..=100.0).contains(&white) {
            return bad("the percentile shown white", white, "at least that shown black, and at most 100");
        }
        let size = volume.geometry().size();
        if index >= size[axis] {
            return Err(PictureError::Slice { axis: ['x', 'y', 'z'][axis], index, last: size[axis] - 1 });
        }
        let in_slice = other_axes(axis).map(|a| size[a]);
        let crop = options.crop.unwrap_or(in_slice.map(|n| [0, n]));
        if (0..2).any(|k| crop[k][0] >= crop[k][1] || crop[k][1] > in_slice[k]) {
            return Err(PictureError::Crop { crop, size: in_slice });
        }
        let spacing = other_axes(axis).map(|a| volume.geometry().spacing()[a]);
        let fine = spacing[0].min(spacing[1]);
        let zoom = spacing.map(|s| zoom as f64 * s / fine);
        let pixels = [0, 1].map(|k| ((crop[k][1] - crop[k][0]) as f64 * zoom[k]).round() as usize);
        Ok(Self { low: crop.map(|c| c[0]), high: crop.map(|c| c[1]), zoom, pixels })
    }

    /// The voxel that a pixel shows, along one axis of the slice.
    fn voxel(&self, k: usize, pixel: usize) -> usize {
        let at = ((pixel as f64 + 0.5) / self.zoom[k]) as usize;
        (self.low[k] + at).min(self.high[k] - 1)
    }

    /// The place of a lattice index in the picture. A voxel's centre is in the middle of its pixels.
    fn place(&self, p: DVec2) -> [f64; 2] {
        [0, 1].map(|k| (p[k] - self.low[k] as f64 + 0.5) * self.zoom[k])
    }
}

/// The part's voxels as bytes, black and white at the percentiles.
fn grey_values(
    volume: &dyn VolumeSource,
    frame: &Frame,
    options: &SliceOptions,
) -> Result<Vec<u8>, PictureError> {
    let mut part = VoxelBox { low: [options.index; 3], high: [options.index + 1; 3] };
    for (k, a) in other_axes(options.axis).into_iter().enumerate() {
        (part.low[a], part.high[a]) = (frame.low[k], frame.high[k]);
    }
    let samples = volume.read(&part)?;
    let values: Vec<f32> = (0..samples.len()).map(|i| samples.get(i)).collect();
    let mut sorted: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let percentile = |p: f64| {
        let at = (p / 100.0 * sorted.len().saturating_sub(1) as f64).round() as usize;
        sorted.get(at).copied().unwrap_or(0.0)
    };
    let [black, white] = options.window.map(percentile);
    let scale = if white > black { 255.0 / (white - black) } else { 0.0 };
    // A cast saturates, and turns NaN into black.
    Ok(values.iter().map(|v| ((v - black) * scale + 0.5) as u8).collect())
}

/// Draws the outline; returns what there is to see.
fn draw_outline(
    picture: &mut Picture,
    volume: &dyn VolumeSource,
    mesh: &InterfaceMesh,
    frame: &Frame,
    options: &SliceOptions,
) -> Vec<Entry> {
    let shown = |pair: Pair| options.only.is_empty() || options.only.iter().any(|&id| pair.contains(id));
    let found = outline(mesh, volume.geometry(), options.axis, options.index as f64, shown);
    // What the crop leaves out must not stand in the legend.
    let size = frame.pixels.map(|n| n as f64);
    let misses = |a: [f64; 2], b: [f64; 2]| (0..2).any(|k| a[k].max(b[k]) < 0.0 || a[k].min(b[k]) > size[k]);
    let width = (options.zoom as f64 / 5.0).clamp(1.0, 3.0);
    let mut strokes: BTreeMap<Pair, Vec<[[f64; 2]; 2]>> = BTreeMap::new();
    for (ends, pair) in found.segments {
        let [a, b] = ends.map(|p| frame.place(p));
        if !misses(a, b) {
            strokes.entry(pair).or_default().push([a, b]);
        }
    }
    for (&pair, lines) in &strokes {
        picture.stroke(lines, width, options.palette.outline(pair));
    }
    let mut entries: Vec<Entry> = strokes.into_keys().map(Entry::Outline).collect();
    let dots = found.junctions.into_iter().map(|p| frame.place(p)).filter(|&p| !misses(p, p));
    for at in dots.filter(|_| options.junctions) {
        picture.disc(at, 1.6 * width + 1.0, INK);
        picture.disc(at, 1.6 * width, DOT);
        if entries.last() != Some(&Entry::Dot) {
            entries.push(Entry::Dot);
        }
    }
    entries
}

/// The picture with a strip below it that says which slice it is and what the colours are: over the
/// slice it would hide data.
fn with_legend(picture: &Picture, legend: &Legend) -> Result<Picture, PictureError> {
    let [width, height] = legend.size();
    let mut whole = Picture::new(picture.width().max(width), picture.height() + height, Background::White)?;
    let (from, to) = (4 * picture.width(), 4 * whole.width());
    for (row, pixels) in whole.rgba_mut().chunks_exact_mut(to).zip(picture.rgba().chunks_exact(from)) {
        row[..from].copy_from_slice(pixels);
    }
    legend.draw(&mut whole, [0, picture.height() as i64]);
    Ok(whole)
}

#[cfg(test)]
#[path = "slice_tests.rs"]
mod tests;
