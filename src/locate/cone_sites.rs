//! Points in which four materials meet: where junction curves of all four triples run to one point, four cones are
//! fitted to the grey values around it.
//!
//! The start are the curves' fits: each is a ray. Or, where patches show three planes through a line and a fourth
//! across it, the line and those in which they meet the fourth: sectors on a plate, of which two may be of one
//! material (one of them air). What three planes explain is `corner_sites`'s.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::by_box::ByBox;
use super::cone::{Cone, ConeFit, ConePrior};
use super::corner::Corner;
use super::corner_planes::{Plane, planes_about};
use super::corner_site::{CornerSite, Shape};
use super::corner_sites::{CELL, FULL, LEVEL, MODEL, REACH, SIGMA, STILL, UNSURE, thinned};
use super::flanks::FlatIndex;
use super::frame::BlurUnits;
use super::sheet::{LevelPrior, Sample};
use super::site::{Model, Site};
use super::view::{Seen, View};
use super::wedge::is_explained;
use crate::grid::MaterialId;

/// The apex may be so far from where its curves or planes meet, blur units.
const FARTHEST: f64 = 2.0;
/// Fits of curves are taken within this distance of each other, blur units.
const AROUND: f64 = 11.0;
/// Their lines pass the point within this distance, and it lies so far along them.
const MISS: f64 = 1.5;
const ALONG: Range<f64> = 1.0..9.0;
/// Iterations of a fit.
const ITERATIONS: usize = 30;

/// Where four curves meet.
struct Start {
    cell: [i32; 3],
    /// The place, voxels.
    at: DVec3,
    /// Materials; ray m runs between those other than m.
    materials: [MaterialId; 4],
    rays: [DVec3; 4],
    /// Sum of distances of the lines from the place.
    miss: f64,
}

/// The materials of a junction curve, ascending.
fn triple(site: &Site) -> Option<[MaterialId; 3]> {
    let Model::Junction(_) = site.model else { return None };
    let mut out = site.materials;
    out.sort_unstable();
    Some(out)
}

/// Fits points of four materials from planes about `places` (of [`junctions_about`](super::corner_sites::junctions_about)) and
/// from fits of junction curves; those whose box begins in the slices `core`.
#[must_use]
pub(super) fn cone_sites(
    view: &View<'_>,
    flats: &FlatIndex,
    places: &[DVec3],
    junctions: &[Site],
    core: &Range<usize>,
) -> Vec<Site> {
    let reach = |units: f64| view.units.voxel(DVec3::splat(units)).z + CELL;
    let within = |reach: f64| (core.start as f64 - reach).max(0.0)..core.end as f64 + reach;
    let places = thinned(places.to_vec());
    let mut starts: Vec<Start> =
        places.par_iter().flat_map_iter(|place| plates(view, flats, *place)).collect();
    let mut boxes = ByBox::new(view.units.voxel(DVec3::splat(AROUND)).max_element());
    junctions.iter().for_each(|site| boxes.insert((), site.at, site));
    let near = |site: &Site| -> Vec<&Site> {
        let mut near: Vec<&Site> = boxes.near((), site.at).collect();
        near.retain(|other| view.units.of(other.at - site.at).length() < AROUND);
        near.sort_by(|a, b| {
            let key = |s: &Site| [s.at.distance_squared(site.at), s.at.z, s.at.y, s.at.x];
            order(&key(a), &key(b))
        });
        near
    };
    if view.scan.noise.len() > 3 {
        let slices = within(reach(AROUND));
        let own: Vec<&Site> = junctions.iter().filter(|site| slices.contains(&site.at.z)).collect();
        let found = own.par_iter().filter_map(|site| start(view.units, site, &near(site)));
        starts.extend(found.collect::<Vec<_>>());
    }
    starts.retain(|s| usize::try_from(s.cell[2] * CELL as i32).is_ok_and(|z| core.contains(&z)));
    starts.sort_by(|a, b| {
        let key = |s: &Start| [s.miss, s.at.z, s.at.y, s.at.x];
        a.cell.cmp(&b.cell).then_with(|| order(&key(a), &key(b)))
    });
    starts.dedup_by_key(|s| s.cell);
    starts.par_iter().filter_map(|start| fit(view, start)).collect()
}

fn order(a: &[f64; 4], b: &[f64; 4]) -> Ordering {
    a.iter().zip(b).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne()).unwrap_or(Ordering::Equal)
}

/// Where the curves around a site meet, if they are of four materials; `near` in order of distance.
fn start(units: BlurUnits, site: &Site, near: &[&Site]) -> Option<Start> {
    let own = triple(site)?;
    let fourth = near.iter().filter_map(|s| triple(s)?.into_iter().find(|m| !own.contains(m))).next()?;
    let mut materials = [own[0], own[1], own[2], fourth];
    materials.sort_unstable();
    let without = |m: usize| {
        let wanted: Vec<MaterialId> = (0..4).filter(|&k| k != m).map(|k| materials[k]).collect();
        near.iter().find(|s| triple(s).is_some_and(|t| t[..] == wanted[..])).copied()
    };
    let sites = [without(0)?, without(1)?, without(2)?, without(3)?];
    let lines = sites.map(|s| {
        let Model::Junction(fit) = &s.model else { return (DVec3::ZERO, DVec3::Z) };
        (units.of(s.at - site.at), fit.wedge.direction(0.0))
    });
    let apex = Cone::meet(&lines)?;
    let mut miss = 0.0;
    let mut rays = [DVec3::ZERO; 4];
    for (ray, (point, along)) in rays.iter_mut().zip(lines) {
        let from = point - apex;
        let off = from.reject_from_normalized(along).length();
        let ahead = from.dot(along);
        if off > MISS || !ALONG.contains(&ahead.abs()) {
            return None;
        }
        *ray = along * ahead.signum();
        miss += off;
    }
    let at = site.at + units.voxel(apex);
    let cell = at.to_array().map(|c| (c / CELL).floor() as i32);
    Some(Start { cell, at, materials, rays, miss })
}

/// Cosine of planes through a line at most, and of the line to the plane's normal across it at least.
const APART: f64 = 0.9;
const ACROSS: f64 = 0.5;
/// Determinant of the normals of planes through a line at most, and how far the third may lie from it, blur units.
const THROUGH: f64 = 0.15;
const ASIDE: f64 = 0.7;

/// Three planes through a line and a fourth across it around a place.
fn plates(view: &View<'_>, flats: &FlatIndex, place: DVec3) -> Vec<Start> {
    let planes = planes_about(view, flats, place);
    let mut out = Vec::new();
    for i in 0..planes.len() {
        for j in 0..i {
            for k in 0..j {
                for t in (0..planes.len()).filter(|t| ![i, j, k].contains(t)) {
                    out.extend(plate(view, place, [i, j, k].map(|p| &planes[p]), &planes[t]));
                }
            }
        }
    }
    out
}

/// The sectors that three planes through a line make on a plate, about a place.
fn plate(view: &View<'_>, place: DVec3, three: [&Plane<'_>; 3], across: &Plane<'_>) -> Option<Start> {
    let n = three.map(|p| p.normal);
    let apart = (0..3).all(|i| n[i].dot(n[(i + 1) % 3]).abs() < APART);
    if !apart || n[0].dot(n[1].cross(n[2])).abs() > THROUGH {
        return None;
    }
    // The line, from the three pairs.
    let first = n[0].cross(n[1]);
    let pairs = [first, n[1].cross(n[2]), n[2].cross(n[0])];
    let line = pairs.iter().map(|p| *p * p.dot(first).signum()).sum::<DVec3>().try_normalize()?;
    if line.dot(across.normal).abs() < ACROSS {
        return None;
    }
    let of = |p: &Plane<'_>| (p.point(), p.normal);
    let meet = |i: usize, j: usize| Corner::meet(&[of(three[i]), of(three[j]), of(across)]);
    let apex = [meet(0, 1)?, meet(1, 2)?, meet(2, 0)?].iter().sum::<DVec3>() / 3.0;
    let off = |p: &Plane<'_>| p.normal.dot(apex - p.point()).abs();
    if apex.length() > REACH || three.iter().any(|p| off(p) > ASIDE) {
        return None;
    }
    // Towards where their patches are.
    let towards = |p: &Plane<'_>, along: DVec3| p.parts.iter().map(|q| along.dot(q.at - apex)).sum::<f64>();
    let down = line * three.iter().map(|p| towards(p, line)).sum::<f64>().signum();
    let mut rays = [down; 4];
    for (ray, p) in rays.iter_mut().zip(three) {
        let along = across.normal.cross(p.normal).try_normalize()?;
        *ray = along * towards(p, along).signum();
    }
    let cone = Cone { apex: DVec3::ZERO, rays, levels: [0.0; 4], log_sigma: 0.0 };
    if !cone.is_possible() {
        return None;
    }
    let at = place + view.units.voxel(apex);
    // What most voxels well inside each cone are.
    let mut seen: Vec<Seen> = Vec::new();
    view.ball(at, FULL, &mut seen);
    let mut votes: [BTreeMap<MaterialId, usize>; 4] = Default::default();
    for s in seen.iter().filter(|s| s.sample.at.length() > 0.5 * FULL) {
        *votes[cone.material(s.sample.at)].entry(s.label).or_default() += 1;
    }
    let most = |m: usize| votes[m].iter().max_by_key(|v| v.1).map(|v| *v.0);
    let materials = [most(0)?, most(1)?, most(2)?, most(3)?];
    let mut distinct = materials.to_vec();
    distinct.sort_unstable();
    distinct.dedup();
    if distinct.len() < 3 || distinct.contains(&MaterialId::OUTSIDE) {
        return None;
    }
    let cell = at.to_array().map(|c| (c / CELL).floor() as i32);
    Some(Start { cell, at, materials, rays, miss: apex.length() })
}

fn fit(view: &View<'_>, start: &Start) -> Option<Site> {
    if view.execution.is_cancelled() {
        return None;
    }
    let Start { materials, rays, .. } = *start;
    let mut middle = start.at;
    let levels: [LevelPrior; 4] = materials.map(|m| view.level(m, middle));
    let ends =
        levels.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], l| [a.min(l.mean), b.max(l.mean)]);
    let contrast = ends[1] - ends[0];
    let reading = view.reading(&materials, MODEL);
    let prior = ConePrior {
        levels: levels.map(|l| LevelPrior { mean: l.mean, sigma: l.sigma.hypot(LEVEL * contrast) }),
        noise: reading.noise,
        log_sigma: SIGMA,
    };
    let mut cone = Cone { apex: DVec3::ZERO, rays, levels: levels.map(|l| l.mean), log_sigma: 0.0 };
    let (mut seen, mut samples): (Vec<Seen>, Vec<Sample>) = (Vec::new(), Vec::new());
    let mut last: Option<ConeFit> = None;
    for _ in 0..3 {
        view.samples(middle, DVec3::ZERO, FULL, &mut seen, &mut samples);
        let fit = cone.fit(&samples, &prior, ITERATIONS)?;
        let moved = fit.cone.apex;
        if moved.length() > FARTHEST {
            return None;
        }
        let still = moved.length() < STILL;
        cone = fit.cone.clone();
        last = Some(fit);
        if still {
            break;
        }
        middle += view.units.voxel(moved);
        cone.apex = DVec3::ZERO;
        last = None;
    }
    let fit = last?;
    let accepted = fit.fit.converged
        && is_explained(fit.reduced(), fit.samples, &reading, contrast)
        && fit.apex_sigmas()[2] < UNSURE
        && fit.cone.log_sigma.abs() < 2.5 * SIGMA
        && view.units.of(middle - start.at).length() < 2.0 * FARTHEST;
    if !accepted {
        return None;
    }
    let at = middle + view.units.voxel(fit.cone.apex);
    let three = [materials[0], materials[1], materials[2]];
    let corner = CornerSite::new(Shape::Cones(Box::new(fit)), materials);
    Some(Site { middle, at, materials: three, model: Model::Corner(Box::new(corner)) })
}
