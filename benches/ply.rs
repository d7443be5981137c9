//! Writing and reading a large PLY beside a plain copy of the same bytes.
//!
//! `cargo bench --bench ply` makes a grid mesh of about ten million triangles in 200 layers;
//! `cargo bench --bench ply -- 2.5 7` another number of millions and of runs. The files go into a temporary
//! folder (`TMPDIR`). Every round takes, in turn, the plain copy (8 MiB blocks, then fsync), the writer of a
//! whole mesh (fsync included), the writer of pieces (fsync included), a plain read of the bytes, the
//! reader of the whole mesh and the reader of pieces. All files stay in the page cache; what is written to the disk
//! is what fsync waits for. The plain read is into memory, as much as the file is long. Before each step, free memory is
//! touched: on a virtual machine the first touch after a while is slow, and would count for whoever comes first.
//! Prints medians and ratios to the copy and the plain read.

#![allow(clippy::print_stdout)] // a benchmark's output is its purpose

use std::error::Error;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;
use std::time::Instant;

use glam::DVec3;
use interfacet::export::{PlyOptions, PlyPieces, PlyStream, ReadOptions, read_mesh, write_ply};
use interfacet::grid::{MaterialId, Pair, VertexKind};
use interfacet::mesh::{InterfaceMesh, MeshMaterial, MeshPiece};
use interfacet::{Execution, Geometry};

const LAYERS: usize = 200;
const STEPS: [&str; 6] =
    ["plain copy", "write mesh", "write pieces", "plain read", "read mesh", "read pieces"];

/// A sheet of `LAYERS` bands of `across` squares, wound up a little so that coordinates are no round
/// numbers. Its layers are the bands, with the row below each.
fn sheet(across: usize) -> Result<InterfaceMesh, Box<dyn Error>> {
    let point = |i: usize| {
        let (row, column) = (i / (across + 1), i % (across + 1));
        let angle = column as f64 * 0.001;
        DVec3::new(angle.cos() * 40.0, angle.sin() * 40.0, row as f64 * 0.1234)
    };
    let positions: Vec<DVec3> = (0..(LAYERS + 1) * (across + 1)).map(point).collect();
    let mut triangles = Vec::with_capacity(2 * LAYERS * across);
    for row in 0..LAYERS {
        for column in 0..across {
            let a = (row * (across + 1) + column) as u32;
            let (b, c, d) = (a + 1, a + across as u32 + 1, a + across as u32 + 2);
            triangles.extend([[a, b, d], [a, d, c]]);
        }
    }
    let pair = Pair::new(MaterialId(1), MaterialId(0)).ok_or("two materials")?;
    let (kinds, pairs) = (vec![VertexKind::Interface; positions.len()], vec![pair; triangles.len()]);
    let material = |(id, name): (u8, &str)| MeshMaterial {
        id: MaterialId(id),
        name: name.to_owned(),
        mean: f64::from(id),
    };
    let materials = [(0, "air"), (1, "steel")].map(material).to_vec();
    Ok(InterfaceMesh::new(positions, kinds, triangles, pairs, materials)?)
}

/// The sheet in pieces of ten layers.
fn pieces(mesh: &InterfaceMesh, across: usize) -> Result<Vec<MeshPiece>, Box<dyn Error>> {
    let row = across + 1;
    let piece = |first: usize| {
        let last = (first + 10).min(LAYERS);
        let vertices = first * row..(last + 1) * row;
        let triangles = first * 2 * across..last * 2 * across;
        let local = |t: &[u32; 3]| t.map(|v| v - vertices.start as u32);
        let part = InterfaceMesh::new(
            mesh.positions()[vertices.clone()].to_vec(),
            mesh.kinds()[vertices.clone()].to_vec(),
            mesh.triangles()[triangles.clone()].iter().map(local).collect(),
            mesh.pairs()[triangles.clone()].to_vec(),
            mesh.materials().to_vec(),
        )?;
        let owned = if last == LAYERS { vertices.len() } else { vertices.len() - row };
        Ok(MeshPiece {
            mesh: part,
            owned,
            last_layer: [owned, 0],
            first_vertex: vertices.start as u64,
            first_triangle: triangles.start as u64,
        })
    };
    (0..LAYERS).step_by(10).map(piece).collect()
}

fn copy(from: &Path, to: &Path) -> io::Result<()> {
    let (mut from, mut to) = (File::open(from)?, File::create(to)?);
    let mut buffer = vec![0; 8 << 20];
    loop {
        match from.read(&mut buffer)? {
            0 => return to.sync_all(),
            n => to.write_all(&buffer[..n])?,
        }
    }
}

/// Touches as much memory as a step may take, and gives it back.
fn touch(bytes: u64) {
    let mut memory = vec![0u8; 2 * bytes as usize];
    memory.iter_mut().step_by(4096).for_each(|byte| *byte = 1);
    std::hint::black_box(&memory);
}

fn main() -> Result<(), Box<dyn Error>> {
    let numbers: Vec<f64> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let millions = numbers.first().copied().unwrap_or(10.0).clamp(0.01, 1000.0);
    let runs = numbers.get(1).map_or(5, |&n| n as usize).max(1);
    let across = (millions * 1e6 / (2.0 * LAYERS as f64)) as usize;
    let mesh = sheet(across)?;
    let cut = pieces(&mesh, across)?;
    let options = PlyOptions::for_volume(&Geometry::axis_aligned([400, 400, 400], [0.1; 3])?);
    let folder = tempfile::tempdir()?;
    let [whole, streamed, copied] = ["whole", "streamed", "copied"].map(|name| folder.path().join(name));
    let execution = Execution::default();
    write_ply(&whole, &mesh, options)?;
    let bytes = std::fs::metadata(&whole)?.len();

    let mut times: [Vec<f64>; STEPS.len()] = Default::default();
    for _ in 0..runs {
        for (step, times) in times.iter_mut().enumerate() {
            // Nothing is left over from the step before for this one to pay for.
            for path in [&streamed, &copied] {
                if path.exists() {
                    std::fs::remove_file(path)?;
                }
            }
            touch(bytes);
            let start = Instant::now();
            match step {
                0 => copy(&whole, &copied)?,
                1 => write_ply(&copied, &mesh, options)?,
                2 => {
                    let mut out = PlyStream::create(&streamed, mesh.materials(), options)?;
                    for piece in &cut {
                        out.add(piece)?;
                    }
                    out.finish(&execution)?;
                }
                3 => drop(std::hint::black_box(std::fs::read(&whole)?)),
                4 => drop(std::hint::black_box(read_mesh(&whole, &ReadOptions::default())?)),
                _ => {
                    let pieces = PlyPieces::open(&whole, &ReadOptions::default())?;
                    pieces.each(|piece| {
                        std::hint::black_box(piece.mesh.triangles().len());
                        Ok::<(), interfacet::export::ExportError>(())
                    })?;
                }
            }
            times.push(start.elapsed().as_secs_f64());
            if step == 2 {
                assert!(std::fs::read(&streamed)? == std::fs::read(&whole)?, "pieces make the same file");
            }
        }
    }
    println!(
        "{} vertices, {} triangles, {:.1} MB, {runs} runs, {} threads; page cache warm",
        mesh.positions().len(),
        mesh.triangles().len(),
        bytes as f64 / 1e6,
        rayon::current_num_threads()
    );
    let medians = times.map(|mut t| {
        t.sort_by(f64::total_cmp);
        t[t.len() / 2]
    });
    for (i, (name, median)) in STEPS.iter().zip(medians).enumerate() {
        let beside = medians[if i < 3 { 0 } else { 3 }];
        let speed = bytes as f64 / 1e6 / median;
        println!("{name:13} {median:7.3} s {speed:8.0} MB/s {:6.2} of the plain one", median / beside);
    }
    Ok(())
}
