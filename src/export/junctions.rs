//! Junction curves as polylines, in a legacy VTK file (`.vtk`), which ParaView opens directly.
//!
//! PLY has no polylines that ParaView shows, hence VTK. The file is text: curves are few next to
//! triangles. Each curve is one line cell with cell data: its number, its materials' number and
//! the first four of them (255 is the outside, -1 none), whether it is closed, and its length.

use std::io::{self, Write};
use std::path::Path;

use glam::DVec3;

use super::{ExportError, write_atomically};
use crate::mesh::{InterfaceMesh, JunctionCurve};

/// Writes curves of `mesh` to the VTK file `path`, whole or not at all.
///
/// # Errors
/// As [`write_curves`].
pub fn write_junctions(
    path: &Path,
    mesh: &InterfaceMesh,
    curves: &[JunctionCurve],
) -> Result<(), ExportError> {
    write_curves(path, |v| mesh.positions().get(v as usize).copied(), curves)
}

/// Writes curves to the VTK file `path`, whole or not at all; `position` tells where a vertex of
/// theirs lies (world, mm).
///
/// # Errors
/// [`ExportError`] naming `path`; [`ExportError::Pieces`] if the position of a vertex is not known.
pub fn write_curves(
    path: &Path,
    position: impl Fn(u32) -> Option<DVec3>,
    curves: &[JunctionCurve],
) -> Result<(), ExportError> {
    let (points, place) = points(position, curves).map_err(|v| ExportError::Pieces {
        path: path.to_owned(),
        what: format!("a curve names vertex {v}, whose position is not known"),
    })?;
    write_atomically(path, |out| write(out, &points, place, curves))
}

/// The points of the curves, ascending by vertex id, and where in them a vertex is; or the first vertex
/// whose position is not known.
fn points(
    position: impl Fn(u32) -> Option<DVec3>,
    curves: &[JunctionCurve],
) -> Result<(Vec<DVec3>, impl Fn(u32) -> usize), u32> {
    let mut ids: Vec<u32> = curves.iter().flat_map(|c| c.vertices.iter().copied()).collect();
    ids.sort_unstable();
    ids.dedup();
    let points = ids.iter().map(|&v| position(v).ok_or(v)).collect::<Result<_, _>>()?;
    Ok((points, move |v| ids.partition_point(|&id| id < v)))
}

fn write(
    out: &mut impl Write,
    points: &[DVec3],
    place: impl Fn(u32) -> usize,
    curves: &[JunctionCurve],
) -> io::Result<()> {
    writeln!(out, "# vtk DataFile Version 3.0")?;
    writeln!(out, "interfacet {} junction curves, unit mm", env!("CARGO_PKG_VERSION"))?;
    writeln!(out, "ASCII\nDATASET POLYDATA\nPOINTS {} double", points.len())?;
    for p in points {
        writeln!(out, "{} {} {}", p.x, p.y, p.z)?;
    }
    let length = |c: &JunctionCurve| c.vertices.len() + usize::from(c.closed);
    let entries: usize = curves.iter().map(|c| 1 + length(c)).sum();
    if curves.is_empty() {
        return out.flush(); // VTK's reader takes a section of no lines for an error
    }
    writeln!(out, "LINES {} {entries}", curves.len())?;
    for curve in curves {
        write!(out, "{}", length(curve))?;
        // A closed line names its first point again.
        for &v in curve.vertices.iter().chain(curve.vertices.first().filter(|_| curve.closed)) {
            write!(out, " {}", place(v))?;
        }
        writeln!(out)?;
    }
    // As fields: of several SCALARS, VTK's reader keeps only the first unless told otherwise.
    writeln!(out, "CELL_DATA {}\nFIELD curves 8", curves.len())?;
    let mut column = |name: &str, kind: &str, value: &dyn Fn(usize, &JunctionCurve) -> String| {
        writeln!(out, "{name} 1 {} {kind}", curves.len())?;
        for (i, curve) in curves.iter().enumerate() {
            writeln!(out, "{}", value(i, curve))?;
        }
        io::Result::Ok(())
    };
    column("curve", "int", &|i, _| i.to_string())?;
    column("materials", "int", &|_, c| c.materials.len().to_string())?;
    for (i, name) in ["material_a", "material_b", "material_c", "material_d"].into_iter().enumerate() {
        column(name, "int", &|_, c| c.materials.get(i).map_or("-1".to_owned(), |m| m.0.to_string()))?;
    }
    column("closed", "int", &|_, c| u8::from(c.closed).to_string())?;
    column("length_mm", "double", &|_, c| c.length.to_string())?;
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::voxel_faces;
    use crate::mesh::junctions;

    #[test]
    fn curves_are_lines_with_their_materials() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("junctions.vtk");
        let m = voxel_faces([2, 1, 1], &[1, 2], 0);
        write_junctions(&path, &m, &junctions(&m).curves).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("POINTS 4 double\n"), "{text}");
        assert!(text.contains("LINES 1 6\n5 0 "), "{text}");
        assert!(text.contains("CELL_DATA 1\nFIELD curves 8\ncurve 1 1 int\n0\n"));
        assert!(text.contains("length_mm 1 1 double\n4\n"));
        let first = m.positions()[0];
        let error = write_curves(&path, |v| (v < 2).then_some(first), &junctions(&m).curves).unwrap_err();
        assert!(matches!(error, ExportError::Pieces { .. }), "{error}");
        // No curves are no error.
        write_junctions(&path, &m, &[]).unwrap();
    }
}
