//! What dual contouring needs to know of a corner pattern: the vertices inside the cell (*leaves*), and
//! which of them the polygon of each crossing uses.
//!
//! Every sheet has a leaf; a capped disc has one of its own, as in [`surface`](super::surface).

use super::curve_graph::{FACE_NODE, Sheet, sheets};
use super::face::{FaceCurves, curves, ring_edges};
use super::partition::Classes;
use super::surface::{caps, disc_corners};
use crate::grid::cube::{EDGES, FACES};

/// A vertex inside a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellLeaf {
    /// The crossings of its sheet, as a bit set over cell edges.
    pub crossings: u16,
    /// For a cap: the corners it cuts off, as a bit set.
    pub cap: u8,
    /// The first leaf of the same sheet.
    pub main: u8,
    /// Whether its sheet has no caps and at most one curve on each face: then each material's part of it
    /// is a disc that meets each face in one path.
    pub simple: bool,
}

/// A triangle that joins a cap to its sheet's main leaf and to a face node, between two materials.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tie {
    /// The face whose node it uses.
    pub face: u8,
    /// Main leaf and cap. Node, main leaf, cap are counter-clockwise seen from the material at `ahead`.
    pub leaves: [u8; 2],
    /// A corner with the material behind it.
    pub behind: u8,
    /// A corner with the material ahead of it.
    pub ahead: u8,
}

/// Curves on a face that need vertices of their own, at least in some meshes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FaceKnot {
    /// A star whose spokes, these cell edges, lead to different leaves.
    Torn {
        /// The face.
        face: u8,
        /// Cell edges.
        spokes: Vec<u8>,
    },
    /// Two curves of one sheet, each between two cell edges.
    Double {
        /// The face.
        face: u8,
        /// Cell edges.
        curves: [[u8; 2]; 2],
    },
}

/// The leaves of a cell.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CellLeaves {
    /// Its vertices.
    pub leaves: Vec<CellLeaf>,
    /// The leaf of each crossing by cell edge; only for edges that have one.
    pub leaf_of: [u8; EDGES],
    /// Number of sheets.
    pub sheets: u8,
    /// Triangles between leaves.
    pub ties: Vec<Tie>,
    /// Faces that are not simple.
    pub knots: Vec<FaceKnot>,
}

/// The leaves of a cell with these corner classes and bits for ambiguous faces.
#[must_use]
pub(super) fn cell_leaves(classes: &Classes, join_first: u8) -> CellLeaves {
    let sheets = sheets(classes, join_first);
    let mut out = CellLeaves { sheets: sheets.len() as u8, ..CellLeaves::default() };
    for sheet in &sheets {
        add_sheet(&mut out, classes, sheet);
    }
    for face in 0..FACES {
        if let Some(knot) = knot(&out, classes, join_first, face) {
            out.knots.push(knot);
        }
    }
    for leaf in &mut out.leaves {
        let double = |k: &FaceKnot| match k {
            FaceKnot::Double { curves, .. } => leaf.crossings >> curves[0][0] & 1 == 1,
            FaceKnot::Torn { .. } => false,
        };
        leaf.simple &= !out.knots.iter().any(double);
    }
    out
}

fn add_sheet(out: &mut CellLeaves, classes: &Classes, sheet: &Sheet) {
    let main = out.leaves.len() as u8;
    let capped = if sheet.face_nodes == 0 { Vec::new() } else { caps(classes, &sheet.discs) };
    let simple = !capped.contains(&true);
    let leaf = CellLeaf { crossings: sheet.crossings, cap: 0, main, simple };
    out.leaves.push(leaf);
    (0..EDGES).filter(|e| sheet.crossings >> e & 1 == 1).for_each(|e| out.leaf_of[e] = main);
    let corner_of = |class| classes.iter().position(|&c| c == class).unwrap_or(0) as u8;
    for (disc, _) in sheet.discs.iter().zip(&capped).filter(|(_, capped)| **capped) {
        let cap = out.leaves.len() as u8;
        out.leaves.push(CellLeaf { cap: disc_corners(classes, disc), ..leaf });
        for (i, c) in disc.rim.iter().enumerate() {
            if c.from < FACE_NODE {
                out.leaf_of[usize::from(c.from)] = cap;
            }
            if c.to >= FACE_NODE {
                let next = disc.rim[(i + 1) % disc.rim.len()];
                out.ties.push(Tie {
                    face: c.to - FACE_NODE,
                    leaves: [main, cap],
                    behind: corner_of(c.right),
                    ahead: corner_of(next.right),
                });
            }
        }
    }
}

/// What is not simple about a face.
fn knot(cell: &CellLeaves, classes: &Classes, join_first: u8, face: usize) -> Option<FaceKnot> {
    let edges = ring_edges(face).map(|e| e as u8);
    let leaf = |e: u8| cell.leaf_of[usize::from(e)];
    let star = |spokes: Vec<u8>| {
        let torn = spokes.iter().any(|&e| leaf(e) != leaf(spokes[0]));
        torn.then_some(FaceKnot::Torn { face: face as u8, spokes })
    };
    match curves(classes, face, join_first >> face & 1 == 1) {
        FaceCurves::None | FaceCurves::One(_) => None,
        FaceCurves::Triple(k) => star(k.map(|k| edges[k]).to_vec()),
        FaceCurves::Quadruple => star(edges.to_vec()),
        FaceCurves::Two(curves) => {
            let curves = curves.map(|ends| ends.map(|k| edges[k]));
            let sheet = |e: u8| cell.leaves[usize::from(leaf(e))].main;
            let double = sheet(curves[0][0]) == sheet(curves[1][0]);
            double.then_some(FaceKnot::Double { face: face as u8, curves })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::PatternTable;
    use crate::contour::pattern::Apex;

    #[test]
    fn every_crossing_has_a_leaf_and_caps_are_those_of_the_surface() {
        let table = PatternTable::get();
        let (mut simple, mut most) = (0, 0);
        for entry in 0..table.len() {
            let (surface, cell) = (table.surface(entry), table.leaves(entry));
            let all = cell.leaves.iter().fold(0, |set, leaf| set | leaf.crossings);
            assert_eq!(all, surface.crossings);
            let caps = surface.apexes.iter().filter(|a| matches!(a, Apex::Cap { .. })).count();
            assert_eq!(cell.leaves.iter().filter(|l| l.cap != 0).count(), caps);
            let ties = surface.triangles.iter().filter(|t| t.vertices[1] >= 18 && t.vertices[2] >= 18);
            assert_eq!(cell.ties.len(), ties.count());
            simple += usize::from(cell.leaves.iter().all(|l| l.simple));
            most = most.max(cell.leaves.len());
        }
        // At most four caps beside a main leaf; a third of the entries, and nearly all cells of a scan, are simple.
        assert_eq!((simple, most), (1738, 5));
    }
}
