//! Small hand-made meshes for tests: faces between unlike voxels.

use std::collections::BTreeMap;

use glam::DVec3;

use super::{InterfaceMesh, MeshMaterial};
use crate::grid::{MaterialId, Pair, VertexKind};

/// Materials 0 to 3.
pub(crate) fn materials() -> Vec<MeshMaterial> {
    ["air", "plastic", "steel", "lead"]
        .into_iter()
        .enumerate()
        .map(|(id, name)| MeshMaterial {
            id: MaterialId(id as u8),
            name: name.to_owned(),
            mean: 50.0 * id as f64,
        })
        .collect()
}

/// A mesh of bare parts; kinds are all `Interface`.
pub(crate) fn mesh(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>, pairs: Vec<Pair>) -> InterfaceMesh {
    let kinds = vec![VertexKind::Interface; positions.len()];
    InterfaceMesh::new(positions, kinds, triangles, pairs, materials()).unwrap()
}

/// The parts of a mesh, to break it and put it together again with [`mesh`].
pub(crate) fn parts(m: &InterfaceMesh) -> (Vec<DVec3>, Vec<[u32; 3]>, Vec<Pair>) {
    (m.positions().to_vec(), m.triangles().to_vec(), m.pairs().to_vec())
}

pub(crate) fn pair(a: u8, b: u8) -> Pair {
    Pair::new(MaterialId(a), MaterialId(b)).unwrap()
}

/// Unit cubes of the given labels (x fastest), `around` beyond them; two triangles for each face
/// between unlike cubes, except between 0 and 255. Vertices are the lattice corners.
pub(crate) fn voxel_faces(dims: [usize; 3], labels: &[u8], around: u8) -> InterfaceMesh {
    let label = |p: [i64; 3]| {
        let inside = (0..3).all(|a| p[a] >= 0 && p[a] < dims[a] as i64);
        if !inside {
            return around;
        }
        labels[(p[0] + dims[0] as i64 * (p[1] + dims[1] as i64 * p[2])) as usize]
    };
    let mut ids = BTreeMap::new();
    let mut positions = Vec::new();
    let (mut triangles, mut pairs) = (Vec::new(), Vec::new());
    let d = dims.map(|n| n as i64);
    for z in -1..=d[2] {
        for y in -1..=d[1] {
            for x in -1..=d[0] {
                for axis in 0..3 {
                    let low = [x, y, z];
                    let mut high = low;
                    high[axis] += 1;
                    let (a, b) = (label(low), label(high));
                    let Some(p) = Pair::new(MaterialId(a), MaterialId(b)) else { continue };
                    if !p.contains(MaterialId(1)) && !p.contains(MaterialId(2)) && !p.contains(MaterialId(3))
                    {
                        continue;
                    }
                    // Counter-clockwise seen from higher coordinates along the axis.
                    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
                    let mut quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(di, dj)| {
                        let mut c = high;
                        c[i] += di;
                        c[j] += dj;
                        *ids.entry(c).or_insert_with(|| {
                            positions.push(DVec3::from_array(c.map(|v| v as f64)));
                            positions.len() as u32 - 1
                        })
                    });
                    if p.front().0 != b {
                        quad.reverse();
                    }
                    triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
                    pairs.extend([p, p]);
                }
            }
        }
    }
    mesh(positions, triangles, pairs)
}
