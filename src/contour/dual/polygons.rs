//! From rings to triangles.
//!
//! A crossing's polygon joins the vertices of the leaves in its ring; what became one vertex drops out, and
//! with fewer than three the polygon does. A quad is split along one diagonal, by the better quality q
//! (000_f7f54f44c17ac186 eq. 14). A polygon that passes a knot that needs a vertex, and one that the remedy
//! asks for, becomes a *star*: a fan from its crossing.

use glam::DVec3;
use rayon::prelude::*;

use super::choices::Choices;
use super::forest::Forest;
use super::leaves::{Crossing, Knot, NONE, Pass};
use super::placement::World;
use super::sigmas::worst_sigma;
use super::vertices::Vertices;
use crate::contour::marching::pair_of;
use crate::contour::patch::Border;
use crate::grid::{MaterialId, Pair};
use crate::triangle::triangle_quality;

/// A surface of triangles, in the world, mm.
#[derive(Debug, Clone, Default)]
pub(super) struct Triangles {
    pub(super) positions: Vec<DVec3>,
    /// Whether each vertex lies on the volume's border.
    pub(super) on_border: Vec<bool>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) pairs: Vec<Pair>,
    /// The crossing of each triangle's polygon; [`NONE`] for one that ties a cap to its sheet.
    pub(super) crossings: Vec<u32>,
    /// Sigmas of the vertices beside those of leaves and nodes, voxels; empty if none are known.
    pub(super) extra_sigmas: Vec<f32>,
}

/// Vertices beside those of leaves and nodes.
struct Extra<'a> {
    /// Ways of polygons through knots that have a vertex, ascending, with the vertex.
    passes: Vec<(Pass, u32)>,
    /// Crossings with a vertex of their own, ascending; the vertices follow each other from the first.
    centres: Vec<u32>,
    first_centre: u32,
    /// The vertex of each knot.
    of_knot: Vec<u32>,
    choices: &'a Choices,
}

impl Extra<'_> {
    /// The vertices of knots that crossing `c` passes, by place in the ring.
    fn passed(&self, c: u32) -> [u32; 4] {
        let mut out = [NONE; 4];
        let from = self.passes.partition_point(|((crossing, _), _)| *crossing < c);
        let own = self.passes[from..].iter().take_while(|((crossing, _), _)| *crossing == c);
        own.for_each(|((_, i), vertex)| out[usize::from(*i)] = *vertex);
        out
    }

    fn centre(&self, c: u32) -> Option<u32> {
        self.centres.binary_search(&c).ok().map(|i| self.first_centre + i as u32)
    }
}

/// The vertices of a ring of leaves, as [`distinct`].
pub(super) fn mapped(vertices: &Vertices, ring: [u32; 4]) -> ([u32; 4], usize) {
    distinct(ring.map(|leaf| vertices.of_leaf[leaf as usize]))
}

/// The vertices of a ring in order, what became one only once, and how many they are. Two that take turns do not
/// occur: the blocks around an edge cannot.
pub(super) fn distinct(ring: [u32; 4]) -> ([u32; 4], usize) {
    let mut out = [NONE; 4];
    let mut count = 0;
    for i in 0..4 {
        if ring[i] != ring[(i + 3) % 4] {
            out[count] = ring[i];
            count += 1;
        }
    }
    (out, count)
}

/// The triangles of all polygons and ties.
pub(super) fn triangulate(
    forest: &Forest,
    vertices: &Vertices,
    knots: &[Knot],
    choices: &Choices,
    world: &World<'_>,
    border: Border,
) -> Triangles {
    let leaves = &forest.leaves;
    let mut out = Triangles {
        positions: vertices
            .all
            .par_iter()
            .map(|v| world.place(leaves.roots[v.root as usize].number, v.position))
            .collect(),
        on_border: vertices.all.iter().map(|v| v.sides != 0).collect(),
        ..Triangles::default()
    };
    let extra = extra(forest, vertices, knots, choices, world, &mut out);
    let by_root: Vec<Triangles> = forest
        .roots()
        .map(|(_, root)| {
            let mut part = Triangles::default();
            for c in root.crossings.clone() {
                put_polygon(
                    &mut part,
                    c,
                    &leaves.crossings[c as usize],
                    vertices,
                    &extra,
                    &out.positions,
                    border,
                );
            }
            part
        })
        .collect();
    for part in by_root {
        out.triangles.extend(part.triangles);
        out.pairs.extend(part.pairs);
        out.crossings.extend(part.crossings);
    }
    for tie in &leaves.ties {
        let knot = extra.of_knot[tie.knot as usize];
        let [a, b] = tie.leaves.map(|leaf| vertices.of_leaf[leaf as usize]);
        if knot != NONE && pair_of([tie.pair.back(), tie.pair.front()], border).is_some() {
            out.triangles.push([knot, a, b]);
            out.pairs.push(tie.pair);
            out.crossings.push(NONE);
        }
    }
    out
}

/// Makes the vertices of knots and of stars.
fn extra<'a>(
    forest: &Forest,
    vertices: &Vertices,
    knots: &[Knot],
    choices: &'a Choices,
    world: &World<'_>,
    out: &mut Triangles,
) -> Extra<'a> {
    let leaves = &forest.leaves;
    let mut of_knot = vec![NONE; knots.len()];
    let mut passes: Vec<(Pass, u32)> = Vec::new();
    for (k, knot) in knots.iter().enumerate() {
        let Some(&(c, i)) = knot.passes.first() else { continue };
        let sides = |(c, i): Pass| {
            let ring = leaves.crossings[c as usize].ring;
            [ring[usize::from(i)], ring[usize::from(i + 1) % 4]].map(|leaf| vertices.of_leaf[leaf as usize])
        };
        if let Some(twin) = knot.twin {
            let mut here = sides((c, i));
            let Some(&other) = knots[twin as usize].passes.first() else { continue };
            let mut there = sides(other);
            here.sort_unstable();
            there.sort_unstable();
            if here != there {
                continue;
            }
        }
        let vertex = out.positions.len() as u32;
        of_knot[k] = vertex;
        passes.extend(knot.passes.iter().map(|&pass| (pass, vertex)));
        // At the mean of its crossings, in the border plane if both cells reach beyond it.
        let root = leaves.root_of_crossing(c);
        let mut at = DVec3::ZERO;
        for &(c, _) in &knot.passes {
            let of = leaves.root_of_crossing(c);
            let apart = leaves.apart(&leaves.roots[of], &leaves.roots[root]);
            let crossing = &leaves.crossings[c as usize];
            at += crossing.at(&leaves.grid, apart) / knot.passes.len() as f64;
        }
        let ring = leaves.crossings[c as usize].ring;
        let both = [ring[usize::from(i)], ring[usize::from(i + 1) % 4]]
            .map(|leaf| leaves.sides(&leaves.roots[leaves.root_of_leaf(leaf)], leaf))
            .into_iter()
            .fold(u8::MAX, |both, sides| both & sides);
        let fixed = leaves.grid.fixed(leaves.roots[root].number, both);
        (0..3).for_each(|a| at[a] = fixed[a].unwrap_or(at[a]));
        out.positions.push(world.place(leaves.roots[root].number, at));
        out.on_border.push(both != 0);
        out.extra_sigmas.extend(worst_sigma(leaves, knot.passes.iter().map(|pass| pass.0)));
    }
    passes.sort_unstable();
    let mut centres: Vec<u32> =
        passes.iter().map(|((c, _), _)| *c).chain(choices.stars.iter().copied()).collect();
    centres.sort_unstable();
    centres.dedup();
    centres.retain(|&c| mapped(vertices, leaves.crossings[c as usize].ring).1 >= 3);
    let first_centre = out.positions.len() as u32;
    for &c in &centres {
        let crossing = &leaves.crossings[c as usize];
        let root = &leaves.roots[leaves.root_of_crossing(c)];
        out.positions.push(world.place(root.number, crossing.at(&leaves.grid, [0; 3])));
        out.on_border.push(crossing.labels.contains(&MaterialId::OUTSIDE));
        out.extra_sigmas.extend(worst_sigma(leaves, [c]));
    }
    Extra { passes, centres, first_centre, of_knot, choices }
}

/// Adds the triangles of a crossing's polygon.
fn put_polygon(
    out: &mut Triangles,
    c: u32,
    crossing: &Crossing,
    vertices: &Vertices,
    extra: &Extra<'_>,
    positions: &[DVec3],
    border: Border,
) {
    let (ring, count) = mapped(vertices, crossing.ring);
    let Some((pair, turned)) = crossing.pair(border).filter(|_| count >= 3) else { return };
    let mut put = |[a, b, c_]: [u32; 3]| {
        out.triangles.push(if turned { [a, c_, b] } else { [a, b, c_] });
        out.pairs.push(pair);
        out.crossings.push(c);
    };
    if let Some(centre) = extra.centre(c) {
        let passed = extra.passed(c);
        let all = crossing.ring.map(|leaf| vertices.of_leaf[leaf as usize]);
        let mut rim = Vec::with_capacity(8);
        for i in 0..4 {
            if rim.last() != Some(&all[i]) {
                rim.push(all[i]);
            }
            if passed[i] != NONE {
                rim.push(passed[i]);
            }
        }
        if rim.len() > 1 && rim.first() == rim.last() {
            rim.pop();
        }
        (0..rim.len()).for_each(|i| put([rim[i], rim[(i + 1) % rim.len()], centre]));
    } else if count == 3 {
        put([ring[0], ring[1], ring[2]]);
    } else {
        let at = ring.map(|v| positions[v as usize]);
        let other = extra.choices.other_diagonal.binary_search(&c).is_ok();
        let first = splits_first(at) != other;
        let [p, q, r, s] = ring;
        let split = if first { [[p, q, r], [p, r, s]] } else { [[q, r, s], [q, s, p]] };
        split.into_iter().for_each(put);
    }
}

/// Whether a quad is better split between its corners 0 and 2 than between 1 and 3: its two triangles must
/// not face away from each other; of what is left, the one with the better worst triangle.
fn splits_first([p, q, r, s]: [DVec3; 4]) -> bool {
    let worth = |a: [DVec3; 3], b: [DVec3; 3]| {
        let normal = |t: [DVec3; 3]| (t[1] - t[0]).cross(t[2] - t[0]);
        let least = triangle_quality(a).min(triangle_quality(b));
        if normal(a).dot(normal(b)) > 0.0 { least } else { least - 1.0 }
    };
    worth([p, q, r], [p, r, s]) >= worth([q, r, s], [q, s, p])
}
