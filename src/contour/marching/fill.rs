//! Second pass over a layer: its vertices and triangles, written to their place.

use crate::classify::LabelVolume;
use crate::contour::crossing::CrossingRule;
use crate::contour::patch::Border;
use crate::contour::pattern::PatternTable;
use crate::grid::cube::{EDGES, FACES, face_ring};
use crate::grid::{MaterialId, Pair, VertexKind};

use super::cell::{Cell, crossing_position};
use super::count::{LayerCount, pair_of};
use super::edge_rows::LayerEdges;

/// A layer's share of the output.
pub(super) struct LayerSlices<'a> {
    pub(super) first_vertex: u32,
    pub(super) positions: &'a mut [[f32; 3]],
    pub(super) kinds: &'a mut [VertexKind],
    pub(super) triangles: &'a mut [[u32; 3]],
    pub(super) pairs: &'a mut [Pair],
}

/// Numbers of the first vertex of each group that a layer owns.
struct Firsts {
    /// Crossings along x, y, z.
    crossings: [u32; 3],
    /// Nodes of lower x, y, z faces.
    nodes: [u32; 3],
    apexes: u32,
}

impl Firsts {
    fn new(first: u32, count: &LayerCount) -> Self {
        let mut next = first;
        let mut take = |n: u32| {
            let at = next;
            next += n;
            at
        };
        let crossings = count.crossings.map(&mut take);
        let nodes = [0, 1, 2].map(|a| take(count.face_nodes[a].len() as u32));
        Self { crossings, nodes, apexes: take(count.apexes) }
    }
}

/// Fills the output of layer `z`; `above` is the next layer's count and first vertex.
pub(super) fn fill_layer<C: CrossingRule>(
    labels: &LabelVolume,
    rule: &C,
    border: Border,
    z: usize,
    count: &LayerCount,
    above: Option<(&LayerCount, u32)>,
    out: LayerSlices<'_>,
) {
    let table = PatternTable::get();
    let edges = LayerEdges::new(labels, z, border);
    let first = out.first_vertex;
    let here = Firsts::new(first, count);
    let above = above.map(|(count, first)| (count, Firsts::new(first, count)));
    let mut vertices = Vertices { first, positions: out.positions, kinds: out.kinds };

    for (axis, rows) in [&edges.plane[0][0], &edges.plane[0][1], &edges.up].into_iter().enumerate() {
        for (i, (x, y)) in rows.iter().enumerate() {
            let from = [x, y, z];
            let mut to = from;
            to[axis] += 1;
            let ends = [labels.at(from), labels.at(to)];
            let mut at = [0.0; 3];
            at[axis] = crossing_position(rule, from, axis, ends);
            let outside = ends.contains(&MaterialId::OUTSIDE);
            vertices.put(here.crossings[axis] + i as u32, from, at, VertexKind::new(2, outside));
        }
    }

    let row = labels.codes().padded()[0];
    let node = |cell: &Cell, f: usize| -> u32 {
        // A face's node is owned by the cell above it along the face's axis.
        let mut low = cell.low;
        low[f / 2] += f & 1;
        let key = (low[1] * row + low[0]) as u32;
        let (nodes, first) = match (&above, f) {
            (Some((count, firsts)), 5) => (&count.face_nodes[2], firsts.nodes[2]),
            _ => (&count.face_nodes[f / 2], here.nodes[f / 2]),
        };
        first + nodes.binary_search(&key).unwrap_or(0) as u32
    };

    let mut ids = [0u32; EDGES + FACES];
    let (mut next_triangle, mut next_apex) = (0, here.apexes);
    let mut next_node = here.nodes;
    for active in &count.cells {
        let (x, y) = (usize::from(active.x), usize::from(active.y));
        let cell = Cell::new(labels, [x, y, z]);
        let surface = table.surface(usize::from(active.entry));
        let mut crossed = surface.crossings;
        while crossed != 0 {
            let e = crossed.trailing_zeros() as usize;
            crossed &= crossed - 1;
            let (low, high) = (e & 1, e >> 1 & 1);
            ids[e] = match e / 4 {
                2 => here.crossings[2] + edges.up.rank(x + low, y + high),
                axis => {
                    let firsts = if high == 1 { above.as_ref().map_or(&here, |a| &a.1) } else { &here };
                    let (dx, dy) = if axis == 0 { (0, low) } else { (low, 0) };
                    firsts.crossings[axis] + edges.plane[high][axis].rank(x + dx, y + dy)
                }
            };
        }
        let apex = next_apex;
        if !surface.apexes.is_empty() {
            let positions = cell.apexes(rule, surface);
            for (at, &corners) in positions.into_iter().zip(&surface.apex_corners) {
                let kind = cell.kind((0..8).filter(|c| corners >> c & 1 == 1), border);
                vertices.put(next_apex, cell.low, at, kind);
                next_apex += 1;
            }
            let nodes = surface.triangles.iter().flat_map(|t| t.vertices).filter(|v| (12..18).contains(v));
            for f in nodes.map(|v| usize::from(v) - EDGES).collect::<std::collections::BTreeSet<_>>() {
                ids[EDGES + f] = node(&cell, f);
                if f & 1 == 0 {
                    let kind = cell.kind(face_ring(f), border);
                    vertices.put(ids[EDGES + f], cell.low, cell.face_node(rule, f), kind);
                    next_node[f / 2] += 1;
                }
            }
        }
        for t in &surface.triangles {
            let Some((pair, turn)) = pair_of(&cell, t, border) else { continue };
            let [a, b, c] = t.vertices.map(|v| match usize::from(v).checked_sub(EDGES + FACES) {
                Some(i) => apex + i as u32,
                None => ids[usize::from(v)],
            });
            out.triangles[next_triangle] = if turn { [a, c, b] } else { [a, b, c] };
            out.pairs[next_triangle] = pair;
            next_triangle += 1;
        }
    }
    debug_assert_eq!(next_triangle, count.triangles);
    debug_assert_eq!(next_apex, here.apexes + count.apexes);
    debug_assert!((0..3).all(|a| next_node[a] == here.nodes[a] + count.face_nodes[a].len() as u32));
}

/// The vertices of a layer.
struct Vertices<'a> {
    first: u32,
    positions: &'a mut [[f32; 3]],
    kinds: &'a mut [VertexKind],
}

impl Vertices<'_> {
    /// Writes vertex `id` at padded point `low` plus `offset`.
    fn put(&mut self, id: u32, low: [usize; 3], offset: [f32; 3], kind: VertexKind) {
        let i = (id - self.first) as usize;
        // The padded lattice begins one voxel before the volume.
        self.positions[i] = std::array::from_fn(|a| low[a] as f32 - 1.0 + offset[a]);
        self.kinds[i] = kind;
    }
}
