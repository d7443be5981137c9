//! Where three planes meet: blurred octants about an apex, fitted to grey values.
//!
//! Planes through `a` with unit normals n1, n2, n3 split space into eight octants, numbered by bits: bit i is set
//! where `n_i . (q - a) > 0`. Each holds one of up to four materials. That covers corners of a block, convex and
//! concave, an edge that ends on another part's face, a block flush with others, and four blocks that meet.
//! In blur units the grey value is `sum over octants of level * share`; with `c_S`, the alternating sums of the
//! octants' levels, it is `sum over subsets S of planes of c_S Phi_S(h)`, `h_i = n_i . (q - a) / sigma`, and
//! `Phi_S` the share of the Gaussian on the positive side of all planes in S (`orthant`). Most `c_S` vanish:
//! a block in one material needs nothing but the share of all three.
//!
//! Fitted are the apex, two tilts of each normal, up to four levels with priors, and the logarithm of sigma.
//! A normal is `normalize(n + s u + t v)` with u, v, n orthonormal, derivatives exact, so tilts need not be small.
//!
//! Planes may be bent, where their curvature is about known (patches): plane i is `n . r = r' F r / 2` with the form F
//! (three parameters, with a prior), and a voxel sees its tangent plane: `h` less the sag there and half the
//! trace of F (as in `sheet`), and to first order the correlations `(n_i - F_i r) . (n_j - F_j r)`.
//!
//! Left out: corners of more than three planes (`cone`). A planar fit of a bent plane is wrong: the apex by about
//! 4 units squared over the radius of curvature, 0.15 for 30 units, and nothing but the misfit tells.

use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, SVector};

use super::least_squares::Fit;

/// Parameters of a corner.
pub(super) const CORNER: usize = 23;
/// Materials at most.
pub(super) const MATERIALS: usize = 4;
/// Places of the parameters: the apex stands first.
pub(super) const TILT: usize = 3;
pub(super) const LEVEL: usize = 9;
pub(super) const SIGMA: usize = LEVEL + MATERIALS;
pub(super) const BEND: usize = SIGMA + 1;

/// Normals whose determinant is smaller do not make a corner.
pub(super) const FLATTEST: f64 = 0.06;

/// Three planes through a point, and what lies between them, in blur units.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Corner {
    /// Where the planes meet.
    pub apex: DVec3,
    /// Unit normals.
    pub normals: [DVec3; 3],
    /// Material of each octant, below [`MATERIALS`].
    pub materials: [u8; 8],
    /// Grey level of each material.
    pub levels: [f64; MATERIALS],
    /// Logarithm of the factor on sigma.
    pub log_sigma: f64,
    /// How each plane bends: symmetric, its normal in the kernel; positive where it rises along its normal.
    pub forms: [DMat3; 3],
}

/// A corner and how well it fits.
#[derive(Debug, Clone)]
pub(super) struct CornerFit {
    /// The corner.
    pub corner: Corner,
    /// The fit. Its first parameters are the apex, then two tilts of each normal.
    pub fit: Fit<CORNER>,
    /// Derivative of each normal by its tilts, at the fit.
    pub tangents: [[DVec3; 2]; 3],
    /// Two tangents of each plane that its bend is told in, and its normal, at the start.
    pub frames: [[DVec3; 3]; 3],
    /// Samples used, anchors among them.
    pub samples: usize,
}

/// What lies along one of the six half-lines in which two planes meet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HalfLine {
    /// The two planes.
    pub planes: [usize; 2],
    /// Unit vector away from the apex.
    pub direction: DVec3,
    /// Materials around it, in order.
    pub around: [u8; 4],
    /// What it is.
    pub kind: LineKind,
}

/// Kinds of half-lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LineKind {
    /// No curve: at most one plane can be seen there.
    None,
    /// A sharp edge of the interface between two materials.
    Edge,
    /// Two edges of the same two materials that touch: octants of one material face each other across the line.
    Crossing,
    /// A curve where three or four materials meet.
    Junction,
}

impl Corner {
    /// The octant of a point.
    #[must_use]
    pub(super) fn octant(&self, at: DVec3) -> usize {
        (0..3).map(|i| usize::from(self.distance(i, at) > 0.0) << i).sum()
    }

    /// The material at a point.
    #[must_use]
    pub(super) fn material(&self, at: DVec3) -> u8 {
        self.materials[self.octant(at)]
    }

    /// Signed distance of a point from plane `i`.
    #[must_use]
    pub(super) fn distance(&self, i: usize, at: DVec3) -> f64 {
        let r = at - self.apex;
        let d = self.normals[i].dot(r);
        d - sag(self.forms[i], r, d)
    }

    /// The two materials that plane `i` separates at a point of it, on the negative and positive side; the same
    /// twice where the plane cannot be seen.
    #[cfg(test)]
    pub(super) fn sides(&self, i: usize, at: DVec3) -> [u8; 2] {
        let octant = self.octant(at);
        [self.materials[octant & !(1 << i)], self.materials[octant | 1 << i]]
    }

    /// The determinant of the normals: the volume of what they span, 1 for a cube's corner.
    #[must_use]
    pub(super) fn determinant(&self) -> f64 {
        self.normals[0].dot(self.normals[1].cross(self.normals[2]))
    }

    /// Whether each plane separates materials somewhere; else there is no corner.
    #[must_use]
    pub(super) fn is_complete(&self) -> bool {
        (0..3).all(|i| (0..8).any(|o| self.materials[o] != self.materials[o ^ (1 << i)]))
    }

    /// Which materials there are.
    #[must_use]
    pub(super) fn present(&self) -> [bool; MATERIALS] {
        std::array::from_fn(|m| self.materials.iter().any(|&o| usize::from(o) == m))
    }

    /// The six half-lines in which two planes meet, both directions for each pair; tangents, where planes are
    /// bent.
    #[must_use]
    pub(super) fn lines(&self) -> [HalfLine; 6] {
        std::array::from_fn(|k| {
            let [i, j] = [(k / 2 + 1) % 3, (k / 2 + 2) % 3];
            let line = self.normals[i].cross(self.normals[j]).normalize_or_zero();
            let direction = if k % 2 == 0 { line } else { -line };
            let side = usize::from(self.normals[k / 2].dot(direction) > 0.0) << (k / 2);
            let (a, b) = (1 << i, 1 << j);
            let around = [side, side | a, side | a | b, side | b].map(|o| self.materials[o]);
            HalfLine { planes: [i, j], direction, around, kind: LineKind::of(around) }
        })
    }

    /// The apex of three planes, each given by a point and a unit normal. `None` if the normals are nearly
    /// dependent.
    #[must_use]
    pub(super) fn meet(planes: &[(DVec3, DVec3); 3]) -> Option<DVec3> {
        let rows = DMat3::from_cols(planes[0].1, planes[1].1, planes[2].1).transpose();
        if rows.determinant().abs() < FLATTEST {
            return None;
        }
        let offsets = planes.map(|(point, normal)| normal.dot(point));
        Some(rows.inverse() * DVec3::from(offsets))
    }
}

impl LineKind {
    /// Of four materials in order around a line.
    fn of([a, b, c, d]: [u8; 4]) -> Self {
        let mut kinds = [a, b, c, d];
        kinds.sort_unstable();
        let count = 1 + kinds.windows(2).filter(|w| w[0] != w[1]).count();
        // Planes: a, b | d, c and b, c | a, d.
        if (a == b && c == d) || (b == c && a == d) {
            Self::None
        } else if count > 2 {
            Self::Junction
        } else if a == c && b == d {
            Self::Crossing
        } else {
            Self::Edge
        }
    }
}

impl CornerFit {
    /// Standard deviation of the position of plane `i` along its normal at a place, for white noise.
    #[must_use]
    pub(super) fn plane_sigma(&self, i: usize, at: DVec3) -> f64 {
        let g = SVector::from(lean(&self.corner, &self.tangents, &self.frames, i, at));
        (g.transpose() * self.fit.covariance * g)[(0, 0)].max(0.0).sqrt()
    }

    /// The covariance of the apex.
    #[must_use]
    pub(super) fn apex_covariance(&self) -> Matrix3<f64> {
        self.fit.covariance.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// Standard deviations of the apex along its principal directions, ascending.
    #[must_use]
    pub(super) fn apex_sigmas(&self) -> [f64; 3] {
        principal_sigmas(&self.apex_covariance())
    }

    /// Misfit per sample.
    #[must_use]
    pub(super) fn reduced(&self) -> f64 {
        self.fit.chi2 / self.samples.max(1) as f64
    }
}

/// Standard deviations along the principal directions of a covariance, ascending.
pub(super) fn principal_sigmas(covariance: &Matrix3<f64>) -> [f64; 3] {
    let values = covariance.symmetric_eigenvalues();
    let mut out = [values[0], values[1], values[2]].map(|v| v.max(0.0).sqrt());
    out.sort_unstable_by(f64::total_cmp);
    out
}

/// Derivatives of the distance of a place from plane `i`.
pub(super) fn lean(
    corner: &Corner,
    tangents: &[[DVec3; 2]; 3],
    frames: &[[DVec3; 3]; 3],
    i: usize,
    at: DVec3,
) -> [f64; CORNER] {
    let r = at - corner.apex;
    let mut row = [0.0; CORNER];
    row[..3].copy_from_slice(&(corner.forms[i] * r - corner.normals[i]).to_array());
    for k in 0..2 {
        row[TILT + 2 * i + k] = tangents[i][k].dot(r);
    }
    let (u, v) = (frames[i][0].dot(r), frames[i][1].dot(r));
    row[BEND + 3 * i..BEND + 3 * i + 3].copy_from_slice(&[-0.5 * u * u, -u * v, -0.5 * v * v]);
    row
}

/// How far a bent plane has risen at a place `r` from the apex that lies `d` above the tangent plane there: beside
/// the plane, not on it, the circle that it follows is nearer or farther.
#[inline]
pub(super) fn sag(form: DMat3, r: DVec3, d: f64) -> f64 {
    let rise = r.dot(form * r);
    let k = rise / (r.length_squared() - d * d).max(1e-9);
    0.5 * rise / (1.0 - k * d).clamp(0.5, 2.0)
}
