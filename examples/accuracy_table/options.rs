//! The command line, and what it makes of phantoms and of the pipeline.

use std::path::PathBuf;

use anyhow::Context;
use clap::Parser;

use interfacet::phantom::{Noise, PhantomOptions, SceneName};
use interfacet::pipeline::{self, DualMethod, Method, PipelineOptions};

use super::cases::{CONDITIONS, Case, Condition};

/// Prints the accuracy reached on phantoms, beside what is wanted.
#[derive(Debug, Parser)]
pub(crate) struct Args {
    /// Only this scene; may be given several times.
    #[arg(long)]
    pub scene: Vec<SceneName>,
    /// Only this column of the table: 1 (noise 1 %), 2 (noise 4 %), 3 (cupping).
    #[arg(long, value_parser = column)]
    pub column: Option<usize>,
    /// Other objects, rotations and seeds than those a method is tuned on.
    #[arg(long)]
    pub held_out: bool,
    /// How the surface is made.
    #[arg(long, value_enum, default_value_t = MethodName::Marching)]
    method: MethodName,
    /// The published methods, or all that goes beyond them.
    #[arg(long, value_enum, default_value_t = Accuracy::Paper)]
    accuracy: Accuracy,
    /// Radius R in voxels instead of the estimate.
    #[arg(long)]
    radius: Option<f64>,
    /// Voxels per axis.
    #[arg(long, default_value_t = 112)]
    size: usize,
    /// Share of the volume's side that the turned object takes up.
    #[arg(long, default_value_t = 0.85)]
    fill: f64,
    /// Sigma of the blur in voxels, without the voxel's own box.
    #[arg(long, default_value_t = 1.15)]
    sigma: f64,
    /// Sigma in voxels of the filter of the noise; 0: white noise.
    #[arg(long, default_value_t = 0.0)]
    noise_correlation: f64,
    /// Seeds of the noise, separated by commas [default: 1; held out: 101].
    #[arg(long, value_delimiter = ',')]
    seed: Vec<u64>,
    /// Rotation in degrees about x, y, z, separated by commas; may be given several times [default: 7.3,11.9,4.1; held out:
    /// 23.1,-14.7,31.9].
    #[arg(long, allow_hyphen_values = true)]
    rotate: Vec<String>,
    /// Write all figures to this file.
    #[arg(long)]
    pub json: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum MethodName {
    Marching,
    Dual,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Accuracy {
    Paper,
    Full,
}

fn column(text: &str) -> Result<usize, String> {
    let range = 1..=CONDITIONS.len();
    text.parse().ok().filter(|n| range.contains(n)).ok_or_else(|| format!("one of 1 to {}", range.end()))
}

/// The pipeline to measure: the one place that knows how the options of this program become its own.
pub(crate) fn options(args: &Args) -> anyhow::Result<PipelineOptions> {
    let method = match args.method {
        MethodName::Marching => Method::Marching,
        MethodName::Dual => Method::Dual(DualMethod::default()),
    };
    let accuracy = match args.accuracy {
        Accuracy::Paper => pipeline::Accuracy::Paper,
        Accuracy::Full => pipeline::Accuracy::Full,
    };
    Ok(PipelineOptions { method, radius: args.radius, accuracy, ..PipelineOptions::default() })
}

impl Args {
    /// What was measured, in one line.
    pub(crate) fn title(&self) -> String {
        let set = if self.held_out { "held out" } else { "tuning" };
        let correlation = if self.noise_correlation > 0.0 {
            format!(", noise filtered with sigma {}", self.noise_correlation)
        } else {
            String::new()
        };
        format!(
            "{:?}, accuracy {:?}; {set} set, {} voxels per axis, fill {}, blur sigma {}{correlation}",
            self.method, self.accuracy, self.size, self.fill, self.sigma
        )
    }

    /// The seeds asked for.
    pub(crate) fn seeds(&self) -> Vec<u64> {
        match (&self.seed[..], self.held_out) {
            ([], false) => vec![1],
            ([], true) => vec![101],
            (given, _) => given.to_vec(),
        }
    }

    /// The rotations asked for, degrees.
    pub(crate) fn rotations(&self) -> anyhow::Result<Vec<[f64; 3]>> {
        if self.rotate.is_empty() {
            return Ok(vec![if self.held_out { [23.1, -14.7, 31.9] } else { [7.3, 11.9, 4.1] }]);
        }
        let parse = |text: &String| {
            let angles: Vec<f64> = text.split(',').map(|a| a.trim().parse()).collect::<Result<_, _>>()?;
            <[f64; 3]>::try_from(&angles[..]).context("--rotate takes three angles")
        };
        self.rotate.iter().map(parse).collect()
    }

    /// The image of a case.
    pub(crate) fn phantom(
        &self,
        case: &Case,
        condition: &Condition,
        rotation: [f64; 3],
        seed: u64,
    ) -> PhantomOptions {
        let base = PhantomOptions {
            scene: case.scene,
            size: [self.size; 3],
            fill: self.fill,
            sigma: self.sigma,
            rotation,
            noise: Noise::Percent(condition.noise),
            noise_correlation: self.noise_correlation,
            cupping: condition.cupping,
            seed,
            ..PhantomOptions::default()
        };
        match case.number {
            n if case.scene.uses_thickness() => PhantomOptions { thickness: n, ..base },
            n if case.scene.uses_angle() => PhantomOptions { angle: n, ..base },
            n if case.scene.uses_fillet() => PhantomOptions { fillet: n, ..base },
            _ => base,
        }
    }
}
