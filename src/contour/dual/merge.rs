//! Merging: edges of the finished triangles are contracted, guided by the QEFs, so that the mesh is not bound to
//! the octree's blocks.
//!
//! Method: rounds. Each looks at the state before it; carried out are those contractions that are the best of all
//! whose stars (all triangles at their two vertices) share a triangle with theirs. So they change different
//! triangles, and neither threads nor the order of the list matter; equal ranks are told apart by a hash.
//! What is admitted:
//! - topology: `complex.rs`;
//! - place: two vertices of one kind go to the minimum of their added QEFs nearest to the edge's middle, else the higher
//!   one (a curve's, a point) stays where it is. Vertices on the volume's border stay in it, and merge only into
//!   one that lies on the same sides, or more;
//! - error: *each* of the two QEFs admits the new place by itself. Their sum alone would let a large flat face swallow the
//!   small one beside it: 50 planes that are 2 voxels off do not show among 10 000 (rms 0.14);
//! - shape: no triangle turns by more than [`TURN`] from the one that was in its slot at first, however many merges
//!   that takes; no q falls under [`QUALITY`], or, where one is under it, lower; valence and length are bounded.
//!
//! Ranked by error and length, over the lowest q that results: short edges (slivers) go first.
//!
//! What a round changes is not looked at anew at once: a rank in the neighbourhood becomes stale and is found again when
//! its turn comes; refused ones are tried again every few rounds. That changes the order somewhat, and
//! seemed to save a third of the time (not measured on a quiet machine). (To rank *new* edges so late as well does not pay: refused ones that lead hold their neighbours up,
//! and large meshes are not done after 200 rounds.)
//!
//! Guaranteed: topology; the tolerance, as an RMS distance of each vertex to all planes of the crossings that it stands
//! for; no pair of triangles that meets wrongly but those of the mesh before (exact; merges after which triangles
//! meet are taken back, the latest first). Not guaranteed: a distance between the surfaces: planes far from a vertex say
//! nothing about the triangles between; nor that no further edge could be contracted.

use std::cmp::Ordering;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::changes::{Changes, mix};
use super::complex::{Complex, Kind, is_gone};
use super::forest::Forest;
use super::placement::World;
use super::polygons::Triangles;
use super::qef::{Place, Qef};
use super::roots::RootGrid;
use super::vertices::Vertices;
use crate::execution::{Cancelled, Execution};
use crate::triangle::{Search, without_area};

/// The largest angle between a triangle and the first one of its slot, degrees. 30 left 7 % more triangles (three phantoms, tolerance 0.1); with 60
/// more of them come to meet.
const TURN: f64 = 40.0;
/// The q that all triangles shall have: somewhat more than the 0.3 that counts as good.
const QUALITY: f64 = 0.35;
/// A triangle with less has no safe normal.
const LEAST: f64 = 0.01;
/// The most neighbours of a merged vertex.
const VALENCE: usize = 12;
/// The longest edge, voxels: a root's side.
const LONGEST: f64 = 32.0;
/// What an edge's squared length, voxels squared, counts beside the error in squared tolerances.
const LENGTH: f64 = 0.01;
/// Refused contractions are tried again when a round carries out less than one in so many of those that are not,
const SLOW: usize = 32;
/// and this many rounds after the last time.
const AGAIN: u32 = 6;
/// Rounds at most; seen: 49 to 78.
const ROUNDS: u32 = 200;

/// How far merging goes.
#[derive(Debug, Clone, Copy)]
pub(super) struct MergeOptions {
    /// Root mean square distance from the planes of each of two vertices, voxels.
    pub(super) tolerance: f64,
    /// What of it those on a curve may get.
    pub(super) on_curves: f64,
    /// Length of a voxel, mm.
    pub(super) edge: f64,
    /// Merging ends with the first round that leaves no more triangles than this.
    pub(super) wanted: u64,
}

/// What merging did.
#[derive(Debug, Clone)]
pub(super) struct Merged {
    /// Merges in the mesh.
    pub(super) count: u64,
    /// Merges taken back because triangles met.
    pub(super) undone: u64,
    /// For each vertex the one that it became part of.
    pub(super) survivors: Vec<u32>,
}

/// The QEF of a vertex and its place, in voxels about the middle of root 0.
#[derive(Debug, Clone, Copy, Default)]
struct Site {
    planes: Qef,
    at: DVec3,
    sides: u8,
}

/// An edge that errors and borders allow to be contracted.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    kept: u32,
    gone: u32,
    /// Where the merged vertex goes.
    at: DVec3,
    /// Cost without regard to the triangles around.
    cost: f32,
    /// The round after which it was ranked.
    ranked: u32,
    /// The lower, the better; [`REFUSED`] by the triangles around.
    rank: u64,
}

const REFUSED: u64 = u64::MAX;

impl Candidate {
    fn is_admitted(&self) -> bool {
        self.rank != REFUSED
    }
}

/// What taking back a merge needs beside the triangles.
#[derive(Debug, Clone, Copy)]
struct Merge {
    kept: u32,
    gone: u32,
    position: DVec3,
    on_border: bool,
    star: [u32; 2],
}

/// Merges vertices; the triangles that vanish are taken out.
pub(super) fn merge(
    forest: &Forest,
    vertices: &Vertices,
    made: &mut Triangles,
    world: &World<'_>,
    options: &MergeOptions,
    execution: &Execution,
) -> Result<Merged, Cancelled> {
    let Triangles { positions, on_border, triangles, pairs, crossings, .. } = made;
    let n = positions.len();
    let normal = |t: &[u32; 3]| cross(t.map(|v| positions[v as usize])).normalize_or_zero().as_vec3();
    let mut state = State {
        normals: triangles.par_iter().map(normal).collect(),
        sites: sites(forest, vertices, n),
        changes: Changes::new(triangles.len()),
        merges: Vec::new(),
        survivors: (0..n as u32).collect(),
        complex: Complex::new(n, vertices.all.len(), triangles, pairs),
        positions,
        on_border,
        world,
        grid: &forest.leaves.grid,
        options: *options,
    };
    state.run(execution)?;
    state.take_back(execution)?;
    let State { changes, survivors, .. } = state;
    let survivor = |mut v: u32| {
        while survivors[v as usize] != v {
            v = survivors[v as usize];
        }
        v
    };
    let survivors = (0..n as u32).into_par_iter().map(survivor).collect();
    let live: Vec<bool> = triangles.iter().map(|t| !is_gone(*t)).collect();
    retain(triangles, &live);
    retain(pairs, &live);
    retain(crossings, &live);
    let undone = changes.undone() as u64;
    Ok(Merged { count: changes.made() as u64 - undone, undone, survivors })
}

fn retain<T>(list: &mut Vec<T>, live: &[bool]) {
    let mut live = live.iter();
    list.retain(|_| live.next() == Some(&true));
}

/// All vertices; those of knots and stars, behind the others, have no planes.
fn sites(forest: &Forest, vertices: &Vertices, count: usize) -> Vec<Site> {
    let leaves = &forest.leaves;
    let by_root: Vec<Vec<Site>> = forest
        .roots()
        .map(|(i, root)| {
            let own = vertices.in_root(i);
            let mut planes = vec![Qef::default(); own.len()];
            leaves.add_planes(root, &mut planes, |leaf| vertices.of_leaf[leaf as usize] as usize - own.start);
            let offset = leaves.grid.offset(root.number);
            let site = |(vertex, planes): (&super::vertices::Vertex, Qef)| Site {
                planes: planes.shifted(offset),
                at: vertex.position + offset,
                sides: vertex.sides,
            };
            vertices.all[own].iter().zip(planes).map(site).collect()
        })
        .collect();
    let mut sites = Vec::with_capacity(count);
    by_root.into_iter().for_each(|part| sites.extend(part));
    sites.resize(count, Site::default());
    sites
}

/// A triangle's normal, twice its area long.
fn cross([p, q, r]: [DVec3; 3]) -> DVec3 {
    (q - p).cross(r - p)
}

/// The square of a triangle's q.
fn squared_quality([p, q, r]: [DVec3; 3], cross: DVec3) -> f64 {
    let squares = (q - p).length_squared() + (r - q).length_squared() + (p - r).length_squared();
    12.0 * cross.length_squared() / (squares * squares).max(f64::MIN_POSITIVE)
}

/// The latest round, from 1, that merged each vertex, and that changed a triangle at it.
struct Latest {
    merged: Vec<u32>,
    touched: Vec<u32>,
}

impl Latest {
    /// Whether one of a candidate's vertices has been merged since it was ranked: it is another edge now, if any.
    fn has_merged(&self, c: &Candidate) -> bool {
        [c.kept, c.gone].iter().any(|&v| self.merged[v as usize] > c.ranked)
    }

    /// Whether the triangles around have changed since it was ranked.
    fn has_touched(&self, c: &Candidate) -> bool {
        [c.kept, c.gone].iter().any(|&v| self.touched[v as usize] > c.ranked)
    }
}

/// The mesh between two rounds.
struct State<'a> {
    complex: Complex<'a>,
    /// In the world, mm.
    positions: &'a mut [DVec3],
    on_border: &'a mut [bool],
    sites: Vec<Site>,
    /// Of the triangle that was in each slot at first.
    normals: Vec<Vec3>,
    changes: Changes,
    /// One for each change.
    merges: Vec<Merge>,
    /// What each vertex became part of; itself if nothing.
    survivors: Vec<u32>,
    world: &'a World<'a>,
    grid: &'a RootGrid,
    options: MergeOptions,
}

impl State<'_> {
    fn run(&mut self, execution: &Execution) -> Result<(), Cancelled> {
        let n = self.positions.len();
        let best: Vec<AtomicU64> = (0..n).map(|_| AtomicU64::new(REFUSED)).collect();
        let mut latest = Latest { merged: vec![0; n], touched: vec![0; n] };
        let mut left = self.complex.triangles.len() as u64;
        let (mut live, mut refused): (Vec<Candidate>, Vec<Candidate>) = {
            let state = &*self;
            let of = |v: u32| state.candidates_of(v, 0, move |w| w > v);
            let all = (0..n as u32).into_par_iter().with_min_len(1 << 8).flat_map_iter(of);
            all.partition(Candidate::is_admitted)
        };
        let mut tried_again = 0;
        for round in 1..=ROUNDS {
            execution.check()?;
            let winners = self.winners(&mut live, &best, &latest, round);
            let merged = self.carry_out_all(&winners, round, &mut left, &mut latest);
            if left <= self.options.wanted {
                break;
            }
            let state = &*self;
            live.retain(|c| {
                let stays = c.is_admitted() && !latest.has_merged(c);
                if !c.is_admitted() {
                    refused.push(*c);
                }
                stays
            });
            let is_slow = merged.len() * SLOW < live.len() && round - tried_again >= AGAIN;
            if merged.is_empty() || is_slow {
                tried_again = round;
                refused.par_iter_mut().with_min_len(1 << 8).for_each(|c| {
                    if !latest.has_merged(c) && latest.has_touched(c) {
                        state.rank_again(c, round);
                    }
                });
                refused.retain(|c| {
                    if c.is_admitted() {
                        live.push(*c);
                    }
                    !c.is_admitted() && !latest.has_merged(c)
                });
            }
            let of = |&v: &u32| state.candidates_of(v, round, |_| true);
            let new = merged.par_iter().with_min_len(1 << 4).flat_map_iter(of);
            let (admitted, not): (Vec<Candidate>, Vec<Candidate>) = new.partition(Candidate::is_admitted);
            live.extend(admitted);
            refused.extend(not);
            if live.is_empty() && tried_again == round {
                break;
            }
        }
        Ok(())
    }

    /// Carries out the winners of a round, by rank, while triangles enough are left; returns the vertices that they made.
    fn carry_out_all(
        &mut self,
        winners: &[Candidate],
        round: u32,
        left: &mut u64,
        latest: &mut Latest,
    ) -> Vec<u32> {
        let mut merged = Vec::with_capacity(winners.len());
        for candidate in winners {
            let Candidate { kept, gone, .. } = *candidate;
            if *left <= self.options.wanted {
                break;
            }
            // Two neighbours may have one rank, however rarely.
            if [kept, gone].iter().any(|&v| latest.touched[v as usize] == round) {
                continue;
            }
            *left -= self.carry_out(candidate);
            latest.merged[gone as usize] = round;
            latest.merged[kept as usize] = round;
            let around = self.complex.star(kept).flat_map(|(_, t)| t);
            around.for_each(|v| latest.touched[v as usize] = round);
            merged.push(kept);
        }
        merged
    }

    /// The candidates that are the best of all whose stars share a triangle with theirs, and are not refused at a
    /// second look, by rank.
    fn winners(
        &self,
        candidates: &mut [Candidate],
        best: &[AtomicU64],
        latest: &Latest,
        round: u32,
    ) -> Vec<Candidate> {
        best.par_iter().with_min_len(1 << 12).for_each(|b| b.store(REFUSED, Relaxed));
        candidates.par_iter().with_min_len(1 << 10).for_each(|c| {
            best[c.kept as usize].fetch_min(c.rank, Relaxed);
            best[c.gone as usize].fetch_min(c.rank, Relaxed);
        });
        let best = |v: u32| best[v as usize].load(Relaxed);
        let wins = |c: &Candidate| {
            let ends = [c.kept, c.gone];
            let around = |v: u32| self.complex.star(v).flat_map(|(_, t)| t);
            ends.into_iter().all(|v| best(v) == c.rank)
                && ends.into_iter().flat_map(around).all(|v| best(v) >= c.rank)
        };
        let look = |c: &mut Candidate| {
            if latest.has_touched(c) {
                self.rank_again(c, round - 1);
            }
            c.is_admitted().then_some(*c)
        };
        let winners = candidates.par_iter_mut().with_min_len(1 << 8).filter(|c| wins(c)).filter_map(look);
        let mut winners: Vec<Candidate> = winners.collect();
        winners.sort_unstable_by_key(|c| (c.rank, c.kept, c.gone));
        winners
    }

    /// The edges from `v` to the neighbours that are `wanted`, as far as they are candidates, ranked after `round`.
    fn candidates_of(
        &self,
        v: u32,
        round: u32,
        wanted: impl Fn(u32) -> bool,
    ) -> impl Iterator<Item = Candidate> {
        self.complex
            .neighbours(v)
            .filter(move |&w| wanted(w))
            .filter_map(move |w| self.candidate(v, w, round))
    }

    fn candidate(&self, a: u32, b: u32, round: u32) -> Option<Candidate> {
        let order = |v: u32| (self.complex.kind(v), self.sites[v as usize].sides.count_ones());
        let (kept, gone) = match order(a).cmp(&order(b)) {
            Ordering::Greater => (a, b),
            Ordering::Less => (b, a),
            Ordering::Equal => (a.min(b), a.max(b)),
        };
        let (kinds, [k, g]) =
            ([kept, gone].map(|v| self.complex.kind(v)), [kept, gone].map(|v| &self.sites[v as usize]));
        if kinds[0] == Kind::Fixed || kinds[1] > Kind::Curve || k.sides | g.sides != k.sides {
            return None;
        }
        let share = if kinds == [Kind::Curve; 2] { self.options.on_curves } else { 1.0 };
        let limit = (share * self.options.tolerance).powi(2);
        let length = k.at.distance(g.at);
        let mut planes = k.planes;
        planes.merge(&g.planes);
        let at = if kinds[0] > kinds[1] {
            k.at
        } else {
            // Refuses many, and is cheap.
            if planes.least_error() > limit * planes.count() {
                return None;
            }
            let bounds = [k.at.min(g.at) - length / 2.0, k.at.max(g.at) + length / 2.0];
            let place = Place { bounds, fixed: self.grid.fixed(0, k.sides) };
            planes.minimiser_near(k.at.midpoint(g.at), &place)
        };
        if [k, g].iter().any(|site| site.planes.error(at) > limit * site.planes.count()) {
            return None;
        }
        let cost = planes.error(at) / limit.max(f64::MIN_POSITIVE) + LENGTH * length * length;
        let mut candidate = Candidate { kept, gone, at, cost: cost as f32, ranked: round, rank: REFUSED };
        self.rank_again(&mut candidate, round);
        Some(candidate)
    }

    /// Where in the world the merged vertex goes.
    fn place(&self, candidate: &Candidate) -> DVec3 {
        let kept = candidate.kept as usize;
        if candidate.at == self.sites[kept].at {
            self.positions[kept]
        } else {
            self.world.place(0, candidate.at)
        }
    }

    /// Ranks a candidate by the triangles around it as they are after `round`.
    fn rank_again(&self, candidate: &mut Candidate, round: u32) {
        candidate.rank = self.rank(candidate);
        candidate.ranked = round;
    }

    /// Rank among all that the triangles around an edge allow.
    fn rank(&self, candidate: &Candidate) -> u64 {
        let Some(quality) = self.quality_after(candidate) else { return REFUSED };
        let Candidate { kept, gone, cost, .. } = *candidate;
        let edge = u64::from(kept.min(gone)) << 32 | u64::from(kept.max(gone));
        // Costs are positive, so their bits are in the order of their values.
        u64::from((cost / quality as f32).to_bits()) << 32 | mix(edge) >> 32
    }

    /// The lowest q of the triangles that a contraction would change, if topology and shapes allow it.
    fn quality_after(&self, candidate: &Candidate) -> Option<f64> {
        let Candidate { kept, gone, .. } = *candidate;
        if self.complex.link(kept, gone)? > VALENCE {
            return None;
        }
        let place = self.place(candidate);
        let longest = (LONGEST * self.options.edge).powi(2);
        let turn = TURN.to_radians().cos();
        let moves = place != self.positions[kept as usize];
        let changed = || {
            let of = |v: u32, other: u32| self.complex.star(v).map(move |(slot, t)| (slot, t, v, other));
            of(gone, kept).chain(of(kept, gone).filter(move |_| moves))
        };
        let mut after = 1.0f64;
        for (slot, t, v, _) in changed().filter(|(_, t, _, other)| !t.contains(other)) {
            let corners = t.map(|w| if w == v { place } else { self.positions[w as usize] });
            let normal = cross(corners);
            let q = squared_quality(corners, normal);
            let turns = normal.dot(self.normals[slot as usize].as_dvec3()) < turn * normal.length();
            let is_long = corners.iter().any(|c| c.distance_squared(place) > longest);
            if turns || is_long || q.is_nan() || q < LEAST * LEAST {
                return None;
            }
            after = after.min(q);
        }
        let is_better = || {
            let before = changed().map(|(_, t, ..)| {
                let corners = t.map(|w| self.positions[w as usize]);
                squared_quality(corners, cross(corners))
            });
            before.fold(1.0f64, f64::min) <= after
        };
        (after >= QUALITY * QUALITY || is_better()).then(|| after.sqrt())
    }

    /// Contracts an edge; returns how many triangles that takes away.
    fn carry_out(&mut self, candidate: &Candidate) -> u64 {
        let Candidate { kept, gone, at, .. } = *candidate;
        let place = self.place(candidate);
        let new = self.complex.contracted(kept, gone);
        let live = || new.iter().filter(|(_, t)| !is_gone(*t)).map(|(slot, _)| *slot);
        let away = (new.len() - live().count()) as u64;
        let star = self.complex.set_star(kept, live());
        self.changes.make(self.complex.triangles, new);
        let planes = self.sites[gone as usize].planes;
        let [k, g] = [kept, gone].map(|v| v as usize);
        let (position, on_border) = (self.positions[k], self.on_border[k]);
        self.merges.push(Merge { kept, gone, position, on_border, star });
        self.sites[k].at = at;
        self.sites[k].planes.merge(&planes);
        self.positions[k] = place;
        self.on_border[k] |= self.on_border[g];
        self.survivors[g] = kept;
        away
    }

    /// Takes merges back until no triangle that one changed is wrong.
    fn take_back(&mut self, execution: &Execution) -> Result<(), Cancelled> {
        let slots = 0..self.complex.triangles.len() as u32;
        let mut asked: Vec<bool> =
            slots.into_par_iter().map(|slot| self.changes.is_changed(slot as usize)).collect();
        while asked.contains(&true) {
            let wrong = self.wrong(&asked, execution)?;
            let Self { complex, changes, merges, .. } = self;
            let mut taken = Vec::new();
            let changed = changes.undo_latest(complex.triangles, wrong, |merge| taken.push(merge));
            for Merge { kept, gone, position, on_border, star } in
                taken.into_iter().map(|m| merges[m as usize])
            {
                complex.restore_star(kept, star);
                self.positions[kept as usize] = position;
                self.on_border[kept as usize] = on_border;
                self.survivors[gone as usize] = gone;
            }
            // The others were asked for before.
            asked.fill(false);
            changed.into_iter().for_each(|slot| asked[slot as usize] = true);
        }
        Ok(())
    }

    /// Slots that merges changed with triangles that are wrong: that meet others, have no area, or lie around an edge
    /// in a wrong order. Only those that are `asked` for, and what they meet. Ascending.
    fn wrong(&self, asked: &[bool], execution: &Execution) -> Result<Vec<u32>, Cancelled> {
        let all = &*self.complex.triangles;
        let live: Vec<u32> = (0..all.len() as u32).filter(|&slot| !is_gone(all[slot as usize])).collect();
        let triangles: Vec<[u32; 3]> = live.iter().map(|&slot| all[slot as usize]).collect();
        let flat = without_area(self.positions, &triangles);
        let is_asked = |t: usize| asked[live[t] as usize];
        let met = Search::new(self.positions, &triangles, &flat).run(is_asked, execution)?;
        let alone =
            |t: &usize| is_asked(*t) && (flat[*t] || !self.complex.matches_up(self.positions, live[*t]));
        let mut wrong: Vec<u32> = (0..live.len()).into_par_iter().filter(alone).map(|t| live[t]).collect();
        wrong.extend(met.first.into_iter().flatten().map(|t| live[t as usize]));
        wrong.retain(|&slot| self.changes.is_changed(slot as usize));
        wrong.sort_unstable();
        wrong.dedup();
        Ok(wrong)
    }
}
