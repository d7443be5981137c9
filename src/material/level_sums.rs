//! What there is to know of the grey values well inside of each material, cell by cell.
//!
//! A *cell* is a cube of 16 voxels (more in large volumes), aligned to the lattice, so that it does not
//! depend on slabs. Of the voxels of a material in it, sums are kept: their number, first and second moments of
//! their places, sum and sum of squares of their grey values. A function of second degree is then compared with
//! exactly the voxels that were there, not with the middle of the cell.

use std::ops::Range;

use rayon::prelude::*;

/// Edge of a cell in voxels, at the least.
const SIDE: usize = 16;
/// Cells times materials at most: 12 MB of sums.
const MOST: usize = 1 << 17;

/// Sums over the voxels of one material in one cell; places are counted from the cell's first voxel.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CellSums {
    /// How many voxels.
    pub voxels: u64,
    /// Sums of x, y, z.
    pub places: [u64; 3],
    /// Sums of xx, yy, zz, xy, xz, yz.
    pub products: [u64; 6],
    /// Sum of the grey values.
    pub grey: f64,
    /// Sum of their squares.
    pub squares: f64,
}

impl CellSums {
    /// Adds voxels of row (y, z) of the cell, given by their x (in the cell) and grey value. Sums of single
    /// rows are added one after another, so that slabs change nothing.
    #[inline]
    pub fn add_row(&mut self, y: usize, z: usize, voxels: impl Iterator<Item = (usize, f32)>) {
        let (mut n, mut sum_x, mut sum_xx, mut grey, mut squares) = (0, 0, 0, 0.0, 0.0);
        for (x, v) in voxels {
            let (x, v) = (x as u64, f64::from(v));
            n += 1;
            sum_x += x;
            sum_xx += x * x;
            grey += v;
            squares += v * v;
        }
        let (y, z) = (y as u64, z as u64);
        self.voxels += n;
        let places = [sum_x, n * y, n * z];
        let products = [sum_xx, n * y * y, n * z * z, sum_x * y, sum_x * z, n * y * z];
        self.places.iter_mut().zip(places).for_each(|(sum, part)| *sum += part);
        self.products.iter_mut().zip(products).for_each(|(sum, part)| *sum += part);
        self.grey += grey;
        self.squares += squares;
    }
}

/// Sums for all cells and materials of a volume.
#[derive(Debug, Clone, PartialEq)]
pub struct LevelSums {
    size: [usize; 3],
    materials: usize,
    side: usize,
    cells: [usize; 3],
    /// By y of the cell, then z, x, material: rows of cells along y belong to one thread each.
    sums: Vec<CellSums>,
}

impl LevelSums {
    /// Of no voxels yet, for a volume of `size` voxels and so many materials.
    #[must_use]
    pub fn new(size: [usize; 3], materials: usize) -> Self {
        let cells = |side: usize| size.map(|n| n.div_ceil(side).max(1));
        let mut side = SIDE;
        while cells(side).iter().product::<usize>() * materials > MOST && side < 1 << 16 {
            side *= 2;
        }
        let cells = cells(side);
        let sums = vec![CellSums::default(); cells.iter().product::<usize>() * materials];
        Self { size, materials, side, cells, sums }
    }

    /// Voxels per axis of the volume.
    #[must_use]
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Number of materials.
    #[must_use]
    pub fn materials(&self) -> usize {
        self.materials
    }

    /// Edge of a cell in voxels.
    #[must_use]
    pub fn side(&self) -> usize {
        self.side
    }

    /// Cells per axis.
    #[must_use]
    pub fn cells(&self) -> [usize; 3] {
        self.cells
    }

    /// The sums of a material in a cell.
    #[must_use]
    pub fn get(&self, material: usize, [x, y, z]: [usize; 3]) -> &CellSums {
        let [across, _, deep] = self.cells;
        &self.sums[((y * deep + z) * across + x) * self.materials + material]
    }

    /// Adds rows of the slices `slices` (voxels), in parallel: `add(y, z, sums)` adds row (y, z) to the sums
    /// `sums[x of the cell * materials + material]`.
    pub fn add_rows(&mut self, slices: Range<usize>, add: impl Fn(usize, usize, &mut [CellSums]) + Sync) {
        let (side, size, row) = (self.side, self.size, self.cells[0] * self.materials);
        self.sums.par_chunks_mut(row * self.cells[2]).enumerate().for_each(|(cell, sums)| {
            for z in slices.clone() {
                let sums = &mut sums[z / side * row..(z / side + 1) * row];
                for y in cell * side..((cell + 1) * side).min(size[1]) {
                    add(y, z, sums);
                }
            }
        });
    }
}
