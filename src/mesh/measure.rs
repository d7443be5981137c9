//! Areas, volumes, pieces and Euler characteristics.
//!
//! Method: the volume inside a shell is the sum of its triangles' signed tetrahedra over a point
//! near them (the divergence theorem); sums run over chunks of fixed size in a fixed order, so they do
//! not depend on threads. Guarantee: for a closed shell the volume does not depend on that point.
//! Not guaranteed: that the volume of an open shell means anything; it is left out.

use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::InterfaceMesh;
use super::check::has_shell;
use super::edge_table::EdgeTable;
use crate::grid::{MaterialId, Pair};

/// Triangles summed in one task.
const CHUNK: usize = 1 << 14;

/// One interface: all triangles of a pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairMeasure {
    /// The materials.
    pub pair: Pair,
    /// Number of triangles.
    pub triangles: u64,
    /// Area, mm².
    pub area: f64,
}

/// One material's shell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShellMeasure {
    /// The material.
    pub material: MaterialId,
    /// Number of triangles.
    pub triangles: u64,
    /// Area, mm².
    pub area: f64,
    /// Volume inside, mm³; `None` if the shell is not closed.
    pub volume: Option<f64>,
    /// Vertices - edges + triangles, over all pieces.
    pub euler_characteristic: i64,
    /// Euler characteristics of the connected pieces (triangles connected through vertices they
    /// share), largest piece first by triangles, then by lowest vertex; at most the first
    /// [`ShellMeasure::MAX_LISTED`].
    pub pieces: Vec<PieceMeasure>,
    /// Number of connected pieces.
    pub components: u64,
}

impl ShellMeasure {
    /// How many pieces are listed one by one.
    pub const MAX_LISTED: usize = 100;
}

/// A connected piece of a shell.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PieceMeasure {
    /// Its lowest vertex id.
    pub vertex: u32,
    /// Number of triangles.
    pub triangles: u64,
    /// Vertices - edges + triangles: 2 for a sphere, 0 for a torus.
    pub euler_characteristic: i64,
}

/// The measures of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// Number of vertices.
    pub vertices: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Each interface, by ascending pair.
    pub pairs: Vec<PairMeasure>,
    /// Each material's shell, ascending; air is left out as its shell is open by design.
    pub shells: Vec<ShellMeasure>,
}

/// Measures all interfaces and shells of `mesh`.
#[must_use]
pub fn measure(mesh: &InterfaceMesh) -> Measures {
    let table = EdgeTable::new(mesh.positions().len(), mesh.triangles());
    measure_with(mesh, &table)
}

/// As [`measure`], with the mesh's edges at hand.
pub(crate) fn measure_with(mesh: &InterfaceMesh, table: &EdgeTable) -> Measures {
    let pairs = pair_measures(mesh);
    let mut ids: Vec<MaterialId> =
        pairs.iter().flat_map(|p| [p.pair.back(), p.pair.front()]).filter(|&id| has_shell(id)).collect();
    ids.sort_unstable();
    ids.dedup();
    let shells = ids
        .into_iter()
        .map(|material| {
            let of_it = || pairs.iter().filter(|p| p.pair.contains(material));
            let (closed, pieces) = pieces(mesh, table, material);
            ShellMeasure {
                material,
                triangles: of_it().map(|p| p.triangles).sum(),
                area: of_it().map(|p| p.area).sum(),
                volume: closed.then(|| volume(mesh, material)),
                euler_characteristic: pieces.iter().map(|p| p.euler_characteristic).sum(),
                components: pieces.len() as u64,
                pieces: pieces.into_iter().take(ShellMeasure::MAX_LISTED).collect(),
            }
        })
        .collect();
    Measures {
        vertices: mesh.positions().len() as u64,
        triangles: mesh.triangles().len() as u64,
        pairs,
        shells,
    }
}

/// The chunks of all triangles' ids.
fn chunks(mesh: &InterfaceMesh) -> impl IndexedParallelIterator<Item = std::ops::Range<usize>> {
    let n = mesh.triangles().len();
    (0..n.div_ceil(CHUNK)).into_par_iter().map(move |c| c * CHUNK..((c + 1) * CHUNK).min(n))
}

fn pair_measures(mesh: &InterfaceMesh) -> Vec<PairMeasure> {
    let parts: Vec<BTreeMap<Pair, (u64, f64)>> = chunks(mesh)
        .map(|chunk| {
            let mut part = BTreeMap::new();
            for t in chunk {
                let [a, b, c] = mesh.corners(t);
                let (count, area) = part.entry(mesh.pairs()[t]).or_insert((0, 0.0));
                *count += 1;
                *area += (b - a).cross(c - a).length() / 2.0;
            }
            part
        })
        .collect();
    let mut all: BTreeMap<Pair, (u64, f64)> = BTreeMap::new();
    for (pair, (count, area)) in parts.into_iter().flatten() {
        let sum = all.entry(pair).or_insert((0, 0.0));
        sum.0 += count;
        sum.1 += area;
    }
    all.into_iter().map(|(pair, (triangles, area))| PairMeasure { pair, triangles, area }).collect()
}

/// The volume inside the shell of `material`, taken over its first corner: far origins cost nothing.
fn volume(mesh: &InterfaceMesh, material: MaterialId) -> f64 {
    let first = mesh.pairs().iter().position(|p| p.contains(material));
    let Some(origin) = first.map(|t| mesh.corners(t)[0]) else { return 0.0 };
    let parts: Vec<f64> = chunks(mesh)
        .map(|chunk| {
            let mut sum = 0.0;
            for t in chunk {
                let pair = mesh.pairs()[t];
                if pair.contains(material) {
                    let [a, b, c] = mesh.corners(t).map(|p| p - origin);
                    let six = DVec3::dot(a, b.cross(c));
                    sum += if pair.back() == material { six } else { -six };
                }
            }
            sum
        })
        .collect();
    parts.into_iter().sum::<f64>() / 6.0
}

/// Whether the shell of `material` is closed, and its connected pieces.
fn pieces(mesh: &InterfaceMesh, table: &EdgeTable, material: MaterialId) -> (bool, Vec<PieceMeasure>) {
    const UNUSED: u32 = u32::MAX;
    let n = mesh.positions().len();
    let mut parent = vec![UNUSED; n];
    let of_it = || mesh.triangles().iter().zip(mesh.pairs()).filter(|(_, p)| p.contains(material));
    for (t, _) in of_it() {
        for &v in t {
            if parent[v as usize] == UNUSED {
                parent[v as usize] = v;
            }
        }
        for v in [t[1], t[2]] {
            let (a, b) = (root(&mut parent, t[0]), root(&mut parent, v));
            // The lowest id stays the root.
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    // Per root: vertices - edges, and triangles.
    let mut dense = vec![(0i64, 0u64); n];
    for v in 0..n as u32 {
        if parent[v as usize] != UNUSED {
            dense[root(&mut parent, v) as usize].0 += 1;
        }
    }
    for (t, _) in of_it() {
        dense[root(&mut parent, t[0]) as usize].1 += 1;
    }
    let mut closed = true;
    for (low, _, uses) in table.edges() {
        let (mut used, mut balance) = (false, 0);
        for u in uses {
            let pair = mesh.pairs()[u.triangle()];
            if pair.contains(material) {
                used = true;
                balance += if u.is_forward() == (pair.back() == material) { 1 } else { -1 };
            }
        }
        if used {
            dense[root(&mut parent, low) as usize].0 -= 1;
            closed &= balance == 0;
        }
    }
    let mut pieces: Vec<_> = dense
        .into_iter()
        .enumerate()
        .filter(|(_, (_, triangles))| *triangles > 0)
        .map(|(vertex, (rest, triangles))| PieceMeasure {
            vertex: vertex as u32,
            triangles,
            euler_characteristic: rest + triangles as i64,
        })
        .collect();
    pieces.sort_by_key(|p| (std::cmp::Reverse(p.triangles), p.vertex));
    (closed, pieces)
}

fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::{mesh, parts, voxel_faces};

    #[test]
    fn cubes_have_their_areas_volumes_and_shapes() {
        let (p, t, pairs) = parts(&voxel_faces([2, 1, 1], &[1, 2], 0));
        // Far from the origin, as CT volumes in machine coordinates are.
        let p = p.iter().map(|&p| p * 0.5 + DVec3::new(1e5, -2e5, 3e5)).collect();
        let m = measure(&mesh(p, t, pairs));
        let areas: Vec<_> =
            m.pairs.iter().map(|p| (p.pair.back().0, p.pair.front().0, p.triangles, p.area)).collect();
        assert_eq!(areas, [(1, 0, 10, 1.25), (2, 0, 10, 1.25), (2, 1, 2, 0.25)]);
        for shell in &m.shells {
            assert!((shell.volume.unwrap() - 0.125).abs() < 1e-12);
            assert_eq!((shell.components, shell.euler_characteristic, shell.triangles), (1, 2, 12));
            assert!((shell.area - 1.5).abs() < 1e-12);
        }
    }

    #[test]
    fn rings_voids_and_pieces() {
        // A ring of eight cubes: a torus.
        let ring = measure(&voxel_faces([3, 3, 1], &[1, 1, 1, 1, 0, 1, 1, 1, 1], 0));
        assert_eq!(ring.shells[0].euler_characteristic, 0);
        assert!((ring.shells[0].volume.unwrap() - 8.0).abs() < 1e-12);
        // A void: two pieces, the outer one first, and its volume is taken off.
        let hollow =
            measure(&voxel_faces([3, 3, 3], &std::array::from_fn::<u8, 27, _>(|i| u8::from(i != 13)), 0));
        assert!((hollow.shells[0].volume.unwrap() - 26.0).abs() < 1e-12);
        assert_eq!(hollow.shells[0].components, 2);
        assert_eq!(hollow.shells[0].pieces[0].triangles, 108);
        assert!(hollow.shells[0].pieces.iter().all(|p| p.euler_characteristic == 2));
        // The filled void belongs to the other material, both ways round.
        let filled =
            measure(&voxel_faces([3, 3, 3], &std::array::from_fn::<u8, 27, _>(|i| 1 + u8::from(i == 13)), 0));
        assert!((filled.shells[1].volume.unwrap() - 1.0).abs() < 1e-12);
        assert!((filled.shells[0].volume.unwrap() - 26.0).abs() < 1e-12);
    }

    #[test]
    fn an_open_shell_has_no_volume() {
        let (p, mut t, mut pairs) = parts(&voxel_faces([1, 1, 1], &[1], 0));
        t.pop();
        pairs.pop();
        let m = measure(&mesh(p, t, pairs));
        assert_eq!(m.shells[0].volume, None);
        assert_eq!(m.shells[0].euler_characteristic, 1);
    }
}
