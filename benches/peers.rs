//! Our side of the comparison with other programs; `benches/peers/run.py` runs both sides in turn.
//!
//! `write DIR` makes the volume and its labels; `label-to-mesh`, `pipeline` and `isosurface`, each with
//! `DIR RUNS`, do that job in memory and print a line of `key=value` for each run. `RAYON_NUM_THREADS` sets
//! the threads. Reading the files is not timed.

#![allow(clippy::print_stdout)] // a benchmark's output is its purpose

use std::error::Error;
use std::fs;
use std::path::Path;

use interfacet::classify::LabelVolume;
use interfacet::contour::marching::march;
use interfacet::contour::{Border, Midpoints, Patch, isosurface};
use interfacet::execution::{Execution, peak_memory};
use interfacet::volume::Slab;
use scene::{Clock, ENGINE, Scene};

mod scene;

/// Grey value of the isosurface: between air and the lightest solid.
const LEVEL: f32 = 7800.0;

fn main() -> Result<(), Box<dyn Error>> {
    // Cargo adds `--bench`.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let [job, dir, rest @ ..] = &words[..] else {
        println!("arguments: write DIR [X Y Z], or label-to-mesh, pipeline or isosurface DIR [RUNS]");
        return Ok(());
    };
    let numbers = rest.iter().map(|n| n.parse()).collect::<Result<Vec<usize>, _>>()?;
    let (dir, runs) = (Path::new(dir), numbers.first().copied().unwrap_or(1));
    if *job == "write" {
        let size = numbers.first_chunk().copied().unwrap_or(ENGINE);
        return write(dir, size);
    }
    let size: Vec<usize> = fs::read_to_string(dir.join("size.txt"))?
        .split_whitespace()
        .map(str::parse)
        .collect::<Result<_, _>>()?;
    let size = size.first_chunk().copied().ok_or("size.txt needs three numbers")?;
    let execution = Execution::default();
    match *job {
        "label-to-mesh" => {
            let labels = fs::read(dir.join("labels.raw"))?;
            repeat(job, runs, || {
                let mut clock = Clock::start();
                let (volume, _) = LabelVolume::from_labels(&labels, size)?;
                let packing = clock.lap();
                let patch = march(&volume, &Midpoints, Border::Closed, &execution)?;
                Ok((packing + clock.lap(), patch, format!(" packing={packing:.4}")))
            })
        }
        "pipeline" => {
            let scene = Scene { size, samples: greys(dir)?, table: Scene::new([1; 3], 3)?.table };
            repeat(job, runs, || {
                let (laps, outcome) = scene.run()?;
                Ok((laps[6], outcome.patch, format!(" contour={:.4}", laps[5])))
            })
        }
        "isosurface" => {
            let samples = greys(dir)?;
            repeat(job, runs, || {
                let mut clock = Clock::start();
                let patch = isosurface(Slab::whole(&samples, size), LEVEL, Border::Open, &execution)?;
                Ok((clock.lap(), patch, String::new()))
            })
        }
        _ => Err(format!("there is no job '{job}'").into()),
    }
}

fn repeat(
    job: &str,
    runs: usize,
    mut work: impl FnMut() -> Result<(f64, Patch, String), Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    for _ in 0..runs {
        let before = processor_seconds();
        let (seconds, patch, more) = work()?;
        let processor = processor_seconds() - before;
        let (triangles, vertices) = (patch.triangles.len(), patch.positions.len());
        let (threads, peak) = (rayon::current_num_threads(), peak_memory().unwrap_or(0));
        println!(
            "who=interfacet job={job} threads={threads} seconds={seconds:.4} cpu={processor:.2} triangles={triangles} vertices={vertices} peak={peak}{more}"
        );
    }
    Ok(())
}

/// Processor time of this process so far, all threads together; zero where the system does not say.
fn processor_seconds() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // User and system time, in hundredths of a second, are the 12th and 13th word behind the name.
    let words = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    words.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// Writes the grey values (u16, little endian), the labels that our pipeline gives (u8), and the size.
fn write(dir: &Path, size: [usize; 3]) -> Result<(), Box<dyn Error>> {
    let scene = Scene::new(size, 3)?;
    let (_, outcome) = scene.run()?;
    let mut labels = Vec::with_capacity(scene.samples.len());
    for z in 1..=size[2] {
        for y in 1..=size[1] {
            labels.extend((1..=size[0]).map(|x| outcome.labels.at([x, y, z]).0));
        }
    }
    fs::create_dir_all(dir)?;
    fs::write(dir.join("labels.raw"), labels)?;
    fs::write(dir.join("grey.raw"), scene.samples.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())?;
    let [x, y, z] = size;
    fs::write(dir.join("size.txt"), format!("{x} {y} {z}\n"))?;
    Ok(())
}

fn greys(dir: &Path) -> Result<Vec<u16>, Box<dyn Error>> {
    let bytes = fs::read(dir.join("grey.raw"))?;
    Ok(bytes.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect())
}
