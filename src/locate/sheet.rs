//! One interface, smooth within a few sigma: a blurred step across a paraboloid, fitted to grey values.
//!
//! In blur units and a frame (u, v, w) with w along the normal the interface is
//! `w = h + b . p + p' K p / 2`, `p = (u, v)`. Blurred by a round Gaussian of sigma one, the share of the far
//! material at a point is close to `Phi(d)` with
//! `d = (w - h - b . p - p' K p / 2 - tr K / 2) / sqrt(1 + |b + K p|^2)`: averaging the paraboloid over the
//! Gaussian raises it by half the trace of K (the curvature bias of threshold crossings,
//! `../shared/notes/junctions.md`), and a tilted sheet meets a wider step along w. Both grey levels are fitted,
//! held by priors.
//!
//! Left out: terms of third order in curvature times distance. 2 units from the middle they are 0.11 at a radius of
//! 4 units, 0.03 at 6, 0.006 at 10.

use glam::{DMat3, DVec3};
use nalgebra::SVector;

use super::batch::{BATCH, Batch, Batches, Rows, Sums, assemble, dot};
use super::frame::basis;
use super::least_squares::{ENOUGH, Fit, Model, Normal, Problem, minimise};
use super::normal::{bell, density, distribution};

/// Parameters: height, two tilts, three curvatures, level behind, level ahead.
pub(super) const PARAMETERS: usize = 8;

/// A voxel in a window: its place in blur units from the window's middle, and its grey value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Place.
    pub at: DVec3,
    /// Grey value.
    pub grey: f64,
}

/// Grey level with its standard deviation, known before a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelPrior {
    /// Grey value.
    pub mean: f64,
    /// Standard deviation.
    pub sigma: f64,
}

/// What a single grey value is worth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Its standard deviation.
    pub noise: f64,
    /// The same well inside of the materials, where nothing but noise is.
    pub white: f64,
    /// The lowest and the highest value there can be: at these ends it says only that the truth is no nearer.
    pub clip: [f64; 2],
    /// How many times the squared deviations that `noise` makes the scan shows at its worse interfaces, 1 or more: streaks are
    /// not everywhere. What a fit leaves up to this factor is no reason to refuse it.
    pub slack: f64,
}

impl Reading {
    /// Of grey values without an end, with noise of this standard deviation alone.
    #[must_use]
    pub fn unclipped(noise: f64) -> Self {
        Self { noise, white: noise, clip: [f64::NEG_INFINITY, f64::INFINITY], slack: 1.0 }
    }
}

/// A fitted sheet, in blur units about the window's middle.
#[derive(Debug, Clone)]
pub(super) struct Sheet {
    /// Where the frame starts: a point near the sheet.
    pub origin: DVec3,
    /// Columns u, v, w; w is the normal from behind to ahead.
    pub axes: DMat3,
    /// The fit.
    pub fit: Fit<PARAMETERS>,
}

struct Paraboloid<'a> {
    samples: &'a Batches,
    origin: DVec3,
    /// Axes of the frame.
    axes: DMat3,
    reading: Reading,
}

/// The parameters and the frame, as every voxel needs them.
struct Known {
    origin: [f32; 3],
    axes: [[f32; 3]; 3],
    x: [f32; PARAMETERS],
}

impl Rows<PARAMETERS> for Known {
    #[inline(always)]
    fn add(&self, batch: &Batch, reading: &Reading, sums: &mut Sums<PARAMETERS>) {
        let zero = [0.0; BATCH];
        let (mut rows, mut predicted, mut slope) = ([zero; PARAMETERS], zero, zero);
        let (x, o, [a, b, c]) = (&self.x, &self.origin, &self.axes);
        let contrast = x[7] - x[6];
        for i in 0..BATCH {
            let p = [batch.at[0][i] - o[0], batch.at[1][i] - o[1], batch.at[2][i] - o[2]];
            let (u, v, w) = (dot(a, &p), dot(b, &p), dot(c, &p));
            let tilt = [x[1] + x[3] * u + x[4] * v, x[2] + x[4] * u + x[5] * v];
            let scale = 1.0 / (1.0 + tilt[0] * tilt[0] + tilt[1] * tilt[1]).sqrt();
            let (uu, vv) = (0.5 * (u * u + 1.0), 0.5 * (v * v + 1.0));
            let height = x[0] + x[1] * u + x[2] * v + x[3] * uu + x[4] * (u * v) + x[5] * vv;
            let d = (w - height) * scale;
            let bell = bell(d);
            let share = distribution(d, bell);
            predicted[i] = x[6] + contrast * share;
            slope[i] = -contrast * density(bell) * scale;
            rows[1][i] = u;
            rows[2][i] = v;
            rows[3][i] = uu;
            rows[4][i] = u * v;
            rows[5][i] = vv;
            rows[7][i] = share;
        }
        let [residuals, weights] = batch.residuals(reading, &predicted);
        for i in 0..BATCH {
            let f = slope[i] * weights[i];
            rows[0][i] = f;
            rows[6][i] = (1.0 - rows[7][i]) * weights[i];
            rows[7][i] *= weights[i];
            for row in &mut rows[1..6] {
                row[i] *= f;
            }
        }
        sums.add(&rows, &residuals);
    }
}

impl Model<PARAMETERS> for Paraboloid<'_> {
    fn normal_equations(&self, x: &SVector<f64, PARAMETERS>, equations: &mut Normal<PARAMETERS>) -> f64 {
        let known = Known {
            origin: self.origin.as_vec3().to_array(),
            axes: self.axes.to_cols_array_2d().map(|axis| axis.map(|c| c as f32)),
            x: std::array::from_fn(|i| x[i] as f32),
        };
        assemble(&known, self.samples, &self.reading, equations)
    }
}

/// Fits a sheet through about `start` with about the normal `normal` (from behind to ahead).
/// `None` where there is no such fit.
#[must_use]
pub(super) fn fit_sheet(
    samples: &[Sample],
    start: DVec3,
    normal: DVec3,
    levels: [LevelPrior; 2],
    reading: Reading,
) -> Option<Sheet> {
    let mut sheet: Option<Sheet> = None;
    let (mut origin, mut normal) = (start, normal);
    let mut curvature = [0.0; 3];
    let mut means = levels.map(|l| l.mean);
    let mut axes = DMat3::from_cols_array_2d(&basis(normal).map(|a| a.to_array()));
    let mut problem = Problem {
        active: [true; PARAMETERS],
        prior: [(0.0, f64::INFINITY); PARAMETERS],
        most: [0.7, 0.4, 0.4, 0.3, 0.3, 0.3, f64::INFINITY, f64::INFINITY],
        iterations: 3,
        enough: ENOUGH,
    };
    for k in 3..6 {
        problem.prior[k] = (0.0, 0.5);
    }
    for (k, level) in levels.iter().enumerate() {
        problem.prior[6 + k] = (level.mean, level.sigma);
    }
    let samples = &Batches::new(samples);
    for pass in 0..2 {
        let model = Paraboloid { samples, origin, axes, reading };
        let start =
            SVector::from([0.0, 0.0, 0.0, curvature[0], curvature[1], curvature[2], means[0], means[1]]);
        let fit = minimise(&model, &problem, start)?;
        let x = fit.x;
        let done = sheet.insert(Sheet { origin, axes, fit });
        let tilt = (x[1] * x[1] + x[2] * x[2]).sqrt();
        if pass == 1 || (tilt < 0.05 && x[0].abs() < 0.2) {
            break;
        }
        origin = done.point(0.0, 0.0);
        normal = done.normal_at(0.0, 0.0);
        let turned = DMat3::from_cols_array_2d(&basis(normal).map(|a| a.to_array()));
        // The curvature in the turned frame, as a form on space.
        let [u, v] = [turned.x_axis, turned.y_axis].map(|a| done.axes.transpose() * a);
        let form = |a: DVec3, b: DVec3| x[3] * a.x * b.x + x[4] * (a.x * b.y + a.y * b.x) + x[5] * a.y * b.y;
        curvature = [form(u, u), form(u, v), form(v, v)];
        means = [x[6], x[7]];
        axes = turned;
    }
    sheet
}

impl Sheet {
    /// The point of the sheet over (u, v).
    #[must_use]
    pub(super) fn point(&self, u: f64, v: f64) -> DVec3 {
        self.origin + self.axes * DVec3::new(u, v, self.height(u, v))
    }

    fn height(&self, u: f64, v: f64) -> f64 {
        let x = &self.fit.x;
        x[0] + x[1] * u + x[2] * v + 0.5 * (x[3] * u * u + x[5] * v * v) + x[4] * u * v
    }

    fn slope(&self, u: f64, v: f64) -> [f64; 2] {
        let x = &self.fit.x;
        [x[1] + x[3] * u + x[4] * v, x[2] + x[4] * u + x[5] * v]
    }

    /// The unit normal over (u, v), from behind to ahead.
    #[must_use]
    pub(super) fn normal_at(&self, u: f64, v: f64) -> DVec3 {
        let [a, b] = self.slope(u, v);
        (self.axes * DVec3::new(-a, -b, 1.0)).normalize()
    }

    /// Standard deviation of the sheet's position near a point, blur units, for white noise.
    #[must_use]
    pub(super) fn sigma(&self, at: DVec3) -> f64 {
        let q = self.axes.transpose() * (at - self.origin);
        let (u, v) = (q.x, q.y);
        let g = SVector::<f64, PARAMETERS>::from([1.0, u, v, 0.5 * u * u, u * v, 0.5 * v * v, 0.0, 0.0]);
        (g.transpose() * self.fit.covariance * g)[(0, 0)].max(0.0).sqrt()
    }

    /// The curvature as a form on space.
    #[must_use]
    pub(super) fn form(&self) -> DMat3 {
        let x = &self.fit.x;
        let k = DMat3::from_cols(DVec3::new(x[3], x[4], 0.0), DVec3::new(x[4], x[5], 0.0), DVec3::ZERO);
        self.axes * k * self.axes.transpose()
    }

    /// The larger principal curvature by size, per blur unit.
    #[must_use]
    pub(super) fn curvature(&self) -> f64 {
        let x = &self.fit.x;
        let mean = 0.5 * (x[3] + x[5]);
        let root = (0.25 * (x[3] - x[5]).powi(2) + x[4] * x[4]).sqrt();
        mean.abs() + root
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::print_stdout)] // figures, with --nocapture

    use super::*;
    use crate::locate::fixtures::{ball, cylinder, distribution, noisy, reading, rms, window};

    const LEVELS: [LevelPrior; 2] =
        [LevelPrior { mean: 20.0, sigma: 1.0 }, LevelPrior { mean: 120.0, sigma: 1.0 }];
    /// Near the sheet under test, its normal there and a direction across.
    const AT: DVec3 = DVec3::new(0.2, -0.1, 0.15);

    fn normal() -> DVec3 {
        DVec3::new(0.5, 0.3, 0.8).normalize()
    }

    /// Fits from beside and tilted.
    fn fit(samples: &[Sample], noise: f64) -> Sheet {
        let tilted = (normal() + normal().any_orthonormal_vector() * 0.15).normalize();
        fit_sheet(samples, AT + normal() * 0.3, tilted, LEVELS, reading(noise)).unwrap()
    }

    /// Grey values of a window in which the share of the lower material is `behind`.
    fn greys(behind: impl Fn(DVec3) -> f64) -> Vec<Sample> {
        window(3.0, |at| 120.0 - 100.0 * behind(at))
    }

    /// Largest error of the sheet within one and a half units of the window's middle, for exact grey values;
    /// `height` is a point's true distance ahead.
    fn worst(samples: &[Sample], height: impl Fn(DVec3) -> f64) -> (f64, Sheet) {
        let sheet = fit(samples, 1.0);
        let places = (-3..=3).flat_map(|i| (-3..=3).map(move |j| [i, j].map(|c| 0.5 * f64::from(c))));
        let off = places.map(|[u, v]| height(sheet.point(u, v)).abs()).fold(0.0, f64::max);
        (off, sheet)
    }

    #[test]
    fn planes_are_found_exactly() {
        let height = |at: DVec3| (at - AT).dot(normal());
        let (off, sheet) = worst(&greys(|at| distribution(-height(at))), height);
        assert!(off < 1e-3 && sheet.curvature() < 1e-3, "{off} {}", sheet.curvature());
        assert!(sheet.normal_at(0.0, 0.0).dot(normal()) > 1.0 - 1e-6);
    }

    #[test]
    fn curved_sheets_are_found_without_the_bias_of_the_blur() {
        for (radius, most) in [(4.0, 0.17), (6.0, 0.045), (10.0, 0.009), (20.0, 0.001)] {
            let centre = AT - normal() * radius;
            let axis = normal().any_orthonormal_vector();
            let beside = |at: DVec3| (at - centre).reject_from_normalized(axis).length();
            let height = |at: DVec3| (at - centre).length() - radius;
            let balls = worst(&greys(|at| ball(radius, at.distance(centre))), height);
            let height = |at: DVec3| beside(at) - radius;
            let cylinders = worst(&greys(|at| cylinder(radius, beside(at))), height);
            for (off, sheet) in [balls, cylinders] {
                // Half-value surfaces are off by 1 / r and half of that. The corners of the places are 2.1 from the middle,
                // where a paraboloid leaves a ball by 2.5 / r^3.
                println!("r {radius}: {off}, curvature {}", sheet.curvature() * radius);
                assert!(off < most, "r {radius}: {off}");
                let curvature = sheet.curvature() * radius;
                assert!((curvature - 1.0).abs() < 5.5 / (radius * radius), "r {radius}: {curvature}");
            }
        }
    }

    #[test]
    fn stated_sigmas_are_those_of_the_errors() {
        let radius = 15.0;
        let centre = AT - normal() * radius;
        let exact = greys(|at| ball(radius, at.distance(centre)));
        let (mut pulls, mut worst) = (Vec::new(), 0.0f64);
        for seed in 0..150 {
            let sheet = fit(&noisy(&exact, 2.0, seed), 2.0);
            for [u, v] in [[0.0, 0.0], [1.2, 0.0], [-0.6, -1.0]] {
                let at = sheet.point(u, v);
                let off = at.distance(centre) - radius;
                worst = worst.max(off.abs());
                pulls.push(off / sheet.sigma(at));
            }
        }
        let found = rms(&pulls);
        // 450 values, three of a fit alike: 6 % of standard error.
        assert!((0.85..1.15).contains(&found), "{found}");
        assert!(worst < 0.1, "{worst}");
    }

    #[test]
    fn no_sheet_is_made_of_nothing() {
        let sheet = fit_sheet(&[], DVec3::ZERO, DVec3::Z, LEVELS, reading(1.0));
        // The priors alone keep levels and curvatures; place and tilt have none.
        assert!(sheet.is_none());
    }
}
