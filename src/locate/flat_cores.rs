//! Labels of parts that are a little too thin for the published classification.
//!
//! That takes a voxel for certain if a ball of R = 2.5 sigma around it is of one class, so parts under 2R (5 sigma, 6 voxels at the
//! usual blur) come out in pieces, as what lies between the materials beside them. The ball is so large because a blurred
//! interface between a dark and a bright material passes the levels of those between them. But it passes them at
//! full slope, and in the middle of a part of four sigma or more the grey value hardly changes. So a smaller ball is enough where
//! grey values are *flat*:
//!
//! 1. A *flat core* is a voxel around which all within [`BALL`] units are of one class (by the thresholds between neighbouring
//!    levels), and at which the gradient is below [`FLAT`] of that with which interfaces pass this level. The lightest
//!    and the densest material lie between no others, so nothing but they reaches their levels: their cores need no flatness.
//! 2. The voxels of its ball are of its material, for certain; and so are specks of others that are left beside.
//!
//! Beyond the ball nothing is said: beside a junction what is of the class of the third material is no longer that.
//! Guaranteed: all is decided by what is within [`reach`] of a voxel. Not guaranteed: parts under some four sigma, for which `thin`
//! has models.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::frame::BlurUnits;
use super::gauss::{exact_density, quantile};
use super::ridges::grey_at;
use super::specks;
use super::thin::Relabelled;
use super::view::{Scan, View};
use crate::classify::Ball;
use crate::grid::MaterialId;

/// Radius of the ball around a flat core, blur units.
const BALL: f64 = 1.5;
/// Gradient at a flat core, as a share of that of an interface which passes its level.
const FLAT: f64 = 0.4;

/// The ball around a flat core.
fn ball_of(units: BlurUnits) -> Ball {
    Ball::new(units.voxel(DVec3::splat(BALL)).to_array())
}

/// Slices that this reads beyond those that it decides.
#[must_use]
pub fn reach(units: BlurUnits) -> usize {
    // From a voxel to a core whose ball it is in, and from there to what the ball and the gradient see.
    2 * ball_of(units).reach()[2] + 1 + 2 * specks::MOST
}

/// The smallest gradient (per blur unit) with which a blurred interface between a lighter and a denser material passes the level
/// of each material; infinite where there is none.
fn passing(scan: &Scan) -> Vec<f64> {
    let means = &scan.means;
    let of = |m: usize| {
        let pairs = means[..m].iter().flat_map(|a| means[m + 1..].iter().map(move |b| (a, b)));
        pairs.fold(f64::INFINITY, |least, (a, b)| {
            let slope = exact_density(quantile((means[m] - a) / (b - a)));
            least.min((b - a) * slope)
        })
    };
    (0..means.len()).map(of).collect()
}

/// The voxels of the slices `core` that are of parts found so, and are not labelled so; ascending.
#[must_use]
pub fn find_flat_cores(view: &View<'_>, core: Range<usize>) -> Vec<Relabelled> {
    let (size, held) = (view.slab.size(), view.slab.slices());
    let ball = ball_of(view.units);
    let far = ball.reach()[2];
    let ball: Vec<[isize; 3]> = ball.offsets().collect();
    let steepest: Vec<f64> = passing(view.scan).into_iter().map(|g| FLAT * g).collect();
    let class = |voxel: [usize; 3]| view.scan.class(view.slab.grey(voxel));
    let is_unlike = |voxel: [usize; 3], m: MaterialId| view.is_uncertain(voxel) || view.label(voxel) != m;
    let moved = |voxel: [usize; 3], by: &[isize; 3]| -> Option<[usize; 3]> {
        let at: [usize; 3] = std::array::from_fn(|a| voxel[a].wrapping_add_signed(by[a]));
        ((0..3).all(|a| at[a] < size[a]) && held.contains(&at[2])).then_some(at)
    };
    let slope = |voxel: [usize; 3]| {
        let along = |a: usize| {
            let grey = |by: isize| {
                let mut step = [0; 3];
                step[a] = by;
                grey_at(view.slab, voxel, step)
            };
            Some((grey(1)? - grey(-1)?) / (2.0 * view.units.per_voxel[a]))
        };
        Some(DVec3::new(along(0)?, along(1)?, along(2)?).length())
    };
    let is_core = |voxel: [usize; 3], m: MaterialId| {
        let steepest = steepest.get(usize::from(m.0)).copied().unwrap_or(0.0);
        slope(voxel).is_some_and(|slope| slope < steepest)
            && ball.iter().all(|by| moved(voxel, by).is_some_and(|at| class(at) == m))
    };
    let around = |by: usize| core.start.saturating_sub(by).max(held.start)..(core.end + by).min(held.end);
    // What is a speck is told by what is around it.
    let (wider, slices) = (around(2 * specks::MOST), around(far + 2 * specks::MOST));
    let rows = slices.into_par_iter().flat_map_iter(|z| (0..size[1]).map(move |y| [y, z]));
    let mut found: Vec<Relabelled> = rows
        .flat_map_iter(|[y, z]| {
            let cores = (0..size[0]).filter_map(move |x| {
                let (voxel, m) = ([x, y, z], class([x, y, z]));
                (is_unlike(voxel, m) && is_core(voxel, m)).then_some((voxel, m))
            });
            let own =
                cores.flat_map(|(voxel, m)| ball.iter().filter_map(move |by| Some((moved(voxel, by)?, m))));
            let own = own.filter(|&(at, m)| wider.contains(&at[2]) && is_unlike(at, m));
            own.map(|([x, y, z], material)| Relabelled { voxel: [z, y, x].map(|c| c as u32), material })
                .collect::<Vec<_>>()
        })
        .collect();
    if found.is_empty() {
        return found;
    }
    let mut labels = view.labels.clone();
    let mut voxels = Vec::with_capacity(found.len());
    for Relabelled { voxel: [z, y, x], material } in &found {
        let voxel = [*x, *y, *z].map(|c| c as usize + 1);
        labels.set(voxel, *material);
        voxels.push(voxel);
    }
    for (part, material) in specks::specks(&labels, &voxels) {
        let unpadded = part.into_iter().map(|[x, y, z]| [z, y, x].map(|c| c as u32 - 1));
        found.extend(unpadded.map(|voxel| Relabelled { voxel, material }));
    }
    found.retain(|r| core.contains(&(r.voxel[0] as usize)));
    // A speck that a ball says to be one is what is around it.
    found.reverse();
    found.par_sort_by_key(|r| r.voxel);
    found.dedup_by_key(|r| r.voxel);
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classify::{BitPlanes, LabelVolume};
    use crate::execution::Execution;
    use crate::locate::fixtures::distribution;
    use crate::material::{Levels, MaterialTable};
    use crate::volume::Slab;

    const SIZE: [usize; 3] = [32, 14, 14];
    const SIGMA: f64 = 1.2;
    const MEANS: [f64; 3] = [10.0, 30.0, 110.0];

    /// Layers across x, blurred, labelled without the one in the middle; what is found of it.
    fn found(layers: [(f64, usize); 2]) -> Vec<Relabelled> {
        let [(first, left), (second, right)] = layers;
        let grey = |x: f64| {
            let share = |at: f64| distribution((x - at) / SIGMA);
            MEANS[0] + (MEANS[left] - MEANS[0]) * share(first) + (MEANS[right] - MEANS[left]) * share(second)
        };
        let all = || (0..SIZE.iter().product::<usize>()).map(|i| (i % SIZE[0]) as f64);
        let greys: Vec<f32> = all().map(|x| grey(x) as f32).collect();
        let mut labels: Vec<u8> = all().map(|x| if x < 0.5 * (first + second) { 0 } else { 2 }).collect();
        // All three labels must be there to be known by their numbers.
        labels[0] = 1;
        let (labels, _) = LabelVolume::from_labels(&labels, SIZE).unwrap();
        let uncertain = BitPlanes::window(SIZE, 1, labels.codes().slices());
        let [air, aluminium, iron] = MEANS;
        let table = MaterialTable::new([("air", air), ("aluminium", aluminium), ("iron", iron)]).unwrap();
        let scan = Scan {
            units: BlurUnits::new([SIGMA; 3]),
            is_blur_known: true,
            levels: Levels::constant(&table),
            means: MEANS.to_vec(),
            contrast: 20.0,
            is_thin: vec![false; 3],
            thresholds: vec![20.0, 70.0],
            noise: vec![0.2; 3],
            misfits: Vec::new(),
            clip: [f64::NEG_INFINITY, f64::INFINITY],
            inflation: 1.0,
        };
        let slab = Slab::whole(&greys, SIZE);
        find_flat_cores(&scan.view(&slab, &labels, &uncertain, &Execution::default()), 4..10)
    }

    #[test]
    fn a_wall_of_four_sigma_is_found_between_a_lighter_and_a_denser_material() {
        let found = found([(13.0, 1), (18.0, 2)]);
        assert!(found.iter().all(|r| r.material == MaterialId(1) && (13..=18).contains(&r.voxel[2])));
        // All of its inner voxels that are far enough from the volume's border, in the slices asked for alone.
        let inner = found.iter().filter(|r| (14..=16).contains(&r.voxel[2])).count();
        assert!(inner >= 3 * 8 * 6, "{inner}");
        assert!(found.iter().all(|r| (4..10).contains(&r.voxel[0])));
    }

    #[test]
    fn a_blurred_interface_is_no_wall() {
        assert_eq!(found([(16.0, 2), (16.0, 2)]), []);
        // Nor is one that passes the level of the material between slowly.
        assert_eq!(found([(15.0, 1), (17.0, 2)]), []);
    }
}
