//! Where more than two interfaces meet: junction curves and points; and where one ends: boundaries.
//!
//! A *junction edge* has three or more triangles. Junction edges are strung into curves between
//! *junction points*: vertices where their number is not two, or where the set of materials round
//! the one differs from that round the other. What is left are closed curves. Boundary edges (one
//! triangle) are strung in the same way, but pass a vertex where several boundaries touch by staying
//! with the same fan of triangles: holes that touch in a vertex are one loop, as they would be with that
//! vertex split in two. So the boundaries of an edge-manifold surface are always closed loops.
//!
//! Guarantee: each edge is in exactly one curve; the order depends on the mesh alone. The rim where
//! one material, air and `OUTSIDE` meet has two triangles at each edge, as there is nothing between
//! air and outside; it is counted, not strung.

use std::collections::BTreeMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::InterfaceMesh;
use super::curve_edges::{BoundaryEdge, CurveEdge, CurveEdges, Sets};
use super::curve_vertices::CurveVertices;
use super::tables::Tables;
use super::window::Window;
use crate::grid::MaterialId;

/// A curve of edges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JunctionCurve {
    /// The materials that meet along it, ascending, `OUTSIDE` (255) included.
    pub materials: Vec<MaterialId>,
    /// Whether it ends where it starts; then the first vertex is not repeated in `vertices`.
    pub closed: bool,
    /// Its length, mm.
    pub length: f64,
    /// How many edges it has.
    pub edges: u64,
    /// The ids of its vertices, in order.
    pub vertices: Vec<u32>,
}

/// The edges with one triangle only.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Boundaries {
    /// How many edges there are.
    pub edges: u64,
    /// Closed curves of them.
    pub loops: u64,
    /// Curves that end somewhere: only where the surface is not edge-manifold.
    pub open_curves: u64,
    /// Their length in all, mm.
    pub length: f64,
    /// The curves.
    pub curves: Vec<JunctionCurve>,
}

/// All junctions of a mesh.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Junctions {
    /// How many junction edges there are.
    pub edges: u64,
    /// How many of them have how many triangles: 3, 4, ...
    pub edges_by_triangles: BTreeMap<u32, u64>,
    /// The curves they form, by their lowest end or, if closed, their lowest vertex; open ones first.
    pub curves: Vec<JunctionCurve>,
    /// Their length in all, mm.
    pub length: f64,
    /// The vertex ids of the junction points, ascending.
    pub points: Vec<u32>,
    /// Edges with two triangles where three materials meet: one of them, air and `OUTSIDE`.
    pub rim_edges: u64,
    /// The edges with one triangle only.
    pub boundaries: Boundaries,
    /// Where the vertices of all these curves are; left out of files, as the mesh has them.
    #[serde(skip)]
    pub vertices: CurveVertices,
}

/// Finds the junctions and boundaries of `mesh`.
#[must_use]
pub fn junctions(mesh: &InterfaceMesh) -> Junctions {
    let window = Window::whole(mesh);
    let mut found = CurveEdges::default();
    found.add(&window, &Tables::new(&window));
    found.finish()
}

impl CurveEdges {
    /// Strings all edges found into curves.
    pub(crate) fn finish(self) -> Junctions {
        let vertices = CurveVertices::new(self.vertices);
        let line = |e: &CurveEdge| Edge { ends: e.ends, nodes: e.ends, set: e.set };
        let edges: Vec<Edge> = self.junction.iter().map(line).collect();
        let (chains, points) = string(&edges);
        let set = |chain: &Chain| self.sets.of(edges[chain.edges[0]].set).to_vec();
        let curves: Vec<_> = chains.iter().map(|c| curve(&vertices, &edges, c, set(c))).collect();
        Junctions {
            edges: edges.len() as u64,
            edges_by_triangles: self.edges_by_triangles,
            length: total_length(&curves),
            curves,
            points,
            rim_edges: self.rim_edges,
            boundaries: boundaries(&self.boundary, &self.sets, &vertices),
            vertices,
        }
    }
}

fn total_length(curves: &[JunctionCurve]) -> f64 {
    // An empty `sum` is -0, which looks odd in a report.
    curves.iter().fold(0.0, |sum, c| sum + c.length)
}

/// Strings boundary edges; see the module header.
fn boundaries(found: &[BoundaryEdge], sets: &Sets, vertices: &CurveVertices) -> Boundaries {
    // Nodes to string through are (vertex, fan) instead of vertices, numbered as they are met.
    let mut numbers = BTreeMap::new();
    let mut number = |node: (u32, u32)| {
        let next = numbers.len() as u32;
        *numbers.entry(node).or_insert(next)
    };
    let line = |e: &BoundaryEdge| Edge {
        ends: e.edge.ends,
        nodes: [0, 1].map(|i| number((e.edge.ends[i], e.fans[i]))),
        set: 0, // a boundary goes on where the materials change
    };
    let edges: Vec<Edge> = found.iter().map(line).collect();
    let (chains, _) = string(&edges);
    let materials = |chain: &Chain| {
        let mut used: Vec<u32> = chain.edges.iter().map(|&e| found[e].edge.set).collect();
        used.sort_unstable();
        used.dedup();
        let mut ids: Vec<_> = used.into_iter().flat_map(|set| sets.of(set).iter().copied()).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    };
    let curves: Vec<_> =
        chains.iter().map(|chain| curve(vertices, &edges, chain, materials(chain))).collect();
    Boundaries {
        edges: edges.len() as u64,
        loops: curves.iter().filter(|c| c.closed).count() as u64,
        open_curves: curves.iter().filter(|c| !c.closed).count() as u64,
        length: total_length(&curves),
        curves,
    }
}

/// An edge to be strung.
struct Edge {
    ends: [u32; 2],
    /// What is strung through: the ends themselves, or finer nodes at them.
    nodes: [u32; 2],
    /// Curves end where this changes.
    set: u32,
}

/// Edges in order, each taken along the vertices that `vertices` lists.
struct Chain {
    edges: Vec<usize>,
    vertices: Vec<u32>,
    closed: bool,
}

/// Strings edges between nodes where they branch, end or change their set; returns the chains and
/// the nodes at which open ones end, ascending.
fn string(edges: &[Edge]) -> (Vec<Chain>, Vec<u32>) {
    let mut at: Vec<(u32, usize)> =
        edges.iter().enumerate().flat_map(|(i, e)| e.nodes.map(|node| (node, i))).collect();
    at.sort_unstable();
    let around = |node: u32| {
        let first = at.partition_point(|a| a.0 < node);
        let last = at.partition_point(|a| a.0 <= node);
        &at[first..last]
    };
    let passes =
        |here: &[(u32, usize)]| matches!(here, [a, b] if a.1 != b.1 && edges[a.1].set == edges[b.1].set);
    let mut done = vec![false; edges.len()];
    let walk = |start: u32, first: usize, done: &mut Vec<bool>| {
        let mut chain = Chain { edges: Vec::new(), vertices: Vec::new(), closed: false };
        let (mut node, mut edge) = (start, first);
        loop {
            done[edge] = true;
            let forward = edges[edge].nodes[0] == node;
            let side = usize::from(!forward);
            chain.edges.push(edge);
            chain.vertices.push(edges[edge].ends[side]);
            node = edges[edge].nodes[1 - side];
            let here = around(node);
            let next = here.iter().map(|a| a.1).find(|&e| e != edge && !done[e]);
            match next {
                Some(next) if passes(here) => edge = next,
                _ => {
                    chain.closed = node == start;
                    if !chain.closed {
                        chain.vertices.push(edges[edge].ends[1 - side]);
                    }
                    return chain;
                }
            }
        }
    };
    let (mut chains, mut points) = (Vec::new(), Vec::new());
    for here in at.chunk_by(|a, b| a.0 == b.0).filter(|here| !passes(here)) {
        points.push(here[0].0);
        for &(node, edge) in here {
            if !done[edge] {
                chains.push(walk(node, edge, &mut done));
            }
        }
    }
    for i in 0..edges.len() {
        if !done[i] {
            chains.push(walk(edges[i].nodes[0], i, &mut done));
        }
    }
    (chains, points)
}

fn curve(
    vertices: &CurveVertices,
    edges: &[Edge],
    chain: &Chain,
    materials: Vec<MaterialId>,
) -> JunctionCurve {
    let point = |v: u32| vertices.position(v).unwrap_or_default();
    let length = |&e: &usize| DVec3::distance(point(edges[e].ends[0]), point(edges[e].ends[1]));
    JunctionCurve {
        materials,
        closed: chain.closed,
        length: chain.edges.iter().map(length).sum(),
        edges: chain.edges.len() as u64,
        vertices: chain.vertices.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::{mesh, parts, voxel_faces};

    fn ids(curve: &JunctionCurve) -> Vec<u8> {
        curve.materials.iter().map(|m| m.0).collect()
    }

    #[test]
    fn two_touching_cubes_share_one_closed_curve() {
        let j = junctions(&voxel_faces([2, 1, 1], &[1, 2], 0));
        assert_eq!((j.edges, j.edges_by_triangles.get(&3)), (4, Some(&4)));
        assert_eq!(j.curves.len(), 1);
        let c = &j.curves[0];
        assert!(c.closed && c.vertices.len() == 4 && (c.length - 4.0).abs() < 1e-12);
        assert_eq!(ids(c), [0, 1, 2]);
        assert!(j.points.is_empty() && j.boundaries.edges == 0 && j.rim_edges == 0);
    }

    #[test]
    fn three_cubes_in_a_corner_have_curves_between_points() {
        // 1 and 2 side by side, 3 behind both: a curve 1-2-3 within, its ends on the outside.
        let j = junctions(&voxel_faces([2, 2, 1], &[1, 2, 3, 3], 0));
        assert_eq!(j.points.len(), 2);
        let mut sets: Vec<_> = j.curves.iter().map(|c| (ids(c), c.edges, c.closed)).collect();
        sets.sort();
        assert_eq!(
            sets,
            [
                (vec![0, 1, 2], 3, false),
                (vec![0, 1, 3], 3, false),
                (vec![0, 2, 3], 3, false),
                (vec![1, 2, 3], 1, false)
            ]
        );
        for c in &j.curves {
            assert!(j.points.contains(&c.vertices[0]) && j.points.contains(c.vertices.last().unwrap()));
        }
    }

    #[test]
    fn the_rim_at_the_outside_is_counted_only() {
        let j = junctions(&voxel_faces([2, 1, 1], &[1, 0], 255));
        assert_eq!((j.edges, j.rim_edges), (0, 4));
    }

    #[test]
    fn holes_that_touch_in_a_vertex_are_one_loop() {
        let m = voxel_faces([3, 3, 1], &[1; 9], 0);
        let (p, t, pairs) = parts(&m);
        // Leave out two top squares that share only a corner.
        let top = |t: &[u32; 3], x: f64| {
            let c = t.map(|v| p[v as usize]);
            c.iter().all(|c| c.z > 0.5 && (x..=x + 1.0).contains(&c.x) && (x..=x + 1.0).contains(&c.y))
        };
        let keep: Vec<usize> = (0..t.len()).filter(|&i| !top(&t[i], 0.0) && !top(&t[i], 1.0)).collect();
        let m =
            mesh(p.clone(), keep.iter().map(|&i| t[i]).collect(), keep.iter().map(|&i| pairs[i]).collect());
        let b = junctions(&m).boundaries;
        assert_eq!((b.edges, b.loops, b.open_curves), (8, 1, 0));
        assert!((b.length - 8.0).abs() < 1e-12);
    }
}
