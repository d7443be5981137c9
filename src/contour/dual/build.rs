//! Makes the unsimplified surface from labels and Hermite data, run of layers by run of layers.
//!
//! Layers of cells may come in any runs; a layer of roots is put together as soon as its cells are complete.
//! Reads labels up to one voxel around, and what Hermite data needs.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::knots::{OddCell, knots};
use super::leaves::{
    Cap, Crossing, Leaves, NONE, Root, flag, pack_sigma, pack_weight, ring_edge, ring_offset,
};
use super::roots::{RootGrid, SIDE, morton, place};
use crate::classify::LabelVolume;
use crate::contour::crossing::Midpoints;
use crate::contour::error::ContourError;
use crate::contour::hermite::{Hermite, HermiteRule};
use crate::contour::marching::{self, Cell};
use crate::contour::patch::Border;
use crate::contour::pattern::{CellLeaves, PatternTable};
use crate::execution::{Execution, Stage};
use crate::grid::cube::edge_corners;
use crate::grid::{Geometry, MaterialId};

/// A cell with a crossing, as it is found.
#[derive(Debug, Clone, Copy)]
struct FoundCell {
    /// Root in its layer of roots (32 bits), then place in the root.
    key: u64,
    entry: u16,
    /// Its crossings among those of its layer.
    first: u32,
    crossings: u8,
}

/// A crossing as it is found: all but its ring and cell.
#[derive(Debug, Clone, Copy)]
struct FoundCrossing {
    hermite: Hermite,
    sigma: f32,
    labels: [MaterialId; 2],
    axis: u8,
}

/// What a layer of cells holds.
#[derive(Debug, Default)]
struct FoundLayer {
    cells: Vec<FoundCell>,
    crossings: Vec<FoundCrossing>,
    /// The materials at the corners of cells that are not simple, by number of the cell.
    labels: Vec<(u32, [MaterialId; 8])>,
}

/// The cells of a root, to look them up by place.
struct Lookup {
    bits: Vec<u64>,
    ranks: Vec<u16>,
    /// Entry and first leaf of each cell.
    cells: Vec<(u16, u32)>,
}

impl Lookup {
    fn new(cells: &[(u16, u16, u32)]) -> Self {
        let mut bits = vec![0u64; SIDE * SIDE * SIDE / 64];
        cells.iter().for_each(|(place, ..)| bits[usize::from(*place) / 64] |= 1 << (place % 64));
        let mut rank = 0;
        let ranks = bits
            .iter()
            .map(|word| {
                let here = rank;
                rank += word.count_ones() as u16;
                here
            })
            .collect();
        Self { bits, ranks, cells: cells.iter().map(|&(_, entry, leaf)| (entry, leaf)).collect() }
    }

    /// Entry and first leaf of the cell at a place.
    #[inline]
    fn get(&self, place: u16) -> (u16, u32) {
        let (word, bit) = (usize::from(place) / 64, place % 64);
        debug_assert!(self.bits[word] >> bit & 1 == 1, "a crossing's cells all have it");
        let before = (self.bits[word] & ((1 << bit) - 1)).count_ones();
        self.cells[usize::from(self.ranks[word]) + before as usize]
    }
}

/// Puts the unsimplified surface together.
pub struct Builder {
    table: &'static PatternTable,
    leaves: Leaves,
    /// Layers that wait for the rest of their layer of roots.
    waiting: Vec<FoundLayer>,
    next_layer: usize,
    /// Lookups of the last layer of roots, by number in the layer.
    below: Vec<Option<Lookup>>,
    /// Foreign crossings as (root, crossing).
    foreign: Vec<(u32, u32)>,
    /// Cells that are not simple.
    odd: Vec<OddCell>,
    /// Whether the rule of the first layers knows sigmas. That of all others is the same kind of rule.
    has_sigmas: bool,
}

impl Builder {
    /// For a volume that lies as `geometry` says.
    #[must_use]
    pub fn new(geometry: &Geometry) -> Self {
        let grid = RootGrid::new(geometry);
        let leaves = Leaves {
            grid,
            roots: Vec::new(),
            places: Vec::new(),
            flags: Vec::new(),
            crossings: Vec::new(),
            sigmas: Vec::new(),
            knows_curves: false,
            foreign: Vec::new(),
            caps: Vec::new(),
            knots: Vec::new(),
            ties: Vec::new(),
        };
        Self {
            table: PatternTable::get(),
            leaves,
            waiting: Vec::new(),
            next_layer: 0,
            below: Vec::new(),
            foreign: Vec::new(),
            odd: Vec::new(),
            has_sigmas: false,
        }
    }

    /// Crossings of the layers that are complete so far.
    #[must_use]
    pub fn crossings(&self) -> u64 {
        self.leaves.crossings.len() as u64
    }

    /// Adds layers of cells, which must follow those before them. `labels` holds their slices of the padded
    /// lattice and `rule` can answer for their edges.
    ///
    /// # Errors
    /// [`ContourError::TooManyVertices`], [`ContourError::Cancelled`].
    ///
    /// # Panics
    /// If the layers do not follow those added before.
    pub fn add(
        &mut self,
        labels: &LabelVolume,
        rule: &dyn HermiteRule,
        layers: Range<usize>,
        execution: &Execution,
        stage: &Stage<'_>,
    ) -> Result<(), ContourError> {
        assert_eq!(layers.start, self.next_layer, "layers come in order");
        if layers.start == 0 {
            self.has_sigmas = rule.has_sigmas();
            self.leaves.knows_curves = rule.knows_curves();
        }
        let mut start = layers.start;
        while start < layers.end {
            let end = (start / SIDE * SIDE + SIDE).min(layers.end);
            let found: Vec<Vec<FoundLayer>> = marching::runs(start..end)
                .into_par_iter()
                .map(|run| self.find(labels, rule, run, execution, stage))
                .collect::<Result<_, _>>()?;
            self.waiting.extend(found.into_iter().flatten());
            if end.is_multiple_of(SIDE) || end == self.leaves.grid.cells[2] {
                self.put_together(end.div_ceil(SIDE) - 1)?;
            }
            start = end;
        }
        self.next_layer = layers.end;
        Ok(())
    }

    /// Finds the cells and crossings of some layers.
    fn find(
        &self,
        labels: &LabelVolume,
        rule: &dyn HermiteRule,
        layers: Range<usize>,
        execution: &Execution,
        stage: &Stage<'_>,
    ) -> Result<Vec<FoundLayer>, ContourError> {
        let mut out = Vec::with_capacity(layers.len());
        let grid = &self.leaves.grid;
        // No kinks: QEFs find sharp edges by themselves.
        marching::walk(labels, &Midpoints, Border::Closed, layers, execution, stage, |layer| {
            let z = layer.z();
            let mut found = FoundLayer::default();
            layer.visit(labels, rule, self.table, |[x, y], corners, entry| {
                let cell = Cell::new(labels, [x, y, z], corners);
                let in_layer = grid.number([x / SIDE, y / SIDE, 0]);
                let key = (in_layer as u64) << 32 | u64::from(morton([x, y, z]));
                let first = found.crossings.len();
                for (axis, edge) in [0, 4, 8].into_iter().enumerate() {
                    let ends = edge_corners(edge).map(|c| cell.labels[c]);
                    if marching::pair_of(ends, Border::Closed).is_some() {
                        found.crossings.push(crossing(rule, [x, y, z], axis, ends));
                    }
                }
                let crossings = (found.crossings.len() - first) as u8;
                found.cells.push(FoundCell { key, entry: entry as u16, first: first as u32, crossings });
                if !self.table.leaves(entry).knots.is_empty() {
                    found.labels.push((found.cells.len() as u32 - 1, cell.labels));
                }
            });
            out.push(found);
        })?;
        Ok(out)
    }

    /// Numbers the leaves and crossings of a complete layer of roots and closes the rings.
    fn put_together(&mut self, layer: usize) -> Result<(), ContourError> {
        let found = std::mem::take(&mut self.waiting);
        let mut order: Vec<(u64, u32, u32)> = found
            .iter()
            .enumerate()
            .flat_map(|(z, f)| f.cells.iter().enumerate().map(move |(i, c)| (c.key, z as u32, i as u32)))
            .collect();
        order.par_sort_unstable();
        let leaves = &mut self.leaves;
        let per_layer = leaves.grid.roots[0] * leaves.grid.roots[1];
        let mut above: Vec<Option<Lookup>> = (0..per_layer).map(|_| None).collect();
        let first_root = leaves.roots.len();
        // Leaves.
        let mut cell_crossings = Vec::with_capacity(order.len());
        for group in order.chunk_by(|a, b| a.0 >> 32 == b.0 >> 32) {
            let in_layer = (group[0].0 >> 32) as usize;
            let mut root = Root { number: layer * per_layer + in_layer, ..Root::default() };
            root.leaves.start = leaves.places.len() as u32;
            let mut cells = Vec::with_capacity(group.len());
            for &(key, z, i) in group {
                let cell = &found[z as usize].cells[i as usize];
                let place = key as u16;
                cells.push((place, cell.entry, leaves.places.len() as u32));
                cell_crossings.push((place, z, cell.first, cell.crossings));
                if !self.table.leaves(cell.entry.into()).knots.is_empty() {
                    let labels = &found[z as usize].labels;
                    let at = labels.partition_point(|(number, _)| *number < i);
                    self.odd.push(OddCell {
                        entry: cell.entry,
                        first_leaf: leaves.places.len() as u32,
                        labels: labels[at].1,
                    });
                }
                let two = self.table.packed().entry(cell.entry.into()).two_materials;
                let curve = if two { 0 } else { flag::CURVE };
                put_leaves(leaves, self.table.leaves(cell.entry.into()), root.number, place, curve);
            }
            root.leaves.end = leaves.places.len() as u32;
            above[in_layer] = Some(Lookup::new(&cells));
            leaves.roots.push(root);
        }
        marching::check_vertices(leaves.places.len() as u64)?;
        // Crossings.
        let mut done = 0;
        for root in first_root..leaves.roots.len() {
            let count =
                above[leaves.roots[root].number - layer * per_layer].as_ref().map_or(0, |l| l.cells.len());
            leaves.roots[root].crossings.start = leaves.crossings.len() as u32;
            for &(cell, z, first, count) in &cell_crossings[done..done + count] {
                let own = &found[z as usize].crossings[first as usize..first as usize + usize::from(count)];
                leaves.crossings.extend(own.iter().map(|c| Crossing {
                    ring: [NONE; 4],
                    normal: c.hermite.normal,
                    position: c.hermite.position,
                    cell,
                    labels: c.labels,
                    axis: c.axis,
                    weight: pack_weight(c.hermite.weight),
                }));
                if self.has_sigmas {
                    leaves.sigmas.extend(own.iter().map(|c| pack_sigma(c.sigma)));
                }
            }
            done += count;
            leaves.roots[root].crossings.end = leaves.crossings.len() as u32;
        }
        if leaves.crossings.len() >= NONE as usize {
            return marching::check_vertices(leaves.crossings.len() as u64);
        }
        let rings = Rings { grid: &leaves.grid, table: self.table, below: &self.below, above: &above };
        let first = leaves.roots[first_root..].first().map_or(0, |r| r.crossings.start) as usize;
        let mut rest = &mut leaves.crossings[first..];
        let tasks: Vec<(&Root, &mut [Crossing])> = leaves.roots[first_root..]
            .iter()
            .filter_map(|root| rest.split_off_mut(..root.crossings.len()).map(|own| (root, own)))
            .collect();
        let foreign: Vec<Vec<(u32, u32)>> =
            tasks.into_par_iter().map(|(root, own)| rings.close(root, own)).collect();
        self.foreign.extend(foreign.into_iter().flatten());
        self.below = above;
        Ok(())
    }

    /// The whole surface, once all layers were added.
    pub(super) fn into_leaves(mut self) -> Leaves {
        let numbers: Vec<u32> = self.leaves.roots.iter().map(|r| r.number as u32).collect();
        self.foreign.par_sort_unstable();
        let leaves = &mut self.leaves;
        let mut at = 0;
        for (root, number) in leaves.roots.iter_mut().zip(numbers) {
            let count = self.foreign[at..].partition_point(|(r, _)| *r <= number);
            root.foreign = at as u32..(at + count) as u32;
            at += count;
        }
        leaves.foreign = self.foreign.into_iter().map(|(_, crossing)| crossing).collect();
        (leaves.knots, leaves.ties) = knots(leaves, self.table, &self.odd);
        self.leaves
    }
}

/// Hermite data of a crossing; at the border it lies across the edge.
fn crossing(rule: &dyn HermiteRule, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> FoundCrossing {
    let (hermite, sigma) = if labels.contains(&MaterialId::OUTSIDE) {
        (Hermite { position: 0.5, normal: Vec3::AXES[axis], weight: 1.0 }, f32::NAN)
    } else {
        (rule.hermite(from, axis, labels), rule.sigma(from, axis, labels))
    };
    FoundCrossing { hermite, sigma, labels, axis: axis as u8 }
}

/// Adds the leaves of a cell.
fn put_leaves(leaves: &mut Leaves, cell: &CellLeaves, root: usize, at: u16, curve: u8) {
    let first = leaves.places.len() as u32;
    let (low, in_root) = (leaves.grid.low(root), place(at));
    let sides = leaves.grid.sides([0, 1, 2].map(|a| low[a] + in_root[a]));
    let border = if sides == 0 { 0 } else { flag::BORDER };
    let crowded = if cell.leaves.len() > 1 { flag::CROWDED } else { 0 };
    for leaf in &cell.leaves {
        let simple = if leaf.simple { flag::SIMPLE } else { 0 };
        let cap = if leaf.cap != 0 { flag::CAP } else { 0 };
        if leaf.cap != 0 {
            let (own, main) = (leaves.places.len() as u32, first + u32::from(leaf.main));
            leaves.caps.push(Cap { leaf: own, main, corners: leaf.cap });
        }
        leaves.places.push(at);
        leaves.flags.push(simple | crowded | cap | border | curve);
    }
}

/// Closes rings.
struct Rings<'a> {
    grid: &'a RootGrid,
    table: &'static PatternTable,
    below: &'a [Option<Lookup>],
    above: &'a [Option<Lookup>],
}

impl Rings<'_> {
    /// Fills in the rings of a root's crossings; returns (other root, crossing) where a ring has leaves of
    /// another root.
    fn close(&self, root: &Root, crossings: &mut [Crossing]) -> Vec<(u32, u32)> {
        let low = self.grid.low(root.number);
        let per_layer = self.grid.roots[0] * self.grid.roots[1];
        let mut foreign = Vec::new();
        for (i, crossing) in crossings.iter_mut().enumerate() {
            let own = place(crossing.cell);
            let axis = usize::from(crossing.axis);
            let mut others = [NONE; 4];
            for k in 0..4 {
                let offset = ring_offset(axis, k);
                let cell = [0, 1, 2].map(|a| low[a] + own[a] - offset[a]);
                let number = self.grid.root_of(cell);
                let lookups = if cell[2] / SIDE == low[2] / SIDE { self.above } else { self.below };
                // All four cells have the crossing, so they are there.
                let Some(lookup) = &lookups[number % per_layer] else { continue };
                let (entry, first) = lookup.get(morton(cell));
                let leaf = self.table.leaves(entry.into()).leaf_of[ring_edge(axis, k)];
                crossing.ring[k] = first + u32::from(leaf);
                let number = number as u32;
                if number != root.number as u32 && !others.contains(&number) {
                    others[k] = number;
                    foreign.push((number, root.crossings.start + i as u32));
                }
            }
        }
        foreign
    }
}
