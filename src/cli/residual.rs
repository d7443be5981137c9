//! `interfacet residual`.

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, bail};

use super::input::InputArgs;
use crate::execution::Execution;
use crate::export::{RESULT_MARK, ReadOptions, read_mesh, write_atomically};
use crate::grid::MaterialId;
use crate::inspect::{Figures, LevelChoice, Residual, ResidualOptions, residual};
use crate::report::RunReport;

const EXAMPLES: &str = "\
A surface that is right leaves noise. Look at how far interfaces are above the insides of
materials, and how that changes from one result of a scan to another.

Examples:
  interfacet extract part.mha --out result
  interfacet residual part.mha --result result
      for each interface: grey values less those of the mesh blurred as the scan is
  interfacet residual slices --spacing 0.1 --result result --json residual.json
  interfacet residual part.mha --mesh other.ply --sigma 0.12
      a mesh without a report, at a blur of 0.12 mm
";

/// Arguments of `interfacet residual`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(flatten)]
    input: InputArgs,
    /// The folder that `interfacet extract` made of this volume: its mesh, and the blur of its report.
    #[arg(long, value_name = "FOLDER", required_unless_present = "mesh")]
    result: Option<PathBuf>,
    /// Another mesh of this volume, closed, with the grey values of its materials (PLY).
    #[arg(long, value_name = "PLY")]
    mesh: Option<PathBuf>,
    /// Standard deviation of the scan's blur in mm, averaging over a voxel included [default: the report's, per axis].
    #[arg(long, value_name = "MM", required_unless_present = "result")]
    sigma: Option<f64>,
    /// Compare the voxels within this many voxels of an interface.
    #[arg(long, value_name = "VOXELS", default_value_t = 3.0)]
    reach: f64,
    /// Voxels within this many voxels of a junction curve are near it.
    #[arg(long, value_name = "VOXELS", default_value_t = 3.0)]
    near: f64,
    /// Cells of the model's grid along a voxel.
    #[arg(long, value_name = "N", default_value_t = 3)]
    fine: usize,
    /// One grey value for each material instead of levels fitted to the voxels inside of it.
    #[arg(long)]
    one_level: bool,
    /// Write all figures to this JSON file.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Runs the command.
pub(crate) fn run(args: &Args, execution: &Execution) -> anyhow::Result<ExitCode> {
    let source = args.input.open()?;
    let sigma_mm = match (args.sigma, &args.result) {
        (Some(sigma), _) => [sigma; 3],
        (None, Some(folder)) => reported(folder)?,
        (None, None) => bail!("give the scan's blur with --sigma, or a result with --result"),
    };
    let path = match (&args.mesh, &args.result) {
        (Some(mesh), _) => mesh.clone(),
        (None, Some(folder)) => folder.join("assembly.ply"),
        (None, None) => bail!("give a result with --result, or a mesh with --mesh"),
    };
    let mesh = read_mesh(&path, &ReadOptions::default())?;
    let options = ResidualOptions {
        reach: args.reach,
        near: args.near,
        fine: args.fine,
        levels: if args.one_level { LevelChoice::Table } else { LevelChoice::Local },
        ..ResidualOptions::new(sigma_mm)
    };
    let found =
        residual(&mesh, source.as_ref(), &options, execution).with_context(|| path.display().to_string())?;
    if let Some(path) = &args.json {
        write_atomically(path, |out| {
            serde_json::to_writer_pretty(&mut *out, &found).map_err(io::Error::from)?;
            writeln!(out)
        })?;
    }
    print(&found, &mut io::stdout().lock())?;
    Ok(ExitCode::SUCCESS)
}

/// The blur of a result's report, mm per axis.
fn reported(folder: &std::path::Path) -> anyhow::Result<[f64; 3]> {
    let path = folder.join(RESULT_MARK);
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let report: RunReport = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    let blur = report.blur.and_then(|blur| blur.sigma_axes_mm.or(blur.sigma_mm.map(|s| [s; 3])));
    blur.with_context(|| format!("{} states no blur; give it with --sigma", path.display()))
}

fn print(found: &Residual, out: &mut impl Write) -> io::Result<()> {
    let name = |id: MaterialId| found.materials.get(usize::from(id.0)).map_or("unknown", String::as_str);
    let [x, y, z] = found.options.sigma_mm;
    writeln!(
        out,
        "measured less modelled grey values within {} voxels of interfaces; blur {x:.4}, {y:.4}, {z:.4} mm;\n{:?} voxels at the border left out\n",
        found.options.reach, found.border
    )?;
    writeln!(
        out,
        "{:<34} {:>9} {:>8} {:>17} {:>17} {:>17}",
        "interface", "voxels", "mean", "RMS", "median", "95 %"
    )?;
    let row = |out: &mut dyn Write, title: &str, figures: Option<&Figures>| match figures {
        None => Ok(()),
        Some(f) => writeln!(
            out,
            "{title:<34} {:>9} {:>+8.2} {:>8.2} ({:>5.2} %) {:>8.2} ({:>5.2} %) {:>8.2} ({:>5.2} %)",
            f.voxels, f.mean, f.rms, f.percent[0], f.median, f.percent[1], f.p95, f.percent[2]
        ),
    };
    for pair in &found.pairs {
        let title = format!("{}/{}, contrast {:.1}", name(pair.back), name(pair.front), pair.contrast);
        row(out, &title, pair.all.as_ref())?;
        if pair.near.is_some() {
            row(out, &format!("  {} from junctions and more", found.options.near), pair.away.as_ref())?;
            row(out, "  nearer to junctions", pair.near.as_ref())?;
        }
    }
    writeln!(out)?;
    for deep in &found.deep {
        writeln!(out, "inside of {:<24} {:>9} {:>17.2}", name(deep.material), deep.voxels, deep.rms)?;
    }
    Ok(())
}
