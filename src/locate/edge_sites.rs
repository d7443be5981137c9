//! Sharp edges of one interface, rounded by blur: where they are looked for, and the wedge fits there.
//!
//! Seeds are blocks whose crossings are no smooth sheet ([`Rough`]), away from junctions. The start are the two
//! patches around whose normals differ most: their planes meet in a line near the seed. Then a wedge of two rays is
//! fitted as at junctions, with the patches around as places on its flanks.
//!
//! A fillet is no edge: the two planes would explain its flanks, but not the grey values between. So a fit must
//! explain these, too.

use std::cmp::Ordering;
use std::ops::Range;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::ball_model::fit_ball;
use super::by_box::ByBox;
use super::crossing_edges::differing_from;
use super::flanks::{self, FlatIndex, flanks_of};
use super::junction_fit::STILL;
use super::patches::{Flat, Rough};
use super::sheet::{LevelPrior, Reading, Sample};
use super::site::{Model, Site};
use super::view::{Seen, View};
use super::wedge::{BLURRED, EDGE, Flank, Prior, Section, Stage, Wedge, WedgeFit};
use crate::classify::{WORD, set_bits};
use crate::grid::MaterialId;

/// Patches are looked for within this distance of a seed, blur units.
const AROUND: f64 = 7.5;
/// Radius of the ball of a fit, blur units.
const FULL: f64 = 4.0;
/// No more patches than this are looked at, the nearest ones.
const NEAR: usize = 40;
/// Sheets that turn by less than this beyond their curvature make no edge, radians.
const LEAST_TURN: f64 = 0.4;
/// Its cosine, rounded up.
const LEAST_TURN_COS: f64 = 0.922;
/// Standard deviation of grey levels, as a share of the contrast, beside what the levels say.
const LEVEL: f64 = 0.02;
/// Standard deviation of the logarithm of sigma.
const SIGMA: f64 = 0.05;
/// Standard deviation of curvatures, per blur unit.
const CURVATURE: f64 = 0.06;
/// The models' own errors, as a share of the contrast.
const MODEL: f64 = 0.0007;
/// Largest standard deviation of the edge's place, blur units.
const UNSURE: f64 = 0.3;
/// A planar fit that leaves more than this share of the contrast will not be mended by curvature.
const HOPELESS: f64 = 0.06;
/// The edge may lie this far from its seed, blur units.
const FARTHEST: f64 = 3.5;

/// Edges that turn by more than this are no part of a rounding, radians.
const SHARP: f64 = 0.8;
/// Where all that clean interfaces miss a blurred step by is physics and not noise, sharp edges may leave so many times as much more.
const MISFIT: f64 = 4.0;

/// Fits the sharp edges at seeds; those whose box begins in the slices `core`.
#[must_use]
pub(super) fn edge_sites(
    view: &View<'_>,
    flats: &FlatIndex,
    seeds: &[Rough],
    core: Range<usize>,
) -> Vec<Site> {
    let reach = view.units.voxel(DVec3::splat(FARTHEST)).z + 2.0 * CELL;
    let near = |seed: &&Rough| seed.at.z >= core.start as f64 - reach && seed.at.z <= core.end as f64 + reach;
    let seeds: Vec<&Rough> = seeds.iter().filter(near).collect();
    let mut starts: Vec<Start> = seeds.par_iter().filter_map(|seed| start(view, flats, seed)).collect();
    let onwards = onwards(view, &starts);
    starts.extend(onwards);
    starts.retain(|s| usize::try_from(s.cell[2] * CELL as i32).is_ok_and(|z| core.contains(&z)));
    // One for each box that the edge passes: the one whose seed is nearest to it; if there is none the next box's, gone on.
    starts.sort_by(|a, b| {
        (a.cell, a.seed.pair, a.is_onwards)
            .cmp(&(b.cell, b.seed.pair, b.is_onwards))
            .then(a.wedge.origin.length().total_cmp(&b.wedge.origin.length()))
            .then_with(|| {
                let [p, q] = [a, b].map(|s| s.seed.at.to_array());
                (0..3).map(|i| p[i].total_cmp(&q[i])).find(|o| o.is_ne()).unwrap_or(Ordering::Equal)
            })
    });
    starts.dedup_by_key(|s| (s.cell, s.seed.pair));
    starts.par_iter().filter_map(|start| fit(view, flats, start)).collect()
}

/// Edge of the boxes in which one fit is enough, voxels.
const CELL: f64 = 4.0;

/// Where a fit starts.
struct Start {
    /// The box of the point where it starts.
    cell: [i32; 3],
    seed: Rough,
    wedge: Wedge<2, EDGE>,
    materials: [MaterialId; 2],
    /// Whether it was found from the box before.
    is_onwards: bool,
}

impl Start {
    /// Where the edge should go on, one box farther: in much noise patches are accepted that lie across an edge, and no seed is
    /// left there.
    fn onwards(&self, view: &View<'_>, sense: f64) -> Self {
        let along = view.units.voxel(self.wedge.axes.z_axis);
        let at = self.seed.at + view.units.voxel(self.wedge.origin) + along * (sense * CELL / along.length());
        let mut wedge = self.wedge.clone();
        wedge.origin = DVec3::ZERO;
        Self { cell: cell_of(at), seed: Rough { at, ..self.seed }, wedge, is_onwards: true, ..*self }
    }
}

/// Where edges should go on from these starts, and none of them is near.
fn onwards(view: &View<'_>, starts: &[Start]) -> Vec<Start> {
    let mut places = ByBox::new(CELL);
    for start in starts {
        let at = start.seed.at + view.units.voxel(start.wedge.origin);
        places.insert(start.seed.pair, at, at);
    }
    let is_new = |start: &Start| {
        let at = start.seed.at;
        places.near(start.seed.pair, at).all(|other| other.distance(at) >= NEW * CELL)
    };
    starts.iter().flat_map(|s| [-1.0, 1.0].map(|sense| s.onwards(view, sense))).filter(is_new).collect()
}

/// Distance to the next start from which on a fit between is worth its while, boxes.
const NEW: f64 = 0.75;

/// The box of a place, voxels.
fn cell_of(at: DVec3) -> [i32; 3] {
    at.to_array().map(|c| (c / CELL).floor() as i32)
}

/// The two patches around a seed that make an edge: near, and of different directions.
fn faces<'a>(view: &View<'_>, flats: &'a FlatIndex, seed: &Rough) -> Option<[&'a Flat; 2]> {
    let reach = view.units.voxel(DVec3::splat(AROUND)).max_element();
    let mut near: Vec<(&Flat, f64)> = flats
        .near(seed.at, reach)
        .filter(|f| f.pair == seed.pair)
        .map(|f| (f, view.units.of(f.at - seed.at)))
        // The edge lies in both planes, and near the seed: one that is farther off is of another wall.
        .filter(|(f, at)| at.length() <= AROUND && f.normal.dot(*at).abs() <= FARTHEST)
        .map(|(f, at)| (f, at.length()))
        .collect();
    if near.len() > NEAR {
        near.select_nth_unstable_by(NEAR, |a, b| a.1.total_cmp(&b.1));
        near.truncate(NEAR);
    }
    // Near the seed, and the seed near both planes.
    let near: Vec<(&Flat, f64)> = near
        .into_iter()
        .map(|(f, d)| (f, d + 2.0 * f.normal.dot(view.units.of(seed.at - f.at)).abs()))
        .collect();
    let mut best: Option<(f64, [&Flat; 2])> = None;
    for (i, (a, da)) in near.iter().enumerate() {
        for (b, db) in &near[..i] {
            let cos = a.normal.dot(b.normal);
            let cost = da + db + 4.0 * cos;
            if !(-0.95..=LEAST_TURN_COS).contains(&cos) || best.is_some_and(|(c, _)| cost >= c) {
                continue;
            }
            // A curved face turns as well.
            let apart = view.units.of(a.at - b.at).length();
            let turned = 1.4 * a.curvature.max(b.curvature) * apart;
            if cos.clamp(-1.0, 1.0).acos() >= LEAST_TURN + turned {
                best = Some((cost, [a, b]));
            }
        }
    }
    best.map(|b| b.1)
}

/// Crossings this near to a seed (voxels) are rounded with the edge, those farther than the second are not its.
const ROUNDED: [f64; 2] = [2.0, 6.5];
/// The planes of a seed's own faces pass it nearer than this, blur units; others are of the wall's other side.
const PASSING: f64 = 2.0;
/// Fewest crossings that make a face.
const FEWEST: usize = 8;

/// Two faces where there are no patches, as between edges that are near to each other: the crossings around,
/// parted by the directions of their gradients.
fn faces_of_crossings(view: &View<'_>, seed: &Rough) -> Option<[Flat; 2]> {
    let (size, slices) = (view.slab.size(), view.slab.slices());
    let low: [usize; 3] = std::array::from_fn(|a| (seed.at[a] - ROUNDED[1]).max(1.0) as usize);
    let end: [usize; 3] =
        std::array::from_fn(|a| ((seed.at[a] + ROUNDED[1]) as usize + 1).min(size[a].saturating_sub(2)));
    let middle = seed.pair.map(|m| view.mean(m, seed.at)).iter().sum::<f64>() / 2.0;
    let grey = |v: [usize; 3]| f64::from(view.slab.grey(v));
    let gradient = |v: [usize; 3]| {
        DVec3::from(std::array::from_fn(|a| {
            let (mut up, mut down) = (v, v);
            up[a] += 1;
            down[a] -= 1;
            (grey(up) - grey(down)) / view.units.per_voxel[a]
        }))
    };
    let mut found: Vec<(DVec3, DVec3)> = Vec::new();
    // Of the window's rows, no wider than a word.
    let within = (1u64 << (end[0].saturating_sub(low[0])).min(WORD - 1)) - 1;
    for z in low[2].max(slices.start + 1)..end[2].min(slices.end.saturating_sub(2)) {
        for y in low[1]..end[1] {
            let row = [low[0], y, z];
            let differs = [0, 1, 2].map(|axis| within & differing_from(view.labels, row, axis));
            for x in set_bits(differs[0] | differs[1] | differs[2]).map(|k| low[0] + k) {
                let from = [x, y, z];
                let here = view.label(from);
                for axis in 0..3 {
                    let mut to = from;
                    to[axis] += 1;
                    let there = view.label(to);
                    if here == there || !seed.pair.contains(&here) || !seed.pair.contains(&there) {
                        continue;
                    }
                    let (f, g) = (grey(from) - middle, grey(to) - middle);
                    if (f < 0.0) == (g < 0.0) {
                        continue;
                    }
                    let t = f / (f - g);
                    let at = DVec3::new(x as f64, y as f64, z as f64) + DVec3::AXES[axis] * t;
                    let distance = at.distance(seed.at);
                    let normal = gradient(from) * (1.0 - t) + gradient(to) * t;
                    if (ROUNDED[0]..ROUNDED[1]).contains(&distance)
                        && let Some(normal) = normal.try_normalize()
                        && normal.dot(view.units.of(at - seed.at)).abs() < PASSING
                    {
                        found.push((at, normal));
                    }
                }
            }
        }
    }
    // The two directions farthest apart, then means of the crossings nearer to the one or the other.
    let mean = found.iter().map(|f| f.1).sum::<DVec3>().try_normalize()?;
    let far = |from: DVec3| found.iter().map(|f| f.1).min_by(|a, b| a.dot(from).total_cmp(&b.dot(from)));
    let mut centres = [far(mean)?, DVec3::ZERO];
    centres[1] = far(centres[0])?;
    let mut faces = [None; 2];
    for _ in 0..4 {
        for k in 0..2 {
            let own = found.iter().filter(|f| {
                let d = centres.map(|c| c.dot(f.1));
                d[k] > d[1 - k] && d[k] > 0.9
            });
            let count = own.clone().count();
            if count < FEWEST {
                return None;
            }
            let at = own.clone().map(|f| f.0).sum::<DVec3>() / count as f64;
            let normal = own.map(|f| f.1).sum::<DVec3>().try_normalize()?;
            faces[k] = Some((at, normal));
        }
        centres = [faces[0]?.1, faces[1]?.1];
    }
    if centres[0].dot(centres[1]).acos() < LEAST_TURN {
        return None;
    }
    let flat = |(at, normal): (DVec3, DVec3)| Flat {
        pair: seed.pair,
        at,
        normal,
        sigma: 1.0,
        curvature: 0.0,
        form: DMat3::ZERO,
        form_sigma: 1.0,
    };
    Some([flat(faces[0]?), flat(faces[1]?)])
}

/// The wedge that two faces make about a seed: patches, or where those make none crossings around.
fn start(view: &View<'_>, flats: &FlatIndex, seed: &Rough) -> Option<Start> {
    let by_patches = faces(view, flats, seed).and_then(|faces| start_of(view, seed, faces.map(|f| *f)));
    // Where a patch was accepted, those around tell if there is an edge.
    let alone = || if seed.fitted { None } else { faces_of_crossings(view, seed) };
    by_patches.or_else(|| start_of(view, seed, alone()?))
}

/// The wedge that these faces make.
fn start_of(view: &View<'_>, seed: &Rough, faces: [Flat; 2]) -> Option<Start> {
    let [a, b] = faces;
    let direction = a.normal.cross(b.normal).try_normalize()?;
    let at = faces.map(|f| view.units.of(f.at - seed.at));
    // Where both planes meet, nearest to the seed.
    let (da, db, cos) = (a.normal.dot(at[0]), b.normal.dot(at[1]), a.normal.dot(b.normal));
    let det = 1.0 - cos * cos;
    let apex = a.normal * ((da - cos * db) / det) + b.normal * ((db - cos * da) / det);
    if apex.length() > FARTHEST {
        return None;
    }
    let mut rays = Vec::with_capacity(2);
    for (f, at) in faces.iter().zip(at) {
        let along = f.normal.cross(direction).normalize();
        let towards = (at - apex).dot(along);
        if towards.abs() < 0.5 {
            return None;
        }
        let ray = along * towards.signum();
        // On the left of the ray lies the higher material if the normal points there.
        let higher_left = f.normal.dot(direction.cross(ray)) > 0.0;
        rays.push((ray, higher_left));
    }
    // One ray has the higher material on its left, the other on its right, or there is no such edge.
    if rays[0].1 == rays[1].1 {
        return None;
    }
    if !rays[0].1 {
        rays.swap(0, 1);
    }
    // Counter-clockwise of the first ray lies the higher material.
    let materials = [seed.pair[1], seed.pair[0]];
    let levels = materials.map(|m| view.level(m, seed.at).mean);
    let wedge = Wedge::new(apex, direction, [rays[0].0, rays[1].0], levels);
    let cell = cell_of(seed.at + view.units.voxel(apex));
    Some(Start { cell, seed: *seed, wedge, materials, is_onwards: false })
}

/// Fewest voxels of a fit.
const FEWEST_VOXELS: usize = 60;
/// So many labels may contradict.
const MOST_WRONG: usize = 2;

fn fit(view: &View<'_>, flats: &FlatIndex, start: &Start) -> Option<Site> {
    if view.execution.is_cancelled() {
        return None;
    }
    let Start { seed, wedge, materials, .. } = start;
    let (mut wedge, materials) = (wedge.clone(), *materials);
    let levels: [LevelPrior; 2] = materials.map(|m| view.level(m, seed.at));
    let contrast = (levels[0].mean - levels[1].mean).abs();
    let reading = view.reading(&materials, MODEL);
    let prior = Prior {
        levels: levels.map(|l| LevelPrior { mean: l.mean, sigma: l.sigma.hypot(LEVEL * contrast) }),
        reading,
        log_sigma: SIGMA,
        curvature: CURVATURE,
        bends: [None; 2],
    };
    let (mut seen, mut samples): (Vec<Seen>, Vec<Sample>) = (Vec::new(), Vec::new());
    let mut on: Vec<Flank> = Vec::new();
    let mut is_again = false;
    let (fit, from, prior) = loop {
        let from = wedge.origin;
        view.samples(seed.at, from, FULL + BLURRED[0], &mut seen, &mut samples);
        // A third material, or another part, is none of the edge's.
        if seen.iter().any(|s| !materials.contains(&s.label) && s.sample.at.length() < BLURRED[1]) {
            return None;
        }
        let sections: Vec<Section> = samples.iter().map(|s| wedge.section(s.at)).collect();
        let others = wedge.others(&materials, seen.iter().zip(&samples).zip(&sections));
        // Two edges of something thin, as at the mouth of a gap, are not told apart by windows that leave the other out.
        if others.iter().filter(|(p, _)| p.distance(from) < BLURRED[1]).count() > MOST_WRONG {
            return None;
        }
        samples.retain(|s| {
            s.at.distance_squared(from) <= FULL * FULL
                && others.iter().all(|(p, reach)| p.distance_squared(s.at) > reach * reach)
        });
        if samples.len() < FEWEST_VOXELS {
            return None;
        }
        let bends = flanks_of(view, flats, seed.at, &wedge, &materials, flanks::FARTHEST, &mut on);
        let prior = Prior { bends, ..prior };
        let planar = wedge.fit(&samples, &on, &prior, Stage::Planar)?;
        if planar.reduced().sqrt() * reading.noise > HOPELESS * contrast {
            return None;
        }
        let best = planar.or_curved(&samples, &on, &prior);
        if is_again || best.wedge.apex(0.0).length() <= STILL {
            break (best, from, prior);
        }
        wedge = best.wedge.recentred(0.0);
        if wedge.origin.length() > FARTHEST {
            return None;
        }
        is_again = true;
    };
    let angle = fit.wedge.angles()[0];
    let turn = (angle - std::f64::consts::PI).abs();
    // Roundings turn little where they are explained; an edge that patches show on both sides may leave what physics does to a scan.
    let is_sharp = turn > SHARP;
    let is_shown = (0..2).all(|i| on.iter().any(|flank| flank.ray == i));
    let physics = 1.0 - (reading.white / reading.noise).powi(2);
    let allowed = match is_sharp && is_shown {
        true => Reading { slack: reading.slack * (1.0 + MISFIT * physics), ..reading },
        false => reading,
    };
    let accepted = fit.wedge.apex(0.0).length() < 1.0
        && fit.wedge.point(0.0).length() <= FARTHEST
        && fit.apex_sigma(0.0)[1] < UNSURE
        && fit.explains(&allowed, contrast)
        && turn > 0.35
        && turn < 2.8
        && fit.wedge.sigma().ln().abs() < 2.5 * SIGMA;
    if !accepted {
        return None;
    }
    // Labels must agree in the window, or another sheet is there: across a gap the edge of the other block may go on.
    let wrong = seen
        .iter()
        .filter(|s| !s.uncertain && s.sample.at.length() <= FULL)
        .filter(|s| fit.wedge.is_contradicted(&materials, s.label, fit.wedge.section(s.sample.at + from)))
        .count();
    if wrong > MOST_WRONG || is_ball(&fit, &samples, &prior) {
        return None;
    }
    let fit = if is_sharp { fit.steadied(view, flats, seed.at, &materials, &samples, &prior) } else { fit };
    let at = seed.at + view.units.voxel(fit.wedge.point(0.0));
    Some(Site {
        middle: seed.at,
        at,
        materials: [materials[0], materials[1], materials[1]],
        model: Model::Edge(Box::new(fit)),
    })
}

/// Radius from which a ball is fitted in the place of an edge, blur units.
const BALL: f64 = 3.0;

/// Whether the grey values are explained better by a ball: where the contrast is large what a model may leave of it hides that a
/// pore or an inclusion of some four voxels has no edge.
fn is_ball(fit: &WedgeFit<2, EDGE>, samples: &[Sample], prior: &Prior<2>) -> bool {
    let wedge = &fit.wedge;
    let convex = usize::from(wedge.angles()[0] > std::f64::consts::PI);
    let [a, b] = wedge.rays(0.0);
    let Some(inwards) = (a + b).try_normalize() else { return false };
    let levels = [prior.levels[convex], prior.levels[1 - convex]];
    let ball = fit_ball(samples, wedge.point(0.0) + inwards * BALL, BALL, levels, prior.reading.noise);
    ball.is_some_and(|ball| ball.fit.chi2 + ball.fit.strain < fit.fit.chi2 + fit.fit.strain)
}
