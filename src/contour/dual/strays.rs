//! Strays: vertices of curves beside their cells.
//!
//! Labels tell to a voxel which cells a curve passes, models where it is to a few hundredths. So the curve often passes beside the
//! cell in whose corners its materials meet, by up to half a cell; the best point of the cell is then as far off. Where the rule
//! knows curves, the vertex of a simple leaf on a curve may lie beyond the one side of its cell from which the minimum of
//! its QEF is farthest, by no more than [`STRAY`]. Beyond one side only: along the curve it stays beside its cell, or the vertices
//! of neighbours would change their order on the curve.
//!
//! What a cell promises, that triangles do not fold, is not promised then. So the remedy takes strays back into their cells: of
//! triangles that meet others, and of those that face away from the interface at their crossing.

use glam::DVec3;

use super::choices::Choices;
use super::forest::{Forest, Owner};
use super::leaves::{Leaves, NONE, flag};
use super::octree::Bound;
use super::polygons::Triangles;
use super::qef::{Place, Placement, Qef};
use super::relax::relax;
use super::vertices::{Vertex, Vertices};
use crate::contour::patch::Border;

/// How far beside its cell the vertex of a curve may lie, cells.
const STRAY: f64 = 0.5;

impl Leaves {
    /// Whether the vertex of a leaf may lie beside its cell.
    pub(super) fn may_stray(&self, leaf: u32) -> bool {
        let flags = flag::CURVE | flag::SIMPLE | flag::CROWDED | flag::BORDER;
        self.knows_curves && self.flags[leaf as usize] & flags == flag::CURVE | flag::SIMPLE
    }
}

/// The vertex of a leaf that may stray, of a lattice with cells of size `cell`: where its best point is, if that is beyond a side of
/// its cell, else `inside`.
pub(super) fn strayed(cell: DVec3, qef: &Qef, place: &Place, inside: DVec3) -> DVec3 {
    let [low, high] = place.bounds;
    let within = |by: DVec3| Place { bounds: [low - by, high + by], ..*place };
    let by = STRAY * cell;
    let best = qef.minimiser_near(inside, &within(by));
    let beyond = (low - best).max(best - high) / cell;
    let axis = beyond.max_position();
    if beyond[axis] > 0.0 { qef.minimiser_near(inside, &within(DVec3::AXES[axis] * by)) } else { inside }
}

/// Where relaxation puts the vertices of leaves that may stray while they are inside their cells: where they go back to. Ascending.
pub(super) fn places_inside(
    forest: &Forest,
    vertices: &Vertices,
    qefs: &[Vec<Qef>],
    placement: Placement,
    bound: Bound,
) -> Vec<(u32, DVec3)> {
    let leaves = &forest.leaves;
    let strays = |vertex: &Vertex| match vertex.owner {
        Owner::Leaf(leaf) if leaves.may_stray(leaf) => Some(leaf),
        _ => None,
    };
    let mut inside = vertices.clone();
    for (i, root) in leaves.roots.iter().enumerate() {
        for (vertex, qef) in inside.all[vertices.in_root(i)].iter_mut().zip(&qefs[i]) {
            if let Some(leaf) = strays(vertex) {
                vertex.position = leaves.vertex_inside(root, leaf, qef, placement);
            }
        }
    }
    relax(forest, &mut inside, qefs, bound);
    inside.all.iter().filter_map(|vertex| Some((strays(vertex)?, vertex.position))).collect()
}

/// The leaf of a vertex that lies beside its cell and was not told to go back.
pub(super) fn stray(forest: &Forest, vertices: &Vertices, choices: &Choices, v: u32) -> Option<u32> {
    // Vertices of knots and centres are behind the others.
    let vertex = vertices.all.get(v as usize)?;
    let Owner::Leaf(leaf) = vertex.owner else { return None };
    let [low, high] = forest.block(vertex.owner).bounds(&forest.leaves.grid);
    let is_beside = vertex.position.clamp(low, high) != vertex.position;
    (is_beside && choices.returned.binary_search(&leaf).is_err()).then_some(leaf)
}

/// Whether a triangle of vertices alone faces away from the interface at its crossing.
pub(super) fn is_turned(
    forest: &Forest,
    vertices: &Vertices,
    made: &Triangles,
    border: Border,
    t: usize,
) -> bool {
    let crossing = made.crossings[t];
    if crossing == NONE {
        return false;
    }
    let leaves = &forest.leaves;
    let crossing = &leaves.crossings[crossing as usize];
    let Some((_, over)) = crossing.pair(border) else { return false };
    // In lengths along the lattice, as normals are: the world may be turned against it.
    let at = |v: u32| {
        let vertex = vertices.all.get(v as usize)?;
        Some(vertex.position + leaves.grid.offset(leaves.roots[vertex.root as usize].number))
    };
    let [Some(p), Some(q), Some(r)] = made.triangles[t].map(at) else { return false };
    let facing = (q - p).cross(r - p).dot(crossing.normal.as_dvec3());
    if over { facing > 0.0 } else { facing < 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const CELL: DVec3 = DVec3::new(1.0, 0.8, 1.3);

    fn cell() -> Place {
        Place { bounds: [DVec3::ZERO, CELL], fixed: [None; 3] }
    }

    #[test]
    fn a_curve_beside_its_cell_is_reached_and_others_stay_inside() {
        let vertex = |x: f64, z: f64| {
            let mut qef = Qef::default();
            for t in [0.2, 0.6] {
                let mut add = |at: DVec3, normal: DVec3| qef.add(at, at, normal, 1.0);
                add(DVec3::new(x, t, 0.5), DVec3::X);
                add(DVec3::new(0.5, t, z), DVec3::Z);
            }
            strayed(CELL, &qef, &cell(), qef.minimiser_within(&cell()))
        };
        assert!(vertex(-0.3, 0.9).distance(DVec3::new(-0.3, 0.4, 0.9)) < 1e-9);
        assert!(vertex(0.3, 0.9).distance(DVec3::new(0.3, 0.4, 0.9)) < 1e-9);
        // Beyond two sides: the farther one counts.
        assert!(vertex(-0.3, 1.4).distance(DVec3::new(-0.3, 0.4, 1.3)) < 1e-9);
        assert!(vertex(-2.0, 0.9).distance(DVec3::new(-0.5, 0.4, 0.9)) < 1e-9);
    }

    fn vector(r: f64) -> impl Strategy<Value = DVec3> {
        [-r..r, -r..r, -r..r].prop_map(DVec3::from)
    }

    proptest! {
        #[test]
        fn a_stray_is_beyond_one_side_and_nearer_to_its_planes(
            planes in prop::collection::vec((vector(2.0), vector(1.0)), 3..12),
        ) {
            let mut qef = Qef::default();
            planes.iter().for_each(|(p, n)| qef.add(*p, *p, n.normalize_or(DVec3::X), 1.0));
            let inside = qef.minimiser_within(&cell());
            let at = strayed(CELL, &qef, &cell(), inside);
            let beyond = (-at).max(at - CELL).max(DVec3::ZERO) / CELL;
            prop_assert!(beyond.max_element() <= STRAY + 1e-12);
            prop_assert!(beyond.to_array().iter().filter(|b| **b > 0.0).count() <= 1);
            prop_assert!(qef.error(at) <= qef.error(inside) * (1.0 + 1e-9) + 1e-9);
        }
    }
}
