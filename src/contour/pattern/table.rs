//! The pattern table: 4,140 corner partitions, 5,245 entries with the bits of ambiguous faces.

use std::sync::LazyLock;

use super::face::{FaceCurves, curves, is_ambiguous};
use super::leaves::{CellLeaves, cell_leaves};
use super::packed::Packed;
use super::partition::{PARTITIONS, Partitions};
use super::surface::{CellSurface, cell_surface};
use crate::grid::cube::FACES;

/// Number of entries: the sum over partitions of 2 to the number of ambiguous faces.
pub const ENTRIES: usize = 5245;

/// The derived table; get it with [`PatternTable::get`].
#[derive(Debug)]
pub struct PatternTable {
    partitions: Partitions,
    /// First entry of each partition.
    first: Vec<u16>,
    /// Ambiguous faces of each partition, as a bit set.
    ambiguous: Vec<u8>,
    /// Faces with a node (three or four materials in a star), as a bit set.
    star_faces: Vec<u8>,
    surfaces: Vec<CellSurface>,
    leaves: Vec<CellLeaves>,
    packed: Packed,
}

impl PatternTable {
    /// The table, derived on first use (some milliseconds).
    #[must_use]
    pub fn get() -> &'static Self {
        static TABLE: LazyLock<PatternTable> = LazyLock::new(PatternTable::derive);
        &TABLE
    }

    fn derive() -> Self {
        let partitions = Partitions::new();
        let mut first = Vec::with_capacity(PARTITIONS);
        let mut ambiguous = Vec::with_capacity(PARTITIONS);
        let mut star_faces = Vec::with_capacity(PARTITIONS);
        let mut surfaces = Vec::with_capacity(ENTRIES);
        let mut leaves = Vec::with_capacity(ENTRIES);
        for classes in partitions.iter() {
            let faces = (0..FACES).filter(|&f| is_ambiguous(classes, f)).fold(0u8, |set, f| set | 1 << f);
            let is_star = |f: &usize| {
                matches!(curves(classes, *f, false), FaceCurves::Triple(_) | FaceCurves::Quadruple)
            };
            star_faces.push((0..FACES).filter(is_star).fold(0u8, |set, f| set | 1 << f));
            first.push(surfaces.len() as u16);
            ambiguous.push(faces);
            for code in 0..1u8 << faces.count_ones() {
                surfaces.push(cell_surface(classes, spread(code, faces)));
                leaves.push(cell_leaves(classes, spread(code, faces)));
            }
        }
        let packed = Packed::new(&partitions, &first, &ambiguous, &star_faces, &surfaces);
        Self { partitions, first, ambiguous, star_faces, surfaces, leaves, packed }
    }

    /// The corner partitions that the entries belong to.
    #[must_use]
    pub fn partitions(&self) -> &Partitions {
        &self.partitions
    }

    /// The ambiguous faces of a partition, as a bit set.
    #[must_use]
    pub fn ambiguous_faces(&self, partition: usize) -> u8 {
        self.ambiguous[partition]
    }

    /// The faces of a partition that have a node, as a bit set.
    #[must_use]
    pub fn star_faces(&self, partition: usize) -> u8 {
        self.star_faces[partition]
    }

    /// The entry of a partition; `join_first` has bit f set where ambiguous face f joins the
    /// diagonal through its lowest corner. Bits of other faces do not matter.
    #[must_use]
    pub fn entry(&self, partition: usize, join_first: u8) -> usize {
        usize::from(self.first[partition]) + usize::from(gather(join_first, self.ambiguous[partition]))
    }

    /// The surface of an entry.
    #[must_use]
    pub fn surface(&self, entry: usize) -> &CellSurface {
        &self.surfaces[entry]
    }

    /// The vertices of dual contouring of an entry.
    #[must_use]
    pub fn leaves(&self, entry: usize) -> &CellLeaves {
        &self.leaves[entry]
    }

    /// The same entries in flat arrays.
    #[must_use]
    pub fn packed(&self) -> &Packed {
        &self.packed
    }

    /// Number of entries.
    #[must_use]
    pub fn len(&self) -> usize {
        self.surfaces.len()
    }

    /// Whether the table has no entries (never).
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.surfaces.is_empty()
    }
}

/// Moves the low bits of `code` to the set bits of `mask`, in order.
fn spread(code: u8, mask: u8) -> u8 {
    let set = (0..8).filter(|&bit| mask >> bit & 1 == 1);
    set.enumerate().fold(0, |out, (i, bit)| out | (code >> i & 1) << bit)
}

/// The inverse of [`spread`]: the bits of `bits` under `mask`, packed.
fn gather(bits: u8, mask: u8) -> u8 {
    let set = (0..8).filter(|&bit| mask >> bit & 1 == 1);
    set.enumerate().fold(0, |out, (i, bit)| out | (bits >> bit & 1) << i)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contour::pattern::Apex;

    #[test]
    fn there_are_5245_entries_and_caps_where_the_prototype_needed_them() {
        let table = PatternTable::get();
        assert_eq!(table.len(), ENTRIES);
        let mut needing = [0usize; 5];
        let mut corners = [0usize; 9];
        for partition in 0..PARTITIONS {
            // The fixed-diagonal rule: bit 0 on every ambiguous face.
            let surface = table.surface(table.entry(partition, 0));
            let caps = surface.apexes.iter().filter(|a| matches!(a, Apex::Cap { .. })).count();
            needing[caps] += 1;
        }
        for entry in 0..table.len() {
            for apex in &table.surface(entry).apexes {
                if let Apex::Cap { corners: c, .. } = apex {
                    corners[c.count_ones() as usize] += 1;
                }
            }
        }
        println!("caps by count {needing:?}, by corners {corners:?}");
        assert_eq!(needing[1..].iter().sum::<usize>(), 857);
    }
}
