//! Areas, volumes, pieces and Euler characteristics.
//!
//! Method: the volume inside a shell is the sum of its triangles' signed tetrahedra over a point
//! near them (the divergence theorem); sums run over chunks of fixed size in a fixed order, so they do
//! not depend on threads. Guarantee: for a closed shell the volume does not depend on that point.
//! Not guaranteed: that the volume of an open shell means anything; it is left out.

use std::collections::BTreeMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::InterfaceMesh;
use super::check::has_shell;
use super::components::{Components, ShellPieces};
use super::in_chunks::{InChunks, Sum};
use super::sigmas::{SigmaMeasure, Sigmas};
use super::tables::Tables;
use super::window::Window;
use crate::grid::{MaterialId, Pair};

/// One interface: all triangles of a pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairMeasure {
    /// The materials.
    pub pair: Pair,
    /// Number of triangles.
    pub triangles: u64,
    /// Area, mm².
    pub area: f64,
    /// How well its vertices are known, if that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma: Option<SigmaMeasure>,
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
    let window = Window::whole(mesh);
    let mut measurer = Measurer::default();
    measurer.add(&window, &Tables::new(&window));
    measurer.finish()
}

/// Measures a mesh window by window.
#[derive(Default)]
pub(crate) struct Measurer {
    vertices: u64,
    triangles: u64,
    origins: Origins,
    sums: InChunks<Sums>,
    components: Components,
    sigmas: Sigmas,
}

impl Measurer {
    /// Measures what the window owns.
    pub(crate) fn add(&mut self, window: &Window<'_>, tables: &Tables) {
        self.vertices += window.own_vertices().len() as u64;
        self.triangles += window.own_triangles().len() as u64;
        self.origins.add(window);
        self.sums.add(window, &self.origins);
        self.components.add(window, tables);
        self.sigmas.add(window, tables);
    }

    /// The measures of all windows.
    pub(crate) fn finish(self) -> Measures {
        let Sums { pairs, volumes, .. } = self.sums.finish();
        let pairs: BTreeMap<Pair, (u64, f64)> =
            pairs.into_iter().map(|(pair, count, area)| (pair, (count, area))).collect();
        let pairs: Vec<PairMeasure> = pairs
            .into_iter()
            .map(|(pair, (triangles, area))| PairMeasure {
                pair,
                triangles,
                area,
                sigma: self.sigmas.of(pair),
            })
            .collect();
        let volume = |id: MaterialId| volumes.iter().find(|v| v.0 == id).map_or(0.0, |v| v.1 / 6.0);
        let shell = |(material, found): (MaterialId, ShellPieces)| {
            let of_it = || pairs.iter().filter(|p| p.pair.contains(material));
            ShellMeasure {
                material,
                triangles: of_it().map(|p| p.triangles).sum(),
                area: of_it().map(|p| p.area).sum(),
                volume: found.closed.then(|| volume(material)),
                euler_characteristic: found.euler_characteristic,
                components: found.count,
                pieces: found.largest,
            }
        };
        let shells = self.components.finish().into_iter().map(shell).collect();
        Measures { vertices: self.vertices, triangles: self.triangles, pairs, shells }
    }
}

/// For each material a point near its shell, over which volumes are taken: the first corner of its
/// first triangle. So far origins cost no digits.
struct Origins([Option<DVec3>; 256]);

impl Default for Origins {
    fn default() -> Self {
        Self([None; 256])
    }
}

impl Origins {
    fn add(&mut self, window: &Window<'_>) {
        let mut last = None;
        for t in window.own_triangles() {
            let pair = window.pairs()[t];
            if last != Some(pair) {
                last = Some(pair);
                for id in [pair.back(), pair.front()] {
                    self.0[usize::from(id.0)].get_or_insert_with(|| window.corners(t)[0]);
                }
            }
        }
    }
}

/// Areas and volumes of some triangles. There are few pairs and materials in a chunk, and neighbours mostly
/// have the same, so lists are searched from the last entry used.
#[derive(Default)]
struct Sums {
    /// Triangles and area of each pair met.
    pairs: Vec<(Pair, u64, f64)>,
    /// Six times the volume of each material met.
    volumes: Vec<(MaterialId, f64)>,
    /// The pair of the triangle before, and its places in the lists.
    last: Option<(Pair, usize, [Option<usize>; 2])>,
}

impl Sums {
    fn of_pair(&mut self, pair: Pair) -> usize {
        self.pairs.iter().position(|p| p.0 == pair).unwrap_or_else(|| {
            self.pairs.push((pair, 0, 0.0));
            self.pairs.len() - 1
        })
    }

    fn of_material(&mut self, id: MaterialId) -> usize {
        self.volumes.iter().position(|v| v.0 == id).unwrap_or_else(|| {
            self.volumes.push((id, 0.0));
            self.volumes.len() - 1
        })
    }
}

impl Sum for Sums {
    type Given = Origins;

    fn take(&mut self, window: &Window<'_>, t: usize, origins: &Origins) {
        let pair = window.pairs()[t];
        let (_, place, volumes) = match self.last {
            Some(last) if last.0 == pair => last,
            _ => {
                let ids = [pair.back(), pair.front()];
                let volumes = ids.map(|id| has_shell(id).then(|| self.of_material(id)));
                let last = (pair, self.of_pair(pair), volumes);
                self.last = Some(last);
                last
            }
        };
        let [a, b, c] = window.corners(t);
        self.pairs[place].1 += 1;
        self.pairs[place].2 += (b - a).cross(c - a).length() / 2.0;
        for (place, sign) in volumes.into_iter().zip([1.0, -1.0]) {
            let Some((id, six)) = place.map(|v| &mut self.volumes[v]) else { continue };
            let origin = origins.0[usize::from(id.0)].unwrap_or(a);
            *six += sign * (a - origin).dot((b - origin).cross(c - origin));
        }
    }

    fn join(&mut self, later: Self) {
        for (pair, count, area) in later.pairs {
            let place = self.of_pair(pair);
            self.pairs[place].1 += count;
            self.pairs[place].2 += area;
        }
        for (id, six) in later.volumes {
            let place = self.of_material(id);
            self.volumes[place].1 += six;
        }
    }
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
