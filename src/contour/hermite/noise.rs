//! How well the positions of crossings are known, from noise and blur.

use std::f64::consts::TAU;

use crate::grid::MaterialId;
use crate::material::MaterialTable;

/// Blur where it is not known: a typical industrial scan, in voxels.
const DEFAULT_BLUR: f64 = 1.0;
/// Mean of (1 - t)² + t² over an edge: how much of the variance of two independent grey values linear
/// interpolation between them leaves.
const INTERPOLATED: f64 = 2.0 / 3.0;

/// What is known of an interface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairQuality {
    /// Sigma of the blur, in voxels of mean edge length.
    pub blur: f64,
    /// Standard deviation of grey values, as a share of the contrast.
    pub noise: f64,
    /// Difference of the materials' mean grey values; 0 where it is not known, and then no step is gentle
    /// enough for [`NormalRule::Auto`](super::NormalRule::Auto) to trust grey values alone.
    pub contrast: f64,
}

impl Default for PairQuality {
    fn default() -> Self {
        Self { blur: DEFAULT_BLUR, noise: 0.0, contrast: 0.0 }
    }
}

impl PairQuality {
    /// Of the interface between two materials of the table, for a blur of sigma `blur` voxels (of mean edge
    /// length), if known. The noise is the mean of that of both materials; where none is known, zero.
    ///
    /// # Panics
    /// If an id is not in the table.
    #[must_use]
    pub fn new(materials: &MaterialTable, pair: [MaterialId; 2], blur: Option<f64>) -> Self {
        let [a, b] = pair.map(|id| &materials.materials()[usize::from(id.0)]);
        let variance = |sigma: Option<f64>| sigma.map(|s| s * s);
        let (a2, b2) = (variance(a.sigma), variance(b.sigma));
        let mean = 0.5 * (a2.or(b2).unwrap_or(0.0) + b2.or(a2).unwrap_or(0.0));
        let contrast = (a.mean - b.mean).abs().max(f64::MIN_POSITIVE);
        Self { blur: blur.unwrap_or(DEFAULT_BLUR), noise: mean.sqrt() / contrast, contrast }
    }

    /// Standard deviation that noise gives the positions of crossings, measured along the normal, in voxels of
    /// mean edge length: the noise left by interpolation over the slope of a blurred step, which is one per
    /// `blur * sqrt(2 pi)` voxels, but one per voxel at most.
    #[must_use]
    pub fn position_sigma(&self) -> f64 {
        let width = (self.blur * TAU.sqrt()).max(1.0);
        self.noise * width * INTERPOLATED.sqrt()
    }
}

/// The quality of each pair of materials.
#[derive(Debug, Clone, PartialEq)]
pub struct Qualities {
    materials: usize,
    pairs: Vec<PairQuality>,
}

impl Qualities {
    /// Of all pairs of a table; blur as for [`PairQuality::new`].
    #[must_use]
    pub fn new(materials: &MaterialTable, blur: Option<f64>) -> Self {
        let (ids, n) = (materials.materials(), materials.count());
        let of = |i: usize| match (ids[i / n].id, ids[i % n].id) {
            (a, b) if a == b => PairQuality::default(),
            (a, b) => PairQuality::new(materials, [a, b], blur),
        };
        Self { materials: n, pairs: (0..n * n).map(of).collect() }
    }

    /// The same for all pairs of that many materials.
    #[must_use]
    pub fn alike(materials: usize, quality: PairQuality) -> Self {
        Self { materials, pairs: vec![quality; materials * materials] }
    }

    /// Number of materials.
    #[must_use]
    pub fn materials(&self) -> usize {
        self.materials
    }

    /// The largest standard deviation of positions, of all pairs, voxels of mean edge length.
    #[must_use]
    pub fn worst_position_sigma(&self) -> f64 {
        self.pairs.iter().fold(0.0, |m: f64, q| m.max(q.position_sigma()))
    }

    /// Of a pair of materials.
    ///
    /// # Panics
    /// If an id is not among the materials.
    #[must_use]
    pub fn of(&self, [a, b]: [MaterialId; 2]) -> PairQuality {
        assert!(usize::from(b.0) < self.materials, "material {} of {}", b.0, self.materials);
        self.pairs[usize::from(a.0) * self.materials + usize::from(b.0)]
    }
}
