//! Are the standard deviations that a mesh states for its vertices those of its errors?

use serde::{Deserialize, Serialize};

use super::Lengths;
use crate::grid::{MaterialId, Pair, VertexKind};
use crate::mesh::InterfaceMesh;
use crate::phantom::Truth;

/// Vertices with a stated standard deviation and a true error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Covered {
    /// How many.
    pub vertices: usize,
    /// Share of them with an error below one standard deviation, percent (68.3 if all is well).
    pub within_1: f64,
    /// Share below two, percent (95.4 if all is well).
    pub within_2: f64,
    /// Root mean square of error / standard deviation (1 if all is well).
    pub rms: f64,
    /// Mean of error / standard deviation: positive where the mesh lies too far to the front.
    pub mean: f64,
    /// Root mean square of the stated standard deviations, voxels.
    pub sigma_rms: f64,
}

/// Coverage of one pair or of all, by surrounding: as [`Groups`](super::Groups) at the near distance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// The pair's material behind and in front; `None`: all pairs.
    pub pair: Option<[u8; 2]>,
    /// All its vertices with a standard deviation.
    pub all: Option<Covered>,
    /// Away from junction curves and sharp edges.
    pub clear: Option<Covered>,
    /// Away from junction curves, near a sharp edge.
    pub near_edge: Option<Covered>,
    /// Near a junction curve.
    pub near_junction: Option<Covered>,
    /// Vertices of it whose standard deviation is not a positive number.
    pub without: usize,
}

/// A vertex: its pair, what is near it, error and standard deviation in mm.
#[derive(Clone, Copy)]
struct Vertex {
    pair: Pair,
    near_junction: bool,
    near_edge: bool,
    error: f64,
    sigma: f64,
}

/// For all pairs together, then for each pair. Only vertices inside of interfaces count: on curves an error has no one
/// direction.
pub(super) fn compare(
    mesh: &InterfaceMesh,
    truth: &Truth,
    sigmas: &[f32],
    errors: &[f64],
    lengths: &Lengths,
) -> Vec<Coverage> {
    let mut pairs: Vec<Option<Pair>> = vec![None; mesh.positions().len()];
    for (triangle, pair) in mesh.triangles().iter().zip(mesh.pairs()) {
        for v in triangle {
            pairs[*v as usize] = Some(*pair);
        }
    }
    let near = |distance: Option<f64>| distance.is_some_and(|d| d <= lengths.near);
    let vertices: Vec<Vertex> = (0..pairs.len())
        .filter(|&v| mesh.kinds()[v] == VertexKind::Interface && errors[v].is_finite())
        .filter_map(|v| {
            let p = mesh.positions()[v];
            Some(Vertex {
                pair: pairs[v].filter(|pair| !pair.contains(MaterialId::OUTSIDE))?,
                near_junction: near(truth.closest_junction(p).map(|c| c.1)),
                near_edge: near(truth.closest_edge(p).map(|c| c.1)),
                error: errors[v],
                sigma: f64::from(sigmas[v]),
            })
        })
        .collect();
    let mut named: Vec<Pair> = vertices.iter().map(|v| v.pair).collect();
    named.sort_unstable();
    named.dedup();
    let each = named.into_iter().map(Some);
    std::iter::once(None).chain(each).map(|pair| coverage(&vertices, pair, lengths.voxel)).collect()
}

fn coverage(vertices: &[Vertex], pair: Option<Pair>, voxel: f64) -> Coverage {
    let own = || vertices.iter().filter(move |v| pair.is_none_or(|pair| v.pair == pair));
    let known = |v: &&Vertex| v.sigma.is_finite() && v.sigma > 0.0;
    let group = |keep: fn(bool, bool) -> bool| {
        covered(own().filter(known).filter(|v| keep(v.near_junction, v.near_edge)), voxel)
    };
    Coverage {
        pair: pair.map(|pair| [pair.back().0, pair.front().0]),
        all: group(|_, _| true),
        clear: group(|junction, edge| !junction && !edge),
        near_edge: group(|junction, edge| !junction && edge),
        near_junction: group(|junction, _| junction),
        without: own().filter(|v| !known(v)).count(),
    }
}

fn covered<'a>(vertices: impl Iterator<Item = &'a Vertex>, voxel: f64) -> Option<Covered> {
    let (mut n, mut one, mut two) = (0, 0, 0);
    let (mut sum, mut squares, mut sigmas) = (0.0, 0.0, 0.0);
    for v in vertices {
        let ratio = v.error / v.sigma;
        n += 1;
        one += usize::from(ratio.abs() < 1.0);
        two += usize::from(ratio.abs() < 2.0);
        sum += ratio;
        squares += ratio * ratio;
        sigmas += v.sigma * v.sigma;
    }
    let all = n as f64;
    (n > 0).then(|| Covered {
        vertices: n,
        within_1: 100.0 * one as f64 / all,
        within_2: 100.0 * two as f64 / all,
        rms: (squares / all).sqrt(),
        mean: sum / all,
        sigma_rms: (sigmas / all).sqrt() / voxel,
    })
}
