//! One volume, many processes: every brick (a run of slices) is classified and contoured by processes of its
//! own, which share nothing but files; then the pieces are merged and compared with [`extract`].
//! `cargo run --release --example bricks -- [BRICKS] [VOLUME]`
//!
//! What a process keeps is written with `postcard`, whose format is specified and exact to the bit.

#![allow(clippy::print_stdout)] // an example talks

use std::error::Error;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::Command;

use interfacet::classify::{Brick, Passes, Schedule, Sweep, SweepReport};
use interfacet::contour::marching::march_pieces;
use interfacet::contour::{ContourError, Piece, Thresholds, layers_of, merge};
use interfacet::export::{PlyOptions, write_ply};
use interfacet::material::{Blur, Found, ScanQuality, Survey};
use interfacet::mesh::MeshMaterial;
use interfacet::pipeline::Accuracy;
use interfacet::volume::{OpenOptions, Sample, SampleWindow, open};
use interfacet::{
    Border, Execution, InterfaceMesh, MaterialTable, PipelineOptions, VolumeSource, extract, with_sample_type,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

type Outcome<T = ()> = Result<T, Box<dyn Error>>;

/// What all processes must know.
#[derive(Serialize, Deserialize)]
struct Job {
    volume: PathBuf,
    materials: MaterialTable,
    /// Radius R of the blur, voxels per axis.
    radius: [f64; 3],
    border: Border,
    /// The padded slices of each brick.
    bricks: Vec<Range<usize>>,
}

/// What a process does for its brick. A round is a sweep of thinning; bricks are kept by round.
#[derive(Serialize, Deserialize)]
enum Task {
    /// Samples and halo in, round 0 out, and how many voxels are certain.
    Decide,
    /// The brick and its neighbours of a round in, the brick of the next round and a report out.
    Thin { round: usize, sweep: Sweep },
    /// The brick of the last round and one slice above in, a piece of surface out.
    Contour { round: usize },
}

/// Files in the folder that the processes share.
struct Folder<'a>(&'a Path);

impl Folder<'_> {
    fn put<T: Serialize>(&self, name: &str, value: &T) -> Outcome {
        Ok(std::fs::write(self.0.join(name), postcard::to_stdvec(value)?)?)
    }

    fn get<T: DeserializeOwned>(&self, name: &str) -> Outcome<T> {
        Ok(postcard::from_bytes(&std::fs::read(self.0.join(name))?)?)
    }

    /// The padded slices `slices` as they were in a round.
    fn join(&self, job: &Job, round: usize, slices: Range<usize>) -> Outcome<Brick> {
        let touch = |brick: &Range<usize>| brick.start < slices.end && slices.start < brick.end;
        let names =
            (0..job.bricks.len()).filter(|&i| touch(&job.bricks[i])).map(|i| format!("brick-{round}-{i}"));
        let bricks = names.map(|name| self.get(&name)).collect::<Outcome<Vec<Brick>>>()?;
        Ok(Brick::join(&bricks, slices)?)
    }
}

/// A child: one task for brick `i`.
fn work<S: Sample>(job: &Job, source: &dyn VolumeSource, folder: &Folder<'_>, i: usize) -> Outcome {
    let (core, size) = (job.bricks[i].clone(), source.geometry().size());
    let execution = Execution::default();
    // Holds only the slices that it is told to.
    let mut window = SampleWindow::<S>::new(source, &execution)?;
    match folder.get("task")? {
        Task::Decide => {
            let passes = Passes::new(size, &job.materials, job.radius);
            window.hold(passes.needs(&core))?;
            let decided = passes.decide(window.slab(), core);
            folder.put(&format!("brick-0-{i}"), &Brick::new(&decided))?;
            folder.put(&format!("report-{i}"), &decided.core.iter().sum::<u64>())
        }
        Task::Thin { round, sweep } => {
            let wide = sweep.needs(&core, size[2]);
            let brick = folder.join(job, round, wide.clone())?;
            window.hold(wide.start - 1..wide.end - 1)?;
            let (brick, report) = brick.thin(window.slab(), &job.materials, sweep, &core);
            folder.put(&format!("brick-{}-{i}", round + 1), &brick)?;
            folder.put(&format!("report-{i}"), &report)
        }
        Task::Contour { round } => {
            let layers = layers_of(&core);
            let brick = folder.join(job, round, layers.start..layers.end + 1)?;
            window.hold(core.start - 1..core.end.min(size[2]))?;
            let rule = Thresholds::new(window.slab(), brick.junction(), &job.materials);
            let mut pieces = Vec::new();
            march_pieces(brick.labels(), &rule, job.border, layers, usize::MAX, &execution, &mut |piece| {
                pieces.push(piece);
                Ok::<(), ContourError>(())
            })?;
            folder.put(&format!("piece-{i}"), &merge(pieces)?)
        }
    }
}

/// Runs a task for all bricks, each in a process of its own.
fn run(folder: &Folder<'_>, bricks: usize, task: &Task) -> Outcome {
    folder.put("task", task)?;
    let start = |i: usize| {
        let mut child = Command::new(std::env::current_exe()?);
        child.arg("--child").arg(folder.0).arg(i.to_string()).spawn()
    };
    let children: Vec<_> = (0..bricks).map(start).collect();
    for (i, child) in children.into_iter().enumerate() {
        let status = child?.wait()?;
        if !status.success() {
            return Err(format!("the process for brick {i} failed: {status}").into());
        }
    }
    Ok(())
}

/// Materials and blur, by one look at the whole volume.
fn survey<S: Sample>(source: &dyn VolumeSource) -> Outcome<(MaterialTable, Blur)> {
    const SLICES: usize = 16;
    let execution = Execution::default();
    let mut window = SampleWindow::<S>::new(source, &execution)?;
    let Found { table, .. } = Survey::read(&mut window, None, SLICES)?.find_materials(None)?;
    let blur = ScanQuality::read(&mut window, source.geometry(), &table, SLICES)?.blur;
    Ok((table, blur))
}

/// The parent: only small reports pass through it, until it merges.
fn bricks(job: &Job, folder: &Folder<'_>) -> Outcome<Piece> {
    let n = job.bricks.len();
    folder.put("job", job)?;
    run(folder, n, &Task::Decide)?;
    let certain = (0..n).map(|i| folder.get::<u64>(&format!("report-{i}"))).sum::<Outcome<u64>>()?;
    if certain == 0 {
        return Err("no voxel is certain: the radius is too large".into());
    }
    let mut schedule = Schedule::new(4, job.radius);
    let mut round = 0;
    loop {
        let sweep = schedule.sweep();
        run(folder, n, &Task::Thin { round, sweep })?;
        round += 1;
        let (mut changed, mut undecided) = (vec![0; sweep.steps().count()], 0);
        for i in 0..n {
            let report: SweepReport = folder.get(&format!("report-{i}"))?;
            changed.iter_mut().zip(&report.changed).for_each(|(sum, c)| *sum += c);
            undecided += report.undecided;
        }
        println!("sweep {round}: {changed:?} voxels labelled by step, {undecided} left");
        if !schedule.add(&changed, undecided)? {
            break;
        }
    }
    run(folder, n, &Task::Contour { round })?;
    let pieces = (0..n).map(|i| folder.get(&format!("piece-{i}"))).collect::<Outcome<Vec<Piece>>>()?;
    Ok(merge(pieces)?)
}

fn main() -> Outcome {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [mark, folder, i] = &arguments[..]
        && mark == "--child"
    {
        let folder = Folder(Path::new(folder));
        let job: Job = folder.get("job")?;
        let source = open(&job.volume, &OpenOptions::default())?;
        return with_sample_type!(source.sample_type(), S => work::<S>(&job, source.as_ref(), &folder, i.parse()?));
    }
    let count: usize = arguments.first().map_or(Ok(5), |n| n.parse())?;
    let ring = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/press_fit_ring.mha");
    let volume: PathBuf = arguments.get(1).map_or(ring, String::as_str).into();
    let source = open(&volume, &OpenOptions::default())?;
    // Bricks do what the papers do.
    let options = PipelineOptions { accuracy: Accuracy::Paper, ..PipelineOptions::default() };
    let depth = source.geometry().size()[2];
    let (materials, blur) = with_sample_type!(source.sample_type(), S => survey::<S>(source.as_ref()))?;
    let thickness = depth.div_ceil(count.clamp(1, depth));
    let bricks_of = |z: usize| z..(z + thickness).min(depth + 1);
    let cuts = (1..=depth).step_by(thickness).map(bricks_of).collect();
    let job = Job { volume, materials, radius: blur.radius, border: options.border, bricks: cuts };

    let shared = tempfile::tempdir()?;
    let merged = bricks(&job, &Folder(shared.path()))?;
    let materials = MeshMaterial::from_table(&job.materials);
    let mesh = InterfaceMesh::from_patch(merged.patch, source.geometry(), materials)?;
    println!("{} bricks: {} triangles", job.bricks.len(), mesh.triangles().len());

    let whole = extract(source.as_ref(), &options, &Execution::default())?;
    let bytes = |mesh: &InterfaceMesh| -> Outcome<Vec<u8>> {
        let path = shared.path().join("mesh.ply");
        write_ply(&path, mesh, PlyOptions::for_volume(source.geometry()))?;
        Ok(std::fs::read(path)?)
    };
    if bytes(&mesh)? != bytes(&whole.mesh)? {
        // `extract` would also try a smaller radius where thin parts are lost; bricks take the radius given.
        return Err("the mesh differs from that of one process".into());
    }
    println!("the same mesh, byte for byte, as in one process");
    Ok(())
}
