//! What a check finds: lists of located defects.

use serde::{Deserialize, Serialize};

use crate::grid::MaterialId;

/// How many defects of a kind there are, and the first of them in ascending order of their ids.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Listed<T> {
    /// How many there are in all.
    pub count: u64,
    /// The first of them; how many are kept is said by the check's options.
    pub first: Vec<T>,
}

impl<T> Default for Listed<T> {
    fn default() -> Self {
        Self { count: 0, first: Vec::new() }
    }
}

impl<T> Listed<T> {
    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    pub(crate) fn add(&mut self, keep: usize, make: impl FnOnce() -> T) {
        self.count += 1;
        if self.first.len() < keep {
            self.first.push(make());
        }
    }

    /// Puts what was found later behind what was found earlier.
    pub(crate) fn append(&mut self, keep: usize, later: Self) {
        self.count += later.count;
        let room = keep.saturating_sub(self.first.len());
        self.first.extend(later.first.into_iter().take(room));
    }
}

/// An edge that is wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EdgeDefect {
    /// The vertex ids of its ends, lower id first.
    pub vertices: [u32; 2],
    /// Where its ends are: world, mm.
    pub ends: [[f64; 3]; 2],
    /// The triangles at the edge, ascending; at most the first [`EdgeDefect::MAX_TRIANGLES`].
    pub triangles: Vec<u32>,
    /// The material in whose shell the edge is wrong; `None` where the edge itself is.
    pub material: Option<MaterialId>,
}

impl EdgeDefect {
    /// How many triangles are listed at most.
    pub const MAX_TRIANGLES: usize = 16;
}

/// A vertex that is wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VertexDefect {
    /// Its id.
    pub vertex: u32,
    /// Where it is: world, mm.
    pub position: [f64; 3],
    /// The material in whose shell it is wrong, if it is one shell.
    pub material: Option<MaterialId>,
    /// How many separate pieces of that shell meet in it (0 for an unreferenced vertex).
    pub pieces: u32,
}

/// A triangle that is wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TriangleDefect {
    /// Its id.
    pub triangle: u32,
    /// Its vertex ids.
    pub vertices: [u32; 3],
    /// Its corners: world, mm.
    pub corners: [[f64; 3]; 3],
    /// The materials behind and in front of it.
    pub materials: [MaterialId; 2],
}

/// Two triangles that are wrong together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrianglePairDefect {
    /// Their ids, ascending.
    pub triangles: [u32; 2],
    /// The centroid of each: world, mm.
    pub centroids: [[f64; 3]; 2],
}

/// The state of one material's own shell: the triangles that border it, seen from outside it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShellState {
    /// The material.
    pub material: MaterialId,
    /// Edges used once only.
    pub open_edges: u64,
    /// Edges used three times or more.
    pub non_manifold_edges: u64,
    /// Edges used twice in the same direction.
    pub winding_edges: u64,
    /// Vertices in which separate pieces of the shell meet.
    pub non_manifold_vertices: u64,
    /// Whether each edge is used as often one way as the other: the shell bounds a solid and has
    /// a volume. Non-manifold shells can be closed.
    pub closed: bool,
    /// Whether every edge is used exactly once each way and every vertex's link is one cycle.
    pub manifold: bool,
}

/// Everything a check found. Shells of air (0) and of the world outside (255) are not closed by
/// design, as there are no triangles between the two, and are not checked.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Defects {
    /// Edges with exactly one triangle.
    pub boundary_edges: Listed<EdgeDefect>,
    /// Edges round which the materials do not match up: going round by angle, the material that
    /// one triangle leads into is not the one that the next leads out of. Air and outside match.
    /// Edges round which two triangles lie exactly on each other have no such order; they are
    /// listed as self-intersections instead.
    pub alternation: Listed<EdgeDefect>,
    /// Edges that a material's shell uses only once.
    pub open_edges: Listed<EdgeDefect>,
    /// Edges that a material's shell uses three times or more.
    pub non_manifold_edges: Listed<EdgeDefect>,
    /// Edges that a material's shell uses twice in the same direction.
    pub winding: Listed<EdgeDefect>,
    /// Vertices in which separate pieces of a material's shell meet. Where an edge is wrong the
    /// pieces are counted as if they were whole, so that one open edge is not listed three times.
    pub non_manifold_vertices: Listed<VertexDefect>,
    /// Triangles that repeat a vertex or whose corners are exactly collinear.
    pub degenerate_triangles: Listed<TriangleDefect>,
    /// Pairs of triangles with the same three vertices: each with the one before it.
    pub duplicate_triangles: Listed<TrianglePairDefect>,
    /// Pairs of triangles that meet away from what they share, decided exactly. Degenerate
    /// triangles are not tested.
    pub self_intersections: Listed<TrianglePairDefect>,
    /// Whether self-intersections were looked for.
    pub self_intersections_checked: bool,
    /// Vertices that no triangle uses: a note, not a defect.
    pub unreferenced_vertices: Listed<VertexDefect>,
    /// Each material's shell, ascending; air and materials without triangles are left out.
    pub shells: Vec<ShellState>,
}

impl Defects {
    /// How many defects there are of all kinds.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.by_kind().iter().map(|&(_, count)| count).sum()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.total() == 0
    }

    /// The number of defects of each kind, with the kind's name for people.
    #[must_use]
    pub fn by_kind(&self) -> [(&'static str, u64); 9] {
        [
            ("boundary edges", self.boundary_edges.count),
            ("edges with materials that do not match up", self.alternation.count),
            ("open edges of a shell", self.open_edges.count),
            ("non-manifold edges of a shell", self.non_manifold_edges.count),
            ("edges with inconsistent winding", self.winding.count),
            ("non-manifold vertices of a shell", self.non_manifold_vertices.count),
            ("degenerate triangles", self.degenerate_triangles.count),
            ("duplicate triangles", self.duplicate_triangles.count),
            ("self-intersections", self.self_intersections.count),
        ]
    }
}
