//! Levenberg-Marquardt for the local models: few parameters, hundreds of grey values.
//!
//! Models differ in how they evaluate a voxel; damping, priors, step limits and covariance are the same for all
//! and stand here. The normal equations are solved by a Cholesky factorisation of the rows that move: often a half of them.

use nalgebra::{SMatrix, SVector};

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

impl<const N: usize> Normal<N> {
    /// Of no measurements.
    pub(super) fn new(active: &[bool; N]) -> Self {
        Self { matrix: SMatrix::zeros(), right: SVector::zeros(), active: *active }
    }

    /// Adds a measurement: its row of the Jacobian and its residual, in standard deviations.
    pub(super) fn add(&mut self, row: &[f64; N], r: f64) {
        add_products(self.matrix.as_mut_slice(), row);
        for (right, entry) in self.right.iter_mut().zip(row) {
            *right += entry * r;
        }
    }
}

/// Adds the products of a row's entries to the lower triangle of a matrix of as many rows, by columns.
#[inline(never)]
fn add_products(matrix: &mut [f64], row: &[f64]) {
    for (j, column) in matrix.chunks_exact_mut(row.len()).enumerate() {
        for (entry, factor) in column[j..].iter_mut().zip(&row[j..]) {
            *entry += factor * row[j];
        }
    }
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
    /// A step that promises to lower the misfit by no more than this is not made.
    pub enough: f64,
}

/// Of [`Problem::enough`] for a fit that is a result, a tenth of a standard deviation; and for one that another starts from.
pub(super) const ENOUGH: f64 = 0.01;
pub(super) const ENOUGH_TO_START: f64 = 0.5;

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

/// Where the damping is above this, a step that promises little may be held back.
const FREE: f64 = 1.0;
/// Damping after a good step falls to no less than this share, and rises by this factor after the first bad one, twice as much
/// after each next (Nielsen 1999, Damping Parameter in Marquardt's Method).
const LOWER: f64 = 0.2;
const RAISE: f64 = 4.0;

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
    let (mut lambda, mut raise) = (1e-3, RAISE);
    let mut converged = false;
    let (mut chi2, mut equations) = assemble(model, problem, &x);
    let mut total = chi2 + strain(&x);
    for _ in 0..problem.iterations {
        let Some((step, promised)) = damped_step(&equations, problem, lambda) else {
            lambda *= 10.0;
            if lambda > 1e6 {
                return None;
            }
            continue;
        };
        if promised < problem.enough && lambda < FREE {
            converged = true;
            break;
        }
        let next = x + step;
        // Most steps are good ones: their derivatives are made along with their misfit.
        let tried = model.is_possible(&next).then(|| assemble(model, problem, &next));
        let value = tried.as_ref().map_or(f64::INFINITY, |t| t.0 + strain(&next));
        if let Some(better) = tried.filter(|_| value <= total * (1.0 + 1e-12)) {
            // Where the misfit falls as promised the next step may be freer.
            let kept = (total - value) / promised;
            lambda = (lambda * (1.0 - (2.0 * kept - 1.0).powi(3)).clamp(LOWER, 2.0)).max(1e-9);
            raise = RAISE;
            x = next;
            (chi2, equations) = better;
            total = value;
        } else {
            lambda *= raise;
            raise *= 2.0;
            if lambda > 1e8 || (value - total).abs() < ROUNDING * total {
                // No step improves it: a minimum, as far as rounding can tell.
                converged = true;
                break;
            }
        }
    }
    let covariance = Factor::new(&equations.matrix, &problem.active, 0.0)?.inverse();
    Some(Fit { x, chi2, strain: strain(&x), covariance, converged })
}

/// By how much farther the misfit falls, as far as the model is linear at `x`, if a parameter that a problem holds is free, too (a score
/// test); 0 where that cannot be told.
pub(super) fn promise<const N: usize>(
    model: &impl Model<N>,
    problem: &Problem<N>,
    x: &SVector<f64, N>,
    parameter: usize,
) -> f64 {
    let mut free = Problem { most: [f64::INFINITY; N], ..problem.clone() };
    free.active[parameter] = true;
    let (_, equations) = assemble(model, &free, x);
    let falls = |problem: &Problem<N>| damped_step(&equations, problem, 1e-6).map(|(_, promised)| promised);
    let with = falls(&free);
    free.active[parameter] = false;
    with.zip(falls(&free)).map_or(0.0, |(with, without)| with - without)
}

/// The normal equations with priors.
fn assemble<const N: usize>(
    model: &impl Model<N>,
    problem: &Problem<N>,
    x: &SVector<f64, N>,
) -> (f64, Normal<N>) {
    let mut equations = Normal::new(&problem.active);
    let chi2 = model.normal_equations(x, &mut equations);
    for i in 0..N {
        if problem.active[i] {
            let (mean, sigma) = problem.prior[i];
            if sigma.is_finite() {
                equations.matrix[(i, i)] += 1.0 / (sigma * sigma);
                equations.right[i] += (x[i] - mean) / (sigma * sigma);
            }
        }
    }
    (chi2, equations)
}

/// Which of some parameters move, ascending.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moving<const N: usize> {
    of: [usize; N],
    count: usize,
}

impl<const N: usize> Moving<N> {
    /// Of flags.
    pub(super) fn new(active: &[bool; N]) -> Self {
        let mut of = [0; N];
        let count = list(active, &mut of);
        Self { of, count }
    }

    /// The parameters.
    #[inline(always)]
    pub(super) fn all(&self) -> &[usize] {
        &self.of[..self.count]
    }
}

/// The Cholesky factor of the rows and columns that move, its rows without gaps.
struct Factor<const N: usize> {
    rows: [[f64; N]; N],
    /// Which row of the matrix each is.
    moving: Moving<N>,
}

impl<const N: usize> Factor<N> {
    /// Of a symmetric matrix (its lower triangle), the diagonal enlarged by the share `lambda`. `None` unless it is positive
    /// definite.
    fn new(matrix: &SMatrix<f64, N, N>, active: &[bool; N], lambda: f64) -> Option<Self> {
        const { assert!(N <= MOST_PARAMETERS) }
        let moving = Moving::new(active);
        let mut rows = [[0.0; N]; N];
        for (n, &i) in moving.all().iter().enumerate() {
            for (entry, &j) in rows[n].iter_mut().zip(&moving.all()[..n]) {
                *entry = matrix[(i, j)];
            }
            rows[n][n] = matrix[(i, i)] * (1.0 + lambda);
        }
        factorise(rows.as_flattened_mut(), N, moving.count).then_some(Self { rows, moving })
    }

    /// Solves for a right side without gaps, whose entries before `first` are zero.
    fn substitute(&self, x: &mut [f64; N], first: usize) {
        substitute(self.rows.as_flattened(), N, &mut x[..self.moving.count], first);
    }

    /// The solution for a right side; zero where nothing moves.
    fn solve(&self, right: &SVector<f64, N>) -> SVector<f64, N> {
        let mut x = [0.0; N];
        for (entry, &i) in x.iter_mut().zip(self.moving.all()) {
            *entry = right[i];
        }
        self.substitute(&mut x, 0);
        let mut out = SVector::zeros();
        for (entry, &i) in x.iter().zip(self.moving.all()) {
            out[i] = *entry;
        }
        out
    }

    /// The inverse of the matrix; zero where nothing moves.
    fn inverse(&self) -> SMatrix<f64, N, N> {
        let mut out = SMatrix::zeros();
        for (k, &column) in self.moving.all().iter().enumerate() {
            let mut x = [0.0; N];
            x[k] = 1.0;
            self.substitute(&mut x, k);
            for (entry, &row) in x.iter().zip(self.moving.all()) {
                out[(row, column)] = *entry;
            }
        }
        out
    }
}

/// The first rows of a covariance as they are kept: its lower triangle by rows; as many entries as there is room for.
pub(super) fn packed<const N: usize, const M: usize>(covariance: &SMatrix<f64, N, N>) -> [f32; M] {
    let mut entries = (0..N).flat_map(|i| (0..=i).map(move |j| covariance[(i, j)] as f32));
    std::array::from_fn(|_| entries.next().unwrap_or(0.0))
}

/// Standard deviation of what has the derivatives `g` by parameters of a [`packed`] covariance.
pub(super) fn packed_sigma<const N: usize>(packed: &[f32], g: &[f64; N]) -> f64 {
    let mut entries = packed.iter();
    let mut variance = 0.0;
    for i in 0..N {
        for (j, entry) in entries.by_ref().take(i + 1).enumerate() {
            let twice = if i == j { 1.0 } else { 2.0 };
            variance += twice * g[i] * g[j] * f64::from(*entry);
        }
    }
    variance.max(0.0).sqrt()
}

/// Models have no more parameters than this.
const MOST_PARAMETERS: usize = 32;

// What loops over parameters that move is one function for all sizes: with the size known, compilers unroll such loops, and take minutes
// over what they make of that.

/// Lists which of some parameters move, ascending; returns how many.
#[inline(never)]
fn list(active: &[bool], out: &mut [usize]) -> usize {
    let mut count = 0;
    for (i, _) in active.iter().enumerate().filter(|(_, moves)| **moves) {
        out[count] = i;
        count += 1;
    }
    count
}

/// Replaces a positive definite matrix (its lower triangle; `count` rows, each `width` entries after the one before) by its Cholesky
/// factor; false if it is none.
#[inline(never)]
fn factorise(rows: &mut [f64], width: usize, count: usize) -> bool {
    let mut column = [0.0; MOST_PARAMETERS];
    for k in 0..count {
        let (done, below) = rows.split_at_mut((k + 1) * width);
        let pivot = &mut done[k * width + k];
        if pivot.is_nan() || *pivot <= 0.0 {
            return false;
        }
        let root = pivot.sqrt();
        *pivot = root;
        for (row, entry) in below.chunks_exact_mut(width).take(count - k - 1).zip(&mut column) {
            row[k] /= root;
            *entry = row[k];
        }
        for (i, row) in below.chunks_exact_mut(width).take(count - k - 1).enumerate() {
            let factor = column[i];
            for (entry, other) in row[k + 1..].iter_mut().zip(&column[..=i]) {
                *entry -= factor * other;
            }
        }
    }
    true
}

/// Solves for a right side whose entries before `first` are zero, in its place, by a Cholesky factor (as [`factorise`] has it).
#[inline(never)]
fn substitute(rows: &[f64], width: usize, x: &mut [f64], first: usize) {
    let row = |i: usize| &rows[i * width..][..=i];
    for i in first..x.len() {
        let sum: f64 = row(i)[first..i].iter().zip(&x[first..i]).map(|(factor, entry)| factor * entry).sum();
        x[i] = (x[i] - sum) / row(i)[i];
    }
    for i in (0..x.len()).rev() {
        x[i] /= row(i)[i];
        let value = x[i];
        for (entry, factor) in x[..i].iter_mut().zip(row(i)) {
            *entry -= factor * value;
        }
    }
}

/// The damped Gauss-Newton step, shortened as a whole so that no parameter moves too far, and by how much it lowers the misfit if
/// the model is as linear as its derivatives say.
fn damped_step<const N: usize>(
    equations: &Normal<N>,
    problem: &Problem<N>,
    lambda: f64,
) -> Option<(SVector<f64, N>, f64)> {
    let Normal { matrix, right, .. } = equations;
    let step = -Factor::new(matrix, &problem.active, lambda)?.solve(right);
    if !step.iter().all(|s| s.is_finite()) {
        return None;
    }
    let active = || (0..N).filter(|&i| problem.active[i]);
    let share = active().fold(1.0f64, |s, i| s.min(problem.most[i] / step[i].abs())).min(1.0);
    // The step solves (H + lambda D) s = -g.
    let falls: f64 = active().map(|i| -right[i] * step[i]).sum();
    let damping: f64 = active().map(|i| lambda * matrix[(i, i)] * step[i] * step[i]).sum();
    let promised = share * (2.0 * falls - share * (falls - damping));
    Some((step * share, promised))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// grey = x0 t + x1 t², measured at some places, of which the first is off.
    struct Parabola;

    impl Model<2> for Parabola {
        fn normal_equations(&self, x: &SVector<f64, 2>, equations: &mut Normal<2>) -> f64 {
            let mut chi2 = 0.0;
            for (t, grey) in [(-1.0, 0.7), (0.5, 0.4), (1.0, 2.0), (2.0, 5.9)] {
                let row = [t, t * t];
                let r = row[0] * x[0] + row[1] * x[1] - grey;
                equations.add(&row, r);
                chi2 += r * r;
            }
            chi2
        }
    }

    fn problem(active: [bool; 2]) -> Problem<2> {
        let prior = [(0.0, f64::INFINITY); 2];
        Problem { active, prior, most: [f64::INFINITY; 2], iterations: 20, enough: 1e-12 }
    }

    #[test]
    fn a_parameter_promises_what_it_gains_beside_the_others() {
        let fit = |active, start| minimise(&Parabola, &problem(active), start).unwrap();
        let line = fit([true, false], SVector::zeros());
        let parabola = fit([true, true], SVector::zeros());
        let gain = line.chi2 - parabola.chi2;
        assert!(gain > 1.0, "{gain}");
        // Also where the others are not yet at their best.
        for start in [line.x, SVector::zeros()] {
            let promised = promise(&Parabola, &problem([true, false]), &start, 1);
            assert!((promised - gain).abs() < 1e-3 * gain, "{promised} {gain}");
        }
    }

    #[test]
    fn what_does_not_move_has_no_covariance() {
        let line = minimise(&Parabola, &problem([true, false]), SVector::from([0.0, 0.3])).unwrap();
        assert!((line.x[1] - 0.3).abs() < 1e-12 && line.converged);
        // Of one parameter the inverse of the sum of squared slopes: 1 + 1/4 + 1 + 4.
        assert!((line.covariance[(0, 0)] - 1.0 / 6.25).abs() < 1e-9);
        assert!(line.covariance.iter().skip(1).all(|c| c.abs() < 1e-12));
    }
}
