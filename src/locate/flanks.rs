//! Patches near a curve, as places on the flanks of its wedge.

use glam::DVec3;
use rayon::prelude::*;

use super::patches::Flat;
use super::view::View;
use super::wedge::{Flank, Wedge};
use crate::grid::MaterialId;

/// Patches are taken from so far from the curve on, blur units: nearer they see the third material.
const NEAREST: f64 = 3.2;
/// And no farther than this, or than a wedge's curvature is good for, where its own window is explained.
pub(super) const FARTHEST: f64 = 6.5;
/// Farthest along the curve.
const ALONG: f64 = 3.0;
/// How far from the sheet as it stands a patch may lie, in blur units per unit of distance from the curve.
const OFF: f64 = 0.25;
/// Least cosine of its normal to the sheet's.
const AGREE: f64 = 0.9;
/// Neighbouring patches share grey values: each counts as this much less certain.
const SHARED: f64 = 2.0;
/// What a patch is off by beside noise, blur units.
const MODEL: f64 = 0.004;

/// Patches, to be found by place.
#[derive(Debug, Default)]
pub(super) struct FlatIndex {
    /// Sorted by box.
    flats: Vec<Flat>,
    boxes: Vec<[i32; 3]>,
    /// The first row of boxes, as z and y; how many rows there are along y; and where each begins.
    low: [i32; 2],
    height: usize,
    rows: Vec<u32>,
}

/// Edge of a box, voxels.
const SIDE: f64 = 6.0;

fn box_of(at: DVec3) -> [i32; 3] {
    [at.z, at.y, at.x].map(|c| (c / SIDE).floor() as i32)
}

impl FlatIndex {
    /// Of these patches.
    #[must_use]
    pub(super) fn new(mut flats: Vec<Flat>) -> Self {
        // Stable: the order within a box is that of the passes.
        flats.par_sort_by_key(|flat| box_of(flat.at));
        let boxes: Vec<[i32; 3]> = flats.iter().map(|flat| box_of(flat.at)).collect();
        let ends = |a: usize| {
            let all = || boxes.iter().map(|b| b[a]);
            all().min().zip(all().max()).map_or([0; 2], |(low, high)| [low, high + 1])
        };
        let [z, y] = [ends(0), ends(1)];
        let height = (y[1] - y[0]) as usize;
        let starts = (z[0]..z[1]).flat_map(|z| (y[0]..y[1]).map(move |y| [z, y]));
        let mut next = 0;
        let mut rows: Vec<u32> = Vec::new();
        for row in starts {
            next += boxes[next..].iter().take_while(|b| [b[0], b[1]] < row).count();
            rows.push(next as u32);
        }
        rows.push(boxes.len() as u32);
        Self { flats, boxes, low: [z[0], y[0]], height, rows }
    }

    /// Whether no patches are known.
    pub(super) fn is_empty(&self) -> bool {
        self.flats.is_empty()
    }

    /// The patches of a row of boxes between two along x.
    fn in_row(&self, [z, y]: [i32; 2], x: [i32; 2]) -> &[Flat] {
        let [z, y] = [z - self.low[0], y - self.low[1]].map(|c| usize::try_from(c).unwrap_or(usize::MAX));
        let row = z.checked_mul(self.height).map_or(usize::MAX, |row| row.saturating_add(y));
        let (true, Some(&[first, end])) = (y < self.height, self.rows.get(row..row.saturating_add(2))) else {
            return &[];
        };
        let (first, end) = (first as usize, end as usize);
        let boxes = &self.boxes[first..end];
        let [low, high] = [boxes.partition_point(|b| b[2] < x[0]), boxes.partition_point(|b| b[2] <= x[1])];
        &self.flats[first + low..first + high]
    }

    /// The patches within `radius` voxels along each axis, in a fixed order.
    pub(super) fn near(&self, at: DVec3, radius: f64) -> impl Iterator<Item = &Flat> {
        let (low, high) = (box_of(at - radius), box_of(at + radius));
        (low[0]..=high[0])
            .flat_map(move |z| (low[1]..=high[1]).map(move |y| [z, y]))
            .flat_map(move |row| self.in_row(row, [low[2], high[2]]))
            .filter(move |f| (f.at - at).abs().max_element() <= radius)
    }
}

/// Curvatures are taken over with at least this standard deviation: they may change towards the curve.
const BEND: f64 = 0.02;

/// The places that patches give on the sheets of a wedge about `middle` up to `farthest` from its curve, and the sheets' curvatures across the
/// curve with standard deviations.
pub(super) fn flanks_of<const R: usize, const N: usize>(
    view: &View<'_>,
    flats: &FlatIndex,
    middle: DVec3,
    wedge: &Wedge<R, N>,
    materials: &[MaterialId],
    farthest: f64,
    out: &mut Vec<Flank>,
) -> [Option<(f64, f64)>; R] {
    out.clear();
    let rays = wedge.rays(0.0);
    // Weighted sums of curvature, of weights.
    let mut bends = [[0.0f64; 2]; R];
    let reach = view.units.voxel(DVec3::splat(farthest + 1.0)).max_element();
    for flat in flats.near(middle + view.units.voxel(wedge.origin), reach) {
        let at = view.units.of(flat.at - middle);
        let section = wedge.section(at);
        if !(NEAREST..=farthest).contains(&section.r.length()) || section.z.abs() > ALONG {
            continue;
        }
        for i in 0..R {
            let (before, after) = (materials[(i + R - 1) % R], materials[i]);
            let rising = before < after;
            let pair = if rising { [before, after] } else { [after, before] };
            if pair != flat.pair {
                continue;
            }
            let (d, c, normal) = wedge.sheet_of(i, section);
            let agrees = normal.dot(flat.normal) * if rising { 1.0 } else { -1.0 };
            // A sheet that turns farther than this over its length is no parabola any more.
            let bent = flat.curvature * c > 0.9;
            if c > NEAREST * 0.8 && d.abs() < OFF * c && agrees > AGREE && !bent {
                out.push(Flank { ray: i, at, sigma: (SHARED * flat.sigma).hypot(MODEL) });
                let across = rays[i].dot(flat.form * rays[i]) * if rising { 1.0 } else { -1.0 };
                let weight = (SHARED * flat.form_sigma).powi(-2);
                bends[i][0] += weight * across;
                bends[i][1] += weight;
            }
        }
    }
    bends.map(|[sum, weight]| (weight > 0.0).then(|| (sum / weight, weight.powf(-0.5).hypot(BEND))))
}
