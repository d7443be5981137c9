//! Time and memory of the main job on a synthetic assembly, stage by stage.
//!
//! `cargo bench --bench assembly` runs the 500 x 700 x 231 voxels of Fujimori and Suzuki's engine
//! head (about ten million triangles); `cargo bench --bench assembly -- 250 350 116 5` another size
//! and number of runs. `RAYON_NUM_THREADS` sets the threads. Prints the median of each stage over
//! the runs, and the process's peak memory.

#![allow(clippy::print_stdout)] // a benchmark's output is its purpose

use std::error::Error;
use std::f32::consts::TAU;
use std::time::Instant;

use interfacet::classify::{Ball, LabelVolume, alpha, core, junction, pair, thin};
use interfacet::contour::marching::march;
use interfacet::contour::{Border, Thresholds};
use interfacet::execution::{Execution, peak_memory};
use interfacet::grid::Geometry;
use interfacet::material::{MaterialTable, estimate_blur, find_materials};
use interfacet::mesh::{InterfaceMesh, MeshMaterial};
use interfacet::volume::Slab;
use rayon::prelude::*;

/// R in voxels per axis.
const RADIUS: [f64; 3] = [3.0, 3.0, 2.4];
const STAGES: [&str; 7] = ["alpha", "core", "pair", "thin", "labels", "contour", "together"];

/// Air, aluminium and iron separated by two gyroids: interfaces of all three pairs, curved every
/// way, and junction curves everywhere; blurred by about 1.2 voxels, with 1 % noise.
fn assembly(size: [usize; 3]) -> Vec<u16> {
    const PERIODS: [f32; 2] = [112.0, 171.0];
    const SIGMA: f32 = 1.2;
    let [nx, ny, nz] = size;
    let waves =
        |n: usize, p: f32| -> Vec<(f32, f32)> { (0..n).map(|i| (TAU * i as f32 / p).sin_cos()).collect() };
    let tables: Vec<[Vec<(f32, f32)>; 3]> =
        PERIODS.iter().map(|&p| [nx, ny, nz].map(|n| waves(n, p))).collect();
    let step = |d: f32| 1.0 / (1.0 + (-1.702 * d / SIGMA).exp());
    let mut out = vec![0u16; nx * ny * nz];
    out.par_chunks_mut(nx * ny).enumerate().for_each(|(z, slice)| {
        for (i, value) in slice.iter_mut().enumerate() {
            let (x, y) = (i % nx, i / nx);
            let distance = |k: usize| {
                let [tx, ty, tz] = &tables[k];
                let ((sx, cx), (sy, cy), (sz, cz)) = (tx[x], ty[y], tz[z]);
                (sx * cy + sy * cz + sz * cx) * PERIODS[k] / (TAU * 1.2)
            };
            let noise = (((i * 31 + z * 7919).wrapping_mul(2_654_435_761) >> 9) & 255) as f32 - 127.5;
            let grey = 4000.0 + step(distance(0)) * (7600.0 + 28400.0 * step(distance(1)));
            *value = (grey + noise) as u16;
        }
    });
    out
}

fn main() -> Result<(), Box<dyn Error>> {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let (size, runs) = match numbers[..] {
        [x, y, z] => ([x, y, z], 3),
        [x, y, z, runs, ..] => ([x, y, z], runs.max(1)),
        _ => ([500, 700, 231], 5),
    };
    let samples = assembly(size);
    let geometry = Geometry::axis_aligned(size, [0.4, 0.4, 0.5])?;
    let execution = Execution::default();
    let table = MaterialTable::new([("air", 4000.0), ("aluminium", 11600.0), ("iron", 40000.0)])?;
    let slab = Slab::whole(&samples, size);
    let before = peak_memory();

    let mut times: Vec<[f64; 7]> = Vec::new();
    let mut last = None;
    for _ in 0..runs {
        drop(last.take());
        let mut clock = Clock::start();
        let mut laps = [0.0; 7];
        let planes = alpha(slab, &table, 1..size[2] + 1);
        laps[0] = clock.lap();
        let certain = core(&planes, &Ball::new(RADIUS), planes.slices());
        laps[1] = clock.lap();
        let twice = Ball::new(RADIUS.map(|r| 2.0 * r));
        let mut b = pair(slab, &certain, &planes, &twice, &table, planes.slices());
        drop((planes, certain));
        laps[2] = clock.lap();
        let undecided = junction(&b);
        let thinned = thin(slab, &mut b, &undecided, &table, RADIUS, &execution)?;
        laps[3] = clock.lap();
        let labels = LabelVolume::from_planes(&b);
        drop(b);
        laps[4] = clock.lap();
        let rule = Thresholds::new(slab, &undecided, &table);
        let patch = march(&labels, &rule, Border::Closed, &execution)?;
        laps[5] = clock.lap();
        laps[6] = laps.iter().sum();
        times.push(laps);
        last = Some((patch, undecided.counts()[0], thinned.rounds));
    }
    let peak = peak_memory();
    let Some((patch, undecided, rounds)) = last else { return Ok(()) };

    let (triangles, vertices) = (patch.triangles.len(), patch.positions.len());
    println!("{size:?} u16, {} threads, medians of {runs} runs", rayon::current_num_threads());
    println!(
        "{triangles} triangles, {vertices} vertices, {undecided} junction voxels, {rounds} rounds of thinning"
    );
    for (k, stage) in STAGES.iter().enumerate() {
        let mut column: Vec<f64> = times.iter().map(|t| t[k]).collect();
        column.sort_by(f64::total_cmp);
        println!("{stage:<20}{:8.3} s", column[column.len() / 2]);
    }
    if let (Some(before), Some(peak)) = (before, peak) {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        let mesh = (vertices * 13 + triangles * 14) as u64;
        let per_voxel = peak.saturating_sub(before + mesh) as f64 / samples.len() as f64;
        println!(
            "peak memory         {:8.1} MiB: input {:.1}, mesh {:.1}",
            mib(peak),
            mib(before),
            mib(mesh)
        );
        println!("beyond input + mesh {per_voxel:8.2} bytes per voxel");
    }

    println!("\nbefore and after that, once:");
    let mut clock = Clock::start();
    let found = find_materials(slab, None)?;
    let means: Vec<f64> = found.table.materials().iter().map(|m| m.mean).collect();
    println!("find materials      {:8.3} s: {means:.0?}", clock.lap());
    let blur = estimate_blur(slab, &geometry, &found.table);
    println!("estimate blur       {:8.3} s: R {:.2?}", clock.lap(), blur.radius);
    let mesh = InterfaceMesh::from_patch(patch, &geometry, MeshMaterial::from_table(&table))?;
    println!("to the world        {:8.3} s: {} triangles", clock.lap(), mesh.triangles().len());
    Ok(())
}

/// Times one stage after the other.
struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Self(Instant::now())
    }

    /// Seconds since the last lap.
    fn lap(&mut self) -> f64 {
        let now = Instant::now();
        let seconds = now.duration_since(self.0).as_secs_f64();
        self.0 = now;
        seconds
    }
}
