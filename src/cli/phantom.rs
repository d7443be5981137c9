//! `interfacet phantom`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crate::execution::Execution;
use crate::export::metaimage::{self, MetaImageOptions};
use crate::export::write_atomically;
use crate::phantom::{Noise, Phantom, PhantomOptions, SceneName, Sidecar};
use crate::volume::SampleType;

/// What defines the object's geometry; shared with `interfacet compare`.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Object")]
pub(super) struct ObjectArgs {
    /// Voxels per axis: one number, or X,Y,Z.
    #[arg(long, value_name = "N|X,Y,Z", default_value = "96", value_parser = one_or_three::<usize>)]
    size: [usize; 3],
    /// Voxel spacing in mm: one number, or X,Y,Z.
    #[arg(long, value_name = "MM|X,Y,Z", default_value = "1", value_parser = one_or_three::<f64>)]
    spacing: [f64; 3],
    /// Rotation about the x, then y, then z axis in degrees.
    #[arg(long, value_name = "A,B,C", default_value = "7.3,11.9,4.1", value_parser = three, allow_hyphen_values = true)]
    rotate: [f64; 3],
    /// Shift of the object from the volume's middle in voxels.
    #[arg(long, value_name = "X,Y,Z", default_value = "0.31,-0.17,0.23", value_parser = three, allow_hyphen_values = true)]
    shift: [f64; 3],
    /// Share of the volume's shortest side that the rotated object takes up.
    #[arg(long, value_name = "SHARE", default_value_t = 0.75)]
    fill: f64,
    /// Thickness of the thin part or gap of thin-plate, thin-gap and thin-layer in voxels.
    #[arg(long, value_name = "VOXELS", default_value_t = 4.0)]
    thickness: f64,
    /// Degrees of the aluminium wedge of wedge.
    #[arg(long, value_name = "DEGREES", default_value_t = 60.0)]
    angle: f64,
    /// Radius of the rounded edges of fillet in voxels.
    #[arg(long, value_name = "VOXELS", default_value_t = 3.0)]
    fillet: f64,
    /// Edges of the box of cube in voxels, before it is turned, instead of --fill: one number, or X,Y,Z.
    #[arg(long, value_name = "N|X,Y,Z", value_parser = one_or_three::<f64>, conflicts_with = "fill")]
    extent: Option<[f64; 3]>,
}

impl ObjectArgs {
    /// Options with this geometry; everything else as by default.
    pub(super) fn options(&self, scene: SceneName) -> PhantomOptions {
        PhantomOptions {
            scene,
            size: self.size,
            spacing: self.spacing,
            rotation: self.rotate,
            shift: self.shift,
            fill: self.fill,
            thickness: self.thickness,
            angle: self.angle,
            fillet: self.fillet,
            extent: self.extent,
            ..PhantomOptions::default()
        }
    }
}

const EXAMPLES: &str = "\
Examples:
  interfacet phantom press-fit-ring --out part.mha
      writes part.mha, and the exact geometry to part.phantom.json
  interfacet phantom thin-plate --thickness 2.5 --size 128 --noise 3 --out plate.mha
  interfacet phantom wedge --angle 30 --noise 2 --noise-correlation 0.8 --out wedge.mha
      a bar of aluminium that tapers to 30 degrees where it meets iron and air, in noise as of a reconstruction
  interfacet phantom cube --extent 40,40,20 --rotate 0,0,0 --shift 0,0,0 --binary --out cube.mha
      a box whose faces lie on voxel boundaries, of two grey values only
  interfacet phantom --list
";

/// Arguments of `interfacet phantom`.
#[derive(Debug, clap::Args)]
#[command(after_help = after_help(), after_long_help = format!("{EXAMPLES}\n{}", list()))]
pub(crate) struct Args {
    /// The object; --list says what there is.
    #[arg(value_name = "NAME", required_unless_present = "list")]
    name: Option<SceneName>,
    /// The volume to write, .mha or .mhd; NAME.phantom.json with the truth is written beside it.
    #[arg(short, long, value_name = "FILE", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// List the objects and what they show.
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    object: Box<ObjectArgs>,
    #[command(flatten)]
    image: Box<ImageArgs>,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Image")]
struct ImageArgs {
    /// Sigma of the Gaussian blur in voxels: one number (the same length in mm in every direction), or per axis X,Y,Z.
    /// 0: the share of each material in a voxel, no blur.
    #[arg(long, visible_alias = "blur", value_name = "S|X,Y,Z", default_value = "1.15", value_parser = one_to_three)]
    sigma: Sigma,
    /// Give every voxel the grey value of the material at its centre: neither area sampling nor blur.
    /// Noise is still added: see --noise.
    #[arg(long, conflicts_with_all = ["sigma", "fine"])]
    binary: bool,
    /// Noise in percent of the smallest difference between two materials.
    #[arg(long, value_name = "PERCENT", default_value_t = 1.0)]
    noise: f64,
    /// Noise as a grey value instead.
    #[arg(long, value_name = "GREY", conflicts_with = "noise")]
    noise_grey: Option<f64>,
    /// Filter the noise by a Gaussian of this sigma in voxels, and bring it back to its strength. 0: white noise.
    #[arg(long, value_name = "SIGMA", default_value_t = 0.0)]
    noise_correlation: f64,
    /// Seed of the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Cupping: how much darker materials are in the middle than outside (0.1: ten percent).
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    cupping: f64,
    /// Number type of the voxels.
    #[arg(long = "type", value_name = "TYPE", default_value = "u16", value_parser = sample_type)]
    sample_type: SampleType,
    /// Grey values of the materials, the background first [default: 4000, 11600, (22000,) 40000].
    #[arg(long, value_name = "GREY,...", value_delimiter = ',')]
    greys: Option<Vec<f64>>,
    /// How many times finer per axis the grid is on which the object is blurred.
    #[arg(long, value_name = "N", default_value_t = 3)]
    fine: usize,
    /// Do not compress the voxels.
    #[arg(long)]
    uncompressed: bool,
}

#[derive(Debug, Clone, Copy)]
enum Sigma {
    Isotropic(f64),
    Axes([f64; 3]),
}

fn numbers<T: std::str::FromStr>(text: &str) -> Result<Vec<T>, String> {
    text.split(',')
        .map(|part| part.trim().parse().map_err(|_| format!("'{part}' is not a number of the right kind")))
        .collect()
}

fn one_or_three<T: std::str::FromStr + Copy>(text: &str) -> Result<[T; 3], String> {
    match numbers(text)?[..] {
        [x] => Ok([x; 3]),
        [x, y, z] => Ok([x, y, z]),
        _ => Err("one number or three, separated by commas".to_owned()),
    }
}

fn three(text: &str) -> Result<[f64; 3], String> {
    match numbers(text)?[..] {
        [x, y, z] => Ok([x, y, z]),
        _ => Err("three numbers, separated by commas".to_owned()),
    }
}

fn one_to_three(text: &str) -> Result<Sigma, String> {
    match numbers(text)?[..] {
        [s] => Ok(Sigma::Isotropic(s)),
        [x, y, z] => Ok(Sigma::Axes([x, y, z])),
        _ => Err("one number or three, separated by commas".to_owned()),
    }
}

fn sample_type(text: &str) -> Result<SampleType, String> {
    match text {
        "u8" => Ok(SampleType::U8),
        "u16" => Ok(SampleType::U16),
        "i16" => Ok(SampleType::I16),
        "f32" => Ok(SampleType::F32),
        _ => Err("one of u8, u16, i16, f32".to_owned()),
    }
}

fn after_help() -> String {
    let names: Vec<_> = SceneName::ALL.iter().map(|s| s.name()).collect();
    format!("{EXAMPLES}\nObjects: {}. --list says what they show.", names.join(", "))
}

fn list() -> String {
    use std::fmt::Write;
    let mut text = String::from("Objects:\n");
    for scene in SceneName::ALL {
        let materials: Vec<_> = scene.materials().iter().map(|(n, g)| format!("{n} {g}")).collect();
        // Writing to a string cannot fail.
        let _ = writeln!(text, "\n{}\n  {}", scene.name(), scene.description());
        let _ = writeln!(text, "  Grey values: {}.", materials.join(", "));
        let shells: Vec<_> = scene
            .topology()
            .iter()
            .zip(scene.materials())
            .map(|(t, (name, _))| format!("{name} {} / {}", t.components, t.euler))
            .collect();
        let _ = writeln!(text, "  Shells (components / Euler characteristic): {}.", shells.join(", "));
    }
    text
}

/// Runs the command.
pub(crate) fn run(args: &Args, execution: &Execution) -> anyhow::Result<ExitCode> {
    let mut stdout = std::io::stdout().lock();
    let (false, Some(name), Some(out)) = (args.list, args.name, &args.out) else {
        write!(stdout, "{}", list())?;
        return Ok(ExitCode::SUCCESS);
    };
    let image = &args.image;
    let mut options = args.object.options(name);
    match image.sigma {
        Sigma::Isotropic(sigma) => options.sigma = sigma,
        Sigma::Axes(axes) => options.sigma_axes = Some(axes),
    }
    options.noise = image.noise_grey.map_or(Noise::Percent(image.noise), Noise::Grey);
    options.noise_correlation = image.noise_correlation;
    options.seed = image.seed;
    options.cupping = image.cupping;
    options.sample_type = image.sample_type;
    options.greys.clone_from(&image.greys);
    options.fine = image.fine;
    options.binary = image.binary;

    let phantom = Phantom::new(&options)?;
    let samples = phantom.rasterise(execution)?;
    let written = MetaImageOptions { compress: !image.uncompressed };
    metaimage::write(out, phantom.geometry(), &samples, &written)?;
    let truth = sidecar_path(out);
    let text = Sidecar::new(&phantom).to_json()?;
    write_atomically(&truth, |file| file.write_all(text.as_bytes()))?;

    writeln!(stdout, "{}: {}", name.name(), name.description())?;
    for (material, topology) in phantom.materials().materials().iter().zip(phantom.truth().topology()) {
        let volume =
            phantom.truth().volume(material.id).map_or_else(String::new, |v| format!(", {v:.3} mm³"));
        writeln!(
            stdout,
            "  material {} {}: grey {}{volume}; shell of {} component(s), Euler characteristic {}",
            material.id.0, material.name, material.mean, topology.components, topology.euler
        )?;
    }
    writeln!(stdout, "wrote {} and {}", out.display(), truth.display())?;
    Ok(ExitCode::SUCCESS)
}

/// Where the truth of a volume is written: `part.mha` gets `part.phantom.json`.
fn sidecar_path(volume: &Path) -> PathBuf {
    volume.with_extension("phantom.json")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_number_stands_for_three_and_the_list_names_every_scene() {
        assert_eq!(one_or_three::<usize>("64"), Ok([64; 3]));
        assert_eq!(one_or_three::<f64>("1, 2,0.5"), Ok([1.0, 2.0, 0.5]));
        assert!(one_or_three::<usize>("1,2").is_err() && one_or_three::<usize>("-1").is_err());
        assert!(three("1,2,x").is_err());
        assert!(SceneName::ALL.iter().all(|s| list().contains(&format!("\n{}\n", s.name()))));
        assert_eq!(sidecar_path(Path::new("a/part.mha")), Path::new("a/part.phantom.json"));
    }
}
