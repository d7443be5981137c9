//! Junction curves as polylines, in a legacy VTK file (`.vtk`), which ParaView opens directly.
//!
//! PLY has no polylines that ParaView shows, hence VTK. The file is text: curves are few next to
//! triangles. Each curve is one line cell with cell data: its number, its materials' number and
//! the first four of them (255 is the outside, -1 none), whether it is closed, and its length.

use std::io::{self, Write};
use std::path::Path;

use super::{ExportError, write_atomically};
use crate::mesh::{InterfaceMesh, JunctionCurve};

/// Writes curves of `mesh` to the VTK file `path`, whole or not at all.
///
/// # Errors
/// [`ExportError`] naming `path`.
///
/// # Panics
/// If the curves name vertices that the mesh does not have.
pub fn write_junctions(
    path: &Path,
    mesh: &InterfaceMesh,
    curves: &[JunctionCurve],
) -> Result<(), ExportError> {
    write_atomically(path, |out| write(out, mesh, curves))
}

fn write(out: &mut impl Write, mesh: &InterfaceMesh, curves: &[JunctionCurve]) -> io::Result<()> {
    // Points are those of the curves only, ascending by vertex id.
    let mut ids: Vec<u32> = curves.iter().flat_map(|c| c.vertices.iter().copied()).collect();
    ids.sort_unstable();
    ids.dedup();
    let place = |v: u32| ids.partition_point(|&id| id < v);
    writeln!(out, "# vtk DataFile Version 3.0")?;
    writeln!(out, "interfacet {} junction curves, unit mm", env!("CARGO_PKG_VERSION"))?;
    writeln!(out, "ASCII\nDATASET POLYDATA\nPOINTS {} double", ids.len())?;
    for &v in &ids {
        let p = mesh.positions()[v as usize];
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
        // No curves are no error.
        write_junctions(&path, &m, &[]).unwrap();
    }
}
