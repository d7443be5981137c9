//! How well the vertices of each interface are known: quantiles of their standard deviations.
//!
//! Counted in bins of 1.6 % and less, so that neither threads nor the cutting of a mesh matter and memory is bounded. A
//! vertex of several interfaces counts for each of them.

use std::collections::BTreeMap;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::tables::Tables;
use super::window::Window;
use crate::grid::Pair;

/// Standard deviations of the positions of an interface's vertices, along its normal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SigmaMeasure {
    /// Vertices whose sigma is known.
    pub known: u64,
    /// All others.
    pub unknown: u64,
    /// Half of the known ones are at most this, mm, to within 1 %.
    pub median: f64,
    /// 95 % of the known ones are.
    pub percent_95: f64,
}

/// Bits of an `f32` that tell bins apart: its exponent and six more.
const SHIFT: u32 = 17;
/// The bin of what is unknown.
const UNKNOWN: u16 = u16::MAX;

/// Vertices of each pair by bin.
#[derive(Default)]
pub(crate) struct Sigmas(BTreeMap<(Pair, u16), u64>);

impl Sigmas {
    /// Counts the vertices that the window owns.
    pub(crate) fn add(&mut self, window: &Window<'_>, tables: &Tables) {
        let sigmas = window.sigmas();
        if sigmas.is_empty() {
            return;
        }
        let count = |mut all: Self, v: usize| {
            let bin = if sigmas[v] >= 0.0 { (sigmas[v].abs().to_bits() >> SHIFT) as u16 } else { UNKNOWN };
            let pair = |t: &u32| window.pairs()[*t as usize];
            let around = tables.vertices.triangles(v);
            for (i, t) in around.iter().enumerate() {
                if !around[..i].iter().any(|u| pair(u) == pair(t)) {
                    *all.0.entry((pair(t), bin)).or_default() += 1;
                }
            }
            all
        };
        let own = window.own_vertices().into_par_iter().with_min_len(1 << 12);
        let counted = own.fold(Self::default, count).reduce(Self::default, Self::join);
        *self = std::mem::take(self).join(counted);
    }

    fn join(mut self, other: Self) -> Self {
        for (bin, count) in other.0 {
            *self.0.entry(bin).or_default() += count;
        }
        self
    }

    /// Of a pair; `None` if none is known.
    pub(crate) fn of(&self, pair: Pair) -> Option<SigmaMeasure> {
        let bins = || self.0.range((pair, 0)..(pair, UNKNOWN)).map(|((_, bin), count)| (*bin, *count));
        let known: u64 = bins().map(|(_, count)| count).sum();
        let quantile = |percent: u64| {
            let mut below = 0;
            let bin = bins().find(|(_, count)| {
                below += count;
                100 * below >= percent * known
            });
            // The middle of the bin.
            bin.map(|(bin, _)| match bin {
                0 => 0.0,
                _ => f64::from(f32::from_bits(u32::from(bin) << SHIFT | 1 << (SHIFT - 1))),
            })
        };
        let unknown = self.0.get(&(pair, UNKNOWN)).copied().unwrap_or(0);
        let (median, percent_95) = (quantile(50)?, quantile(95)?);
        Some(SigmaMeasure { known, unknown, median, percent_95 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::{pair, voxel_faces};

    #[test]
    fn quantiles_are_those_of_the_vertices_of_each_pair() {
        let mesh = voxel_faces([30, 2, 1], &[[1; 30], [2; 30]].concat(), 0);
        let n = mesh.positions().len();
        let sigmas: Vec<f32> = mesh.positions().iter().map(|p| 0.01 + 0.001 * p.x as f32).collect();
        let of = |sigmas: Vec<f32>, pair| {
            let mesh = mesh.clone().with_sigmas(sigmas).unwrap();
            let window = Window::whole(&mesh);
            let mut all = Sigmas::default();
            all.add(&window, &Tables::new(&window));
            all.of(pair)
        };
        // 31 columns of two vertices between the two; all columns have as many.
        let between = of(sigmas.clone(), pair(1, 2)).unwrap();
        assert_eq!((between.known, between.unknown), (62, 0));
        assert!(
            (between.median / 0.025 - 1.0).abs() < 0.01 && (between.percent_95 / 0.039 - 1.0).abs() < 0.01
        );
        let mut half = sigmas;
        half[..n / 2].fill(f32::NAN);
        let some = of(half, pair(1, 0)).unwrap();
        assert!(some.known > 0 && some.unknown > 0);
        assert_eq!(of(vec![f32::NAN; n], pair(1, 0)), None);
        assert_eq!(of(vec![0.0; n], pair(1, 0)).map(|s| (s.median, s.percent_95)), Some((0.0, 0.0)));
        assert_eq!(of(Vec::new(), pair(1, 0)), None);
    }
}
