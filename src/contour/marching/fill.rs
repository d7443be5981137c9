//! Second pass over a layer: its vertices and triangles, written to their place.

use super::Job;
use super::bit_rows::BitRows;
use super::cell::{Cell, crossing_node, crossing_position, pair_of};
use super::code_rows::{CodeRow, MAX_PLANES, code};
use super::corners::{Corners, visit_cells};
use super::count::LayerCount;
use super::kinks::{KINK, TIP, kink_of};
use super::lattice::{Between, Layer, Plane};
use crate::classify::{WORD, set_bits};
use crate::contour::crossing::{CrossingRule, Node};
use crate::contour::moves::Move;
use crate::contour::pattern::{CELL_VERTICES, CellTriangle, PackedEntry};
use crate::contour::piece::SeamKey;
use crate::grid::cube::{EDGES, FACES, face_ring};
use crate::grid::{MaterialId, Pair, VertexKind};

/// A layer's share of the output.
pub(super) struct LayerSlices<'a> {
    /// Number of its first vertex. Those of the layer above follow its own.
    pub(super) first_vertex: u32,
    pub(super) vertices: VertexSlices<'a>,
    pub(super) triangles: &'a mut [[u32; 3]],
    pub(super) pairs: &'a mut [Pair],
}

/// Vertices to be written.
pub(super) struct VertexSlices<'a> {
    pub(super) positions: &'a mut [[f32; 3]],
    pub(super) kinds: &'a mut [VertexKind],
    /// Empty if none are known.
    pub(super) sigmas: &'a mut [f32],
}

impl<'a> VertexSlices<'a> {
    /// A patch's lists; `sigmas` is empty if none are known.
    pub(super) fn of(
        positions: &'a mut [[f32; 3]],
        kinds: &'a mut [VertexKind],
        sigmas: &'a mut [f32],
    ) -> Self {
        Self { positions, kinds, sigmas }
    }

    /// Writes vertex `i`, which lies at `node` from padded point `low`.
    fn put(&mut self, i: usize, low: [usize; 3], node: Node, kind: VertexKind) {
        self.positions[i] = place(low, node.at);
        self.kinds[i] = kind;
        if let Some(sigma) = self.sigmas.get_mut(i) {
            *sigma = node.sigma;
        }
    }

    /// Puts vertex `i`, which was written, elsewhere.
    fn shift(&mut self, i: usize, moved: &Move) {
        self.positions[i] = moved.at;
        if let Some(sigma) = self.sigmas.get_mut(i) {
            *sigma = moved.sigma;
        }
    }
}

/// Fills the output of a layer.
pub(super) fn fill_layer<C: CrossingRule>(
    job: &Job<'_, C>,
    layer: Layer<'_>,
    count: &LayerCount,
    mut out: LayerSlices<'_>,
) {
    let mut next = 0;
    put_plane(job, layer.lower, &mut out.vertices, &mut next);
    put_between(job, layer.between, &mut out.vertices, &mut next);
    let mut cells = CellWriter {
        job,
        apex: next,
        first_vertex: out.first_vertex,
        vertices: out.vertices,
        triangles: out.triangles,
        pairs: out.pairs,
        next_triangle: 0,
    };
    let mut entries = count.entries.iter();
    let mut active = Vec::new();
    let z = layer.lower.z;
    let above = out.first_vertex + count.vertices as u32;
    for y in 0..job.labels.codes().padded()[1] - 1 {
        layer.active(y, &mut active);
        let mut numbers = RowNumbers::new(layer, y, out.first_vertex, above);
        visit_cells(job.labels, [y, z], &active, |x, corners| {
            if let Some(&entry) = entries.next() {
                let kinked = if job.rule.has_kinks() { layer.kinks(x, y) } else { 0 };
                cells.put([x, y, z], corners, usize::from(entry), kinked, &mut numbers);
            }
        });
    }
    debug_assert_eq!(cells.next_triangle, count.triangles);
    debug_assert_eq!(cells.apex, count.vertices);
}

/// Writes the vertices in a plane from `next` on.
pub(super) fn put_plane<C: CrossingRule>(
    job: &Job<'_, C>,
    plane: &Plane,
    out: &mut VertexSlices<'_>,
    next: &mut usize,
) {
    for (axis, edges) in plane.edges.iter().enumerate() {
        put_crossings(job, edges, axis, plane.z, out, next);
    }
    put_nodes(job, &plane.nodes, 2, plane.z, out, next);
    put_kinks(job, &plane.kinks, 2, plane.z, out, next);
}

/// Moves those vertices of a kind in plane `z` that the rule puts elsewhere; `first` is the first of them.
fn put_moves<C: CrossingRule>(
    job: &Job<'_, C>,
    rows: &BitRows,
    kind: u64,
    z: usize,
    out: &mut VertexSlices<'_>,
    first: usize,
) {
    let Some(moves) = job.rule.moves() else { return };
    for moved in moves.in_plane(kind, z) {
        let [x, y, _] = moved.key.low();
        if let Some(number) = rows.number(x, y) {
            out.shift(first + number as usize, moved);
        }
    }
}

/// Writes the vertices between two planes from `next` on.
fn put_between<C: CrossingRule>(
    job: &Job<'_, C>,
    between: &Between,
    out: &mut VertexSlices<'_>,
    next: &mut usize,
) {
    put_crossings(job, &between.edges, 2, between.z, out, next);
    for (axis, nodes) in between.nodes.iter().enumerate() {
        put_nodes(job, nodes, axis, between.z, out, next);
    }
    for (axis, kinks) in between.kinks.iter().enumerate() {
        put_kinks(job, kinks, axis, between.z, out, next);
    }
}

/// Writes the crossings of edges along `axis` with lower ends in plane `z`.
fn put_crossings<C: CrossingRule>(
    job: &Job<'_, C>,
    edges: &BitRows,
    axis: usize,
    z: usize,
    out: &mut VertexSlices<'_>,
    next: &mut usize,
) {
    let first = *next;
    if out.sigmas.is_empty() {
        // As for cells: loops over few planes are worth unrolling.
        match job.labels.codes().count() {
            0..=2 => put_crossings_of::<2, C>(job, edges, axis, z, out, next),
            3 => put_crossings_of::<3, C>(job, edges, axis, z, out, next),
            _ => put_crossings_of::<MAX_PLANES, C>(job, edges, axis, z, out, next),
        }
    } else {
        // A loop of its own: the other one is what every surface pays for.
        for (x, y) in edges.iter() {
            let (from, mut to) = ([x, y, z], [x, y, z]);
            to[axis] += 1;
            let ends = [from, to].map(|p| job.labels.at(p));
            let kind = VertexKind::new(2, ends.contains(&MaterialId::OUTSIDE));
            out.put(*next, from, crossing_node(job.rule, from, axis, ends), kind);
            *next += 1;
        }
    }
    put_moves(job, edges, SeamKey::EDGES[axis], z, out, first);
}

/// The same for no more than `P` code planes and without standard deviations.
fn put_crossings_of<const P: usize, C: CrossingRule>(
    job: &Job<'_, C>,
    edges: &BitRows,
    axis: usize,
    z: usize,
    out: &mut VertexSlices<'_>,
    next: &mut usize,
) {
    let end = *next + edges.total() as usize;
    let mut places = out.positions[*next..end].iter_mut().zip(&mut out.kinds[*next..end]);
    *next = end;
    for y in edges.filled_rows() {
        let here = CodeRow::new(job.labels, y, z);
        let there = match axis {
            0 => here,
            1 => CodeRow::new(job.labels, y + 1, z),
            _ => CodeRow::new(job.labels, y, z + 1),
        };
        for (w, &word) in edges.row(y).iter().enumerate().filter(|(_, word)| **word != 0) {
            let (near, far) =
                (here.words::<P>(w), if axis == 0 { here.next_words(w) } else { there.words(w) });
            for (bit, (position, kind)) in set_bits(word).zip(&mut places) {
                let from = [WORD * w + bit, y, z];
                let ends = [&near, &far].map(|words| job.labels.material_of_code(code(words, bit)));
                let mut offset = [0.0; 3];
                offset[axis] = crossing_position(job.rule, from, axis, ends);
                *position = place(from, offset);
                *kind = VertexKind::new(2, ends.contains(&MaterialId::OUTSIDE));
            }
        }
    }
}

/// Writes the nodes of faces across `axis` whose lowest corner lies in plane `z`.
fn put_nodes<C: CrossingRule>(
    job: &Job<'_, C>,
    faces: &BitRows,
    axis: usize,
    z: usize,
    out: &mut VertexSlices<'_>,
    next: &mut usize,
) {
    let first = *next;
    for (x, y) in faces.iter() {
        let cell = Cell::of_face(job.labels, [x, y, z], axis);
        let kind = cell.kind(face_ring(2 * axis), job.border);
        out.put(*next, cell.low, cell.face_node(job.rule, 2 * axis), kind);
        *next += 1;
    }
    put_moves(job, faces, SeamKey::NODES[axis], z, out, first);
}

/// Writes the kinks of faces across `axis` whose lowest corner lies in plane `z`.
fn put_kinks<C: CrossingRule>(
    job: &Job<'_, C>,
    faces: &BitRows,
    axis: usize,
    z: usize,
    out: &mut VertexSlices<'_>,
    next: &mut usize,
) {
    let first = *next;
    for (x, y) in faces.iter() {
        // There is one: the bit was set by it.
        if let Some(kink) = kink_of(job.rule, [x, y, z], axis) {
            out.put(*next, [x, y, z], kink, VertexKind::Interface);
        }
        *next += 1;
    }
    put_moves(job, faces, SeamKey::KINKS[axis], z, out, first);
}

/// Position in lattice units of what lies `offset` from padded point `low`.
#[inline]
pub(super) fn place(low: [usize; 3], offset: [f32; 3]) -> [f32; 3] {
    // The padded lattice begins one voxel before the volume.
    // From 32 bits it is one instruction, from 64 unsigned ones it is not.
    std::array::from_fn(|a| low[a] as i32 as f32 - 1.0 + offset[a])
}

/// Numbers of the vertices around the next active cell of a row of cells. They are carried along: the
/// cells between two active ones touch no vertex.
struct RowNumbers {
    /// Crossings of x edges, in the order of a cell's edges.
    x: [u32; 4],
    /// Crossings of y edges in the lower and in the upper plane.
    y: [u32; 2],
    /// Crossings of z edges in row y and in row y + 1.
    z: [u32; 2],
    /// Nodes of x faces; of y faces in row y and in row y + 1; of z faces in the lower and in the upper
    /// plane.
    nodes: [u32; 5],
    /// Kinks of the same faces.
    kinks: [u32; 5],
    /// Those of the cell at hand, by the table's numbering. For edges and faces without a vertex they mean
    /// nothing.
    ids: [u32; CELL_VERTICES],
}

impl RowNumbers {
    /// For row `y` of a layer; `first` and `above` are the first vertices of this layer and the next.
    fn new(layer: Layer<'_>, y: usize, first: u32, above: u32) -> Self {
        let (lower, between, upper) = (layer.lower, layer.between, layer.upper);
        // Where the groups of vertices begin.
        let in_plane = |plane: &Plane, first: u32| {
            let y_edges = first + plane.edges[0].total();
            [first, y_edges, y_edges + plane.edges[1].total()]
        };
        let (low, up) = (in_plane(lower, first), in_plane(upper, above));
        let z_edges = first + lower.vertices();
        let x_nodes = z_edges + between.edges.total();
        let y_nodes = x_nodes + between.nodes[0].total();
        let x_edges = |plane: &Plane, first: u32| [y, y + 1].map(|y| first + plane.edges[0].first(y));
        let ([a, b], [c, d]) = (x_edges(lower, low[0]), x_edges(upper, up[0]));
        Self {
            x: [a, b, c, d],
            y: [low[1] + lower.edges[1].first(y), up[1] + upper.edges[1].first(y)],
            z: [y, y + 1].map(|y| z_edges + between.edges.first(y)),
            nodes: [
                x_nodes + between.nodes[0].first(y),
                y_nodes + between.nodes[1].first(y),
                y_nodes + between.nodes[1].first(y + 1),
                low[2] + lower.nodes.first(y),
                up[2] + upper.nodes.first(y),
            ],
            kinks: if between.kinks[0].is_empty() {
                [0; 5]
            } else {
                let x_kinks = y_nodes + between.nodes[1].total();
                let y_kinks = x_kinks + between.kinks[0].total();
                [
                    x_kinks + between.kinks[0].first(y),
                    y_kinks + between.kinks[1].first(y),
                    y_kinks + between.kinks[1].first(y + 1),
                    low[2] + lower.nodes.total() + lower.kinks.first(y),
                    up[2] + upper.nodes.total() + upper.kinks.first(y),
                ]
            },
            ids: [0; CELL_VERTICES],
        }
    }

    /// Finds the numbers of a cell's crossings and face nodes, and moves on to the next cell.
    #[inline]
    fn take(&mut self, crossings: u16, star_faces: u8) {
        let ids = &mut self.ids;
        let crossed = |e: usize| u32::from(crossings >> e & 1);
        for (k, (id, next)) in ids.iter_mut().zip(&mut self.x).enumerate() {
            *id = *next;
            *next += crossed(k);
        }
        for k in 0..2 {
            // What lies at the cell's upper x is the next cell's at its lower x.
            ids[4 + 2 * k] = self.y[k];
            self.y[k] += crossed(4 + 2 * k);
            ids[5 + 2 * k] = self.y[k];
            ids[8 + 2 * k] = self.z[k];
            self.z[k] += crossed(8 + 2 * k);
            ids[9 + 2 * k] = self.z[k];
        }
        if star_faces != 0 {
            take_faces(&mut ids[EDGES..], &mut self.nodes, star_faces);
        }
    }

    /// Finds the numbers of the same cell's kinks.
    fn take_kinks(&mut self, kinked: u8) {
        take_faces(&mut self.ids[KINK..], &mut self.kinks, kinked);
    }
}

/// Finds the numbers of what lies on a cell's faces, of which those in `faces` have something, and moves on.
#[inline]
fn take_faces(ids: &mut [u32], next: &mut [u32; 5], faces: u8) {
    let has = |f: usize| u32::from(faces >> f & 1);
    ids[0] = next[0];
    next[0] += has(0);
    // What lies at the cell's upper x is the next cell's at its lower x.
    ids[1] = next[0];
    for (f, next) in (2..FACES).zip(&mut next[1..]) {
        ids[f] = *next;
        *next += has(f);
    }
}

/// Writes what is inside cells.
struct CellWriter<'a, 'b, C> {
    job: &'a Job<'a, C>,
    first_vertex: u32,
    vertices: VertexSlices<'b>,
    triangles: &'b mut [[u32; 3]],
    pairs: &'b mut [Pair],
    /// Place of the next apex among the layer's vertices.
    apex: usize,
    next_triangle: usize,
}

impl<C: CrossingRule> CellWriter<'_, '_, C> {
    #[inline]
    fn put(&mut self, low: [usize; 3], corners: Corners, entry: usize, kinked: u8, numbers: &mut RowNumbers) {
        let summary = self.job.table.packed().entry(entry);
        if kinked != 0 {
            return self.put_bent(&Cell::new(self.job.labels, low, corners), entry, kinked, numbers);
        }
        if summary.two_materials && summary.apexes == 0 {
            numbers.take(summary.crossings, 0);
            self.put_two_materials(corners, &summary, &numbers.ids);
            return;
        }
        let cell = Cell::new(self.job.labels, low, corners);
        let crossings = cell.needed(summary.crossings, self.job.border);
        numbers.take(crossings, summary.star_faces);
        let ids = &mut numbers.ids;
        self.put_apexes(&cell, entry, ids);
        if summary.two_materials {
            self.put_two_materials(corners, &summary, ids);
            return;
        }
        self.put_triangles(&cell, self.job.table.packed().triangles(&summary), ids);
    }

    /// The triangles of a cell with any materials.
    fn put_triangles<'t>(
        &mut self,
        cell: &Cell,
        triangles: impl IntoIterator<Item = &'t CellTriangle>,
        ids: &[u32; CELL_VERTICES],
    ) {
        for t in triangles {
            if let Some((pair, turn)) = pair_of(cell.sides(t), self.job.border) {
                let [a, b, c] = t.vertices.map(|v| ids[usize::from(v) % CELL_VERTICES]);
                self.triangles[self.next_triangle] = if turn { [a, c, b] } else { [a, b, c] };
                self.pairs[self.next_triangle] = pair;
                self.next_triangle += 1;
            }
        }
    }

    /// A cell of which the faces in `kinked` have kinks.
    fn put_bent(&mut self, cell: &Cell, entry: usize, kinked: u8, numbers: &mut RowNumbers) {
        let summary = self.job.table.packed().entry(entry);
        numbers.take(cell.needed(summary.crossings, self.job.border), summary.star_faces);
        numbers.take_kinks(kinked);
        let ids = &mut numbers.ids;
        self.put_apexes(cell, entry, ids);
        let triangles = self.job.table.packed().triangles(&summary);
        let (triangles, tips) = cell.bent(self.job.rule, triangles, summary.crossings, kinked);
        for (i, tip) in tips.into_iter().enumerate() {
            ids[TIP + i] = self.first_vertex + self.apex as u32;
            self.vertices.put(self.apex, cell.low, tip, VertexKind::Interface);
            self.put_move(SeamKey::new(SeamKey::TIP + i as u64, cell.low));
            self.apex += 1;
        }
        self.put_triangles(cell, &triangles, ids);
    }

    /// The triangles of a cell with two materials: all have the same pair.
    #[inline(always)]
    fn put_two_materials(&mut self, corners: Corners, summary: &PackedEntry, ids: &[u32; CELL_VERTICES]) {
        let other = corners.differing().0.trailing_zeros() as usize;
        let sides = [corners.code(0), corners.code(other)].map(|c| self.job.labels.material_of_code(c));
        let Some((pair, turn)) = pair_of(sides, self.job.border) else { return };
        let from = self.next_triangle;
        self.next_triangle += usize::from(summary.triangles);
        self.pairs[from..self.next_triangle].fill(pair);
        let triangles = self.job.table.packed().triangles(summary);
        for (out, t) in self.triangles[from..self.next_triangle].iter_mut().zip(triangles) {
            let [a, b, c] = t.vertices.map(|v| ids[usize::from(v) % CELL_VERTICES]);
            *out = if turn { [a, c, b] } else { [a, b, c] };
        }
    }

    /// Moves the vertex inside a cell that was written last, if the rule puts it elsewhere.
    fn put_move(&mut self, key: SeamKey) {
        if let Some(moved) = self.job.rule.moves().and_then(|moves| moves.get(key)) {
            self.vertices.shift(self.apex, moved);
        }
    }

    fn put_apexes(&mut self, cell: &Cell, entry: usize, ids: &mut [u32; CELL_VERTICES]) {
        let surface = self.job.table.surface(entry);
        let apexes = cell.apexes(self.job.rule, surface);
        for (i, (apex, &corners)) in apexes.into_iter().zip(&surface.apex_corners).enumerate() {
            ids[EDGES + FACES + i] = self.first_vertex + self.apex as u32;
            let kind = cell.kind(set_bits(u64::from(corners)), self.job.border);
            self.vertices.put(self.apex, cell.low, apex, kind);
            self.put_move(SeamKey::new(SeamKey::APEX + i as u64, cell.low));
            self.apex += 1;
        }
    }
}
