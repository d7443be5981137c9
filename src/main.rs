//! The `interfacet` command line.

use std::process::ExitCode;

fn main() -> ExitCode {
    interfacet::cli::main()
}
