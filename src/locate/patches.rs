//! Sheets of interfaces away from junctions and sharp edges: one fit for the crossings of a block of cells.
//!
//! Blocks are aligned to the lattice, so they do not depend on how the volume was cut. The crossings of a pair in a
//! block share a fit ([`fit_sheet`]) of the grey values around their mean; voxels whose label contradicts a single
//! sheet there (another sheet, an edge) are left out together with what their blur reaches. A fit is taken if it
//! explains the grey values as well as noise allows; then each crossing of the block gets its place, the sheet's
//! normal and a standard deviation from it. Others stay where the threshold puts them, and the blocks are
//! where sharp edges are looked for.

use std::ops::Range;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::ball_model::KeptBall;
use super::crossing_edges::crossing_edges;
use super::frame::BlurUnits;
use super::least_squares::{packed, packed_sigma};
use super::passage::Passage;
use super::sheet::{LevelPrior, Sample, Sheet, fit_sheet};
use super::specks::settle;
use super::thin_faces::{ThinFace, explains, thin_face};
use super::view::{Seen, View};
use crate::classify::{BitPlanes, LabelVolume};
use crate::grid::MaterialId;

/// Cells along a block.
pub(super) const BLOCK: usize = 3;
/// Radius of a fit, blur units; no less than so many voxels, or there is too little to see.
const RADIUS: f64 = 3.0;
const LEAST_VOXELS: f64 = 2.6;
/// Fewest voxels of a fit.
const FEWEST: usize = 24;
/// A voxel this far (blur units) on the wrong side contradicts a single sheet.
const WRONG: f64 = 1.3;
/// What lies this near to it is left out.
const TAINTED: f64 = 2.4;
/// The model's own errors, as a share of the contrast: what is left without noise.
const MODEL: f64 = 0.003;
/// Standard deviation of grey levels, as a share of the contrast, beside what the levels say: they drift towards surfaces.
const LEVEL: f64 = 0.03;
/// Largest curvature at which the model of a sheet holds, per blur unit.
pub(super) const MOST_CURVED: f64 = 0.45;
/// A fit that leaves its block's crossings by more than this (voxels) is of another sheet.
pub(super) const FARTHEST: f64 = 1.0;

/// A fitted patch, as its neighbours need it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flat {
    /// The lower and the higher material.
    pub pair: [MaterialId; 2],
    /// A point of the sheet, voxels.
    pub at: DVec3,
    /// Normal in blur units, from the lower to the higher.
    pub normal: DVec3,
    /// Standard deviation of the point along the normal, blur units.
    pub sigma: f64,
    /// Larger principal curvature by size, per blur unit.
    pub curvature: f64,
    /// Normal curvature as a form on space: the sheet rises by half of it along the normal.
    pub form: DMat3,
    /// Standard deviation of normal curvatures.
    pub form_sigma: f64,
}

/// A block whose crossings are not one smooth sheet, or not surely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rough {
    /// The lower and the higher material.
    pub pair: [MaterialId; 2],
    /// Mean of its crossings, voxels.
    pub at: DVec3,
    /// Whether a patch was accepted all the same, for what the scan's worse interfaces show.
    pub fitted: bool,
}

/// A sheet as it is kept: in voxels from the block's lowest corner.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Kept {
    origin: [f32; 3],
    /// Axes u and w in blur units; v is their product.
    u: [f32; 3],
    w: [f32; 3],
    /// Height, tilts, curvatures.
    form: [f32; 6],
    /// Lower triangle of their covariance, by rows.
    covariance: [f32; 21],
}

/// What is kept of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    Sheet(Kept),
    Ball(KeptBall),
    /// No model explains it.
    Rough,
}

impl Shape {
    /// At a place in blur units from the block's corner.
    fn passage(&self, at: DVec3) -> Option<Passage> {
        match self {
            Self::Sheet(sheet) => Some(sheet.passage(at)),
            Self::Ball(ball) => Some(ball.passage(at)),
            Self::Rough => None,
        }
    }

    /// Standard deviation of the surface's place along its normal there, for white noise; NaN if there is none.
    fn sigma(&self, at: DVec3) -> f64 {
        match self {
            Self::Sheet(sheet) => sheet.sigma(at),
            Self::Ball(ball) => ball.sigma(at),
            Self::Rough => f64::NAN,
        }
    }
}

/// What patches say of the interface of a pair in a block.
#[derive(Debug, Clone, Copy)]
pub struct OfBlock<'a> {
    shapes: &'a [Shape],
    /// The block's lowest voxel.
    corner: DVec3,
    units: BlurUnits,
}

impl OfBlock<'_> {
    /// Whether the interface passes the block, fitted or not.
    #[must_use]
    pub fn passes(&self) -> bool {
        !self.shapes.is_empty()
    }

    /// Whether it is the same block.
    pub(super) fn is_of(&self, other: &Self) -> bool {
        std::ptr::eq(self.shapes, other.shapes)
    }

    fn nearest(&self, at: DVec3) -> Option<(&Shape, Passage)> {
        let at = self.units.of(at - self.corner);
        let all = self.shapes.iter().filter_map(|shape| Some((shape, shape.passage(at)?)));
        all.min_by(|a, b| a.1.distance.abs().total_cmp(&b.1.distance.abs()))
    }

    /// Where the interface passes `at` (voxels).
    #[must_use]
    pub fn passage(&self, at: DVec3) -> Option<Passage> {
        self.nearest(at).map(|(_, passage)| passage)
    }

    /// Standard deviation of its place along the normal there, blur units, for white noise.
    #[must_use]
    pub fn sigma(&self, at: DVec3) -> Option<f64> {
        self.nearest(at).map(|(shape, _)| shape.sigma(self.units.of(at - self.corner)))
    }
}

/// The patches of a run of slices.
#[derive(Debug, Default)]
pub struct Patches {
    /// Layers of blocks that are here, and rows of blocks in a layer.
    layers: Range<usize>,
    height: usize,
    /// First entry of each row of blocks, and the end.
    first: Vec<u32>,
    /// Place of the block in its row, and the pair, ascending; several sheets of a pair are apart.
    keys: Vec<(u16, [MaterialId; 2])>,
    kept: Vec<Shape>,
    /// By block.
    pub flats: Vec<Flat>,
    /// By block.
    pub rough: Vec<Rough>,
}

/// An edge with different labels.
#[derive(Debug, Clone, Copy)]
struct Edge {
    block: [u16; 2],
    pair: [MaterialId; 2],
    from: [usize; 3],
    axis: u8,
    /// Whether the lower material is at the lower end.
    rising: bool,
    plain: f32,
}

#[derive(Default)]
struct Layer {
    sheets: Vec<([u16; 2], [MaterialId; 2], Shape)>,
    flats: Vec<Flat>,
    rough: Vec<Rough>,
}

impl Patches {
    /// The patches of these layers of blocks, from what `view` holds.
    #[must_use]
    pub fn fit(view: &View<'_>, layers: Range<usize>) -> Self {
        let found: Vec<Layer> = layers.clone().into_par_iter().map(|b| layer(view, b)).collect();
        let height = view.slab.size()[1].div_ceil(BLOCK);
        let mut out = Self { layers: layers.clone(), height, ..Self::default() };
        out.first = vec![0; height * layers.len() + 1];
        for (i, mut layer) in found.into_iter().enumerate() {
            for (block, pair, kept) in layer.sheets {
                out.first[i * height + usize::from(block[0]) + 1] += 1;
                out.keys.push((block[1], pair));
                out.kept.push(kept);
            }
            out.flats.append(&mut layer.flats);
            out.rough.append(&mut layer.rough);
        }
        for i in 1..out.first.len() {
            out.first[i] += out.first[i - 1];
        }
        out
    }

    /// What they say of the interface of a pair (ascending) in the block that voxel `from` is in.
    #[must_use]
    pub fn of_block(&self, units: BlurUnits, from: [usize; 3], pair: [MaterialId; 2]) -> OfBlock<'_> {
        let corner = DVec3::from(from.map(|c| (c / BLOCK * BLOCK) as f64));
        OfBlock { shapes: self.own(from, pair), corner, units }
    }

    /// What is kept of the block of a voxel.
    fn own(&self, from: [usize; 3], pair: [MaterialId; 2]) -> &[Shape] {
        let block = from.map(|c| c / BLOCK);
        if !self.layers.contains(&block[2]) || block[1] >= self.height {
            return &[];
        }
        let row = (block[2] - self.layers.start) * self.height + block[1];
        let range = self.first[row] as usize..self.first[row + 1] as usize;
        let key = (block[0] as u16, pair);
        let keys = &self.keys[range.clone()];
        let (first, end) = (keys.partition_point(|k| *k < key), keys.partition_point(|k| *k <= key));
        &self.kept[range.start + first..range.start + end]
    }
}

/// A label may be wrong by noise if its voxel lies this near to the interface, blur units.
const NOISY: f64 = 0.7;

impl Patches {
    /// Gives voxels that noise has put on the wrong side of a patch the right material. `slices` of voxels; those in
    /// `fixed` keep theirs. Each voxel is judged by the patch of its own block.
    pub fn relabel(
        &self,
        units: &BlurUnits,
        labels: &mut LabelVolume,
        fixed: &BitPlanes,
        slices: Range<usize>,
    ) {
        let before = &*labels;
        let wrong: Vec<([usize; 3], MaterialId)> = slices
            .into_par_iter()
            .flat_map_iter(|z| {
                let mut ends: Vec<([usize; 3], [MaterialId; 2])> = Vec::new();
                for low in [z.checked_sub(1), Some(z)].into_iter().flatten() {
                    if !before.codes().voxel_slices().contains(&(low + 1)) {
                        continue;
                    }
                    crossing_edges(before, low, |from, axis| {
                        let mut to = from;
                        to[axis] += 1;
                        let label = |v: [usize; 3]| before.at(v.map(|c| c + 1));
                        for (own, other) in [(from, to), (to, from)] {
                            if own[2] == z && !fixed.bit(0, own[0] + 1, own[1] + 1, own[2] + 1) {
                                ends.push((own, [label(own), label(other)]));
                            }
                        }
                    });
                }
                ends.sort_unstable();
                ends.dedup();
                ends.into_iter()
                    .filter_map(|(voxel, [own, other])| {
                        let pair = if own < other { [own, other] } else { [other, own] };
                        let at = DVec3::from(voxel.map(|c| c as f64));
                        let passage = self.of_block(*units, voxel, pair).passage(at)?;
                        let right = pair[usize::from(passage.distance > 0.0)];
                        (right != own && passage.distance.abs() < NOISY).then_some((voxel, right))
                    })
                    .collect::<Vec<_>>()
            })
            .collect();
        for (voxel, material) in &wrong {
            labels.set(voxel.map(|c| c + 1), *material);
        }
        // Neighbours judge by patches of their own: what they leave alone follows them.
        settle(labels, &wrong.iter().map(|(voxel, _)| voxel.map(|c| c + 1)).collect::<Vec<_>>());
    }
}

impl Kept {
    fn new(sheet: &Sheet, from_corner: DVec3) -> Self {
        let x = &sheet.fit.x;
        Self {
            origin: (sheet.origin + from_corner).as_vec3().to_array(),
            u: sheet.axes.x_axis.as_vec3().to_array(),
            w: sheet.axes.z_axis.as_vec3().to_array(),
            form: std::array::from_fn(|i| x[i] as f32),
            covariance: packed(&sheet.fit.covariance),
        }
    }

    /// Axes u, v, w, and a place (blur units from the block's corner) in them.
    fn seen(&self, at: DVec3) -> ([DVec3; 3], DVec3) {
        let [origin, u, w] = [self.origin, self.u, self.w].map(|v| DVec3::from(v.map(f64::from)));
        let (v, q) = (w.cross(u), at - origin);
        ([u, v, w], DVec3::new(u.dot(q), v.dot(q), w.dot(q)))
    }

    /// At a place in blur units from the block's corner.
    fn passage(&self, at: DVec3) -> Passage {
        let ([u_axis, v_axis, w_axis], DVec3 { x: u, y: v, z: w }) = self.seen(at);
        let x = self.form.map(f64::from);
        let height = x[0] + x[1] * u + x[2] * v + 0.5 * (x[3] * u * u + x[5] * v * v) + x[4] * u * v;
        let slope = [x[1] + x[3] * u + x[4] * v, x[2] + x[4] * u + x[5] * v];
        let scale = 1.0 / (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt();
        let normal = (w_axis - u_axis * slope[0] - v_axis * slope[1]) * scale;
        Passage { distance: (w - height) * scale, normal }
    }

    /// Standard deviation there along the normal, for white noise.
    fn sigma(&self, at: DVec3) -> f64 {
        let (_, DVec3 { x: u, y: v, .. }) = self.seen(at);
        packed_sigma(&self.covariance, &[1.0, u, v, 0.5 * u * u, u * v, 0.5 * v * v])
    }
}

/// The blocks of one layer of blocks.
fn layer(view: &View<'_>, block_z: usize) -> Layer {
    let mut edges = Vec::new();
    for z in block_z * BLOCK..((block_z + 1) * BLOCK).min(view.slab.size()[2]) {
        crossing_edges(view.labels, z, |from, axis| {
            let mut to = from;
            to[axis] += 1;
            if view.is_uncertain(from) || view.is_uncertain(to) {
                return;
            }
            let (a, b) = (view.label(from), view.label(to));
            let pair = if a < b { [a, b] } else { [b, a] };
            let middle = DVec3::from(from.map(|c| c as f64)) + 0.5 * DVec3::AXES[axis];
            let t = 0.5 * (view.mean(a, middle) + view.mean(b, middle));
            let (f, g) = (f64::from(view.slab.grey(from)) - t, f64::from(view.slab.grey(to)) - t);
            let plain = if (f < 0.0) == (g < 0.0) { 0.5 } else { (f / (f - g)) as f32 };
            edges.push(Edge {
                block: [from[1], from[0]].map(|c| (c / BLOCK) as u16),
                pair,
                from,
                axis: axis as u8,
                rising: a < b,
                plain,
            });
        });
    }
    // Stable: within a block in the order of z, y, axis, x.
    edges.sort_by_key(|e| (e.block, e.pair));
    let mut out = Layer::default();
    let mut seen = Vec::new();
    for group in edges.chunk_by(|a, b| (a.block, a.pair) == (b.block, b.pair)) {
        for side in sides(group) {
            block(view, &side, block_z, &mut seen, &mut out);
        }
    }
    out
}

/// The edges of a block, apart where both directions occur along an axis: two faces of something thin.
fn sides(group: &[Edge]) -> Vec<Vec<Edge>> {
    let count =
        |axis: u8, rising: bool| group.iter().filter(|e| e.axis == axis && e.rising == rising).count();
    // The axis nearest to the normal has most edges; of others those of a single face may show both directions.
    let both = (0..3u8).filter(|&a| count(a, true) > 0 && count(a, false) > 0);
    let split = both.max_by_key(|&a| (count(a, true) + count(a, false), 2 - a));
    let Some(axis) = split else {
        return vec![group.to_vec()];
    };
    let mean = |rising: bool| {
        let own = group.iter().filter(|e| e.axis == axis && e.rising == rising);
        own.map(crossing).sum::<DVec3>() / count(axis, rising) as f64
    };
    let means = [mean(false), mean(true)];
    let mut out = vec![Vec::new(), Vec::new()];
    for e in group {
        let side = if e.axis == axis {
            usize::from(e.rising)
        } else {
            let d = means.map(|m| m.distance_squared(crossing(e)));
            usize::from(d[1] < d[0])
        };
        out[side].push(*e);
    }
    out
}

/// The crossing by the threshold, in voxels.
fn crossing(e: &Edge) -> DVec3 {
    DVec3::from(e.from.map(|c| c as f64)) + DVec3::AXES[usize::from(e.axis)] * f64::from(e.plain)
}

/// Fits a block.
fn block(view: &View<'_>, edges: &[Edge], block_z: usize, seen: &mut Vec<Seen>, out: &mut Layer) {
    let Some(first) = edges.first() else { return };
    if view.execution.is_cancelled() {
        return;
    }
    let centre = edges.iter().map(crossing).sum::<DVec3>() / edges.len() as f64;
    let pair = first.pair;
    let direction: DVec3 =
        edges.iter().map(|e| DVec3::AXES[usize::from(e.axis)] * if e.rising { 1.0 } else { -1.0 }).sum();
    let corner = DVec3::new(
        f64::from(first.block[1]) * BLOCK as f64,
        f64::from(first.block[0]) * BLOCK as f64,
        (block_z * BLOCK) as f64,
    );
    let from_corner = view.units.of(centre - corner);
    let thin = thin_face(view, centre, pair, direction, seen);
    // The mouth of a gap looks like a notch, but is no edge.
    let unclear = matches!(thin, Some(ThinFace::Unclear));
    let fitted = match thin {
        Some(ThinFace::Sheet(sheet)) => Some((*sheet, true)),
        Some(ThinFace::Ball(ball, first_inside)) => {
            let kept = KeptBall::new(&ball, from_corner, first_inside);
            out.sheets.push((first.block, pair, Shape::Ball(kept)));
            return;
        }
        Some(ThinFace::Unclear) | None => fit_around(view, centre, pair, direction, seen),
    };
    let fitted = fitted.filter(|(sheet, _)| view.units.voxel(sheet.point(0.0, 0.0)).length() < FARTHEST);
    let Some((sheet, sure)) = fitted else {
        out.sheets.push((first.block, pair, Shape::Rough));
        if !unclear {
            out.rough.push(Rough { pair, at: centre, fitted: false });
        }
        return;
    };
    if !sure {
        // What streaks may explain an edge may, too.
        out.rough.push(Rough { pair, at: centre, fitted: true });
    }
    let at = sheet.point(0.0, 0.0);
    out.sheets.push((first.block, pair, Shape::Sheet(Kept::new(&sheet, from_corner))));
    out.flats.push(Flat {
        pair,
        at: centre + view.units.voxel(at),
        normal: sheet.normal_at(0.0, 0.0),
        sigma: sheet.sigma(at),
        curvature: sheet.curvature(),
        form: sheet.form(),
        form_sigma: sheet.fit.covariance[(3, 3)].max(sheet.fit.covariance[(5, 5)]).sqrt(),
    });
}

/// Fits a sheet through about `centre`; `None` if the grey values there are not those of one smooth sheet. And whether noise alone
/// explains them.
fn fit_around(
    view: &View<'_>,
    centre: DVec3,
    pair: [MaterialId; 2],
    direction: DVec3,
    seen: &mut Vec<Seen>,
) -> Option<(Sheet, bool)> {
    let radius = RADIUS.max(LEAST_VOXELS / view.units.mean_voxels);
    view.ball(centre, radius, seen);
    let own = |s: &Seen| !s.uncertain && pair.contains(&s.label);
    let used = seen.iter().filter(|s| own(s));
    let count = used.clone().count();
    if count < FEWEST {
        return None;
    }
    let mean = used.clone().map(|s| s.sample.grey).sum::<f64>() / count as f64;
    let middle = used.clone().map(|s| s.sample.at).sum::<DVec3>() / count as f64;
    let moment = used.map(|s| (s.sample.at - middle) * (s.sample.grey - mean)).sum::<DVec3>();
    let normal = moment.try_normalize()?;
    if normal.dot(direction) < 0.0 {
        return None;
    }
    let wrong: Vec<DVec3> = seen
        .iter()
        .filter(|s| {
            let w = normal.dot(s.sample.at);
            !pair.contains(&s.label)
                || (s.label == pair[0] && w > WRONG)
                || (s.label == pair[1] && w < -WRONG)
        })
        .map(|s| s.sample.at)
        .collect();
    let clean =
        |s: &&Seen| own(s) && wrong.iter().all(|w| w.distance_squared(s.sample.at) > TAINTED * TAINTED);
    let samples: Vec<Sample> = seen.iter().filter(clean).map(|s| s.sample).collect();
    if samples.len() < FEWEST {
        return None;
    }
    let levels: [LevelPrior; 2] = pair.map(|m| view.level(m, centre));
    let contrast = (levels[1].mean - levels[0].mean).abs();
    let levels = levels.map(|l| LevelPrior { sigma: l.sigma.hypot(LEVEL * contrast), ..l });
    let reading = view.reading(&pair, MODEL);
    let sheet = fit_sheet(&samples, DVec3::ZERO, normal, levels, reading)?;
    let explained = |slack| explains(sheet.fit.chi2, sheet.fit.strain, samples.len(), slack);
    let taken = explained(reading.slack) && sheet.curvature() < MOST_CURVED;
    let sure = explained(1.0);
    taken.then_some((sheet, sure))
}
