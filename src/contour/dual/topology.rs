//! Whether parts in the eight halves of a block may become one vertex: the tests V, F and E of
//! `docs/dual.md`, from the parts' crossings alone.
//!
//! The block's half edges are 54 places: an axis, which half, and two coordinates 0, 1 or 2 across. A crossing
//! there is a *slot*; up to four of the eight children have an edge at a place.

use std::sync::LazyLock;

use super::leaves::NONE;
use super::plain::Plain;
use crate::grid::MaterialId;
use crate::grid::cube::{CORNERS, EDGES, FACES, edge_axis, edge_corners, edge_faces, other_axes};

/// Most sets of materials that are looked at in a cluster; with more it is refused.
const SETS: usize = 16;

/// Why parts did not become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Refusal {
    /// A material's part would not be a disc (V).
    Disc,
    /// On a face, curves would not be connected, or a material's part not a path (F).
    Face,
    /// An edge would carry two crossings (E).
    Edge,
    /// A neighbour did not pass at a lower level.
    Neighbour,
}

/// A part: what is known of it is the crossing on each edge of its block.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outline {
    /// Which of the eight children of the block it lies in.
    pub(super) child: u8,
    /// Numbers of the crossings on the child's edges, or [`NONE`].
    pub(super) crossings: [u32; EDGES],
    /// The materials of all of its crossings, ascending; twice `OUTSIDE` if there are more than two.
    pub(super) pair: [MaterialId; 2],
}

/// A crossing on a half edge.
#[derive(Debug, Clone, Copy)]
struct Slot {
    place: u8,
    crossing: u32,
    /// The part of each child that has it.
    parts: [u16; CORNERS],
    /// Which sets of materials it bounds.
    sets: u16,
}

const NO_PART: u16 = u16::MAX;
pub(super) const PLACES: usize = 54;

/// Where each edge of each child lies.
pub(super) static PLACE: [[u8; EDGES]; CORNERS] = places();

const fn places() -> [[u8; EDGES]; CORNERS] {
    let mut out = [[0; EDGES]; CORNERS];
    let mut child = 0;
    while child < CORNERS {
        let mut e = 0;
        while e < EDGES {
            let axis = edge_axis(e);
            let [b, c] = other_axes(axis);
            let low = edge_corners(e)[0];
            let (along, across) = (
                (child >> axis) & 1,
                [((child >> b) & 1) + ((low >> b) & 1), ((child >> c) & 1) + ((low >> c) & 1)],
            );
            out[child][e] = (axis * 18 + along * 9 + across[0] * 3 + across[1]) as u8;
            e += 1;
        }
        child += 1;
    }
    out
}

/// What a place is in its block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Within {
    /// Between four children.
    Inner,
    /// On a face, between two children.
    Face(usize),
    /// On an edge.
    Edge(usize),
}

fn within(place: u8) -> Within {
    let (axis, across) = (usize::from(place) / 18, usize::from(place) % 9);
    let [b, c] = other_axes(axis);
    match (across / 3, across % 3) {
        (1, 1) => Within::Inner,
        (1, side) => Within::Face(2 * c + side / 2),
        (side, 1) => Within::Face(2 * b + side / 2),
        (p, q) => Within::Edge(4 * axis + p / 2 + 2 * (q / 2)),
    }
}

/// What each place is.
pub(super) static WITHIN: LazyLock<[Within; PLACES]> =
    LazyLock::new(|| std::array::from_fn(|p| within(p as u8)));

/// Groups parts into clusters and tests them; kept for its buffers.
#[derive(Debug, Default)]
pub(super) struct Clusters {
    /// If the block is plain; the rest is not used then.
    plain: Option<Plain>,
    outlines: Vec<Outline>,
    slots: Vec<Slot>,
    by_place: Vec<Vec<u16>>,
    /// Union-find over parts.
    links: Vec<u16>,
    /// The sets of materials that each part bounds on each face, and in all.
    faces: Vec<[u16; FACES]>,
    parts: Vec<u16>,
    /// The slots of the cluster.
    own: Vec<u16>,
    sets: Vec<MaterialId>,
}

impl Clusters {
    /// Takes the parts of a block; they are numbered in this order.
    pub(super) fn set(&mut self, outlines: impl Iterator<Item = Outline>) {
        self.outlines.clear();
        self.outlines.extend(outlines);
        self.plain = Plain::new(&self.outlines);
        if self.plain.is_none() {
            self.link();
        }
    }

    /// Finds out which crossings parts have in common.
    fn link(&mut self) {
        let n = self.outlines.len();
        self.links.clear();
        self.links.extend(0..n as u16);
        self.slots.clear();
        self.by_place.resize(PLACES, Vec::new());
        self.by_place.iter_mut().for_each(Vec::clear);
        for p in 0..n {
            let outline = self.outlines[p];
            let child = usize::from(outline.child);
            for (e, &crossing) in outline.crossings.iter().enumerate().filter(|(_, c)| **c != NONE) {
                let place = PLACE[child][e];
                let here = &mut self.by_place[usize::from(place)];
                let found = here.iter().find(|&&s| self.slots[usize::from(s)].crossing == crossing);
                let slot = match found {
                    Some(&slot) => usize::from(slot),
                    None => {
                        here.push(self.slots.len() as u16);
                        self.slots.push(Slot { place, crossing, parts: [NO_PART; CORNERS], sets: 0 });
                        self.slots.len() - 1
                    }
                };
                let parts = &mut self.slots[slot].parts;
                let other = parts.iter().copied().find(|&q| q != NO_PART);
                parts[child] = p as u16;
                if let Some(other) = other {
                    unite(&mut self.links, other, p as u16);
                }
            }
        }
    }

    /// The lowest part of a part's cluster.
    pub(super) fn cluster(&mut self, part: usize) -> usize {
        match &self.plain {
            Some(plain) => plain.cluster(part),
            None => usize::from(find(&mut self.links, part as u16)),
        }
    }

    /// Tests the cluster whose lowest part is `cluster`; `labels` gives the materials of a crossing. Returns
    /// the crossings on the edges of the block.
    pub(super) fn test(
        &mut self,
        cluster: usize,
        labels: impl Fn(u32) -> [MaterialId; 2],
    ) -> Result<[u32; EDGES], Refusal> {
        if let Some(plain) = &self.plain {
            return plain.test(cluster);
        }
        self.parts.clear();
        for p in 0..self.outlines.len() as u16 {
            if usize::from(find(&mut self.links, p)) == cluster {
                self.parts.push(p);
            }
        }
        let mut own = std::mem::take(&mut self.own);
        own.clear();
        own.extend(
            (0..self.slots.len() as u16).filter(|&s| self.in_cluster(&self.slots[usize::from(s)], cluster)),
        );
        self.own = own;
        let all = self.name_sets(labels)?;
        self.look_at_faces();
        let edges = self.edges()?;
        self.discs(all)?;
        (0..FACES).try_for_each(|face| self.face(face, all))?;
        Ok(edges)
    }

    /// The slots of the cluster.
    fn own(&self) -> impl Iterator<Item = &Slot> {
        self.own.iter().map(|&s| &self.slots[usize::from(s)])
    }

    fn in_cluster(&self, slot: &Slot, cluster: usize) -> bool {
        // Links of a part lead to its cluster at once after `test` has found them all.
        slot.parts
            .iter()
            .find(|p| **p != NO_PART)
            .is_some_and(|&p| usize::from(self.links[usize::from(p)]) == cluster)
    }

    /// Gives each material of the cluster a bit, and the sets that each slot bounds; all bits.
    ///
    /// Two materials bound the same surface, so one bit will do. Where air and `OUTSIDE` both occur, they get
    /// one together too: crossings between them are not looked at, yet the rim must stay a curve.
    fn name_sets(&mut self, labels: impl Fn(u32) -> [MaterialId; 2]) -> Result<u16, Refusal> {
        self.sets.clear();
        for i in 0..self.own.len() {
            let i = usize::from(self.own[i]);
            let mut bits = 0;
            for label in labels(self.slots[i].crossing) {
                let known = self.sets.iter().position(|&l| l == label);
                let bit = known.unwrap_or_else(|| {
                    self.sets.push(label);
                    self.sets.len() - 1
                });
                if bit >= SETS - 1 {
                    return Err(Refusal::Disc);
                }
                bits |= 1 << bit;
            }
            self.slots[i].sets = bits;
        }
        let n = self.sets.len();
        let bit = |label| self.sets.iter().position(|&l| l == label).map(|bit| 1u16 << bit);
        if n <= 2 {
            self.slots.iter_mut().for_each(|s| s.sets = s.sets.min(1));
            return Ok(1);
        }
        let mut all = (1u16 << n) - 1;
        if let (Some(air), Some(outside)) = (bit(MaterialId::BACKGROUND), bit(MaterialId::OUTSIDE)) {
            let both = 1 << n;
            self.slots.iter_mut().filter(|s| s.sets & (air | outside) != 0).for_each(|s| s.sets |= both);
            all |= both;
        }
        Ok(all)
    }

    /// The sets that each part bounds on each of its child's faces.
    fn look_at_faces(&mut self) {
        self.faces.clear();
        self.faces.resize(self.outlines.len(), [0; FACES]);
        for &slot in &self.own {
            let slot = &self.slots[usize::from(slot)];
            for (child, &p) in slot.parts.iter().enumerate().filter(|(_, p)| **p != NO_PART) {
                // Of the child's edges along the axis, the one at this place.
                let axis = usize::from(slot.place) / 18;
                let edges = (4 * axis..4 * axis + 4).filter(|&e| PLACE[child][e] == slot.place);
                for f in edges.flat_map(edge_faces) {
                    self.faces[usize::from(p)][f] |= slot.sets;
                }
            }
        }
    }

    /// Test E: the crossings on the block's edges.
    fn edges(&self) -> Result<[u32; EDGES], Refusal> {
        let mut edges = [NONE; EDGES];
        for slot in self.own() {
            if let Within::Edge(e) = WITHIN[usize::from(slot.place)] {
                if edges[e] != NONE {
                    return Err(Refusal::Edge);
                }
                edges[e] = slot.crossing;
            }
        }
        Ok(edges)
    }

    /// The part on the other side of face 2 · `axis` + 1 of part `p`, if there is one.
    fn across(&self, p: u16, axis: usize) -> Option<u16> {
        let outline = &self.outlines[usize::from(p)];
        let child = usize::from(outline.child);
        let other = child ^ 1 << axis;
        let face = 2 * axis + usize::from(child >> axis & 1 == 0);
        (0..EDGES).filter(|&e| edge_faces(e).contains(&face) && outline.crossings[e] != NONE).find_map(|e| {
            let place = usize::from(PLACE[child][e]);
            let slots = self.by_place[place].iter().map(|&s| &self.slots[usize::from(s)]);
            let slot = slots.clone().find(|s| s.crossing == outline.crossings[e])?;
            Some(slot.parts[other]).filter(|&q| q != NO_PART)
        })
    }

    /// Test V, and that no part has a neighbour that did not pass.
    fn discs(&self, all: u16) -> Result<(), Refusal> {
        // Parts, inner quarter faces and inner half edges of each set.
        let mut euler = [0i32; SETS];
        let mut count = |sets: u16, by: i32| {
            (0..SETS).filter(|s| sets >> s & 1 == 1).for_each(|s| euler[s] += by);
        };
        let mut joints: Vec<(u16, u16, u16)> = Vec::new();
        for &p in &self.parts {
            let faces = &self.faces[usize::from(p)];
            count(faces.iter().fold(0, |sets, f| sets | f), 1);
            let child = usize::from(self.outlines[usize::from(p)].child);
            for axis in 0..3 {
                let low = child >> axis & 1 == 0;
                let sets = faces[2 * axis + usize::from(low)];
                if sets == 0 {
                    continue;
                }
                let Some(q) = self.across(p, axis) else { return Err(Refusal::Neighbour) };
                if low {
                    count(sets, -1);
                    joints.push((p, q, sets));
                }
            }
        }
        for slot in self.own() {
            if WITHIN[usize::from(slot.place)] == Within::Inner {
                count(slot.sets, 1);
            }
        }
        if all == 1 {
            // The parts of a cluster are joined through faces, or a neighbour would be missing.
            return if euler[0] == 1 { Ok(()) } else { Err(Refusal::Disc) };
        }
        for set in (0..SETS).filter(|s| all >> s & 1 == 1) {
            let has = |p: &u16| self.faces[usize::from(*p)].iter().any(|f| f >> set & 1 == 1);
            let of_set = joints.iter().filter(|j| j.2 >> set & 1 == 1).map(|j| [j.0, j.1]);
            if euler[set] != 1 || !is_connected(self.parts.iter().copied().filter(has), of_set) {
                return Err(Refusal::Disc);
            }
        }
        Ok(())
    }

    /// Test F for a face of the block.
    fn face(&self, face: usize, all: u16) -> Result<(), Refusal> {
        let (axis, side) = (face / 2, face % 2);
        let sets_of = |p: u16| self.faces[usize::from(p)][face];
        let on_face = |p: &u16| {
            usize::from(self.outlines[usize::from(*p)].child) >> axis & 1 == side && sets_of(*p) != 0
        };
        let nodes = || self.parts.iter().copied().filter(on_face);
        let (mut count, mut children, mut twice) = (0, 0u8, false);
        for p in nodes() {
            let child = 1 << self.outlines[usize::from(p)].child;
            twice |= children & child != 0;
            children |= child;
            count += 1;
        }
        if count == 0 {
            return Ok(());
        }
        if all == 1 && !twice {
            // At most one node on each quarter face: with one joint less than nodes they are a path.
            let on = Within::Face(face);
            let joints = self.own().filter(|s| WITHIN[usize::from(s.place)] == on).count();
            return if joints + 1 == count { Ok(()) } else { Err(Refusal::Face) };
        }
        let mut joints: Vec<([u16; 2], u16)> = Vec::new();
        for slot in self.own() {
            if WITHIN[usize::from(slot.place)] == Within::Face(face) {
                let mut both = slot.parts.iter().copied().filter(|&p| p != NO_PART);
                if let (Some(p), Some(q)) = (both.next(), both.next()) {
                    joints.push(([p, q], slot.sets));
                }
            }
        }
        if !is_connected(nodes(), joints.iter().map(|j| j.0)) {
            return Err(Refusal::Face);
        }
        for set in (0..SETS).filter(|s| all >> s & 1 == 1) {
            let of_set = nodes().filter(|&p| sets_of(p) >> set & 1 == 1);
            let joints = joints.iter().filter(|j| j.1 >> set & 1 == 1).map(|j| j.0);
            let count = of_set.clone().count();
            if count > 0 && (count != joints.clone().count() + 1 || !is_connected(of_set, joints)) {
                return Err(Refusal::Face);
            }
        }
        Ok(())
    }
}

/// Whether joints connect all of these parts.
fn is_connected(parts: impl Iterator<Item = u16>, joints: impl Iterator<Item = [u16; 2]>) -> bool {
    let parts: Vec<u16> = parts.collect();
    if parts.len() < 2 {
        return true;
    }
    let mut links: Vec<u16> = (0..parts.len() as u16).collect();
    let at = |p: u16| parts.binary_search(&p).ok().map(|i| i as u16);
    let mut separate = parts.len();
    for [p, q] in joints {
        if let (Some(p), Some(q)) = (at(p), at(q))
            && unite(&mut links, p, q)
        {
            separate -= 1;
        }
    }
    separate == 1
}

/// The representative of `p`, which is its set's lowest; shortens the way there.
fn find(links: &mut [u16], p: u16) -> u16 {
    let mut root = p;
    while links[usize::from(root)] != root {
        root = links[usize::from(root)];
    }
    links[usize::from(p)] = root;
    root
}

/// Joins two sets; whether they were two.
fn unite(links: &mut [u16], p: u16, q: u16) -> bool {
    let (p, q) = (find(links, p), find(links, q));
    links[usize::from(p.max(q))] = p.min(q);
    p != q
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::cube::corner_offset;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn places_are_those_of_a_block_cut_in_eight() {
        let mut kinds = [0; 3];
        for place in 0..PLACES as u8 {
            let children = (0..CORNERS).filter(|&c| PLACE[c].contains(&place)).count();
            let (kind, expected) = match within(place) {
                Within::Inner => (0, 4),
                Within::Face(_) => (1, 2),
                Within::Edge(e) => {
                    // The block's edge is the same edge of the children there.
                    assert!((0..CORNERS).any(|c| PLACE[c][e] == place));
                    (2, 1)
                }
            };
            assert_eq!(children, expected);
            kinds[kind] += 1;
        }
        assert_eq!(kinds, [6, 24, 24]);
    }

    #[test]
    fn plain_blocks_are_told_the_same_by_counting_bits() {
        let pair = [MaterialId(0), MaterialId(1)];
        let (mut passed, mut refused) = (0, [0; 4]);
        for seed in 0..20_000u64 {
            // Which of the block's 27 lattice points lie behind the interface: at random, or beside a plane.
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let normal: [f64; 3] = std::array::from_fn(|_| rng.random::<f64>() - 0.5);
            let (offset, wild) = (rng.random::<f64>() - 0.5, rng.random::<f64>() * 0.3);
            let behind = |p: [usize; 3], rng: &mut rand_chacha::ChaCha8Rng| {
                let along: f64 = (0..3).map(|a| normal[a] * (p[a] as f64 - 1.0)).sum();
                (along > offset) != (rng.random::<f64>() < wild)
            };
            let points: Vec<bool> = (0..27).map(|i| behind([i % 3, i / 3 % 3, i / 9], &mut rng)).collect();
            let at = |p: [usize; 3]| points[p[0] + 3 * p[1] + 9 * p[2]];
            let mut outlines = Vec::new();
            for (child, places) in PLACE.iter().enumerate() {
                let low = corner_offset(child);
                let crosses = |e: usize| {
                    let [p, q] = edge_corners(e).map(|c| {
                        let o = corner_offset(c);
                        at([0, 1, 2].map(|a| low[a] + o[a]))
                    });
                    p != q
                };
                let crossing = |e| if crosses(e) { u32::from(places[e]) } else { NONE };
                let crossings = std::array::from_fn(crossing);
                // Some cells have not passed.
                if crossings != [NONE; EDGES] && rng.random::<f64>() > 0.05 {
                    outlines.push(Outline { child: child as u8, crossings, pair });
                }
            }
            let Some(plain) = Plain::new(&outlines) else {
                assert!(outlines.is_empty());
                continue;
            };
            let mut clusters = Clusters { outlines: outlines.clone(), ..Clusters::default() };
            clusters.link();
            for p in 0..outlines.len() {
                let cluster = clusters.cluster(p);
                assert_eq!(plain.cluster(p), cluster, "{seed}");
                if cluster == p {
                    let expected = clusters.test(p, |_| pair);
                    assert_eq!(plain.test(p), expected, "{seed}");
                    match expected {
                        Ok(_) => passed += 1,
                        Err(refusal) => refused[refusal as usize] += 1,
                    }
                }
            }
        }
        assert!(passed > 1000 && refused.iter().all(|&n| n > 100), "{passed} {refused:?}");
    }
}
