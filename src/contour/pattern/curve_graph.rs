//! The curves on a cell's surface as a graph; its connected pieces (*sheets*) and the regions they
//! bound (*discs*).
//!
//! A disc is a cycle of directed curve edges that all have the same class on their left: one
//! material's boundary loop in one sheet (`docs/contouring.md`).

use super::face::{FaceCurves, curves, is_ambiguous, outward_ring, ring_edges};
use super::partition::Classes;
use crate::grid::cube::{EDGES, FACES};

/// A vertex of the graph: a crossing on cell edge `0..12`, or the node of face `12..18`.
pub type Node = u8;

/// First node number of the face nodes.
pub const FACE_NODE: Node = EDGES as Node;

/// A curve edge with a direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DirectedCurve {
    /// Where it starts.
    pub from: Node,
    /// Where it ends.
    pub to: Node,
    /// Class on its left, seen from outside the cell.
    pub left: u8,
    /// Class on its right.
    pub right: u8,
    /// The face it lies on.
    pub face: u8,
}

/// A loop of directed curves with one class on the left.
#[derive(Debug, Clone)]
pub struct Disc {
    /// The class inside.
    pub class: u8,
    /// Its boundary in order.
    pub rim: Vec<DirectedCurve>,
}

impl Disc {
    /// The classes on the other side, one for each run between face nodes, cyclically.
    #[must_use]
    pub fn rim_classes(&self) -> Vec<u8> {
        let starts: Vec<u8> = self.rim.iter().filter(|c| c.from >= FACE_NODE).map(|c| c.right).collect();
        if starts.is_empty() { vec![self.rim[0].right] } else { starts }
    }

    /// The crossings on the rim as a bit set.
    #[must_use]
    pub fn crossings(&self) -> u16 {
        self.rim.iter().filter(|c| c.from < FACE_NODE).fold(0, |set, c| set | 1 << c.from)
    }
}

/// A connected piece of the graph.
#[derive(Debug, Clone)]
pub struct Sheet {
    /// The regions of the cell's surface that it bounds.
    pub discs: Vec<Disc>,
    /// Its face nodes as a bit set over faces.
    pub face_nodes: u8,
    /// Its crossings as a bit set over cell edges.
    pub crossings: u16,
}

/// The sheets of a cell. `join_first` has bit f set where ambiguous face f joins its first diagonal.
#[must_use]
pub fn sheets(classes: &Classes, join_first: u8) -> Vec<Sheet> {
    let directed = directed_curves(classes, join_first);
    let mut used = vec![false; directed.len()];
    let mut sheet_of_node = [u8::MAX; EDGES + FACES];
    let mut sheets: Vec<Sheet> = Vec::new();
    for node in connected_order(&directed, &mut sheet_of_node) {
        let sheet = usize::from(sheet_of_node[usize::from(node)]);
        if sheets.len() <= sheet {
            sheets.push(Sheet { discs: Vec::new(), face_nodes: 0, crossings: 0 });
        }
        if node < FACE_NODE {
            sheets[sheet].crossings |= 1 << node;
        } else {
            sheets[sheet].face_nodes |= 1 << (node - FACE_NODE);
        }
    }
    for start in 0..directed.len() {
        if used[start] {
            continue;
        }
        let mut rim = Vec::new();
        let mut at = start;
        while !used[at] {
            used[at] = true;
            rim.push(directed[at]);
            at = next(&directed, at);
        }
        let sheet = usize::from(sheet_of_node[usize::from(directed[start].from)]);
        sheets[sheet].discs.push(Disc { class: directed[start].left, rim });
    }
    sheets
}

/// Every curve edge in both directions, in order of faces.
fn directed_curves(classes: &Classes, join_first: u8) -> Vec<DirectedCurve> {
    let mut out = Vec::new();
    for f in 0..FACES {
        let ring = outward_ring(f).map(|c| classes[c]);
        let edges = ring_edges(f);
        let crossing = |k: usize| edges[k] as Node;
        // Leaving the crossing on ring edge k into the face, corner k is on the left.
        let sides = |k: usize| (ring[k], ring[(k + 1) % 4]);
        let mut add = |from: Node, to: Node, (left, right): (u8, u8)| {
            let face = f as u8;
            out.push(DirectedCurve { from, to, left, right, face });
            out.push(DirectedCurve { from: to, to: from, left: right, right: left, face });
        };
        let join = is_ambiguous(classes, f) && join_first >> f & 1 == 1;
        let node = FACE_NODE + f as Node;
        match curves(classes, f, join) {
            FaceCurves::None => {}
            FaceCurves::One([a, b]) => add(crossing(a), crossing(b), sides(a)),
            FaceCurves::Two(segments) => {
                for [a, b] in segments {
                    add(crossing(a), crossing(b), sides(a));
                }
            }
            FaceCurves::Triple(spokes) => spokes.iter().for_each(|&k| add(crossing(k), node, sides(k))),
            FaceCurves::Quadruple => (0..4).for_each(|k| add(crossing(k), node, sides(k))),
        }
    }
    out
}

/// The next curve of the disc to the left of curve `at`.
fn next(directed: &[DirectedCurve], at: usize) -> usize {
    let here = directed[at];
    let continues = |c: &DirectedCurve| {
        c.from == here.to
            && c.left == here.left
            // At a crossing the disc goes on in the edge's other face; at a face node, along the
            // other spoke of its sector (the classes round a node all differ).
            && if here.to < FACE_NODE { c.face != here.face } else { c.to != here.from }
    };
    // Every class that reaches a node has exactly two curves there.
    directed.iter().position(continues).unwrap_or(at)
}

/// Numbers the connected pieces by their lowest node and returns all nodes, piece by piece.
fn connected_order(directed: &[DirectedCurve], sheet_of_node: &mut [u8]) -> Vec<Node> {
    let mut order = Vec::new();
    let mut sheets = 0;
    let mut nodes: Vec<Node> = directed.iter().map(|c| c.from).collect();
    nodes.sort_unstable();
    nodes.dedup();
    for start in nodes {
        if sheet_of_node[usize::from(start)] != u8::MAX {
            continue;
        }
        sheet_of_node[usize::from(start)] = sheets;
        let mut open = vec![start];
        while let Some(node) = open.pop() {
            order.push(node);
            for curve in directed.iter().filter(|c| c.from == node) {
                let seen = &mut sheet_of_node[usize::from(curve.to)];
                if *seen == u8::MAX {
                    *seen = sheets;
                    open.push(curve.to);
                }
            }
        }
        sheets += 1;
    }
    order
}
