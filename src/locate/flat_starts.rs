//! Where three interfaces meet by the patches around: a start for junctions that the labels do not tell.
//!
//! Beside a narrow wedge the published labels lose its tip, so junction cells lie up to nine voxels from the curve, and
//! fits from there end anywhere. But farther out each of the three interfaces is known alone. Two of their planes, those that cross
//! at the largest angle, meet in a line near the curve.

use glam::DVec3;

use super::flanks::FlatIndex;
use super::frame::basis;
use super::patches::Flat;
use super::view::View;
use crate::grid::MaterialId;

/// Patches are looked for within this distance of a seed, blur units.
const AROUND: f64 = 13.0;
/// The curve may lie this far from the seed, blur units.
pub(super) const FARTHEST: f64 = 9.0;
/// Least cosine between the normals of patches of one plane, and how far they may be off it, blur units and per unit of
/// distance.
const ALIKE: f64 = 0.95;
const OFF: [f64; 2] = [0.4, 0.05];
/// Planes that cross at less than this sine have no line in common.
const CROSSING: f64 = 0.25;
/// Patches must lie at least this far from the line to tell a ray, blur units.
const LEAST: f64 = 1.5;
/// Sectors are no narrower than this, radians.
const NARROWEST: f64 = 0.15;

/// A line on which three interfaces meet, in blur units from the seed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Meeting {
    /// A point of it.
    pub at: DVec3,
    /// Its direction.
    pub direction: DVec3,
    /// Where the interfaces of the pairs (0, 1), (0, 2), (1, 2) of the seed's materials lie, across the line.
    pub rays: [DVec3; 3],
}

/// A plane through patches: the mean of their places, the normal, and the places.
struct Plane {
    at: DVec3,
    normal: DVec3,
    places: Vec<DVec3>,
}

impl Plane {
    /// Where the patches lie as seen from a line on the plane, across it: for either side the direction and how many there are.
    fn sides(&self, at: DVec3, direction: DVec3) -> [(DVec3, usize); 2] {
        let across = direction.cross(self.normal).normalize_or_zero();
        [across, -across].map(|side| {
            let own = |place: &&DVec3| (**place - at).dot(side) >= LEAST;
            (side, self.places.iter().filter(own).count())
        })
    }
}

/// The line on which the interfaces of three materials meet, by the patches around `seed` (voxels).
pub(super) fn meeting(
    view: &View<'_>,
    flats: &FlatIndex,
    seed: DVec3,
    materials: [MaterialId; 3],
) -> Option<Meeting> {
    let reach = view.units.voxel(DVec3::splat(AROUND)).max_element();
    let near: Vec<(f64, DVec3, &Flat)> = flats
        .near(seed, reach)
        .map(|f| (view.units.of(f.at - seed), f))
        .map(|(at, f)| (at.length(), at, f))
        .filter(|(distance, ..)| *distance <= AROUND)
        .collect();
    let plane = |pair: [usize; 2]| {
        let pair = pair.map(|k| materials[k]);
        let own = || near.iter().filter(|(.., f)| f.pair == pair);
        let (_, first, flat) = own().min_by(|a, b| a.0.total_cmp(&b.0))?;
        let (mut normal, mut places) = (DVec3::ZERO, Vec::new());
        for (_, place, f) in own() {
            let apart = place.distance(*first);
            let off = flat.normal.dot(*place - *first).abs();
            if f.normal.dot(flat.normal) > ALIKE && off < OFF[0] + OFF[1] * apart {
                places.push(*place);
                normal += f.normal;
            }
        }
        let at = places.iter().sum::<DVec3>() / places.len() as f64;
        Some(Plane { at, normal: normal.try_normalize()?, places })
    };
    let planes = [plane([0, 1])?, plane([0, 2])?, plane([1, 2])?];
    let across = |i: usize, j: usize| planes[i].normal.cross(planes[j].normal);
    let [i, j] = [[0, 1], [0, 2], [1, 2]]
        .into_iter()
        .max_by(|a, b| across(a[0], a[1]).length().total_cmp(&across(b[0], b[1]).length()))?;
    let sine = across(i, j).length();
    if sine < CROSSING {
        return None;
    }
    let direction = across(i, j) / sine;
    // On both planes, nearest to the seed.
    let [a, b] = [&planes[i], &planes[j]];
    let (da, db, cos) = (a.normal.dot(a.at), b.normal.dot(b.at), a.normal.dot(b.normal));
    let det = sine * sine;
    let at = a.normal * ((da - cos * db) / det) + b.normal * ((db - cos * da) / det);
    if at.length() > FARTHEST {
        return None;
    }
    // An interface may have patches on both sides of the line: beside the tip of a narrow wedge labels name its neighbours, and patches
    // that are theirs by name go on along its faces. Those sides are the interfaces' that leave every sector room; of several the
    // one that most patches show.
    let sides = planes.each_ref().map(|plane| plane.sides(at, direction));
    let choices = (0..8usize).filter_map(|choice| {
        let chosen = [0, 1, 2].map(|k| sides[k][choice >> k & 1]);
        let [a, b, c] = chosen.map(|(ray, _)| ray);
        let nearest = a.angle_between(b).min(b.angle_between(c)).min(c.angle_between(a));
        let shown = chosen.iter().all(|(_, count)| *count > 0);
        let all = chosen.iter().map(|(_, count)| count).sum::<usize>();
        (shown && nearest > NARROWEST).then_some((all, [a, b, c]))
    });
    let (_, rays) =
        choices.fold(None, |best: Option<(usize, _)>, next| best.filter(|b| b.0 >= next.0).or(Some(next)))?;
    Some(Meeting { at, direction, rays })
}

/// Rays of the pairs (0, 1), (0, 2), (1, 2) of three materials in counter-clockwise order seen against `direction`, and the
/// material (0, 1, 2) of the sector after each; `None` if neighbouring pairs have none in common.
pub(super) fn ordered(direction: DVec3, rays: [DVec3; 3]) -> Option<([DVec3; 3], [usize; 3])> {
    let [e1, e2, _] = basis(direction);
    let mut sorted: Vec<(f64, DVec3, [usize; 2])> = rays
        .into_iter()
        .zip([[0, 1], [0, 2], [1, 2]])
        .map(|(ray, pair)| (f64::atan2(ray.dot(e2), ray.dot(e1)), ray, pair))
        .collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sectors = [0; 3];
    for i in 0..3 {
        let (here, next) = (sorted[i].2, sorted[(i + 1) % 3].2);
        sectors[i] = *here.iter().find(|k| next.contains(k))?;
    }
    Some(([sorted[0].1, sorted[1].1, sorted[2].1], sectors))
}
