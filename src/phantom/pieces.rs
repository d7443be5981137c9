//! The pieces of curves at which interfaces end, bend or pass over to another surface.
//!
//! All curves in which two surfaces cross are cut where other surfaces cross them, and each piece keeps the
//! pairs that touch it: three or more materials around it make it a junction curve, two an edge, or a smooth seam
//! where the interface goes on in the same direction.

use std::f64::consts::TAU;

use glam::DVec3;

use super::curve::{Curve, crossing};
use super::scene::Scene;
use super::surface::Surface;
use super::{PhantomError, Truth};
use crate::grid::{MaterialId, Pair};

/// A piece of a curve at which interfaces end, bend or pass over to another surface.
#[derive(Debug, Clone, PartialEq)]
pub struct CurvePiece {
    /// The curve.
    pub curve: Curve,
    /// Where the piece starts.
    pub low: f64,
    /// Where it ends.
    pub high: f64,
    /// The materials around it, ascending: three or more on a junction curve.
    pub materials: Vec<MaterialId>,
    /// Whether one interface only passes over to another surface here, without a bend.
    pub is_smooth: bool,
    /// Surfaces it lies on.
    pub(super) surfaces: Vec<usize>,
    /// Interfaces that touch it: pair, surface, whether the pair's front is outside of the surface.
    pub(super) touching: Vec<(Pair, usize, bool)>,
}

impl CurvePiece {
    /// Whether three or more materials meet there.
    #[must_use]
    pub fn is_junction(&self) -> bool {
        self.materials.len() >= 3
    }

    /// Whether one interface bends there and no third material meets it.
    #[must_use]
    pub fn is_edge(&self) -> bool {
        !self.is_junction() && !self.is_smooth
    }

    /// The pair whose interface bends there, on a sharp edge.
    #[must_use]
    pub fn edge_pair(&self) -> Option<Pair> {
        if self.is_edge() { self.touching.first().map(|t| t.0) } else { None }
    }

    /// The surfaces of [`Scene::surfaces`] on which interfaces touch it, ascending.
    #[must_use]
    pub fn touching_surfaces(&self) -> Vec<usize> {
        let mut out: Vec<usize> = self.touching.iter().map(|t| t.1).collect();
        out.sort_unstable();
        out.dedup();
        out
    }

    /// Whether the interface of this pair touches it.
    #[must_use]
    pub fn touches(&self, pair: Pair) -> bool {
        self.touching.iter().any(|t| t.0 == pair)
    }

    /// Its length, in mm.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.curve.length(self.low, self.high)
    }
}

/// The point of a curve closest to another one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnCurve<'a> {
    /// The piece it lies on.
    pub piece: &'a CurvePiece,
    /// Its parameter there.
    pub t: f64,
    /// The point, mm.
    pub point: DVec3,
    /// Its distance, mm.
    pub distance: f64,
}

/// The point of a piece closest to `q`, if it is nearer than `limit`.
pub(super) fn closest_on<'a>(
    piece: &'a CurvePiece,
    surfaces: &[Surface],
    q: DVec3,
    limit: f64,
) -> Option<OnCurve<'a>> {
    // The piece lies on its surfaces, so it is no nearer than the farthest of them.
    if piece.surfaces.iter().any(|&s| surfaces[s].signed_distance(q).abs() >= limit) {
        return None;
    }
    let t = piece.curve.closest(q, piece.low, piece.high);
    let point = piece.curve.at(t);
    let distance = (q - point).length();
    (distance < limit).then_some(OnCurve { piece, t, point, distance })
}

/// Points per curve at which crossings with other surfaces are looked for.
const SCAN: usize = 1440;

/// All pieces of curves at which an interface ends or bends.
pub(super) fn pieces(scene: &Scene, ball: (DVec3, f64)) -> Result<Vec<CurvePiece>, PhantomError> {
    let surfaces = scene.surfaces();
    let mut out = Vec::new();
    for first in 0..surfaces.len() {
        for second in first + 1..surfaces.len() {
            let Some(curves) = crossing(&surfaces[first], &surfaces[second]) else {
                if may_meet(&surfaces[first], &surfaces[second]) {
                    return Err(PhantomError::Crossing { first, second });
                }
                continue;
            };
            for curve in curves {
                let Some(range) = curve.range(ball) else { continue };
                let on = |s: &Surface| {
                    (0..=16).all(|k| {
                        let p = curve.at(range.0 + (range.1 - range.0) * f64::from(k) / 16.0);
                        s.signed_distance(p).abs() < 1e-9 * ball.1
                    })
                };
                let containing: Vec<usize> =
                    (0..surfaces.len()).filter(|&k| k == first || k == second || on(&surfaces[k])).collect();
                // A curve on three surfaces appears for each two of them: keep the first time.
                if containing[..2] != [first, second] {
                    continue;
                }
                for (low, high) in cut(scene, &curve, range, &containing) {
                    // Where several surfaces cross the curve in one point, rounding leaves specks.
                    if curve.length(low, high) < 1e-9 * ball.1 {
                        continue;
                    }
                    out.extend(piece(scene, curve, (low, high), &containing, ball.1));
                }
            }
        }
    }
    Ok(out)
}

/// Whether two surfaces without a closed-form crossing can meet; spheres and parallel cylinders exactly,
/// others assumed to meet.
fn may_meet(first: &Surface, second: &Surface) -> bool {
    use Surface::{Cylinder, Sphere};
    let rings = |distance: f64, r: f64, s: f64| distance < r + s && distance > (r - s).abs();
    match (*first, *second) {
        (Sphere { centre, radius }, Sphere { centre: c, radius: r }) => {
            rings((centre - c).length(), radius, r)
        }
        (Sphere { centre, radius }, Cylinder { point, axis, radius: r })
        | (Cylinder { point, axis, radius: r }, Sphere { centre, radius }) => {
            let distance = super::surface::reject(centre - point, axis).length();
            distance + radius > r && distance - radius < r
        }
        (Cylinder { point, axis, radius }, Cylinder { point: p, axis: a, radius: r }) => {
            axis.cross(a).length() > 1e-12
                || rings(super::surface::reject(p - point, axis).length(), radius, r)
        }
        _ => true,
    }
}

/// Cuts a curve where surfaces that do not contain it cross it.
fn cut(scene: &Scene, curve: &Curve, range: (f64, f64), containing: &[usize]) -> Vec<(f64, f64)> {
    let at = |k: usize| range.0 + (range.1 - range.0) * k as f64 / SCAN as f64;
    let mut breaks = Vec::new();
    for (index, surface) in scene.surfaces().iter().enumerate() {
        if containing.contains(&index) {
            continue;
        }
        let value = |t: f64| surface.signed_distance(curve.at(t));
        for k in 0..SCAN {
            let (mut low, mut high) = (at(k), at(k + 1));
            let below = value(low) < 0.0;
            if below == (value(high) < 0.0) {
                continue;
            }
            for _ in 0..100 {
                let middle = 0.5 * (low + high);
                if middle <= low || middle >= high {
                    break;
                }
                if (value(middle) < 0.0) == below { low = middle } else { high = middle }
            }
            breaks.push(0.5 * (low + high));
        }
    }
    breaks.sort_by(f64::total_cmp);
    let closed = matches!(curve, Curve::Ellipse { .. });
    match (closed, breaks.first(), breaks.last()) {
        (_, None, _) | (_, _, None) => vec![range],
        (true, Some(&first), Some(&last)) => {
            let mut out: Vec<_> = breaks.windows(2).map(|w| (w[0], w[1])).collect();
            out.push((last, first + TAU));
            out
        }
        (false, Some(&first), Some(&last)) => {
            let mut out = vec![(range.0, first)];
            out.extend(breaks.windows(2).map(|w| (w[0], w[1])));
            out.push((last, range.1));
            out
        }
    }
}

/// What meets at a piece of a curve; `None` if it is not an end or bend of any interface.
fn piece(
    scene: &Scene,
    curve: Curve,
    (low, high): (f64, f64),
    containing: &[usize],
    scale: f64,
) -> Option<CurvePiece> {
    let t = 0.5 * (low + high);
    let (middle, tangent) = (curve.at(t), curve.tangent(t).normalize());
    let eps = 1e-5 * scale;
    let mut touching = Vec::new();
    let mut materials = Vec::new();
    let mut directions = Vec::new();
    for &index in containing {
        let surface = &scene.surfaces()[index];
        let across = surface.normal(middle).cross(tangent);
        for step in [eps, -eps] {
            let p = surface.foot(middle + step * across);
            let (inside, outside) = scene.sides(index, p);
            materials.extend([inside, outside]);
            if let Some((pair, front_outside)) = scene.interface_at(index, p) {
                touching.push((pair, index, front_outside));
                directions.push(across * step.signum());
            }
        }
    }
    materials.sort_unstable();
    materials.dedup();
    // Nothing meets, or one interface runs on over the curve on the same surface.
    let runs_on = touching.len() == 2 && touching[0] == touching[1];
    let is_smooth = materials.len() < 3 && matches!(directions[..], [u, v] if u.dot(v) < -1.0 + SMOOTH);
    (!touching.is_empty() && !runs_on).then(|| CurvePiece {
        curve,
        low,
        high,
        materials,
        is_smooth,
        surfaces: containing.to_vec(),
        touching,
    })
}

/// 1 - cos of the fold up to which an interface counts as smooth: 0.01 degree.
const SMOOTH: f64 = 1.5e-8;

impl Truth {
    /// The directions in which interfaces leave `piece` at parameter `t`: unit vectors perpendicular to
    /// the curve.
    fn leaves(&self, piece: &CurvePiece, t: f64) -> Vec<DVec3> {
        let (place, tangent) = (piece.curve.at(t), piece.curve.tangent(t).normalize());
        let eps = 1e-5 * self.ball().1;
        let mut out = Vec::new();
        for &index in &piece.surfaces {
            let surface = &self.scene().surfaces()[index];
            let across = surface.normal(place).cross(tangent);
            for direction in [across, -across] {
                if self.scene().interface_at(index, surface.foot(place + eps * direction)).is_some() {
                    out.push(direction);
                }
            }
        }
        out
    }

    /// The smallest angle in degrees that a material fills around `piece` at parameter `t`. At the very ends of a piece
    /// other surfaces may count: ask a little inside.
    #[must_use]
    pub fn smallest_wedge(&self, piece: &CurvePiece, t: f64) -> f64 {
        let leaves = self.leaves(piece, t);
        let Some(&first) = leaves.first() else { return 360.0 };
        let second = piece.curve.tangent(t).normalize().cross(first);
        let mut angles: Vec<f64> =
            leaves.iter().map(|d| libm::atan2(d.dot(second), d.dot(first)).rem_euclid(TAU)).collect();
        angles.sort_by(f64::total_cmp);
        let turn = angles[0] + TAU;
        let next = angles.iter().skip(1).copied().chain([turn]);
        next.zip(&angles).map(|(b, a)| b - a).fold(TAU, f64::min).to_degrees()
    }
}
