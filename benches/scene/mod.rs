//! The synthetic assembly that the benchmarks share, and the main job on it, timed stage by stage.

#![allow(dead_code)] // each benchmark uses its part

use std::error::Error;
use std::f32::consts::TAU;
use std::ops::Range;
use std::time::Instant;

use interfacet::classify::{Ball, BitPlanes, LabelVolume, alpha, core, junction, pair, thin};
use interfacet::contour::marching::march;
use interfacet::contour::{Border, Patch, Thresholds};
use interfacet::execution::Execution;
use interfacet::material::MaterialTable;
use interfacet::volume::Slab;
use rayon::prelude::*;

/// Voxels of Fujimori and Suzuki's engine head.
pub(crate) const ENGINE: [usize; 3] = [500, 700, 231];
/// R in voxels per axis.
pub(crate) const RADIUS: [f64; 3] = [3.0, 3.0, 2.4];
/// The stages of the main job, and their sum.
pub(crate) const STAGES: [&str; 7] = ["alpha", "core", "pair", "thin", "labels", "contour", "together"];

/// Grey value of air, and of the least and the most dense solid.
const GREYS: [f32; 3] = [4000.0, 11600.0, 40000.0];

/// A volume to be measured on.
pub(crate) struct Scene {
    pub(crate) size: [usize; 3],
    pub(crate) samples: Vec<u16>,
    pub(crate) table: MaterialTable,
}

impl Scene {
    /// Air and `materials` - 1 solids separated by gyroids: interfaces curved every way, and junction
    /// curves everywhere; blurred by about 1.2 voxels, with 1 % noise. The solid at a voxel is given by
    /// how many of `materials` - 2 gyroids it lies inside.
    pub(crate) fn new(size: [usize; 3], materials: usize) -> Result<Self, Box<dyn Error>> {
        let solids = materials.saturating_sub(2);
        let grey = |k: usize| match solids {
            0 => GREYS[2],
            n => GREYS[1] + (GREYS[2] - GREYS[1]) * k as f32 / n as f32,
        };
        let means = (0..=solids).map(|k| (format!("solid{k}"), f64::from(grey(k))));
        let table = MaterialTable::new([("air".to_owned(), f64::from(GREYS[0]))].into_iter().chain(means))?;
        Ok(Self { size, samples: Gyroids::new(size, solids, 1.0).slices(0..size[2]), table })
    }

    pub(crate) fn slab(&self) -> Slab<'_, u16> {
        Slab::whole(&self.samples, self.size)
    }

    /// The main job. Returns seconds per stage and what came out.
    pub(crate) fn run(&self) -> Result<([f64; 7], Outcome), Box<dyn Error>> {
        let (slab, table, execution) = (self.slab(), &self.table, Execution::default());
        let mut clock = Clock::start();
        let mut laps = [0.0; 7];
        let planes = alpha(slab, table, 1..self.size[2] + 1);
        laps[0] = clock.lap();
        let certain = core(&planes, &Ball::new(RADIUS), planes.slices());
        laps[1] = clock.lap();
        let twice = Ball::new(RADIUS.map(|r| 2.0 * r));
        let mut b = pair(slab, &certain, &planes, &twice, table, planes.slices());
        drop((planes, certain));
        laps[2] = clock.lap();
        let undecided = junction(&b);
        let rounds = thin(slab, &mut b, &undecided, table, RADIUS, &execution)?.rounds;
        laps[3] = clock.lap();
        let labels = LabelVolume::from_planes(&b);
        drop(b);
        laps[4] = clock.lap();
        let patch = march(&labels, &Thresholds::new(slab, &undecided, table), Border::Closed, &execution)?;
        laps[5] = clock.lap();
        laps[6] = laps.iter().sum();
        Ok((laps, Outcome { patch, labels, undecided, rounds }))
    }
}

/// What the main job leaves.
pub(crate) struct Outcome {
    pub(crate) patch: Patch,
    pub(crate) labels: LabelVolume,
    pub(crate) undecided: BitPlanes,
    /// Rounds of thinning.
    pub(crate) rounds: usize,
}

/// The grey values of a volume cut up by gyroids, any slices of it.
pub(crate) struct Gyroids {
    size: [usize; 3],
    periods: Vec<f32>,
    /// For each gyroid and axis, sine and cosine at every voxel.
    tables: Vec<[Vec<(f32, f32)>; 3]>,
}

impl Gyroids {
    /// `solids` + 1 gyroids with periods of about a hundred voxels times `scale`.
    pub(crate) fn new(size: [usize; 3], solids: usize, scale: f32) -> Self {
        const PERIODS: [f32; 7] = [112.0, 171.0, 139.0, 97.0, 151.0, 127.0, 109.0];
        let waves = |n: usize, p: f32| -> Vec<(f32, f32)> {
            (0..n).map(|i| (TAU * i as f32 / p).sin_cos()).collect()
        };
        let periods: Vec<f32> =
            PERIODS[..(solids + 1).min(PERIODS.len())].iter().map(|p| p * scale).collect();
        let tables = periods.iter().map(|&p| size.map(|n| waves(n, p))).collect();
        Self { size, periods, tables }
    }

    /// The samples of some slices.
    pub(crate) fn slices(&self, slices: Range<usize>) -> Vec<u16> {
        const SIGMA: f32 = 1.2;
        let [nx, ny, _] = self.size;
        let step = |d: f32| 1.0 / (1.0 + (-1.702 * d / SIGMA).exp());
        let mut out = vec![0u16; nx * ny * slices.len()];
        out.par_chunks_mut(nx * ny).zip(slices).for_each(|(slice, z)| {
            for (i, value) in slice.iter_mut().enumerate() {
                let (x, y) = (i % nx, i / nx);
                let inside = |k: usize| {
                    let [tx, ty, tz] = &self.tables[k];
                    let ((sx, cx), (sy, cy), (sz, cz)) = (tx[x], ty[y], tz[z]);
                    step((sx * cy + sy * cz + sz * cx) * self.periods[k] / (TAU * 1.2))
                };
                let share = match self.periods.len() {
                    1 => 1.0,
                    n => (1..n).map(inside).sum::<f32>() / (n - 1) as f32,
                };
                let noise = (((i * 31 + z * 7919).wrapping_mul(2_654_435_761) >> 9) & 255) as f32 - 127.5;
                let solid = GREYS[1] - GREYS[0] + (GREYS[2] - GREYS[1]) * share;
                *value = (GREYS[0] + inside(0) * solid + noise) as u16;
            }
        });
        out
    }
}

/// The middle of some measurements.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Times one stage after the other.
pub(crate) struct Clock(Instant);

impl Clock {
    pub(crate) fn start() -> Self {
        Self(Instant::now())
    }

    /// Seconds since the last lap.
    pub(crate) fn lap(&mut self) -> f64 {
        let now = Instant::now();
        let seconds = now.duration_since(self.0).as_secs_f64();
        self.0 = now;
        seconds
    }
}
