//! How many vertices STL's `f32` coordinates make one with another.
//!
//! Rounding moves a coordinate by at most half a step of `f32` at the largest coordinate, so vertices can
//! only become one if they are at most a whole step apart. A mesh that comes by layers of the volume is therefore
//! looked through with the rounded places of the last few layers at hand: as many as such a
//! step can span, normally one. (Skipping the search where the step is small against the distances in the mesh
//! would need a least distance, and the nodes that contouring puts into faces and cells have none that is proven.)

use glam::DVec3;
use rayon::prelude::*;

use crate::grid::Geometry;
use crate::mesh::{InterfaceMesh, MeshPiece};

/// Layers by which a vertex may lie lower than one that came before it: those of one layer come in any
/// order, and one more for rounding.
const DISORDER: f64 = 2.0;

/// A vertex as STL has it; both zeros are one.
type Place = [u32; 3];

fn rounded(p: DVec3) -> Place {
    p.to_array().map(|c| (c as f32 + 0.0).to_bits())
}

/// Counts, piece by piece, the vertices that become one with another in the `f32` coordinates of STL: none
/// unless the mesh lies far from the world's origin for the size of its triangles. A shell in which that
/// happens is in general no longer closed or manifold for a reader.
#[derive(Debug)]
pub struct MergedByStl {
    /// From the world to layers: their number is `layer · p + offset`.
    layer: DVec3,
    offset: f64,
    /// How far below the highest vertex so far one may lie to be met again, in layers.
    reach: f64,
    highest: f64,
    /// Different places that may be met again, and their layers; ascending.
    recent: Vec<(Place, f64)>,
    merged: u64,
}

impl MergedByStl {
    /// For the mesh of a volume that lies as `geometry` says, in whose pieces vertices come by layers of
    /// cells, as contouring leaves them.
    #[must_use]
    pub fn new(geometry: &Geometry) -> Self {
        let to_index = geometry.index_to_world().inverse();
        let layer = to_index.row(2);
        // Half a step at a number is at most 2^-24 of it, of the least numbers 2^-150. A little more, for the
        // rounding of what is computed here; beyond the range of f32 all become infinite: then nothing is far.
        let largest = geometry.largest_coordinate();
        let half = 1.001 * largest * f64::from(f32::EPSILON) / 2.0 + f64::from(f32::MIN_POSITIVE);
        let half = if largest < f64::from(f32::MAX) { half } else { f64::INFINITY };
        Self {
            layer,
            offset: -layer.dot(DVec3::from(geometry.origin())),
            reach: DISORDER + layer.abs().element_sum() * 2.0 * half,
            highest: f64::NEG_INFINITY,
            recent: Vec::new(),
            merged: 0,
        }
    }

    /// Counts the vertices of the next piece that are its own.
    pub fn add(&mut self, piece: &MeshPiece) {
        let own = &piece.mesh.positions()[..piece.owned.min(piece.mesh.positions().len())];
        let mut new: Vec<_> =
            own.par_iter().map(|&p| (rounded(p), self.layer.dot(p) + self.offset)).collect();
        self.highest = new.par_iter().map(|v| v.1).reduce(|| self.highest, f64::max);
        // Of equal places the highest comes last and is kept: it stays in reach the longest.
        new.par_sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let count = new.len();
        new.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 = next.1;
            }
            same
        });
        self.merged += (count - new.len()) as u64;
        let lowest = self.highest - self.reach;
        let mut both = Vec::with_capacity(self.recent.len() + new.len());
        let mut old = std::mem::take(&mut self.recent).into_iter().peekable();
        for (place, layer) in new {
            while let Some(earlier) = old.next_if(|o| o.0 < place) {
                both.push(earlier);
            }
            let again = old.next_if(|o| o.0 == place);
            self.merged += u64::from(again.is_some());
            both.push((place, again.map_or(layer, |o| o.1.max(layer))));
        }
        both.extend(old);
        both.retain(|v| v.1 >= lowest);
        self.recent = both;
    }

    /// How many vertices have become one with an earlier one so far.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.merged
    }
}

/// As [`MergedByStl`], of a mesh at hand, in whatever order.
#[must_use]
pub fn vertices_merged_by_stl(mesh: &InterfaceMesh) -> usize {
    let mut places: Vec<Place> = mesh.positions().par_iter().map(|&p| rounded(p)).collect();
    places.par_sort_unstable();
    places.dedup();
    mesh.positions().len() - places.len()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::grid::VertexKind;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        #[test]
        fn pieces_merge_as_the_whole_does(
            // In every layer some vertices near a few places, some of them on the planes.
            layers in prop::collection::vec(
                prop::collection::vec((0u8..3, 0u8..3, 0u8..5, 0u8..3), 0..12), 1..9),
            cuts in prop::collection::vec(0usize..9, 0..4),
            far in -1i32..10,
            turned: bool,
        ) {
            let direction = if turned {
                [[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, -0.8, 0.6]]
            } else {
                [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
            };
            let origin = if far < 0 { 0.0 } else { 10f64.powi(far) };
            let geometry =
                Geometry::new([3, 3, 10], [0.3, 0.2, 0.1], [origin, -origin, 2.0 * origin], direction).unwrap();
            let point = |k: usize, &(x, y, z, tiny): &(u8, u8, u8, u8)| {
                let z = k as f64 + (f64::from(z) / 4.0 + f64::from(tiny) * 1e-5).min(1.0);
                geometry.world(DVec3::new(f64::from(x), f64::from(y), z))
            };
            let positions: Vec<Vec<DVec3>> = layers
                .iter()
                .enumerate()
                .map(|(k, layer)| layer.iter().map(|v| point(k, v)).collect())
                .collect();
            let mesh = |positions: Vec<DVec3>| {
                let kinds = vec![VertexKind::Interface; positions.len()];
                InterfaceMesh::new(positions, kinds, Vec::new(), Vec::new(), Vec::new()).unwrap()
            };
            let mut stream = MergedByStl::new(&geometry);
            let mut bounds: Vec<usize> = cuts.iter().map(|c| c % positions.len()).collect();
            bounds.extend([0, positions.len()]);
            bounds.sort_unstable();
            for range in bounds.windows(2) {
                stream.add(&MeshPiece::whole(mesh(positions[range[0]..range[1]].concat())));
            }
            prop_assert_eq!(stream.count(), vertices_merged_by_stl(&mesh(positions.concat())) as u64);
        }
    }

    #[test]
    fn only_the_last_layers_are_kept() {
        let geometry = Geometry::axis_aligned([10, 10, 1000], [0.1; 3]).unwrap();
        let mut stream = MergedByStl::new(&geometry);
        let mut most = 0;
        for z in 0..1000 {
            let positions: Vec<_> = (0..100)
                .map(|i| geometry.world(DVec3::new(f64::from(i) / 10.0, 0.5, f64::from(z))))
                .collect();
            let kinds = vec![VertexKind::Interface; 100];
            let mesh = InterfaceMesh::new(positions, kinds, Vec::new(), Vec::new(), Vec::new()).unwrap();
            stream.add(&MeshPiece::whole(mesh));
            most = most.max(stream.recent.len());
        }
        assert_eq!((stream.count(), most), (0, 300));
    }
}
