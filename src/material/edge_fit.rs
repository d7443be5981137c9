//! A blurred step, plane or curved, fitted to a patch of profiles.
//!
//! Across the interface the grey value is `low + (high - low) Phi(d / s)` with d the distance from it. The
//! interface is a graph over the patch, `x0(j, k) = p0 + p1 j + p2 k + p3 j²/2 + p4 j k + p5 k²/2`, so the
//! distance is taken along the row and multiplied by the cosine of the local slope. Both plateaus, their
//! slopes along d (a blurred ramp on either side), the graph and s are fitted by Levenberg and Marquardt's
//! method: no mean grey value of a whole material is needed, which cupping would make wrong, and no gradient of
//! single voxels, which noise makes too steep to the sides. Without the ramps, cupping of 10 % makes s 1 to 2 %
//! too small.
//!
//! Blur along a curved interface widens the step: with principal curvatures k1, k2 the average over the
//! tangent plane adds `s⁴ (k1² + k2²) / 2` to s² (variance of the parabola under the Gaussian); that is taken
//! off again. Left over below 0.1 % for radii of 8 s and more.

use nalgebra::{SMatrix, SVector};

use super::edge_patches::{LENGTH, PLATEAU, Patch, REACH, ROWS, SIDE, sides};

/// `low`, `high`, the six coefficients of the graph, s, and the slopes of both plateaus.
const PARAMETERS: usize = 11;
const S: usize = 8;
const ROUNDS: usize = 15;
/// Widths beyond these (in voxels along the profile) were not measured by a profile of this length.
const WIDTHS: [f64; 2] = [0.05, 4.0];

/// What a patch tells.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct EdgeFit {
    /// Width of the step, mm: standard deviation of the blur along the normal.
    pub(super) sigma: f64,
    /// Its standard deviation by the residuals, mm (as far as noise is white).
    pub(super) sigma_error: f64,
    /// Squares of the components of the unit normal, along the lattice axes.
    pub(super) normal2: [f64; 3],
    /// The grey values of both plateaus at the interface.
    pub(super) plateaus: [f64; 2],
    /// How much the plateaus' slopes add to the step there (grey values per mm, before and behind).
    ramps: [f64; 2],
    /// Root mean square of the residuals, grey values.
    pub(super) rms: f64,
    /// Distance from the interface along the normal (mm) of each voxel of the patch.
    pub(super) distances: Box<[f32]>,
}

impl EdgeFit {
    /// A grey value at a distance (mm) as a share of the step, the slopes of the plateaus taken off.
    pub(super) fn share(&self, grey: f64, distance: f64) -> f64 {
        let t = distance / self.sigma;
        let (cdf, density) = normal(t);
        let ramps = self.ramps[0] * (t * (1.0 - cdf) - density) + self.ramps[1] * (t * cdf + density);
        (grey - self.sigma * ramps - self.plateaus[0]) / (self.plateaus[1] - self.plateaus[0])
    }
}

type Vector = SVector<f64, PARAMETERS>;

/// The standard normal distribution function.
pub(super) fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x / std::f64::consts::SQRT_2)
}

fn normal_density(x: f64) -> f64 {
    const SCALE: f64 = 0.398_942_280_401_432_7;
    SCALE * libm::exp(-0.5 * x * x)
}

struct Model<'a> {
    patch: &'a Patch,
    /// Spacing along the profiles and along both sides, mm.
    spacing: [f64; 3],
}

/// The standard normal distribution function and density.
fn normal(t: f64) -> (f64, f64) {
    (normal_cdf(t), normal_density(t))
}

/// A row: its place in the patch, the graph's height, mm of distance per voxel along it.
struct Row {
    basis: [f64; 6],
    height: f64,
    scale: f64,
}

impl Model<'_> {
    fn row(&self, p: &Vector, row: usize) -> Row {
        let [j, k] = [row % ROWS, row / ROWS].map(|i| i as f64 - SIDE as f64);
        let basis = [1.0, j, k, 0.5 * j * j, j * k, 0.5 * k * k];
        let height = basis.iter().zip(&p.as_slice()[2..S]).map(|(b, p)| b * p).sum();
        let slopes = [p[3] + p[5] * j + p[6] * k, p[4] + p[6] * j + p[7] * k];
        let [along, b, c] = self.spacing;
        let tilt = (slopes[0] * along / b).powi(2) + (slopes[1] * along / c).powi(2);
        Row { basis, height, scale: along / (1.0 + tilt).sqrt() }
    }

    /// Sum of squared residuals, the normal matrix and the right side.
    fn normal_equations(&self, p: &Vector) -> (f64, SMatrix<f64, PARAMETERS, PARAMETERS>, Vector) {
        let (mut sum, mut matrix, mut right) = (0.0, [[0.0; PARAMETERS]; PARAMETERS], [0.0; PARAMETERS]);
        let (contrast, s, ramps) = (p[1] - p[0], p[S], [p[S + 1], p[S + 2]]);
        for (row, grey) in self.patch.grey.chunks_exact(LENGTH).enumerate() {
            let Row { basis, height, scale } = self.row(p, row);
            for (i, &v) in grey.iter().enumerate() {
                let t = (i as f64 - REACH as f64 - height) * scale / s;
                let (cdf, density) = normal(t);
                let residual = f64::from(v) - value(p, t, (cdf, density));
                let slope = contrast * density / s + ramps[0] * (1.0 - cdf) + ramps[1] * cdf;
                let mut d = [0.0; PARAMETERS];
                (d[0], d[1]) = (1.0 - cdf, cdf);
                for (d, b) in d[2..S].iter_mut().zip(&basis) {
                    *d = -slope * scale * b;
                }
                d[S] = density * (ramps[1] - ramps[0] - contrast * t / s);
                d[S + 1] = s * (t * (1.0 - cdf) - density);
                d[S + 2] = s * (t * cdf + density);
                sum += residual * residual;
                for ((row, right), own) in matrix.iter_mut().zip(&mut right).zip(&d) {
                    *right += own * residual;
                    row.iter_mut().zip(&d).for_each(|(sum, d)| *sum += own * d);
                }
            }
        }
        (sum, SMatrix::from(matrix), Vector::from(right))
    }

    /// Plateaus from the ends, slopes of the graph from the sums of whole rows (which a step moves in
    /// proportion to its place), s as usual.
    fn start(&self) -> Option<Vector> {
        let rows: Vec<&[f32]> = self.patch.grey.chunks_exact(LENGTH).collect();
        let middle = rows[ROWS * ROWS / 2];
        let mean = |a: usize, b: usize| 0.5 * f64::from(middle[a] + middle[b]);
        let (low, high) = (mean(0, 1), mean(LENGTH - 2, LENGTH - 1));
        let mut p = Vector::zeros();
        (p[0], p[1], p[2]) = (low, high, self.patch.crossing);
        for (row, grey) in rows.iter().enumerate() {
            let sum: f64 = grey.iter().map(|&v| f64::from(v)).sum();
            let [j, k] = [row % ROWS, row / ROWS].map(|i| i as f64 - SIDE as f64);
            // Sum of j² over a patch of 5 x 5.
            const SQUARES: f64 = 50.0;
            p[3] -= j * sum / (SQUARES * (high - low));
            p[4] -= k * sum / (SQUARES * (high - low));
        }
        (p[3].abs().max(p[4].abs()) < 3.0).then_some(())?;
        p[S] = self.row(&p, ROWS * ROWS / 2).scale;
        p.iter().all(|v| v.is_finite()).then_some(p)
    }
}

/// The model at distance `t s`: a step between two ramps, blurred.
fn value(p: &Vector, t: f64, (cdf, density): (f64, f64)) -> f64 {
    let ramps = p[S + 1] * (t * (1.0 - cdf) - density) + p[S + 2] * (t * cdf + density);
    p[0] + (p[1] - p[0]) * cdf + p[S] * ramps
}

/// Fits a patch of a volume with voxels of `spacing` mm; `None` if it is no blurred step.
pub(super) fn fit(patch: &Patch, spacing: [f64; 3]) -> Option<EdgeFit> {
    let [b, c] = sides(patch.axis);
    let along = spacing[patch.axis];
    let model = Model { patch, spacing: [along, spacing[b], spacing[c]] };
    let mut p = model.start()?;
    let (mut sum, mut matrix, mut right) = model.normal_equations(&p);
    let (mut damping, mut converged) = (1e-3, false);
    for _ in 0..ROUNDS {
        let mut damped = matrix;
        for a in 0..PARAMETERS {
            damped[(a, a)] += damping * matrix[(a, a)] + f64::MIN_POSITIVE;
        }
        let step = damped.cholesky()?.solve(&right);
        let mut next = p + step;
        next[S] = next[S].clamp(0.5 * p[S], 2.0 * p[S]);
        let small = (step[S] / p[S]).abs() < 1e-4 && step[2].abs() < 1e-4;
        let trial = model.normal_equations(&next);
        if trial.0 <= sum {
            p = next;
            damping *= 0.1;
            (sum, matrix, right) = trial;
            converged = small;
            if converged {
                break;
            }
        } else {
            if small {
                converged = true;
                break;
            }
            damping *= 10.0;
        }
    }
    let contrast = p[1] - p[0];
    let middle = model.row(&p, ROWS * ROWS / 2);
    let width = p[S] / along;
    let ends = [patch.grey[LENGTH * (ROWS * ROWS / 2)], patch.grey[LENGTH * (ROWS * ROWS / 2) + LENGTH - 1]];
    let off = ends
        .iter()
        .zip([p[0], p[1]])
        .any(|(&v, p)| (f64::from(v) - p).abs() > 2.0 * PLATEAU * contrast.abs());
    if !converged || off || !(WIDTHS[0]..WIDTHS[1]).contains(&width) || !(-1.0..2.0).contains(&p[2]) {
        return None;
    }
    let free = (patch.grey.len() - PARAMETERS) as f64;
    let covariance = matrix.cholesky()?.inverse();
    let cosine = middle.scale / along;
    let tilts = [p[3] * along / spacing[b], p[4] * along / spacing[c]];
    let mut normal2 = [0.0; 3];
    (normal2[patch.axis], normal2[b], normal2[c]) =
        (cosine * cosine, (tilts[0] * cosine).powi(2), (tilts[1] * cosine).powi(2));
    let bends = [p[5] / spacing[b].powi(2), p[6] / (spacing[b] * spacing[c]), p[7] / spacing[c].powi(2)];
    let widened = p[S] * p[S] * squared_curvatures(tilts, bends.map(|h| h * along));
    let distances = (0..patch.grey.len()).map(|i| {
        let row = model.row(&p, i / LENGTH);
        (((i % LENGTH) as f64 - REACH as f64 - row.height) * row.scale) as f32
    });
    Some(EdgeFit {
        sigma: p[S] / (1.0 + 0.5 * widened.min(0.5)).sqrt(),
        sigma_error: (covariance[(S, S)] * sum / free).sqrt(),
        normal2,
        plateaus: [p[0], p[1]],
        ramps: [p[S + 1], p[S + 2]],
        rms: (sum / free).sqrt(),
        distances: distances.collect(),
    })
}

/// `k1² + k2²` of a graph from its slopes and second derivatives (bb, bc, cc): the trace of the squared
/// shape operator `G⁻¹ H / W`.
fn squared_curvatures([f, g]: [f64; 2], [fb, fc, gc]: [f64; 3]) -> f64 {
    let w2 = 1.0 + f * f + g * g;
    let inverse = [[(1.0 + g * g) / w2, -f * g / w2], [-f * g / w2, (1.0 + f * f) / w2]];
    let h = [[fb, fc], [fc, gc]];
    let product = |i: usize, j: usize| (inverse[i][0] * h[0][j] + inverse[i][1] * h[1][j]) / w2.sqrt();
    product(0, 0).powi(2) + 2.0 * product(0, 1) * product(1, 0) + product(1, 1).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curvature_of_a_sphere_is_the_same_wherever_it_is_touched() {
        // z = sqrt(r² - x² - y²) at (a, b).
        for (r, a, b) in [(10.0_f64, 0.0, 0.0), (10.0, 3.0, -4.0), (7.0, 1.0, 2.0)] {
            let z = (r * r - a * a - b * b).sqrt();
            let slopes = [-a / z, -b / z];
            let h = [-1.0 / z - a * a / z.powi(3), -a * b / z.powi(3), -1.0 / z - b * b / z.powi(3)];
            assert!((squared_curvatures(slopes, h) * r * r / 2.0 - 1.0).abs() < 1e-9);
        }
    }
}
