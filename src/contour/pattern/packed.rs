//! The table in the form in which millions of cells read it: flat arrays, few bytes an entry.

use super::partition::{Classes, PARTITIONS, Partitions};
use super::surface::{CellSurface, CellTriangle};
use crate::grid::cube::{CORNERS, EDGES, FACES};

/// Vertices that a cell can have: crossings, face nodes and apexes, rounded up to a power of two.
pub const CELL_VERTICES: usize = 32;

/// What an entry says about a cell, but for its triangles.
#[derive(Debug, Clone, Copy)]
pub struct PackedEntry {
    /// Cell edges with a crossing, as a bit set.
    pub crossings: u16,
    first_triangle: u32,
    /// Number of triangles.
    pub triangles: u8,
    /// Number of vertices inside the cell.
    pub apexes: u8,
    /// Faces with a node, as a bit set.
    pub star_faces: u8,
    /// Whether the corners have just two materials. If so, the one at corner 0 is behind all triangles.
    pub two_materials: bool,
}

/// Entries and triangles in flat arrays.
#[derive(Debug)]
pub struct Packed {
    entries: Vec<PackedEntry>,
    triangles: Vec<CellTriangle>,
    /// By the corners that differ from corner 0, halved: the entry of a cell with two materials and no
    /// ambiguous face, or [`Packed::UNDECIDED`].
    by_mask: [u16; 128],
    /// The partition of eight two-bit codes: low bits first, then high bits.
    by_codes: Vec<u16>,
}

impl Packed {
    /// Stands for an entry that depends on ambiguous faces.
    const UNDECIDED: u16 = u16::MAX;

    pub(super) fn new(
        partitions: &Partitions,
        first: &[u16],
        ambiguous: &[u8],
        star_faces: &[u8],
        surfaces: &[CellSurface],
    ) -> Self {
        let mut out = Self {
            entries: Vec::with_capacity(surfaces.len()),
            triangles: Vec::new(),
            by_mask: [Self::UNDECIDED; 128],
            by_codes: vec![0; 1 << (2 * CORNERS)],
        };
        for (partition, classes) in partitions.iter().enumerate() {
            let end = first.get(partition + 1).map_or(surfaces.len(), |&f| usize::from(f));
            for surface in &surfaces[usize::from(first[partition])..end] {
                out.push(classes, star_faces[partition], surface);
            }
        }
        for half in 0..128u8 {
            let partition = partitions.index_of_mask(half << 1);
            if ambiguous[partition] == 0 {
                out.by_mask[usize::from(half)] = first[partition];
            }
        }
        for (codes, partition) in out.by_codes.iter_mut().enumerate() {
            let labels: Classes =
                std::array::from_fn(|c| (codes >> c & 1 | (codes >> (c + 8) & 1) << 1) as u8);
            *partition = partitions.index(&labels) as u16;
        }
        debug_assert_eq!(star_faces.len(), PARTITIONS);
        out
    }

    fn push(&mut self, classes: &Classes, star_faces: u8, surface: &CellSurface) {
        let two_materials = classes.iter().all(|&c| c < 2);
        self.entries.push(PackedEntry {
            crossings: surface.crossings,
            first_triangle: self.triangles.len() as u32,
            triangles: surface.triangles.len() as u8,
            apexes: surface.apexes.len() as u8,
            star_faces,
            two_materials,
        });
        debug_assert!(EDGES + FACES + surface.apexes.len() <= CELL_VERTICES);
        self.triangles.extend(surface.triangles.iter().map(|t| {
            if two_materials && classes[usize::from(t.behind)] != 0 {
                let [a, b, c] = t.vertices;
                CellTriangle { vertices: [a, c, b], behind: t.ahead, ahead: t.behind }
            } else {
                *t
            }
        }));
    }

    /// An entry.
    #[must_use]
    #[inline]
    pub fn entry(&self, entry: usize) -> PackedEntry {
        self.entries[entry]
    }

    /// The triangles of an entry.
    #[must_use]
    #[inline]
    pub fn triangles(&self, entry: &PackedEntry) -> &[CellTriangle] {
        let first = entry.first_triangle as usize;
        &self.triangles[first..first + usize::from(entry.triangles)]
    }

    /// The entry of a cell with two materials, by the corners that differ from corner 0; `None` if it
    /// depends on ambiguous faces.
    #[must_use]
    #[inline]
    pub fn entry_of_mask(&self, differing: u8) -> Option<usize> {
        let entry = self.by_mask[usize::from(differing >> 1)];
        (entry != Self::UNDECIDED).then_some(usize::from(entry))
    }

    /// The partition of eight codes of two bits: bit c of `codes` is the low bit of the code at corner
    /// c, bit c + 8 the high bit.
    #[must_use]
    #[inline]
    pub fn partition_of_codes(&self, codes: usize) -> usize {
        usize::from(self.by_codes[codes & 0xFFFF])
    }
}
