//! Remakes the pictures of the README that show what the tolerance of dual contouring does: one volume, four
//! tolerances, the triangles' edges over the shading.
//!
//! ```text
//! cargo run --release --example tolerance_pictures -- docs/images --engine shared/data/engine/engine.mha
//! ```
//!
//! The phantom needs no file; without `--engine` only its picture is made.

#![allow(clippy::print_stdout)] // an example talks

use std::path::{Path, PathBuf};

use clap::Parser;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use interfacet::grid::VoxelBox;
use interfacet::phantom::{Phantom, PhantomOptions, SceneName};
use interfacet::pipeline::{Accuracy, DualMethod, Method, Tolerance};
use interfacet::report::{Picture, RenderOptions, render, sheet};
use interfacet::volume::{OpenOptions, RegionOfInterest, open};
use interfacet::{Execution, MemorySource, PipelineOptions, VolumeSource, extract};

/// Remakes the pictures of dual contouring at four tolerances.
#[derive(Debug, Parser)]
struct Args {
    /// The folder to write into.
    folder: PathBuf,
    /// The engine of the Open Scientific Visualization Datasets, 256 x 256 x 128, as a MetaImage.
    #[arg(long)]
    engine: Option<PathBuf>,
}

/// Voxels; the first is negative, which means no simplification.
const TOLERANCES: [f64; 4] = [-1.0, 0.1, 0.2, 0.5];
/// Steps between the tones of a picture that is saved.
const TONES: u8 = 8;
/// Slices of the engine that are used.
const ENGINE_SLICES: usize = 100;

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    std::fs::create_dir_all(&args.folder)?;
    let cubes = PhantomOptions { scene: SceneName::CubeInCube, size: [64; 3], ..PhantomOptions::default() };
    let phantom = Phantom::new(&cubes)?;
    let samples = phantom.rasterise(&Execution::default())?;
    let volume = MemorySource::new(phantom.geometry().clone(), samples)?;
    let view = RenderOptions { azimuth: 30.0, elevation: 38.0, ..tile() };
    four(&volume, &view, &args.folder.join("tolerance_cubes.png"))?;
    if let Some(path) = &args.engine {
        let whole = open(path, &OpenOptions::default())?;
        let [width, height, _] = whole.geometry().size();
        let engine = RegionOfInterest::new(whole, VoxelBox::whole([width, height, ENGINE_SLICES]))?;
        let view = RenderOptions { azimuth: 215.0, elevation: 40.0, ..tile() };
        four(&engine, &view, &args.folder.join("tolerance_engine.png"))?;
    }
    Ok(())
}

/// One of four pictures.
fn tile() -> RenderOptions {
    RenderOptions {
        width: 440,
        height: 400,
        wireframe: true,
        legend: false,
        supersampling: 3,
        ..RenderOptions::default()
    }
}

/// Draws a volume's surface at all tolerances.
fn four(volume: &dyn VolumeSource, view: &RenderOptions, path: &Path) -> anyhow::Result<()> {
    let execution = Execution::default();
    let mut tiles: Vec<(Picture, String)> = Vec::new();
    for tolerance in TOLERANCES {
        let method =
            Method::Dual(DualMethod { tolerance: Tolerance::Voxels(tolerance), ..DualMethod::default() });
        let options = PipelineOptions { method, accuracy: Accuracy::Paper, ..PipelineOptions::default() };
        let mesh = extract(volume, &options, &execution)?.mesh;
        let count = mesh.triangles().len();
        let name = if tolerance < 0.0 { "not simplified".to_owned() } else { format!("{tolerance} voxel") };
        let caption = format!("{name}: {count} triangles");
        println!("{}: {caption}", path.display());
        tiles.push((render(&mesh, view)?, caption));
    }
    save_small(&sheet(&tiles, 2)?, path)
}

/// Writes a PNG of few tones: thin lines over shading hardly compress otherwise, and a README should load fast.
fn save_small(picture: &Picture, path: &Path) -> anyhow::Result<()> {
    let tone = |v: u8| v.saturating_add(TONES / 2) / TONES * TONES;
    let white = |v: u8| if v >= 255 - TONES / 2 { 255 } else { tone(v) };
    let rgb: Vec<u8> = picture.rgba().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(white).collect();
    let mut smallest: Option<Vec<u8>> = None;
    for filter in [FilterType::NoFilter, FilterType::Adaptive] {
        let mut bytes = Vec::new();
        let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, filter);
        let [width, height] = [picture.width(), picture.height()].map(|n| n as u32);
        encoder.write_image(&rgb, width, height, ExtendedColorType::Rgb8)?;
        smallest = smallest.filter(|s| s.len() <= bytes.len()).or(Some(bytes));
    }
    Ok(std::fs::write(path, smallest.unwrap_or_default())?)
}
