//! The fit behind [`Levels`]: a polynomial per material, then what it leaves.

use nalgebra::{Matrix4, SMatrix, SVector, Vector4};

use super::level_sums::{CellSums, LevelSums};
use super::levels::{Level, Levels, contrast};
use super::table::MaterialTable;

/// Terms of a polynomial of second degree.
pub(super) const TERMS: usize = 10;

/// Fewest voxels of a cell that tell anything.
const MIN_VOXELS: u64 = 8;
/// The variance of a cell's mean is taken as so much more than that of independent voxels: noise of
/// reconstructed volumes is correlated.
const CORRELATED: f64 = 8.0;
/// No cell is known better than to this share of the contrast.
const FLOOR: f64 = 0.002;
/// Prior standard deviations of linear and quadratic terms, as a share of the contrast, over half the volume's
/// longest side; the constant is free.
const PRIOR: f64 = 0.5;
/// The same where there is no drift.
const FLAT: f64 = 1e-6;
/// What the polynomial must gain (in squared standard errors) to be preferred: three for each term.
const GAIN: f64 = 27.0;
/// Tukey's constant, and rounds of reweighting.
const TUKEY: f64 = 4.685;
const ROUNDS: usize = 12;
/// How far (in cells, along each axis) residues reach, and the standard deviation of their weights.
const REACH: usize = 2;
const WIDTH: f64 = 1.0;
/// Neighbouring cells are alike if what the polynomial leaves differs by less than this share of it; fewest
/// and at least half of all neighbours.
const ALIKE: f64 = 0.35;
const MIN_ALIKE: usize = 2;
/// A residue smaller than this share of the contrast is none.
const NOTHING: f64 = 2e-4;

type Vector = SVector<f64, TERMS>;
type Matrix = SMatrix<f64, TERMS, TERMS>;

/// The terms at a place in units.
pub(super) fn terms([x, y, z]: [f64; 3]) -> [f64; TERMS] {
    [1.0, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z]
}

/// A cell that tells something of a material.
struct Cell {
    at: [usize; 3],
    /// Mean of the terms over its voxels, and of their grey values.
    terms: Vector,
    grey: f64,
    /// Middle of its voxels, in voxels.
    middle: [f64; 3],
    voxels: f64,
    /// Variance of the mean grey value that noise and the floor leave.
    variance: f64,
    /// From 1 (agrees) to 0 (an outlier).
    weight: f64,
}

/// Fits the level of a material.
pub(super) fn fit(levels: &Levels, sums: &LevelSums, table: &MaterialTable, material: usize) -> Level {
    let contrast = contrast(table, material);
    let mut cells = cells(levels, sums, material, contrast);
    if cells.is_empty() {
        return Level::constant(table, material);
    }
    let base = median(cells.iter().map(|c| c.grey).collect());
    let (mut polynomial, covariance) = simplest(&mut cells, base, contrast);
    let left: Vec<f64> = cells.iter().map(|c| c.grey - base - polynomial.dot(&c.terms)).collect();
    readmit(levels, &mut cells, &left);
    let residue = residue(levels, &cells, &left, contrast);
    polynomial[0] += base;
    let agreeing = cells.iter().filter(|c| c.weight > 0.0).map(|c| c.grey);
    let [low, high] = agreeing.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)]);
    let beyond = high - low + 0.02 * contrast;
    let mut level = Level {
        polynomial: polynomial.into(),
        covariance: covariance.into(),
        residue,
        range: [low - beyond, high + beyond],
        drift: None,
    };
    let values = cells.iter().map(|c| levels.value(&level, c.middle));
    level.drift = Some(values.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)]));
    level
}

/// The cells of a material that tell something.
fn cells(levels: &Levels, sums: &LevelSums, material: usize, contrast: f64) -> Vec<Cell> {
    let [nx, ny, nz] = sums.cells();
    let all = (0..nx * ny * nz).map(|i| [i % nx, i / nx % ny, i / (nx * ny)]);
    let mut cells: Vec<Cell> = all
        .map(|at| (at, sums.get(material, at)))
        .filter(|(_, s)| s.voxels >= MIN_VOXELS)
        .map(|(at, s)| cell(levels, at, s))
        .collect();
    // What is usual inside a cell: a few on streaks do not speak for it.
    let usual = median(cells.iter().map(|c| c.variance).collect());
    for cell in &mut cells {
        cell.variance = CORRELATED * usual / cell.voxels + (FLOOR * contrast).powi(2);
    }
    cells
}

/// A cell with the variance of its voxels.
fn cell(levels: &Levels, at: [usize; 3], s: &CellSums) -> Cell {
    let n = s.voxels as f64;
    let first: [f64; 3] = std::array::from_fn(|a| (at[a] * levels.side) as f64);
    let place = s.places.map(|p| p as f64 / n);
    let middle: [f64; 3] = std::array::from_fn(|a| first[a] + place[a]);
    let u: [f64; 3] = std::array::from_fn(|a| (middle[a] - levels.centre[a]) / levels.unit);
    let mut terms = Vector::from(terms(u));
    // Second moments about the middle make the means of products exact.
    for (i, [a, b]) in [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]].into_iter().enumerate() {
        terms[4 + i] += (s.products[i] as f64 / n - place[a] * place[b]) / levels.unit.powi(2);
    }
    let grey = s.grey / n;
    let variance = (s.squares / n - grey * grey).max(0.0);
    Cell { at, terms, grey, middle, voxels: n, variance, weight: 1.0 }
}

/// A constant if that explains the cells about as well as a polynomial does: the nine more terms follow noise
/// then, which shows where the polynomial goes beyond the cells.
fn simplest(cells: &mut [Cell], base: f64, contrast: f64) -> (Vector, Matrix) {
    let flat = polynomial(cells, base, contrast, FLAT);
    let flat_cost = cost(cells, base, &flat.0);
    let curved = polynomial(cells, base, contrast, PRIOR);
    if flat_cost - cost(cells, base, &curved.0) >= GAIN {
        return curved;
    }
    polynomial(cells, base, contrast, FLAT)
}

/// Sum of the squared errors in units of their variance; beyond Tukey's constant they are no worse.
fn cost(cells: &[Cell], base: f64, polynomial: &Vector) -> f64 {
    let off = |c: &Cell| (c.grey - base - polynomial.dot(&c.terms)).powi(2) / c.variance;
    cells.iter().map(|c| off(c).min(TUKEY * TUKEY)).sum()
}

/// The polynomial of the grey values less `base`, and its covariance; sets the cells' weights. `share` is the
/// prior standard deviation of all terms but the constant, as a share of the contrast.
fn polynomial(cells: &mut [Cell], base: f64, contrast: f64, share: f64) -> (Vector, Matrix) {
    cells.iter_mut().for_each(|cell| cell.weight = 1.0);
    let mut prior = Vector::repeat((share * contrast).powi(-2));
    prior[0] = (10.0 * contrast).powi(-2);
    let mut found = Vector::zeros();
    let mut covariance = Matrix::zeros();
    for _ in 0..ROUNDS {
        let (mut matrix, mut right) = (Matrix::from_diagonal(&prior), Vector::zeros());
        for cell in cells.iter() {
            let weight = cell.weight / cell.variance;
            for a in 0..TERMS {
                let t = weight * cell.terms[a];
                right[a] += t * (cell.grey - base);
                for b in 0..=a {
                    matrix[(a, b)] += t * cell.terms[b];
                }
            }
        }
        matrix.fill_upper_triangle_with_lower_triangle();
        let Some(cholesky) = matrix.cholesky() else { break };
        found = cholesky.solve(&right);
        let off = |cell: &Cell| (cell.grey - base - found.dot(&cell.terms)) / cell.variance.sqrt();
        let scale = (median(cells.iter().map(|c| off(c).abs()).collect()) / 0.6745).max(1.0);
        covariance = cholesky.inverse() * (scale * scale);
        for cell in cells.iter_mut() {
            let share = (off(cell) / (TUKEY * scale)).powi(2);
            cell.weight = if share < 1.0 { (1.0 - share).powi(2) } else { 0.0 };
        }
    }
    (found, covariance)
}

/// Cells far from the polynomial count again if their neighbours are as far: they are no streaks but another level, as of
/// the air in a bore.
fn readmit(levels: &Levels, cells: &mut [Cell], left: &[f64]) {
    let [nx, ny, nz] = levels.cells;
    let index = |[x, y, z]: [usize; 3]| (z * ny + y) * nx + x;
    let mut at = vec![usize::MAX; nx * ny * nz];
    for (i, cell) in cells.iter().enumerate() {
        at[index(cell.at)] = i;
    }
    let agrees = |i: usize| {
        let near = |a: usize| cells[i].at[a].saturating_sub(1)..(cells[i].at[a] + 2).min(levels.cells[a]);
        let around = near(2).flat_map(|z| near(1).flat_map(move |y| near(0).map(move |x| [x, y, z])));
        let others: Vec<f64> = around
            .filter_map(|place| left.get(at[index(place)]).filter(|_| place != cells[i].at))
            .map(|other| (other - left[i]).abs())
            .collect();
        let alike = others.iter().filter(|d| **d < ALIKE * left[i].abs()).count();
        alike >= MIN_ALIKE && 2 * alike >= others.len()
    };
    let again: Vec<usize> = (0..cells.len()).filter(|&i| cells[i].weight < 0.5 && agrees(i)).collect();
    for i in again {
        cells[i].weight = 1.0;
    }
}

/// What the polynomial leaves at the middle of each cell, with its variance.
fn residue(levels: &Levels, cells: &[Cell], left: &[f64], contrast: f64) -> Vec<[f32; 2]> {
    let [nx, ny, nz] = levels.cells;
    let index = |[x, y, z]: [usize; 3]| (z * ny + y) * nx + x;
    let mut at = vec![usize::MAX; nx * ny * nz];
    for (i, cell) in cells.iter().enumerate().filter(|(_, cell)| cell.weight > 0.0) {
        at[index(cell.at)] = i;
    }
    let [smooth, rough] = variances(cells, left, &at, &index, levels.cells);
    if smooth <= (NOTHING * contrast).powi(2) {
        return Vec::new();
    }
    let usual = median(cells.iter().map(|c| c.voxels).collect());
    let nodes = (0..nx * ny * nz).map(|i| [i % nx, i / nx % ny, i / (nx * ny)]);
    nodes
        .map(|node| {
            // A constant and slopes per cell, all small beforehand.
            let mut matrix = Matrix4::from_diagonal(&Vector4::new(1.0, 4.0, 4.0, 4.0)) / smooth;
            let mut right = Vector4::zeros();
            let near = |a: usize| node[a].saturating_sub(REACH)..(node[a] + REACH + 1).min(levels.cells[a]);
            for z in near(2) {
                for y in near(1) {
                    for x in near(0) {
                        let Some(cell) = cells.get(at[index([x, y, z])]) else { continue };
                        let middle =
                            |a: usize| (node[a] * levels.side) as f64 + 0.5 * (levels.side as f64 - 1.0);
                        let d: [f64; 3] =
                            std::array::from_fn(|a| (cell.middle[a] - middle(a)) / levels.side as f64);
                        let near = libm::exp(-0.5 * d.iter().map(|d| d * d).sum::<f64>() / (WIDTH * WIDTH));
                        let weight = near * cell.weight * (cell.voxels / usual).min(1.0) / rough;
                        let t = Vector4::new(1.0, d[0], d[1], d[2]);
                        matrix += t * t.transpose() * weight;
                        right += t * (weight * left[at[index([x, y, z])]]);
                    }
                }
            }
            let inverse = matrix.try_inverse().unwrap_or_else(Matrix4::zeros);
            [(inverse * right)[0] as f32, inverse[(0, 0)] as f32]
        })
        .collect()
}

/// The variance of what is smooth in the residues (the mean product of neighbouring cells', less two standard
/// errors), and of the rest.
fn variances(
    cells: &[Cell],
    left: &[f64],
    at: &[usize],
    index: &impl Fn([usize; 3]) -> usize,
    size: [usize; 3],
) -> [f64; 2] {
    let (mut n, mut sum, mut squares, mut own, mut count) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (i, cell) in cells.iter().enumerate().filter(|(_, cell)| cell.weight > 0.0) {
        own += left[i] * left[i];
        count += 1.0;
        for a in 0..3 {
            let mut next = cell.at;
            next[a] += 1;
            let Some(&r) = (next[a] < size[a]).then(|| left.get(at[index(next)])).flatten() else { continue };
            let product = left[i] * r;
            n += 1.0;
            sum += product;
            squares += product * product;
        }
    }
    if n < 8.0 {
        return [0.0, 1.0];
    }
    let mean: f64 = sum / n;
    let error = (squares / n - mean * mean).max(0.0).sqrt() / f64::sqrt(n);
    let smooth = (mean - 2.0 * error).max(0.0);
    let all: f64 = own / count;
    [smooth, (all - smooth).max(0.05 * all).max(f64::MIN_POSITIVE)]
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}
