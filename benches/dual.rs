//! Adaptive dual contouring beside marching on the synthetic assembly.
//!
//! `cargo bench --bench dual` runs the 500 x 700 x 231 voxels of `benches/assembly.rs` at tolerance 0.1;
//! `cargo bench --bench dual -- growth` runs an eighth of it, all of it and twice as much. Prints medians of
//! the stages, the ratio to marching, and the memory that the surface took.

#![allow(clippy::print_stdout)] // a benchmark's output is its purpose

use std::error::Error;

use interfacet::contour::dual::{Bound, Builder, DualOptions};
use interfacet::contour::hermite::{GreyHermite, Qualities};
use interfacet::contour::{Border, NormalRule, Thresholds};
use interfacet::execution::{Execution, peak_memory};
use interfacet::grid::Geometry;
use scene::{Clock, ENGINE, Scene, median};

mod scene;

fn main() -> Result<(), Box<dyn Error>> {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    if std::env::args().any(|a| a == "growth") {
        let [x, y, z] = ENGINE;
        for size in [[x / 2, y / 2, z / 2], ENGINE, [x, y, 2 * z]] {
            measure(size, 3)?;
        }
        return Ok(());
    }
    match numbers[..] {
        [x, y, z, runs, ..] => measure([x, y, z], runs.max(1)),
        [x, y, z] => measure([x, y, z], 3),
        _ => measure(ENGINE, 3),
    }
}

fn measure(size: [usize; 3], runs: usize) -> Result<(), Box<dyn Error>> {
    let scene = Scene::new(size, 3)?;
    let spacing = [0.4, 0.4, 0.5];
    let geometry = Geometry::axis_aligned(size, spacing)?;
    let execution = Execution::default();
    let options = DualOptions { bound: Bound::Rms(0.1), deviation: false, ..DualOptions::default() };
    let (mut marching, mut together, mut dual) = (Vec::new(), Vec::new(), Vec::new());
    let mut stages: Vec<(String, Vec<f64>)> = Vec::new();
    let mut last = None;
    for _ in 0..runs {
        let (laps, outcome) = scene.run()?;
        marching.push(laps[5]);
        together.push(laps[6]);
        let before = outcome.patch.triangles.len();
        drop(outcome.patch);
        let memory = peak_memory();
        let mut clock = Clock::start();
        let qualities = Qualities::new(&scene.table, Some(1.1));
        let rule = Thresholds::new(scene.slab(), &outcome.undecided, &scene.table);
        let rule =
            GreyHermite::new(rule, scene.slab(), &outcome.labels, spacing, NormalRule::Auto, &qualities);
        let mut builder = Builder::new(&geometry);
        builder.add(&outcome.labels, &rule, 0..size[2] + 1, &execution, &execution.stage("", 0))?;
        let first = clock.lap();
        let surface = builder.finish(&geometry, &options, Border::Closed, &execution)?;
        dual.push(first + clock.lap());
        let add = |stages: &mut Vec<(String, Vec<f64>)>, name: &str, seconds: f64| match stages
            .iter_mut()
            .find(|s| s.0 == name)
        {
            Some(stage) => stage.1.push(seconds),
            None => stages.push((name.to_owned(), vec![seconds])),
        };
        add(&mut stages, "cells and normals", first);
        surface.costs.stages.iter().for_each(|s| add(&mut stages, &s.stage, s.seconds));
        last = Some((surface.triangles.len(), before, memory, peak_memory()));
    }
    let Some((triangles, before, memory, peak)) = last else { return Ok(()) };
    println!("{size:?} u16, {} threads, medians of {runs} runs", rayon::current_num_threads());
    println!("{before} triangles marching, {triangles} dual at tolerance 0.1");
    for (name, seconds) in &stages {
        println!("  {name:<20}{:8.3} s", median(seconds.iter().copied()));
    }
    let (marching, together, dual) = (median(marching), median(together), median(dual));
    println!("contouring: marching {marching:.3} s, dual {dual:.3} s: {:.2} times", dual / marching);
    println!(
        "classification and contouring: marching {together:.3} s, dual {:.3} s: {:.2} times",
        together - marching + dual,
        (together - marching + dual) / together
    );
    if let (Some(memory), Some(peak)) = (memory, peak) {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        println!("peak memory {:.0} MiB, {:.0} before dual contouring", mib(peak), mib(memory));
    }
    println!();
    Ok(())
}
