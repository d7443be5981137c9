//! The wedge fits of a junction curve from a start.
//!
//! Rough fits in a small ball; then fits in a window along the curve, with places on the flanks where patches know the interface of
//! a pair alone; planar first, then curved. Where a narrow sector leaves the place unsure, again in a wider window.
//!
//! Acceptance: the fit explains the grey values; the curve lies in the ball, its place is known; rays do not
//! merge; sigma is the scan's. A ball without a junction fits well, but leaves the place along an interface open.

use std::f64::consts::PI;

use glam::DVec3;

use super::flanks::{self, FlatIndex, flanks_of};
use super::knee_fit::find_knee;
use super::sheet::{LevelPrior, Sample};
use super::site::{Model, Site};
use super::view::{Seen, View};
use super::wedge::{
    BLURRED, EDGE, Flank, JUNCTION, Prior, SMALLEST_ANGLE, Section, Stage, Wedge, WedgeFit, most_reduced,
};
use crate::grid::MaterialId;

/// Radius of the ball of the rough fits and of the later ones, blur units.
const ROUGH: f64 = 3.0;
const FULL: f64 = 4.2;
/// Later fits look so far along the curve, blur units, but not where it has turned by more than this (radians): it is
/// the longer look that tells where a weak interface ends at a strong one.
const ALONG: f64 = 5.0;
const TURN: f64 = 0.5;
/// But no farther around, other sheets included: a pass reads so much beyond where a curve may lie.
const AROUND: f64 = 9.1;
/// It reaches to where a narrow sector is at least twice this wide, but no farther than the second, blur units: where a
/// material is narrower its grey value is not seen.
const HALF_WIDTH: f64 = 2.1;
const WIDEST: f64 = 7.0;
/// Other sheets are nowhere nearer to the curve than this, blur units: nearer labels that contradict a rough wedge may be right.
const OTHERS: f64 = 2.5;
/// So many labels of voxels within the window may contradict.
const MOST_WRONG: usize = 4;
/// A fit that leaves so many times the chi squared that may be left is given up: the last rough one, planar ones and curved ones.
/// Of fits that were accepted in the end, on phantoms and on the engine, one rough one of 280 left more, and planar ones at most 45 times.
const HOPELESS: [f64; 3] = [16.0, 64.0, 8.0];
/// Fewest voxels of a fit.
const FEWEST: usize = 120;
/// Standard deviation of grey levels, as a share of the smallest contrast, and of the largest, beside what the levels say:
/// what a dense material does to the scan it does to its neighbours.
const LEVEL: [f64; 2] = [0.03, 0.01];
/// Standard deviation of the logarithm of sigma.
const SIGMA: f64 = 0.1;
/// Standard deviation of curvatures, per blur unit.
const CURVATURE: f64 = 0.05;
/// The models' own errors, as a share of the largest contrast.
const MODEL: f64 = 0.0005;
/// A fit whose curve has moved farther than this from the window's middle is made again about it, blur units.
pub(super) const STILL: f64 = 0.1;
/// Largest standard deviation of the curve's place, blur units.
const UNSURE: f64 = 0.4;

/// The rough fits from a start about `middle` (voxels), as a start for the others. The curve may move so far if a sector is narrow, and if none
/// is, blur units.
pub(super) fn rough(
    view: &View<'_>,
    middle: DVec3,
    mut wedge: Wedge<3, JUNCTION>,
    prior: &Prior<3>,
    most: [f64; 2],
) -> Option<Wedge<3, JUNCTION>> {
    let (mut seen, mut samples): (Vec<Seen>, Vec<Sample>) = (Vec::new(), Vec::new());
    for pass in 0..2 {
        view.samples(middle, wedge.origin, ROUGH, &mut seen, &mut samples);
        let fit = wedge.fit(&samples, &[], prior, Stage::Rough)?;
        wedge = fit.wedge.recentred(0.0);
        let most = most[usize::from(wedge.narrowest().1 > NARROW)];
        if wedge.origin.length() > most || (pass == 1 && is_hopeless(&fit, prior, HOPELESS[0])) {
            return None;
        }
    }
    Some(wedge)
}

/// What is known before the fits at a place.
pub(super) fn prior(view: &View<'_>, at: DVec3, materials: [MaterialId; 3]) -> Prior<3> {
    let levels: [LevelPrior; 3] = materials.map(|m| view.level(m, at));
    let mut sorted = levels.map(|l| l.mean);
    sorted.sort_by(f64::total_cmp);
    let smallest = (sorted[1] - sorted[0]).min(sorted[2] - sorted[1]);
    let level = (LEVEL[0] * smallest).hypot(LEVEL[1] * (sorted[2] - sorted[0]));
    Prior {
        levels: levels.map(|l| LevelPrior { mean: l.mean, sigma: l.sigma.hypot(level) }),
        reading: view.reading(&materials, MODEL),
        log_sigma: SIGMA,
        curvature: CURVATURE,
        bends: [None; 3],
    }
}

/// A later fit, and what it was made of.
pub(super) struct Finished {
    /// The fit.
    pub fit: WedgeFit<3, JUNCTION>,
    /// The voxels it was fitted to.
    pub samples: Vec<Sample>,
    prior: Prior<3>,
}

/// What is asked of a place.
pub(super) struct Asked<'a> {
    /// The window's middle, voxels, and how far the curve may lie from it, blur units.
    pub place: (DVec3, f64),
    /// Of the wedge's sectors.
    pub materials: [MaterialId; 3],
    /// What is known before.
    pub prior: Prior<3>,
    /// Patches, if known.
    pub flats: &'a FlatIndex,
}

/// The site that later fits from a rough one make: a knee, if another sheet is near and the grey values show one, or what [`refit`] finds.
pub(super) fn finish(view: &View<'_>, asked: &Asked<'_>, wedge: &Wedge<3, JUNCTION>) -> Option<Site> {
    let found = in_windows(view, asked, wedge)?;
    find_knee(view, asked, &found).or_else(|| accepted(view, asked, found))
}

/// The site that later fits from a rough or an earlier one make, if it is accepted.
pub(super) fn refit(view: &View<'_>, asked: &Asked<'_>, wedge: &Wedge<3, JUNCTION>) -> Option<Site> {
    accepted(view, asked, in_windows(view, asked, wedge)?)
}

/// The later fits: of the least window, and of a wider one where that leaves the place unsure.
fn in_windows(view: &View<'_>, asked: &Asked<'_>, wedge: &Wedge<3, JUNCTION>) -> Option<Finished> {
    if view.execution.is_cancelled() {
        return None;
    }
    let within = |wedge: &Wedge<3, JUNCTION>, widest: f64| fit_within(view, asked, wedge.clone(), widest);
    // A wide window knows a narrow sector better, if nothing else is in it: another edge, or an interface that is near by nature. What else
    // there is shows in what is left.
    let near = within(wedge, FULL);
    let start = near.as_ref().map_or(wedge, |near| &near.fit.wedge);
    let is_sure = near.as_ref().is_some_and(|near| unsure(&near.fit) < SURE);
    let far = if !is_sure && wide(start) > FULL { within(&start.recentred(0.0), WIDEST) } else { None };
    match (near, far) {
        (Some(near), Some(far)) if far.fit.reduced() > WORSE * near.fit.reduced() => Some(near),
        (_, Some(far)) => Some(far),
        (near, None) => near,
    }
}

/// The site of a fit, if it is accepted.
fn accepted(view: &View<'_>, asked: &Asked<'_>, found: Finished) -> Option<Site> {
    let Finished { fit, samples, prior } = found;
    let (middle, most) = asked.place;
    // What a pass reads beyond its slices is enough up to `most`.
    let accepted = fit.wedge.apex(0.0).length() < 1.0
        && fit.wedge.point(0.0).length() <= most
        && (fit.apex_sigma(0.0)[1] < UNSURE || unsure(&fit) < KNOWN && fit.apex_sigma(0.0)[1] < VAGUE)
        && fit.explains(&prior.reading, range_of(&prior.levels))
        && fit.wedge.sigma().ln().abs() < 2.5 * SIGMA
        && fit.wedge.angles().iter().all(|a| *a > SMALLEST_ANGLE);
    if !accepted || !needs_all(&fit, &samples, &prior) {
        return None;
    }
    let fit = fit.steadied(view, asked.flats, middle, &asked.materials, &samples, &prior);
    let at = middle + view.units.voxel(fit.wedge.point(0.0));
    Some(Site { middle, at, materials: asked.materials, model: Model::Junction(Box::new(fit)) })
}

/// A wide window's fit may leave so many times what the least one's leaves.
const WORSE: f64 = 1.2;
/// A fit in the least window whose place has no larger standard deviation, by what it leaves, is not made in a wider one, blur units.
const SURE: f64 = 0.12;
/// A fit may be taken though its standard deviation is above [`UNSURE`] if that is so because interfaces of the scan miss the model (beside
/// narrow wedges false ones do): it must be below the first by what the fit itself leaves, and below the second by those misfits.
const KNOWN: f64 = 0.25;
const VAGUE: f64 = 1.0;

/// Standard deviation of the curve's place where it is largest, by what the fit leaves if that is less than what was to be expected.
fn unsure(fit: &WedgeFit<3, JUNCTION>) -> f64 {
    fit.apex_sigma(0.0)[1] * fit.reduced().sqrt().min(1.0)
}

/// The fits in a window no wider than `widest` about the wedge, and again about where the first one puts it.
fn fit_within(
    view: &View<'_>,
    asked: &Asked<'_>,
    mut wedge: Wedge<3, JUNCTION>,
    widest: f64,
) -> Option<Finished> {
    let Asked { place: (middle, most), materials, prior, flats } = asked;
    let (middle, most) = (*middle, *most);
    let mut seen: Vec<Seen> = Vec::new();
    let mut samples: Vec<Sample> = Vec::new();
    let mut on: Vec<Flank> = Vec::new();
    let mut is_again = false;
    loop {
        let along = ALONG.min(TURN / wedge.bend().max(1e-9));
        let (mut full, blind) = (wide(&wedge).min(widest), wedge.blind());
        // And, once patches are known, as far around it as blur reaches, where labels tell others too. (Before, what lies ahead of a curve's end
        // would be left out: a wedge beside a corner is accepted then, its labels spoil the patches there, and the corner is not found.)
        let beyond = if flats.is_empty() { 0.0 } else { BLURRED[0] };
        let around = (full + beyond).hypot(along).min(AROUND);
        view.samples(middle, wedge.origin, around, &mut seen, &mut samples);
        let sections: Vec<Section> = samples.iter().map(|s| wedge.section(s.at)).collect();
        // In a thin wall the sheet of its other side is near; and in the tip of a narrow sector labels are its neighbours'.
        let certain = |((s, _), at): &((&Seen, &Sample), &Section)| {
            let r = at.r.length();
            !s.uncertain && r > OTHERS && (r > blind || !wedge.is_narrow_of(**at, 0.0))
        };
        let mut others = wedge.others(materials, seen.iter().zip(&samples).zip(&sections).filter(certain));
        let mut beside: Vec<f64> = others
            .iter()
            .map(|(at, _)| wedge.section(*at))
            .filter(|at| at.z.abs() <= along)
            .map(|at| at.r.length())
            .collect();
        beside.sort_by(f64::total_cmp);
        // A wide window for a narrow sector ends where others are. But if they are within the least, as where the curve ends, there is no
        // such wedge: leaving much out would hide that.
        if let Some(&end) = beside.get(MOST_WRONG) {
            full = full.min(end.max(FULL));
            if end <= FULL {
                others.clear();
            }
        }
        let is_within = |at: Section| at.r.length_squared() <= full * full && at.z.abs() <= along;
        let is_own = |s: &Sample| others.iter().all(|(p, reach)| p.distance_squared(s.at) > reach * reach);
        let mut own = sections.iter().map(|at| is_within(*at));
        samples.retain(|s| own.next().unwrap_or(false) && is_own(s));
        if samples.len() < FEWEST {
            return None;
        }
        let bends = flanks_of(view, flats, middle, &wedge, materials, flanks::FARTHEST, &mut on);
        let prior = Prior { bends, ..*prior };
        let planar = wedge.fit(&samples, &on, &prior, Stage::Planar)?;
        if is_hopeless(&planar, &prior, HOPELESS[1]) {
            return None;
        }
        let fit = planar.curved(&samples, &on, &prior);
        if is_hopeless(&fit, &prior, HOPELESS[2]) {
            return None;
        }
        if is_again || fit.wedge.apex(0.0).length() <= STILL {
            return Some(Finished { fit, samples, prior });
        }
        wedge = fit.wedge.recentred(0.0);
        if wedge.origin.length() > most {
            return None;
        }
        is_again = true;
    }
}

/// Whether a fit leaves so many times what may be left that a better middle will not mend it.
fn is_hopeless(fit: &WedgeFit<3, JUNCTION>, prior: &Prior<3>, times: f64) -> bool {
    fit.reduced() > times * most_reduced(fit.samples, &prior.reading, range_of(&prior.levels))
}

/// Radius of the window about a wedge, blur units: where its narrowest sector is wide enough for its material to be seen.
fn wide(wedge: &Wedge<3, JUNCTION>) -> f64 {
    (HALF_WIDTH / (0.5 * wedge.narrowest().1).tan()).clamp(FULL, WIDEST)
}

/// Sectors narrower than this must be needed, radians: a blurred step between two materials passes the level of one
/// between them, and labels there may show it.
const NARROW: f64 = 1.05;
/// By how much the grey values must be explained better with it than without, chi squared; of a sector narrower than the second
/// (radians) by more, as the square of its angle falls: the narrower, the more it is like what models miss at a bent edge. (Of 13 to 24
/// degrees at the edge of an iron ring gained up to 54, of wedges of 30 degrees at 4 % noise 5,000 and more.)
const EVIDENCE: f64 = 50.0;
const SLIVER: f64 = PI / 6.0;

/// Whether the grey values show the narrowest sector: whether its two neighbours, meeting in one sheet in its place, explain them less.
fn needs_all(fit: &WedgeFit<3, JUNCTION>, samples: &[Sample], prior: &Prior<3>) -> bool {
    let (i, angle) = fit.wedge.narrowest();
    if angle > NARROW {
        return true;
    }
    let (next, last) = ((i + 1) % 3, (i + 2) % 3);
    let rays = fit.wedge.rays(0.0);
    let Some(instead) = (rays[i] + rays[next]).try_normalize() else { return true };
    let levels = [prior.levels[next], prior.levels[last]];
    let (origin, direction) = (fit.wedge.point(0.0), fit.wedge.direction(0.0));
    let wedge = Wedge::<2, EDGE>::new(origin, direction, [instead, rays[last]], levels.map(|l| l.mean));
    let Prior { reading, log_sigma, curvature, .. } = *prior;
    let prior = Prior { levels, reading, log_sigma, curvature, bends: [None; 2] };
    let without = wedge.fit(samples, &[], &prior, Stage::Planar).map(|w| w.or_curved(samples, &[], &prior));
    let evidence = EVIDENCE * (SLIVER / angle).max(1.0).powi(2);
    without.is_none_or(|w| w.fit.chi2 + w.fit.strain > fit.fit.chi2 + evidence)
}

/// Difference of the largest and the smallest level.
fn range_of(levels: &[LevelPrior]) -> f64 {
    let ends =
        levels.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], l| [a.min(l.mean), b.max(l.mean)]);
    ends[1] - ends[0]
}
