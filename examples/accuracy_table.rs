//! Makes phantoms, extracts their surfaces and prints how far these are from the exact geometry, as the
//! tables of `docs/accuracy.md`:
//!
//! ```text
//! cargo run --release --example accuracy_table > tables.md
//! ```
//!
//! Nothing is written to disk. Options choose scenes, sizes, noise and radius, for experiments.

use std::io::Write;

use anyhow::Context;
use clap::Parser;

use interfacet::execution::Execution;
use interfacet::mesh::{CheckOptions, check};
use interfacet::phantom::compare::{CompareOptions, Comparison, Distances, Split, Tally, compare};
use interfacet::phantom::{Noise, Phantom, PhantomOptions, SceneName, Surface};
use interfacet::pipeline::{Extraction, PipelineOptions, extract};
use interfacet::volume::MemorySource;

/// Prints the accuracy reached on phantoms.
#[derive(Debug, Parser)]
struct Args {
    /// Only this scene; may be given several times.
    #[arg(long)]
    scene: Vec<SceneName>,
    /// Voxels per axis.
    #[arg(long, default_value_t = 128)]
    size: usize,
    /// Voxels per axis of scenes with curved surfaces.
    #[arg(long, default_value_t = 160)]
    curved_size: usize,
    /// Sigma of the blur in voxels, without the voxel's own box.
    #[arg(long, default_value_t = 1.15)]
    sigma: f64,
    /// White noise in percent of the smallest difference of two materials.
    #[arg(long, default_value_t = 1.0)]
    noise: f64,
    /// Seed of the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Rotation in degrees about x, y, z.
    #[arg(long, value_delimiter = ',', default_value = "7.3,11.9,4.1")]
    rotate: Vec<f64>,
    /// Radius R in units of the true sigma, instead of the estimate.
    #[arg(long)]
    radius_per_sigma: Option<f64>,
    /// Grey values of the materials, for scenes that have as many.
    #[arg(long, value_delimiter = ',')]
    greys: Option<Vec<f64>>,
    /// Only the summary.
    #[arg(long)]
    brief: bool,
}

/// One phantom, extracted and compared.
struct Run {
    phantom: Phantom,
    extraction: Extraction,
    comparison: Comparison,
    /// With the clear distance one voxel larger.
    beyond: Comparison,
    radius: f64,
    defects: u64,
}

impl Args {
    fn run(&self, scene: SceneName, size: usize, thickness: f64) -> anyhow::Result<Run> {
        let rotation = <[f64; 3]>::try_from(&self.rotate[..]).context("--rotate takes three angles")?;
        let phantom = Phantom::new(&PhantomOptions {
            scene,
            size: [size; 3],
            sigma: self.sigma,
            noise: Noise::Percent(self.noise),
            seed: self.seed,
            rotation,
            thickness,
            greys: self.greys.clone(),
            ..PhantomOptions::default()
        })?;
        let execution = Execution::default();
        let source = MemorySource::new(phantom.geometry().clone(), phantom.rasterise(&execution)?)?;
        let radius = self.radius_per_sigma.map(|f| f * effective_sigma(self.sigma));
        let options = PipelineOptions { radius, ..PipelineOptions::default() };
        let extraction = extract(&source, &options, &execution)?;
        let radius = extraction.findings.blur.context("a grey volume has a blur")?.radius[0];
        let defects = check(&extraction.mesh, &CheckOptions::default(), &execution)?.total();
        let at = |clear: f64| {
            let options = CompareOptions { clear, ..CompareOptions::default() };
            compare(&extraction.mesh, &phantom, &options, &execution)
        };
        let (comparison, beyond) = (at(2.0 * radius)?, at(2.0 * radius + 1.0)?);
        Ok(Run { phantom, extraction, comparison, beyond, radius, defects })
    }
}

/// Sigma with the averaging over a voxel.
fn effective_sigma(sigma: f64) -> f64 {
    (sigma * sigma + 1.0 / 12.0).sqrt()
}

impl Run {
    fn title(&self) -> String {
        let options = self.phantom.options();
        let name = options.scene.name();
        let thickness =
            if options.scene.uses_thickness() { format!(" {}", options.thickness) } else { String::new() };
        format!("{name}{thickness}")
    }

    /// Smallest radius of curvature in voxels and the shift that blur causes there.
    fn curvature(&self, sigma: f64) -> Option<(f64, f64)> {
        let voxel = self.phantom.geometry().voxel_edge();
        let s2 = effective_sigma(sigma).powi(2);
        let surfaces = self.phantom.truth().scene().surfaces().iter();
        surfaces
            .filter_map(|surface| match surface {
                Surface::Plane { .. } => None,
                Surface::Sphere { radius, .. } => Some((radius / voxel, s2 * voxel / radius)),
                Surface::Cylinder { radius, .. } => Some((radius / voxel, 0.5 * s2 * voxel / radius)),
            })
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The worst of the pairs, both ways, in voxels: RMS, 99 %, largest.
    fn worst(comparison: &Comparison, of: impl Fn(&Split) -> Option<Distances>) -> [f64; 3] {
        let mut worst = [f64::NAN; 3];
        for pair in &comparison.pairs {
            for found in [of(&pair.mesh_to_truth), of(&pair.truth_to_mesh)].into_iter().flatten() {
                for (w, new) in worst.iter_mut().zip([found.voxels.rms, found.voxels.p99, found.voxels.max]) {
                    *w = w.max(new);
                }
            }
        }
        worst
    }

    fn topology(&self) -> String {
        let wrong: Vec<String> = self
            .comparison
            .materials
            .iter()
            .filter(|m| m.topology != m.expected)
            .map(|m| {
                let (t, e) = (m.topology, m.expected);
                format!("{} {}/{} for {}/{}", m.name, t.components, t.euler, e.components, e.euler)
            })
            .collect();
        if wrong.is_empty() { "right".into() } else { wrong.join("; ") }
    }

    fn volume_errors(&self) -> String {
        let errors: Vec<String> = self
            .comparison
            .materials
            .iter()
            .filter_map(|m| Some(format!("{:+.2}", m.volume_error_percent?)))
            .collect();
        errors.join(", ")
    }
}

fn numbers<const N: usize>(values: [f64; N]) -> String {
    values.map(|v| if v.is_nan() { "-".into() } else { format!("{v:.3}") }).join(" / ")
}

fn tally(tally: Tally) -> String {
    if tally.triangles == 0 {
        "0".into()
    } else {
        format!("{} ({:.2} %)", tally.triangles, tally.share_percent)
    }
}

fn summary(out: &mut impl Write, runs: &[Run], sigma: f64) -> std::io::Result<()> {
    writeln!(
        out,
        "| scene | size | R | curvature: radius, shift | clear of junctions and edges by 2R | by 2R + 1 | near a sharp edge | farther than 2R from junctions | near a junction | above 0.35 up to | junction curve RMS / 95 % / max | volume error % | false: near / beyond | components/Euler | defects |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|")?;
    for run in runs {
        let c = &run.comparison;
        let curve = c.junctions.as_ref().and_then(|j| j.mesh_to_truth).map(|d| d.voxels);
        let reach = c.pairs.iter().map(|p| p.disturbed_reach).fold(0.0, f64::max);
        writeln!(
            out,
            "| {} | {} | {:.2} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} / {} | {} | {} |",
            run.title(),
            run.phantom.options().size[0],
            run.radius,
            run.curvature(sigma).map_or("plane".into(), |(r, shift)| format!("{r:.1}, {shift:.3}")),
            numbers(Run::worst(c, |s| s.clear)),
            numbers(Run::worst(&run.beyond, |s| s.clear)),
            numbers(Run::worst(c, |s| s.near_edge)),
            numbers(Run::worst(c, |s| s.off_junctions)),
            numbers(Run::worst(c, |s| s.near_junction)),
            if reach > 0.0 { format!("{reach:.2}") } else { "-".into() },
            curve.map_or("-".into(), |f| numbers([f.rms, f.p95, f.max])),
            run.volume_errors(),
            tally(c.false_triangles.near),
            tally(c.false_triangles.clear),
            run.topology(),
            run.defects,
        )?;
    }
    Ok(())
}

fn details(out: &mut impl Write, runs: &[Run]) -> std::io::Result<()> {
    writeln!(
        out,
        "| scene | interface | where | mesh to truth: mean | RMS / 95 % / 99 % / max | truth to mesh: RMS / 95 % / 99 % / max |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|")?;
    for run in runs {
        let materials = &run.comparison.materials;
        let name = |id: u8| materials.get(usize::from(id)).map_or("unknown", |m| m.name.as_str());
        for pair in &run.comparison.pairs {
            let (there, back) = (&pair.mesh_to_truth, &pair.truth_to_mesh);
            for (group, there, back) in [
                ("clear of both", there.clear, back.clear),
                ("near a sharp edge", there.near_edge, back.near_edge),
                ("farther than 2R from junctions", there.off_junctions, back.off_junctions),
                ("near a junction", there.near_junction, back.near_junction),
            ] {
                if there.is_none() && back.is_none() {
                    continue;
                }
                let figures = |d: Option<Distances>| {
                    d.map_or("-".into(), |d| {
                        numbers([d.voxels.rms, d.voxels.p95, d.voxels.p99, d.voxels.max])
                    })
                };
                writeln!(
                    out,
                    "| {} | {}/{} | {group} | {} | {} | {} |",
                    run.title(),
                    name(pair.back),
                    name(pair.front),
                    there.map_or("-".into(), |d| format!("{:+.4}", d.voxels.signed_mean)),
                    figures(there),
                    figures(back),
                )?;
            }
        }
    }
    Ok(())
}

fn means(out: &mut impl Write, runs: &[Run]) -> std::io::Result<()> {
    writeln!(out, "| scene | grey values | found | noise found |\n|---|---|---|---|")?;
    for run in runs {
        let list = |values: Vec<String>| values.join(", ");
        let (true_ones, found) =
            (run.phantom.materials().materials(), run.extraction.findings.materials.materials());
        writeln!(
            out,
            "| {} | {} | {} | {} |",
            run.title(),
            list(true_ones.iter().map(|m| m.mean.to_string()).collect()),
            list(found.iter().map(|m| format!("{:.1}", m.mean)).collect()),
            list(found.iter().map(|m| m.sigma.map_or("-".into(), |s| format!("{s:.1}"))).collect()),
        )?;
    }
    Ok(())
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let mut out = std::io::stdout().lock();
    let scenes = if args.scene.is_empty() { SceneName::ALL.to_vec() } else { args.scene.clone() };
    let mut runs = Vec::new();
    for &scene in &scenes {
        let curved = Phantom::new(&PhantomOptions { scene, ..PhantomOptions::default() })?;
        let curved = curved.truth().scene().surfaces().iter().any(|s| !matches!(s, Surface::Plane { .. }));
        // Thick enough to be kept whole; what happens to thinner ones is a table of its own.
        let thickness = if args.brief { 4.0 } else { 8.0 };
        let mut sizes = vec![args.size];
        if curved && args.curved_size != args.size {
            sizes.push(args.curved_size);
        }
        for size in sizes {
            runs.push(args.run(scene, size, thickness)?);
        }
    }
    summary(&mut out, &runs, args.sigma)?;
    writeln!(out)?;
    means(&mut out, &runs)?;
    if args.brief {
        return Ok(());
    }
    writeln!(out)?;
    details(&mut out, &runs)?;
    drop(runs);
    let mut thin = Vec::new();
    for &scene in scenes.iter().filter(|s| s.uses_thickness()) {
        for thickness in [2.5, 4.0, 6.0, 8.0] {
            thin.push(args.run(scene, args.size, thickness)?);
        }
    }
    if !thin.is_empty() {
        writeln!(out)?;
        summary(&mut out, &thin, args.sigma)?;
    }
    Ok(())
}
