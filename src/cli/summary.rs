//! What `extract` says at the end.

use std::io::{self, Write};
use std::path::Path;

use crate::contour::Border;
use crate::contour::dual::{Bound, Statistics};
use crate::pipeline::DenoiseFound;
use crate::report::RunReport;

/// What a person wants to know at once.
pub(super) fn summary(out: &mut impl Write, folder: &Path, report: &RunReport) -> io::Result<()> {
    let [x, y, z] = report.input.geometry.size();
    let [sx, sy, sz] = report.input.geometry.spacing();
    writeln!(out, "{x} x {y} x {z} voxels of {sx} x {sy} x {sz} mm")?;
    writeln!(out, "\n  id  material              grey      volume mm³  components   Euler")?;
    for m in &report.materials {
        let (id, name, grey) = (m.material.id.0, &m.material.name, m.material.mean);
        let number = |n: Option<String>| n.unwrap_or_else(|| "-".into());
        writeln!(
            out,
            "  {id:>2}  {name:<16} {grey:>9.6} {:>15} {:>11} {:>7}",
            number(m.mesh_volume.map(|v| format!("{v:.3}"))),
            number(m.components.map(|c| c.to_string())),
            number(m.euler_characteristic.map(|e| e.to_string())),
        )?;
    }
    writeln!(out, "\n  interface                              triangles        area mm²")?;
    for p in &report.pairs {
        let pair = format!("{} | {}", p.back, p.front);
        writeln!(out, "  {pair:<36} {:>11} {:>15.3}", p.triangles, p.area)?;
    }
    let n = &report.non_manifold_edges;
    writeln!(
        out,
        "\n{} triangles; {} non-manifold edges in {} junction curves ({:.3} mm), {} junction points, {} boundary edges",
        report.triangles,
        n.edges,
        n.curves.len(),
        n.length,
        n.junction_points,
        n.boundary_edges
    )?;
    if let Some(dual) = &report.dual {
        simplification(out, dual)?;
    }
    if let Some(blur) = &report.blur {
        let [rx, ry, rz] = blur.radius;
        writeln!(out, "blur radius R {rx:.2} x {ry:.2} x {rz:.2} voxels")?;
        if let Some(axes) = blur.sigma_axes_mm {
            let [x, y, z] = std::array::from_fn(|a| axes[a] / report.input.geometry.spacing()[a]);
            writeln!(out, "blur sigma {x:.2} x {y:.2} x {z:.2} voxels along the axes")?;
        }
    }
    if let Some(DenoiseFound { used, noise_before, noise_after }) = &report.denoise {
        writeln!(out, "noise {noise_before:.3} before and {noise_after:.3} after {used}")?;
    }
    if let Some(iso) = &report.iso {
        let found = iso.otsu_mode.as_ref().map_or_else(String::new, |mode| {
            format!(
                ", the mode of {} slices' Otsu thresholds ({} agree; {} slices have no two classes)",
                mode.with_two_classes,
                mode.agreeing,
                mode.slices - mode.with_two_classes
            )
        });
        writeln!(out, "iso value {}{found}", iso.grey)?;
    }
    match (report.unexpected_defects, report.options.border) {
        (0, Border::Closed) => writeln!(out, "no defects")?,
        (0, Border::Open) => {
            writeln!(out, "no defects; the border is open along {} edges", n.boundary_edges)?
        }
        (n, _) => writeln!(out, "{n} DEFECTS: see report.json")?,
    }
    for warning in report.input.notes.iter().chain(&report.warnings) {
        writeln!(out, "note: {warning}")?;
    }
    let seconds = report.costs.total_seconds();
    writeln!(out, "{seconds:.1} s; results in {}", folder.display())
}

/// The line on adaptive dual contouring.
fn simplification(out: &mut impl Write, dual: &Statistics) -> io::Result<()> {
    let bound = match dual.bound {
        Bound::None => return writeln!(out, "not simplified"),
        Bound::Rms(rms) => format!("tolerance {rms:.3} voxel"),
        Bound::Sum(sum) => format!("phi {sum} square voxels"),
        Bound::Triangles(count) => format!("{count} triangles wanted"),
    };
    write!(out, "simplified by {:.1} % ({bound})", dual.simplification_percent)?;
    if let Some(deviation) = dual.deviation {
        let (rms, most) = (deviation.rms, deviation.maximum);
        write!(out, "; {rms:.3} voxel from the unsimplified surface (RMS), {most:.2} at most")?;
    }
    writeln!(out)
}
