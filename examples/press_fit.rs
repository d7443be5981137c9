//! The pipeline as a library: makes a phantom of a press-fit ring, extracts its surface and says
//! what meets what. `cargo run --release --example press_fit`

#![allow(clippy::print_stdout)] // an example talks

use std::error::Error;

use interfacet::mesh::{CheckOptions, MeshReport};
use interfacet::phantom::{Phantom, PhantomOptions, SceneName};
use interfacet::{Execution, MemorySource, PipelineOptions, extract};

fn main() -> Result<(), Box<dyn Error>> {
    let execution = Execution::default();
    let options =
        PhantomOptions { scene: SceneName::PressFitRing, size: [64; 3], ..PhantomOptions::default() };
    let phantom = Phantom::new(&options)?;
    let samples = phantom.rasterise(&execution)?;
    let source = MemorySource::new(phantom.geometry().clone(), samples)?;

    let extraction = extract(&source, &PipelineOptions::default(), &execution)?;
    let report = MeshReport::new(&extraction.mesh, &CheckOptions::default(), &execution)?;

    for shell in &report.measures.shells {
        let name = extraction.findings.materials.get(shell.material).map_or("?", |m| m.name.as_str());
        println!("{name}: {} piece(s), {:.1} mm³", shell.components, shell.volume.unwrap_or(0.0));
    }
    println!("{} junction curves, {:.1} mm", report.junctions.curves.len(), report.junctions.length);
    println!("{} defects", report.defects.total());
    Ok(())
}
