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
mod vertices;

pub use defects::{
    Defects, EdgeDefect, Listed, ShellState, TriangleDefect, TrianglePairDefect, VertexDefect,
};

use super::InterfaceMesh;
use super::tables::Tables;
use super::window::Window;
use crate::execution::{Cancelled, Execution};
use crate::grid::MaterialId;
use crate::triangle::{Search, without_area};

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
    let window = Window::whole(mesh);
    let mut checker = Checker::new(options.clone());
    checker.progress = true;
    checker.add(&window, Tables::new(&window), execution)?;
    Ok(checker.finish())
}

/// Checks a mesh window by window.
pub(crate) struct Checker {
    options: CheckOptions,
    /// Whether the search for self-intersections shows its progress as a stage.
    pub(crate) progress: bool,
    defects: Defects,
    counts: ShellCounts,
    /// Which materials have triangles.
    present: [bool; 256],
}

impl Checker {
    pub(crate) fn new(options: CheckOptions) -> Self {
        let defects =
            Defects { self_intersections_checked: options.self_intersections, ..Defects::default() };
        Self { options, progress: false, defects, counts: ShellCounts::new(), present: [false; 256] }
    }

    /// Checks what the window owns; takes the tables to free their memory in time.
    pub(crate) fn add(
        &mut self,
        window: &Window<'_>,
        tables: Tables,
        execution: &Execution,
    ) -> Result<(), Cancelled> {
        let Self { options, progress, defects, counts, present } = self;
        let keep = options.examples;
        execution.check()?;
        let own = window.own_triangles();
        let degenerate = without_area(window.positions(), window.triangles());
        for t in own.clone().filter(|&t| degenerate[t]) {
            defects.degenerate_triangles.add(keep, || triangle_defect(window, t));
        }
        for pair in &window.pairs()[own.clone()] {
            present[usize::from(pair.back().0)] = true;
            present[usize::from(pair.front().0)] = true;
        }
        execution.check()?;
        edges::check(window, &tables.edges, keep, defects, counts, execution)?;
        vertices::check(window, &tables.vertices, keep, defects, counts, execution)?;
        if options.self_intersections {
            execution.check()?;
            drop(tables); // the trees need as much memory again
            let mut search = Search::new(window.positions(), window.triangles(), &degenerate).keep(keep);
            if *progress {
                search = search.stage("search self-intersections");
            }
            let found = search.run(|t| own.contains(&t), execution)?;
            // A pair may come after others whose lower triangle lies higher.
            let all = &mut defects.self_intersections;
            all.count += found.count;
            all.first.extend(found.first.iter().map(|&pair| pair_defect(window, pair)));
            all.first.sort_by_key(|pair| pair.triangles);
            all.first.truncate(keep);
        }
        Ok(())
    }

    /// What was found in all windows.
    pub(crate) fn finish(self) -> Defects {
        let shells = self.counts.states(&self.present);
        Defects { shells, ..self.defects }
    }
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

    fn states(&self, present: &[bool; 256]) -> Vec<ShellState> {
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

fn triangle_defect(window: &Window<'_>, t: usize) -> TriangleDefect {
    let pair = window.pairs()[t];
    TriangleDefect {
        triangle: window.triangle_id(t),
        vertices: window.triangles()[t].map(|v| window.vertex_id(v as usize)),
        corners: window.corners(t).map(|p| p.to_array()),
        materials: [pair.back(), pair.front()],
    }
}

/// The defect of two triangles, given in local numbers.
fn pair_defect(window: &Window<'_>, triangles: [u32; 2]) -> TrianglePairDefect {
    let centroid = |t: u32| {
        let [a, b, c] = window.corners(t as usize);
        (a / 3.0 + b / 3.0 + c / 3.0).to_array()
    };
    TrianglePairDefect {
        triangles: triangles.map(|t| window.triangle_id(t as usize)),
        centroids: triangles.map(centroid),
    }
}

#[cfg(test)]
mod tests;
