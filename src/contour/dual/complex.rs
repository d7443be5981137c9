//! Which edges of a labelled mesh may be contracted so that its topology stays.
//!
//! Words: an edge is *common* if two triangles of one interface run through it in opposite directions; all others
//! are *junction* edges (where interfaces meet or end). A vertex is *smooth* if all its edges are common and
//! its triangles one fan; a *curve* vertex if two of its edges are junction edges and all its fans
//! lead from one of them to the other; else a *point*. Contracting *ab* makes *b* part of *a*; its *tips* are the third
//! corners of the triangles at *ab*, which vanish.
//!
//! Guarantee: the mesh after a contraction that [`Complex::link`] admits is homeomorphic to the one before,
//! interface by interface and curve by curve. So components and Euler number of every material's shell
//! stay, edges keep their triangles and pairs, and no triangle is there twice. These are the link conditions of
//! Dey, Edelsbrunner, Guha and Nekhayev (Topology preserving edge contraction, 1999) for 2-complexes: no
//! vertex but the tips is a neighbour of both *a* and *b*; no edge lies opposite both; two vertices on curves are
//! joined by a junction edge, have no neighbour in common along junction edges, and are not both points. A
//! vertex stays what it is, and the merged one is what the higher of its two was.
//!
//! Not looked at: where the vertices lie, but for [`Complex::matches_up`].

use glam::DVec3;
use rayon::prelude::*;

use crate::grid::{MaterialId, Pair};
use crate::triangle::{VertexTable, in_turn};

/// Neighbours of a vertex at most; with more it stays.
const MOST: usize = 32;

/// What a vertex is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Smooth,
    Curve,
    Point,
    /// It stays, and nothing becomes part of it.
    Fixed,
}

/// A labelled mesh whose edges are contracted. A triangle that vanishes stays in its slot, with a corner twice.
pub(super) struct Complex<'a> {
    pub(super) triangles: &'a mut [[u32; 3]],
    pairs: &'a [Pair],
    kinds: Vec<Kind>,
    /// Each vertex's part of the list of stars.
    spans: Vec<[u32; 2]>,
    /// Slots of the triangles at each vertex, vanished ones among them. A merged vertex gets a new part.
    stars: Vec<u32>,
}

/// Whether a triangle has vanished.
pub(super) fn is_gone([a, b, _]: [u32; 3]) -> bool {
    a == b
}

/// The two corners after `v`, in order.
fn opposite([a, b, c]: [u32; 3], v: u32) -> [u32; 2] {
    if a == v {
        [b, c]
    } else if b == v {
        [c, a]
    } else {
        [a, b]
    }
}

/// A few different vertices.
#[derive(Clone, Copy)]
struct Few {
    list: [u32; MOST],
    count: usize,
}

impl Few {
    const NONE: Self = Self { list: [0; MOST], count: 0 };

    /// Adds a vertex unless it is there; false if there is no room.
    fn add(&mut self, v: u32) -> bool {
        if self.all().contains(&v) {
            return true;
        }
        let room = self.count < MOST;
        if room {
            self.list[self.count] = v;
            self.count += 1;
        }
        room
    }

    fn all(&self) -> &[u32] {
        &self.list[..self.count]
    }
}

impl<'a> Complex<'a> {
    /// A mesh of this many vertices, of which those from `first_fixed` on stay.
    pub(super) fn new(
        vertices: usize,
        first_fixed: usize,
        triangles: &'a mut [[u32; 3]],
        pairs: &'a [Pair],
    ) -> Self {
        let table = VertexTable::new(vertices, triangles);
        let mut stars = Vec::with_capacity(4 * triangles.len());
        let spans = (0..vertices)
            .map(|v| {
                let first = stars.len() as u32;
                stars.extend_from_slice(table.triangles(v));
                [first, stars.len() as u32]
            })
            .collect();
        let mut complex = Self { triangles, pairs, kinds: vec![Kind::Fixed; vertices], spans, stars };
        let kinds: Vec<Kind> =
            (0..first_fixed as u32).into_par_iter().with_min_len(256).map(|v| complex.find_kind(v)).collect();
        complex.kinds[..first_fixed].copy_from_slice(&kinds);
        complex
    }

    pub(super) fn kind(&self, v: u32) -> Kind {
        self.kinds[v as usize]
    }

    /// The triangles at a vertex, with their slots.
    pub(super) fn star(&self, v: u32) -> impl Iterator<Item = (u32, [u32; 3])> {
        let [first, end] = self.spans[v as usize];
        let slots = &self.stars[first as usize..end as usize];
        slots.iter().map(|&slot| (slot, self.triangles[slot as usize])).filter(|(_, t)| !is_gone(*t))
    }

    /// The neighbours of a vertex.
    pub(super) fn neighbours(&self, v: u32) -> impl Iterator<Item = u32> + use<> {
        let mut around = Few::NONE;
        if self.kind(v) != Kind::Fixed {
            self.star(v).for_each(|(_, t)| opposite(t, v).into_iter().for_each(|w| _ = around.add(w)));
        }
        around.list.into_iter().take(around.count)
    }

    fn find_kind(&self, v: u32) -> Kind {
        // An edge of the link for each triangle.
        let link: Vec<[u32; 2]> = self.star(v).map(|(_, t)| opposite(t, v)).collect();
        let mut around = Few::NONE;
        if link.is_empty() || !link.iter().flatten().all(|&w| around.add(w)) {
            return Kind::Fixed;
        }
        let mut ends = around.all().iter().copied().filter(|&w| self.is_junction(v, w));
        let ends = [ends.next(), ends.next(), ends.next()];
        let (from, to) = match ends {
            [None, ..] => (link[0][0], link[0][0]),
            [Some(from), Some(to), None] => (from, to),
            _ => return Kind::Point,
        };
        // Along every fan, from one end to the other, or once around.
        let fans =
            (0..link.len()).filter(|&i| link[i].contains(&from)).take(if from == to { 1 } else { MOST });
        let mut seen = 0;
        for mut i in fans {
            let mut at = from;
            loop {
                seen += 1;
                at = if link[i][0] == at { link[i][1] } else { link[i][0] };
                if at == from || at == to {
                    break;
                }
                // It has two triangles: its edge is common.
                let next = (0..link.len()).find(|&j| j != i && link[j].contains(&at));
                let Some(next) = next.filter(|_| seen < link.len()) else { return Kind::Point };
                i = next;
            }
            if at != to {
                return Kind::Point;
            }
        }
        match (seen == link.len(), from == to) {
            (true, true) => Kind::Smooth,
            (true, false) => Kind::Curve,
            (false, _) => Kind::Point,
        }
    }

    /// Whether an edge is a junction edge.
    fn is_junction(&self, v: u32, w: u32) -> bool {
        let mut uses = self
            .star(v)
            .filter(|(_, t)| t.contains(&w))
            .map(|(slot, t)| (self.pairs[slot as usize], opposite(t, v)[0] == w));
        match (uses.next(), uses.next(), uses.next()) {
            (Some((pair, ahead)), Some((other, also_ahead)), None) => pair != other || ahead == also_ahead,
            _ => true,
        }
    }

    /// How many neighbours the merged vertex will have; `None` if the topology would change.
    pub(super) fn link(&self, kept: u32, gone: u32) -> Option<usize> {
        if self.kind(kept) == Kind::Fixed
            || self.kind(gone) > Kind::Curve
            || self.kind(gone) > self.kind(kept)
        {
            return None;
        }
        let [mut around_kept, mut around_gone, mut tips] = [Few::NONE; 3];
        for (around, v, other) in [(&mut around_kept, kept, gone), (&mut around_gone, gone, kept)] {
            for (_, t) in self.star(v) {
                let at_edge = t.contains(&other);
                for w in opposite(t, v).into_iter().filter(|&w| w != other) {
                    if !around.add(w) || at_edge && !tips.add(w) {
                        return None;
                    }
                }
            }
        }
        let tips = tips.all();
        if around_kept.all().iter().filter(|w| around_gone.all().contains(w)).count() != tips.len() {
            return None;
        }
        // Edges opposite both: only between tips.
        let between_tips = |v: u32, other: u32| {
            let own =
                self.star(v).filter(move |(_, t)| !t.contains(&other)).map(move |(_, t)| opposite(t, v));
            own.filter(|edge| edge.iter().all(|w| tips.contains(w)))
        };
        if between_tips(kept, gone)
            .any(|[x, y]| between_tips(gone, kept).any(|edge| edge == [x, y] || edge == [y, x]))
        {
            return None;
        }
        let shared = |&x: &u32| self.is_junction(kept, x) && self.is_junction(gone, x);
        if self.kind(gone) == Kind::Curve && (!self.is_junction(kept, gone) || tips.iter().any(shared)) {
            return None;
        }
        Some(around_kept.count + around_gone.count - tips.len())
    }

    /// What a contraction puts into the slots around: all triangles at the two vertices, changed or not.
    pub(super) fn contracted(&self, kept: u32, gone: u32) -> Vec<(u32, [u32; 3])> {
        let own = self.star(kept).map(|(slot, t)| {
            // Any corner twice will do.
            (slot, if t.contains(&gone) { [t[0], t[0], t[1]] } else { t })
        });
        let other = self.star(gone).filter(|(_, t)| !t.contains(&kept));
        own.chain(other.map(|(slot, t)| (slot, t.map(|v| if v == gone { kept } else { v })))).collect()
    }

    /// Says that the vertex has these slots now; returns what [`Self::restore_star`] needs.
    pub(super) fn set_star(&mut self, v: u32, slots: impl Iterator<Item = u32>) -> [u32; 2] {
        let first = self.stars.len() as u32;
        self.stars.extend(slots);
        std::mem::replace(&mut self.spans[v as usize], [first, self.stars.len() as u32])
    }

    /// Gives a vertex the slots back that it had before.
    pub(super) fn restore_star(&mut self, v: u32, star: [u32; 2]) {
        self.spans[v as usize] = star;
    }

    /// Whether materials match up around the edges of a triangle: the rule that a mesh is checked by. Two sheets with a
    /// common rim could pass through each other without meeting anywhere.
    pub(super) fn matches_up(&self, positions: &[DVec3], slot: u32) -> bool {
        let [a, b, c] = self.triangles[slot as usize];
        [[a, b], [b, c], [c, a]].into_iter().all(|[u, v]| {
            if self.kind(u) == Kind::Smooth || self.kind(v) == Kind::Smooth {
                return true;
            }
            let point = |v: u32| positions[v as usize];
            let of_edge = self.star(u).filter(|(_, t)| t.contains(&v)).map(|(slot, t)| {
                let [ahead, behind] = opposite(t, u);
                let pair = self.pairs[slot as usize];
                // Where it is entered and left on the way around.
                let passed =
                    if ahead == v { [pair.back(), pair.front()] } else { [pair.front(), pair.back()] };
                (passed.map(|id| if id == MaterialId::OUTSIDE { MaterialId::BACKGROUND } else { id }), {
                    point(if ahead == v { behind } else { ahead })
                })
            });
            let tips: Vec<([MaterialId; 2], DVec3)> = of_edge.collect();
            // With two triangles the order is always the same.
            tips.len() < 3
                || in_turn(point(u), point(v), &tips).is_none_or(|around| {
                    (0..around.len()).all(|i| around[i][1] == around[(i + 1) % around.len()][0])
                })
        })
    }
}

#[cfg(test)]
#[path = "complex_tests.rs"]
mod tests;
