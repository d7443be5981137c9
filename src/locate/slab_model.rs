//! Something thin: two interfaces nearer to each other than the blur reaches, fitted together.
//!
//! In a frame (u, v, w) with w across, the middle surface is the paraboloid of [`sheet`](super::sheet); the faces are it
//! less and plus half the thickness, each tilted a little by half of how the thickness changes. With `d1`, `d2` as there,
//!
//! ```text
//! grey = before + (within - before) Phi(d1) + (after - within) Phi(d2)
//! ```
//!
//! The peak of a thin plate is below its material's grey value: thickness and level make up for each other. So the
//! level is held by what is known of it elsewhere, and the standard deviation of the thickness has its share.
//!
//! Left out: that curved faces are concentric (thickness times curvature is small), and rims.

use glam::{DMat3, DVec3};
use nalgebra::{SMatrix, SVector};

use super::batch::{BATCH, Batch, Batches, Rows, Sums, assemble, dot};
use super::frame::basis;
use super::gauss::TABLES;
use super::least_squares::{ENOUGH, Fit, Model, Normal, Problem, minimise};
use super::normal::{bell, density, distribution};
use super::sheet::{LevelPrior, Reading, Sample, Sheet};

/// Parameters: height of the middle, two tilts, three curvatures, half the thickness, two tilts of the faces against the
/// middle, levels before, within and after, logarithm of the blur in blur units.
pub(super) const PARAMETERS: usize = 13;
/// The parameter of the level within, and of the blur.
pub(super) const WITHIN: usize = 10;
pub(super) const BLUR: usize = 12;

/// Prior standard deviations of curvatures and of the tilts of the faces against the middle.
const CURVATURE: f64 = 0.3;
const TAPER: f64 = 0.1;
/// Half a thickness below this is nothing, blur units.
const THINNEST: f64 = 0.15;

/// A fitted slab, in blur units about the window's middle.
#[derive(Debug, Clone)]
pub(super) struct Slab {
    /// Where the frame starts.
    pub origin: DVec3,
    /// Columns u, v, w; w goes from before to after.
    pub axes: DMat3,
    /// The fit.
    pub fit: Fit<PARAMETERS>,
}

struct TwoSteps<'a> {
    samples: &'a Batches,
    origin: DVec3,
    axes: DMat3,
    reading: Reading,
}

/// The parameters and the frame, as every voxel needs them.
struct Known {
    origin: [f32; 3],
    axes: [[f32; 3]; 3],
    x: [f32; PARAMETERS],
    /// One over the factor on sigma.
    sharper: f32,
}

impl Rows<PARAMETERS> for Known {
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // loops over batches, for SIMD
    fn add(&self, batch: &Batch, reading: &Reading, sums: &mut Sums<PARAMETERS>) {
        let zero = [0.0; BATCH];
        let (mut rows, mut predicted) = ([zero; PARAMETERS], zero);
        let (mut shares, mut slopes, mut wider) = ([zero; 2], [zero; 2], zero);
        let (x, o, [a, b, c]) = (&self.x, &self.origin, &self.axes);
        let steps = [x[WITHIN] - x[9], x[11] - x[WITHIN]];
        for i in 0..BATCH {
            let p = [batch.at[0][i] - o[0], batch.at[1][i] - o[1], batch.at[2][i] - o[2]];
            let (u, v, w) = (dot(a, &p), dot(b, &p), dot(c, &p));
            let bend = [x[3] * u + x[4] * v, x[4] * u + x[5] * v];
            let (uu, vv) = (0.5 * (u * u + 1.0), 0.5 * (v * v + 1.0));
            let bow = x[3] * uu + x[5] * vv + x[4] * u * v;
            for k in 0..2 {
                let side = if k == 0 { -1.0 } else { 1.0 };
                let tilt = [x[1] + side * x[7], x[2] + side * x[8]];
                let lean = [tilt[0] + bend[0], tilt[1] + bend[1]];
                let scale = self.sharper / (1.0 + lean[0] * lean[0] + lean[1] * lean[1]).sqrt();
                let off = w - (x[0] + side * x[6] + tilt[0] * u + tilt[1] * v + bow);
                let d = off * scale;
                let bell = bell(d);
                shares[k][i] = distribution(d, bell);
                slopes[k][i] = -steps[k] * density(bell) * scale;
                // What a wider blur does to the height of curved faces is left out.
                wider[i] += slopes[k][i] * off;
            }
            predicted[i] = x[9] + steps[0] * shares[0][i] + steps[1] * shares[1][i];
            rows[1][i] = u;
            rows[2][i] = v;
            rows[3][i] = uu;
            rows[4][i] = u * v;
            rows[5][i] = vv;
        }
        let [residuals, weights] = batch.residuals(reading, &predicted);
        for i in 0..BATCH {
            let weight = weights[i];
            let both = (slopes[0][i] + slopes[1][i]) * weight;
            let apart = (slopes[1][i] - slopes[0][i]) * weight;
            rows[0][i] = both;
            rows[6][i] = apart;
            rows[7][i] = apart * rows[1][i];
            rows[8][i] = apart * rows[2][i];
            for row in &mut rows[1..6] {
                row[i] *= both;
            }
            rows[9][i] = (1.0 - shares[0][i]) * weight;
            rows[WITHIN][i] = (shares[0][i] - shares[1][i]) * weight;
            rows[11][i] = shares[1][i] * weight;
            rows[BLUR][i] = wider[i] * weight;
        }
        sums.add(&rows, &residuals);
    }
}

impl Model<PARAMETERS> for TwoSteps<'_> {
    fn normal_equations(&self, x: &SVector<f64, PARAMETERS>, equations: &mut Normal<PARAMETERS>) -> f64 {
        let known = Known {
            origin: self.origin.as_vec3().to_array(),
            axes: self.axes.to_cols_array_2d().map(|axis| axis.map(|c| c as f32)),
            x: std::array::from_fn(|i| x[i] as f32),
            sharper: libm::exp(-x[BLUR]) as f32,
        };
        assemble(&known, self.samples, &self.reading, equations)
    }

    fn is_possible(&self, x: &SVector<f64, PARAMETERS>) -> bool {
        x[6] > THINNEST
    }
}

/// Where a fit of a slab starts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    /// A point near the middle surface.
    pub at: DVec3,
    /// About its normal, from before to after.
    pub normal: DVec3,
    /// About half the thickness.
    pub half: f64,
}

/// Fits a slab. `levels`: before, within, after. `noise` is the standard deviation of a grey value. `None` where there is
/// no such fit.
#[must_use]
pub(super) fn fit_slab(
    samples: &[Sample],
    start: Start,
    levels: [LevelPrior; 3],
    noise: f64,
) -> Option<Slab> {
    fit_blurred_slab(samples, start, levels, (0.0, 0.0), 1.0, noise)
}

/// The same with a prior of the blur's logarithm (one of no width fixes it), and curvatures and taper held more or
/// less: what is fitted together for many places must not follow the noise of each.
#[must_use]
pub(super) fn fit_blurred_slab(
    samples: &[Sample],
    start: Start,
    levels: [LevelPrior; 3],
    blur: (f64, f64),
    freedom: f64,
    noise: f64,
) -> Option<Slab> {
    let mut slab: Option<Slab> = None;
    let mut start = start;
    let mut curvature = [0.0; 3];
    let mut means = levels.map(|l| l.mean);
    let mut problem = Problem {
        active: [true; PARAMETERS],
        prior: [(0.0, f64::INFINITY); PARAMETERS],
        most: [0.7, 0.4, 0.4, 0.3, 0.3, 0.3, 0.5, 0.2, 0.2, f64::INFINITY, f64::INFINITY, f64::INFINITY, 0.1],
        iterations: 5,
        enough: ENOUGH,
    };
    problem.active[BLUR] = blur.1 > 0.0;
    problem.prior[BLUR] = blur;
    let mut log_blur = blur.0;
    problem.prior[3..6].fill((0.0, freedom * CURVATURE));
    problem.prior[7..9].fill((0.0, freedom * TAPER));
    for (prior, level) in problem.prior[9..BLUR].iter_mut().zip(levels) {
        *prior = (level.mean, level.sigma);
    }
    let samples = &Batches::new(samples);
    let reading = Reading::unclipped(noise);
    for pass in 0..2 {
        let axes = DMat3::from_cols_array_2d(&basis(start.normal).map(|a| a.to_array()));
        let model = TwoSteps { samples, origin: start.at, axes, reading };
        let mut x = SVector::<f64, PARAMETERS>::zeros();
        x.as_mut_slice()[3..6].copy_from_slice(&curvature);
        x[6] = start.half;
        x.as_mut_slice()[9..BLUR].copy_from_slice(&means);
        x[BLUR] = log_blur;
        let fit = minimise(&model, &problem, x)?;
        let x = fit.x;
        let done = slab.insert(Slab { origin: start.at, axes, fit });
        if pass == 1 || (x[1].hypot(x[2]) < 0.05 && x[0].abs() < 0.2) {
            break;
        }
        start = Start { at: done.middle(), normal: done.normal(), half: x[6] };
        let turned = DMat3::from_cols_array_2d(&basis(start.normal).map(|a| a.to_array()));
        let [u, v] = [turned.x_axis, turned.y_axis].map(|a| done.axes.transpose() * a);
        let form = |a: DVec3, b: DVec3| x[3] * a.x * b.x + x[4] * (a.x * b.y + a.y * b.x) + x[5] * a.y * b.y;
        curvature = [form(u, u), form(u, v), form(v, v)];
        means = [x[9], x[10], x[11]];
        log_blur = x[BLUR];
        problem.iterations = 8;
    }
    slab
}

impl Slab {
    /// The point of the middle surface at the frame's axis.
    #[must_use]
    pub(super) fn middle(&self) -> DVec3 {
        self.origin + self.axes.z_axis * self.fit.x[0]
    }

    /// Its unit normal, from before to after.
    #[must_use]
    pub(super) fn normal(&self) -> DVec3 {
        (self.axes * DVec3::new(-self.fit.x[1], -self.fit.x[2], 1.0)).normalize()
    }

    /// Half the thickness at the frame's axis.
    #[must_use]
    pub(super) fn half(&self) -> f64 {
        self.fit.x[6] / (1.0 + self.fit.x[1].powi(2) + self.fit.x[2].powi(2)).sqrt()
    }

    /// Standard deviation of half the thickness, for white noise.
    #[must_use]
    pub(super) fn half_sigma(&self) -> f64 {
        self.fit.covariance[(6, 6)].max(0.0).sqrt()
    }

    /// The larger principal curvature by size.
    #[must_use]
    pub(super) fn curvature(&self) -> f64 {
        let x = &self.fit.x;
        (0.5 * (x[3] + x[5])).abs() + (0.25 * (x[3] - x[5]).powi(2) + x[4] * x[4]).sqrt()
    }

    /// By how much its faces are tilted against the middle.
    #[must_use]
    pub(super) fn taper(&self) -> f64 {
        self.fit.x[7].hypot(self.fit.x[8])
    }

    /// Distances of a place from the faces: before the first both are negative, behind the second positive.
    #[must_use]
    pub(super) fn distances(&self, at: DVec3) -> [f64; 2] {
        let x = &self.fit.x;
        let q = self.axes.transpose() * (at - self.origin);
        let (u, v) = (q.x, q.y);
        let bend = [x[3] * u + x[4] * v, x[4] * u + x[5] * v];
        [-1.0, 1.0].map(|side| {
            let tilt = [x[1] + side * x[7], x[2] + side * x[8]];
            let scale = 1.0 / (1.0 + (tilt[0] + bend[0]).powi(2) + (tilt[1] + bend[1]).powi(2)).sqrt();
            let height = x[0] + side * x[6] + (tilt[0] + 0.5 * bend[0]) * u + (tilt[1] + 0.5 * bend[1]) * v;
            (q.z - height) * scale
        })
    }

    /// Distance of a place from the axis of the frame.
    #[must_use]
    pub(super) fn aside(&self, at: DVec3) -> f64 {
        let q = self.axes.transpose() * (at - self.origin);
        q.x.hypot(q.y)
    }

    /// The larger of its steps in grey value.
    #[must_use]
    pub(super) fn contrast(&self) -> f64 {
        let x = &self.fit.x;
        (x[WITHIN] - x[9]).abs().max((x[11] - x[WITHIN]).abs())
    }

    /// The direction along the slab from its frame's axis to a place.
    #[must_use]
    pub(super) fn outwards(&self, at: DVec3) -> Option<DVec3> {
        let q = self.axes.transpose() * (at - self.origin);
        (self.axes * DVec3::new(q.x, q.y, 0.0)).try_normalize()
    }

    /// The grey value where a place would be if the slab went on as it is.
    #[must_use]
    pub(super) fn grey(&self, at: DVec3) -> f64 {
        let [first, second] = self.distances(at).map(|d| TABLES.distribution(d));
        let x = &self.fit.x;
        x[9] + (x[WITHIN] - x[9]) * first + (x[11] - x[WITHIN]) * second
    }

    /// The first or the second face as a sheet of its own, its normal as the slab's.
    #[must_use]
    pub(super) fn face(&self, second: bool) -> Sheet {
        let side = if second { 1.0 } else { -1.0 };
        let mut from = SMatrix::<f64, 8, PARAMETERS>::zeros();
        (0..6).for_each(|k| from[(k, k)] = 1.0);
        (0..3).for_each(|k| from[(k, 6 + k)] = side);
        from[(6, 9 + usize::from(second))] = 1.0;
        from[(7, 10 + usize::from(second))] = 1.0;
        let Fit { chi2, strain, converged, .. } = self.fit;
        let covariance = from * self.fit.covariance * from.transpose();
        let fit = Fit { x: from * self.fit.x, chi2, strain, covariance, converged };
        Sheet { origin: self.origin, axes: self.axes, fit }
    }
}

/// The share of the contrast at the middle of a slab of half thickness `half`.
#[must_use]
pub(super) fn peak(half: f64) -> f64 {
    2.0 * TABLES.distribution(half) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::locate::fixtures::{cylinder, distribution, noisy, rms, window};

    fn prior(levels: [f64; 3]) -> [LevelPrior; 3] {
        levels.map(|mean| LevelPrior { mean, sigma: 0.3 })
    }

    fn normal() -> DVec3 {
        DVec3::new(0.5, 0.3, 0.8).normalize()
    }

    fn start(half: f64) -> Start {
        let normal = (normal() + normal().any_orthonormal_vector() * 0.2).normalize();
        Start { at: normal * 0.3, normal, half }
    }

    /// Grey values of a flat slab about the origin.
    fn flat(half: f64, [before, within, after]: [f64; 3]) -> Vec<Sample> {
        window(3.4, |at| {
            let w = at.dot(normal());
            before + (within - before) * distribution(w + half) + (after - within) * distribution(w - half)
        })
    }

    #[test]
    fn flat_slabs_are_found_exactly_whatever_is_around() {
        for levels in [[20.0, 120.0, 20.0], [120.0, 20.0, 120.0], [60.0, 20.0, 150.0]] {
            for half in [0.8, 1.05, 1.3, 1.8] {
                let slab = fit_slab(&flat(half, levels), start(1.0), prior(levels), 1.0).unwrap();
                assert!((slab.half() - half).abs() < 2e-3, "{half}: {}", slab.half());
                let [a, b] = slab.distances(DVec3::ZERO);
                assert!((a - half).abs() < 2e-3 && (b + half).abs() < 2e-3, "{half}: {a} {b}");
                for second in [false, true] {
                    let face = slab.face(second);
                    assert!(face.normal_at(0.3, 0.2).dot(normal()) > 0.9999);
                    let at = if second { half } else { -half };
                    for (u, v) in [(0.0, 0.0), (0.9, -0.7)] {
                        assert!((face.point(u, v).dot(normal()) - at).abs() < 3e-3, "{second}");
                    }
                    assert!((face.fit.x[6] - levels[usize::from(second)]).abs() < 0.1);
                }
            }
        }
    }

    #[test]
    fn the_wall_of_a_tube_has_its_thickness() {
        let axis = normal().any_orthonormal_vector();
        // What the paraboloids leave out is of third order in curvature.
        for (radius, bound) in [(8.0, 0.035), (14.0, 0.02)] {
            let half = 1.1;
            let centre = -normal() * radius;
            let samples = window(3.4, |at| {
                let beside = (at - centre).reject_from_normalized(axis).length();
                20.0 + 100.0 * (cylinder(radius + half, beside) - cylinder(radius - half, beside))
            });
            let slab = fit_slab(&samples, start(1.0), prior([20.0, 120.0, 20.0]), 1.0).unwrap();
            assert!((slab.half() - half).abs() < bound, "{radius}: {}", slab.half());
        }
    }

    #[test]
    fn stated_sigmas_of_the_thickness_are_those_of_the_errors() {
        let levels = [20.0, 120.0, 20.0];
        let exact = flat(1.05, levels);
        let pulls: Vec<f64> = (0..200)
            .map(|seed| {
                let priors = levels.map(|mean| LevelPrior { mean, sigma: 1e-3 });
                let slab = fit_slab(&noisy(&exact, 3.0, seed), start(1.0), priors, 3.0).unwrap();
                (slab.half() - 1.05) / slab.half_sigma()
            })
            .collect();
        let found = rms(&pulls);
        assert!((0.85..1.15).contains(&found), "{found}");
    }
}
