//! How well shaped a triangle is.
//!
//! Method: q = 4 sqrt(3) S / (l1^2 + l2^2 + l3^2) of 000_f7f54f44c17ac186, eq. 14: 1 for an
//! equilateral triangle, 0 for one without area.

use glam::DVec3;

/// The quality q of a triangle: 0 (no area) to 1 (equilateral); a single point counts as 0.
#[must_use]
pub fn triangle_quality([a, b, c]: [DVec3; 3]) -> f64 {
    let (s, t, u) = (b - a, c - b, a - c);
    let squares = s.length_squared() + t.length_squared() + u.length_squared();
    if squares > 0.0 {
        // 4 sqrt(3) S with S = |cross| / 2; rounding must not lift it over 1.
        (2.0 * 3f64.sqrt() * s.cross(t).length() / squares).min(1.0)
    } else {
        0.0
    }
}

/// The smallest angle of a triangle, degrees; 0 without area.
#[must_use]
pub fn smallest_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let at = |p: DVec3, q: DVec3, r: DVec3| {
        let (s, t) = (q - p, r - p);
        s.cross(t).length().atan2(s.dot(t))
    };
    at(a, b, c).min(at(b, c, a)).min(at(c, a, b)).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equilateral_is_one_and_flat_is_zero() {
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
        assert!((triangle_quality([x, y, z]) - 1.0).abs() < 1e-15);
        assert!((smallest_angle([x, y, z]) - 60.0).abs() < 1e-12);
        assert!(triangle_quality([x, 2.0 * x, 4.0 * x]).abs() < 1e-15);
        assert!(triangle_quality([x, x, x]).abs() < 1e-15);
    }
}
