//! Curves in which two surfaces cross: lines, circles and ellipses, in closed form.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::surface::{Surface, reject};

/// A parametrised curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Curve {
    /// `point + t · direction`, `direction` of unit length.
    Line {
        /// The point at t = 0.
        point: DVec3,
        /// Unit direction.
        direction: DVec3,
    },
    /// `centre + cos t · a + sin t · b`, `a` perpendicular to `b`.
    Ellipse {
        /// The centre.
        centre: DVec3,
        /// Half axis at t = 0.
        a: DVec3,
        /// Half axis at t = π/2.
        b: DVec3,
    },
}

/// The curves in which two different surfaces cross. `None`: this kind of crossing has no closed form
/// here (sphere or cylinder with sphere or cylinder); scenes are built so that such surfaces do not meet.
pub(super) fn crossing(first: &Surface, second: &Surface) -> Option<Vec<Curve>> {
    use Surface::{Cylinder, Plane, Sphere};
    Some(match (*first, *second) {
        (Plane { normal: n, offset: d }, Plane { normal: m, offset: e }) => {
            let direction = n.cross(m);
            let squared = direction.length_squared();
            if squared < 1e-18 {
                return Some(Vec::new());
            }
            let point = (d * m.cross(direction) + e * direction.cross(n)) / squared;
            vec![Curve::Line { point, direction: direction / squared.sqrt() }]
        }
        (plane @ Plane { normal, .. }, Sphere { centre, radius }) => {
            let distance = plane.signed_distance(centre);
            let squared = radius * radius - distance * distance;
            if squared <= 0.0 {
                return Some(Vec::new());
            }
            let (a, b) = normal.any_orthonormal_pair();
            let r = squared.sqrt();
            vec![Curve::Ellipse { centre: centre - distance * normal, a: a * r, b: b * r }]
        }
        (plane @ Plane { normal, .. }, Cylinder { point, axis, radius }) => {
            let slope = normal.dot(axis);
            if slope.abs() < 1e-9 {
                let distance = plane.signed_distance(point);
                let squared = radius * radius - distance * distance;
                // A plane that touches the cylinder does not cross it, whatever rounding makes of it.
                if squared <= 1e-10 * radius * radius {
                    return Some(Vec::new());
                }
                let across = normal.cross(axis).normalize() * squared.sqrt();
                let middle = point - distance * normal;
                let line = |point| Curve::Line { point, direction: axis };
                return Some(vec![line(middle - across), line(middle + across)]);
            }
            let centre = point - plane.signed_distance(point) / slope * axis;
            let a = axis.cross(normal).try_normalize().unwrap_or_else(|| axis.any_orthonormal_vector());
            let b = normal.cross(a).normalize();
            // The long half axis is r / cos of the angle between the plane's normal and the axis.
            vec![Curve::Ellipse { centre, a: a * radius, b: b * (radius / slope.abs()) }]
        }
        (_, Plane { .. }) => return crossing(second, first),
        _ => return None,
    })
}

impl Curve {
    /// The point at parameter `t`.
    #[must_use]
    pub fn at(&self, t: f64) -> DVec3 {
        match *self {
            Self::Line { point, direction } => point + t * direction,
            Self::Ellipse { centre, a, b } => {
                let (sin, cos) = libm::sincos(t);
                centre + cos * a + sin * b
            }
        }
    }

    /// The derivative by `t` (not of unit length on an ellipse).
    #[must_use]
    pub fn tangent(&self, t: f64) -> DVec3 {
        match *self {
            Self::Line { direction, .. } => direction,
            Self::Ellipse { a, b, .. } => {
                let (sin, cos) = libm::sincos(t);
                cos * b - sin * a
            }
        }
    }

    /// Radius of curvature at parameter `t`; infinite on a line.
    #[must_use]
    pub fn radius(&self, t: f64) -> f64 {
        match *self {
            Self::Line { .. } => f64::INFINITY,
            // |c'|^3 / |c' x c''|, and that product is |a| |b| everywhere.
            Self::Ellipse { a, b, .. } => self.tangent(t).length().powi(3) / (a.length() * b.length()),
        }
    }

    /// The parameter range that can lie in the ball: for an ellipse always one whole turn.
    pub(super) fn range(&self, ball: (DVec3, f64)) -> Option<(f64, f64)> {
        match *self {
            Self::Line { point, direction } => {
                let middle = (ball.0 - point).dot(direction);
                let away = reject(ball.0 - point, direction).length_squared();
                let squared = ball.1 * ball.1 - away;
                (squared > 0.0).then(|| (middle - squared.sqrt(), middle + squared.sqrt()))
            }
            Self::Ellipse { .. } => Some((0.0, TAU)),
        }
    }

    /// The parameter in `[low, high]` whose point is closest to `q`.
    #[must_use]
    pub fn closest(&self, q: DVec3, low: f64, high: f64) -> f64 {
        match *self {
            Self::Line { point, direction } => (q - point).dot(direction).clamp(low, high),
            Self::Ellipse { centre, a, b } => closest_on_ellipse(q - centre, a, b, low, high),
        }
    }

    /// Length between two parameters.
    #[must_use]
    pub fn length(&self, low: f64, high: f64) -> f64 {
        match *self {
            Self::Line { .. } => high - low,
            Self::Ellipse { .. } => {
                // The midpoint rule converges very fast on a smooth, nearly constant speed.
                let width = (high - low) / 2000.0;
                (0..2000).map(|k| width * self.tangent(low + (f64::from(k) + 0.5) * width).length()).sum()
            }
        }
    }

    /// Points along `[low, high]`, at most `step` apart, each with the length of curve it stands for.
    #[must_use]
    pub fn samples(&self, low: f64, high: f64, step: f64) -> Vec<(DVec3, f64)> {
        let speed = match *self {
            Self::Line { .. } => 1.0,
            Self::Ellipse { a, b, .. } => a.length().max(b.length()),
        };
        let count = ((high - low) * speed / step).ceil().max(1.0);
        let width = (high - low) / count;
        (0..count as usize)
            .map(|k| {
                let t = low + (k as f64 + 0.5) * width;
                (self.at(t), width * self.tangent(t).length())
            })
            .collect()
    }
}

/// Starts of the search on an ellipse: enough that the best one is in the valley of the global minimum
/// for axis ratios below about 10.
const ELLIPSE_STARTS: usize = 64;

fn closest_on_ellipse(q: DVec3, a: DVec3, b: DVec3, low: f64, high: f64) -> f64 {
    let (aa, bb) = (a.length_squared(), b.length_squared());
    let (qa, qb) = (q.dot(a), q.dot(b));
    // |q - c(t)|² / 2 up to a constant.
    let value = |t: f64| {
        let (s, c) = libm::sincos(t);
        0.5 * (aa * c * c + bb * s * s) - qa * c - qb * s
    };
    if (aa - bb).abs() <= 1e-14 * aa {
        let t = libm::atan2(qb, qa);
        let t = t - ((t - low) / TAU).floor() * TAU;
        return match (t <= high, value(low) <= value(high)) {
            (true, _) => t,
            (false, true) => low,
            (false, false) => high,
        };
    }
    let step = (high - low) / ELLIPSE_STARTS as f64;
    let start = (0..=ELLIPSE_STARTS)
        .map(|k| low + k as f64 * step)
        .min_by(|s, t| value(*s).total_cmp(&value(*t)))
        .unwrap_or(low);
    // The minimum is between the neighbours of the best start: Newton, halving where it leaves them.
    // A whole turn has no ends to stop at.
    let closed = high - low > TAU - 1e-9;
    let stop = |t: f64| if closed { t } else { t.clamp(low, high) };
    let (mut left, mut right) = (stop(start - step), stop(start + step));
    let mut t = start;
    for _ in 0..60 {
        let (s, c) = libm::sincos(t);
        let slope = (bb - aa) * s * c + qa * s - qb * c;
        let curvature = (bb - aa) * (c * c - s * s) + qa * c + qb * s;
        if slope > 0.0 {
            right = t;
        } else {
            left = t;
        }
        let newton = t - slope / curvature;
        let next = if newton > left && newton < right { newton } else { 0.5 * (left + right) };
        let done = (next - t).abs() < 1e-15 * PI;
        t = next;
        if done {
            break;
        }
    }
    match closed {
        true if t < low => t + TAU,
        true if t > high => t - TAU,
        _ => t,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crossing_curves_lie_on_both_surfaces() {
        let plane = Surface::Plane { normal: DVec3::new(0.6, 0.0, 0.8), offset: 0.3 };
        let flat = Surface::Plane { normal: DVec3::Z, offset: 0.1 };
        let sphere = Surface::Sphere { centre: DVec3::new(0.1, 0.2, 0.3), radius: 0.7 };
        let cylinder = Surface::Cylinder { point: DVec3::new(0.1, 0.0, 0.0), axis: DVec3::Z, radius: 0.9 };
        let wall = Surface::Plane { normal: DVec3::X, offset: 0.4 };
        let pairs = [(plane, flat), (sphere, plane), (plane, cylinder), (flat, cylinder), (wall, cylinder)];
        for (first, second) in pairs {
            let curves = crossing(&first, &second).unwrap();
            assert!(!curves.is_empty());
            for curve in curves {
                for k in 0..50 {
                    let p = curve.at(f64::from(k) * 0.13);
                    assert!(first.signed_distance(p).abs() < 1e-12);
                    assert!(second.signed_distance(p).abs() < 1e-12);
                }
            }
        }
        assert!(crossing(&sphere, &cylinder).is_none());
    }

    #[test]
    fn the_closest_point_of_an_ellipse_beats_dense_samples() {
        let a = DVec3::new(1.0, 0.0, 0.0);
        for b in [DVec3::new(0.0, 1.0, 0.0), DVec3::new(0.0, 2.5, 0.0)] {
            let curve = Curve::Ellipse { centre: DVec3::new(0.3, 0.2, 0.1), a, b };
            for k in 0..100 {
                let k = f64::from(k);
                let q = DVec3::new((k * 0.7).sin(), (k * 1.3).cos(), (k * 0.31).sin()) * 3.0;
                for (low, high) in [(0.0, TAU), (0.5, 2.0), (3.0, 6.5)] {
                    let t = curve.closest(q, low, high);
                    assert!(t >= low && t <= high);
                    let best = (curve.at(t) - q).length();
                    let n = 2000;
                    let dense = (0..=n)
                        .map(|i| (curve.at(low + (high - low) * f64::from(i) / f64::from(n)) - q).length())
                        .fold(f64::INFINITY, f64::min);
                    assert!(best <= dense + 1e-12, "{best} {dense}");
                }
            }
        }
    }
}
