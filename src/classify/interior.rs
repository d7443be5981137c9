//! The voxels well inside of each material: sums of their grey values for its local level.
//!
//! A core voxel has its whole ball of radius R (2.5 sigma of the blur) in its own grey class. At its edge 0.6 %
//! of the next material is still left, which is 2 % of the contrast of a weak pair beside a strong one. So a
//! voxel counts only if its six neighbours are core as well: another voxel further in, at 3.3 sigma of the usual
//! blur, where less than 0.1 % is left. Voxels at the volume's border do not count.

use std::ops::Range;

use super::bit_planes::{BitPlanes, WORD};
use crate::material::LevelSums;
use crate::volume::{Sample, Slab};

/// Adds the voxels well inside of each material in the padded slices `slices`. `core` must hold a slice more on
/// both sides, as far as there are voxels.
pub(super) fn add_interior<S: Sample>(
    sums: &mut LevelSums,
    slab: Slab<'_, S>,
    core: &BitPlanes,
    slices: Range<usize>,
) {
    let (side, materials, words) = (sums.side(), sums.materials(), core.words());
    let held = core.voxel_slices();
    sums.add_rows(slices.start - 1..slices.end - 1, |y, z, sums| {
        let (py, pz) = (y + 1, z + 1);
        if pz <= held.start || pz + 1 >= held.end {
            return;
        }
        let samples = slab.row(y, z);
        for material in 0..materials {
            let row = core.row(material, py, pz);
            let around = [(py - 1, pz), (py + 1, pz), (py, pz - 1), (py, pz + 1)];
            let around = around.map(|(y, z)| core.row(material, y, z));
            // Voxels come by ascending x; those of one cell are one run.
            let mut voxels = (0..words).flat_map(|w| Bits(inside(row, &around, w), w * WORD)).peekable();
            while let Some(&first) = voxels.peek() {
                let cell = (first - 1) / side;
                let end = (cell + 1) * side + 1;
                let run = std::iter::from_fn(|| voxels.next_if(|&bit| bit < end));
                sums[cell * materials + material].add_row(
                    y % side,
                    z % side,
                    run.map(|bit| ((bit - 1) % side, samples[bit - 1].to_f32())),
                );
            }
        }
    });
}

/// The bits of word w that are set with their neighbours in the row and in the rows around it.
fn inside(row: &[u64], around: &[&[u64]; 4], w: usize) -> u64 {
    let before = w.checked_sub(1).map_or(0, |w| row[w]);
    let behind = row.get(w + 1).copied().unwrap_or(0);
    let sides = (row[w] << 1 | before >> (WORD - 1)) & (row[w] >> 1 | behind << (WORD - 1));
    around.iter().fold(row[w] & sides, |bits, row| bits & row[w])
}

/// The numbers of the bits that are set in a word, ascending, from an offset on.
struct Bits(u64, usize);

impl Iterator for Bits {
    type Item = usize;

    fn next(&mut self) -> Option<usize> {
        let bit = self.0.trailing_zeros() as usize;
        self.0 &= self.0.wrapping_sub(1);
        (bit < WORD).then_some(self.1 + bit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classify::passes::Passes;
    use crate::material::MaterialTable;

    /// A tilted wall in air, on a lattice that ends within a word.
    fn wall(size: [usize; 3]) -> Vec<f32> {
        (0..size.iter().product::<usize>())
            .map(|i| {
                let [x, y, z] = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])];
                let d = 0.8 * x as f32 + 0.5 * y as f32 - 0.3 * z as f32 - 30.0;
                100.0 + 0.37 * z as f32 + if d.abs() < 12.0 { 900.0 } else { 0.0 }
            })
            .collect()
    }

    #[test]
    fn slabs_add_up_to_the_whole_and_places_are_right() {
        let size = [93, 21, 40];
        let samples = wall(size);
        let slab = Slab::whole(&samples, size);
        let table = MaterialTable::new([("air", 107.0), ("al", 1007.0)]).unwrap();
        let passes = Passes::new(size, &table, [2.0; 3]);
        let sums = |thickness: usize| {
            let mut sums = LevelSums::new(size, 2);
            for first in (1..=size[2]).step_by(thickness) {
                let slices = first..(first + thickness).min(size[2] + 1);
                let decided = passes.decide_and(slab, slices.clone(), |core| {
                    add_interior(&mut sums, slab, core, slices);
                });
                assert!(decided.b.count() == 2);
            }
            sums
        };
        let whole = sums(size[2]);
        for thickness in [1, 3, 7, 16] {
            assert_eq!(sums(thickness), whole, "{thickness}");
        }
        // Every voxel counted has its own material's grey value at its place.
        let mut voxels = 0;
        for cell in 0..whole.cells().iter().product::<usize>() {
            let [nx, ny, _] = whole.cells();
            let at = [cell % nx, cell / nx % ny, cell / (nx * ny)];
            for material in 0..2 {
                let s = whole.get(material, at);
                voxels += s.voxels;
                let base = [100.0, 1000.0][material] * s.voxels as f64;
                let z = s.places[2] as f64 + (s.voxels * (at[2] * whole.side()) as u64) as f64;
                assert!((s.grey - base - 0.37 * z).abs() < 1e-3 * base.max(1.0));
                assert!(s.places[0] <= 15 * s.voxels && s.products[0] <= 225 * s.voxels);
            }
        }
        assert!(voxels > 10_000, "{voxels}");
    }
}
