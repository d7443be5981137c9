//! Time and memory of the main job on a synthetic assembly, stage by stage.
//!
//! `cargo bench --bench assembly` runs the 500 x 700 x 231 voxels of Fujimori and Suzuki's engine
//! head (about ten million triangles); `cargo bench --bench assembly -- 250 350 116 5` another size
//! and number of runs. Prints the median of each stage over the runs, and the process's peak memory.

#![allow(clippy::print_stdout)] // a benchmark's output is its purpose

use std::error::Error;
use std::f32::consts::TAU;
use std::time::Instant;

use interfacet::classify::{Classification, classify};
use interfacet::contour::marching::march;
use interfacet::contour::{Border, Thresholds};
use interfacet::execution::{Execution, peak_memory};
use interfacet::grid::Geometry;
use interfacet::material::{MaterialTable, estimate_blur, find_materials};
use interfacet::mesh::{InterfaceMesh, MeshMaterial};
use rayon::prelude::*;

/// Air, aluminium and iron separated by two gyroids: interfaces of all three pairs, curved every
/// way, and junction curves everywhere; blurred by about 1.2 voxels, with 1 % noise.
fn assembly(size: [usize; 3]) -> Vec<u16> {
    const PERIODS: [f32; 2] = [112.0, 171.0];
    const SIGMA: f32 = 1.2;
    let [nx, ny, nz] = size;
    let waves = |n: usize, period: f32| -> Vec<(f32, f32)> {
        (0..n).map(|i| (TAU * i as f32 / period).sin_cos()).collect()
    };
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
            let noise = ((i * 31 + z * 7919).wrapping_mul(2_654_435_761) >> 9 & 255) as f32 - 127.5;
            let solid = step(distance(0));
            let grey = 4000.0 + solid * (7600.0 + 28400.0 * step(distance(1)));
            *value = (grey + noise) as u16;
        }
    });
    out
}

fn main() -> Result<(), Box<dyn Error>> {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let (size, runs) = match numbers[..] {
        [x, y, z] => ([x, y, z], 3),
        [x, y, z, runs, ..] => ([x, y, z], runs),
        _ => ([500, 700, 231], 3),
    };
    let samples = assembly(size);
    let geometry = Geometry::axis_aligned(size, [0.4, 0.4, 0.5])?;
    let voxels = samples.len();
    let input = 2 * voxels;
    let execution = Execution::default();
    let table = MaterialTable::new([("air", 4000.0), ("aluminium", 11600.0), ("iron", 40000.0)])?;
    let before = peak_memory();
    let mut times: Vec<[f64; 3]> = Vec::new();
    let (mut triangles, mut vertices, mut counts) = (0, 0, None);
    for _ in 0..runs.max(1) {
        let start = Instant::now();
        let Classification { labels, junction, counts: c } =
            classify(&samples, size, &table, [3.0, 3.0, 2.4], &execution)?;
        let classified = start.elapsed().as_secs_f64();
        let rule = Thresholds::new(&samples, size, &junction, &table);
        let start = Instant::now();
        let patch = march(&labels, &rule, Border::Closed, &execution)?;
        let contoured = start.elapsed().as_secs_f64();
        (triangles, vertices, counts) = (patch.triangles.len(), patch.positions.len(), Some(c));
        times.push([classified, contoured, classified + contoured]);
    }
    let median = |k: usize| {
        let mut column: Vec<f64> = times.iter().map(|t| t[k]).collect();
        column.sort_by(f64::total_cmp);
        column[column.len() / 2]
    };
    println!("{size:?} u16, {} threads, {} runs, medians", rayon::current_num_threads(), times.len());
    println!("{triangles} triangles, {vertices} vertices; {:?}", counts);
    println!("classify and thin   {:8.3} s", median(0));
    println!("contour             {:8.3} s", median(1));
    println!("together            {:8.3} s", median(2));
    if let (Some(before), Some(peak)) = (before, peak_memory()) {
        let mesh = vertices * 13 + triangles * 14;
        let beyond = (peak - before.max(input as u64)) as f64;
        println!(
            "peak memory         {:8.1} MiB, input {:.1} MiB, mesh {:.1} MiB",
            mib(peak as f64),
            mib(input as f64),
            mib(mesh as f64)
        );
        println!("beyond input + mesh {:8.2} bytes per voxel", (beyond - mesh as f64) / voxels as f64);
    }
    let start = Instant::now();
    let found = find_materials(&samples, size, None)?;
    println!(
        "find materials      {:8.3} s: {:?}",
        start.elapsed().as_secs_f64(),
        found.table.materials().iter().map(|m| m.mean).collect::<Vec<_>>()
    );
    let start = Instant::now();
    let blur = estimate_blur(&samples, &geometry, &found.table);
    println!("estimate blur       {:8.3} s: {:?}", start.elapsed().as_secs_f64(), blur.radius);
    let Classification { labels, junction, .. } =
        classify(&samples, size, &table, [3.0, 3.0, 2.4], &execution)?;
    let rule = Thresholds::new(&samples, size, &junction, &table);
    let patch = march(&labels, &rule, Border::Closed, &execution)?;
    let start = Instant::now();
    let mesh = InterfaceMesh::from_patch(patch, &geometry, MeshMaterial::from_table(&table))?;
    println!(
        "to the world        {:8.3} s, {} triangles",
        start.elapsed().as_secs_f64(),
        mesh.triangles().len()
    );
    Ok(())
}

fn mib(bytes: f64) -> f64 {
    bytes / (1 << 20) as f64
}
