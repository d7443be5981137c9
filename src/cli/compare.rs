//! `interfacet compare`.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;

use super::phantom::ObjectArgs;
use crate::execution::Execution;
use crate::export::{ReadOptions, read_mesh, write_atomically};
use crate::phantom::compare::{
    CREASE, CompareOptions, Comparison, DISTURBED, Distances, NARROW, TIGHT, compare,
};
use crate::phantom::{Phantom, SceneName, Sidecar};
use crate::report::RunReport;

const EXAMPLES: &str = "\
Examples:
  interfacet phantom cube-in-cube --out part.mha
  interfacet extract part.mha --out result
  interfacet compare result/assembly.ply --truth part.phantom.json
      how far the mesh is from the exact geometry, in voxels
  interfacet compare result/assembly.ply --truth part.phantom.json --error-ply error.ply
      and the mesh coloured by its error
";

/// Arguments of `interfacet compare`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The mesh, as `interfacet extract` writes it.
    mesh: PathBuf,
    /// The truth file that was written beside the phantom's volume.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["size", "spacing", "rotate", "shift", "fill", "thickness", "angle", "fillet", "extent"])]
    truth: Option<PathBuf>,
    /// The phantom by name, with the options below as it was made.
    #[arg(long, value_name = "NAME", conflicts_with = "truth", required_unless_present = "truth")]
    phantom: Option<SceneName>,
    /// Points farther than this many voxels from every junction curve or sharp edge are clear of them;
    /// triangles farther than this from where they belong are false [default: 2R, from the report.json
    /// beside the mesh; 6 without one].
    #[arg(long, value_name = "VOXELS")]
    clear: Option<f64>,
    /// Figures are also given apart for points within this many voxels of a junction curve or sharp edge.
    #[arg(long, value_name = "VOXELS", default_value_t = CompareOptions::default().near)]
    near: f64,
    /// Largest distance of sample points in voxels.
    #[arg(long, value_name = "VOXELS", default_value_t = CompareOptions::default().step)]
    step: f64,
    /// Write all figures to this JSON file.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the mesh coloured by its error to this PLY file.
    #[arg(long, value_name = "FILE")]
    error_ply: Option<PathBuf>,
    #[command(flatten)]
    object: Box<ObjectArgs>,
}

/// Runs the command.
pub(crate) fn run(args: &Args, execution: &Execution) -> anyhow::Result<ExitCode> {
    let phantom = phantom(args)?;
    let mesh = read_mesh(&args.mesh, &ReadOptions::default())?;
    let clear = args.clear.unwrap_or_else(|| default_clear(args));
    let options = CompareOptions { clear, near: args.near, step: args.step };
    let found = compare(&mesh, &phantom, mesh.sigmas(), &options, execution)?;
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&found)? + "\n";
        write_atomically(path, |out| out.write_all(text.as_bytes()))?;
    }
    if let Some(path) = &args.error_ply {
        write_atomically(path, |out| found.write_error_ply(&mesh, out))?;
    }
    print(&found, &mut std::io::stdout().lock())?;
    Ok(ExitCode::SUCCESS)
}

/// Twice the radius R of the run that made the mesh, where its report is at hand.
fn default_clear(args: &Args) -> f64 {
    let report = args.mesh.with_file_name("report.json");
    let radius = || -> Option<f64> {
        let report: RunReport = serde_json::from_str(&std::fs::read_to_string(report).ok()?).ok()?;
        let geometry = &report.input.geometry;
        Some(report.blur?.radius[0] * geometry.spacing()[0] / geometry.voxel_edge())
    };
    radius().map_or(CompareOptions::default().clear, |r| 2.0 * r)
}

fn phantom(args: &Args) -> anyhow::Result<Phantom> {
    let options = match (&args.truth, args.phantom) {
        (Some(path), _) => {
            let text =
                std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
            Sidecar::from_json(&text).with_context(|| path.display().to_string())?.options
        }
        (None, Some(scene)) => args.object.options(scene),
        (None, None) => anyhow::bail!("name the phantom with --truth or --phantom"),
    };
    Ok(Phantom::new(&options)?)
}

/// The figures as tables; distances in voxels.
fn print(found: &Comparison, out: &mut impl Write) -> std::io::Result<()> {
    let names: Vec<&str> = found.materials.iter().map(|m| m.name.as_str()).collect();
    let name = |id: u8| names.get(usize::from(id)).copied().unwrap_or("unknown");
    let CompareOptions { clear, near, .. } = found.options;
    writeln!(out, "phantom {}, 1 voxel = {} mm; all distances in voxels", found.scene, found.voxel_mm)?;
    writeln!(
        out,
        "\n{:<43} {:>9} {:>8} {:>8} {:>8} {:>8} {:>9}",
        "interfaces (positive: too far to the front)", "mean", "RMS", "95 %", "99 %", "max", "points"
    )?;
    for pair in &found.pairs {
        let title = format!("{}/{}", name(pair.back), name(pair.front));
        if !pair.in_truth {
            writeln!(out, "{title}: {} triangles of a pair that does not meet in the truth", pair.triangles)?;
            continue;
        }
        if pair.triangles == 0 {
            writeln!(out, "{title}: MISSING in the mesh ({:.1} mm² in the truth)", pair.truth_area)?;
            continue;
        }
        for (way, split) in [("mesh to truth", pair.mesh_to_truth), ("truth to mesh", pair.truth_to_mesh)] {
            row(out, &format!("{title}, {way}"), split.all.as_ref())?;
            let (wide, close) = (&split.wide, &split.close);
            row(out, "  clear of junctions and sharp edges", wide.clear.as_ref())?;
            row(out, "  near a sharp edge", wide.near_edge.as_ref())?;
            row(out, &format!("  farther than {clear:.2} from junctions"), wide.off_junctions.as_ref())?;
            row(out, "  near a junction", wide.near_junction.as_ref())?;
            row(out, &format!("  farther than {near:.2} from both"), close.clear.as_ref())?;
            row(out, &format!("  within {near:.2} of a sharp edge"), close.near_edge.as_ref())?;
            row(out, &format!("  within {near:.2} of a junction"), close.near_junction.as_ref())?;
        }
    }
    let reach = found.pairs.iter().map(|p| p.disturbed_reach).fold(0.0, f64::max);
    if reach > 0.0 {
        writeln!(out, "\nerrors above {DISTURBED} voxel reach {reach:.2} voxels from the junction curves")?;
    }
    if let Some(junctions) = &found.junctions {
        writeln!(
            out,
            "\njunction curves: {:.2} mm in the mesh, {:.2} mm in the truth",
            junctions.mesh_length, junctions.truth_length
        )?;
        if junctions.touching_edges > 0 {
            let count = junctions.touching_edges;
            writeln!(out, "{count} edges where sheets of one interface touch are not counted")?;
        }
        for (title, curves) in [
            (String::new(), &junctions.all),
            (format!("wedges of {NARROW} degrees and more, "), &junctions.plain),
            (format!("wedges below {NARROW} degrees, "), &junctions.narrow),
            (format!("radius below {TIGHT}, "), &junctions.tight),
        ] {
            if title.is_empty() || curves.truth_to_mesh.is_some() {
                row(out, &format!("{title}mesh to truth"), curves.mesh_to_truth.as_ref())?;
                row(out, &format!("{title}truth to mesh"), curves.truth_to_mesh.as_ref())?;
            }
        }
        for (title, points) in [
            ("points of four materials", &junctions.points),
            ("ends and kinks of junction curves", &junctions.kinks),
        ] {
            if points.truth > 0 {
                row(out, &format!("{title}, {} missed", points.missed), points.distances.as_ref())?;
                row(out, "  to the nearest junction curve", points.to_curve.as_ref())?;
            }
        }
    }
    for edge in &found.edges {
        writeln!(
            out,
            "\nsharp edges of {}/{}: {:.2} mm in the truth, {:.2} mm of folds above {CREASE} degrees in the mesh",
            name(edge.back),
            name(edge.front),
            edge.truth_length,
            edge.crease_length
        )?;
        row(out, "true edge to surface", edge.to_surface.as_ref())?;
        row(out, "  clear of corners and junctions", edge.to_surface_clear.as_ref())?;
        row(out, "true edge to an edge of the mesh", edge.to_mesh_edge.as_ref())?;
        row(out, "  clear of corners and junctions", edge.to_mesh_edge_clear.as_ref())?;
        row(out, "folds of the mesh to true edges", edge.crease_to_edge.as_ref())?;
        row(out, &format!("right angles, {near:.2} off ends, to surface"), edge.right.off_ends.as_ref())?;
        row(out, "  within that of corners and junctions", edge.right.at_ends.as_ref())?;
    }
    print_parts(found, &name, out)?;
    writeln!(
        out,
        "\n{:<20} {:>14} {:>14} {:>10}   {:<22} {:<22}",
        "material", "volume mm³", "exact mm³", "error %", "components (expected)", "Euler (expected)"
    )?;
    for m in &found.materials {
        let number = |v: Option<f64>, digits: usize| v.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
        let figures = |got: i64, expected: i64| {
            format!("{got} ({expected}){}", if got == expected { "" } else { "  WRONG" })
        };
        let error = m.volume_error_percent.map_or("-".to_owned(), |e| format!("{e:+.4}"));
        writeln!(
            out,
            "{:<20} {:>14} {:>14} {error:>10}   {:<22} {:<22}",
            m.name,
            number(m.volume, 3),
            number(m.exact_volume, 3),
            figures(m.topology.components as i64, m.expected.components as i64),
            figures(m.topology.euler, m.expected.euler),
        )?;
    }
    let tallies = &found.false_triangles;
    writeln!(out, "\nfalse triangles")?;
    for (title, tally) in [
        (format!("within {clear:.2} of a junction"), tallies.near),
        ("beyond".to_owned(), tallies.clear),
        ("of these, of a pair that does not meet".to_owned(), tallies.wrong_pair),
    ] {
        writeln!(
            out,
            "{title:<40} {:>9} triangles, {:.3} mm², {:.4} % of the area",
            tally.triangles, tally.area, tally.share_percent
        )?;
    }
    Ok(())
}

/// Spheres, thin parts, rounded edges and standard deviations, where there are any.
fn print_parts<'a>(
    found: &Comparison,
    name: &impl Fn(u8) -> &'a str,
    out: &mut impl Write,
) -> std::io::Result<()> {
    for sphere in &found.spheres {
        let title = format!("sphere of {} in {}", name(sphere.inside), name(sphere.outside));
        let exact = sphere.exact_radius / found.voxel_mm;
        match &sphere.fit {
            None => writeln!(out, "\n{title}, radius {exact:.3}: MISSING in the mesh")?,
            Some(fit) => writeln!(
                out,
                "\n{title}, radius {exact:.3}: by least squares {:+.4}, centre {:.4} off, form {:.4} RMS",
                fit.radius_error, fit.centre_error, fit.form
            )?,
        }
    }
    if let Some(thin) = &found.thickness {
        writeln!(out, "\nthickness {}: present in {:.2} % of its area", thin.exact, thin.present_percent)?;
        row(out, "thickness of the mesh, too large by", thin.error.as_ref())?;
    }
    for fillet in &found.fillets {
        row(out, &format!("\nrounded edges of radius {:.2}", fillet.radius), fillet.to_mesh.as_ref())?;
    }
    let stray: f64 = found.edges.iter().map(|e| e.stray_crease_length).sum();
    if stray > 0.0 {
        writeln!(out, "{stray:.2} mm of folds above {CREASE} degrees away from every true edge")?;
    }
    for coverage in &found.coverage {
        let title = coverage.pair.map_or("all".to_owned(), |[b, f]| format!("{}/{}", name(b), name(f)));
        for (group, covered) in [
            (title.as_str(), coverage.all),
            ("  clear", coverage.clear),
            ("  near a sharp edge", coverage.near_edge),
            ("  near a junction", coverage.near_junction),
        ] {
            if let Some(c) = covered {
                writeln!(
                    out,
                    "{group:<43} {:.1} % within sigma, {:.1} % within two; error / sigma {:.3} RMS; {} vertices",
                    c.within_1, c.within_2, c.rms, c.vertices
                )?;
            }
        }
    }
    Ok(())
}

fn row(out: &mut impl Write, title: &str, distances: Option<&Distances>) -> std::io::Result<()> {
    match distances {
        None => writeln!(out, "{title:<43} {:>9}", "-"),
        Some(d) => writeln!(
            out,
            "{title:<43} {:>+9.4} {:>8.4} {:>8.4} {:>8.4} {:>8.4} {:>9}",
            d.voxels.signed_mean, d.voxels.rms, d.voxels.p95, d.voxels.p99, d.voxels.max, d.samples
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom::PhantomOptions;

    #[test]
    fn an_empty_mesh_is_reported_as_missing_everything() {
        let phantom = Phantom::new(&PhantomOptions::default()).unwrap();
        let mesh = crate::mesh::InterfaceMesh::new(vec![], vec![], vec![], vec![], vec![]).unwrap();
        let found =
            compare(&mesh, &phantom, None, &CompareOptions::default(), &Execution::default()).unwrap();
        let mut text = Vec::new();
        print(&found, &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        for line in ["aluminium/air: MISSING", "iron/air: MISSING", "iron/aluminium: MISSING", "0 (1)  WRONG"]
        {
            assert!(text.contains(line), "{line} in\n{text}");
        }
    }
}
