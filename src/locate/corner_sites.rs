//! Corners and points of junction curves: where they are looked for, and the fits there.
//!
//! Seeds are blocks whose crossings are no smooth sheet, and junction cells. Where patches around show three
//! planes that meet nearby, a corner of three planes is fitted to all grey values around their common point, with the
//! patches as places on the planes and their curvatures; which octant holds what is found by trial
//! (`corner_starts`).
//!
//! A corner that is wrong is worse than none. So: the grey values are explained, no other material of any octant would do, the
//! apex is known and near where the planes meet, and the planes are those of the patches.

use std::cmp::Ordering;
use std::ops::Range;
use std::sync::Arc;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::batch::Batches;
use super::corner::{Corner, CornerFit, LineKind, MATERIALS};
use super::corner_fit::{Anchor, CornerPrior};
use super::corner_planes::{Plane, planes_about};
use super::corner_site::{CornerSite, Shape};
use super::corner_starts::{self, Found};
use super::flanks::FlatIndex;
use super::junction_sites::junction_places;
use super::patches::Rough;
use super::sheet::{LevelPrior, Reading, Sample};
use super::site::{Model, Site};
use super::view::{Seen, View};
use super::wedge::{BLURRED, RESIDUAL, is_explained};
use crate::grid::MaterialId;

/// Planes meet within this distance of a seed, blur units.
pub(super) const REACH: f64 = 4.0;
/// Determinant of their normals at least.
const FLATTEST: f64 = 0.2;
/// A plane that one patch alone shows makes a corner as likely as one so much farther away.
const LONE: f64 = 1.5;
/// Radius of the ball of a fit, blur units.
pub(super) const FULL: f64 = 4.3;
/// The apex may be so far from where the planes of the patches meet: beside what a flat core has widened patches are a little off (the corner of a
/// wedge of 60 degrees was 2.5 away).
const FARTHEST: f64 = 3.0;
/// A fit whose apex moved farther than this is made again about it.
pub(super) const STILL: f64 = 0.3;
/// Patches so far from the apex are places on the planes.
const ANCHORS: Range<f64> = 3.2..8.0;
/// But not those that a fit without them leaves by more standard deviations than this, and some room.
const DOUBTFUL: f64 = 4.0;
const ROOM: f64 = 0.1;
/// Neighbouring patches share grey values: each counts as this much less certain.
const SHARED: f64 = 2.0;
/// What a patch is off by beside noise, blur units.
const OFF: f64 = 0.004;
/// Planes bend if their curvature is larger than this, per blur unit, and they may change towards the corner.
const STRAIGHT: f64 = 0.012;
const BEND: f64 = 0.02;
/// Planes that bend more are no planes within the ball.
const MOST_BENT: f64 = 0.12;
/// Standard deviation of grey levels, as a share of the contrast, beside what the levels say.
pub(super) const LEVEL: f64 = 0.02;
/// Standard deviation of the logarithm of sigma.
pub(super) const SIGMA: f64 = 0.05;
/// The models' own errors, as a share of the contrast.
pub(super) const MODEL: f64 = 0.0007;
/// A first fit that leaves this many times what may be left is given up.
const HOPELESS: f64 = 3.0;
/// Cosine of the normals beside an edge at most: planes that turn less may be a rounding.
const BLUNT: f64 = 0.83;
/// Largest standard deviation of the apex, blur units.
pub(super) const UNSURE: f64 = 0.25;
/// The same of a first fit, without patches: of those that were accepted in the end none had more than 0.4.
const VAGUE: f64 = 0.75;
/// Edge of the boxes in which one fit is enough, voxels.
pub(super) const CELL: f64 = 4.0;
/// Planes that meet this near to each other are the same three, blur units.
const ALIKE: f64 = 0.1;
/// Starts of a box that are tried.
const STARTS: usize = 3;
/// Edge of the boxes in which one seed is enough, voxels.
const SEEDS: f64 = 3.0;
/// A label contradicts a corner if its voxel lies farther than this from all planes, blur units; so many may.
const WRONG: f64 = 1.3;
const MOST_WRONG: usize = 2;
/// Labels nearer to the apex than this that contradict a first fit may be wrong; if they contradict it nearer than the second, it is no such
/// corner; blur units.
const OTHERS: [f64; 2] = [2.5, 3.6];
/// Fewest voxels with a label for its material to count.
const FEWEST: usize = 3;

/// Labels are there as far as a corner's ball reaches from the slices `core`.
fn seen_from(view: &View<'_>, core: &Range<usize>) -> Range<f64> {
    let reach = view.units.voxel(DVec3::splat(REACH + FARTHEST)).z + CELL;
    (core.start as f64 - reach).max(0.0)..core.end as f64 + reach
}

/// Where blocks have junction cells from which corners of the slices `core` may be found, voxels.
#[must_use]
pub(super) fn junctions_about(view: &View<'_>, core: &Range<usize>) -> Vec<DVec3> {
    let slices = seen_from(view, core);
    let last = view.slab.size()[2] - 1;
    let mut places = junction_places(view, slices.start as usize..(slices.end.ceil() as usize).min(last));
    places.retain(|at| slices.contains(&at.z));
    places
}

/// Fits the corners whose start lies in a box that begins in the slices `core`; seeds are `junctions` (of
/// [`junctions_about`]) and `rough`.
#[must_use]
pub(super) fn corner_sites(
    view: &View<'_>,
    flats: &FlatIndex,
    junctions: &[DVec3],
    rough: &[Rough],
    core: &Range<usize>,
) -> Vec<Site> {
    let slices = seen_from(view, core);
    let mut seeds = junctions.to_vec();
    seeds.extend(rough.iter().map(|r| r.at).filter(|at| slices.contains(&at.z)));
    let seeds = thinned(seeds);
    let mut starts: Vec<Start> = seeds.par_iter().flat_map_iter(|seed| starts(view, flats, *seed)).collect();
    starts.retain(|s| usize::try_from(s.cell[2] * CELL as i32).is_ok_and(|z| core.contains(&z)));
    starts.sort_by(|a, b| {
        let key = |s: &Start| [s.away, s.at.z, s.at.y, s.at.x];
        let places = || key(a).into_iter().zip(key(b)).map(|(x, y)| x.total_cmp(&y));
        a.cell.cmp(&b.cell).then_with(|| places().find(|o| o.is_ne()).unwrap_or(Ordering::Equal))
    });
    let boxes: Vec<&[Start]> = starts.chunk_by(|a, b| a.cell == b.cell).collect();
    boxes
        .into_par_iter()
        .filter_map(|all| {
            let step = all.len().div_ceil(STARTS).max(1);
            let mut tried: Vec<DVec3> = Vec::new();
            let mut first = |kept| {
                let mut starts = all.iter().step_by(step);
                starts.find_map(|start| fit(view, flats, start, kept, &mut tried))
            };
            first(false).or_else(|| first(true))
        })
        .collect()
}

/// The lowest of the seeds in each box: a corner is looked for farther around than that. Boxes that the ends of what is seen cut
/// are too far from the core to matter.
pub(super) fn thinned(seeds: Vec<DVec3>) -> Vec<DVec3> {
    let key = |at: &DVec3| (*at / SEEDS).floor().as_ivec3().to_array();
    let mut seeds: Vec<([i32; 3], DVec3)> = seeds.into_iter().map(|at| (key(&at), at)).collect();
    seeds.sort_by(|a, b| {
        let places = a.1.to_array().into_iter().zip(b.1.to_array());
        a.0.cmp(&b.0)
            .then_with(|| places.map(|(x, y)| x.total_cmp(&y)).find(|o| o.is_ne()).unwrap_or(Ordering::Equal))
    });
    seeds.dedup_by_key(|s| s.0);
    seeds.into_iter().map(|s| s.1).collect()
}

/// Where three planes meet.
struct Start<'a> {
    cell: [i32; 3],
    /// The planes around the seed (voxels), and which ones they are.
    planes: Arc<[Plane<'a>]>,
    seed: DVec3,
    three: [usize; 3],
    /// The place, voxels.
    at: DVec3,
    /// Distance from the seed, blur units.
    away: f64,
}

/// The triples of planes that meet near a place: which, where, and what speaks against them.
fn triples(planes: &[Plane<'_>], reach: f64) -> Vec<([usize; 3], DVec3, f64)> {
    let mut out = Vec::new();
    for i in 0..planes.len() {
        for j in 0..i {
            for k in 0..j {
                let three = [i, j, k].map(|p| (planes[p].point(), planes[p].normal));
                let determinant = three[0].1.dot(three[1].1.cross(three[2].1)).abs();
                if determinant > FLATTEST
                    && let Some(apex) = Corner::meet(&three).filter(|a| a.length() < reach)
                {
                    let lone = [i, j, k].iter().filter(|&&p| planes[p].parts.len() == 1).count();
                    out.push(([i, j, k], apex, apex.length() + LONE * lone as f64));
                }
            }
        }
    }
    out
}

fn starts<'a>(view: &View<'_>, flats: &'a FlatIndex, seed: DVec3) -> Vec<Start<'a>> {
    let planes: Arc<[Plane<'a>]> = planes_about(view, flats, seed).into();
    let found = triples(&planes, REACH);
    found
        .into_iter()
        .map(|(three, apex, _)| {
            let at = seed + view.units.voxel(apex);
            let cell = at.to_array().map(|c| (c / CELL).floor() as i32);
            Start { cell, planes: planes.clone(), seed, three, at, away: apex.length() }
        })
        .collect()
}

/// What a corner is fitted with, about `middle`.
struct Window {
    samples: Batches,
    /// The same one by one, blur units from the middle.
    voxels: Vec<Sample>,
    /// Materials by the numbers that labels have here.
    materials: Vec<MaterialId>,
    labels: Vec<u8>,
    reading: Reading,
    prior: CornerPrior,
    anchors: Vec<Anchor>,
    planes: [(DVec3, DVec3); 3],
    contrast: f64,
}

impl Window {
    /// Of the voxels about `middle` (voxels) and three planes there.
    fn new(view: &View<'_>, middle: DVec3, planes: [&Plane<'_>; 3]) -> Option<Self> {
        let (mut seen, mut samples): (Vec<Seen>, Vec<Sample>) = (Vec::new(), Vec::new());
        view.samples(middle, DVec3::ZERO, FULL, &mut seen, &mut samples);
        let mut materials: Vec<MaterialId> = seen.iter().map(|s| s.label).collect();
        materials.sort_unstable();
        materials = materials.chunk_by(|a, b| a == b).filter(|g| g.len() >= FEWEST).map(|g| g[0]).collect();
        if !(2..=MATERIALS).contains(&materials.len()) || materials.contains(&MaterialId::OUTSIDE) {
            return None;
        }
        let labels =
            seen.iter().map(|s| materials.binary_search(&s.label).map_or(u8::MAX, |i| i as u8)).collect();
        let levels: Vec<LevelPrior> = materials.iter().map(|&m| view.level(m, middle)).collect();
        let ends = levels
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], l| [a.min(l.mean), b.max(l.mean)]);
        let contrast = ends[1] - ends[0];
        let mut bends = [(DMat3::ZERO, 0.0); 3];
        for (bend, plane) in bends.iter_mut().zip(planes) {
            let (form, sigma) = plane.bend(SHARED);
            let size = form.to_cols_array().iter().map(|c| c * c).sum::<f64>().sqrt();
            if size > MOST_BENT {
                return None;
            }
            if size > STRAIGHT.max(2.0 * sigma) {
                *bend = (form, sigma.hypot(BEND));
            }
        }
        let reading = view.reading(&materials, MODEL);
        let prior = CornerPrior {
            levels: std::array::from_fn(|m| {
                let level = levels.get(m)?;
                Some(LevelPrior { mean: level.mean, sigma: level.sigma.hypot(LEVEL * contrast) })
            }),
            noise: reading.noise,
            log_sigma: SIGMA,
            bends,
        };
        let planes_of = |plane: usize| {
            planes[plane].parts.iter().filter(|p| ANCHORS.contains(&p.at.length())).map(move |p| Anchor {
                plane,
                at: p.at,
                sigma: (SHARED * p.flat.sigma).hypot(OFF),
            })
        };
        let anchors = (0..3).flat_map(planes_of).collect();
        let planes = planes.map(|p| (p.point(), p.normal));
        let voxels = samples;
        let samples = Batches::new(&voxels);
        Some(Self { samples, voxels, materials, labels, reading, prior, anchors, planes, contrast })
    }

    /// Leaves out what other sheets reach that a corner about the window's middle does not have, such as that of a ledge's edge: they are
    /// where certain labels contradict the corner.
    fn leave_others(&mut self, view: &View<'_>, middle: DVec3, corner: &Corner) {
        let mut seen: Vec<Seen> = Vec::new();
        view.ball(middle, FULL + BLURRED[1], &mut seen);
        let others: Vec<(DVec3, f64)> = seen
            .iter()
            .filter(|s| !s.uncertain && s.sample.at.length() > OTHERS[0])
            .filter(|s| {
                let own = self.materials.binary_search(&s.label).ok();
                let is_own = own.is_some_and(|own| usize::from(corner.material(s.sample.at)) == own);
                !is_own && (own.is_none() || (0..3).all(|i| corner.distance(i, s.sample.at).abs() > WRONG))
            })
            .map(|s| (s.sample.at, BLURRED[usize::from(!self.materials.contains(&s.label))]))
            .collect();
        let within = others.iter().filter(|(at, _)| at.length() < OTHERS[1]).count();
        if within > MOST_WRONG || others.len() <= MOST_WRONG {
            return;
        }
        let is_clear = |at: DVec3| others.iter().all(|(p, reach)| p.distance_squared(at) > reach * reach);
        let kept = self.voxels.iter().zip(&self.labels).filter(|(voxel, _)| is_clear(voxel.at));
        (self.voxels, self.labels) = kept.map(|(voxel, label)| (*voxel, *label)).unzip();
        self.samples = Batches::new(&self.voxels);
    }

    fn start(&self) -> Option<corner_starts::Start> {
        corner_starts::Start::new(&self.planes, &self.samples, &self.labels, &self.prior)
    }

    fn find(&self, start: &corner_starts::Start, anchors: &[Anchor], first: bool) -> Option<Found> {
        start.find(&self.samples, anchors, &self.prior, self.hopeless(), FARTHEST, first)
    }

    /// The places on planes that agree with a fit without them.
    fn agreeing(&self, fit: &CornerFit) -> Vec<Anchor> {
        let same = |normal: DVec3, i: usize| fit.corner.normals[i].dot(normal).abs();
        let plane_of = self
            .planes
            .map(|(_, normal)| (1..3).fold(0, |m, i| if same(normal, i) > same(normal, m) { i } else { m }));
        let agrees = |a: &&Anchor| {
            let i = plane_of[a.plane];
            let off = fit.corner.distance(i, a.at).abs();
            off < DOUBTFUL * a.sigma.hypot(fit.plane_sigma(i, a.at)) + ROOM
        };
        self.anchors.iter().filter(agrees).copied().collect()
    }

    /// Misfit per measurement that is far more than a better start would explain.
    fn hopeless(&self) -> f64 {
        HOPELESS.max((HOPELESS * RESIDUAL * self.contrast / self.prior.noise).powi(2))
    }

    /// Whether labels of two materials contradict a corner away from its planes: another sheet is there, such as that of another
    /// block across a gap. (Where more materials meet, labels are not that certain.)
    fn is_contradicted(&self, corner: &Corner) -> bool {
        let wrong = self.voxels.iter().zip(&self.labels).filter(|(voxel, label)| {
            corner.material(voxel.at) != **label && (0..3).all(|i| corner.distance(i, voxel.at).abs() > WRONG)
        });
        self.materials.len() == 2 && wrong.count() > MOST_WRONG
    }

    /// Whether a fit leaves no more than noise and the scan's misfits.
    fn explains(&self, fit: &CornerFit) -> bool {
        is_explained(fit.reduced(), fit.samples, &self.reading, self.contrast)
    }

    /// Whether a fit may be taken.
    fn accepts(&self, found: &Found) -> bool {
        let fit = &found.fit;
        let lines = fit.corner.lines();
        let curves = lines.iter().filter(|l| l.kind != LineKind::None).count();
        let blunt = lines.iter().filter(|l| l.kind == LineKind::Edge).any(|l| {
            let [a, b] = l.planes.map(|i| fit.corner.normals[i]);
            a.dot(b).abs() > BLUNT
        });
        found.is_sound(FULL)
            && self.explains(fit)
            && curves >= 3
            && !blunt
            && fit.corner.is_complete()
            && !self.is_contradicted(&fit.corner)
            && fit.apex_sigmas()[2] < UNSURE
            && fit.corner.log_sigma.abs() < 2.5 * SIGMA
    }
}

/// The planes of a start as they are seen from `middle` (voxels), and where they meet. If not `kept`, those that are found
/// there most clearly: often more patches show them. But a plane that one patch alone shows may not be found again.
fn planes_of<'a>(
    view: &View<'_>,
    flats: &'a FlatIndex,
    start: &Start<'a>,
    kept: bool,
    middle: DVec3,
) -> Option<([Plane<'a>; 3], DVec3)> {
    let seen = planes_about(view, flats, middle);
    if !kept {
        let (three, apex, _) = triples(&seen, REACH).into_iter().min_by(|a, b| a.2.total_cmp(&b.2))?;
        return Some((three.map(|p| seen[p].clone()), apex));
    }
    let away = view.units.of(middle - start.seed);
    let planes = start.three.map(|p| {
        let plane = start.planes[p].from(away);
        plane.among(&seen).cloned().unwrap_or(plane)
    });
    let apex = Corner::meet(&planes.each_ref().map(|p| (p.point(), p.normal)))?;
    (apex.length() < REACH).then_some((planes, apex))
}

/// The fit from a start, if it is accepted; not from where planes met that were `tried` before.
fn fit<'a>(
    view: &View<'_>,
    flats: &'a FlatIndex,
    at: &Start<'a>,
    kept: bool,
    tried: &mut Vec<DVec3>,
) -> Option<Site> {
    if view.execution.is_cancelled() {
        return None;
    }
    let (_, apex) = planes_of(view, flats, at, kept, at.at)?;
    let mut middle = at.at + view.units.voxel(apex);
    if tried.iter().any(|other| view.units.of(*other - middle).length() < ALIKE) {
        return None;
    }
    tried.push(middle);
    let mut last: Option<CornerFit> = None;
    loop {
        let (planes, _) = planes_of(view, flats, at, kept, middle)?;
        let mut window = Window::new(view, middle, planes.each_ref())?;
        // Where four materials meet, what three planes contradict is more likely a sheet of the point's own.
        if let Some(before) = &last
            && window.materials.len() < MATERIALS
        {
            window.leave_others(view, middle, &before.corner);
        }
        let start = window.start()?;
        // From the voxels alone, then with the patches that agree.
        let Some(before) = last else {
            if !start.is_complete() {
                return None;
            }
            let mut found = window.find(&start, &[], true)?.fit;
            let moved = found.corner.apex;
            let is_vague = found.apex_sigmas()[2] > VAGUE;
            if moved.length() > FARTHEST || is_vague || found.reduced() > window.hopeless() {
                return None;
            }
            if moved.length() > STILL {
                middle += view.units.voxel(moved);
                found.corner.apex = DVec3::ZERO;
            }
            last = Some(found);
            continue;
        };
        let is_taken = |found: &Found| found.fit.corner.apex.length() <= FARTHEST && window.accepts(found);
        // Patches near a corner may be off by what they have seen of other sheets: then what the voxels alone have explained stands.
        let alone = || {
            let is_explained = window.explains(&before);
            is_explained
                .then(|| corner_starts::alone(&before.corner, &window.samples, &window.prior))
                .flatten()
        };
        let with_patches = window.find(&start, &window.agreeing(&before), false);
        let found = with_patches.filter(is_taken).or_else(|| alone().filter(is_taken))?;
        let materials = std::array::from_fn(|m| window.materials[m.min(window.materials.len() - 1)]);
        let apex = middle + view.units.voxel(found.fit.corner.apex);
        let corner = CornerSite::new(Shape::Planes(Box::new(found.fit)), materials);
        let three = [materials[0], materials[1], materials[2]];
        return Some(Site { middle, at: apex, materials: three, model: Model::Corner(Box::new(corner)) });
    }
}
