//! `interfacet extract`.

use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;

use anyhow::{Context, anyhow, bail};
use bytesize::ByteSize;
use clap::ValueEnum;
use serde::Deserialize;

use super::failure;
use super::input::InputArgs;
use super::summary;
use crate::contour::dual::Placement;
use crate::contour::{Border, NormalRule};
use crate::execution::{Execution, available_memory};
use crate::export::StagedFolder;
use crate::mesh::CheckOptions;
use crate::pipeline::{
    Accuracy, DualMethod, IsoValue, MaterialChoice, Method, NamedGrey, PipelineOptions, Threshold, Tolerance,
    extract_into,
};
use crate::report::{InputReport, ResultWriter};
use crate::volume::Denoise;

const EXAMPLES: &str = "\
Filters for --denoise, with the defaults of their parameters. Lengths are in voxels of mean edge
length, or in millimetres as in 0.05mm; greys in grey values.
  bilateral:sigma=1,grey=3*NOISE   keeps edges: the usual choice. sigma: how far it reaches;
                                   grey: differences that it takes for noise
  nlm:search=3,patch=1,grey=1.5*NOISE
                                   non-local means; keeps edges and texture, slow. search: radius
                                   of the search; patch: half the box that is compared
  median:radius=1.5                for specks; loses thin parts
  gaussian:sigma=1                 blurs edges as well
  mean:radius=1                    blurs edges as well
NOISE is the noise found in the volume, which report.json tells before and after.

Examples:
  interfacet extract part.mha --out result
      finds the materials by itself and writes into the folder result:
        assembly.ply            the labelled mesh of all interfaces
        materials/1_NAME.stl    the closed mesh of each material, also as .ply
        junctions.vtk           the curves where three or more materials meet
        report.json             what was used, found and measured
        preview.png             a picture
  interfacet extract slices/ --spacing 0.092 --out result
      a folder of TIFF slices, which say nothing about spacing
  interfacet extract part.raw --size 512,512,300 --type u16 --spacing 0.1 --out result
      samples without a header
  interfacet extract part.mha --material air=4000 --material alu=11600 --out result
      materials by name; `interfacet info part.mha` shows the grey values
  interfacet extract part.mha --threshold otsu-mode --out result
      a part of one material: the surface of one grey value, which is found (or given with --iso)
  interfacet extract part.mha --denoise bilateral --out result
      a noisy scan: the noise is filtered first
  interfacet extract segmented.mha --labels --out result
      a volume that another program has segmented
  interfacet extract part.mha --method dual --tolerance 0.02mm --out result
      few triangles: the surface may move by 0.02 mm, edges stay sharp
";

/// Arguments of `interfacet extract`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(flatten)]
    input: InputArgs,

    /// Folder for the results. It is made once all went well; an earlier result there is then
    /// replaced as a whole, any other folder that is not empty is refused.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,

    /// A material and its mean grey value; give it once for each, by ascending grey value, the
    /// background (air) first. Without any, the materials are found in the volume.
    #[arg(long = "material", value_name = "NAME=GREY", help_heading = "Materials", conflicts_with_all = ["count", "labels"])]
    material: Vec<Named>,

    /// Read the materials from a TOML file: a `[[material]]` table with name and grey for each.
    #[arg(long, value_name = "FILE", help_heading = "Materials", conflicts_with_all = ["material", "count", "labels"])]
    materials: Option<PathBuf>,

    /// How many materials to find, the background (air) counted [default: as many as show].
    #[arg(long, value_name = "N", help_heading = "Materials", conflicts_with = "labels")]
    count: Option<usize>,

    /// Names for the materials found, by ascending grey value, the background first [default: air,
    /// material1, ...].
    #[arg(long, value_name = "NAME,NAME,...", value_delimiter = ',', help_heading = "Materials", conflicts_with_all = ["material", "materials", "labels"])]
    names: Vec<String>,

    /// Two materials, parted by one grey value that is found: the background below it, material at
    /// or above it. `otsu-mode` takes Otsu's threshold of each slice, and of these the most frequent.
    #[arg(long, value_enum, value_name = "HOW", help_heading = "Materials", conflicts_with_all = ["material", "materials", "count", "labels", "radius"])]
    threshold: Option<ThresholdName>,

    /// Two materials, parted by the grey value V: the surface is the isosurface of V.
    #[arg(long, value_name = "V", allow_negative_numbers = true, help_heading = "Materials", conflicts_with_all = ["threshold", "material", "materials", "count", "labels", "radius"])]
    iso: Option<f64>,

    /// The volume is segmented already: every different value is a material, the lowest the
    /// background. Crossings lie halfway between voxels.
    #[arg(long, help_heading = "Materials")]
    labels: bool,

    /// Filter noise out of the volume before all else: bilateral, mean, gaussian, median, nlm or none.
    /// Parameters follow as in `bilateral:sigma=0.05mm,grey=12`; see below.
    #[arg(long, value_name = "FILTER", value_parser = parse_denoise, default_value = "none", help_heading = "Preprocessing")]
    denoise: DenoiseArg,
    /// How well crossings are placed: by models of the blurred scene fitted to the grey values (with a standard
    /// deviation for each vertex), or as published, which is faster.
    #[arg(long, value_enum, default_value_t = AccuracyName::Full, help_heading = "Surface")]
    accuracy: AccuracyName,

    /// Radius of the scan's blur in voxels [default: estimated]. Larger gives more certain
    /// interfaces, smaller keeps thinner parts and sharper junctions.
    #[arg(long, value_name = "R", allow_negative_numbers = true, help_heading = "Surface")]
    radius: Option<f64>,

    /// What becomes of a material that reaches the volume's border: its mesh is closed there, or
    /// left open.
    #[arg(long, value_enum, default_value_t = BorderName::Closed, help_heading = "Surface")]
    border: BorderName,

    /// How to make the surface. The options below it are for `dual` only.
    #[arg(long, value_enum, default_value_t = MethodName::Marching, help_heading = "Surface: dual")]
    method: MethodName,

    /// How far `dual` may move the surface while it takes triangles away: the root mean square distance,
    /// in voxels, or in millimetres as in 0.02mm. Larger gives fewer triangles; a negative number
    /// takes none away [default: 0.1, more if the scan is noisy].
    #[arg(long, value_name = "DISTANCE", allow_negative_numbers = true, help_heading = "Surface: dual", conflicts_with_all = ["phi", "target_triangles"])]
    tolerance: Option<ToleranceArg>,

    /// Instead of --tolerance: take away triangles until about N are left.
    #[arg(long, value_name = "N", help_heading = "Surface: dual", value_parser = clap::value_parser!(u64).range(1..))]
    target_triangles: Option<u64>,

    /// Instead of --tolerance: the parameter phi of Li et al. 2022, to compare with their paper. It bounds the
    /// sum of squared distances, in square voxels; a negative number takes no triangles away.
    #[arg(
        long,
        value_name = "PHI",
        allow_negative_numbers = true,
        help_heading = "Surface: dual",
        conflicts_with = "target_triangles"
    )]
    phi: Option<f64>,

    /// Where to put a vertex whose best place lies outside its block of voxels.
    #[arg(long, value_enum, value_name = "PLACE", default_value_t = QefName::Clamped, help_heading = "Surface: dual")]
    qef: QefName,

    /// Stop at the octree, as Li et al. 2022 do: vertices are not merged beyond its blocks. More triangles
    /// for the same tolerance. With --phi this is always so.
    #[arg(long, help_heading = "Surface: dual")]
    octree_only: bool,

    /// How to find the directions that the surface faces, which tell edges from noise. Volumes of labels
    /// (--labels) have a way of their own, whatever is said here.
    #[arg(long, value_enum, value_name = "HOW", default_value_t = NormalsName::Auto, help_heading = "Surface: dual")]
    normals: NormalsName,

    /// How thoroughly to check the mesh: `full` looks for self-intersections too, which takes
    /// several times as long as everything else.
    #[arg(long, value_enum, default_value_t = CheckName::Full, help_heading = "Run")]
    check: CheckName,

    /// Memory to use at most, for example 2GiB [default: half of what is free]. A volume that takes more
    /// is worked on in slabs of slices; the result is the same for any amount.
    #[arg(long, value_name = "SIZE", help_heading = "Run")]
    memory: Option<ByteSize>,

    /// Work on slabs of at most N slices, however much memory there is. The result is the same.
    #[arg(long, value_name = "N", help_heading = "Run", value_parser = clap::value_parser!(u32).range(1..))]
    slab: Option<u32>,

    /// Threads to use [default: all cores]. The result is the same for any number.
    #[arg(long, short = 'j', value_name = "N", help_heading = "Run")]
    threads: Option<usize>,

    /// Say nothing on success.
    #[arg(long, short, help_heading = "Run")]
    quiet: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ThresholdName {
    OtsuMode,
}

#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum MethodName {
    /// Generalized marching cubes: triangles in every cell that the surface passes.
    Marching,
    /// Adaptive dual contouring: few triangles where the surface is flat, sharp edges kept.
    Dual,
}

#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum AccuracyName {
    /// Linear interpolation between two voxels, midpoints near junctions (Fujimori and Suzuki).
    Paper,
    /// Blurred sheets, junction curves, sharp edges and thin parts fitted to the grey values.
    Full,
}

impl From<AccuracyName> for Accuracy {
    fn from(name: AccuracyName) -> Self {
        match name {
            AccuracyName::Paper => Self::Paper,
            AccuracyName::Full => Self::Full,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum QefName {
    /// At the best place inside the block.
    Clamped,
    /// At the mean of the crossings, as in Li et al. 2022.
    Paper,
}

#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum NormalsName {
    /// From the scan where the surface is smooth, from the crossings around where an edge is near.
    Auto,
    /// Central differences, as in Li et al. 2022: rounds edges off.
    Gradient,
    /// Gradient of the smoothed scan: little noise, but rounds edges off.
    Smoothed,
    /// From the crossings around, on this side of any edge.
    Sided,
}

/// A distance in voxels, or in mm with its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ToleranceArg(Tolerance);

impl FromStr for ToleranceArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (number, unit): (_, fn(f64) -> Tolerance) = match text.strip_suffix("mm") {
            Some(number) => (number, Tolerance::Millimetres),
            None => (text.strip_suffix("vx").unwrap_or(text), Tolerance::Voxels),
        };
        match number.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Self(unit(value))),
            _ => Err(format!("'{text}' is not a distance: give voxels (0.1) or mm (0.02mm)")),
        }
    }
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum BorderName {
    Closed,
    Open,
}

#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum CheckName {
    /// Everything, self-intersections included.
    Full,
    /// Closedness, orientation, manifoldness, degenerate triangles.
    Topology,
}

/// A filter, or `none`; a type of its own since clap reads options as arguments that may be missing.
#[derive(Debug, Clone, Copy, PartialEq)]
struct DenoiseArg(Option<Denoise>);

fn parse_denoise(text: &str) -> Result<DenoiseArg, String> {
    if text == "none" { Ok(DenoiseArg(None)) } else { text.parse().map(|filter| DenoiseArg(Some(filter))) }
}

/// `NAME=GREY`.
#[derive(Debug, Clone)]
struct Named(NamedGrey);

impl FromStr for Named {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (name, grey) = text.rsplit_once('=').ok_or("expected NAME=GREY, for example aluminium=11600")?;
        let grey = grey.trim().parse().map_err(|_| format!("the grey value '{grey}' is not a number"))?;
        Ok(Self(NamedGrey { name: name.trim().into(), grey }))
    }
}

/// A materials file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MaterialsFile {
    material: Vec<NamedGrey>,
}

impl Args {
    fn options(&self) -> anyhow::Result<PipelineOptions> {
        let iso = match (self.iso, self.threshold) {
            (Some(iso), _) => Some(IsoValue::Given(iso)),
            (None, threshold) => threshold.map(|ThresholdName::OtsuMode| IsoValue::OtsuMode),
        };
        let materials = if self.labels {
            MaterialChoice::Labels
        } else if let Some(iso) = iso {
            MaterialChoice::Threshold(Threshold { iso, names: self.names.clone() })
        } else if let Some(path) = &self.materials {
            let text = std::fs::read_to_string(path)
                .with_context(|| format!("cannot read the materials file {}", path.display()))?;
            let file: MaterialsFile = toml::from_str(&text).with_context(|| {
                format!("{} is not a materials file ([[material]] tables with name and grey)", path.display())
            })?;
            MaterialChoice::Given(file.material)
        } else if !self.material.is_empty() {
            MaterialChoice::Given(self.material.iter().map(|m| m.0.clone()).collect())
        } else {
            MaterialChoice::Find { count: self.count, names: self.names.clone() }
        };
        let border = match self.border {
            BorderName::Closed => Border::Closed,
            BorderName::Open => Border::Open,
        };
        let method = self.method()?;
        let (denoise, radius, accuracy) = (self.denoise.0, self.radius, self.accuracy.into());
        Ok(PipelineOptions { denoise, materials, radius, border, method, accuracy })
    }
}

impl Args {
    fn method(&self) -> anyhow::Result<Method> {
        let tolerance = match (self.tolerance, self.phi, self.target_triangles) {
            (Some(ToleranceArg(tolerance)), ..) => tolerance,
            (None, Some(phi), _) => Tolerance::Phi(phi),
            (None, None, Some(count)) => Tolerance::Triangles(count),
            (None, None, None) => Tolerance::Auto,
        };
        let placement = match self.qef {
            QefName::Clamped => Placement::Clamped,
            QefName::Paper => Placement::Paper,
        };
        let normals = match self.normals {
            NormalsName::Auto => NormalRule::Auto,
            NormalsName::Gradient => NormalRule::Gradient,
            NormalsName::Smoothed => NormalRule::Smoothed,
            NormalsName::Sided => NormalRule::Sided,
        };
        let dual = DualMethod { tolerance, placement, octree_only: self.octree_only, normals };
        match self.method {
            MethodName::Dual => Ok(Method::Dual(dual)),
            MethodName::Marching if dual == DualMethod::default() => Ok(Method::Marching),
            MethodName::Marching => bail!(
                "--tolerance, --phi, --target-triangles, --qef, --octree-only and --normals belong to --method dual; add it, or leave them out"
            ),
        }
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args, execution: &Execution) -> anyhow::Result<ExitCode> {
    let mut pool = rayon::ThreadPoolBuilder::new();
    if let Some(threads) = args.threads {
        if !(1..=1024).contains(&threads) {
            bail!("--threads {threads}: give a number between 1 and 1024, or leave it out to use all cores");
        }
        pool = pool.num_threads(threads);
    }
    let execution = &match args.slab {
        Some(slices) => execution.clone().with_slab(slices as usize),
        None => execution.clone(),
    };
    let execution = match args.memory.map(|size| size.as_u64()).or_else(|| Some(available_memory()? / 2)) {
        Some(bytes) => &execution.clone().with_memory(bytes),
        None => execution,
    };
    pool.build().context("cannot start threads")?.install(|| run_in_pool(args, execution))
}

fn run_in_pool(args: &Args, execution: &Execution) -> anyhow::Result<ExitCode> {
    let options = args.options()?;
    let source = args.input.open()?;
    // Before the work, so that a folder that cannot be written is known at once.
    let folder = StagedFolder::create(&args.out)?;
    let input = InputReport {
        path: args.input.input.display().to_string(),
        sample_type: source.sample_type(),
        geometry: source.geometry().clone(),
        voxels: source.geometry().voxels() as u64,
        notes: source.notes(),
    };
    let check = CheckOptions { self_intersections: args.check == CheckName::Full, ..CheckOptions::default() };
    let mut result = ResultWriter::new(folder.path(), check, execution);
    let report = extract_into(source.as_ref(), &options, execution, Some(folder.path()), &mut result)
        .map_err(anyhow::Error::from)
        .and_then(|findings| {
            drop(source);
            Ok(result.finish(input, options, &findings)?)
        })
        .map_err(|error| in_place(error, folder.path(), &args.out))?;
    execution.check()?;
    folder.commit()?;
    if !args.quiet {
        execution.plan(&[]);
        match summary::summary(&mut io::stdout().lock(), &args.out, &report) {
            // Whoever reads has seen enough: `interfacet extract ... | head`.
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {}
            written => written.context("cannot write to standard output")?,
        }
    }
    Ok(if report.unexpected_defects > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// The error, with the path that the user gave for the hidden one where the result was being made.
fn in_place(error: anyhow::Error, aside: &Path, out: &Path) -> anyhow::Error {
    anyhow!(failure::message(&error).replace(&aside.display().to_string(), &out.display().to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_material_is_a_name_and_a_grey_value() {
        let named: Named = "iron = -40.5".parse().unwrap();
        assert_eq!(named.0, NamedGrey { name: "iron".into(), grey: -40.5 });
        assert!("iron".parse::<Named>().is_err());
        assert!("iron=heavy".parse::<Named>().is_err());
    }
}
