//! Vertices: how many pieces of each shell meet in one, and those that nothing uses.

use rayon::prelude::*;

use super::defects::{Defects, Listed, VertexDefect};
use super::{ShellCounts, Wrong, has_shell};
use crate::execution::{Cancelled, Execution};
use crate::grid::{MaterialId, Pair};
use crate::mesh::window::Window;
use crate::triangle::VertexTable;

/// How many vertices one parallel task handles.
const CHUNK: usize = 1 << 14;

/// Checks the vertices that the window owns and enters what is wrong in `defects` and `counts`.
pub(super) fn check(
    window: &Window<'_>,
    table: &VertexTable,
    keep: usize,
    defects: &mut Defects,
    counts: &mut ShellCounts,
    execution: &Execution,
) -> Result<(), Cancelled> {
    let own = window.own_vertices();
    let parts = (0..own.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            execution.check()?;
            let (mut wrong, mut unused) = (Listed::default(), Listed::default());
            // Only the first of these need a place, but all count per material.
            let mut materials = Vec::new();
            let mut link = Link::default();
            let first = own.start + chunk * CHUNK;
            for v in first..(first + CHUNK).min(own.end) {
                let make = |material, pieces| VertexDefect {
                    vertex: window.vertex_id(v),
                    position: window.positions()[v].to_array(),
                    material,
                    pieces,
                };
                let triangles = table.triangles(v);
                if triangles.is_empty() {
                    unused.add(keep, || make(None, 0));
                }
                link.visit(window, v as u32, triangles, |material, pieces| {
                    if pieces > 1 {
                        wrong.add(keep, || make(Some(material), pieces));
                        materials.push(material);
                    }
                });
            }
            Ok((wrong, unused, materials))
        })
        .collect::<Result<Vec<_>, Cancelled>>()?;
    for (wrong, unused, materials) in parts {
        defects.non_manifold_vertices.append(keep, wrong);
        defects.unreferenced_vertices.append(keep, unused);
        for id in materials {
            counts.add(id, Wrong::Vertex);
        }
    }
    Ok(())
}

/// Buffers to follow the link of one vertex after the other.
#[derive(Default)]
struct Link {
    edges: Vec<(Pair, [u32; 2])>,
    materials: Vec<MaterialId>,
    ring: Vec<u32>,
    parent: Vec<u32>,
}

impl Link {
    /// Calls `found(material, pieces)` for every shell that touches the vertex.
    fn visit(
        &mut self,
        window: &Window<'_>,
        v: u32,
        triangles: &[u32],
        mut found: impl FnMut(MaterialId, u32),
    ) {
        self.edges.clear();
        self.materials.clear();
        for &t in triangles {
            let [a, b, c] = window.triangles()[t as usize];
            let ends = if a == v {
                [b, c]
            } else if b == v {
                [c, a]
            } else {
                [a, b]
            };
            // A triangle that repeats the vertex has no edge in its link; it is a defect of its own.
            if !ends.contains(&v) {
                let pair = window.pairs()[t as usize];
                self.edges.push((pair, ends));
                self.materials.extend([pair.back(), pair.front()].into_iter().filter(|&id| has_shell(id)));
            }
        }
        self.materials.sort_unstable();
        self.materials.dedup();
        let one_pair = self.edges.windows(2).all(|two| two[0].0 == two[1].0);
        let mut known = None;
        for i in 0..self.materials.len() {
            let id = self.materials[i];
            // Both shells of an interface see the same link.
            let pieces = match known {
                Some(pieces) if one_pair => pieces,
                _ => self.pieces(id),
            };
            known = Some(pieces);
            found(id, pieces);
        }
    }

    /// Number of connected pieces of the link among the triangles of `id`.
    fn pieces(&mut self, id: MaterialId) -> u32 {
        self.ring.clear();
        self.ring.extend(self.edges.iter().filter(|e| e.0.contains(id)).flat_map(|e| e.1));
        self.ring.sort_unstable();
        self.ring.dedup();
        self.parent.clear();
        self.parent.extend(0..self.ring.len() as u32);
        let mut pieces = self.ring.len() as u32;
        for (_, [a, b]) in self.edges.iter().filter(|e| e.0.contains(id)) {
            let place = |v: &u32| self.ring.partition_point(|r| r < v) as u32;
            let (a, b) = (root(&mut self.parent, place(a)), root(&mut self.parent, place(b)));
            if a != b {
                self.parent[a.max(b) as usize] = a.min(b);
                pieces -= 1;
            }
        }
        pieces
    }
}

fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}
