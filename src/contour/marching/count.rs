//! First pass over a layer: the table entries of its active cells, and how much it will write.

use super::Job;
use super::cell::{Cell, pair_of};
use super::corners::{Corners, visit_cells};
use super::kinks::Bent;
use super::lattice::Layer;
use crate::classify::LabelVolume;
use crate::contour::crossing::CrossingRule;
use crate::contour::pattern::{CellTriangle, PatternTable};

/// What a layer of cells will write.
#[derive(Debug)]
pub(super) struct LayerCount {
    /// Its vertices: in its lower plane, up to the next, and inside its cells.
    pub(super) vertices: usize,
    /// Its triangles.
    pub(super) triangles: usize,
    /// The entries of its active cells in row-major order.
    pub(super) entries: Vec<u16>,
}

impl LayerCount {
    pub(super) fn new<C: CrossingRule>(job: &Job<'_, C>, layer: Layer<'_>) -> Self {
        let packed = job.table.packed();
        let vertices = (layer.lower.vertices() + layer.between.vertices()) as usize;
        let mut out = Self { vertices, triangles: 0, entries: Vec::new() };
        let z = layer.lower.z;
        let mut active = Vec::new();
        for y in 0..job.labels.codes().padded()[1] - 1 {
            layer.active(y, &mut active);
            visit_cells(job.labels, [y, z], &active, |x, corners| {
                let (entry, two) = entry(job.labels, job.rule, job.table, [x, y, z], corners);
                let summary = packed.entry(entry);
                out.entries.push(entry as u16);
                out.vertices += usize::from(summary.apexes);
                out.triangles += if two {
                    usize::from(summary.triangles)
                } else {
                    let cell = Cell::new(job.labels, [x, y, z], corners);
                    let pair = |t: &&_| pair_of(cell.sides(t), job.border).is_some();
                    packed.triangles(&summary).iter().filter(pair).count()
                };
                if job.rule.has_kinks() {
                    out.add_kinks(packed.triangles(&summary), layer.kinks(x, y));
                }
            });
        }
        out
    }

    /// Adds what the kinks of a cell's faces add: each divides an edge of one triangle, and a tip stands in for the start
    /// of a fan.
    #[inline]
    fn add_kinks(&mut self, triangles: &[CellTriangle], kinked: u8) {
        if kinked != 0 {
            let tips = Bent::new(triangles, kinked).tips();
            self.vertices += tips;
            self.triangles += kinked.count_ones() as usize + 2 * tips;
        }
    }
}

/// The table's entry for a cell, and whether it has just two materials (all its triangles are needed
/// then, or it would not be active).
#[inline(always)]
pub(super) fn entry<C: CrossingRule + ?Sized>(
    labels: &LabelVolume,
    rule: &C,
    table: &PatternTable,
    low: [usize; 3],
    corners: Corners,
) -> (usize, bool) {
    let (differing, two) = corners.differing();
    if two && let Some(entry) = table.packed().entry_of_mask(differing) {
        return (entry, true);
    }
    (rare_entry(labels, rule, table, low, corners), two)
}

/// The table's entry for a cell with more materials or an ambiguous face.
#[inline(never)]
fn rare_entry<C: CrossingRule + ?Sized>(
    labels: &LabelVolume,
    rule: &C,
    table: &PatternTable,
    low: [usize; 3],
    corners: Corners,
) -> usize {
    let (differing, two) = corners.differing();
    let cell = Cell::new(labels, low, corners);
    let partition = match corners.two_planes() {
        _ if two => table.partitions().index_of_mask(differing),
        Some(codes) => table.packed().partition_of_codes(codes),
        None => table.partitions().index(&cell.labels),
    };
    cell.entry(table, rule, partition)
}
