//! A volume larger than the memory allowed, and how memory grows with the number of slices.
//!
//! `cargo bench --bench large` makes synthetic u16 volumes of 1024 x 1024 x (256, 512, 1024) voxels slab by
//! slab (up to 2 GiB, in a temporary folder under `target/`), extracts each with `--memory 1GiB`, and prints the time and
//! the peak memory of the process. `cargo bench --bench large -- 512 700 128 256` takes slices of 512 x 512, a budget of
//! 700 MiB, and these numbers of slices; `--check topology` leaves out self-intersections.

#![allow(clippy::print_stdout)] // a benchmark's output is its purpose

use std::error::Error;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use scene::Gyroids;

mod scene;

/// Larger than in the other benchmarks, as parts are in large scans: 48 million triangles in 1024³.
const SCALE: f32 = 4.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let topology = arguments.iter().any(|a| a == "topology");
    let numbers: Vec<usize> = arguments.iter().filter_map(|a| a.parse().ok()).collect();
    let (side, mib, depths) = match &numbers[..] {
        [side, mib, depths @ ..] if !depths.is_empty() => (*side, *mib, depths.to_vec()),
        _ => (1024, 1024, vec![256, 512, 1024]),
    };
    let program = Path::new(env!("CARGO_BIN_EXE_interfacet"));
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR"))?;
    println!(
        "{side} x {side} slices of u16, --memory {mib}MiB, check {}",
        if topology { "topology" } else { "full" }
    );
    println!(
        "| slices | input MiB | triangles | assembly.ply MiB | s | peak MiB |\n|---|---|---|---|---|---|"
    );
    for depth in depths {
        let (input, out) = (folder.path().join("large.raw"), folder.path().join("out"));
        generate(&input, [side, side, depth])?;
        let started = Instant::now();
        let status = Command::new(program)
            .args(["extract", "-q", "--type", "u16", "--spacing", "0.1", "--names", "air,aluminium,iron"])
            .args(["--accuracy", "paper", "--check", if topology { "topology" } else { "full" }])
            .arg(format!("--size={side},{side},{depth}"))
            .arg(format!("--memory={mib}MiB"))
            .arg("--out")
            .args([&out, &input])
            .status()?;
        let seconds = started.elapsed().as_secs_f64();
        if !status.success() {
            return Err(format!("extract failed on {depth} slices").into());
        }
        let report: serde_json::Value = serde_json::from_reader(File::open(out.join("report.json"))?)?;
        let stages = report["costs"].as_array().ok_or("a report has costs")?;
        let peak = stages.iter().filter_map(|s| s["peak_memory"].as_u64()).max().unwrap_or(0);
        let mib = |bytes: u64| bytes >> 20;
        println!(
            "| {depth} | {} | {} | {} | {seconds:.1} | {} |",
            mib(2 * (side * side * depth) as u64),
            report["triangles"],
            mib(out.join("assembly.ply").metadata()?.len()),
            mib(peak)
        );
        for stage in stages {
            println!(
                "  {} {:.1} s, peak {} MiB",
                stage["stage"],
                stage["seconds"].as_f64().unwrap_or(0.0),
                mib(stage["peak_memory"].as_u64().unwrap_or(0))
            );
        }
    }
    Ok(())
}

/// Writes the samples of a volume slice by slice.
fn generate(path: &Path, size: [usize; 3]) -> Result<(), Box<dyn Error>> {
    let gyroids = Gyroids::new(size, 1, SCALE);
    let mut out = BufWriter::with_capacity(1 << 22, File::create(path)?);
    let together = 32;
    for first in (0..size[2]).step_by(together) {
        let samples = gyroids.slices(first..(first + together).min(size[2]));
        out.write_all(bytemuck::cast_slice(&samples))?;
    }
    out.flush()?;
    Ok(())
}
