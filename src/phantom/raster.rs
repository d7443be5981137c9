//! From a scene to grey values: area sampling on a fine grid, blur there, averaging, noise.
//!
//! The grid is `fine` times finer than the volume. A fine voxel that is cut by an interface gets the
//! mean grey over it: it is crossed by a square of lines along the axis most nearly normal to the first
//! surface in it; along a line the materials' shares are exact, across lines they are sampled. (That
//! beats a cube of samples: for one surface per voxel the error is of second order.) The blur is a Gaussian
//! sampled on the fine grid, cut off at 4.5 sigma or more and normalised; it and the average over
//! the volume's voxel are one separable kernel. So a value is the exact area average convolved with
//! the box of a voxel and the Gaussian, but for the sampling of the latter on the fine grid.
//!
//! A *binary* phantom has none of that: a voxel has the grey value of the material at its centre.
//!
//! The object is blurred beyond the volume's border as well: nothing is clamped there. Slices of the
//! fine grid are reduced to the volume's width and height one by one and kept only while they are
//! needed, so memory stays near that of the result.

use glam::DVec3;
use rayon::prelude::*;

use super::noise::NoiseField;
use super::{Phantom, PhantomError};
use crate::execution::Execution;
use crate::volume::kernel::{Kernel, Window, reduce};
use crate::volume::{SampleType, Samples};

/// Coarse slices finished per round: enough work for many threads, little memory.
const ROUND: usize = 16;
/// Lines across a cut fine voxel, per direction.
const LINES: usize = 6;
/// Fine voxels along a tile of the outer and the inner kind.
const TILES: [usize; 2] = [16, 4];

/// Fine voxels along a voxel: a binary phantom needs its centre only.
fn fine(phantom: &Phantom) -> usize {
    if phantom.options().binary { 1 } else { phantom.options().fine }
}

pub(super) fn rasterise(phantom: &Phantom, execution: &Execution) -> Result<Samples, PhantomError> {
    let size = phantom.geometry().size();
    let spacing = phantom.geometry().spacing();
    let factor = fine(phantom);
    let step: [f64; 3] = spacing.map(|s| s / factor as f64);
    let sigma = phantom.sigma_mm();
    let kernels: [Kernel; 3] = std::array::from_fn(|a| Kernel::new(sigma[a] / step[a], factor));
    let slicer = Slicer::new(phantom, step, &kernels);
    let mut noise = NoiseField::new(phantom);
    let air = phantom.materials().materials()[0].mean;

    let plane = size[0] * size[1];
    let mut out = Writer::new(phantom.options().sample_type, plane * size[2]);
    let mut window = Window::default();
    let stage = execution.stage("making the volume", size[2] as u64);
    for z in (0..size[2]).step_by(ROUND) {
        execution.check()?;
        let end = (z + ROUND).min(size[2]);
        window.fill(end, &kernels[2], |k| reduce(&slicer.slice(k), [size[0], size[1]], &kernels));
        noise.fill(end);
        let layers: Vec<Vec<f32>> = (z..end)
            .into_par_iter()
            .map(|z| {
                let mut layer = window.slice(z, &kernels[2], plane);
                noise.add(&mut layer, z, air);
                layer
            })
            .collect();
        for layer in layers {
            out.append(&layer);
        }
        window.drop_before(end, &kernels[2]);
        noise.drop_before(end);
        stage.advance((end - z) as u64);
    }
    Ok(out.samples)
}

/// Collects values as samples: integers rounded to the nearest and kept in range.
struct Writer {
    samples: Samples,
}

impl Writer {
    fn new(kind: SampleType, voxels: usize) -> Self {
        let samples = match kind {
            SampleType::U8 => Samples::U8(Vec::with_capacity(voxels)),
            SampleType::U16 => Samples::U16(Vec::with_capacity(voxels)),
            SampleType::I16 => Samples::I16(Vec::with_capacity(voxels)),
            SampleType::F32 => Samples::F32(Vec::with_capacity(voxels)),
        };
        Self { samples }
    }

    fn append(&mut self, layer: &[f32]) {
        // `as` keeps the value in the range of the integer type.
        match &mut self.samples {
            Samples::U8(v) => v.extend(layer.iter().map(|x| x.round() as u8)),
            Samples::U16(v) => v.extend(layer.iter().map(|x| x.round() as u16)),
            Samples::I16(v) => v.extend(layer.iter().map(|x| x.round() as i16)),
            Samples::F32(v) => v.extend_from_slice(layer),
        }
    }
}

/// Makes slices of the fine grid. Values are differences from the background's grey value.
struct Slicer<'a> {
    phantom: &'a Phantom,
    /// mm per fine voxel.
    step: DVec3,
    /// World position of the centre of fine voxel (0, 0, 0), which lies outside of the volume.
    origin: DVec3,
    width: usize,
    height: usize,
    contrast: Vec<f64>,
}

impl<'a> Slicer<'a> {
    fn new(phantom: &'a Phantom, step: [f64; 3], kernels: &[Kernel; 3]) -> Self {
        let size = phantom.geometry().size();
        let factor = fine(phantom) as f64;
        let low = |a: usize| (0.5 - 0.5 * factor - kernels[a].reach as f64) * step[a];
        let means = phantom.materials().materials();
        Self {
            phantom,
            step: step.into(),
            origin: phantom.geometry().world(DVec3::ZERO) + DVec3::new(low(0), low(1), low(2)),
            width: kernels[0].needed(size[0]),
            height: kernels[1].needed(size[1]),
            contrast: means.iter().map(|m| m.mean - means[0].mean).collect(),
        }
    }

    fn centre(&self, x: f64, y: f64, z: f64) -> DVec3 {
        self.origin + self.step * DVec3::new(x, y, z)
    }

    fn slice(&self, z: usize) -> Vec<f32> {
        let mut out = vec![0.0_f32; self.width * self.height];
        let all = u64::MAX >> (64 - self.phantom.truth().scene().surfaces().len());
        for y in (0..self.height).step_by(TILES[0]) {
            for x in (0..self.width).step_by(TILES[0]) {
                self.tile(&mut out, [x, y, z], 0, (0, all));
            }
        }
        out
    }

    /// Fills a tile; `(mask, open)` are the sides known so far, and the surfaces not yet decided.
    fn tile(&self, out: &mut [f32], at: [usize; 3], level: usize, (mask, open): (u64, u64)) {
        let edge = TILES.get(level).copied().unwrap_or(1);
        let end = [(at[0] + edge).min(self.width), (at[1] + edge).min(self.height)];
        let reach = 0.5 * (edge as f64 - 1.0);
        let centre = self.centre(at[0] as f64 + reach, at[1] as f64 + reach, at[2] as f64);
        let radius = 0.5 * (self.step * DVec3::new(edge as f64, edge as f64, 1.0)).length();
        let (mask, open) = self.decide(centre, radius, mask, open);
        let scene = self.phantom.truth().scene();
        if let Some(material) = scene.uniform(mask, open) {
            let contrast = self.contrast[usize::from(material.0)];
            if contrast == 0.0 {
                return;
            }
            for y in at[1]..end[1] {
                for x in at[0]..end[0] {
                    out[y * self.width + x] = self.cupped(contrast, [x, y, at[2]]);
                }
            }
        } else if edge == 1 {
            let contrast = if self.phantom.options().binary {
                self.contrast[usize::from(scene.material_at(centre).0)]
            } else {
                self.mixed(centre, mask, open)
            };
            out[at[1] * self.width + at[0]] = self.cupped(contrast, at);
        } else {
            let inner = TILES.get(level + 1).copied().unwrap_or(1);
            for y in (at[1]..end[1]).step_by(inner) {
                for x in (at[0]..end[0]).step_by(inner) {
                    self.tile(out, [x, y, at[2]], level + 1, (mask, open));
                }
            }
        }
    }

    /// Decides the sides of the open surfaces that are farther than `radius` from `centre`.
    fn decide(&self, centre: DVec3, radius: f64, mut mask: u64, mut open: u64) -> (u64, u64) {
        let surfaces = self.phantom.truth().scene().surfaces();
        let mut left = open;
        while left != 0 {
            let index = left.trailing_zeros() as usize;
            left &= left - 1;
            let distance = surfaces[index].signed_distance(centre);
            if distance.abs() > radius {
                open &= !(1 << index);
                mask = (mask & !(1 << index)) | (u64::from(distance < 0.0) << index);
            }
        }
        (mask, open)
    }

    /// Grey drift inside materials.
    fn cupped(&self, contrast: f64, at: [usize; 3]) -> f32 {
        let cupping = self.phantom.options().cupping;
        if cupping == 0.0 {
            return contrast as f32;
        }
        let (middle, radius) = self.phantom.truth().ball();
        let p = self.centre(at[0] as f64, at[1] as f64, at[2] as f64);
        let share = ((p - middle).length_squared() / (radius * radius)).min(1.0);
        (contrast * (1.0 - cupping * (1.0 - share))) as f32
    }

    /// Mean contrast over the fine voxel at `centre`, cut by some of the `open` surfaces.
    fn mixed(&self, centre: DVec3, mask: u64, open: u64) -> f64 {
        let scene = self.phantom.truth().scene();
        let surfaces = scene.surfaces();
        let normal = surfaces[open.trailing_zeros() as usize].normal(centre).abs();
        let axis = if normal.x >= normal.y && normal.x >= normal.z {
            0
        } else if normal.y >= normal.z {
            1
        } else {
            2
        };
        let unit = DVec3::AXES[axis];
        let half = 0.5 * self.step[axis];
        let [a, b] = crate::grid::cube::other_axes(axis);
        let offset = |k: usize| (k as f64 + 0.5) / LINES as f64 - 0.5;
        let mut cuts = Vec::with_capacity(2 + 2 * open.count_ones() as usize);
        let mut sum = 0.0;
        for (i, j) in (0..LINES).flat_map(|i| (0..LINES).map(move |j| (i, j))) {
            let mut p = centre;
            p[a] += offset(i) * self.step[a];
            p[b] += offset(j) * self.step[b];
            cuts.clear();
            cuts.extend([-half, half]);
            let mut left = open;
            while left != 0 {
                let surface = &surfaces[left.trailing_zeros() as usize];
                left &= left - 1;
                cuts.extend(surface.crossings(p, unit).into_iter().flatten().filter(|t| t.abs() < half));
            }
            cuts.sort_unstable_by(f64::total_cmp);
            for w in cuts.windows(2) {
                let (mask, _) = self.decide(p + 0.5 * (w[0] + w[1]) * unit, -1.0, mask, open);
                sum += (w[1] - w[0]) * self.contrast[usize::from(scene.material_of(mask).0)];
            }
        }
        sum / (2.0 * half * (LINES * LINES) as f64)
    }
}
