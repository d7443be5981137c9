//! The fit of a corner (`corner`) to grey values.
//!
//! Grey values are those of `corner_rows`; here are the parameters.

use glam::{DMat3, DVec3};
use nalgebra::SVector;

use super::batch::{Batches, assemble};
use super::corner::{BEND, CORNER, Corner, CornerFit, FLATTEST, LEVEL, MATERIALS, SIGMA, TILT, lean};
use super::corner_rows::Known;
use super::frame::basis;
use super::least_squares::{ENOUGH, Model, Normal, Problem, minimise};
use super::sheet::{LevelPrior, Reading};

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
        let known = Known::new(self, &[[DVec3::ZERO; 2]; 3], &self.normals.map(basis), true);
        known.predict(&Batches::new(&[super::sheet::Sample { at, grey: 0.0 }]))
    }

    /// Fits to samples and anchors from here. `None` without a corner: a plane separates nothing, or no step is
    /// possible.
    #[must_use]
    pub(super) fn fit(
        &self,
        samples: &Batches,
        anchors: &[Anchor],
        prior: &CornerPrior,
        iterations: usize,
    ) -> Option<CornerFit> {
        if !self.is_complete() || self.determinant().abs() < FLATTEST {
            return None;
        }
        let frames = self.normals.map(basis);
        let bends = self.forms.iter().any(|f| *f != DMat3::ZERO) || prior.bends.iter().any(|b| b.1 > 0.0);
        let model = Blurred { samples, anchors, start: self, frames, bends, noise: prior.noise };
        let mut problem = Problem {
            active: [true; CORNER],
            prior: [(0.0, f64::INFINITY); CORNER],
            most: [0.8; CORNER],
            iterations,
            enough: ENOUGH,
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
        Some(CornerFit { corner, fit, tangents, frames, samples: samples.voxels() + anchors.len() })
    }
}

/// Entries uu, uv, vv of a form in a frame.
fn entries(form: DMat3, [u, v, _]: &[DVec3; 3]) -> [f64; 3] {
    [u.dot(form * *u), u.dot(form * *v), v.dot(form * *v)]
}

struct Blurred<'a> {
    samples: &'a Batches,
    anchors: &'a [Anchor],
    start: &'a Corner,
    /// Two tangents and the normal of each plane at the start.
    frames: [[DVec3; 3]; 3],
    /// Whether planes are or may get bent.
    bends: bool,
    noise: f64,
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
}

impl Model<CORNER> for Blurred<'_> {
    fn normal_equations(&self, x: &SVector<f64, CORNER>, equations: &mut Normal<CORNER>) -> f64 {
        let (corner, tangents) = self.corner(x);
        let known = Known::new(&corner, &tangents, &self.frames, self.bends);
        let reading = Reading::unclipped(self.noise);
        let mut chi2 = assemble(&known, self.samples, &reading, equations);
        for a in self.anchors {
            let weight = 1.0 / a.sigma;
            let off = corner.distance(a.plane, a.at) * weight;
            let row = lean(&corner, &tangents, &self.frames, a.plane, a.at);
            equations.add(&row.map(|v| v * weight), off);
            chi2 += off * off;
        }
        chi2
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
