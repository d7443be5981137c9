//! The part of a mesh that is looked at in one step, and what is kept of it for the next.
//!
//! A window is the last layer of the piece before and a piece. Its numbers are local; as pieces are
//! contiguous, global numbers are these plus an offset. Every vertex, edge and triangle has one window
//! that *owns* it, in which everything that touches it is present: a vertex's and a triangle's is that of
//! their piece, an edge's is that of its lower vertex.

use std::ops::Range;

use glam::DVec3;

use super::{InterfaceMesh, MeshPiece};
use crate::contour::append_sigmas;
use crate::grid::{Pair, VertexKind};

/// A view of part of a mesh; see the module header.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window<'a> {
    positions: &'a [DVec3],
    kinds: &'a [VertexKind],
    sigmas: &'a [f32],
    triangles: &'a [[u32; 3]],
    pairs: &'a [Pair],
    /// The numbers of vertex 0 and triangle 0 in the whole mesh.
    first: [u64; 2],
    /// The first vertex and triangle of its own, and the first vertex behind its own.
    own: [usize; 2],
    own_end: usize,
}

impl<'a> Window<'a> {
    /// A whole mesh: everything is its own.
    pub(crate) fn whole(mesh: &'a InterfaceMesh) -> Self {
        Self::alone(mesh, mesh.positions().len(), [0, 0])
    }

    /// A piece with nothing before it.
    fn alone(mesh: &'a InterfaceMesh, owned: usize, first: [u64; 2]) -> Self {
        Self {
            positions: mesh.positions(),
            kinds: mesh.kinds(),
            sigmas: mesh.sigmas().unwrap_or_default(),
            triangles: mesh.triangles(),
            pairs: mesh.pairs(),
            first,
            own: [0, 0],
            own_end: owned.min(mesh.positions().len()),
        }
    }

    /// Vertex positions in the world, mm.
    pub(crate) fn positions(&self) -> &'a [DVec3] {
        self.positions
    }

    /// What each vertex is.
    pub(crate) fn kinds(&self) -> &'a [VertexKind] {
        self.kinds
    }

    /// Standard deviation of each vertex's position, mm; empty if none are known.
    pub(crate) fn sigmas(&self) -> &'a [f32] {
        self.sigmas
    }

    /// Local vertex numbers of each triangle.
    pub(crate) fn triangles(&self) -> &'a [[u32; 3]] {
        self.triangles
    }

    /// The pair of each triangle.
    pub(crate) fn pairs(&self) -> &'a [Pair] {
        self.pairs
    }

    /// The corners of local triangle `t`.
    pub(crate) fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].map(|v| self.positions[v as usize])
    }

    /// The vertices that this window owns.
    pub(crate) fn own_vertices(&self) -> Range<usize> {
        self.own[0]..self.own_end
    }

    /// The triangles that this window owns.
    pub(crate) fn own_triangles(&self) -> Range<usize> {
        self.own[1]..self.triangles.len()
    }

    /// The number of a local vertex in the whole mesh; meshes with more than 2^32 are refused earlier.
    pub(crate) fn vertex_id(&self, v: usize) -> u32 {
        (self.first[0] + v as u64) as u32
    }

    /// The number of a local triangle in the whole mesh.
    pub(crate) fn triangle_id(&self, t: usize) -> u32 {
        (self.first[1] + t as u64) as u32
    }

    /// The number of the first own triangle in the whole mesh.
    pub(crate) fn first_own_triangle(&self) -> u64 {
        self.first[1] + self.own[1] as u64
    }
}

/// What is kept of the pieces so far: the last layer of the last one.
#[derive(Debug, Default)]
pub(crate) struct Carry {
    positions: Vec<DVec3>,
    kinds: Vec<VertexKind>,
    sigmas: Vec<f32>,
    triangles: Vec<[u32; 3]>,
    pairs: Vec<Pair>,
}

impl Carry {
    /// Calls `look` with the window of `piece` behind what is kept, then keeps `piece`'s last layer.
    pub(crate) fn step<E>(
        &mut self,
        piece: &MeshPiece,
        look: impl FnOnce(&Window<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let first = [piece.first_vertex, piece.first_triangle];
        let window = if self.positions.is_empty() && self.triangles.is_empty() {
            Window::alone(&piece.mesh, piece.owned, first)
        } else {
            let own = [self.positions.len(), self.triangles.len()];
            self.append(&piece.mesh);
            Window {
                positions: &self.positions,
                kinds: &self.kinds,
                sigmas: &self.sigmas,
                triangles: &self.triangles,
                pairs: &self.pairs,
                first: std::array::from_fn(|i| first[i].saturating_sub(own[i] as u64)),
                own,
                own_end: own[0] + piece.owned.min(piece.mesh.positions().len()),
            }
        };
        look(&window)?;
        self.keep_last_layer(piece);
        Ok(())
    }

    fn append(&mut self, mesh: &InterfaceMesh) {
        let offset = self.positions.len() as u32;
        self.positions.extend_from_slice(mesh.positions());
        let sigmas = mesh.sigmas().unwrap_or_default();
        append_sigmas(&mut self.sigmas, self.kinds.len(), sigmas, mesh.kinds().len());
        self.kinds.extend_from_slice(mesh.kinds());
        self.triangles.extend(mesh.triangles().iter().map(|t| t.map(|v| v + offset)));
        self.pairs.extend_from_slice(mesh.pairs());
    }

    fn keep_last_layer(&mut self, piece: &MeshPiece) {
        let mesh = &piece.mesh;
        let owned = piece.owned.min(mesh.positions().len());
        let t = piece.last_layer[1].min(mesh.triangles().len());
        // The layer's triangles use its own vertices only, and the seam, which comes again.
        let used = mesh.triangles()[t..].iter().flatten().map(|&v| v as usize).min();
        let v = used.unwrap_or(owned).min(piece.last_layer[0]).min(owned);
        self.positions.clear();
        self.kinds.clear();
        self.sigmas.clear();
        self.triangles.clear();
        self.pairs.clear();
        self.positions.extend_from_slice(&mesh.positions()[v..owned]);
        self.kinds.extend_from_slice(&mesh.kinds()[v..owned]);
        self.sigmas.extend_from_slice(mesh.sigmas().map_or(&[], |sigmas| &sigmas[v..owned]));
        self.triangles.extend(mesh.triangles()[t..].iter().map(|tri| tri.map(|w| w - v as u32)));
        self.pairs.extend_from_slice(&mesh.pairs()[t..]);
    }
}
