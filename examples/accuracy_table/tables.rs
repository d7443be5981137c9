//! The tables, in Markdown.

use std::io::{self, Write};

use interfacet::phantom::compare::Covered;

use super::cases::{CONDITIONS, Role};
use super::metrics::TARGETS;
use super::run::{Found, Outcome};

/// How far a thin part's thickness may be off, voxels.
const THICKNESS: f64 = 0.15;
/// Shares of vertices within one and two standard deviations, and how far off they may be, percent.
const SHARES: [f64; 2] = [68.3, 95.4];
const OFF: f64 = 5.0;

fn head(out: &mut impl Write, title: &str, columns: &[&str]) -> io::Result<()> {
    writeln!(out, "\n## {title}\n\n| {} |", columns.join(" | "))?;
    writeln!(out, "|{}", "---|".repeat(columns.len()))
}

fn numbers(values: &[f64]) -> String {
    let all: Vec<String> = values.iter().map(|v| format!("{v:.3}")).collect();
    all.join(" / ")
}

fn optional(values: Option<&[f64]>) -> String {
    values.map_or("-".into(), numbers)
}

/// What a row starts with: object, condition and, where there are several, rotation and seed.
fn start(outcome: &Outcome) -> String {
    let [a, b, c] = outcome.phantom.rotation;
    let seed = outcome.phantom.seed;
    format!("{} | {} | {a}, {b}, {c} | {seed}", outcome.case.title(), CONDITIONS[outcome.column].title)
}

const START: [&str; 4] = ["object", "image", "rotation", "seed"];

fn of_role(outcomes: &[Outcome], role: Role) -> impl Iterator<Item = &Outcome> {
    outcomes.iter().filter(move |o| o.case.role == role)
}

fn topology(found: &Found) -> String {
    let wrong = found.comparison.materials.iter().filter(|m| m.topology != m.expected);
    let mut wrong: Vec<String> = wrong
        .map(|m| {
            let (t, e) = (m.topology, m.expected);
            format!("{} {}/{} for {}/{}", m.name, t.components, t.euler, e.components, e.euler)
        })
        .collect();
    if found.metrics.missing_interfaces > 0 {
        wrong.push(format!("{} interfaces missing", found.metrics.missing_interfaces));
    }
    if wrong.is_empty() { "right".into() } else { wrong.join("; ") }
}

/// The worst of all objects beside what is wanted; what is not reached is in bold and names its object.
pub(crate) fn summary(out: &mut impl Write, outcomes: &[Outcome]) -> io::Result<()> {
    let titles = CONDITIONS.map(|c| format!("{}: worst (wanted)", c.title));
    let mut columns = vec!["voxels"];
    columns.extend(titles.iter().map(String::as_str));
    head(out, "Worst of all objects, and what is wanted", &columns)?;
    for target in &TARGETS {
        write!(out, "| {}: {} |", target.title, target.figures.join(" / "))?;
        for (column, wanted) in target.wanted.iter().enumerate() {
            let values: Vec<(Vec<f64>, String)> = of_role(outcomes, Role::General)
                .filter(|o| o.column == column)
                .filter_map(|o| Some(((target.of)(&o.found.as_ref().ok()?.metrics)?, o.case.title())))
                .collect();
            let cells: Vec<String> = (0..target.figures.len())
                .filter_map(|k| {
                    let (values, title) = values.iter().max_by(|a, b| a.0[k].total_cmp(&b.0[k]))?;
                    let value = values[k];
                    Some(match wanted.get(k) {
                        Some(wanted) if value <= *wanted => format!("{value:.3} ({wanted})"),
                        Some(wanted) => format!("**{value:.3}** ({wanted}) {title}"),
                        None => format!("{value:.3} {title}"),
                    })
                })
                .collect();
            write!(out, " {} |", if cells.is_empty() { "-".into() } else { cells.join("; ") })?;
        }
        writeln!(out)?;
    }
    // An object that is lost spoils no figure above, so it is named here.
    write!(out, "| objects of which nothing was found |")?;
    for column in 0..CONDITIONS.len() {
        let lost: Vec<String> = of_role(outcomes, Role::General)
            .filter(|o| o.column == column && o.found.is_err())
            .map(|o| o.case.title())
            .collect();
        write!(
            out,
            " {} |",
            if lost.is_empty() { "none".into() } else { format!("**{}**", lost.join(", ")) }
        )?;
    }
    writeln!(out)
}

/// A row for each object and image.
pub(crate) fn details(out: &mut impl Write, outcomes: &[Outcome]) -> io::Result<()> {
    let mut columns = START.to_vec();
    columns.extend([
        "R",
        "triangles",
        "> 3 from junctions RMS / 99 % / max",
        "and from edges",
        "< 3 from junctions",
        "curves RMS / 95 % / max",
        "narrow wedges",
        "tight curves",
        "points RMS / max",
        "kinks RMS / max",
        "missed",
        "90 degree edges RMS / 99 % / max",
        "at their ends",
        "volume %",
        "radius of spheres",
        "components/Euler",
        "defects",
    ]);
    head(out, "Every object", &columns)?;
    for outcome in outcomes {
        let found = match &outcome.found {
            Err(error) => {
                writeln!(
                    out,
                    "| {} | {error}{} |",
                    start(outcome),
                    " |".repeat(columns.len() - START.len() - 1)
                )?;
                continue;
            }
            Ok(found) => found,
        };
        let m = &found.metrics;
        let cells = [
            format!("{:.2}", found.radius),
            found.triangles.to_string(),
            optional(m.away.as_ref().map(|f| &f[..])),
            optional(m.away_clear.as_ref().map(|f| &f[..])),
            optional(m.near_junction.as_ref().map(|f| &f[..])),
            optional(m.curve.as_ref().map(|f| &f[..])),
            optional(m.narrow_curve.as_ref().map(|f| &f[..])),
            optional(m.tight_curve.as_ref().map(|f| &f[..])),
            optional(m.points.as_ref().map(|f| &f[..])),
            optional(m.kinks.as_ref().map(|f| &f[..])),
            m.missed.to_string(),
            optional(m.right_edge.as_ref().map(|f| &f[..])),
            optional(m.right_edge_ends.as_ref().map(|f| &f[..])),
            optional(m.volume.as_ref().map(std::slice::from_ref)),
            optional(m.sphere.as_ref().map(std::slice::from_ref)),
            topology(found),
            found.defects.to_string(),
        ];
        writeln!(out, "| {} | {} |", start(outcome), cells.join(" | "))?;
    }
    Ok(())
}

/// Plates, gaps and layers.
pub(crate) fn thin_parts(out: &mut impl Write, outcomes: &[Outcome]) -> io::Result<()> {
    let mut columns = START.to_vec();
    columns.extend([
        "present %",
        "thickness: mean error / RMS / 95 % / max",
        "components/Euler",
        "as wanted",
    ]);
    let mut rows = of_role(outcomes, Role::Thin).peekable();
    if rows.peek().is_none() {
        return Ok(());
    }
    head(out, "Thin parts (thickness within 0.15, right topology)", &columns)?;
    for outcome in rows {
        let found = match &outcome.found {
            Err(error) => {
                writeln!(out, "| {} | 0 | - | {error} | **no** |", start(outcome))?;
                continue;
            }
            Ok(found) => found,
        };
        let thin = found.comparison.thickness;
        let error = thin.and_then(|t| t.error).map(|d| d.voxels);
        let figures = error.map(|f| [f.signed_mean, f.rms, f.p95, f.max]);
        let good = found.metrics.right_topology
            && thin.is_some_and(|t| t.present_percent > 99.9)
            && error.is_some_and(|f| f.p95 <= THICKNESS);
        writeln!(
            out,
            "| {} | {} | {} | {} | {} |",
            start(outcome),
            thin.map_or("-".into(), |t| format!("{:.2}", t.present_percent)),
            optional(figures.as_ref().map(|f| &f[..])),
            topology(found),
            if good { "yes" } else { "**no**" },
        )?;
    }
    Ok(())
}

/// Pores and iron balls.
pub(crate) fn small_spheres(out: &mut impl Write, outcomes: &[Outcome]) -> io::Result<()> {
    let mut rows = of_role(outcomes, Role::Small).peekable();
    if rows.peek().is_none() {
        return Ok(());
    }
    let mut columns = START.to_vec();
    columns.extend(["sphere", "radius", "radius error", "centre error", "form RMS", "parts"]);
    head(out, "Pores and inclusions", &columns)?;
    for outcome in rows {
        let found = match &outcome.found {
            Err(error) => {
                writeln!(out, "| {} | {error} | | | | | |", start(outcome))?;
                continue;
            }
            Ok(found) => found,
        };
        let materials = &found.comparison.materials;
        let name = |id: u8| materials.get(usize::from(id)).map_or("?", |m| m.name.as_str());
        for sphere in &found.comparison.spheres {
            let figures = sphere.fit.map(|fit| [fit.radius_error, fit.centre_error, fit.form]);
            writeln!(
                out,
                "| {} | {} in {} | {:.1} | {} | {} |",
                start(outcome),
                name(sphere.inside),
                name(sphere.outside),
                sphere.exact_radius / found.comparison.voxel_mm,
                figures.map_or("**missing** | |".into(), |f| f.map(|v| format!("{v:.3}")).join(" | ")),
                sphere.parts,
            )?;
        }
    }
    Ok(())
}

/// Rounded edges.
pub(crate) fn fillets(out: &mut impl Write, outcomes: &[Outcome]) -> io::Result<()> {
    let mut rows = of_role(outcomes, Role::Fillet).peekable();
    if rows.peek().is_none() {
        return Ok(());
    }
    let mut columns = START.to_vec();
    columns.extend([
        "mean / RMS / 99 % / max from the rounding to the mesh",
        "a sharp edge would be off by",
        "folds above 45 degrees off every true edge, mm, of a rounding's length",
    ]);
    head(out, "Rounded edges (must not become sharp)", &columns)?;
    for outcome in rows {
        let Ok(found) = &outcome.found else { continue };
        let stray: f64 = found.comparison.edges.iter().map(|e| e.stray_crease_length).sum();
        for fillet in &found.comparison.fillets {
            let figures = fillet.to_mesh.map(|d| d.voxels).map(|f| [f.signed_mean, f.rms, f.p99, f.max]);
            writeln!(
                out,
                "| {} | {} | {:.3} | {stray:.1} of {:.1} |",
                start(outcome),
                optional(figures.as_ref().map(|f| &f[..])),
                (1.0 - 0.5_f64.sqrt()) * fillet.radius,
                fillet.length,
            )?;
        }
    }
    Ok(())
}

/// Shares of vertices whose errors are within their standard deviations, if the meshes state any.
pub(crate) fn coverage(out: &mut impl Write, outcomes: &[Outcome]) -> io::Result<()> {
    let mut rows = outcomes
        .iter()
        .filter_map(|o| Some((o, o.found.as_ref().ok()?.comparison.coverage.first()?)))
        .peekable();
    if rows.peek().is_none() {
        return Ok(());
    }
    let mut columns = START.to_vec();
    columns.extend(["all", "clear", "near a sharp edge", "near a junction", "vertices without"]);
    head(
        out,
        "Standard deviations: within one % / within two % / RMS of error in them (wanted: 68 / 95 +- 5)",
        &columns,
    )?;
    for (outcome, coverage) in rows {
        let groups = [coverage.all, coverage.clear, coverage.near_edge, coverage.near_junction].map(covered);
        writeln!(out, "| {} | {} | {} |", start(outcome), groups.join(" | "), coverage.without)?;
    }
    Ok(())
}

fn covered(group: Option<Covered>) -> String {
    let Some(c) = group else { return "-".into() };
    let shares = [c.within_1, c.within_2];
    let good = shares.iter().zip(SHARES).all(|(found, wanted)| (found - wanted).abs() <= OFF);
    let mark = if good { "" } else { "**" };
    format!("{mark}{:.1} / {:.1} / {:.2}{mark}", c.within_1, c.within_2, c.rms)
}
