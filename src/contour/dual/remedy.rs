//! Until no triangles meet where they must not.
//!
//! In rounds (the prototype's loop): all pairs that meet are found with exact predicates, on the positions as
//! they will be written; then each pair asks for the first of these steps that is still open to it:
//! 1. strays (`strays.rs`) among its vertices, then those of its polygons, go back into their cells;
//! 2. quads of its polygons are split along the other diagonal (once each);
//! 3. the largest nodes among their vertices are split;
//! 4. their leaves go to the mean of their crossings;
//! 5. their polygons become fans from their crossings, with vertices on the faces that they pass: cones
//!    inside the cells.
//!
//! All pairs of a round ask at once and what is asked for twice is done once, so order does not matter. Each
//! step is taken once per item and none is taken back, so the loop ends. A triangle without area is treated
//! like a pair. Strays of triangles that face away from their interface go back at once: a diagonal turned for a stray
//! would not suit the place that it may go back to later. What was not changed is not tested again.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::choices::Choices;
use super::forest::{Forest, Owner};
use super::leaves::{Knot, NONE, ring_face_axis};
use super::octree::Bound;
use super::placement::World;
use super::polygons::{Triangles, mapped, triangulate};
use super::qef::Placement;
use super::relax::relax;
use super::strays::{is_turned, places_inside, stray};
use super::vertices::Vertices;
use crate::contour::error::ContourError;
use crate::contour::patch::Border;
use crate::execution::Execution;
use crate::triangle::{Search, without_area};

/// How far relaxation may move vertices where nothing is simplified, in voxels of mean edge: nothing that a scan
/// could tell.
const STILL: f64 = 0.02;

/// What the remedy did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remedy {
    /// Pairs of triangles that met, or triangles without area, before anything was done about it.
    pub found: u64,
    /// Rounds of the loop.
    pub rounds: u64,
    /// Quads split along the other diagonal.
    pub diagonals: u64,
    /// Collapses undone.
    pub undone: u64,
    /// Vertices of curves put back into their cells.
    #[serde(default)]
    pub returned: u64,
    /// Leaves put at the mean of their crossings.
    pub pinned: u64,
    /// Polygons made fans.
    pub fanned: u64,
    /// Pairs that nothing could be done about.
    pub left: u64,
}

/// How to make the surface.
#[derive(Clone, Copy)]
pub(super) struct Making<'a> {
    pub(super) bound: Bound,
    pub(super) placement: Placement,
    pub(super) border: Border,
    pub(super) world: &'a World<'a>,
    pub(super) execution: &'a Execution,
}

/// Makes the triangles of a graded forest and mends them.
pub(super) fn mend(
    forest: &mut Forest,
    making: Making<'_>,
) -> Result<(Vertices, Triangles, Remedy), ContourError> {
    let Making { bound, placement, border, world, execution } = making;
    let mut choices = Choices::default();
    let mut knots = forest.leaves.knots.clone();
    let (mut vertices, qefs) = Vertices::new(forest, placement, &choices);
    let still = if bound == Bound::None { Bound::Rms(STILL) } else { bound };
    if forest.leaves.knows_curves {
        choices.inside = places_inside(forest, &vertices, &qefs, placement, still);
    }
    relax(forest, &mut vertices, &qefs, still);
    drop(qefs);
    keep_places(forest, &vertices, &mut choices);
    let mut remedy = Remedy::default();
    let mut fresh: Option<Fresh> = None;
    loop {
        execution.check()?;
        let made = triangulate(forest, &vertices, &knots, &choices, world, border);
        let flat = without_area(&made.positions, &made.triangles);
        let asked: Vec<bool> = match &fresh {
            None => Vec::new(),
            Some(fresh) => (0..made.triangles.len())
                .into_par_iter()
                .map(|t| fresh.has(forest, &vertices, &made, t))
                .collect(),
        };
        let is_asked = |t: usize| asked.is_empty() || asked[t];
        let met = Search::new(&made.positions, &made.triangles, &flat).run(is_asked, execution)?;
        let alone = (0..flat.len()).filter(|&t| flat[t] && is_asked(t)).map(|t| [t as u32; 2]);
        let wrong: Vec<[u32; 2]> = met.first.into_iter().chain(alone).collect();
        if fresh.is_none() {
            remedy.found = wrong.len() as u64;
        }
        let mut next = Fresh::default();
        for pair in &wrong {
            next.ask(forest, &vertices, &made, &choices, *pair);
        }
        // Without known curves there are no strays.
        let looked_at = if forest.leaves.knows_curves { made.triangles.len() } else { 0 };
        for t in (0..looked_at).filter(|&t| is_asked(t)) {
            next.ask_turned(forest, &vertices, &made, &choices, border, t);
        }
        remedy.left += next.stuck;
        if !next.settle(&mut choices, &mut remedy) {
            return Ok((vertices, made, remedy));
        }
        remedy.rounds += 1;
        next.split.iter().for_each(|&node| forest.split(node));
        next.stars.iter().for_each(|&c| knot_all_sides(forest, &mut knots, c));
        let mut changed: Vec<usize> = next.split.iter().map(|&node| forest.root_of_node(node)).collect();
        changed
            .extend(next.returned.iter().chain(&next.pinned).map(|&leaf| forest.leaves.root_of_leaf(leaf)));
        changed.sort_unstable();
        changed.dedup();
        vertices = vertices.updated(forest, placement, &choices, &changed);
        fresh = Some(next);
    }
}

/// Remembers where relaxation put the vertices.
fn keep_places(forest: &mut Forest, vertices: &Vertices, choices: &mut Choices) {
    for vertex in &vertices.all {
        let at = vertex.position;
        match vertex.owner {
            Owner::Node(node) => forest.nodes[node as usize].position = at.as_vec3(),
            Owner::Leaf(leaf) if !vertex.pinned => choices.moved.push((leaf, at)),
            Owner::Leaf(_) => {}
        }
    }
    choices.moved.sort_unstable_by_key(|(leaf, _)| *leaf);
}

/// What a round asks for; ascending once settled.
#[derive(Debug, Default)]
struct Fresh {
    diagonals: Vec<u32>,
    split: Vec<u32>,
    returned: Vec<u32>,
    pinned: Vec<u32>,
    stars: Vec<u32>,
    stuck: u64,
}

impl Fresh {
    /// The step for a pair of triangles that meet.
    fn ask(
        &mut self,
        forest: &Forest,
        vertices: &Vertices,
        made: &Triangles,
        choices: &Choices,
        pair: [u32; 2],
    ) {
        let mut polygons: Vec<u32> =
            pair.iter().map(|&t| made.crossings[t as usize]).filter(|&c| c != NONE).collect();
        polygons.dedup();
        let crossing = |c: u32| &forest.leaves.crossings[c as usize];
        let is_star = |c: &u32| choices.stars.binary_search(c).is_ok();
        let strays = |v: u32| stray(forest, vertices, choices, v);
        let mut returned: Vec<u32> =
            pair.iter().flat_map(|&t| made.triangles[t as usize]).filter_map(strays).collect();
        if returned.is_empty() {
            let rings = polygons.iter().flat_map(|&c| crossing(c).ring);
            returned.extend(rings.map(|leaf| vertices.of_leaf[leaf as usize]).filter_map(strays));
        }
        if !returned.is_empty() {
            self.returned.extend(returned);
            return;
        }
        let quads: Vec<u32> =
            polygons.iter().copied().filter(|&c| can_turn_diagonal(forest, vertices, choices, c)).collect();
        if !quads.is_empty() {
            self.diagonals.extend(quads);
            return;
        }
        let owners: Vec<Owner> =
            polygons.iter().flat_map(|&c| crossing(c).ring).map(|leaf| forest.owner(leaf)).collect();
        let nodes = owners.iter().filter_map(|o| match o {
            Owner::Node(node) => Some((forest.nodes[*node as usize].block.level, *node)),
            Owner::Leaf(_) => None,
        });
        if let Some(largest) = nodes.clone().map(|(level, _)| level).max() {
            self.split.extend(nodes.filter(|(level, _)| *level == largest).map(|(_, node)| node));
            return;
        }
        let leaves: Vec<u32> = owners
            .iter()
            .filter_map(|o| match o {
                Owner::Leaf(leaf) if !vertices.all[vertices.of_leaf[*leaf as usize] as usize].pinned => {
                    Some(*leaf)
                }
                _ => None,
            })
            .collect();
        if !leaves.is_empty() {
            self.pinned.extend(leaves);
            return;
        }
        let plain: Vec<u32> = polygons.iter().copied().filter(|c| !is_star(c)).collect();
        if plain.is_empty() {
            self.stuck += 1;
        }
        self.stars.extend(plain);
    }

    /// The strays of a triangle that faces away from its interface go back.
    fn ask_turned(
        &mut self,
        forest: &Forest,
        vertices: &Vertices,
        made: &Triangles,
        choices: &Choices,
        border: Border,
        t: usize,
    ) {
        let strays = |v: u32| stray(forest, vertices, choices, v);
        let mut returned = made.triangles[t].into_iter().filter_map(strays).peekable();
        if returned.peek().is_some() && is_turned(forest, vertices, made, border, t) {
            self.returned.extend(returned);
        }
    }

    /// Sorts what was asked for and adds it to the choices; whether there is anything to do.
    fn settle(&mut self, choices: &mut Choices, remedy: &mut Remedy) -> bool {
        for list in
            [&mut self.diagonals, &mut self.split, &mut self.returned, &mut self.pinned, &mut self.stars]
        {
            list.sort_unstable();
            list.dedup();
        }
        let join = |all: &mut Vec<u32>, more: &[u32]| {
            all.extend_from_slice(more);
            all.sort_unstable();
        };
        join(&mut choices.other_diagonal, &self.diagonals);
        join(&mut choices.returned, &self.returned);
        join(&mut choices.pinned, &self.pinned);
        join(&mut choices.stars, &self.stars);
        remedy.diagonals += self.diagonals.len() as u64;
        remedy.undone += self.split.len() as u64;
        remedy.returned += self.returned.len() as u64;
        remedy.pinned += self.pinned.len() as u64;
        remedy.fanned += self.stars.len() as u64;
        !(self.diagonals.is_empty()
            && self.split.is_empty()
            && self.returned.is_empty()
            && self.pinned.is_empty()
            && self.stars.is_empty())
    }

    /// Whether a triangle or another one of its polygon is not what it was before this round: what a pair asks for may change others
    /// than the two, which then ask again.
    fn has(&self, forest: &Forest, vertices: &Vertices, made: &Triangles, t: usize) -> bool {
        let c = made.crossings[t];
        let asked = |list: &[u32]| list.binary_search(&c).is_ok();
        let is_new = |owner: Owner| match owner {
            Owner::Leaf(leaf)
                if [&self.returned, &self.pinned].iter().any(|l| l.binary_search(&leaf).is_ok()) =>
            {
                true
            }
            _ => self.split.binary_search(&forest.parent(owner)).is_ok(),
        };
        // Vertices of knots and centres are behind the others; they may be new.
        let is_fresh = |v: u32| vertices.all.get(v as usize).is_none_or(|v| is_new(v.owner));
        let ring = || forest.leaves.crossings.get(c as usize).into_iter().flat_map(|crossing| crossing.ring);
        asked(&self.diagonals)
            || asked(&self.stars)
            || made.triangles[t].into_iter().any(is_fresh)
            || ring().map(|leaf| vertices.of_leaf[leaf as usize]).any(is_fresh)
    }
}

/// Whether a crossing's polygon is a quad that was not yet split along its other diagonal.
fn can_turn_diagonal(forest: &Forest, vertices: &Vertices, choices: &Choices, c: u32) -> bool {
    let was_changed = [&choices.stars, &choices.other_diagonal].iter().any(|l| l.binary_search(&c).is_ok());
    !was_changed && mapped(vertices, forest.leaves.crossings[c as usize].ring).1 == 4
}

/// Sees to it that there is a knot on each of the four faces that a crossing's polygon passes.
fn knot_all_sides(forest: &Forest, knots: &mut Vec<Knot>, c: u32) {
    let leaves = &forest.leaves;
    let crossing = &leaves.crossings[c as usize];
    for i in 0..4u8 {
        if let Some(knot) = knots.iter_mut().find(|k| k.passes.contains(&(c, i))) {
            knot.twin = None;
            continue;
        }
        let [a, b] = [i, (i + 1) % 4].map(|k| crossing.ring[usize::from(k)]);
        let axis = ring_face_axis(crossing.axis.into(), i.into());
        let mut passes = Vec::new();
        let root = &leaves.roots[leaves.root_of_leaf(a)];
        leaves.crossings_of(root, |number, other, _| {
            for k in 0..4u8 {
                let ends = [k, (k + 1) % 4].map(|k| other.ring[usize::from(k)]);
                if (ends == [a, b] || ends == [b, a]) && ring_face_axis(other.axis.into(), k.into()) == axis {
                    passes.push((number, k));
                }
            }
        });
        passes.sort_unstable();
        knots.push(Knot { passes, twin: None });
    }
}
