//! Filters a volume, says how much noise there was before and after and how long it took, and writes the
//! filtered volume to look at: `cargo run --release --example denoise -- part.mha bilateral out.mha`. Without a
//! file to write it only measures; several filters may be given, separated by blanks.

#![allow(clippy::print_stdout)] // an example talks

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use interfacet::export::metaimage::{self, MetaImageOptions};
use interfacet::material::read_noise;
use interfacet::volume::{Denoise, Denoised, OpenOptions, open};
use interfacet::{Execution, MemorySource, VolumeSource};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, filters, out @ ..] = &arguments[..] else {
        return Err("give a volume, a filter such as bilateral, and perhaps a file to write".into());
    };
    let execution = Execution::default();
    let file = open(Path::new(input), &OpenOptions::default())?;
    let source = MemorySource::new(file.geometry().clone(), file.read_all()?)?;
    let started = Instant::now();
    let before = read_noise(&source, &execution)?;
    println!("noise {before:.3}, found in {:.2} s", started.elapsed().as_secs_f64());
    for filter in filters.split(' ') {
        let started = Instant::now();
        let denoised = Denoised::new(&source, filter.parse::<Denoise>()?.with_noise(before))?;
        let stage = execution.stage("removing noise", source.geometry().size()[2] as u64);
        let clean = denoised.in_memory(&execution, &stage)?;
        let seconds = started.elapsed().as_secs_f64();
        println!("{}: noise {:.3}, {seconds:.2} s", denoised.denoise(), read_noise(&clean, &execution)?);
        if let Some(out) = out.first() {
            metaimage::write(
                Path::new(out),
                clean.geometry(),
                &clean.read_all()?,
                &MetaImageOptions::default(),
            )?;
        }
    }
    Ok(())
}
