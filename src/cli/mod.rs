//! The command line: a client of the public API. One file per command.

mod check;
mod compare;
mod extract;
mod failure;
mod info;
mod input;
mod interrupt;
mod phantom;
mod progress;
mod render;
mod residual;
mod summary;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::execution::Execution;

const FIRST_STEPS: &str = "\
First steps:
  interfacet info part.mha                     what is in the volume
  interfacet extract part.mha --out result     the mesh, a report and a picture
  interfacet check result/assembly.ply         is the mesh sound?
No scan at hand? `interfacet phantom press-fit-ring --out part.mha` makes one.

Each command has its own help with examples: interfacet extract --help.
Exit codes: 0 done; 1 failed, or the mesh has defects; 2 bad arguments; 130 interrupted.
Whatever goes wrong, an output is whole or not there, and an earlier one stays.";

/// Labelled multi-material surface meshes from industrial CT volumes.
#[derive(Debug, Parser)]
#[command(name = "interfacet", version, about, after_help = FIRST_STEPS, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Turn a CT volume into a labelled mesh, one closed mesh per material, and a report.
    Extract(Box<extract::Args>),
    /// Show what a volume holds: geometry, grey values, histogram, materials.
    Info(info::Args),
    /// Check a mesh and list every defect with its place.
    Check(check::Args),
    /// Make a test volume of an object with known geometry.
    Phantom(phantom::Args),
    /// Measure a mesh against the exact geometry of a phantom.
    Compare(compare::Args),
    /// Compare a mesh, blurred as the scan is, with the scan's grey values.
    Residual(Box<residual::Args>),
    /// Draw a mesh, or a slice of a volume with the mesh's outline, to a PNG picture.
    Render(render::Args),
}

/// Parses the arguments, runs the command, and reports a failure with its causes.
///
/// Exit codes: 0 done; 1 the command failed, or found defects; 2 bad arguments; 130 interrupted.
#[must_use]
#[allow(clippy::print_stderr)] // the one place that reports an error to a person
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let execution = Execution::new(progress::for_terminal());
    interrupt::install(execution.cancel_flag());
    let outcome = cli.run(&execution);
    execution.plan(&[]);
    match outcome {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {}", failure::message(&error));
            if execution.is_cancelled() { interrupt::EXIT_CODE.into() } else { ExitCode::FAILURE }
        }
    }
}

impl Cli {
    /// Runs the command.
    ///
    /// # Errors
    /// Whatever stopped it, with its causes.
    pub fn run(self, execution: &Execution) -> anyhow::Result<ExitCode> {
        match self.command {
            Command::Extract(args) => extract::run(&args, execution),
            Command::Info(args) => info::run(&args, execution),
            Command::Check(args) => check::run(&args, execution),
            Command::Phantom(args) => phantom::run(&args, execution),
            Command::Compare(args) => compare::run(&args, execution),
            Command::Residual(args) => residual::run(&args, execution),
            Command::Render(args) => render::run(&args, execution),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_well_formed() {
        Cli::command().debug_assert();
    }
}
