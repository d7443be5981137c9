//! The grey value of each material at each place: cupping, beam hardening and slow drift make it vary.
//!
//! Per material, to the mean grey values of cells ([`LevelSums`]: voxels well inside only) is fitted
//!
//! 1. a polynomial of second degree in x, y, z, by least squares reweighted with Tukey's biweight (a cell on a
//!    streak does not pull), with priors that keep it flat where few cells tell;
//! 2. what the polynomial leaves, by local regression on the cells around, shrunk by how much neighbouring
//!    cells agree on it: their mean product is the variance of a smooth residue; noise has none.
//!
//! Beam hardening of a compact part is close to the polynomial alone, so it goes on to surfaces and thin
//! parts that have no voxel well inside. Values go no further beyond those of the
//! cells than these differ among each other.
//! Not guaranteed: sharp changes of level (streaks, rings, metal shadows) are not followed, and a
//! material without any voxel well inside has the mean of its table.

use super::level_fit::{TERMS, fit, terms};
use super::level_sums::LevelSums;
use super::table::MaterialTable;
use crate::grid::MaterialId;

/// A material without voxels well inside is known to this share of its contrast.
const UNKNOWN: f64 = 0.1;

/// The local grey values of all materials; see the module's header.
#[derive(Debug, Clone, PartialEq)]
pub struct Levels {
    /// Edge of a cell in voxels, cells per axis.
    pub(super) side: usize,
    pub(super) cells: [usize; 3],
    /// Places are taken relative to this voxel and in units of this many voxels.
    pub(super) centre: [f64; 3],
    pub(super) unit: f64,
    pub(super) materials: Vec<Level>,
}

/// The local grey value of one material.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Level {
    /// The polynomial, and its covariance.
    pub(super) polynomial: [f64; TERMS],
    pub(super) covariance: [[f64; TERMS]; TERMS],
    /// What it leaves at the middle of each cell (x fastest), and the variance of that; none if it leaves
    /// nothing.
    pub(super) residue: Vec<[f32; 2]>,
    /// Values stay within.
    pub(super) range: [f64; 2],
    /// Smallest and largest where the material is; `None` without voxels well inside.
    pub(super) drift: Option<[f64; 2]>,
}

impl Levels {
    /// One grey value per material everywhere: the table's means.
    #[must_use]
    pub fn constant(table: &MaterialTable) -> Self {
        let materials = (0..table.count()).map(|i| Level::constant(table, i)).collect();
        Self { side: 1, cells: [1; 3], centre: [0.0; 3], unit: 1.0, materials }
    }

    /// From sums over the voxels well inside of each material.
    ///
    /// # Panics
    /// If the sums are of another number of materials.
    #[must_use]
    pub fn new(sums: &LevelSums, table: &MaterialTable) -> Self {
        assert_eq!(sums.materials(), table.count(), "sums of other materials");
        let size = sums.size();
        let mut levels = Self {
            side: sums.side(),
            cells: sums.cells(),
            centre: size.map(|n| 0.5 * (n as f64 - 1.0)),
            unit: 0.5 * size.into_iter().max().unwrap_or(1) as f64,
            materials: Vec::new(),
        };
        levels.materials = (0..table.count()).map(|i| fit(&levels, sums, table, i)).collect();
        levels
    }

    /// The mean grey value of a material at a place (voxels; the first voxel's centre is 0, 0, 0).
    ///
    /// # Panics
    /// If the material is not in the table.
    #[must_use]
    pub fn mean(&self, material: MaterialId, at: [f32; 3]) -> f32 {
        self.value(&self.materials[usize::from(material.0)], at.map(f64::from)) as f32
    }

    /// Standard deviation of [`Levels::mean`]: how well the fit knows it, grey values.
    ///
    /// # Panics
    /// If the material is not in the table.
    #[must_use]
    pub fn sigma(&self, material: MaterialId, at: [f32; 3]) -> f32 {
        let level = &self.materials[usize::from(material.0)];
        let at = at.map(f64::from);
        let phi = terms(self.relative(at));
        let form = |row: &[f64; TERMS]| row.iter().zip(&phi).map(|(c, p)| c * p).sum::<f64>();
        let fitted: f64 = level.covariance.iter().zip(&phi).map(|(row, p)| p * form(row)).sum();
        (fitted.max(0.0) + self.residue(level, at)[1]).sqrt() as f32
    }

    /// The smallest and the largest mean grey value of a material where it is: how much it drifts. `None` if no
    /// voxel is well inside of it.
    #[must_use]
    pub fn drift(&self, material: MaterialId) -> Option<[f64; 2]> {
        self.materials.get(usize::from(material.0))?.drift
    }

    pub(super) fn value(&self, level: &Level, at: [f64; 3]) -> f64 {
        let phi = terms(self.relative(at));
        let polynomial: f64 = level.polynomial.iter().zip(phi).map(|(c, p)| c * p).sum();
        (polynomial + self.residue(level, at)[0]).clamp(level.range[0], level.range[1])
    }

    /// The terms of a level's polynomial at a place (voxels).
    #[must_use]
    pub fn terms(&self, at: [f64; 3]) -> [f64; TERMS] {
        terms(self.relative(at))
    }

    /// The same with another level of a material that has no voxel well inside: a polynomial of
    /// [`Levels::terms`] with its covariance.
    ///
    /// # Panics
    /// If the material is not in the table.
    #[must_use]
    pub fn with_polynomial(
        &self,
        material: MaterialId,
        polynomial: [f64; TERMS],
        covariance: [[f64; TERMS]; TERMS],
    ) -> Self {
        let mut levels = self.clone();
        let range = [f64::NEG_INFINITY, f64::INFINITY];
        levels.materials[usize::from(material.0)] =
            Level { polynomial, covariance, residue: Vec::new(), range, drift: None };
        levels
    }

    fn relative(&self, at: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| (at[a] - self.centre[a]) / self.unit)
    }

    /// The residue at a place, trilinear between the middles of cells, and its variance.
    fn residue(&self, level: &Level, at: [f64; 3]) -> [f64; 2] {
        if level.residue.is_empty() {
            return [0.0; 2];
        }
        let side = self.side as f64;
        let grid: [(usize, f64); 3] = std::array::from_fn(|a| {
            let last = self.cells[a] - 1;
            let c = ((at[a] - 0.5 * (side - 1.0)) / side).clamp(0.0, last as f64);
            let cell = (c as usize).min(last.saturating_sub(1));
            (cell, c - cell as f64)
        });
        let mut sum = [0.0; 2];
        for corner in 0..8_usize {
            let (mut weight, mut index) = (1.0, [0; 3]);
            for a in 0..3 {
                let (cell, share) = grid[a];
                let upper = corner >> a & 1;
                weight *= if upper == 1 { share } else { 1.0 - share };
                index[a] = (cell + upper).min(self.cells[a] - 1);
            }
            let node = level.residue[(index[2] * self.cells[1] + index[1]) * self.cells[0] + index[0]];
            sum.iter_mut().zip(node).for_each(|(s, v)| *s += weight * f64::from(v));
        }
        sum
    }
}

impl Level {
    /// The mean of a table, known badly.
    pub(super) fn constant(table: &MaterialTable, material: usize) -> Self {
        let mean = table.materials()[material].mean;
        let (mut polynomial, mut covariance) = ([0.0; TERMS], [[0.0; TERMS]; TERMS]);
        polynomial[0] = mean;
        covariance[0][0] = (UNKNOWN * contrast(table, material)).powi(2);
        Self { polynomial, covariance, residue: Vec::new(), range: [mean; 2], drift: None }
    }
}

/// The distance of a material's mean to the nearest other one.
pub(super) fn contrast(table: &MaterialTable, material: usize) -> f64 {
    let mean = |i: usize| table.materials()[i].mean;
    let others = (0..table.count()).filter(|&i| i != material);
    others.map(|i| (mean(i) - mean(material)).abs()).fold(f64::INFINITY, f64::min)
}
