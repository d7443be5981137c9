//! The fit of a corner (`corner`) to grey values: the blurred octants and their derivatives.
//!
//! The share of a subset of planes falls with distance i by the flux through plane i inside the others, and changes
//! with the correlation of two planes by that along their line (`orthant`); the rest is the chain rule. Derivatives
//! are exact for planes; for bent ones those of the first order in the bends.

use glam::{DMat3, DVec3};
use nalgebra::SVector;

use super::corner::{BEND, CORNER, Corner, CornerFit, FLATTEST, LEVEL, MATERIALS, SIGMA, TILT, lean, sag};
use super::frame::basis;
use super::least_squares::{Model, Normal, Problem, minimise};
use super::orthant::Planes;
use super::sheet::{LevelPrior, Sample};

/// What is known before a fit of a corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct CornerPrior {
    /// Grey level of each material that may be there.
    pub levels: [Option<LevelPrior>; MATERIALS],
    /// Standard deviation of a grey value.
    pub noise: f64,
    /// Standard deviation of the logarithm of sigma; zero to hold sigma.
    pub log_sigma: f64,
    /// How each plane bends and the standard deviation of each entry, per unit; zero to hold it.
    pub bends: [(DMat3, f64); 3],
}

impl CornerPrior {
    /// The materials that may be there.
    pub(super) fn present(&self) -> Vec<u8> {
        (0..MATERIALS as u8).filter(|&m| self.levels[usize::from(m)].is_some()).collect()
    }
}

/// A place on one of the planes, known from a fit of that interface alone away from the corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Anchor {
    /// Which plane.
    pub plane: usize,
    /// The place, blur units from the window's middle.
    pub at: DVec3,
    /// Standard deviation along the plane's normal, blur units.
    pub sigma: f64,
}

impl Corner {
    /// The grey value at a point, blurred.
    #[cfg(test)]
    pub(super) fn blurred(&self, at: DVec3) -> f64 {
        let seen = Seen::new(self);
        let r = at - self.apex;
        let h = seen.distances(r);
        let value = dot(&seen.weights, &seen.planes.shares(h));
        if seen.bent { value + seen.turned(r, seen.planes.slopes(h, &seen.weights).1) } else { value }
    }

    /// Fits to samples and anchors from here. `None` without a corner: a plane separates nothing, or no step is
    /// possible.
    #[must_use]
    pub(super) fn fit(
        &self,
        samples: &[Sample],
        anchors: &[Anchor],
        prior: &CornerPrior,
        iterations: usize,
    ) -> Option<CornerFit> {
        if !self.is_complete() || self.determinant().abs() < FLATTEST {
            return None;
        }
        let frames = self.normals.map(basis);
        let bends = self.forms.iter().any(|f| *f != DMat3::ZERO) || prior.bends.iter().any(|b| b.1 > 0.0);
        let model = Blurred { samples, anchors, start: self, frames, bends, weight: 1.0 / prior.noise };
        let mut problem = Problem {
            active: [true; CORNER],
            prior: [(0.0, f64::INFINITY); CORNER],
            most: [0.8; CORNER],
            iterations,
        };
        let mut start = SVector::<f64, CORNER>::zeros();
        let present = self.present();
        for i in 0..3 {
            start[i] = self.apex[i];
        }
        for i in TILT..LEVEL {
            problem.most[i] = 0.35;
        }
        for m in 0..MATERIALS {
            start[LEVEL + m] = self.levels[m];
            problem.active[LEVEL + m] = present[m];
            problem.most[LEVEL + m] = f64::INFINITY;
            if present[m] {
                let level = prior.levels[m]?;
                problem.prior[LEVEL + m] = (level.mean, level.sigma);
            }
        }
        start[SIGMA] = self.log_sigma;
        problem.active[SIGMA] = prior.log_sigma > 0.0;
        problem.prior[SIGMA] = (0.0, prior.log_sigma.max(1e-6));
        problem.most[SIGMA] = 0.1;
        for (i, frame) in frames.iter().enumerate() {
            let (mean, given) = (entries(prior.bends[i].0, frame), entries(self.forms[i], frame));
            for k in 0..3 {
                let at = BEND + 3 * i + k;
                start[at] = given[k];
                problem.active[at] = prior.bends[i].1 > 0.0;
                problem.prior[at] = (mean[k], prior.bends[i].1.max(1e-9));
                problem.most[at] = 0.1;
            }
        }
        let fit = minimise(&model, &problem, start)?;
        let (corner, tangents) = model.corner(&fit.x);
        Some(CornerFit { corner, fit, tangents, frames, samples: samples.len() + anchors.len() })
    }
}

/// Entries uu, uv, vv of a form in a frame.
fn entries(form: DMat3, [u, v, _]: &[DVec3; 3]) -> [f64; 3] {
    [u.dot(form * *u), u.dot(form * *v), v.dot(form * *v)]
}

#[inline]
pub(super) fn dot(a: &[f64; 8], b: &[f64; 8]) -> f64 {
    (0..8).map(|i| a[i] * b[i]).sum()
}

/// The alternating sums of values of octants: coefficients of the shares of subsets.
pub(super) fn subset_weights(mut octants: [f64; 8]) -> [f64; 8] {
    for i in 0..3 {
        for o in 0..8 {
            if o & (1 << i) != 0 {
                octants[o] -= octants[o ^ (1 << i)];
            }
        }
    }
    octants
}

/// A corner made ready for many voxels.
pub(super) struct Seen {
    normals: [DVec3; 3],
    shrink: f64,
    forms: [DMat3; 3],
    bent: bool,
    pub(super) planes: Planes,
    /// Coefficients of the shares of subsets, for the grey value, and for each material's share.
    weights: [f64; 8],
    of: [[f64; 8]; MATERIALS],
}

impl Seen {
    pub(super) fn new(corner: &Corner) -> Self {
        let n = corner.normals;
        let of: [[f64; 8]; MATERIALS] = std::array::from_fn(|m| {
            subset_weights(corner.materials.map(|o| if usize::from(o) == m { 1.0 } else { 0.0 }))
        });
        let weights = std::array::from_fn(|s| (0..MATERIALS).map(|m| corner.levels[m] * of[m][s]).sum());
        let wanted = std::array::from_fn(|s| of.iter().any(|w| w[s].abs() > 0.5));
        let rho = [n[1].dot(n[2]), n[2].dot(n[0]), n[0].dot(n[1])];
        let shrink = libm::exp(-corner.log_sigma);
        let bent = corner.forms.iter().any(|f| *f != DMat3::ZERO);
        let planes = Planes::new(rho, wanted);
        Self { normals: n, shrink, forms: corner.forms, bent, planes, weights, of }
    }

    /// The same with all shares.
    pub(super) fn complete(corner: &Corner) -> Self {
        let n = corner.normals;
        let rho = [n[1].dot(n[2]), n[2].dot(n[0]), n[0].dot(n[1])];
        Self { planes: Planes::new(rho, [true; 8]), ..Self::new(corner) }
    }

    #[inline]
    pub(super) fn distances(&self, r: DVec3) -> [f64; 3] {
        if !self.bent {
            return self.normals.map(|n| n.dot(r) * self.shrink);
        }
        std::array::from_fn(|i| {
            let (d, form) = (self.normals[i].dot(r), self.forms[i]);
            (d - sag(form, r, d)) * self.shrink - 0.5 * trace(form) / self.shrink
        })
    }

    /// What it adds to the grey value that bent planes are turned at a place.
    #[inline]
    fn turned(&self, r: DVec3, by_rho: [f64; 3]) -> f64 {
        let turn = self.forms.map(|f| f * r);
        let rho = |i: usize, j: usize| {
            (-turn[i].dot(self.normals[j]) - turn[j].dot(self.normals[i])).clamp(-0.3, 0.3)
        };
        by_rho[0] * rho(1, 2) + by_rho[1] * rho(2, 0) + by_rho[2] * rho(0, 1)
    }
}

fn trace(form: DMat3) -> f64 {
    form.x_axis.x + form.y_axis.y + form.z_axis.z
}

struct Blurred<'a> {
    samples: &'a [Sample],
    anchors: &'a [Anchor],
    start: &'a Corner,
    /// Two tangents and the normal of each plane at the start.
    frames: [[DVec3; 3]; 3],
    /// Whether planes are or may get bent.
    bends: bool,
    weight: f64,
}

impl Blurred<'_> {
    /// The corner at `x`, and the derivatives of its normals.
    fn corner(&self, x: &SVector<f64, CORNER>) -> (Corner, [[DVec3; 2]; 3]) {
        let mut tangents = [[DVec3::ZERO; 2]; 3];
        let normals = std::array::from_fn(|i| {
            let [u, v, n] = self.frames[i];
            let m = n + u * x[TILT + 2 * i] + v * x[TILT + 2 * i + 1];
            let length = m.length();
            let normal = m / length;
            tangents[i] = [u, v].map(|t| (t - normal * normal.dot(t)) / length);
            normal
        });
        let corner = Corner {
            apex: DVec3::new(x[0], x[1], x[2]),
            normals,
            materials: self.start.materials,
            levels: std::array::from_fn(|m| x[LEVEL + m]),
            log_sigma: x[SIGMA],
            forms: std::array::from_fn(|i| {
                let [u, v, _] = self.frames[i];
                let [a, b, c] = [0, 1, 2].map(|k| x[BEND + 3 * i + k]);
                let (p, q) = (u * a + v * b, u * b + v * c);
                DMat3::from_cols(p * u.x + q * v.x, p * u.y + q * v.y, p * u.z + q * v.z)
            }),
        };
        (corner, tangents)
    }

    /// The prediction at a place and its derivatives.
    #[inline]
    fn row(
        &self,
        corner: &Corner,
        seen: &Seen,
        tangents: &[[DVec3; 2]; 3],
        at: DVec3,
    ) -> (f64, [f64; CORNER]) {
        let r = at - corner.apex;
        let h = seen.distances(r);
        let shares = seen.planes.shares(h);
        let (by_h, by_rho) = seen.planes.slopes(h, &seen.weights);
        let mut row = [0.0; CORNER];
        let n = &seen.normals;
        let m: [DVec3; 3] = std::array::from_fn(|i| n[i] - seen.forms[i] * r);
        let pull = (m[0] * by_h[0] + m[1] * by_h[1] + m[2] * by_h[2]) * -seen.shrink;
        row[..3].copy_from_slice(&pull.to_array());
        for i in 0..3 {
            let [j, k] = [(i + 1) % 3, (i + 2) % 3];
            // Correlations of plane i stand at the place of the plane that is not part of them.
            let turn = r * (by_h[i] * seen.shrink) + n[j] * by_rho[k] + n[k] * by_rho[j];
            for t in 0..2 {
                row[TILT + 2 * i + t] = tangents[i][t].dot(turn);
            }
        }
        for m in 0..MATERIALS {
            row[LEVEL + m] = dot(&seen.of[m], &shares);
        }
        row[SIGMA] = -(by_h[0] * h[0] + by_h[1] * h[1] + by_h[2] * h[2]);
        let mut value = dot(&seen.weights, &shares);
        if self.bends {
            value += seen.turned(r, by_rho);
            for i in 0..3 {
                let [j, k] = [(i + 1) % 3, (i + 2) % 3];
                row[SIGMA] -= by_h[i] * trace(seen.forms[i]) / seen.shrink;
                let [u, v, _] = self.frames[i];
                let (a, b, raise) = (u.dot(r), v.dot(r), 1.0 / (seen.shrink * seen.shrink));
                let h = by_h[i] * -0.5 * seen.shrink;
                let [p, q] = [u, v].map(|t| -t.dot(n[j]) * by_rho[k] - t.dot(n[k]) * by_rho[j]);
                row[BEND + 3 * i] = h * (a * a + raise) + a * p;
                row[BEND + 3 * i + 1] = h * 2.0 * a * b + b * p + a * q;
                row[BEND + 3 * i + 2] = h * (b * b + raise) + b * q;
            }
        }
        (value, row)
    }
}

/// Sums of products of the rows.
struct Rows {
    chi2: f64,
    square: [[f64; CORNER]; CORNER],
    right: [f64; CORNER],
    /// Whether bends are among the parameters.
    bends: bool,
}

impl Rows {
    #[inline]
    fn add(&mut self, residual: f64, row: &[f64; CORNER], weight: f64) {
        self.chi2 += (residual * weight).powi(2);
        if self.bends {
            self.products::<CORNER>(residual, row, weight * weight);
        } else {
            self.products::<BEND>(residual, row, weight * weight);
        }
    }

    /// Of the first `N` parameters.
    #[inline]
    fn products<const N: usize>(&mut self, residual: f64, row: &[f64; CORNER], weight: f64) {
        for (i, v) in row[..N].iter().enumerate() {
            let v = v * weight;
            for (sum, w) in self.square[i][..N].iter_mut().zip(&row[..N]) {
                *sum += v * w;
            }
            self.right[i] += v * residual;
        }
    }
}

impl Model<CORNER> for Blurred<'_> {
    fn normal_equations(&self, x: &SVector<f64, CORNER>, equations: &mut Normal<CORNER>) -> f64 {
        let (corner, tangents) = self.corner(x);
        let seen = Seen::new(&corner);
        let mut rows =
            Rows { chi2: 0.0, square: [[0.0; CORNER]; CORNER], right: [0.0; CORNER], bends: self.bends };
        for s in self.samples {
            let (value, row) = self.row(&corner, &seen, &tangents, s.at);
            rows.add(value - s.grey, &row, self.weight);
        }
        for a in self.anchors {
            rows.add(
                corner.distance(a.plane, a.at),
                &lean(&corner, &tangents, &self.frames, a.plane, a.at),
                1.0 / a.sigma,
            );
        }
        for i in 0..CORNER {
            for j in 0..=i {
                equations.matrix[(i, j)] += rows.square[i][j];
            }
            equations.right[i] += rows.right[i];
        }
        rows.chi2
    }

    fn is_possible(&self, x: &SVector<f64, CORNER>) -> bool {
        // Planes that pass through a common line turn the octants inside out.
        let det = self.corner(x).0.determinant();
        det.abs() >= FLATTEST && det * self.start.determinant() > 0.0
    }
}

#[cfg(test)]
#[path = "corner_tests.rs"]
mod tests;
