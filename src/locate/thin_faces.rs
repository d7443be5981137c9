//! Faces of thin parts: patches where two interfaces are nearer to each other than a single sheet allows.
//!
//! From the middle of a block's crossings labels are followed across the interface, both ways. Where they change again
//! soon, a slab ([`super::slab_model`]) is fitted, and the block's face of it is its patch; where what is
//! inside ends on all sides, a ball ([`super::ball_model`]). As for single sheets, voxels whose labels
//! contradict the model and all that their blur reaches are left out, and a fit is taken only if it explains what
//! is left. Otherwise there is no answer, and the block is one like others.

use glam::DVec3;
use nalgebra::Matrix3;

use super::ball_model::{Ball, fit_ball};
use super::gauss::TABLES;
use super::patches::{FARTHEST, MOST_CURVED};
use super::sheet::{LevelPrior, Sample, Sheet};
use super::slab_model::{Slab, Start, fit_slab};
use super::view::{Seen, View};
use crate::grid::MaterialId;

/// Two faces farther apart than this are single sheets, blur units.
const THICK: f64 = 4.2;
/// Balls are looked for up to this diameter.
const WIDE: f64 = 7.2;
/// Below this nothing but a slab or a ball can be fitted.
const THIN: f64 = 3.2;
/// Steps along which labels are followed.
const STEP: f64 = 0.5;
/// Radius of a slab's window.
pub(super) const WINDOW: f64 = 3.4;
/// A ball's window goes so far beyond its surface.
const BEYOND: f64 = 2.5;
/// A voxel this far on the wrong side contradicts; what lies this near to it is left out.
const WRONG: f64 = 1.3;
pub(super) const TAINTED: f64 = 2.4;
/// Grey values farther from a slab's than this share of its contrast are of something else; judged within this share of
/// half its thickness, and so far beyond its faces.
const UNLIKE: f64 = 0.25;
const MIDDLE: f64 = 0.4;
const OUTSIDE: f64 = 1.5;
/// Fewest voxels of a fit.
const FEWEST: usize = 40;
/// The models' own errors, as a share of the contrast.
const MODEL: f64 = 0.004;
/// No level is known better than to this share of the contrast.
const LEVEL: f64 = 0.003;

/// A face of something thin.
pub(super) enum ThinFace {
    /// Of a plate or a gap.
    Sheet(Box<Sheet>),
    /// Of a ball; and whether the first material of the pair is inside.
    Ball(Box<Ball>, bool),
    /// Something so thin that no other model sees one interface alone, and no fit.
    Unclear,
}

/// The face of something thin through about `centre` (voxels), where the materials of `pair` meet, about across
/// `direction`, in which their surface's areas are; `None` if nothing is thin there.
pub(super) fn thin_face(
    view: &View<'_>,
    centre: DVec3,
    pair: [MaterialId; 2],
    direction: DVec3,
    seen: &mut Vec<Seen>,
) -> Option<ThinFace> {
    let normal = (direction / view.units.per_voxel).try_normalize()?;
    let far = [1.0, -1.0].map(|way| next(view, centre, normal * way, pair[usize::from(way > 0.0)]));
    let (ahead, (thickness, beyond)) = match far {
        [Some(a), Some(b)] if b.0 < a.0 => (false, b),
        [Some(a), _] => (true, a),
        [None, Some(b)] => (false, b),
        [None, None] => return None,
    };
    let way = if ahead { 1.0 } else { -1.0 };
    let inside = pair[usize::from(ahead)];
    let outside = pair[usize::from(!ahead)];
    let middle = centre + view.units.voxel(normal * (0.5 * way * thickness));
    let round = beyond == outside && is_round(view, middle, normal, 0.5 * thickness, inside);
    if round && let Some(ball) = ball_around(view, middle, 0.5 * thickness, [inside, outside], seen) {
        let at = view.units.of(centre - middle);
        let off = (at.distance(ball.centre()) - ball.radius()).abs();
        if off * view.units.mean_voxels < FARTHEST {
            // From the window's middle to the block's.
            return Some(ThinFace::Ball(Box::new(moved(ball, -at)), !ahead));
        }
    }
    if thickness > THICK {
        return None;
    }
    let materials = if ahead { [outside, inside, beyond] } else { [beyond, inside, outside] };
    let Some(slab) = slab_around(view, middle, normal, thickness, materials, seen) else {
        return (thickness < THIN).then_some(ThinFace::Unclear);
    };
    let mut face = slab.face(!ahead);
    face.origin += view.units.of(middle - centre);
    Some(ThinFace::Sheet(Box::new(face)))
}

/// A ball seen from elsewhere.
fn moved(mut ball: Ball, by: DVec3) -> Ball {
    for (c, d) in ball.fit.x.iter_mut().zip(by.to_array()) {
        *c += d;
    }
    ball
}

/// How far `own` reaches from `centre` in a direction (blur units), and what is behind it; `None` if it reaches far.
fn next(view: &View<'_>, centre: DVec3, direction: DVec3, own: MaterialId) -> Option<(f64, MaterialId)> {
    let mut entered = false;
    let mut left: Option<(f64, MaterialId)> = None;
    for k in 1..=(WIDE / STEP) as usize + 1 {
        let distance = k as f64 * STEP;
        let label = label_at(view, centre + view.units.voxel(direction * distance))?;
        match left {
            _ if label == own => {
                // A voxel or two of something else is noise.
                entered = true;
                left = None;
            }
            Some((at, other)) if label == other => return Some((at - 0.5 * STEP, other)),
            _ if entered => left = Some((distance, label)),
            _ if distance > 1.2 => return None,
            _ => {}
        }
    }
    None
}

/// The label at a place; `None` where there are no voxels.
pub(super) fn label_at(view: &View<'_>, place: DVec3) -> Option<MaterialId> {
    let voxel = place.round();
    let size = view.slab.size().map(|n| n as f64);
    let here = (0..3).all(|a| voxel[a] >= 0.0 && voxel[a] < size[a]);
    let voxel = voxel.max(DVec3::ZERO).to_array().map(|c| c as usize);
    (here && view.slab.slices().contains(&voxel[2])).then(|| view.label(voxel))
}

/// Whether what is inside at `middle` ends on all sides about as near as across `normal`.
fn is_round(view: &View<'_>, middle: DVec3, normal: DVec3, radius: f64, inside: MaterialId) -> bool {
    let (u, v) = normal.any_orthonormal_pair();
    let farthest = 1.6 * radius + 1.0;
    [u, -u, v, -v].into_iter().all(|direction| {
        let steps = (farthest / STEP) as usize + 1;
        (1..=steps).any(|k| {
            let place = middle + view.units.voxel(direction * (k as f64 * STEP));
            label_at(view, place).is_none_or(|label| label != inside)
        })
    })
}

/// Levels about a place, and the noise that fits weigh by.
pub(super) fn levels<const N: usize>(
    view: &View<'_>,
    at: DVec3,
    materials: [MaterialId; N],
) -> ([LevelPrior; N], f64) {
    let all = materials.map(|m| view.level(m, at));
    let means = all.map(|l| l.mean);
    let contrast = means.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b))
        - means.iter().fold(f64::INFINITY, |a, &b| a.min(b));
    let noise = view.reading(&materials, MODEL).noise;
    (all.map(|l| LevelPrior { sigma: l.sigma.hypot(LEVEL * contrast), ..l }), noise)
}

/// Whether a fit explains `n` grey values, of which a scan may show `slack` times what noise makes of them.
pub(super) fn explains(chi2: f64, strain: f64, n: usize, slack: f64) -> bool {
    let n = n as f64;
    chi2 / n < slack * (1.0 + 6.0 * (2.0 / n).sqrt()) && strain < 16.0
}

/// The samples within `radius` whose labels do not contradict, and that no blur of those that do, or are `strange`,
/// reaches.
fn clean(seen: &[Seen], radius: f64, strange: &[DVec3], agrees: impl Fn(&Seen) -> bool) -> Vec<Sample> {
    let mut wrong: Vec<DVec3> =
        seen.iter().filter(|s| !s.uncertain && !agrees(s)).map(|s| s.sample.at).collect();
    wrong.extend(strange);
    seen.iter()
        .filter(|s| !s.uncertain && agrees(s) && s.sample.at.length_squared() <= radius * radius)
        .filter(|s| wrong.iter().all(|w| w.distance_squared(s.sample.at) > TAINTED * TAINTED))
        .map(|s| s.sample)
        .collect()
}

/// Where grey values are far from those of a flat slab about the window's middle: beyond its rim, or in other parts. Looked
/// at are only its middle and what is well outside, which need no exact start.
pub(super) fn strange(
    seen: &[Seen],
    normal: DVec3,
    half: f64,
    [before, within, after]: [f64; 3],
) -> Vec<DVec3> {
    let steps = [within - before, after - within];
    let most = UNLIKE * steps[0].abs().max(steps[1].abs());
    let tables = &*TABLES;
    seen.iter()
        .map(|s| s.sample)
        .filter(|s| {
            let w = normal.dot(s.at);
            let flat = w.abs() < MIDDLE * half || w.abs() > half + OUTSIDE;
            let grey =
                before + steps[0] * tables.distribution(w + half) + steps[1] * tables.distribution(w - half);
            flat && (s.grey - grey).abs() > most
        })
        .map(|s| s.at)
        .collect()
}

/// Fits a slab about `middle` (voxels). `materials`: before, within and after.
fn slab_around(
    view: &View<'_>,
    middle: DVec3,
    normal: DVec3,
    thickness: f64,
    materials: [MaterialId; 3],
    seen: &mut Vec<Seen>,
) -> Option<Slab> {
    // What blurs into the window may lie beyond it.
    view.ball(middle, WINDOW + TAINTED, seen);
    let half = 0.5 * thickness;
    // In the middle of the slab there must be what is inside, or its rim is near.
    let inner = half - WRONG.min(0.6 * half);
    let agrees = |normal: DVec3| {
        move |s: &Seen| {
            let w = normal.dot(s.sample.at);
            (s.label == materials[1] && w.abs() < half + WRONG)
                || (s.label == materials[0] && w < -inner)
                || (s.label == materials[2] && w > inner)
        }
    };
    let (levels, noise) = levels(view, middle, materials);
    let means = levels.map(|l| l.mean);
    let normal = across(seen, normal, means);
    let samples = clean(seen, WINDOW, &strange(seen, normal, half, means), agrees(normal));
    if samples.len() < FEWEST {
        return None;
    }
    let slab = fit_slab(&samples, Start { at: DVec3::ZERO, normal, half }, levels, noise)?;
    let good = explains(slab.fit.chi2, slab.fit.strain, samples.len(), 1.0)
        && slab.curvature() < MOST_CURVED
        && slab.half() > 0.4
        && slab.half() < 0.5 * THICK + 0.5
        && slab.middle().length() < 1.5;
    good.then_some(slab)
}

/// The direction across which what is within is thinnest, about `normal`.
fn across(seen: &[Seen], normal: DVec3, levels: [f64; 3]) -> DVec3 {
    let share = |s: &Seen| {
        let outside = if normal.dot(s.sample.at) < 0.0 { levels[0] } else { levels[2] };
        ((s.sample.grey - outside) / (levels[1] - outside)).clamp(0.0, 1.0)
    };
    let (mut sum, mut first) = (0.0, DVec3::ZERO);
    let seen = || seen.iter().filter(|s| s.sample.at.length_squared() < WINDOW * WINDOW);
    for s in seen() {
        sum += share(s);
        first += s.sample.at * share(s);
    }
    if sum <= 0.0 {
        return normal;
    }
    let mean = first / sum;
    let mut second = Matrix3::zeros();
    for s in seen() {
        let d = s.sample.at - mean;
        let d = nalgebra::Vector3::new(d.x, d.y, d.z);
        second += d * d.transpose() * share(s);
    }
    let eigen = second.symmetric_eigen();
    let column = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let found = DVec3::new(column[0], column[1], column[2]);
    match found.dot(normal) {
        d if d > 0.6 => found,
        d if d < -0.6 => -found,
        _ => normal,
    }
}

/// Fits a ball about `middle` (voxels). `materials`: inside and outside.
fn ball_around(
    view: &View<'_>,
    middle: DVec3,
    radius: f64,
    materials: [MaterialId; 2],
    seen: &mut Vec<Seen>,
) -> Option<Ball> {
    // The middle of one direction may be beside that of the ball.
    view.ball(middle, radius + 1.0 + BEYOND, seen);
    let (levels, noise) = levels(view, middle, materials);
    let own = seen.iter().filter(|s| s.label == materials[0] && s.sample.at.length() < 2.0 * radius + 1.0);
    let count = own.clone().count();
    let centre = own.map(|s| s.sample.at).sum::<DVec3>() / count.max(1) as f64;
    let agrees = |s: &Seen| {
        let far = s.sample.at.distance(centre) > radius + 2.0;
        s.label == materials[1] || (s.label == materials[0] && !far)
    };
    let mut samples = clean(seen, f64::INFINITY, &[], agrees);
    samples.retain(|s| s.at.distance(centre) < radius + BEYOND);
    if samples.len() < FEWEST || count == 0 {
        return None;
    }
    let ball = fit_ball(&samples, centre, radius, levels, noise)?;
    let good = explains(ball.fit.chi2, ball.fit.strain, samples.len(), 1.0)
        && ball.radius() > 0.7
        && ball.centre().distance(centre) < 1.2;
    good.then_some(ball)
}
