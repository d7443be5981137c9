//! Patches near a curve, as places on the flanks of its wedge.

use glam::{DVec2, DVec3};

use super::patches::Flat;
use super::view::View;
use super::wedge::{Flank, Wedge};
use crate::grid::MaterialId;

/// Patches are taken from so far from the curve on, blur units: nearer they see the third material.
const NEAREST: f64 = 3.2;
/// And no farther than this, or than a wedge's curvature is good for.
const FARTHEST: f64 = 6.5;
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
#[derive(Debug)]
pub(super) struct FlatIndex<'a> {
    flats: &'a [Flat],
    /// Patches by box of `SIDE` voxels, sorted.
    boxes: Vec<([i32; 3], u32)>,
}

const SIDE: f64 = 6.0;

fn box_of(at: DVec3) -> [i32; 3] {
    [at.z, at.y, at.x].map(|c| (c / SIDE).floor() as i32)
}

impl<'a> FlatIndex<'a> {
    /// Of these patches.
    #[must_use]
    pub(super) fn new(flats: &'a [Flat]) -> Self {
        let mut boxes: Vec<_> = flats.iter().enumerate().map(|(i, f)| (box_of(f.at), i as u32)).collect();
        boxes.sort_unstable();
        Self { flats, boxes }
    }

    /// The patches within `radius` voxels along each axis, in a fixed order.
    pub(super) fn near(&self, at: DVec3, radius: f64) -> impl Iterator<Item = &'a Flat> {
        let (low, high) = (box_of(at - radius), box_of(at + radius));
        (low[0]..=high[0])
            .flat_map(move |z| (low[1]..=high[1]).map(move |y| [z, y]))
            .flat_map(move |[z, y]| {
                let first = self.boxes.partition_point(|b| b.0 < [z, y, low[2]]);
                self.boxes[first..].iter().take_while(move |b| b.0 <= [z, y, high[2]])
            })
            .map(|b| &self.flats[b.1 as usize])
            .filter(move |f| (f.at - at).abs().max_element() <= radius)
    }
}

/// Curvatures are taken over with at least this standard deviation: they may change towards the curve.
const BEND: f64 = 0.02;

/// The places that patches give on the sheets of a wedge about `middle`, and the sheets' curvatures across the
/// curve with standard deviations.
pub(super) fn flanks_of<const R: usize, const N: usize>(
    view: &View<'_>,
    flats: &FlatIndex<'_>,
    middle: DVec3,
    wedge: &Wedge<R, N>,
    materials: &[MaterialId],
    out: &mut Vec<Flank>,
) -> [Option<(f64, f64)>; R] {
    out.clear();
    let rays = wedge.rays(0.0);
    // Weighted sums of curvature, of weights.
    let mut bends = [[0.0f64; 2]; R];
    let reach = view.units.voxel(DVec3::splat(FARTHEST + 1.0)).max_element();
    for flat in flats.near(middle + view.units.voxel(wedge.origin), reach) {
        let at = view.units.of(flat.at - middle);
        let (r, z) = wedge.section(at);
        let distance: f64 = DVec2::length(r);
        if !(NEAREST..=FARTHEST).contains(&distance) || z.abs() > ALONG {
            continue;
        }
        for i in 0..R {
            let (before, after) = (materials[(i + R - 1) % R], materials[i]);
            let rising = before < after;
            let pair = if rising { [before, after] } else { [after, before] };
            if pair != flat.pair {
                continue;
            }
            let (d, c, normal) = wedge.sheet(i, at);
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
