//! `interfacet render`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;

use crate::execution::Execution;
use crate::export::{ReadOptions, read_mesh};
use crate::grid::MaterialId;
use crate::mesh::InterfaceMesh;
use crate::report::{Background, Cut, RenderOptions, SliceOptions, render, slice_picture};
use crate::volume::{OpenOptions, open};

const EXAMPLES: &str = "\
Examples:
  interfacet render result/assembly.ply --out part.png
  interfacet render result/assembly.ply --cut z=20 --caps --out inside.png
      cut open at z = 20 mm, with the materials in section
  interfacet render result/assembly.ply --wireframe --out edges.png
      with every triangle's edges, so that their size shows
  interfacet render result/assembly.ply --volume part.mha --slice z=40 --out slice.png
      slice 40 of the volume with the outline of the mesh
";

/// Arguments of `interfacet render`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The mesh. With --volume it may be left out: then the slice is drawn alone.
    #[arg(required_unless_present = "volume")]
    mesh: Option<PathBuf>,
    /// The picture to write (PNG).
    #[arg(long, short, value_name = "PNG")]
    out: PathBuf,
    /// Show only this material; may be given several times.
    #[arg(long, value_name = "NAME|ID", requires = "mesh")]
    only: Vec<String>,
    /// Do not draw junction curves or points.
    #[arg(long)]
    no_junctions: bool,
    /// Do not draw the legend.
    #[arg(long)]
    no_legend: bool,
    // In boxes, so that the commands' arguments are of like size.
    #[command(flatten)]
    view: Box<ViewArgs>,
    #[command(flatten)]
    slice: Box<SliceArgs>,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "View of the mesh")]
struct ViewArgs {
    /// Size of the picture in pixels.
    #[arg(long, value_name = "WxH", default_value = "1600x1200", value_parser = parse_size, conflicts_with = "volume")]
    size: [usize; 2],
    /// Where the eye is around the z axis, degrees: 0 looks from -y, 90 from +x.
    #[arg(long, default_value_t = 35.0, allow_negative_numbers = true, conflicts_with = "volume")]
    azimuth: f64,
    /// How high the eye is, degrees: 90 looks from +z.
    #[arg(long, default_value_t = 25.0, allow_negative_numbers = true, conflicts_with = "volume")]
    elevation: f64,
    /// Cut the mesh open: drop what is on the eye's side of this plane (world, mm).
    #[arg(long, value_name = "x|y|z=MM", value_parser = parse_cut, conflicts_with = "volume")]
    cut: Option<Cut>,
    /// Close the cut with the materials in section (right for closed meshes only).
    #[arg(long, requires = "cut")]
    caps: bool,
    /// Draw the triangles' edges over the shading: shows how large the triangles are.
    #[arg(long, visible_alias = "edges", conflicts_with = "volume")]
    wireframe: bool,
    /// Leave the background clear instead of white.
    #[arg(long, conflicts_with = "volume")]
    transparent: bool,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Slice of a volume with the mesh's outline")]
struct SliceArgs {
    /// The volume; draws a slice of it instead of a view of the mesh.
    #[arg(long, value_name = "FILE", requires = "slice")]
    volume: Option<PathBuf>,
    /// Which slice, by voxel index.
    #[arg(long, value_name = "x|y|z=INDEX", value_parser = parse_slice, requires = "volume")]
    slice: Option<(usize, usize)>,
    /// Pixels per voxel, 1 to 64.
    #[arg(long, default_value_t = 4, requires = "volume")]
    zoom: usize,
    /// The part of the slice to show: columns, then rows, by voxel index, the end exclusive.
    #[arg(long, value_name = "C0:C1,R0:R1", value_parser = parse_crop, requires = "volume")]
    crop: Option<Crop>,
}

/// Columns, then rows; low and high (exclusive).
type Crop = [[usize; 2]; 2];

/// Runs the command.
pub(crate) fn run(args: &Args, execution: &Execution) -> anyhow::Result<ExitCode> {
    let mesh = args.mesh.as_deref().map(|path| read_mesh(path, &ReadOptions::default())).transpose()?;
    let only = match &mesh {
        Some(mesh) => {
            args.only.iter().map(|text| material(mesh, text)).collect::<anyhow::Result<Vec<_>>>()?
        }
        None => Vec::new(),
    };
    let picture = match (&args.slice.volume, args.slice.slice, &mesh) {
        (Some(volume), Some((axis, index)), mesh) => {
            let options = SliceOptions {
                axis,
                index,
                zoom: args.slice.zoom,
                crop: args.slice.crop,
                only,
                junctions: !args.no_junctions,
                legend: !args.no_legend,
                ..SliceOptions::default()
            };
            slice_picture(open(volume, &OpenOptions::default())?.as_ref(), mesh.as_ref(), &options)?
        }
        (_, _, Some(mesh)) => {
            let view = &args.view;
            let [width, height] = view.size;
            let background = if view.transparent { Background::Transparent } else { Background::White };
            let options = RenderOptions {
                width,
                height,
                azimuth: view.azimuth,
                elevation: view.elevation,
                only,
                cut: view.cut,
                caps: view.caps,
                wireframe: view.wireframe,
                junctions: !args.no_junctions,
                legend: !args.no_legend,
                background,
                ..RenderOptions::default()
            };
            render(mesh, &options)?
        }
        _ => anyhow::bail!("give a mesh, or a volume and a slice of it"),
    };
    execution.check()?;
    picture.save_png(&args.out)?;
    Ok(ExitCode::SUCCESS)
}

/// The material of a mesh that a name or an id means. A name comes first: it may be a number.
fn material(mesh: &InterfaceMesh, text: &str) -> anyhow::Result<MaterialId> {
    let list = mesh.materials();
    let by_id = || text.parse().ok().and_then(|id: u8| list.iter().find(|m| m.id.0 == id));
    list.iter().find(|m| m.name == text).or_else(by_id).map(|m| m.id).with_context(|| {
        let known: Vec<String> = list.iter().map(|m| format!("{} ({})", m.name, m.id.0)).collect();
        format!("the mesh has no material '{text}'; it has {}", known.join(", "))
    })
}

fn parse_size(text: &str) -> Result<[usize; 2], String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    sides.ok_or_else(|| "expected WIDTHxHEIGHT, such as 1600x1200".to_owned())
}

fn parse_axis(text: &str) -> Option<usize> {
    ["x", "y", "z"].iter().position(|name| name.eq_ignore_ascii_case(text.trim()))
}

fn parse_cut(text: &str) -> Result<Cut, String> {
    let cut = text.split_once('=').and_then(|(axis, position)| {
        let position: f64 = position.trim().parse().ok()?;
        Some(Cut { axis: parse_axis(axis)?, position }).filter(|c| c.position.is_finite())
    });
    cut.ok_or_else(|| "expected an axis and a position in mm, such as z=12.5".to_owned())
}

fn parse_slice(text: &str) -> Result<(usize, usize), String> {
    let slice =
        text.split_once('=').and_then(|(axis, index)| Some((parse_axis(axis)?, index.trim().parse().ok()?)));
    slice.ok_or_else(|| "expected an axis and a voxel index, such as z=50".to_owned())
}

fn parse_crop(text: &str) -> Result<Crop, String> {
    let range = |part: &str| {
        let (low, high) = part.split_once(':')?;
        Some([low.trim().parse().ok()?, high.trim().parse().ok()?]).filter(|[low, high]| low < high)
    };
    let crop = text.split_once(',').and_then(|(c, r)| Some([range(c)?, range(r)?]));
    crop.ok_or_else(|| "expected columns and rows, such as 10:60,20:80".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_read_and_bad_ones_refused() {
        assert_eq!(parse_size("800x600"), Ok([800, 600]));
        assert!(parse_size("800").is_err() && parse_size("ax2").is_err());
        assert_eq!(parse_cut("y=-1.5"), Ok(Cut { axis: 1, position: -1.5 }));
        assert!(parse_cut("w=1").is_err() && parse_cut("z=nan").is_err() && parse_cut("z").is_err());
        assert_eq!(parse_slice("Z=50"), Ok((2, 50)));
        assert!(parse_slice("z=-1").is_err());
        assert_eq!(parse_crop("1:5,2:9"), Ok([[1, 5], [2, 9]]));
        assert!(parse_crop("5:1,2:9").is_err() && parse_crop("1:5").is_err());
    }
}
