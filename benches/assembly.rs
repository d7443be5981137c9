//! Time and memory of the main job on a synthetic assembly, stage by stage.
//!
//! `cargo bench --bench assembly` runs the 500 x 700 x 231 voxels of Fujimori and Suzuki's engine
//! head (about ten million triangles); `cargo bench --bench assembly -- 250 350 116 5` another size
//! and number of runs. `RAYON_NUM_THREADS` sets the threads. Prints the median of each stage over
//! the runs, and the process's peak memory.
//!
//! `cargo bench --bench assembly -- costs 3` prints tables instead: cost against volume, number of
//! materials and threads, medians of 3 runs.

#![allow(clippy::print_stdout)] // a benchmark's output is its purpose

use std::error::Error;

use interfacet::execution::peak_memory;
use interfacet::grid::Geometry;
use interfacet::material::{ScanQuality, find_materials};
use interfacet::mesh::{InterfaceMesh, MeshMaterial};
use rayon::ThreadPoolBuilder;
use scene::{Clock, ENGINE, STAGES, Scene, median};

mod scene;

fn main() -> Result<(), Box<dyn Error>> {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    if std::env::args().any(|a| a == "costs") {
        return costs(numbers.first().copied().unwrap_or(3).max(1));
    }
    let (size, runs) = match numbers[..] {
        [x, y, z] => ([x, y, z], 3),
        [x, y, z, runs, ..] => ([x, y, z], runs.max(1)),
        _ => (ENGINE, 5),
    };
    let scene = Scene::new(size, 3)?;
    let geometry = Geometry::axis_aligned(size, [0.4, 0.4, 0.5])?;
    let before = peak_memory();
    let mut times = Vec::new();
    let mut last = None;
    for _ in 0..runs {
        drop(last.take());
        let (laps, outcome) = scene.run()?;
        times.push(laps);
        last = Some((outcome.patch, outcome.undecided.counts()[0], outcome.rounds));
    }
    let peak = peak_memory();
    let Some((patch, undecided, rounds)) = last else { return Ok(()) };

    let (triangles, vertices) = (patch.triangles.len(), patch.positions.len());
    println!("{size:?} u16, {} threads, medians of {runs} runs", rayon::current_num_threads());
    println!(
        "{triangles} triangles, {vertices} vertices, {undecided} junction voxels, {rounds} rounds of thinning"
    );
    for (k, stage) in STAGES.iter().enumerate() {
        println!("{stage:<20}{:8.3} s", median(times.iter().map(|t| t[k])));
    }
    if let (Some(before), Some(peak)) = (before, peak) {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        let mesh = (vertices * 13 + triangles * 14) as u64;
        let per_voxel = peak.saturating_sub(before + mesh) as f64 / scene.samples.len() as f64;
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
    let found = find_materials(scene.slab(), None)?;
    let means: Vec<f64> = found.table.materials().iter().map(|m| m.mean).collect();
    println!("find materials      {:8.3} s: {means:.0?}", clock.lap());
    let blur = ScanQuality::of(scene.slab(), &geometry, &found.table).blur;
    println!("estimate blur       {:8.3} s: R {:.2?}", clock.lap(), blur.radius);
    let mesh = InterfaceMesh::from_patch(patch, &geometry, MeshMaterial::from_table(&scene.table))?;
    println!("to the world        {:8.3} s: {} triangles", clock.lap(), mesh.triangles().len());
    Ok(())
}

/// Cost against volume, number of materials and threads.
fn costs(runs: usize) -> Result<(), Box<dyn Error>> {
    let [x, y, z] = ENGINE;
    let all = rayon::current_num_threads();
    let volumes = [[x / 2, y / 2, z / 2], ENGINE, [x, y, 2 * z], [2 * x, y, 2 * z]];
    println!("seconds, medians of {runs} runs\n");
    println!("| voxels | materials | threads | triangles | {} |", STAGES.join(" | "));
    println!("|{}", "---|".repeat(4 + STAGES.len()));
    for size in volumes {
        row(size, 3, all, runs)?;
    }
    for materials in [2, 3, 5, 8] {
        row(ENGINE, materials, all, runs)?;
    }
    for threads in [1, 2, 4, 8, 16, 32, 64].into_iter().filter(|&n| n <= all) {
        row(ENGINE, 3, threads, runs)?;
    }
    Ok(())
}

fn row(size: [usize; 3], materials: usize, threads: usize, runs: usize) -> Result<(), Box<dyn Error>> {
    let scene = Scene::new(size, materials)?;
    let pool = ThreadPoolBuilder::new().num_threads(threads).build()?;
    let mut times = Vec::new();
    let mut triangles = 0;
    for _ in 0..runs {
        // Errors cross threads as text.
        let (laps, outcome) = pool.install(|| scene.run().map_err(|e| e.to_string()))?;
        triangles = outcome.patch.triangles.len();
        times.push(laps);
    }
    let columns = (0..STAGES.len()).map(|k| format!("{:.3}", median(times.iter().map(|t| t[k]))));
    let [x, y, z] = size;
    println!(
        "| {x} x {y} x {z} | {materials} | {threads} | {triangles} | {} |",
        columns.collect::<Vec<_>>().join(" | ")
    );
    Ok(())
}
