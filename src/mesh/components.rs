//! Connected pieces of every material's shell, with their Euler characteristics, window by window.
//!
//! Method: a *node* is a vertex together with a material that uses it. Nodes are joined along edges by a
//! union-find in which the lowest node is the root, so a piece is named by its lowest vertex. Vertices, edges
//! and triangles are counted at nodes, each in the window that owns it. A piece that reaches the seam lives on
//! under a handle at its seam nodes; all others are finished: they are counted, and only the largest
//! are kept. So memory follows the seam, and the result does not depend on the cuts.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use rayon::prelude::*;

use super::check::has_shell;
use super::measure::{PieceMeasure, ShellMeasure};
use super::tables::Tables;
use super::window::Window;
use crate::grid::MaterialId;
use crate::triangle::{EdgeTable, EdgeUse};

/// The pieces of one material's shell.
#[derive(Debug, Clone)]
pub(crate) struct ShellPieces {
    /// Whether every edge is used as often one way as the other.
    pub(crate) closed: bool,
    /// How many pieces there are.
    pub(crate) count: u64,
    /// Vertices - edges + triangles over all pieces.
    pub(crate) euler_characteristic: i64,
    /// The largest ones, as [`ShellMeasure::pieces`] orders them.
    pub(crate) largest: Vec<PieceMeasure>,
}

impl ShellPieces {
    fn new() -> Self {
        Self { closed: true, count: 0, euler_characteristic: 0, largest: Vec::new() }
    }

    fn add(&mut self, piece: &Piece) {
        let euler_characteristic = piece.rest + piece.triangles as i64;
        self.count += 1;
        self.euler_characteristic += euler_characteristic;
        self.largest.push(PieceMeasure {
            vertex: piece.vertex,
            triangles: piece.triangles,
            euler_characteristic,
        });
        if self.largest.len() >= 4 * ShellMeasure::MAX_LISTED {
            self.keep_largest();
        }
    }

    fn keep_largest(&mut self) {
        self.largest.sort_by_key(|p| (std::cmp::Reverse(p.triangles), p.vertex));
        self.largest.truncate(ShellMeasure::MAX_LISTED);
    }
}

/// The pieces met in the windows so far.
#[derive(Default)]
pub(crate) struct Components {
    finished: BTreeMap<MaterialId, ShellPieces>,
    /// Pieces that reach the seam, as far as they are known.
    live: Vec<Piece>,
    /// Which of them holds which node of the seam: (vertex counted from the seam's first, material, piece).
    seam: Vec<(u32, MaterialId, u32)>,
}

impl Components {
    /// Adds what the window owns.
    pub(crate) fn add(&mut self, window: &Window<'_>, tables: &Tables) {
        let nodes = Nodes::new(window, tables);
        let own = window.own_vertices();
        let (edges, open) = nodes.join_along_edges(window, &tables.edges);
        let begun = self.join_begun(&nodes);
        // All joins are done: roots are numbered as pieces, ascending.
        let mut number = Vec::with_capacity(nodes.materials.len());
        let mut pieces: Vec<Piece> = Vec::new();
        for (node, &triangles) in nodes.triangles.iter().enumerate() {
            let root = nodes.root(node);
            number.push(if root == node { pieces.len() as u32 } else { number[root] });
            if root == node {
                pieces.push(Piece::new(
                    nodes.materials[node],
                    window.vertex_id(own.start + nodes.vertex(node)),
                ));
            }
            let piece = &mut pieces[number[node] as usize];
            piece.triangles += u64::from(triangles);
            match edges.get(node) {
                Some(&edges) => piece.rest += 1 - i64::from(edges),
                None => piece.seam = Some(0), // no own vertex, so one of the seam
            }
        }
        for (piece, node) in std::mem::take(&mut self.live).into_iter().zip(begun) {
            match node {
                Some(node) => pieces[number[node] as usize].go_on_with(&piece),
                None => pieces.push(piece), // only if the piece of mesh does not begin with the seam
            }
        }
        for piece in &mut pieces {
            if piece.seam.is_some() {
                piece.seam = Some(self.live.len() as u32);
                self.live.push(piece.clone());
            } else {
                self.of(piece.material).add(piece);
            }
        }
        let first = own.len();
        let of_seam = (edges.len()..number.len()).filter_map(|node| {
            let piece = pieces[number[node] as usize].seam?;
            Some(((nodes.vertex(node) - first) as u32, nodes.materials[node], piece))
        });
        self.seam = of_seam.collect();
        for id in open {
            self.of(id).closed = false;
        }
    }

    /// Joins the nodes that the pieces met so far join; returns a node of each.
    fn join_begun(&self, nodes: &Nodes) -> Vec<Option<usize>> {
        let mut at = vec![None; self.live.len()];
        for &(v, id, piece) in &self.seam {
            let Some(node) = nodes.find(v as usize, id) else { continue };
            match at[piece as usize] {
                Some(other) => nodes.join(node, other),
                None => at[piece as usize] = Some(node),
            }
        }
        at
    }

    fn of(&mut self, id: MaterialId) -> &mut ShellPieces {
        self.finished.entry(id).or_insert_with(ShellPieces::new)
    }

    /// The pieces of all shells, ascending by material.
    pub(crate) fn finish(mut self) -> Vec<(MaterialId, ShellPieces)> {
        for piece in std::mem::take(&mut self.live) {
            self.of(piece.material).add(&piece);
        }
        self.finished.values_mut().for_each(ShellPieces::keep_largest);
        self.finished.into_iter().collect()
    }
}

/// A piece as far as it is known.
#[derive(Debug, Clone)]
struct Piece {
    material: MaterialId,
    /// Its lowest vertex.
    vertex: u32,
    triangles: u64,
    /// Vertices - edges.
    rest: i64,
    /// Its number among those that reach the seam, if it does.
    seam: Option<u32>,
}

impl Piece {
    fn new(material: MaterialId, vertex: u32) -> Self {
        Self { material, vertex, triangles: 0, rest: 0, seam: None }
    }

    /// Adds the part of it that windows before have met.
    fn go_on_with(&mut self, begun: &Self) {
        self.vertex = self.vertex.min(begun.vertex);
        self.triangles += begun.triangles;
        self.rest += begun.rest;
    }
}

/// The nodes of a window's own vertices and of its seam, ascending by vertex, then by material.
struct Nodes {
    /// The first node of each vertex, counted from the first own one.
    start: Vec<u32>,
    materials: Vec<MaterialId>,
    /// How many of the window's own triangles have their lowest vertex in each node.
    triangles: Vec<u32>,
    /// A root is its own parent, any other node's parent is lower: whatever order threads
    /// join in, the root is the lowest node in the end.
    parent: Vec<AtomicU32>,
}

impl Nodes {
    fn new(window: &Window<'_>, tables: &Tables) -> Self {
        let all = window.own_vertices().start..window.positions().len();
        let own = window.own_triangles().start;
        let parts: Vec<_> = EdgeTable::chunks(all.clone())
            .into_par_iter()
            .map(|chunk| {
                let (mut ends, mut materials, mut counts) = (Vec::with_capacity(chunk.len()), vec![], vec![]);
                for v in chunk {
                    let first = materials.len();
                    for &t in tables.vertices.triangles(v) {
                        let pair = window.pairs()[t as usize];
                        let low = window.triangles()[t as usize].into_iter().min() == Some(v as u32);
                        let counted = u32::from(low && t as usize >= own);
                        for id in [pair.back(), pair.front()].into_iter().filter(|&id| has_shell(id)) {
                            let known = materials[first..].iter().position(|&m| m == id);
                            if let Some(i) = known {
                                counts[first + i] += counted;
                            } else {
                                materials.push(id);
                                counts.push(counted);
                            }
                        }
                    }
                    sort_together(&mut materials[first..], &mut counts[first..]);
                    ends.push(materials.len() as u32);
                }
                (ends, materials, counts)
            })
            .collect();
        let (mut start, mut materials, mut triangles) = (vec![0], Vec::new(), Vec::new());
        start.reserve(all.len());
        for (ends, m, t) in parts {
            let offset = materials.len() as u32;
            start.extend(ends.into_iter().map(|end| end + offset));
            materials.extend(m);
            triangles.extend(t);
        }
        let parent = (0..materials.len() as u32).map(AtomicU32::new).collect();
        Self { start, materials, triangles, parent }
    }

    /// The node of a vertex, counted from the first own one, with a material.
    fn find(&self, v: usize, id: MaterialId) -> Option<usize> {
        let first = *self.start.get(v)? as usize;
        let last = *self.start.get(v + 1)? as usize;
        self.materials[first..last].iter().position(|&m| m == id).map(|i| first + i)
    }

    /// The vertex of a node, counted from the first own one.
    fn vertex(&self, node: usize) -> usize {
        self.start.partition_point(|&first| first as usize <= node) - 1
    }

    fn root(&self, node: usize) -> usize {
        let mut v = node as u32;
        loop {
            let up = self.parent[v as usize].load(Relaxed);
            if up == v {
                return v as usize;
            }
            let above = self.parent[up as usize].load(Relaxed);
            if above != up {
                // Shortens the way for those who come later; if another thread was first, it did so.
                let _ = self.parent[v as usize].compare_exchange(up, above, Relaxed, Relaxed);
            }
            v = above;
        }
    }

    fn join(&self, a: usize, b: usize) {
        loop {
            let (a, b) = (self.root(a), self.root(b));
            let (low, high) = (a.min(b), a.max(b));
            if low == high
                || self.parent[high].compare_exchange(high as u32, low as u32, Relaxed, Relaxed).is_ok()
            {
                return;
            }
        }
    }

    /// Joins nodes along all own edges. Returns how many edges have their lower end in each node of an
    /// own vertex, and the materials whose shell is open somewhere.
    fn join_along_edges(&self, window: &Window<'_>, table: &EdgeTable) -> (Vec<u32>, Vec<MaterialId>) {
        let own = window.own_vertices();
        let parts: Vec<_> = EdgeTable::chunks(own.clone())
            .into_par_iter()
            .map(|lows| {
                let first = self.start[lows.start - own.start] as usize;
                let last = self.start[lows.end - own.start] as usize;
                let (mut edges, mut open) = (vec![0; last - first], Vec::new());
                let mut ways = Vec::new();
                for low in lows {
                    for (high, uses) in table.edges_of(low) {
                        ways.clear();
                        balance(window, uses, &mut ways);
                        for &(id, balance) in &ways {
                            let ends = [low, high as usize].map(|v| self.find(v - own.start, id));
                            if let [Some(low), Some(high)] = ends {
                                edges[low - first] += 1;
                                self.join(low, high);
                            }
                            if balance != 0 && !open.contains(&id) {
                                open.push(id);
                            }
                        }
                    }
                }
                (edges, open)
            })
            .collect();
        let open = parts.iter().flat_map(|p| p.1.iter().copied()).collect();
        (parts.into_iter().flat_map(|p| p.0).collect(), open)
    }
}

/// The materials whose shells use an edge, and how much more often one way than the other.
fn balance(window: &Window<'_>, uses: &[EdgeUse], out: &mut Vec<(MaterialId, i32)>) {
    for u in uses {
        let (pair, sign) = (window.pairs()[u.triangle()], if u.is_forward() { 1 } else { -1 });
        for (id, sign) in [(pair.back(), sign), (pair.front(), -sign)] {
            if has_shell(id) {
                match out.iter_mut().find(|way| way.0 == id) {
                    Some(way) => way.1 += sign,
                    None => out.push((id, sign)),
                }
            }
        }
    }
}

/// Sorts a vertex's few materials, each with its count.
fn sort_together(materials: &mut [MaterialId], counts: &mut [u32]) {
    for i in 1..materials.len() {
        let mut j = i;
        while j > 0 && materials[j - 1] > materials[j] {
            materials.swap(j - 1, j);
            counts.swap(j - 1, j);
            j -= 1;
        }
    }
}
