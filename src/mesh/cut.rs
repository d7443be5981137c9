//! For tests: meshes in layers, with and without defects, cut into pieces.

use glam::DVec3;
use rand::seq::IndexedRandom;
use rand::{Rng, RngExt};

use super::fixtures::{materials, pair, voxel_faces};
use super::{InterfaceMesh, MeshPiece};
use crate::classify::LabelVolume;
use crate::contour::marching::march;
use crate::contour::{Border, Midpoints};
use crate::execution::Execution;
use crate::grid::{Pair, VertexKind};

/// A mesh whose vertices and triangles come layer by layer, those of a layer that the layer below
/// uses first.
pub(crate) struct Layered {
    pub(crate) mesh: InterfaceMesh,
    /// The first vertex and triangle of each layer, and behind the last one's.
    firsts: Vec<[usize; 2]>,
}

/// What a mesh is made from before it is put in order.
struct Loose {
    positions: Vec<DVec3>,
    kinds: Vec<VertexKind>,
    triangles: Vec<([u32; 3], Pair)>,
}

/// The surfaces between random labels; `broken` puts in about that many defects of each kind.
pub(crate) fn random_layers(rng: &mut impl Rng, broken: usize) -> Layered {
    let dims: [usize; 3] = std::array::from_fn(|a| rng.random_range(1..=[4, 4, 7][a]));
    let most = rng.random_range(1..=3u8);
    let air = rng.random_range(0.1..0.9);
    let labels: Vec<u8> = (0..dims.iter().product())
        .map(|_| if rng.random_bool(air) { 0 } else { rng.random_range(0..=most) })
        .collect();
    let contoured = LabelVolume::from_labels(&labels, dims).ok().filter(|_| rng.random_bool(0.5));
    let mesh = if let Some((labels, _)) = contoured {
        let border = if rng.random_bool(0.5) { Border::Closed } else { Border::Open };
        let patch = march(&labels, &Midpoints, border, &Execution::default()).unwrap();
        let positions = patch.positions.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        InterfaceMesh::new(positions, patch.kinds, patch.triangles, patch.pairs, materials()).unwrap()
    } else {
        voxel_faces(dims, &labels, if rng.random_bool(0.5) { 0 } else { 255 })
    };
    let mut loose = Loose {
        positions: mesh.positions().to_vec(),
        kinds: mesh.kinds().to_vec(),
        triangles: mesh.triangles().iter().copied().zip(mesh.pairs().iter().copied()).collect(),
    };
    for _ in 0..broken {
        spoil(&mut loose, rng);
    }
    in_order(loose, rng)
}

fn layer(p: DVec3) -> i64 {
    p.z.floor() as i64
}

/// Puts in a defect of some kinds; a vertex never leaves its layer.
fn spoil(loose: &mut Loose, rng: &mut impl Rng) {
    let Loose { positions, kinds, triangles } = loose;
    let any = |triangles: &Vec<([u32; 3], Pair)>, rng: &mut _| triangles.choose(rng).copied();
    match rng.random_range(0..8) {
        0 if !triangles.is_empty() => drop(triangles.remove(rng.random_range(0..triangles.len()))),
        1 if !triangles.is_empty() => {
            let t = rng.random_range(0..triangles.len());
            triangles[t].0.swap(0, 1);
        }
        2 => triangles.extend(any(triangles, rng)),
        3 => {
            if let Some(([a, b, _], pair)) = any(triangles, rng) {
                triangles.push(([a, b, b], pair));
                triangles.push(([a, a, a], pair));
            }
        }
        4 if !triangles.is_empty() => {
            let t = rng.random_range(0..triangles.len());
            triangles[t].1 = pair(rng.random_range(1..=3), 0);
        }
        5 if !positions.is_empty() => {
            // Moved through other triangles, within its layer.
            let p = &mut positions[rng.random_range(0..kinds.len())];
            let z = p.z.floor() + rng.random_range(0.0..0.99);
            *p = DVec3::new(p.x + rng.random_range(-2.0..2.0), p.y + rng.random_range(-2.0..2.0), z);
        }
        6 => {
            let z = rng.random_range(-1.0..7.0);
            positions.push(DVec3::new(1.0, 2.0, z));
            kinds.push(VertexKind::BorderInterface);
        }
        _ => {
            // Three vertices of one layer.
            if let Some(([a, ..], pair)) = any(triangles, rng) {
                let same: Vec<u32> = (0..positions.len() as u32)
                    .filter(|&v| layer(positions[v as usize]) == layer(positions[a as usize]))
                    .collect();
                let mut one = || *same.choose(rng).unwrap_or(&a);
                triangles.push(([a, one(), one()], pair));
            }
        }
    }
}

fn in_order(loose: Loose, rng: &mut impl Rng) -> Layered {
    let Loose { positions, kinds, triangles } = loose;
    let lowest = positions.iter().map(|&p| layer(p)).min().unwrap_or(0);
    let of_vertex: Vec<usize> = positions.iter().map(|&p| (layer(p) - lowest) as usize).collect();
    let of_triangle: Vec<usize> = triangles
        .iter()
        .map(|(t, _)| {
            let [low, high] = t.iter().fold([usize::MAX, 0], |[l, h], &v| {
                [l.min(of_vertex[v as usize]), h.max(of_vertex[v as usize])]
            });
            assert!(high <= low + 1);
            // A triangle that lies on the seam altogether may belong to the layer below.
            if low == high && low > 0 && rng.random_bool(0.1) { low - 1 } else { low }
        })
        .collect();
    let mut on_seam = vec![false; positions.len()];
    for ((t, _), &z) in triangles.iter().zip(&of_triangle) {
        for &v in t.iter().filter(|&&v| of_vertex[v as usize] > z) {
            on_seam[v as usize] = true;
        }
    }
    let mut vertices: Vec<usize> = (0..positions.len()).collect();
    vertices.sort_by_key(|&v| (of_vertex[v], !on_seam[v]));
    let mut order: Vec<usize> = (0..triangles.len()).collect();
    order.sort_by_key(|&t| of_triangle[t]);
    let mut number = vec![0u32; positions.len()];
    for (new, &old) in vertices.iter().enumerate() {
        number[old] = new as u32;
    }
    let layers = of_vertex.iter().max().map_or(0, |&top| top + 1);
    let firsts = (0..=layers)
        .map(|z| {
            [vertices.partition_point(|&v| of_vertex[v] < z), order.partition_point(|&t| of_triangle[t] < z)]
        })
        .collect();
    // An odd place in the world, so that sums are rounded.
    let place = |p: DVec3| p * DVec3::new(0.1, 0.17, 0.3) + DVec3::new(100.3, -7.7, 0.1);
    let mesh = InterfaceMesh::new(
        vertices.iter().map(|&v| place(positions[v])).collect(),
        vertices.iter().map(|&v| kinds[v]).collect(),
        order.iter().map(|&t| triangles[t].0.map(|v| number[v as usize])).collect(),
        order.iter().map(|&t| triangles[t].1).collect(),
        materials(),
    )
    .unwrap();
    // Known in every other mesh; every seventh is zero.
    let known = if rng.random_bool(0.5) { vertices.len() } else { 0 };
    let sigmas = vertices[..known].iter().map(|v| (v % 7) as f32 * 0.01).collect();
    Layered { mesh: mesh.with_sigmas(sigmas).unwrap(), firsts }
}

impl Layered {
    /// The mesh in pieces; each layer begins a new one with this probability.
    pub(crate) fn cut(&self, rng: &mut impl Rng, probability: f64) -> Vec<MeshPiece> {
        let layers = self.firsts.len() - 1;
        let mut cuts: Vec<usize> = (1..layers).filter(|_| rng.random_bool(probability)).collect();
        cuts.insert(0, 0);
        cuts.push(layers);
        cuts.windows(2).map(|ends| self.piece(ends[0], ends[1])).collect()
    }

    fn piece(&self, from: usize, to: usize) -> MeshPiece {
        let m = &self.mesh;
        let ([v, t], [end, t_end]) = (self.firsts[from], self.firsts[to]);
        let used = m.triangles()[t..t_end].iter().flatten().map(|&w| w as usize + 1).max();
        let top = used.unwrap_or(end).max(end);
        let last = self.firsts[to.saturating_sub(1).max(from).min(self.firsts.len() - 1)];
        let mesh = InterfaceMesh::new(
            m.positions()[v..top].to_vec(),
            m.kinds()[v..top].to_vec(),
            m.triangles()[t..t_end].iter().map(|w| w.map(|w| w - v as u32)).collect(),
            m.pairs()[t..t_end].to_vec(),
            m.materials().to_vec(),
        )
        .unwrap()
        .with_sigmas(m.sigmas().map_or(Vec::new(), |s| s[v..top].to_vec()))
        .unwrap();
        MeshPiece {
            mesh,
            owned: end - v,
            last_layer: [last[0] - v, last[1] - t],
            first_vertex: v as u64,
            first_triangle: t as u64,
        }
    }
}
