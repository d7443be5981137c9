//! The triangles inside a cell, from its sheets.
//!
//! - A sheet without face nodes is a loop of crossings between two materials. It becomes a *fan*
//!   from a crossing whose two faces hold no other curve of the loop: a cone with its apex on the
//!   cell's surface, so it cannot meet itself, and none of its inner edges lies in a face. Where
//!   there is no such crossing, or where two six-crossing loops face each other (the one case in
//!   which fans of two sheets can meet), it becomes a cone from an apex inside the cell.
//! - A sheet with face nodes becomes the cone from one apex over its curves. This is right as long
//!   as no material has two discs in the sheet; otherwise its regions would touch at the apex.
//! - Then chosen discs get a *cap*: their rim is coned to an apex of their own, between the main
//!   apex and the disc's corner, and every face node on the rim is joined to both apexes by a
//!   triangle between its other two materials.
//!
//! Guarantees, for any positions of crossings strictly inside their edges: every shell is closed
//! and every vertex link of a material is one cycle (tested for all entries); no two triangles
//! meet except in shared vertices and edges (argued in `docs/contouring.md`, tested with exact
//! predicates).

use super::curve_graph::{DirectedCurve, Disc, FACE_NODE, Node, Sheet, sheets};
use super::partition::Classes;
use crate::grid::cube::{CORNERS, EDGES, FACES, edge_corners, edge_faces};

/// Where an inner vertex of a cell is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Apex {
    /// The mean of a sheet's face nodes, or of its crossings where it has no face nodes.
    Sheet {
        /// Bit set over faces.
        face_nodes: u8,
        /// Bit set over cell edges.
        crossings: u16,
    },
    /// Halfway between an earlier apex and the mean of some corners.
    Cap {
        /// Number of the sheet's main apex among the cell's apexes.
        main: u8,
        /// Bit set over corners.
        corners: u8,
    },
}

/// A triangle inside a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellTriangle {
    /// Vertices: crossing of cell edge `0..12`, node of face `12..18`, apex `18..`.
    /// Counter-clockwise seen from the material at corner `ahead`.
    pub vertices: [u8; 3],
    /// A corner with the material behind the triangle.
    pub behind: u8,
    /// A corner with the material ahead of it.
    pub ahead: u8,
}

/// The surface inside a cell with a certain corner pattern.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CellSurface {
    /// Its inner vertices.
    pub apexes: Vec<Apex>,
    /// The classes that meet at each apex, as a bit set over corners (one corner per class).
    pub apex_corners: Vec<u8>,
    /// Its triangles.
    pub triangles: Vec<CellTriangle>,
    /// The cell edges with a crossing, as a bit set.
    pub crossings: u16,
}

/// First vertex number of the apexes.
const APEX: u8 = (EDGES + FACES) as u8;

/// The surface of a cell with these corner classes and bits for ambiguous faces.
#[must_use]
pub(super) fn cell_surface(classes: &Classes, join_first: u8) -> CellSurface {
    let sheets = sheets(classes, join_first);
    let is_hexagon = |s: &Sheet| s.face_nodes == 0 && s.crossings.count_ones() == 6;
    let facing_hexagons = sheets.iter().filter(|s| is_hexagon(s)).count() > 1;
    let crossings = sheets.iter().fold(0, |all, s| all | s.crossings);
    let mut builder = Builder { classes, surface: CellSurface { crossings, ..CellSurface::default() } };
    for sheet in &sheets {
        if sheet.face_nodes != 0 {
            builder.star_sheet(sheet);
        } else {
            match fan_start(&sheet.discs[0].rim) {
                Some(start) if !(facing_hexagons && is_hexagon(sheet)) => builder.fan(&sheet.discs[0], start),
                _ => builder.cone(sheet),
            }
        }
    }
    builder.surface
}

/// A position on the rim whose crossing has no other curve of the rim in its two faces.
fn fan_start(rim: &[DirectedCurve]) -> Option<usize> {
    let alone = |face: usize| rim.iter().filter(|c| usize::from(c.face) == face).count() == 1;
    rim.iter().position(|c| edge_faces(usize::from(c.from)).into_iter().all(alone))
}

struct Builder<'a> {
    classes: &'a Classes,
    surface: CellSurface,
}

impl Builder<'_> {
    fn corner_of(&self, class: u8) -> u8 {
        self.classes.iter().position(|&c| c == class).unwrap_or(0) as u8
    }

    /// Adds a triangle that is counter-clockwise seen from `ahead`.
    fn triangle(&mut self, vertices: [u8; 3], behind: u8, ahead: u8) {
        let (behind, ahead) = (self.corner_of(behind), self.corner_of(ahead));
        self.surface.triangles.push(CellTriangle { vertices, behind, ahead });
    }

    fn apex(&mut self, apex: Apex, classes: impl IntoIterator<Item = u8>) -> u8 {
        let corners = classes.into_iter().fold(0, |set, class| set | 1 << self.corner_of(class));
        self.surface.apexes.push(apex);
        self.surface.apex_corners.push(corners);
        APEX + self.surface.apexes.len() as u8 - 1
    }

    fn fan(&mut self, disc: &Disc, start: usize) {
        let n = disc.rim.len();
        let at = |i: usize| disc.rim[(start + i) % n];
        for i in 1..n - 1 {
            // Seen from outside the disc is to the left of its rim, so a cone over the rim turns
            // its front to the disc's class.
            self.triangle([at(i).from, at(i).to, at(0).from], at(i).right, disc.class);
        }
    }

    fn cone(&mut self, sheet: &Sheet) {
        let disc = &sheet.discs[0];
        let apex = Apex::Sheet { face_nodes: 0, crossings: sheet.crossings };
        let apex = self.apex(apex, [disc.class, disc.rim[0].right]);
        for c in &disc.rim {
            self.triangle([c.from, c.to, apex], c.right, c.left);
        }
    }

    fn star_sheet(&mut self, sheet: &Sheet) {
        let capped = caps(self.classes, &sheet.discs);
        let uncapped = sheet.discs.iter().zip(&capped).filter(|(_, c)| !**c).map(|(d, _)| d.class);
        let rims = sheet.discs.iter().zip(&capped).filter(|(_, c)| **c).flat_map(|(d, _)| d.rim_classes());
        let apex = Apex::Sheet { face_nodes: sheet.face_nodes, crossings: sheet.crossings };
        let main = self.apex(apex, uncapped.chain(rims).collect::<Vec<_>>());
        for (disc, _) in sheet.discs.iter().zip(&capped).filter(|(_, c)| **c) {
            let corners = disc_corners(self.classes, disc);
            let around = disc.rim_classes().into_iter().chain([disc.class]);
            let apex = self.apex(Apex::Cap { main: main - APEX, corners }, around);
            for (i, c) in disc.rim.iter().enumerate() {
                self.triangle([c.from, c.to, apex], c.right, c.left);
                if c.to >= FACE_NODE {
                    let next = disc.rim[(i + 1) % disc.rim.len()];
                    self.triangle([c.to, main, apex], c.right, next.right);
                }
            }
        }
        // Every other curve belongs to two discs; it is coned once, on the side of the lower class.
        for (disc, _) in sheet.discs.iter().zip(&capped).filter(|(_, c)| !**c) {
            for c in &disc.rim {
                if c.left < c.right && !is_on_capped(&sheet.discs, &capped, c) {
                    self.triangle([c.from, c.to, main], c.right, c.left);
                }
            }
        }
    }
}

/// Whether the curve is, in the other direction, on the rim of a capped disc.
fn is_on_capped(discs: &[Disc], capped: &[bool], curve: &DirectedCurve) -> bool {
    let reversed = |c: &DirectedCurve| c.from == curve.to && c.to == curve.from && c.face == curve.face;
    discs.iter().zip(capped).any(|(d, &is_capped)| is_capped && d.rim.iter().any(reversed))
}

/// The corners of the disc's class next to its rim, as a bit set.
pub(super) fn disc_corners(classes: &Classes, disc: &Disc) -> u8 {
    disc.rim
        .iter()
        .filter(|c| c.from < FACE_NODE)
        .flat_map(|c| edge_corners(usize::from(c.from as Node)))
        .filter(|&corner| classes[corner] == disc.class)
        .fold(0, |set, corner| set | 1 << corner)
}

/// Which discs to cap: the smallest set after which every class has at most one uncapped disc, no
/// two capped discs share a crossing, and the classes along a capped rim are all different. Of the
/// smallest sets, the one with the fewest corners inside its caps, then the first.
pub(super) fn caps(classes: &Classes, discs: &[Disc]) -> Vec<bool> {
    let n = discs.len();
    let chosen = |set: u32, i: usize| set >> i & 1 == 1;
    let fits = |set: u32| {
        let mut uncapped = [0; CORNERS];
        let mut crossings = 0u16;
        for (i, disc) in discs.iter().enumerate() {
            if chosen(set, i) {
                let rim = disc.rim_classes();
                let differ = rim.iter().enumerate().all(|(k, class)| !rim[..k].contains(class));
                if !differ || rim.len() < 2 || crossings & disc.crossings() != 0 {
                    return false;
                }
                crossings |= disc.crossings();
            } else {
                uncapped[usize::from(disc.class)] += 1;
            }
        }
        uncapped.iter().all(|&count| count <= 1)
    };
    let cost = |set: u32| {
        let corners: u32 =
            (0..n).filter(|&i| chosen(set, i)).map(|i| disc_corners(classes, &discs[i]).count_ones()).sum();
        (set.count_ones(), corners, set)
    };
    let best = (0..1u32 << n).filter(|&set| fits(set)).min_by_key(|&set| cost(set));
    // The exhaustive test over all entries shows that there always is such a set.
    let set = best.unwrap_or(0);
    (0..n).map(|i| chosen(set, i)).collect()
}
