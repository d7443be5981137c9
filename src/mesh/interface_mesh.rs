//! [`InterfaceMesh`]: triangles that know the material behind and in front of them.

use glam::DVec3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::contour::same_sigmas;
use crate::grid::{MaterialId, Pair, VertexKind};

/// Why arrays do not make a mesh.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum MeshError {
    /// Arrays that belong together differ in length.
    #[error("{what}: {got} entries where {needed} are needed")]
    Length {
        /// Which array.
        what: &'static str,
        /// Its length.
        got: usize,
        /// The length it must have.
        needed: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names vertex {vertex}, but there are only {vertices} vertices")]
    Index {
        /// The triangle.
        triangle: usize,
        /// The vertex it names.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A triangle of a material that is not in the list.
    #[error(
        "triangle {triangle} belongs to material {material}, which is not in the mesh's list of materials"
    )]
    Material {
        /// The triangle.
        triangle: usize,
        /// The material.
        material: u8,
    },
    /// A piece of a mesh that is not the next one.
    #[error(
        "a piece of mesh begins with vertex {} and triangle {}, but vertex {} and triangle {} come next",
        got[0], got[1], needed[0], needed[1]
    )]
    Piece {
        /// The numbers of its first vertex and triangle.
        got: [u64; 2],
        /// Those that come next.
        needed: [u64; 2],
    },
    /// A vertex that is not a finite point.
    #[error("vertex {vertex} at ({x}, {y}, {z}) is not finite")]
    NotFinite {
        /// The vertex.
        vertex: usize,
        /// Its coordinates.
        x: f64,
        /// Its coordinates.
        y: f64,
        /// Its coordinates.
        z: f64,
    },
}

/// What a mesh knows of a material.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeshMaterial {
    /// Its id.
    pub id: MaterialId,
    /// Its name.
    pub name: String,
    /// Its mean grey value.
    pub mean: f64,
}

/// A labelled, in general non-manifold, triangle mesh. Triangles are counter-clockwise seen from
/// their front; their normals point from `back` to `front`. Made only through
/// [`InterfaceMesh::new`], which refuses bad indices and unknown materials; everything else that
/// can be wrong with a mesh is found by the mesh check.
#[derive(Debug, Clone)]
pub struct InterfaceMesh {
    positions: Vec<DVec3>,
    kinds: Vec<VertexKind>,
    /// Empty if none are known.
    sigmas: Vec<f32>,
    triangles: Vec<[u32; 3]>,
    pairs: Vec<Pair>,
    materials: Vec<MeshMaterial>,
}

/// The lists of a mesh, to put it together with others.
pub(super) struct Parts {
    pub(super) positions: Vec<DVec3>,
    pub(super) kinds: Vec<VertexKind>,
    pub(super) sigmas: Vec<f32>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) pairs: Vec<Pair>,
}

impl PartialEq for InterfaceMesh {
    /// Sigmas are compared by their bits: unknown ones are equal.
    fn eq(&self, other: &Self) -> bool {
        self.positions == other.positions
            && self.kinds == other.kinds
            && same_sigmas(&self.sigmas, &other.sigmas)
            && self.triangles == other.triangles
            && self.pairs == other.pairs
            && self.materials == other.materials
    }
}

impl InterfaceMesh {
    /// A mesh of `positions` (world, mm) with a kind each, and `triangles` with a pair each.
    /// `materials` lists every material that a triangle may name (`OUTSIDE` needs no entry).
    ///
    /// # Errors
    /// [`MeshError`] with the first entry that is not usable.
    pub fn new(
        positions: Vec<DVec3>,
        kinds: Vec<VertexKind>,
        triangles: Vec<[u32; 3]>,
        pairs: Vec<Pair>,
        materials: Vec<MeshMaterial>,
    ) -> Result<Self, MeshError> {
        if kinds.len() != positions.len() {
            return Err(MeshError::Length {
                what: "vertex kinds",
                got: kinds.len(),
                needed: positions.len(),
            });
        }
        if pairs.len() != triangles.len() {
            return Err(MeshError::Length {
                what: "triangle pairs",
                got: pairs.len(),
                needed: triangles.len(),
            });
        }
        if let Some(vertex) = positions.iter().position(|p| !p.is_finite()) {
            let DVec3 { x, y, z } = positions[vertex];
            return Err(MeshError::NotFinite { vertex, x, y, z });
        }
        let mut known = [false; 256];
        known[usize::from(MaterialId::OUTSIDE.0)] = true;
        for material in &materials {
            known[usize::from(material.id.0)] = true;
        }
        for (triangle, (corners, pair)) in triangles.iter().zip(&pairs).enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= positions.len()) {
                return Err(MeshError::Index { triangle, vertex, vertices: positions.len() });
            }
            for id in [pair.back(), pair.front()] {
                if !known[usize::from(id.0)] {
                    return Err(MeshError::Material { triangle, material: id.0 });
                }
            }
        }
        Ok(Self { positions, kinds, sigmas: Vec::new(), triangles, pairs, materials })
    }

    /// The same mesh with the standard deviation of each vertex's position along the normal of the surface there, mm; NaN
    /// where it is unknown. None are known if there are no `sigmas`.
    ///
    /// # Errors
    /// [`MeshError::Length`] if there are some, but not one for each vertex.
    pub fn with_sigmas(self, sigmas: Vec<f32>) -> Result<Self, MeshError> {
        let (got, needed) = (sigmas.len(), self.positions.len());
        if got != 0 && got != needed {
            return Err(MeshError::Length { what: "vertex sigmas", got, needed });
        }
        Ok(Self { sigmas, ..self })
    }

    /// All but the materials.
    pub(super) fn into_parts(self) -> Parts {
        let Self { positions, kinds, sigmas, triangles, pairs, .. } = self;
        Parts { positions, kinds, sigmas, triangles, pairs }
    }

    /// The standard deviation of each vertex's position along the normal of the surface there, mm; NaN where it is
    /// unknown. `None` if none is known.
    #[must_use]
    pub fn sigmas(&self) -> Option<&[f32]> {
        (!self.sigmas.is_empty()).then_some(&self.sigmas)
    }

    /// Vertex positions in the world, mm.
    #[must_use]
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// What each vertex is.
    #[must_use]
    pub fn kinds(&self) -> &[VertexKind] {
        &self.kinds
    }

    /// Vertex indices of each triangle.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The pair of each triangle.
    #[must_use]
    pub fn pairs(&self) -> &[Pair] {
        &self.pairs
    }

    /// The materials, by ascending id.
    #[must_use]
    pub fn materials(&self) -> &[MeshMaterial] {
        &self.materials
    }

    /// The three corners of triangle `t`.
    ///
    /// # Panics
    /// If there is no triangle `t`.
    #[must_use]
    pub fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].map(|v| self.positions[v as usize])
    }
}
