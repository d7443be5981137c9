//! Kinks: where sharp edges of one interface pass through faces of cells, and what they make of a cell's triangles.
//!
//! Which faces may have one, and how a cell is put together then, is said in `docs/contouring.md`.

use glam::DVec3;

use super::bit_rows::BitRows;
use super::cell::{Cell, inside, worst};
use super::lattice::{Faces, face_rows};
use crate::classify::LabelVolume;
use crate::contour::crossing::{CrossingRule, Node};
use crate::contour::pattern::CellTriangle;
use crate::grid::cube::{EDGES, FACES, edge_faces};
use crate::triangle::triangle_quality;

/// The number that the kink of a cell's face 0 has among the cell's vertices: behind crossings, face nodes and apexes.
pub(super) const KINK: usize = 24;
/// The number of a cell's first tip.
pub(super) const TIP: usize = KINK + FACES;
/// As many kinks of a loop make a tip: an edge passes through two faces.
const TIP_KINKS: usize = 3;

/// The kink of the face across `axis` whose lowest corner is `low`, if it has one.
pub(super) fn kink_of<C: CrossingRule + ?Sized>(rule: &C, low: [usize; 3], axis: usize) -> Option<Node> {
    let mut node = rule.kink(low, axis).and_then(inside)?;
    node.at[axis] = 0.0;
    Some(node)
}

/// The faces across `axis` with lowest corners in plane `z` that have a kink.
pub(super) fn kinked<C: CrossingRule + ?Sized>(
    labels: &LabelVolume,
    rule: &C,
    axis: usize,
    z: usize,
) -> BitRows {
    let mut faces = pulp::Arch::new().dispatch(|| face_rows(labels, axis, z, Faces::Plain));
    faces.retain(|x, y| kink_of(rule, [x, y, z], axis).is_some());
    faces
}

/// A loop of crossings and kinks.
pub(super) struct Loop {
    /// Its vertices in order, as the triangles turn.
    pub(super) rim: Vec<u8>,
    /// A corner with the material behind it, and one with the material ahead.
    behind: u8,
    ahead: u8,
}

impl Loop {
    /// The places of kinks on the rim.
    pub(super) fn kinks(&self) -> impl Iterator<Item = usize> {
        (0..self.rim.len()).filter(|&i| usize::from(self.rim[i]) >= KINK)
    }

    /// Whether it becomes a cone from a tip.
    pub(super) fn has_tip(&self) -> bool {
        self.kinks().count() >= TIP_KINKS
    }

    /// The fan from the vertex at place `start` of the rim.
    pub(super) fn fan(&self, start: usize) -> impl Iterator<Item = CellTriangle> {
        let n = self.rim.len();
        (1..n - 1).map(move |i| self.triangle((start + i) % n, self.rim[start]))
    }

    /// The cone from a vertex.
    pub(super) fn cone(&self, from: u8) -> impl Iterator<Item = CellTriangle> {
        (0..self.rim.len()).map(move |i| self.triangle(i, from))
    }

    fn triangle(&self, i: usize, from: u8) -> CellTriangle {
        let vertices = [self.rim[i], self.rim[(i + 1) % self.rim.len()], from];
        CellTriangle { vertices, behind: self.behind, ahead: self.ahead }
    }
}

/// A cell's triangles where faces have kinks.
pub(super) struct Bent {
    /// Those that are settled.
    pub(super) triangles: Vec<CellTriangle>,
    /// Loops with kinks.
    pub(super) loops: Vec<Loop>,
}

impl Bent {
    /// Of the triangles of a cell without kinks; bit f of `kinked` says that face f has one.
    pub(super) fn new(triangles: &[CellTriangle], kinked: u8) -> Self {
        let mut out = Self { triangles: Vec::with_capacity(2 * triangles.len()), loops: Vec::new() };
        let mut fans: Vec<(u16, Vec<CellTriangle>)> = Vec::new();
        for t in triangles {
            if t.vertices.iter().all(|&v| usize::from(v) < EDGES) {
                let crossings = t.vertices.iter().fold(0, |set, v| set | 1u16 << v);
                // Loops have no crossing in common, and the triangles of a fan follow each other.
                match fans.last_mut().filter(|(all, _)| all & crossings != 0) {
                    Some((all, fan)) => {
                        *all |= crossings;
                        fan.push(*t);
                    }
                    None => fans.push((crossings, vec![*t])),
                }
            } else {
                out.split(t, kinked);
            }
        }
        for (_, fan) in fans {
            let rim = with_kinks(&rim(&fan), kinked);
            let bent = Loop { rim, behind: fan[0].behind, ahead: fan[0].ahead };
            if bent.kinks().next().is_some() {
                out.loops.push(bent);
            } else {
                out.triangles.extend(fan);
            }
        }
        out
    }

    /// How many tips there are.
    pub(super) fn tips(&self) -> usize {
        self.loops.iter().filter(|l| l.has_tip()).count()
    }

    /// Adds a triangle with an apex: one over a segment with a kink becomes two.
    fn split(&mut self, t: &CellTriangle, kinked: u8) {
        let on_segment = |i: &usize| kink_between(t.vertices[*i], t.vertices[(i + 1) % 3], kinked);
        let Some((i, k)) = (0..3).find_map(|i| Some((i, on_segment(&i)?))) else {
            return self.triangles.push(*t);
        };
        let [a, b, apex] = [0, 1, 2].map(|j| t.vertices[(i + j) % 3]);
        for vertices in [[a, k, apex], [k, b, apex]] {
            self.triangles.push(CellTriangle { vertices, ..*t });
        }
    }
}

/// The kink on the segment between two vertices of a cell, if that lies on a face that has one.
fn kink_between(a: u8, b: u8, kinked: u8) -> Option<u8> {
    if usize::from(a.max(b)) >= EDGES {
        return None;
    }
    let (of_a, of_b) = (edge_faces(a.into()), edge_faces(b.into()));
    // Edges of triangles that are no segments of faces have ends that share none.
    let face = of_a.into_iter().find(|f| of_b.contains(f) && kinked >> f & 1 == 1)?;
    Some((KINK + face) as u8)
}

/// The vertices around a fan, in order.
fn rim(fan: &[CellTriangle]) -> Vec<u8> {
    let edges = || fan.iter().flat_map(|t| (0..3).map(|i| (t.vertices[i], t.vertices[(i + 1) % 3])));
    let outer: Vec<(u8, u8)> = edges().filter(|&(a, b)| !edges().any(|e| e == (b, a))).collect();
    let mut rim = Vec::with_capacity(outer.len() + FACES);
    let mut at = outer.first().map(|e| e.0);
    while let Some(v) = at.filter(|_| rim.len() < outer.len()) {
        rim.push(v);
        at = outer.iter().find(|e| e.0 == v).map(|e| e.1);
    }
    rim
}

/// A rim with the kinks of its segments between their ends.
fn with_kinks(rim: &[u8], kinked: u8) -> Vec<u8> {
    let mut out = Vec::with_capacity(rim.len() + FACES);
    for (i, &v) in rim.iter().enumerate() {
        out.push(v);
        out.extend(kink_between(v, rim[(i + 1) % rim.len()], kinked));
    }
    out
}

impl Cell {
    /// A vertex of a loop, in units of the cell: a crossing or a kink.
    fn rim_vertex<C: CrossingRule>(&self, rule: &C, v: u8) -> Node {
        let v = usize::from(v);
        let Some(face) = v.checked_sub(KINK) else {
            return Node { at: self.crossing(rule, v), sigma: f32::NAN };
        };
        let (mut low, axis) = (self.low, face / 2);
        low[axis] += face % 2;
        // It is there, or the face would not be among those that have one.
        let mut node = kink_of(rule, low, axis).unwrap_or(Node { at: [0.5; 3], sigma: f32::NAN });
        node.at[axis] = (face % 2) as f32;
        node
    }

    /// The kink on a loop's rim from which its fan has the better worst triangle; of equals, the first.
    fn fan_start<C: CrossingRule>(&self, rule: &C, bent: &Loop) -> usize {
        let mut kinks = bent.kinks();
        let first = kinks.next().unwrap_or(0);
        let Some(second) = kinks.next() else { return first };
        let at: Vec<DVec3> =
            bent.rim.iter().map(|&v| DVec3::from(self.rim_vertex(rule, v).at.map(f64::from))).collect();
        let n = at.len();
        let worst = |start: usize| {
            let triangle = |i: usize| [at[(start + i) % n], at[(start + i + 1) % n], at[start]];
            (1..n - 1).map(|i| triangle_quality(triangle(i))).fold(1.0, f64::min)
        };
        if worst(second) > worst(first) { second } else { first }
    }

    /// The triangles of a cell of which the faces in `kinked` have kinks, from those without, and its tips. `crossings` are all
    /// of the cell's.
    pub(super) fn bent<C: CrossingRule>(
        &self,
        rule: &C,
        triangles: &[CellTriangle],
        crossings: u16,
        kinked: u8,
    ) -> (Vec<CellTriangle>, Vec<Node>) {
        let Bent { mut triangles, loops } = Bent::new(triangles, kinked);
        let mut tips = Vec::new();
        for bent in &loops {
            if bent.has_tip() {
                let alone = bent.rim.len() - bent.kinks().count() == crossings.count_ones() as usize;
                triangles.extend(bent.cone((TIP + tips.len()) as u8));
                tips.push(self.tip(rule, bent, alone));
            } else {
                triangles.extend(bent.fan(self.fan_start(rule, bent)));
            }
        }
        (triangles, tips)
    }

    /// The tip of a loop: what the rule knows, if the loop is `alone` in the cell, else the mean of its kinks.
    fn tip<C: CrossingRule>(&self, rule: &C, bent: &Loop, alone: bool) -> Node {
        if let Some(node) = rule.apex(self.low).filter(|_| alone).and_then(inside) {
            return node;
        }
        let kinks: Vec<Node> = bent.kinks().map(|i| self.rim_vertex(rule, bent.rim[i])).collect();
        let count = kinks.len() as f32;
        let at = [0, 1, 2].map(|a| kinks.iter().map(|k| k.at[a]).sum::<f32>() / count);
        let node = Node { at, sigma: worst(kinks.iter().map(|k| k.sigma)) };
        inside(node).unwrap_or(node)
    }
}
