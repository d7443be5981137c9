//! Flips of near-coplanar edges, for better triangles, in any order with the same outcome.
//!
//! Words: an edge *ab* with the triangles *abc* and *bad* is *flipped* to *cd* with *cad* and *dbc*; the four
//! points are its *quad*. A flip reuses the slots of its two triangles (`changes.rs`).
//!
//! Method: rounds. Each looks at the state before it, finds every flip that is worth while, and carries out
//! those that are the best of all that touch either of their triangles. What makes a flip worth while:
//! - the edge has two triangles, of one pair, that run through it in opposite directions: never a junction edge;
//! - the lower q of the two (000_f7f54f44c17ac186, eq. 14) rises by a factor of [`RISE`] at least;
//! - the four triangles' normals, old and new, lie within an angle of each other. Their areas, as vectors,
//!   add up to the same half of (b - a) x (c - d), before and after; so along *that* direction all four are
//!   seen from the front, which makes the quad convex there and the flip no fold;
//! - the surface moves by no more than a tolerance. Seen along that direction, it moves most where *ab* and
//!   *cd* cross, by the distance of these two lines. What earlier flips moved the same triangles by is
//!   added, so the tolerance holds for all flips together;
//! - *cd* is no edge and has never been one.
//!
//! Why that is enough: flips of one round share no triangle and make different edges, none of which was there.
//! So each replaces a disc by a disc with the same rim, no edge gets a third triangle, and no vertex
//! loses its last but one edge (its neighbours would be joined by an edge already).
//!
//! Guarantees: number and pairs of triangles, uses of all other edges, and so the topology stay; the lowest q
//! never falls; nothing depends on threads or on the order or rotation of the triangles (each decision is a
//! function of the quad's vertex numbers and positions; equal gains are told apart by a hash of the edge).
//! Not guaranteed by a flip alone: that triangles far apart do not come to meet. [`flip`] finds those and
//! takes the flips back.

use std::collections::BTreeSet;

use glam::DVec3;
use rayon::prelude::*;

use super::changes::{Changes, mix};
use crate::execution::{Cancelled, Execution};
use crate::grid::Pair;
use crate::triangle::{EdgeTable, Search, is_without_area, triangle_quality, without_area};

/// How many times the lower q of two triangles must rise: anything over 1 makes flips end; less than
/// this is not worth a change of the surface.
const RISE: f64 = 1.1;
/// No half-edge, no flip.
const NONE: u32 = u32::MAX;

/// What a flip may do.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FlipOptions {
    /// How far the surface may move, by all flips together, in the unit of the positions.
    pub(crate) tolerance: f64,
    /// The largest angle between the normals of any two of a quad's four triangles, degrees; under 90.
    pub(crate) angle: f64,
    /// The most rounds; they end earlier if nothing is left to flip.
    pub(crate) rounds: usize,
}

/// A mesh to flip edges of: positions, the pair of each triangle, and which triangles must stay (empty: none).
#[derive(Debug, Clone, Copy)]
pub(crate) struct FlipMesh<'a> {
    pub(crate) positions: &'a [DVec3],
    pub(crate) pairs: &'a [Pair],
    pub(crate) locked: &'a [bool],
}

/// The flips that were carried out, to take them back.
#[derive(Debug, Clone)]
pub(crate) struct Flips {
    changes: Changes,
    /// How many rounds there were.
    pub(crate) rounds: usize,
}

impl Flips {
    /// How many flips are in the mesh now.
    pub(crate) fn count(&self) -> usize {
        self.changes.made() - self.changes.undone()
    }
}

/// Flips edges and takes back the flips after which triangles meet that did not meet before. So every pair of
/// triangles that meets wrongly at the end was in the mesh at first, both of them.
pub(crate) fn flip(
    mesh: FlipMesh<'_>,
    triangles: &mut [[u32; 3]],
    options: &FlipOptions,
    execution: &Execution,
) -> Result<Flips, Cancelled> {
    let mut flips = flip_only(mesh, triangles, options, execution)?;
    if flips.count() == 0 {
        return Ok(flips);
    }
    let mut left_out = without_area(mesh.positions, triangles);
    let mut asked: Vec<bool> = (0..triangles.len()).map(|t| flips.changes.is_changed(t)).collect();
    loop {
        let found = Search::new(mesh.positions, triangles, &left_out).run(|t| asked[t], execution)?;
        let wrong = found.first.into_iter().flatten().filter(|&t| flips.changes.is_changed(t as usize));
        let wrong: Vec<u32> = wrong.collect();
        if wrong.is_empty() {
            return Ok(flips);
        }
        // Old triangles did not meet each other, but they may meet new ones: only these are asked for.
        let changed = flips.changes.undo(triangles, wrong, |_| ());
        asked.fill(false);
        for t in changed {
            asked[t as usize] = true;
            left_out[t as usize] = is_without_area(mesh.positions, triangles[t as usize]);
        }
    }
}

/// Flips edges, wherever the triangles come to lie. A mesh too large for its half-edges to be numbered in 32 bit
/// stays as it is.
pub(crate) fn flip_only(
    mesh: FlipMesh<'_>,
    triangles: &mut [[u32; 3]],
    options: &FlipOptions,
    execution: &Execution,
) -> Result<Flips, Cancelled> {
    let n = triangles.len();
    let mut flips = Flips { changes: Changes::new(n), rounds: 0 };
    if n >= NONE as usize / 3 {
        return Ok(flips);
    }
    let edges = EdgeTable::new(mesh.positions.len(), triangles);
    let mates = mates(&mesh, triangles, &edges);
    let cosine = options.angle.to_radians().cos();
    let mut state = State {
        positions: mesh.positions,
        triangles,
        edges,
        added: BTreeSet::new(),
        mates,
        moved: vec![0.0; n],
        best: vec![NONE; n],
        tolerance: options.tolerance,
        cosine,
    };
    let mut active: Vec<u32> = (0..n as u32).collect();
    let mut is_active = vec![true; n];
    while flips.rounds < options.rounds && !active.is_empty() {
        execution.check()?;
        let candidates = state.candidates(&active, &is_active);
        let winners = state.winners(&candidates);
        for &k in &winners {
            state.carry_out(&candidates[k as usize], &mut flips);
        }
        flips.rounds += 1;
        for t in active.drain(..) {
            is_active[t as usize] = false;
        }
        if winners.is_empty() {
            break;
        }
        // What a round changed or had to put off is looked at again, no more: the rest is as it was.
        active.extend(candidates.iter().flat_map(Candidate::slots));
        active.sort_unstable();
        active.dedup();
        for &t in &active {
            is_active[t as usize] = true;
        }
    }
    Ok(flips)
}

/// Half-edge `3 t + i` runs from corner `i` of triangle `t` to the next. Its mate is the one that runs through
/// the same edge in the other triangle; [`NONE`] where the edge must not be flipped.
fn mates(mesh: &FlipMesh<'_>, triangles: &[[u32; 3]], edges: &EdgeTable) -> Vec<u32> {
    let is_locked = |t: usize| mesh.locked.get(t).copied().unwrap_or(false);
    let mate = |t: usize, i: usize| {
        let (a, b) = (triangles[t][i], triangles[t][(i + 1) % 3]);
        let &[first, second] = edges.uses(a, b) else { return NONE };
        let other = if first.triangle() == t { second } else { first }.triangle();
        let fits = first.is_forward() != second.is_forward() && mesh.pairs[t] == mesh.pairs[other];
        let free = other != t && !is_locked(t) && !is_locked(other);
        let at = triangles[other].iter().position(|&v| v == b).filter(|_| fits && free);
        at.map_or(NONE, |j| (3 * other + j) as u32)
    };
    (0..triangles.len())
        .into_par_iter()
        .flat_map_iter(|t| (0..3).map(move |i| (t, i)))
        .map(|(t, i)| mate(t, i))
        .collect()
}

/// A flip that is worth while.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    /// The half-edges *ab* and *ba*; *a* is less than *b*.
    halves: [u32; 2],
    edge: [u32; 2],
    /// The vertices *c* and *d*.
    tips: [u32; 2],
    gain: f64,
    /// How far the surface has moved here in the end.
    moved: f64,
}

impl Candidate {
    fn slots(&self) -> [u32; 2] {
        self.halves.map(|h| h / 3)
    }

    fn new_edge(&self) -> [u32; 2] {
        [self.tips[0].min(self.tips[1]), self.tips[0].max(self.tips[1])]
    }

    /// The higher, the better; different for different edges. The hash keeps equal gains along a strip from
    /// waiting for each other, one round each.
    fn rank(&self) -> (u64, u64, [u32; 2]) {
        let [a, b] = self.edge.map(u64::from);
        // The gain is positive, so its bits are in the order of its values.
        (self.gain.to_bits(), mix(a << 32 | b), self.edge)
    }
}

/// The mesh between two rounds.
struct State<'a> {
    positions: &'a [DVec3],
    triangles: &'a mut [[u32; 3]],
    /// The edges before all flips.
    edges: EdgeTable,
    /// All edges that flips have made.
    added: BTreeSet<[u32; 2]>,
    mates: Vec<u32>,
    /// How far flips have moved each triangle.
    moved: Vec<f64>,
    /// Per triangle the best candidate that touches it; all [`NONE`] between rounds.
    best: Vec<u32>,
    tolerance: f64,
    cosine: f64,
}

impl State<'_> {
    /// All flips worth while of edges of active triangles.
    fn candidates(&self, active: &[u32], is_active: &[bool]) -> Vec<Candidate> {
        let of_triangle = |&t: &u32| {
            (3 * t..3 * t + 3).filter_map(|half| {
                let mate = self.mates[half as usize];
                // An edge of two active triangles comes up in both; the one with a < b looks at it.
                let forward = self.corner(half) < self.corner(next(half));
                if mate == NONE || !forward && is_active[(mate / 3) as usize] {
                    return None;
                }
                self.candidate(if forward { [half, mate] } else { [mate, half] })
            })
        };
        active.par_iter().with_min_len(1 << 10).flat_map_iter(of_triangle).collect()
    }

    fn corner(&self, half: u32) -> u32 {
        self.triangles[(half / 3) as usize][(half % 3) as usize]
    }

    fn candidate(&self, halves: [u32; 2]) -> Option<Candidate> {
        let [a, b] = halves.map(|h| self.corner(h));
        let [c, d] = halves.map(|h| self.corner(next(next(h))));
        let [p, q, r, s] = [a, b, c, d].map(|v| self.positions[v as usize]);
        let old = triangle_quality([p, q, r]).min(triangle_quality([q, p, s]));
        if old * RISE > 1.0 {
            return None;
        }
        let new = triangle_quality([r, p, s]).min(triangle_quality([s, q, r]));
        // Written so that whatever is not a number is no candidate.
        if !(new > 0.0 && new >= old * RISE) {
            return None;
        }
        let normals = [[p, q, r], [q, p, s], [r, p, s], [s, q, r]]
            .map(|[x, y, z]| (y - x).cross(z - x).normalize_or_zero());
        let agree = |i: usize, j: usize| normals[i].dot(normals[j]) >= self.cosine;
        if !(agree(0, 1) && agree(2, 3) && agree(0, 2) && agree(1, 3) && agree(0, 3) && agree(1, 2)) {
            return None;
        }
        let across = (q - p).cross(r - s);
        let height = (r - p).dot(across).abs() / across.length();
        let slots = halves.map(|h| (h / 3) as usize);
        let moved = self.moved[slots[0]].max(self.moved[slots[1]]) + height;
        let candidate = Candidate { halves, edge: [a, b], tips: [c, d], gain: new - old, moved };
        let taken = c == d
            || !self.edges.uses(c, d).is_empty()
            || self.added.contains(&candidate.new_edge())
            || [[c, a, d], [d, b, c]].into_iter().any(|t| is_without_area(self.positions, t));
        (moved <= self.tolerance && !taken).then_some(candidate)
    }

    /// The candidates to carry out: the best in both of their triangles and of all that make the same edge.
    /// In the order of their new edges.
    fn winners(&mut self, candidates: &[Candidate]) -> Vec<u32> {
        for (k, candidate) in candidates.iter().enumerate() {
            for slot in candidate.slots() {
                let best = &mut self.best[slot as usize];
                if *best == NONE || candidates[*best as usize].rank() < candidate.rank() {
                    *best = k as u32;
                }
            }
        }
        let wins = |k: &u32| candidates[*k as usize].slots().iter().all(|&s| self.best[s as usize] == *k);
        let mut winners: Vec<u32> = (0..candidates.len() as u32).into_par_iter().filter(wins).collect();
        for slot in candidates.iter().flat_map(Candidate::slots) {
            self.best[slot as usize] = NONE;
        }
        let key = |k: &u32| candidates[*k as usize].new_edge();
        winners.par_sort_unstable_by_key(|k| (key(k), std::cmp::Reverse(candidates[*k as usize].rank())));
        winners.dedup_by_key(|k| key(k));
        winners
    }

    fn carry_out(&mut self, candidate: &Candidate, flips: &mut Flips) {
        let (slots, [ab, ba]) = (candidate.slots(), candidate.halves);
        let ([s, t], [a, b], [c, d]) = (slots, candidate.edge, candidate.tips);
        let outer = [next(next(ab)), next(ba), next(next(ba)), next(ab)].map(|h| self.mates[h as usize]);
        slots.into_iter().for_each(|slot| self.moved[slot as usize] = candidate.moved);
        let new = [[c, a, d], [d, b, c]];
        flips.changes.make(self.triangles, slots.into_iter().zip(new));
        let [ca, ad, db, bc] = [3 * s, 3 * s + 1, 3 * t, 3 * t + 1];
        for (half, mate) in [ca, ad, db, bc].into_iter().zip(outer).chain([(3 * s + 2, 3 * t + 2)]) {
            self.mates[half as usize] = mate;
            if mate != NONE {
                self.mates[mate as usize] = half;
            }
        }
        self.added.insert(candidate.new_edge());
    }
}

/// The half-edge after this one in its triangle.
fn next(half: u32) -> u32 {
    if half % 3 == 2 { half - 2 } else { half + 1 }
}

#[cfg(test)]
#[path = "flips_tests.rs"]
mod tests;
