//! The surfaces that bound test objects: plane, sphere, infinite cylinder.
//!
//! Each has an exact signed distance (negative inside), an exact closest point and exact crossings
//! with a line. On all three, the closest point is the only local minimum of the distance to a given
//! point; the distance to a *trimmed* piece of them is therefore the distance to that point if it
//! belongs to the piece, and to the piece's rim otherwise (see [`super::Truth`]).

use glam::{DMat3, DVec3};

/// A surface without rim. Lengths in mm once placed in the world; inside is where the signed
/// distance is negative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// The half-space `normal · x < offset`.
    Plane {
        /// Unit normal, out of the half-space.
        normal: DVec3,
        /// Distance of the plane from the origin along `normal`.
        offset: f64,
    },
    /// A ball.
    Sphere {
        /// Its centre.
        centre: DVec3,
        /// Its radius.
        radius: f64,
    },
    /// An infinite round cylinder.
    Cylinder {
        /// A point of the axis.
        point: DVec3,
        /// Unit direction of the axis.
        axis: DVec3,
        /// Its radius.
        radius: f64,
    },
}

impl Surface {
    /// Exact signed distance from the surface: negative inside.
    #[must_use]
    pub fn signed_distance(&self, p: DVec3) -> f64 {
        match *self {
            Self::Plane { normal, offset } => normal.dot(p) - offset,
            Self::Sphere { centre, radius } => (p - centre).length() - radius,
            Self::Cylinder { point, axis, radius } => reject(p - point, axis).length() - radius,
        }
    }

    /// Unit normal, from inside to outside, of the level surface through `p`.
    #[must_use]
    pub fn normal(&self, p: DVec3) -> DVec3 {
        let radial = match *self {
            Self::Plane { normal, .. } => return normal,
            Self::Sphere { centre, .. } => p - centre,
            Self::Cylinder { point, axis, .. } => reject(p - point, axis),
        };
        // At the centre or on the axis every direction is as good as another.
        radial.try_normalize().unwrap_or_else(|| match *self {
            Self::Cylinder { axis, .. } => axis.any_orthonormal_vector(),
            _ => DVec3::X,
        })
    }

    /// The point of the surface closest to `p`.
    #[must_use]
    pub fn foot(&self, p: DVec3) -> DVec3 {
        p - self.signed_distance(p) * self.normal(p)
    }

    /// Parameters t (ascending) at which the line `p + t · d`, `d` of unit length, crosses the surface.
    #[must_use]
    pub fn crossings(&self, p: DVec3, d: DVec3) -> [Option<f64>; 2] {
        let (w, d, radius) = match *self {
            Self::Plane { normal, offset } => {
                let slope = normal.dot(d);
                let t = (offset - normal.dot(p)) / slope;
                return [t.is_finite().then_some(t), None];
            }
            Self::Sphere { centre, radius } => (p - centre, d, radius),
            Self::Cylinder { point, axis, radius } => (reject(p - point, axis), reject(d, axis), radius),
        };
        let (a, b, c) = (d.length_squared(), w.dot(d), w.length_squared() - radius * radius);
        let discriminant = b * b - a * c;
        if a < 1e-24 || discriminant <= 0.0 {
            return [None, None];
        }
        // The form without cancellation.
        let q = if b > 0.0 { -b - discriminant.sqrt() } else { -b + discriminant.sqrt() };
        let (s, t) = (q / a, c / q);
        [Some(s.min(t)), Some(s.max(t))]
    }

    /// The surface rotated, then scaled, then shifted.
    #[must_use]
    pub fn placed(&self, rotation: &DMat3, scale: f64, shift: DVec3) -> Self {
        let at = |p: DVec3| shift + *rotation * (p * scale);
        match *self {
            Self::Plane { normal, offset } => {
                let normal = (*rotation * normal).normalize();
                Self::Plane { normal, offset: offset * scale + normal.dot(shift) }
            }
            Self::Sphere { centre, radius } => Self::Sphere { centre: at(centre), radius: radius * scale },
            Self::Cylinder { point, axis, radius } => Self::Cylinder {
                point: at(point),
                axis: (*rotation * axis).normalize(),
                radius: radius * scale,
            },
        }
    }
}

/// The part of `v` perpendicular to the unit vector `axis`.
pub(super) fn reject(v: DVec3, axis: DVec3) -> DVec3 {
    v - v.dot(axis) * axis
}

/// Rotation about x, then y, then z by degrees. The sines come from `libm`, so that every platform
/// makes the same object.
pub(super) fn rotation(degrees: [f64; 3]) -> DMat3 {
    let [x, y, z] = degrees.map(|d| libm::sincos(d * (std::f64::consts::PI / 180.0)));
    let rx = DMat3::from_cols(DVec3::X, DVec3::new(0.0, x.1, x.0), DVec3::new(0.0, -x.0, x.1));
    let ry = DMat3::from_cols(DVec3::new(y.1, 0.0, -y.0), DVec3::Y, DVec3::new(y.0, 0.0, y.1));
    let rz = DMat3::from_cols(DVec3::new(z.1, z.0, 0.0), DVec3::new(-z.0, z.1, 0.0), DVec3::Z);
    rz * ry * rx
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feet_lie_on_the_surface_at_the_stated_distance_and_crossings_have_distance_zero() {
        let surfaces = [
            Surface::Plane { normal: DVec3::new(0.6, 0.0, 0.8), offset: 0.3 },
            Surface::Sphere { centre: DVec3::new(0.1, 0.2, 0.3), radius: 0.7 },
            Surface::Cylinder { point: DVec3::ONE, axis: DVec3::new(0.0, 0.6, 0.8), radius: 0.9 },
        ];
        let turn = rotation([10.0, 20.0, 30.0]);
        assert!((turn.determinant() - 1.0).abs() < 1e-12);
        for surface in surfaces {
            for k in 0..200 {
                let k = f64::from(k);
                let p = DVec3::new((k * 0.7).sin(), (k * 1.3).cos(), (k * 0.31).sin()) * 2.0;
                let foot = surface.foot(p);
                assert!(surface.signed_distance(foot).abs() < 1e-12);
                assert!(((p - foot).length() - surface.signed_distance(p).abs()).abs() < 1e-12);
                let d = DVec3::new((k * 0.9).cos(), (k * 0.4).sin(), 0.5).normalize();
                for t in surface.crossings(p, d).into_iter().flatten() {
                    assert!(surface.signed_distance(p + t * d).abs() < 1e-9 * t.abs().max(1.0));
                }
                let placed = surface.placed(&turn, 2.0, DVec3::new(1.0, -1.0, 3.0));
                let q = DVec3::new(1.0, -1.0, 3.0) + turn * (p * 2.0);
                assert!((placed.signed_distance(q) - 2.0 * surface.signed_distance(p)).abs() < 1e-11);
            }
        }
    }
}
