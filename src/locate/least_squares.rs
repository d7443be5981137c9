//! Levenberg-Marquardt for the local models: few parameters, hundreds of grey values.
//!
//! Models differ in how they evaluate a voxel; damping, priors, step limits and covariance are the same for all
//! and stand here. The normal equations are solved by a Cholesky factorisation (nalgebra).

use nalgebra::{Const, SMatrix, SVector};

/// A local model with `N` parameters.
pub(super) trait Model<const N: usize> {
    /// The normal equations at `x`: adds J^T J (lower triangle) and J^T r of all voxels, residuals and rows
    /// divided by the noise's standard deviation; returns the sum of squared residuals.
    fn normal_equations(&self, x: &SVector<f64, N>, equations: &mut Normal<N>) -> f64;

    /// Whether the parameters make sense; a step to others is not taken.
    fn is_possible(&self, _x: &SVector<f64, N>) -> bool {
        true
    }
}

/// J^T J (lower triangle) and J^T r.
#[derive(Debug, Clone)]
pub(super) struct Normal<const N: usize> {
    /// J^T J.
    pub matrix: SMatrix<f64, N, N>,
    /// J^T r, r = prediction - measurement.
    pub right: SVector<f64, N>,
    /// Which parameters move: nothing need be added for the others.
    pub active: [bool; N],
}

/// What a fit is told beside the model.
#[derive(Debug, Clone)]
pub(super) struct Problem<const N: usize> {
    /// Which parameters move.
    pub active: [bool; N],
    /// Prior value and standard deviation of each parameter; infinite for none.
    pub prior: [(f64, f64); N],
    /// Largest step of each parameter at a time.
    pub most: [f64; N],
    /// Iterations at most.
    pub iterations: usize,
}

/// A fit.
#[derive(Debug, Clone)]
pub struct Fit<const N: usize> {
    /// The parameters.
    pub x: SVector<f64, N>,
    /// Sum of squared residuals of the voxels.
    pub chi2: f64,
    /// Sum of squared deviations from the priors.
    pub strain: f64,
    /// Inverse of the normal matrix with priors: covariance for white noise of the stated size. Rows of
    /// parameters that did not move are zero.
    pub covariance: SMatrix<f64, N, N>,
    /// Whether the last step was small against its standard deviation.
    pub converged: bool,
}

/// A step counts as small if no parameter moves by more than this share of its standard deviation.
const SMALL: f64 = 0.05;

/// Misfits are summed in single precision.
const ROUNDING: f64 = 1e-6;

/// Minimises the misfit from `start`. `None` if the normal matrix is singular even when damped.
pub(super) fn minimise<const N: usize>(
    model: &impl Model<N>,
    problem: &Problem<N>,
    start: SVector<f64, N>,
) -> Option<Fit<N>> {
    let strain = |x: &SVector<f64, N>| -> f64 {
        (0..N)
            .filter(|&i| problem.active[i] && problem.prior[i].1.is_finite())
            .map(|i| ((x[i] - problem.prior[i].0) / problem.prior[i].1).powi(2))
            .sum()
    };
    let mut x = start;
    let mut lambda = 1e-3;
    let mut converged = false;
    let (mut chi2, mut equations) = assemble(model, problem, &x);
    let mut total = chi2 + strain(&x);
    for _ in 0..problem.iterations {
        let Some(step) = damped_step(&equations, problem, lambda) else {
            lambda *= 10.0;
            if lambda > 1e6 {
                return None;
            }
            continue;
        };
        let next = x + step;
        // Most steps are good ones: their derivatives are made along with their misfit.
        let tried = model.is_possible(&next).then(|| assemble(model, problem, &next));
        let value = tried.as_ref().map_or(f64::INFINITY, |t| t.0 + strain(&next));
        if let Some(better) = tried.filter(|_| value <= total * (1.0 + 1e-12)) {
            let gain = total - value;
            x = next;
            lambda = (lambda * 0.2).max(1e-9);
            (chi2, equations) = better;
            total = value;
            let small = (0..N).all(|i| {
                !problem.active[i] || step[i].abs() <= SMALL / equations.matrix[(i, i)].max(1e-30).sqrt()
            });
            if small || gain < 1e-3 {
                converged = true;
                break;
            }
        } else {
            lambda *= 8.0;
            if lambda > 1e8 || (value - total).abs() < ROUNDING * total {
                // No step improves it: a minimum, as far as rounding can tell.
                converged = true;
                break;
            }
        }
    }
    let inverse = equations.matrix.cholesky()?.inverse();
    let covariance =
        SMatrix::from_fn(|i, j| if problem.active[i] && problem.active[j] { inverse[(i, j)] } else { 0.0 });
    Some(Fit { x, chi2, strain: strain(&x), covariance, converged })
}

/// The normal equations with priors; parameters that do not move have a row of the unit matrix.
fn assemble<const N: usize>(
    model: &impl Model<N>,
    problem: &Problem<N>,
    x: &SVector<f64, N>,
) -> (f64, Normal<N>) {
    let mut equations = Normal { matrix: SMatrix::zeros(), right: SVector::zeros(), active: problem.active };
    let chi2 = model.normal_equations(x, &mut equations);
    for i in 0..N {
        if problem.active[i] {
            let (mean, sigma) = problem.prior[i];
            if sigma.is_finite() {
                equations.matrix[(i, i)] += 1.0 / (sigma * sigma);
                equations.right[i] += (x[i] - mean) / (sigma * sigma);
            }
        } else {
            for j in 0..N {
                equations.matrix[(i, j)] = 0.0;
                equations.matrix[(j, i)] = 0.0;
            }
            equations.matrix[(i, i)] = 1.0;
            equations.right[i] = 0.0;
        }
    }
    for i in 0..N {
        for j in 0..i {
            equations.matrix[(j, i)] = equations.matrix[(i, j)];
        }
    }
    (chi2, equations)
}

/// The damped Gauss-Newton step, shortened as a whole so that no parameter moves too far.
fn damped_step<const N: usize>(
    equations: &Normal<N>,
    problem: &Problem<N>,
    lambda: f64,
) -> Option<SVector<f64, N>>
where
    Const<N>:,
{
    let mut matrix = equations.matrix;
    for i in 0..N {
        matrix[(i, i)] *= 1.0 + lambda;
    }
    let step = -matrix.cholesky()?.solve(&equations.right);
    if !step.iter().all(|s| s.is_finite()) {
        return None;
    }
    let shorten =
        (0..N).filter(|&i| problem.active[i]).fold(1.0f64, |s, i| s.min(problem.most[i] / step[i].abs()));
    Some(step * shorten.min(1.0))
}
