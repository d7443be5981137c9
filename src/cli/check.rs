//! `interfacet check`.

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, bail};

use crate::execution::Execution;
use crate::export::{ReadOptions, read_mesh, write_atomically};
use crate::grid::MaterialId;
use crate::mesh::check::{EdgeDefect, Listed, TrianglePairDefect, VertexDefect};
use crate::mesh::{CheckOptions, MeshReport};

const EXAMPLES: &str = "\
Exit code: 0 if the mesh has no defects, 1 if it has some or cannot be read.

Examples:
  interfacet check result/assembly.ply
      is every shell closed and consistent, does anything intersect itself?
  interfacet check part.stl --json defects.json
      a mesh of another program; all defects with their places go into the file
";

/// Arguments of `interfacet check`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The mesh: PLY or STL, ascii or binary.
    mesh: PathBuf,
    /// Also write everything found as JSON to this file, or to standard output (-) instead of the text.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Face property of a PLY with the label behind a triangle [default: material_back].
    #[arg(long, value_name = "NAME", requires = "front")]
    back: Option<String>,
    /// Face property of a PLY with the label in front of a triangle [default: material_front].
    #[arg(long, value_name = "NAME", requires = "back")]
    front: Option<String>,
    /// Vertex property of a PLY with the vertex kind [default: kind].
    #[arg(long, value_name = "NAME")]
    kind: Option<String>,
    /// How many defects of each kind to list with their places.
    #[arg(long, value_name = "N", default_value_t = 100)]
    examples: usize,
}

/// Runs the command.
pub(crate) fn run(args: &Args, execution: &Execution) -> anyhow::Result<ExitCode> {
    let default = ReadOptions::default();
    let options = ReadOptions {
        back: args.back.clone().unwrap_or(default.back),
        front: args.front.clone().unwrap_or(default.front),
        kind: args.kind.clone().unwrap_or(default.kind),
        vertex_indices: default.vertex_indices,
    };
    let mesh = read_mesh(&args.mesh, &options)?;
    if mesh.triangles().is_empty() {
        // Saying "no defects" of nothing would let an empty result pass.
        bail!("{} holds no triangles: there is nothing to check", args.mesh.display());
    }
    let check = CheckOptions { examples: args.examples, ..CheckOptions::default() };
    let report = MeshReport::new(&mesh, &check, execution)?;
    let to_stdout = args.json.as_ref().is_some_and(|p| p.as_os_str() == "-");
    let written = if to_stdout {
        let mut out = io::stdout().lock();
        serde_json::to_writer_pretty(&mut out, &report).map_err(io::Error::from).and_then(|()| writeln!(out))
    } else {
        if let Some(path) = &args.json {
            write_atomically(path, |out| {
                serde_json::to_writer_pretty(&mut *out, &report).map_err(io::Error::from)?;
                writeln!(out)
            })?;
        }
        summary(&mut io::stdout().lock(), &report)
    };
    match written {
        // Whoever read the output has seen enough, as `head` does.
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => {}
        other => other.context("cannot write to standard output")?,
    }
    Ok(if report.defects.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// How many places of each defect the text shows; JSON has more.
const SHOWN: usize = 10;

fn summary(out: &mut impl Write, report: &MeshReport) -> io::Result<()> {
    let name = |id: MaterialId| match report.materials.iter().find(|m| m.id == id) {
        Some(m) => m.name.clone(),
        None if id == MaterialId::OUTSIDE => "outside".to_owned(),
        None => format!("material {}", id.0),
    };
    let m = &report.measures;
    writeln!(
        out,
        "{} vertices, {} triangles, {} materials",
        m.vertices,
        m.triangles,
        report.materials.len()
    )?;

    writeln!(out, "\nShells (each material's own closed surface)")?;
    writeln!(
        out,
        "  {:>3}  {:20} {:>9} {:>8} {:>8} {:>10} {:>6} {:>14} {:>14}",
        "id", "name", "triangles", "closed", "manifold", "components", "Euler", "area mm2", "volume mm3"
    )?;
    for shell in &m.shells {
        let state = report.defects.shells.iter().find(|s| s.material == shell.material);
        let yes = |b: Option<bool>| if b == Some(true) { "yes" } else { "NO" };
        writeln!(
            out,
            "  {:>3}  {:20} {:>9} {:>8} {:>8} {:>10} {:>6} {:>14.6} {:>14}",
            shell.material.0,
            name(shell.material),
            shell.triangles,
            yes(state.map(|s| s.closed)),
            yes(state.map(|s| s.manifold)),
            shell.components,
            shell.euler_characteristic,
            shell.area,
            shell.volume.map_or("-".to_owned(), |v| format!("{v:.6}")),
        )?;
    }

    writeln!(out, "\nInterfaces (behind | in front)")?;
    for pair in &m.pairs {
        let label = format!("{} | {}", name(pair.pair.back()), name(pair.pair.front()));
        writeln!(out, "  {label:40} {:>10} triangles {:>16.6} mm2", pair.triangles, pair.area)?;
    }

    junctions(out, report, &name)?;
    quality(out, report)?;
    defects(out, report, &name)
}

fn junctions(
    out: &mut impl Write,
    report: &MeshReport,
    name: &dyn Fn(MaterialId) -> String,
) -> io::Result<()> {
    let j = &report.junctions;
    writeln!(
        out,
        "\nJunctions: {} edges in {} curves of {:.6} mm, {} junction points; {} rim edges at the outside",
        j.edges,
        j.curves.len(),
        j.length,
        j.points.len(),
        j.rim_edges
    )?;
    for (triangles, edges) in &j.edges_by_triangles {
        writeln!(out, "  {edges} edges where {triangles} triangles meet")?;
    }
    let curve = |out: &mut dyn Write, c: &crate::mesh::JunctionCurve| {
        let names: Vec<_> = c.materials.iter().map(|&id| name(id)).collect();
        let ends = if c.closed { "closed" } else { "open" };
        writeln!(out, "  {}: {ends}, {} edges, {:.6} mm", names.join(" | "), c.edges, c.length)
    };
    for c in j.curves.iter().take(SHOWN) {
        curve(out, c)?;
    }
    more(out, j.curves.len() as u64, j.curves.len().min(SHOWN))?;
    let b = &j.boundaries;
    if b.edges > 0 {
        writeln!(
            out,
            "Boundaries: {} edges in {} closed loops and {} open curves, {:.6} mm",
            b.edges, b.loops, b.open_curves, b.length
        )?;
    }
    Ok(())
}

fn quality(out: &mut impl Write, report: &MeshReport) -> io::Result<()> {
    let q = &report.quality;
    if let (Some(minimum), Some(mean), Some(good), Some(angle)) =
        (q.minimum, q.mean, q.above_0_3_percent, q.smallest_angle)
    {
        writeln!(
            out,
            "\nTriangle quality q: minimum {minimum:.4}, mean {mean:.4}, {good:.2} % above 0.3; smallest angle {angle:.3} degrees"
        )?;
    }
    Ok(())
}

fn defects(out: &mut impl Write, report: &MeshReport, name: &dyn Fn(MaterialId) -> String) -> io::Result<()> {
    let d = &report.defects;
    if d.is_empty() {
        writeln!(out, "\nNo defects.")?;
    } else {
        writeln!(out, "\nDEFECTS: {}", d.total())?;
        for (kind, count) in d.by_kind().into_iter().filter(|k| k.1 > 0) {
            writeln!(out, "  {count} {kind}")?;
        }
    }
    edges(out, "Boundary edges", &d.boundary_edges, name)?;
    edges(out, "Edges with materials that do not match up", &d.alternation, name)?;
    edges(out, "Open edges of a shell", &d.open_edges, name)?;
    edges(out, "Non-manifold edges of a shell", &d.non_manifold_edges, name)?;
    edges(out, "Edges with inconsistent winding", &d.winding, name)?;
    vertices(out, "Non-manifold vertices of a shell", &d.non_manifold_vertices, name)?;
    let t = &d.degenerate_triangles;
    list(out, "Degenerate triangles", t, |out, t| {
        writeln!(out, "triangle {} at {}, vertices {:?}", t.triangle, place(t.corners[0]), t.vertices)
    })?;
    let both = |out: &mut dyn Write, p: &TrianglePairDefect| {
        let [a, b] = p.triangles;
        writeln!(out, "triangles {a} at {} and {b} at {}", place(p.centroids[0]), place(p.centroids[1]))
    };
    list(out, "Duplicate triangles", &d.duplicate_triangles, both)?;
    list(out, "Self-intersections", &d.self_intersections, both)?;
    vertices(out, "Note: vertices that no triangle uses", &d.unreferenced_vertices, name)
}

fn edges(
    out: &mut impl Write,
    title: &str,
    edges: &Listed<EdgeDefect>,
    name: &dyn Fn(MaterialId) -> String,
) -> io::Result<()> {
    list(out, title, edges, |out, e| {
        let [a, b] = e.vertices;
        write!(
            out,
            "edge {a}-{b} from {} to {}, triangles {:?}",
            place(e.ends[0]),
            place(e.ends[1]),
            e.triangles
        )?;
        shell(out, e.material, name)
    })
}

fn vertices(
    out: &mut impl Write,
    title: &str,
    vertices: &Listed<VertexDefect>,
    name: &dyn Fn(MaterialId) -> String,
) -> io::Result<()> {
    list(out, title, vertices, |out, v| {
        write!(out, "vertex {} at {}", v.vertex, place(v.position))?;
        if v.pieces > 0 {
            write!(out, ", {} pieces", v.pieces)?;
        }
        shell(out, v.material, name)
    })
}

/// Ends a line with the shell it is about.
fn shell(
    out: &mut dyn Write,
    material: Option<MaterialId>,
    name: &dyn Fn(MaterialId) -> String,
) -> io::Result<()> {
    match material {
        Some(id) => writeln!(out, ", shell of {}", name(id)),
        None => writeln!(out),
    }
}

fn list<T>(
    out: &mut impl Write,
    title: &str,
    all: &Listed<T>,
    mut line: impl FnMut(&mut dyn Write, &T) -> io::Result<()>,
) -> io::Result<()> {
    if all.is_empty() {
        return Ok(());
    }
    writeln!(out, "\n{title}: {}", all.count)?;
    let shown = all.first.len().min(SHOWN);
    for item in &all.first[..shown] {
        write!(out, "  ")?;
        line(out, item)?;
    }
    more(out, all.count, shown)
}

fn more(out: &mut impl Write, count: u64, shown: usize) -> io::Result<()> {
    if count > shown as u64 {
        writeln!(out, "  ... and {} more (see --json)", count - shown as u64)?;
    }
    Ok(())
}

fn place(p: [f64; 3]) -> String {
    format!("({:.6}, {:.6}, {:.6})", p[0], p[1], p[2])
}
