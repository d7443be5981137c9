//! Makes phantoms, extracts their surfaces and prints in Markdown how far these are from the exact geometry, beside
//! what is wanted:
//!
//! ```text
//! cargo run --release --example accuracy_table
//! cargo run --release --example accuracy_table -- --held-out --method dual --json held_out.json
//! ```
//!
//! A method is tuned on the default objects, rotations and seeds, and judged by those of `--held-out`. Nothing is written
//! to disk but the file of `--json`, which has every figure of every comparison.

mod cases;
mod metrics;
mod options;
mod run;
mod tables;

use std::io::Write;

use anyhow::Context;
use clap::Parser;

use cases::{CONDITIONS, Case};
use options::Args;
use run::Outcome;

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let pipeline = options::options(&args)?;
    let wanted = |case: &&Case| args.scene.is_empty() || args.scene.contains(&case.scene);
    let all = if args.held_out { cases::held_out() } else { cases::tuning() };
    let mut outcomes: Vec<Outcome> = Vec::new();
    for case in all.iter().filter(wanted) {
        for (column, condition) in CONDITIONS.iter().enumerate() {
            if args.column.is_some_and(|only| only != column + 1) {
                continue;
            }
            for rotation in args.rotations()? {
                for seed in args.seeds() {
                    let phantom = args.phantom(case, condition, rotation, seed);
                    let outcome = run::run(case, column, &phantom, &pipeline)?;
                    let line = format!("{} ({}), seed {seed}", case.title(), condition.title);
                    writeln!(std::io::stderr(), "{line}: {:.1} s", outcome.seconds)?;
                    outcomes.push(outcome);
                }
            }
        }
    }
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}\n", args.title())?;
    tables::summary(&mut out, &outcomes)?;
    tables::details(&mut out, &outcomes)?;
    tables::thin_parts(&mut out, &outcomes)?;
    tables::small_spheres(&mut out, &outcomes)?;
    tables::fillets(&mut out, &outcomes)?;
    tables::coverage(&mut out, &outcomes)?;
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&serde_json::json!({
            "title": args.title(),
            "pipeline": pipeline,
            "conditions": CONDITIONS,
            "targets": metrics::TARGETS,
            "runs": outcomes,
        }))?;
        std::fs::write(path, text + "\n").with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}
