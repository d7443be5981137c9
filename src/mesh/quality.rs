//! How well shaped the triangles are: a statistic of their quality q ([`triangle_quality`]).

use serde::{Deserialize, Serialize};

use super::InterfaceMesh;
use super::in_chunks::{InChunks, Sum};
use super::window::Window;
use crate::triangle::{smallest_angle, triangle_quality};

/// Bins of [`Quality::histogram`].
pub const BINS: usize = 20;
/// The quality that the paper's table 2 counts triangles above.
pub const GOOD: f64 = 0.3;

/// The shapes of a mesh's triangles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// The lowest q; `None` without triangles.
    pub minimum: Option<f64>,
    /// The mean q; `None` without triangles.
    pub mean: Option<f64>,
    /// Triangles with q above 0.3, in %; `None` without triangles.
    pub above_0_3_percent: Option<f64>,
    /// Triangles by q in [`BINS`] bins of equal width from 0 to 1; 1 itself is in the last one.
    pub histogram: Vec<u64>,
    /// The smallest angle in any triangle, degrees; `None` without triangles.
    pub smallest_angle: Option<f64>,
}

/// Measures the shapes of all triangles.
#[must_use]
pub fn quality(mesh: &InterfaceMesh) -> Quality {
    let mut shapes = InChunks::<Shapes>::default();
    shapes.add(&Window::whole(mesh), &());
    shapes.finish().into()
}

/// The shapes of some triangles.
#[derive(Clone)]
pub(crate) struct Shapes {
    count: u64,
    lowest: f64,
    sum: f64,
    good: u64,
    bins: [u64; BINS],
    angle: f64,
}

impl Default for Shapes {
    fn default() -> Self {
        let (lowest, angle) = (f64::INFINITY, f64::INFINITY);
        Self { count: 0, lowest, sum: 0.0, good: 0, bins: [0; BINS], angle }
    }
}

impl Sum for Shapes {
    type Given = ();

    fn take(&mut self, window: &Window<'_>, t: usize, (): &()) {
        let corners = window.corners(t);
        let q = triangle_quality(corners);
        self.count += 1;
        self.lowest = self.lowest.min(q);
        self.sum += q;
        self.good += u64::from(q > GOOD);
        self.bins[((q * BINS as f64) as usize).min(BINS - 1)] += 1;
        self.angle = self.angle.min(smallest_angle(corners));
    }

    fn join(&mut self, later: Self) {
        self.count += later.count;
        self.lowest = self.lowest.min(later.lowest);
        self.sum += later.sum;
        self.good += later.good;
        for (all, bin) in self.bins.iter_mut().zip(later.bins) {
            *all += bin;
        }
        self.angle = self.angle.min(later.angle);
    }
}

impl From<Shapes> for Quality {
    fn from(all: Shapes) -> Self {
        let some = |value: f64| (all.count > 0).then_some(value);
        Self {
            minimum: some(all.lowest),
            mean: some(all.sum / all.count as f64),
            above_0_3_percent: some(100.0 * all.good as f64 / all.count as f64),
            histogram: all.bins.to_vec(),
            smallest_angle: some(all.angle),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::voxel_faces;

    #[test]
    fn half_squares_are_all_alike() {
        let q = quality(&voxel_faces([1, 1, 1], &[1], 0));
        let half_square = 3f64.sqrt() / 2.0;
        assert!((q.minimum.unwrap() - half_square).abs() < 1e-12);
        assert!((q.mean.unwrap() - half_square).abs() < 1e-12);
        assert!((q.above_0_3_percent.unwrap() - 100.0).abs() < 1e-12);
        assert!((q.smallest_angle.unwrap() - 45.0).abs() < 1e-12);
        assert_eq!(q.histogram[17], 12);
        assert_eq!(q.histogram.iter().sum::<u64>(), 12);
    }
}
