//! A place where sheets meet, in a curve or a corner: a model that was fitted and accepted, and what it says nearby.

use glam::DVec3;

use super::corner_site::{CornerSite, are_same};
use super::knee::KneeFit;
use super::passage::Passage;
use super::sites::CurveKind;
use super::wedge::{EDGE, JUNCTION, Section, WedgeFit};
use crate::grid::MaterialId;

/// The model of a site.
#[derive(Debug, Clone)]
pub enum Model {
    /// A junction curve.
    Junction(Box<WedgeFit<3, JUNCTION>>),
    /// A sharp edge.
    Edge(Box<WedgeFit<2, EDGE>>),
    /// A junction curve beside a sharp edge.
    Knee(Box<KneeFit>),
    /// A corner, or a point where such curves end.
    Corner(Box<CornerSite>),
}

/// See the module's header.
#[derive(Debug, Clone)]
pub struct Site {
    /// The middle of the window, voxels; the model is in blur units about it.
    pub middle: DVec3,
    /// A point of the curve, or the corner, voxels.
    pub at: DVec3,
    /// The material of each sector; of an edge the first two count. A corner knows its own.
    pub materials: [MaterialId; 3],
    /// The fit.
    pub model: Model,
}

macro_rules! with_model {
    ($site:expr, $fit:ident => $body:expr, $knee:ident => $bent:expr, $corner:ident => $other:expr) => {
        match &$site.model {
            Model::Junction($fit) => $body,
            Model::Edge($fit) => $body,
            Model::Knee($knee) => $bent,
            Model::Corner($corner) => $other,
        }
    };
}

impl Site {
    /// Distance of a place (blur units from the middle) from the curve, and how far along it the place lies
    /// from where the fit is centred; of a corner, from its nearest curve and nothing.
    #[must_use]
    pub fn around(&self, at: DVec3) -> [f64; 2] {
        with_model!(self, fit => {
            let Section { r, z } = fit.wedge.section(at);
            [r.length(), z]
        }, knee => {
            let ([junction, bend], z) = knee.knee.around(at);
            [junction.min(bend), z]
        }, corner => [corner.nearest(at, None).map_or(f64::INFINITY, |n| n.distance), 0.0])
    }

    /// The material at a place.
    #[must_use]
    pub fn material(&self, at: DVec3) -> MaterialId {
        with_model!(
            self,
            fit => self.materials[fit.wedge.sector(at)],
            knee => self.materials[knee.knee.sector(at)],
            corner => corner.material(at)
        )
    }

    /// The interface between two of its materials near a place; `None` if they do not meet here. Behind the
    /// curve sheets do not go on.
    #[must_use]
    pub fn passage(&self, pair: [MaterialId; 2], at: DVec3) -> Option<Passage> {
        with_model!(
            self,
            fit => passage(fit, &self.materials, pair, at),
            knee => knee.knee.passage(&self.materials, pair, at),
            corner => corner.passage(pair, at)
        )
    }

    /// Standard deviation of the place of that interface along its normal, for white noise.
    #[must_use]
    pub fn sigma(&self, pair: [MaterialId; 2], at: DVec3) -> Option<f64> {
        with_model!(
            self,
            fit => nearest_sheet(fit, &self.materials, pair, fit.wedge.section(at)).map(|(i, _)| fit.sheet_sigma(i, at)),
            knee => knee.sigma(&self.materials, pair, at),
            corner => corner.sigma(pair, at)
        )
    }

    /// Whether a curve of a kind that it knows has just these materials around it, no one twice.
    #[must_use]
    pub fn is_between(&self, kind: CurveKind, materials: &[MaterialId]) -> bool {
        match (&self.model, kind) {
            (Model::Corner(corner), _) => corner.is_between(kind, materials),
            (Model::Junction(_) | Model::Knee(_), CurveKind::Junction) => {
                are_same(materials, &self.materials)
            }
            (Model::Edge(_), CurveKind::Edge) => are_same(materials, &self.materials[..2]),
            // Which of its sheets bends is not asked for: an edge of two of its materials.
            (Model::Knee(_), CurveKind::Edge) => materials.iter().all(|m| self.materials.contains(m)),
            _ => false,
        }
    }

    /// Which of its sheets between two materials a place lies on or next to; the number only tells sheets apart.
    #[must_use]
    pub fn sheet(&self, pair: [MaterialId; 2], at: DVec3) -> Option<usize> {
        with_model!(
            self,
            fit => nearest_sheet(fit, &self.materials, pair, fit.wedge.section(at)).map(|(i, _)| i),
            knee => knee.knee.sheet(&self.materials, pair, at),
            corner => corner.sheet(pair, at)
        )
    }

    /// Where the segment from `start` along `step` goes from material `a` to `b`, as a fraction; `None` if it does
    /// not, once.
    #[must_use]
    pub fn change(&self, [a, b]: [MaterialId; 2], start: DVec3, step: DVec3) -> Option<f64> {
        if self.material(start) != a || self.material(start + step) != b {
            return None;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..12 {
            let middle = 0.5 * (low + high);
            let found = self.material(start + step * middle);
            if found == a {
                low = middle;
            } else if found == b {
                high = middle;
            } else {
                // A third material between: the edge meets two sheets, and no place is right.
                return Some(middle);
            }
        }
        Some(0.5 * (low + high))
    }

    /// Where a curve of the asked kind passes the plane `coordinate` (voxels) of an axis, in voxels, and its standard
    /// deviation in blur units; `None` where it runs along the plane or farther than `reach` from where the fit is centred (a
    /// corner knows its own). Of several, the one nearest to
    /// `near` (voxels).
    #[must_use]
    pub fn pierces(
        &self,
        kind: CurveKind,
        [axis, coordinate]: [usize; 2],
        per_voxel: DVec3,
        near: DVec3,
        reach: f64,
    ) -> Option<(DVec3, f64)> {
        let target = (coordinate as f64 - self.middle[axis]) * per_voxel[axis];
        with_model!(self, fit => {
            let wedge = &fit.wedge;
            let z = pierced(axis, target, reach, |z| wedge.point(z), |z| wedge.direction(z))?;
            Some((self.middle + fit.wedge.point(z) / per_voxel, fit.apex_sigma(z)[1]))
        }, knee => {
            let bent = &knee.knee;
            let z = pierced(axis, target, reach, |z| bent.point(kind, z), |z| bent.direction(kind, z))?;
            Some((self.middle + knee.knee.point(kind, z) / per_voxel, knee.curve_sigma(kind, z)))
        }, corner => {
            let near = (near - self.middle) * per_voxel;
            let (at, sigma) = corner.pierces(kind, axis, target, near)?;
            Some((self.middle + at / per_voxel, sigma))
        })
    }

    /// The point of a curve of the asked kind that is nearest to `near`, in voxels, and its standard deviation in blur units;
    /// `None` if it is farther than `reach` from where the fit is centred (a corner knows its own). Of a corner's curves one with just
    /// `materials` around it, if there is one.
    #[must_use]
    pub fn nearest(
        &self,
        kind: CurveKind,
        per_voxel: DVec3,
        near: DVec3,
        reach: f64,
        materials: &[MaterialId],
    ) -> Option<(DVec3, f64)> {
        let at = (near - self.middle) * per_voxel;
        let (at, sigma) = with_model!(self, fit => {
            let z = fit.wedge.section(at).z;
            (z.abs() <= reach).then(|| (fit.wedge.point(z), fit.apex_sigma(z)[1]))
        }, knee => {
            let (_, z) = knee.knee.around(at);
            (z.abs() <= reach).then(|| (knee.knee.point(kind, z), knee.curve_sigma(kind, z)))
        }, corner => corner.nearest_point(kind, at, materials))?;
        Some((self.middle + at / per_voxel, sigma))
    }

    /// The point of the interface between two of its materials nearest to a place, where it is at least `margin` away from
    /// the curves at which it ends, and its standard deviation; in blur units. `None` where there is no such interface.
    #[must_use]
    pub fn on_sheet(&self, pair: [MaterialId; 2], at: DVec3, margin: f64) -> Option<(DVec3, f64)> {
        with_model!(
            self,
            fit => on_sheet(fit, &self.materials, pair, at, margin),
            knee => knee.on_sheet(&self.materials, pair, at, margin),
            corner => corner.on_sheet(pair, at, margin)
        )
    }
}

/// How far along a curve its place along an axis is `target`, by its points and directions; `None` where it runs across the axis or if that
/// is farther than `reach`.
fn pierced(
    axis: usize,
    target: f64,
    reach: f64,
    point: impl Fn(f64) -> DVec3,
    direction: impl Fn(f64) -> DVec3,
) -> Option<f64> {
    let mut z = 0.0;
    for _ in 0..6 {
        let slope = direction(z)[axis];
        if slope.abs() < 0.05 {
            return None;
        }
        z += ((target - point(z)[axis]) / slope).clamp(-2.0, 2.0);
    }
    (z.abs() <= reach && (point(z)[axis] - target).abs() <= 1e-3).then_some(z)
}

/// As [`Site::on_sheet`], of a wedge.
fn on_sheet<const R: usize, const N: usize>(
    fit: &WedgeFit<R, N>,
    materials: &[MaterialId],
    [a, b]: [MaterialId; 2],
    at: DVec3,
    margin: f64,
) -> Option<(DVec3, f64)> {
    let wedge = &fit.wedge;
    let of_pair = |i: &usize| {
        let found = [materials[(i + R - 1) % R], materials[*i]];
        found == [a, b] || found == [b, a]
    };
    let section = wedge.section(at);
    let z = section.z;
    let found = (0..R).filter(of_pair).map(|i| {
        let ray = wedge.rays(z)[i];
        let (off, along, normal) = wedge.sheet_of(i, section);
        // Behind the margin the nearest point is on it.
        let mut on = if along < margin { wedge.point(z) + ray * margin } else { at - normal * off };
        for _ in 0..3 {
            let (off, _, normal) = wedge.sheet(i, on);
            on -= normal * off;
        }
        (on, fit.sheet_sigma(i, on))
    });
    found.min_by(|x, y| x.0.distance_squared(at).total_cmp(&y.0.distance_squared(at)))
}

/// What a wedge says of the interface between two materials.
fn passage<const R: usize, const N: usize>(
    fit: &WedgeFit<R, N>,
    materials: &[MaterialId],
    pair: [MaterialId; 2],
    at: DVec3,
) -> Option<Passage> {
    let at = fit.wedge.section(at);
    let (i, along) = nearest_sheet(fit, materials, pair, at)?;
    let (distance, _, normal) = fit.wedge.sheet_of(i, at);
    let passage = Passage { distance, normal };
    Some(if along { passage } else { passage.reversed() })
}

/// The sheet of a wedge between two materials that is nearest to a place, and whether it goes from the first to the second.
fn nearest_sheet<const R: usize, const N: usize>(
    fit: &WedgeFit<R, N>,
    materials: &[MaterialId],
    [a, b]: [MaterialId; 2],
    at: Section,
) -> Option<(usize, bool)> {
    let of_pair = |i: usize| {
        let (before, after) = (materials[(i + R - 1) % R], materials[i]);
        let along = (before, after) == (a, b);
        (along || (before, after) == (b, a)).then_some((i, along))
    };
    let mut own = (0..R).filter_map(of_pair);
    let first = own.next()?;
    let Some(second) = own.next() else { return Some(first) };
    // Both sheets of an edge.
    let away = |(i, _): (usize, bool)| {
        let (distance, c, _) = fit.wedge.sheet_of(i, at);
        distance.hypot(c.min(0.0))
    };
    Some(if away(second) < away(first) { second } else { first })
}
