//! A shaded picture of a mesh.
//!
//! The picture is drawn in bands, each with a z-buffer of its own: first the triangles, then the caps
//! of a cut, then lines where they are not hidden; samples are averaged to pixels. Bands share nothing, and each
//! draws in ascending order: the bytes are the same for any number of threads, and wherever the mesh is cut
//! into pieces. A mesh at hand is drawn band after band, with the memory of a few bands; one
//! in pieces is drawn into all bands at once, with the memory of these and of a piece.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::camera::Fit;
use super::edges::{EdgeMark, MarkedEdge, marked_edges};
use super::legend::{Entry, Legend};
use super::piece_edges::PieceEdges;
use super::view::{View, is_shown};
use super::{Background, Palette, Picture, PictureError};
use crate::execution::Execution;
use crate::export::PlyPieces;
use crate::grid::MaterialId;
use crate::mesh::{InterfaceMesh, MeshMaterial, MeshPiece};

/// A plane across a world axis; the part of the mesh on the eye's side of it is not drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cut {
    /// 0, 1, 2: x, y, z.
    pub axis: usize,
    /// Where the plane crosses the axis, mm.
    pub position: f64,
}

/// How a mesh is drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RenderOptions {
    /// Pixels per row. Default 1600.
    pub width: usize,
    /// Rows of pixels. Default 1200.
    pub height: usize,
    /// Where the eye is around the z axis, degrees: 0 looks from -y, 90 from +x. Default 35.
    pub azimuth: f64,
    /// How high the eye is, degrees: 90 looks from +z. Default 25.
    pub elevation: f64,
    /// Show only interfaces of these materials. Empty: all of them, except where air meets the
    /// volume's border, which would hide the rest.
    pub only: Vec<MaterialId>,
    /// Cut the mesh open.
    pub cut: Option<Cut>,
    /// Close the cut, so that it shows the materials in section. Right for a closed mesh only: a hole lets
    /// the wrong material through. Default `false`: the inner surfaces are seen.
    pub caps: bool,
    /// Draw the triangles' edges, too.
    pub wireframe: bool,
    /// Draw junction curves. Default `true`.
    pub junctions: bool,
    /// Draw edges with one triangle only. Default `true`.
    pub open_edges: bool,
    /// Say what the colours are. Default `true`.
    pub legend: bool,
    /// What is behind the mesh.
    pub background: Background,
    /// Samples per pixel and axis, 1 to 8. Default 2.
    pub supersampling: usize,
    /// The colours.
    pub palette: Palette,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            width: 1600,
            height: 1200,
            azimuth: 35.0,
            elevation: 25.0,
            only: Vec::new(),
            cut: None,
            caps: false,
            wireframe: false,
            junctions: true,
            open_edges: true,
            legend: true,
            background: Background::White,
            supersampling: 2,
            palette: Palette::default(),
        }
    }
}

/// Pixel rows per band of a mesh at hand: a band's z-buffer should stay in a core's cache.
const BAND_ROWS: usize = 16;
/// Pixel rows per band of a mesh in pieces: all bands are held, so little should be computed twice.
const HELD_BAND_ROWS: usize = 64;

/// Draws a mesh, as large as the picture allows.
///
/// # Errors
/// [`PictureError::Size`] and [`PictureError::Option`] for options out of range,
/// [`PictureError::Nothing`] if no triangle is to be shown.
pub fn render(mesh: &InterfaceMesh, options: &RenderOptions) -> Result<Picture, PictureError> {
    let mut picture = checked(options)?;
    countable(mesh)?;
    let fit = shown_bounds(mesh, options);
    if fit.is_empty() {
        return Err(PictureError::Nothing { triangles: mesh.triangles().len() });
    }
    let marked = if options.junctions || options.open_edges {
        marked_edges(mesh, |t| is_shown(mesh.pairs()[t], &options.only))
    } else {
        Vec::new()
    };
    let position = |v: u32| mesh.positions()[v as usize];
    let lines = marked.into_iter().map(|MarkedEdge { vertices, mark }| (mark, vertices.map(position)));
    let view = View::new(options, &fit, wanted(lines, options), BAND_ROWS);
    let shape = view.project(mesh);
    let drawn: Vec<Vec<Entry>> = picture
        .rgba_mut()
        .par_chunks_mut(4 * options.width * BAND_ROWS)
        .enumerate()
        .map(|(k, pixels)| {
            let mut band = view.band(k);
            view.draw(&shape, k, &mut band);
            view.finish(k, band, pixels)
        })
        .collect();
    explain(&mut picture, drawn, mesh.materials(), options);
    Ok(picture)
}

/// Draws a mesh that is given in pieces, twice, by `replay`, which hands them to what it is given, in order, and
/// hands its error on. The picture is the one that [`render()`] draws of the whole mesh if the vertices'
/// kinds are right: lines are looked for between vertices on junctions or on the volume's border only. Takes, apart
/// from a piece, 12 bytes for every sample of the picture.
///
/// # Errors
/// As [`render()`], and those of `replay`.
pub fn render_pieces(
    materials: &[MeshMaterial],
    replay: impl Fn(&mut dyn FnMut(&MeshPiece) -> Result<(), PictureError>) -> Result<(), PictureError>,
    options: &RenderOptions,
) -> Result<Picture, PictureError> {
    let mut picture = checked(options)?;
    let mut fit = Fit::new(options.azimuth, options.elevation);
    let (mut edges, mut triangles) = (PieceEdges::default(), 0);
    replay(&mut |piece| {
        countable(&piece.mesh)?;
        fit.join(&shown_bounds(&piece.mesh, options));
        if options.junctions || options.open_edges {
            edges.add(piece, |pair| is_shown(pair, &options.only));
        }
        triangles += piece.mesh.triangles().len();
        Ok(())
    })?;
    if fit.is_empty() {
        return Err(PictureError::Nothing { triangles });
    }
    let lines = edges.finish(|pair| is_shown(pair, &options.only));
    let view = View::new(options, &fit, wanted(lines, options), HELD_BAND_ROWS);
    let mut bands: Vec<_> = (0..options.height.div_ceil(HELD_BAND_ROWS)).map(|k| view.band(k)).collect();
    replay(&mut |piece| {
        let shape = view.project(&piece.mesh);
        bands.par_iter_mut().enumerate().for_each(|(k, band)| view.draw(&shape, k, band));
        Ok(())
    })?;
    let drawn: Vec<Vec<Entry>> = picture
        .rgba_mut()
        .par_chunks_mut(4 * options.width * HELD_BAND_ROWS)
        .zip(bands)
        .enumerate()
        .map(|(k, (pixels, band))| view.finish(k, band, pixels))
        .collect();
    explain(&mut picture, drawn, materials, options);
    Ok(picture)
}

/// Draws the mesh of a PLY file that this program wrote, without holding it; see [`render_pieces`].
///
/// # Errors
/// As [`render()`], and [`PictureError::Export`] for a file that cannot be read,
/// [`PictureError::Cancelled`].
pub fn render_ply(
    pieces: &PlyPieces,
    options: &RenderOptions,
    execution: &Execution,
) -> Result<Picture, PictureError> {
    let replay = |take: &mut dyn FnMut(&MeshPiece) -> Result<(), PictureError>| {
        pieces.each(|piece| {
            execution.check()?;
            take(piece)
        })
    };
    render_pieces(pieces.materials(), replay, options)
}

/// An empty picture for options that are in their ranges.
fn checked(options: &RenderOptions) -> Result<Picture, PictureError> {
    let picture = Picture::new(options.width, options.height, options.background)?;
    let limit = |what, value: f64, ok: bool, needed| {
        if ok { Ok(()) } else { Err(PictureError::Option { what, value, needed }) }
    };
    limit("the azimuth", options.azimuth, options.azimuth.is_finite(), "a finite number of degrees")?;
    limit("the elevation", options.elevation, options.elevation.is_finite(), "a finite number of degrees")?;
    let samples = options.supersampling;
    limit("the supersampling", samples as f64, (1..=8).contains(&samples), "1 to 8 samples per pixel")?;
    if let Some(Cut { axis, position }) = options.cut {
        limit("the axis of the cut", axis as f64, axis < 3, "0, 1 or 2 (x, y or z)")?;
        limit("the position of the cut", position, position.is_finite(), "a finite number of mm")?;
    }
    Ok(picture)
}

/// Refuses a mesh whose triangles `u32` does not count.
fn countable(mesh: &InterfaceMesh) -> Result<(), PictureError> {
    let (what, value) = ("the number of triangles", mesh.triangles().len());
    let needed = "below 2^32";
    let refused = |_| PictureError::Option { what, value: value as f64, needed };
    u32::try_from(value).map(drop).map_err(refused)
}

/// What a camera must show of a mesh.
fn shown_bounds(mesh: &InterfaceMesh, options: &RenderOptions) -> Fit {
    let empty = || Fit::new(options.azimuth, options.elevation);
    let both = |mut a: Fit, b: Fit| {
        a.join(&b);
        a
    };
    let triangles = mesh.triangles().par_iter().zip(mesh.pairs());
    let shown = triangles.filter(|(_, pair)| is_shown(**pair, &options.only));
    let bounds = shown.fold(empty, |mut fit, (triangle, _)| {
        triangle.iter().for_each(|&v| fit.include(mesh.positions()[v as usize]));
        fit
    });
    bounds.reduce(empty, both)
}

/// The lines that the options ask for.
fn wanted(
    lines: impl IntoIterator<Item = (EdgeMark, [DVec3; 2])>,
    options: &RenderOptions,
) -> Vec<(EdgeMark, [DVec3; 2])> {
    let is_wanted = |mark| if mark == EdgeMark::Open { options.open_edges } else { options.junctions };
    lines.into_iter().filter(|line| is_wanted(line.0)).collect()
}

/// Draws the legend of what is seen.
fn explain(
    picture: &mut Picture,
    drawn: Vec<Vec<Entry>>,
    materials: &[MeshMaterial],
    options: &RenderOptions,
) {
    if options.legend {
        let mut entries: Vec<Entry> = drawn.into_iter().flatten().collect();
        entries.sort_unstable();
        entries.dedup();
        Legend::new(&entries, materials, &options.palette, options.height).draw_in_emptiest_corner(picture);
    }
}

#[cfg(test)]
#[path = "render_tests.rs"]
pub(super) mod tests;
