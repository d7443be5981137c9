//! The vertices of the simplified surface: which leaves they stand for, where they lie and what they are.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::choices::Choices;
use super::forest::{Forest, Owner};
use super::leaves::{NONE, Root, flag};
use super::qef::{Place, Placement, Qef};
use super::roots::{SIDE, place};
use crate::grid::cube::{CORNERS, corner_offset};

/// A vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    pub(super) owner: Owner,
    /// Its root, as an index.
    pub(super) root: u32,
    /// In lengths about the middle of its root.
    pub(super) position: DVec3,
    /// Sides of the volume on which it lies.
    pub(super) sides: u8,
    /// Whether it lies at the mean of its crossings whatever its QEF says.
    pub(super) pinned: bool,
    /// Whether a curve that is known passes one of its leaves.
    pub(super) curve: bool,
}

/// All vertices, root by root.
#[derive(Debug, Clone, Default)]
pub(super) struct Vertices {
    pub(super) all: Vec<Vertex>,
    /// The vertex of each leaf; [`NONE`] for a leaf that no polygon uses.
    pub(super) of_leaf: Vec<u32>,
    /// Behind the last vertex of each root.
    ends: Vec<u32>,
}

impl Vertices {
    /// Numbers alone, for counting: leaves and nodes of a forest as it is.
    pub(super) fn numbered(forest: &Forest) -> Self {
        let leaves = forest.leaves.places.len() as u32;
        let number = |leaf: u32| match forest.owner(leaf) {
            Owner::Leaf(leaf) => leaf,
            Owner::Node(node) => leaves + node,
        };
        Self { of_leaf: (0..leaves).into_par_iter().map(number).collect(), ..Self::default() }
    }

    /// The vertices of a forest as it is, with what was decided about leaves, and the planes of their crossings
    /// by root, about the middles of the roots.
    pub(super) fn new(forest: &Forest, placement: Placement, choices: &Choices) -> (Self, Vec<Vec<Qef>>) {
        let made: Vec<Made> =
            forest.roots().map(|(i, root)| of_root(forest, i, root, placement, choices)).collect();
        let mut out = Self::default();
        let mut qefs = Vec::with_capacity(made.len());
        out.all.reserve(made.iter().map(|m| m.vertices.len()).sum());
        out.of_leaf.reserve(forest.leaves.places.len());
        for made in made {
            out.push(&made.vertices, made.of_leaf.iter().copied());
            qefs.push(made.qefs);
        }
        (out, qefs)
    }

    /// The same after changes in some roots, given by ascending index.
    pub(super) fn updated(
        &self,
        forest: &Forest,
        placement: Placement,
        choices: &Choices,
        changed: &[usize],
    ) -> Self {
        let roots = &forest.leaves.roots;
        let made: Vec<Made> =
            changed.par_iter().map(|&i| of_root(forest, i, &roots[i], placement, choices)).collect();
        let mut out = Self::default();
        out.all.reserve(self.all.len() + self.all.len() / 16);
        out.of_leaf.reserve(self.of_leaf.len());
        for (i, root) in roots.iter().enumerate() {
            match changed.binary_search(&i) {
                Ok(new) => out.push(&made[new].vertices, made[new].of_leaf.iter().copied()),
                Err(_) => {
                    let old = self.in_root(i);
                    let of_leaf = &self.of_leaf[root.leaves.start as usize..root.leaves.end as usize];
                    let first = old.start as u32;
                    out.push(
                        &self.all[old],
                        of_leaf.iter().map(|&v| if v == NONE { NONE } else { v - first }),
                    );
                }
            }
        }
        out
    }

    /// The vertices of a root, given by its index.
    pub(super) fn in_root(&self, root: usize) -> Range<usize> {
        let first = if root == 0 { 0 } else { self.ends[root - 1] };
        first as usize..self.ends[root] as usize
    }

    /// Lets the leaves of each vertex be those of the one that the list has in its place.
    pub(super) fn move_leaves(&mut self, to: &[u32]) {
        self.of_leaf.par_iter_mut().filter(|v| **v != NONE).for_each(|v| *v = to[*v as usize]);
    }

    fn push(&mut self, vertices: &[Vertex], of_leaf: impl Iterator<Item = u32>) {
        let first = self.all.len() as u32;
        self.all.extend_from_slice(vertices);
        self.of_leaf.extend(of_leaf.map(|v| if v == NONE { NONE } else { v + first }));
        self.ends.push(self.all.len() as u32);
    }
}

/// What was made of a root: its vertices, the planes of their crossings, and the vertex of each of its leaves,
/// numbered from 0.
struct Made {
    vertices: Vec<Vertex>,
    qefs: Vec<Qef>,
    of_leaf: Vec<u32>,
}

fn of_root(forest: &Forest, index: usize, root: &Root, placement: Placement, choices: &Choices) -> Made {
    let leaves = &forest.leaves;
    let first = root.leaves.start;
    let caps = leaves.caps.partition_point(|c| c.leaf < first)
        ..leaves.caps.partition_point(|c| c.leaf < root.leaves.end);
    let caps = &leaves.caps[caps];
    // Which leaves polygons use.
    let mut of_leaf = vec![NONE; root.leaves.len()];
    leaves.crossings_of(root, |_, crossing, _| {
        for leaf in crossing.ring.into_iter().filter(|l| root.leaves.contains(l)) {
            of_leaf[(leaf - first) as usize] = 0;
        }
    });
    caps.iter().for_each(|cap| of_leaf[(cap.main - first) as usize] = 0);
    let nodes = forest.nodes_of(index);
    let mut of_node = vec![NONE; nodes.len()];
    let mut out: Vec<Vertex> = Vec::new();
    for leaf in root.leaves.clone() {
        if of_leaf[(leaf - first) as usize] == NONE {
            continue;
        }
        let owner = forest.owner(leaf);
        let sides = leaves.sides(root, leaf);
        let curve = leaves.knows_curves && leaves.flags[leaf as usize] & flag::CURVE != 0;
        let number = match owner {
            Owner::Node(node) if of_node[(node - nodes.start) as usize] != NONE => {
                let number = of_node[(node - nodes.start) as usize];
                out[number as usize].sides |= sides;
                out[number as usize].curve |= curve;
                number
            }
            _ => {
                let number = out.len() as u32;
                if let Owner::Node(node) = owner {
                    of_node[(node - nodes.start) as usize] = number;
                }
                let crowded =
                    matches!(owner, Owner::Leaf(l) if leaves.flags[l as usize] & flag::CROWDED != 0);
                out.push(Vertex {
                    owner,
                    root: index as u32,
                    position: DVec3::ZERO,
                    sides,
                    curve,
                    pinned: crowded
                        || matches!(owner, Owner::Leaf(l) if choices.pinned.binary_search(&l).is_ok()),
                });
                number
            }
        };
        of_leaf[(leaf - first) as usize] = number;
    }
    let mut qefs = vec![Qef::default(); out.len()];
    leaves.add_planes(root, &mut qefs, |leaf| of_leaf[(leaf - first) as usize] as usize);
    for (vertex, qef) in out.iter_mut().zip(&qefs) {
        let bounds = forest.block(vertex.owner).bounds(&leaves.grid);
        let place = Place { bounds, fixed: leaves.grid.fixed(root.number, vertex.sides) };
        vertex.position = match vertex.owner {
            _ if vertex.pinned => place.clamp(qef.mass_point()),
            Owner::Node(node) => place.clamp(forest.nodes[node as usize].position.as_dvec3()),
            Owner::Leaf(leaf) if choices.returned.binary_search(&leaf).is_ok() => {
                let at = choices.place_inside(leaf);
                at.unwrap_or_else(|| leaves.vertex_inside(root, leaf, qef, placement))
            }
            Owner::Leaf(leaf) => {
                choices.place_of(leaf).unwrap_or_else(|| leaves.vertex(root, leaf, qef, placement))
            }
        };
    }
    // Caps lie between the middle of their sheet's crossings and the corners that they cut off.
    for sheet in caps.chunk_by(|a, b| a.main == b.main) {
        let main = of_leaf[(sheet[0].main - first) as usize] as usize;
        let mut all = qefs[main];
        sheet.iter().for_each(|cap| all.merge(&qefs[of_leaf[(cap.leaf - first) as usize] as usize]));
        let fixed = leaves.grid.fixed(root.number, out[main].sides);
        let main_place = Place { bounds: forest.block(out[main].owner).bounds(&leaves.grid), fixed };
        let middle = main_place.clamp(all.mass_point());
        out[main].position = middle;
        for cap in sheet {
            let low =
                DVec3::from(place(leaves.places[cap.leaf as usize]).map(|c| c as f64 - (SIDE / 2) as f64));
            let corners = (0..CORNERS).filter(|c| cap.corners >> c & 1 == 1);
            let count = f64::from(cap.corners.count_ones());
            let corner: DVec3 =
                corners.map(|c| DVec3::from(corner_offset(c).map(|o| o as f64))).sum::<DVec3>() / count;
            let vertex = &mut out[of_leaf[(cap.leaf - first) as usize] as usize];
            vertex.position = main_place.clamp((middle + (low + corner) * leaves.grid.cell) / 2.0);
        }
    }
    Made { vertices: out, qefs, of_leaf }
}
