//! One material's own shell.

use glam::DVec3;

use super::{InterfaceMesh, MeshError};
use crate::grid::{MaterialId, Pair};

/// The triangles that border one material, seen from outside it, with the vertices they use.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Shell {
    /// Vertex positions: world, mm; in the order of the mesh.
    pub positions: Vec<DVec3>,
    /// Vertex indices into `positions`, counter-clockwise seen from outside the material; in the
    /// order of the mesh.
    pub triangles: Vec<[u32; 3]>,
    /// For each vertex its id in the mesh.
    pub vertices: Vec<u32>,
}

/// Splits off the shell of `material`: triangles with it behind them as they are, triangles with it
/// in front flipped. Closed wherever the mesh is without defects, except for air and `OUTSIDE`,
/// between which there are no triangles.
#[must_use]
pub fn split(mesh: &InterfaceMesh, material: MaterialId) -> Shell {
    const UNUSED: u32 = u32::MAX;
    let mut new_id = vec![UNUSED; mesh.positions().len()];
    let mut shell = Shell::default();
    for (&[a, b, c], pair) in mesh.triangles().iter().zip(mesh.pairs()) {
        if pair.back() == material {
            shell.triangles.push([a, b, c]);
        } else if pair.front() == material {
            shell.triangles.push([a, c, b]);
        } else {
            continue;
        }
        for v in [a, b, c] {
            new_id[v as usize] = 0;
        }
    }
    for (v, id) in new_id.iter_mut().enumerate().filter(|(_, id)| **id != UNUSED) {
        *id = shell.positions.len() as u32;
        shell.positions.push(mesh.positions()[v]);
        shell.vertices.push(v as u32);
    }
    for v in shell.triangles.iter_mut().flatten() {
        *v = new_id[*v as usize];
    }
    shell
}

impl Shell {
    /// The shell as a labelled mesh of its own: `material` behind every triangle, the background in
    /// front, whatever is really there. Kinds are those of the mesh it was split from.
    ///
    /// # Errors
    /// [`MeshError`] if `mesh` is not the one the shell was split from.
    pub fn to_mesh(&self, mesh: &InterfaceMesh, material: MaterialId) -> Result<InterfaceMesh, MeshError> {
        let kind = |&v: &u32| mesh.kinds().get(v as usize).copied();
        let kinds: Vec<_> = self.vertices.iter().filter_map(kind).collect();
        let pair = Pair::new(material, MaterialId::BACKGROUND);
        let pairs = pair.map_or_else(Vec::new, |pair| vec![pair; self.triangles.len()]);
        let wanted = |id: MaterialId| id == material || id == MaterialId::BACKGROUND;
        let materials = mesh.materials().iter().filter(|m| wanted(m.id)).cloned().collect();
        let sigmas = mesh.sigmas().unwrap_or_default();
        let sigmas = self.vertices.iter().filter_map(|&v| sigmas.get(v as usize).copied()).collect();
        InterfaceMesh::new(self.positions.clone(), kinds, self.triangles.clone(), pairs, materials)?
            .with_sigmas(sigmas)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::voxel_faces;

    #[test]
    fn both_sides_of_an_interface_get_it_in_their_own_direction() {
        let m = voxel_faces([2, 1, 1], &[1, 2], 0);
        for (id, middle) in [(1, DVec3::new(0.5, 0.5, 0.5)), (2, DVec3::new(1.5, 0.5, 0.5))] {
            let shell = split(&m, MaterialId(id));
            assert_eq!((shell.positions.len(), shell.triangles.len()), (8, 12));
            for t in &shell.triangles {
                let [a, b, c] = t.map(|v| shell.positions[v as usize] - middle);
                assert!((b - a).cross(c - a).dot(a) > 0.0);
            }
            for (p, &v) in shell.positions.iter().zip(&shell.vertices) {
                assert_eq!(*p, m.positions()[v as usize]);
            }
        }
        assert!(split(&m, MaterialId(3)).triangles.is_empty());
    }
}
