//! The edges that curves are made of, collected window by window: junction edges and boundary edges.
//!
//! They are kept in the mesh's numbers, with the positions of their ends; memory follows the curves.

use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;

use super::tables::Tables;
use super::window::Window;
use crate::grid::{MaterialId, VertexKind};
use crate::triangle::{EdgeTable, EdgeUse};

/// An edge of a curve.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CurveEdge {
    /// Its vertices' ids, lower one first.
    pub(crate) ends: [u32; 2],
    /// The set of materials round it, by its number in [`Sets`].
    pub(crate) set: u32,
}

/// An edge with one triangle only.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BoundaryEdge {
    pub(crate) edge: CurveEdge,
    /// At each end, the lowest triangle of the fan that the edge's triangle belongs to: triangles at the
    /// vertex that are joined through edges at it.
    pub(crate) fans: [u32; 2],
}

/// The sets of materials that occur round edges, numbered as they are met.
#[derive(Default)]
pub(crate) struct Sets {
    ids: BTreeMap<Vec<MaterialId>, u32>,
    sets: Vec<Vec<MaterialId>>,
}

impl Sets {
    /// The materials of a set, ascending.
    pub(crate) fn of(&self, set: u32) -> &[MaterialId] {
        &self.sets[set as usize]
    }

    fn around(window: &Window<'_>, uses: &[EdgeUse]) -> Vec<MaterialId> {
        let pairs = uses.iter().map(|u| window.pairs()[u.triangle()]);
        let mut set: Vec<_> = pairs.flat_map(|p| [p.back(), p.front()]).collect();
        set.sort_unstable();
        set.dedup();
        set
    }

    fn id(&mut self, set: Vec<MaterialId>) -> u32 {
        let next = self.sets.len() as u32;
        *self.ids.entry(set).or_insert_with_key(|set| {
            self.sets.push(set.clone());
            next
        })
    }
}

/// All edges of curves met so far.
#[derive(Default)]
pub(crate) struct CurveEdges {
    pub(crate) sets: Sets,
    /// Edges with three triangles or more, ascending.
    pub(crate) junction: Vec<CurveEdge>,
    /// How many of them have how many triangles.
    pub(crate) edges_by_triangles: BTreeMap<u32, u64>,
    /// Edges with two triangles of different pairs.
    pub(crate) rim_edges: u64,
    /// Edges with one triangle, ascending.
    pub(crate) boundary: Vec<BoundaryEdge>,
    /// The ends of all these edges, in no order, some more than once.
    pub(crate) vertices: Vec<(u32, DVec3, VertexKind)>,
    /// Boundary edges whose upper end is on the seam: its fan is complete in the next window only.
    waiting: Vec<usize>,
}

impl CurveEdges {
    /// Adds the edges that the window owns.
    pub(crate) fn add(&mut self, window: &Window<'_>, tables: &Tables) {
        self.resolve(window, tables);
        let parts: Vec<_> = EdgeTable::chunks(window.own_vertices())
            .into_par_iter()
            .map(|lows| {
                let (mut rim, mut found) = (0, Vec::new());
                for low in lows {
                    for (high, uses) in tables.edges.edges_of(low) {
                        if let [a, b] = uses {
                            rim += u64::from(window.pairs()[a.triangle()] != window.pairs()[b.triangle()]);
                        } else {
                            found.push((low, high as usize, uses));
                        }
                    }
                }
                (rim, found)
            })
            .collect();
        let mut ends = Vec::new();
        for (rim, found) in parts {
            self.rim_edges += rim;
            for (low, high, uses) in found {
                ends.extend([low, high]);
                let edge = CurveEdge {
                    ends: [low, high].map(|v| window.vertex_id(v)),
                    set: self.sets.id(Sets::around(window, uses)),
                };
                if let [only] = uses {
                    let t = only.triangle() as u32;
                    self.boundary_edge(window, tables, edge, [low, high], t);
                } else {
                    *self.edges_by_triangles.entry(uses.len() as u32).or_insert(0) += 1;
                    self.junction.push(edge);
                }
            }
        }
        ends.sort_unstable();
        ends.dedup();
        let vertex = |v| (window.vertex_id(v), window.positions()[v], window.kinds()[v]);
        self.vertices.extend(ends.into_iter().map(vertex));
    }

    fn boundary_edge(
        &mut self,
        window: &Window<'_>,
        tables: &Tables,
        edge: CurveEdge,
        ends: [usize; 2],
        t: u32,
    ) {
        let known = |v: usize| window.own_vertices().contains(&v);
        if !known(ends[1]) {
            self.waiting.push(self.boundary.len());
        }
        // Where the fan is not known yet, the triangle stands for it.
        let fans = ends.map(|v| {
            window.triangle_id(if known(v) { lowest_of_fan(window, tables, v as u32, t) } else { t } as usize)
        });
        self.boundary.push(BoundaryEdge { edge, fans });
    }

    /// Finds the fans that windows before left open.
    fn resolve(&mut self, window: &Window<'_>, tables: &Tables) {
        let local = |id: u32, first: u32| id.wrapping_sub(first);
        for i in std::mem::take(&mut self.waiting) {
            let BoundaryEdge { edge, fans } = &mut self.boundary[i];
            let v = local(edge.ends[1], window.vertex_id(0));
            let t = local(fans[1], window.triangle_id(0));
            if (t as usize) < window.triangles().len() && window.triangles()[t as usize].contains(&v) {
                fans[1] = window.triangle_id(lowest_of_fan(window, tables, v, t) as usize);
            }
        }
    }
}

/// The lowest triangle in the fan of triangle `t` at vertex `v`.
fn lowest_of_fan(window: &Window<'_>, tables: &Tables, v: u32, t: u32) -> u32 {
    let around = tables.vertices.triangles(v as usize);
    let place = |t: u32| around.partition_point(|&u| u < t);
    let mut seen = vec![false; around.len()];
    let mut open = vec![t];
    seen[place(t)] = true;
    while let Some(t) = open.pop() {
        for other in window.triangles()[t as usize].into_iter().filter(|&w| w != v) {
            for u in tables.edges.uses(v, other) {
                let u = u.triangle() as u32;
                if !std::mem::replace(&mut seen[place(u)], true) {
                    open.push(u);
                }
            }
        }
    }
    seen.iter().position(|&s| s).map_or(t, |first| around[first])
}
