//! Finds and locates everything that can be wrong with a mesh.
//!
//! Method: an edge table and a vertex table, each built in one linear pass, give every edge and
//! every vertex with the triangles round it; each material's shell is judged there. Pairs of
//! triangles that may meet come from trees of boxes and are decided by exact predicates.
//!
//! Guarantees: no tolerance anywhere; the result is the same for any number of threads. "Defect" is
//! meant per material: a mesh edge with other than two, oppositely directed uses in its shell, or a
//! vertex whose link in it is not one cycle.

mod defects;
mod edges;
mod intersections;
mod size_trees;
mod triangle_pair;
mod vertices;

use rayon::prelude::*;

pub use defects::{
    Defects, EdgeDefect, Listed, ShellState, TriangleDefect, TrianglePairDefect, VertexDefect,
};

use super::InterfaceMesh;
use super::edge_table::EdgeTable;
use crate::execution::{Cancelled, Execution};
use crate::grid::MaterialId;

/// Options of [`check`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CheckOptions {
    /// How many defects of each kind are listed with their places; all are counted.
    pub examples: usize,
    /// Whether to look for self-intersections, by far the longest part.
    pub self_intersections: bool,
}

impl Default for CheckOptions {
    /// 100 examples of each kind; self-intersections are looked for.
    fn default() -> Self {
        Self { examples: 100, self_intersections: true }
    }
}

/// Checks `mesh` and lists every defect with its place.
///
/// # Errors
/// [`Cancelled`] if the execution was asked to stop.
pub fn check(
    mesh: &InterfaceMesh,
    options: &CheckOptions,
    execution: &Execution,
) -> Result<Defects, Cancelled> {
    let table = EdgeTable::new(mesh.positions().len(), mesh.triangles());
    check_with(mesh, &table, options, execution)
}

/// As [`check`], with the mesh's edges at hand.
pub(crate) fn check_with(
    mesh: &InterfaceMesh,
    table: &EdgeTable,
    options: &CheckOptions,
    execution: &Execution,
) -> Result<Defects, Cancelled> {
    let keep = options.examples;
    let mut defects = Defects::default();
    let mut counts = ShellCounts::new();

    execution.check()?;
    let degenerate: Vec<bool> =
        (0..mesh.triangles().len()).into_par_iter().map(|t| is_degenerate(mesh, t)).collect();
    for (t, _) in degenerate.iter().enumerate().filter(|&(_, &bad)| bad) {
        defects.degenerate_triangles.add(keep, || triangle_defect(mesh, t));
    }
    execution.check()?;
    edges::check(mesh, table, keep, &mut defects, &mut counts, execution)?;
    vertices::check(mesh, keep, &mut defects, &mut counts, execution)?;
    defects.shells = counts.states(mesh);
    if options.self_intersections {
        execution.check()?;
        let found = intersections::find(mesh, &degenerate, keep, execution)?;
        defects.self_intersections = Listed {
            count: found.count,
            first: found.first.iter().map(|&pair| pair_defect(mesh, pair)).collect(),
        };
        defects.self_intersections_checked = true;
    }
    Ok(defects)
}

/// Whether a material's shell is checked at all.
pub(crate) fn has_shell(id: MaterialId) -> bool {
    id != MaterialId::BACKGROUND && id != MaterialId::OUTSIDE
}

/// Per material id: how many edges and vertices of its shell are wrong in which way.
struct ShellCounts([[u64; 5]; 256]);

/// The columns of [`ShellCounts`].
#[derive(Clone, Copy)]
enum Wrong {
    Open,
    NonManifold,
    Winding,
    Unbalanced,
    Vertex,
}

impl ShellCounts {
    fn new() -> Self {
        Self([[0; 5]; 256])
    }

    fn add(&mut self, id: MaterialId, wrong: Wrong) {
        self.0[usize::from(id.0)][wrong as usize] += 1;
    }

    fn merge(&mut self, other: &Self) {
        for (a, b) in self.0.iter_mut().flatten().zip(other.0.iter().flatten()) {
            *a += b;
        }
    }

    fn states(&self, mesh: &InterfaceMesh) -> Vec<ShellState> {
        let mut present = [false; 256];
        for pair in mesh.pairs() {
            present[usize::from(pair.back().0)] = true;
            present[usize::from(pair.front().0)] = true;
        }
        (0..=255u8)
            .map(MaterialId)
            .filter(|&id| present[usize::from(id.0)] && has_shell(id))
            .map(|material| {
                let [open_edges, non_manifold_edges, winding_edges, unbalanced, non_manifold_vertices] =
                    self.0[usize::from(material.0)];
                ShellState {
                    material,
                    open_edges,
                    non_manifold_edges,
                    winding_edges,
                    non_manifold_vertices,
                    closed: unbalanced == 0,
                    manifold: open_edges + non_manifold_edges + winding_edges + non_manifold_vertices == 0,
                }
            })
            .collect()
    }
}

fn is_degenerate(mesh: &InterfaceMesh, t: usize) -> bool {
    let [a, b, c] = mesh.triangles()[t];
    a == b || b == c || c == a || triangle_pair::is_degenerate(&mesh.corners(t))
}

fn triangle_defect(mesh: &InterfaceMesh, t: usize) -> TriangleDefect {
    let pair = mesh.pairs()[t];
    TriangleDefect {
        triangle: t as u32,
        vertices: mesh.triangles()[t],
        corners: mesh.corners(t).map(|p| p.to_array()),
        materials: [pair.back(), pair.front()],
    }
}

fn pair_defect(mesh: &InterfaceMesh, triangles: [u32; 2]) -> TrianglePairDefect {
    let centroid = |t: u32| {
        let [a, b, c] = mesh.corners(t as usize);
        (a / 3.0 + b / 3.0 + c / 3.0).to_array()
    };
    TrianglePairDefect { triangles, centroids: triangles.map(centroid) }
}

#[cfg(test)]
mod tests;
