//! Fits of a junction beside a sharp edge ([`knee`](super::knee)), where a wedge alone leaves much.
//!
//! **Whether to look.** A small bend of each sheet at two lengths is tried in the linearised model: what it promises costs one evaluation.
//! Most junctions promise little and nothing more is done.
//!
//! **Starts.** Each sheet bent to either side, near or farther. A wedge that was fitted to a bend lies between the sheets before and after
//! it, so starts are also turned back by half the bend, and moved back along the sheet. Of each sheet and side the one that explains
//! most, and of these the best few are fitted.
//!
//! **Turning over.** The scene of a junction at a with a bend at b is also that of a junction at b with a bend at a, if the third sheet lies close along the
//! one that bends, with a sector of no width between them. Fits end there from starts on the far side; then curve and bend change places
//! and the fit is made again.
//!
//! Patches do not help: beside a bend many are fitted across it (with them a bolt's junction was 0.1 off in place of 0.03).
//!
//! **Acceptance** is that of junctions; and the bend must explain what a wedge leaves of the same voxels, in units of what the knee itself leaves,
//! whatever the noise is thought to be; length and turn must be known.

use std::f64::consts::FRAC_PI_2;

use glam::DVec3;

use super::batch::Batches;
use super::junction_fit::{Asked, Finished};
use super::knee::{KNEED, Knee, KneeFit, LENGTH, SLOPE, TURN};
use super::sheet::Sample;
use super::site::{Model, Site};
use super::view::{Seen, View};
use super::wedge::{BLURRED, JUNCTION, Places, Stage, Wedge, by_noise, is_in_order};

/// Voxels within these distances of the junction curve and of the bend are fitted, blur units, and so far along.
const WINDOW: [f64; 2] = [4.2, 3.4];
const ALONG: f64 = 4.0;
/// What a pass reads beyond its slices is enough for windows up to this, blur units.
const REACH: f64 = 8.6;
/// Lengths at which a small bend is tried first, blur units, and what it must promise beside what the wedge can do, in units of what is left per
/// voxel. Of knees that were accepted in the end (a bolt at 1 and 4 % noise, an engine) none promised less than 2; half of a bolt's other junctions do.
const PROBED: [f64; 2] = [1.5, 3.2];
const PROMISE: f64 = 1.5;
/// Bends that are fitted: the share of the turn by which the sheet before is turned back, the length up to the bend, and the share of it by
/// which the curve is moved back; blur units. And their turn, radians.
const SHAPES: [(f64, f64, f64); 7] = [
    (0.0, 2.0, 0.0),
    (0.0, 3.8, 0.0),
    (0.5, 1.4, 0.0),
    (0.5, 3.0, 0.0),
    (0.5, 1.4, 0.5),
    (0.5, 3.0, 0.5),
    (1.0, 2.0, 0.5),
];
const TURN_TRIED: f64 = FRAC_PI_2;
/// So many of the sheets and sides are fitted.
const TRIED: usize = 3;
/// Sectors beside a bend narrower than the first are tried as none, radians; none is narrower than the second.
const NARROW: f64 = 0.9;
const NARROWEST: f64 = 0.5;
/// What the bend must gain in chi squared, in units of what is left per voxel: much for three parameters. With 150 half of a bolt's knees were lost in 4 % noise.
const EVIDENCE: f64 = 60.0;
/// Fewest voxels.
const FEWEST: usize = 150;
/// No more of [`Reading::slack`](super::sheet::Reading) counts: false interfaces beside such places are what makes it large. Where twice what noise
/// allows was left fits were wrong (objects of four materials, 56 voxels).
const MOST_SLACK: f64 = 1.5;
/// Bends whose length changes faster, or that turn farther (radians), were none: folds at the end of a scan.
const STEEPEST: f64 = 0.5;
const SHARPEST: f64 = 2.2;
/// Largest standard deviations: of the curve's place and of the length, blur units, and of the turn, radians.
const UNSURE: [f64; 3] = [0.4, 0.4, 0.4];

/// The knee about a wedge that was fitted to these voxels, if the grey values show one.
pub(super) fn find_knee(view: &View<'_>, asked: &Asked<'_>, found: &Finished) -> Option<Site> {
    if !is_promising(asked, found) {
        return None;
    }
    let (mut seen, mut samples): (Vec<Seen>, Vec<Sample>) = (Vec::new(), Vec::new());
    let start = found.fit.wedge.recentred(0.0);
    view.samples(asked.place.0, start.origin, WINDOW[0].hypot(ALONG), &mut seen, &mut samples);
    samples.retain(|s| {
        let section = start.section(s.at);
        section.r.length() <= WINDOW[0] && section.z.abs() <= ALONG
    });
    if samples.len() < FEWEST {
        return None;
    }
    let batches = Batches::new(&samples);
    let straight = start.fit(&samples, &[], &asked.prior, Stage::Planar)?;
    // Of each sheet and side the start that explains most.
    let mut tried: Vec<(f64, Knee)> = (0..3)
        .flat_map(|ray| [TURN_TRIED, -TURN_TRIED].map(|turn| (ray, turn)))
        .filter_map(|(ray, turn)| {
            let misfits = starts(&straight.wedge, ray, turn)
                .map(|knee| (knee.misfit(&batches, &asked.prior.reading), knee));
            misfits.min_by(|a, b| a.0.total_cmp(&b.0))
        })
        .collect();
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    let fit = |knee: &Knee| knee.fit(&samples, &asked.prior, Stage::Planar);
    let best = tried
        .iter()
        .take(TRIED)
        .filter_map(|(_, knee)| fit(knee))
        .flat_map(|first| {
            let over = turned_over(&first, NARROW).and_then(|knee| fit(&knee));
            [Some(first), over].into_iter().flatten()
        })
        .filter(is_open)
        .min_by(|a, b| a.fit.fit.chi2.total_cmp(&b.fit.fit.chi2))?;
    if straight.fit.chi2 - best.fit.fit.chi2 < EVIDENCE * best.fit.reduced() {
        return None;
    }
    fit_knee(view, asked, &best.knee)
}

/// Whether a bend of one of a wedge's sheets promises to explain more.
fn is_promising(asked: &Asked<'_>, found: &Finished) -> bool {
    let batches = Batches::new(&found.samples);
    let bends = (0..3).flat_map(|ray| PROBED.map(|length| (ray, length)));
    let promised = bends.map(|bend| Knee::promise(&found.fit.wedge, bend, &batches, &asked.prior));
    let promised = promised.fold(0.0, f64::max) / found.fit.reduced();
    promised > PROMISE
}

/// Knees that a wedge may stand for, of a sheet and a side.
fn starts(wedge: &Wedge<3, JUNCTION>, ray: usize, turn: f64) -> impl Iterator<Item = Knee> + '_ {
    SHAPES.into_iter().filter_map(move |(back, length, shift)| {
        let mut knee = Knee::new(wedge, ray, length, turn);
        knee.wedge.x[Places::<3>::THETA + ray] -= back * turn;
        let u = knee.wedge.ray(ray, 0.0) * (-shift * length);
        knee.wedge.x[Places::<3>::A0] += u.x;
        knee.wedge.x[Places::<3>::A0 + 1] += u.y;
        is_in_order::<3, KNEED>(&knee.wedge.x).then_some(knee)
    })
}

fn is_open(fit: &KneeFit) -> bool {
    fit.knee.wedge.narrowest().1 > NARROWEST
}

/// The knee with curve and bend changed about, if a sector beside the bend is narrower than this.
fn turned_over(fit: &KneeFit, below: f64) -> Option<Knee> {
    let (narrow, angle) = fit.knee.wedge.narrowest();
    if angle < below { fit.knee.turned_over(narrow) } else { None }
}

/// The fit from a knee about the middle of a window, if it is accepted.
fn fit_knee(view: &View<'_>, asked: &Asked<'_>, knee: &Knee) -> Option<Site> {
    let (middle, most) = asked.place;
    let (mut seen, mut samples): (Vec<Seen>, Vec<Sample>) = (Vec::new(), Vec::new());
    let mut knee = knee.clone();
    let mut is_turned = false;
    let mut pass = 0;
    let fit = loop {
        knee = knee.recentred();
        if knee.wedge.origin.length() > most {
            return None;
        }
        let reach = WINDOW[0].max(knee.length(0.0) + WINDOW[1]).hypot(ALONG).min(REACH);
        view.samples(middle, knee.wedge.origin, reach, &mut seen, &mut samples);
        let is_within = |at: DVec3| {
            let ([junction, bend], z) = knee.around(at);
            (junction <= WINDOW[0] || bend <= WINDOW[1]) && z.abs() <= ALONG
        };
        // In a thin wall the sheet of its other side is near.
        let is_other = |(s, sample): &(&Seen, &Sample)| {
            let contradicts = || knee.is_contradicted(&asked.materials, s.label, sample.at);
            !s.uncertain && !is_within(sample.at) && contradicts()
        };
        let blurred = |label| BLURRED[usize::from(!asked.materials.contains(&label))];
        let others: Vec<(DVec3, f64)> = seen
            .iter()
            .zip(&samples)
            .filter(is_other)
            .map(|(s, sample)| (sample.at, blurred(s.label)))
            .collect();
        samples.retain(|s| {
            is_within(s.at) && others.iter().all(|(p, reach)| p.distance_squared(s.at) > reach * reach)
        });
        if samples.len() < FEWEST {
            return None;
        }
        let planar = knee.fit(&samples, &asked.prior, Stage::Planar)?;
        if !is_turned && let Some(over) = turned_over(&planar, NARROWEST) {
            is_turned = true;
            knee = over;
            continue;
        }
        let fit = planar.knee.fit(&samples, &asked.prior, Stage::Curved).unwrap_or(planar);
        pass += 1;
        if pass == 2 {
            break fit;
        }
        knee = fit.knee;
    };
    let straight = fit.knee.straight().fit(&samples, &[], &asked.prior, Stage::Planar)?;
    let straight = straight.curved(&samples, &[], &asked.prior).fit.chi2;
    is_accepted(&fit, straight, asked).then(|| {
        let at = middle + view.units.voxel(fit.fit.wedge.point(0.0));
        Site { middle, at, materials: asked.materials, model: Model::Knee(Box::new(fit)) }
    })
}

/// Whether a knee is to be believed, where a wedge leaves this chi squared of the same voxels.
fn is_accepted(fit: &KneeFit, straight: f64, asked: &Asked<'_>) -> bool {
    let KneeFit { knee: Knee { wedge, .. }, fit: found } = fit;
    let slack = asked.prior.reading.slack.min(MOST_SLACK);
    let reduced = found.reduced();
    let sigma = |p: usize| found.fit.covariance[(p, p)].max(0.0).sqrt();
    let sigmas = [found.apex_sigma(0.0)[1], sigma(LENGTH), sigma(TURN)];
    is_open(fit)
        && wedge.apex(0.0).length() < 1.0
        && wedge.point(0.0).length() <= asked.place.1
        // Where misfits of the scan are large, by what the fit itself leaves.
        && sigmas.iter().zip(UNSURE).all(|(s, most)| s * reduced.sqrt().min(1.0) < most)
        && reduced < by_noise(found.samples, slack)
        && wedge.x[SLOPE].abs() < STEEPEST
        && wedge.x[TURN].abs() < SHARPEST
        && straight - found.fit.chi2 > EVIDENCE * reduced
        && wedge.sigma().ln().abs() < 2.5 * asked.prior.log_sigma
}
