//! From contouring's lattice units to a mesh in the world.

use glam::DVec3;
use rayon::prelude::*;

use super::MeshPiece;
use super::interface_mesh::{InterfaceMesh, MeshError, MeshMaterial};
use crate::contour::dual::DualSurface;
use crate::contour::{Patch, Piece};
use crate::grid::{Geometry, Written};
use crate::material::MaterialTable;

impl MeshMaterial {
    /// What a mesh keeps of a table of materials.
    #[must_use]
    pub fn from_table(table: &MaterialTable) -> Vec<Self> {
        table.materials().iter().map(|m| Self { id: m.id, name: m.name.clone(), mean: m.mean }).collect()
    }
}

impl InterfaceMesh {
    /// The mesh of a patch whose lattice lies in the world as `geometry` says, its places as [`Written`]. On a mirrored
    /// lattice (direction with a negative determinant) triangles are turned over, so that normals
    /// point from back to front in the world.
    ///
    /// # Errors
    /// As [`InterfaceMesh::new`]; a patch made by contouring gives none.
    pub fn from_patch(
        patch: Patch,
        geometry: &Geometry,
        materials: Vec<MeshMaterial>,
    ) -> Result<Self, MeshError> {
        let Patch { positions, kinds, mut sigmas, mut triangles, pairs } = patch;
        let written = Written::new(geometry);
        let positions: Vec<DVec3> =
            positions.par_iter().map(|p| written.place(DVec3::from(p.map(f64::from)))).collect();
        if geometry.is_mirrored() {
            triangles.par_iter_mut().for_each(|t| t.swap(1, 2));
        }
        let edge = geometry.voxel_edge() as f32;
        sigmas.par_iter_mut().for_each(|s| *s *= edge);
        Self::new(positions, kinds, triangles, pairs, materials)?.with_sigmas(sigmas)
    }
}

impl InterfaceMesh {
    /// The mesh of a surface made by dual contouring, which is in the world already.
    ///
    /// # Errors
    /// As [`InterfaceMesh::new`]; a surface made by contouring gives none.
    pub fn from_dual(surface: DualSurface, materials: Vec<MeshMaterial>) -> Result<Self, MeshError> {
        let DualSurface { positions, kinds, sigmas, triangles, pairs, .. } = surface;
        Self::new(positions, kinds, triangles, pairs, materials)?.with_sigmas(sigmas)
    }
}

impl MeshPiece {
    /// The piece of mesh of a piece of surface, as [`InterfaceMesh::from_patch`] makes it. `first` are the
    /// numbers in the whole mesh of its first vertex and its first triangle.
    ///
    /// # Errors
    /// As [`InterfaceMesh::new`]; a piece made by contouring gives none.
    pub fn from_contour(
        piece: Piece,
        geometry: &Geometry,
        materials: Vec<MeshMaterial>,
        [first_vertex, first_triangle]: [u64; 2],
    ) -> Result<Self, MeshError> {
        let Piece { patch, owned, last_layer, .. } = piece;
        let mesh = InterfaceMesh::from_patch(patch, geometry, materials)?;
        Ok(Self { mesh, owned, last_layer, first_vertex, first_triangle })
    }
}
