//! `interfacet extract`.

use std::process::ExitCode;

use crate::execution::Execution;

/// Arguments of `interfacet extract`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

/// Runs the command.
pub(crate) fn run(_args: &Args, _execution: &Execution) -> anyhow::Result<ExitCode> {
    anyhow::bail!("being written")
}
