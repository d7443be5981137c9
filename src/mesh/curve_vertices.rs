//! Where the vertices of curves are, for those who do not hold the mesh.

use glam::DVec3;

use crate::grid::VertexKind;

/// The positions and kinds of the vertices of junction curves and boundaries, ascending by their id in
/// the mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CurveVertices {
    ids: Vec<u32>,
    positions: Vec<DVec3>,
    kinds: Vec<VertexKind>,
}

impl CurveVertices {
    /// The vertices listed, in any order and as often as may be.
    pub(crate) fn new(mut list: Vec<(u32, DVec3, VertexKind)>) -> Self {
        list.sort_unstable_by_key(|v| v.0);
        list.dedup_by_key(|v| v.0);
        let mut all = Self::default();
        for (id, position, kind) in list {
            all.ids.push(id);
            all.positions.push(position);
            all.kinds.push(kind);
        }
        all
    }

    /// The ids, ascending.
    #[must_use]
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Where a vertex is: world, mm; `None` if it is on no curve.
    #[must_use]
    pub fn position(&self, id: u32) -> Option<DVec3> {
        self.place(id).map(|i| self.positions[i])
    }

    /// What a vertex is; `None` if it is on no curve.
    #[must_use]
    pub fn kind(&self, id: u32) -> Option<VertexKind> {
        self.place(id).map(|i| self.kinds[i])
    }

    fn place(&self, id: u32) -> Option<usize> {
        self.ids.binary_search(&id).ok()
    }
}
