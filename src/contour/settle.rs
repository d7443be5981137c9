//! Which wishes can be granted: those after which no triangles meet.
//!
//! All are granted at once. Then triangles that meet where they must not, that have turned over or become slivers are
//! looked for, and their vertices go half of the way back; again, until nothing offends. With no moves the
//! surface is what marching promises, so this ends there at the latest. Then what was refused is tried again, a fifth at a time, the
//! others staying where they are.
//!
//! **Turned over** is a triangle that faced as the interface does that it is of, where its vertices should lie, and does so no more. Where a
//! lattice edge meets two sheets, what construction makes of it may stand across the sheet: it is not what triangles are measured
//! by, unless nothing else is known. Those that face away by construction may do anything but meet others.
//!
//! All vertices go back together and triangles are judged by exact tests of places as they will be written, so neither threads nor
//! slabs show in the result.

use glam::DVec3;

use super::error::ContourError;
use super::marching::Surroundings;
use super::moves::{Move, Moves, Wish};
use super::piece::SeamKey;
use crate::execution::Execution;
use crate::grid::{Geometry, Written};
use crate::triangle::{MovingTriangles, VertexTable, is_without_area, without_area};

/// A wish is granted in so many parts.
const PARTS: u8 = 8;
/// What was refused is tried again, where neighbours have settled: group after group, for vertices that are in each other's way
/// may each be granted alone, or some of them together. So many groups, other ones in each of so many cycles.
const GROUPS: usize = 5;
const CYCLES: usize = 6;
/// A cycle that grants less than this part of what is refused is the last.
const ENOUGH: usize = 32;
/// Height of a triangle over its longest side, lattice units, below which it is a sliver; those that are flatter by construction
/// may not become flatter still.
const FLATTEST: f64 = 0.02;

/// The moves that can be granted, of a lattice that lies in the world as `geometry` says.
///
/// # Errors
/// [`ContourError::Cancelled`] if asked to stop.
pub fn settle(
    around: Surroundings,
    geometry: &Geometry,
    execution: &Execution,
) -> Result<Moves, ContourError> {
    let mut settling = Settling::new(around, geometry);
    while settling.round(execution)? {}
    for cycle in 0..CYCLES {
        let before = settling.refused();
        for group in 0..GROUPS {
            if settling.raise(cycle, group) {
                while settling.round(execution)? {}
            }
        }
        if before - settling.refused() <= before / ENOUGH {
            break;
        }
    }
    let scale = DVec3::from(geometry.spacing()) / geometry.voxel_edge();
    let moved = settling.wishes.iter().zip(&settling.parts).map(|(wish, &part)| {
        let at = partly(wish, part);
        let left = [0, 1, 2].map(|a| f64::from(wish.at[a] - at[a]));
        // A vertex that is known to be off is known no better than that.
        let left = (DVec3::from(left) * scale).length() as f32;
        Move { key: wish.key, at, sigma: wish.sigma.hypot(left) }
    });
    Ok(Moves::new(moved.collect()))
}

/// Where a vertex lies of whose wish so many parts are granted.
fn partly(wish: &Wish, part: u8) -> [f32; 3] {
    let most = wish.most();
    if part == PARTS {
        return most;
    }
    if part == 0 {
        return wish.safe;
    }
    let share = f32::from(part) / f32::from(PARTS);
    [0, 1, 2].map(|a| wish.safe[a] + share * (most[a] - wish.safe[a]))
}

/// The group of a vertex: by chance, so that neighbours are parted in some cycle and together in another.
fn group_of(key: SeamKey, cycle: usize) -> usize {
    // Multipliers of SplitMix64.
    let mixed =
        (key.0 ^ (cycle as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (mixed >> 40) as usize % GROUPS
}

struct Settling<'a> {
    written: Written<'a>,
    wishes: Vec<Wish>,
    /// How many parts of each are granted, and how many at least: with no more nothing offends.
    parts: Vec<u8>,
    least: Vec<u8>,
    /// The vertex of each wish.
    vertex: Vec<u32>,
    /// The wish of each vertex, or [`NONE`].
    wish: Vec<u32>,
    /// Where vertices lie, lattice units, and in the world as a mesh has them.
    positions: [Vec<DVec3>; 2],
    /// By construction, lattice units.
    safe: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Where they should face; not a number where that is not known.
    facing: Vec<[f32; 3]>,
    at: VertexTable,
    /// The triangles by where they may come.
    moving: MovingTriangles,
    /// Triangles of vertices that were moved and not looked at since.
    moved: Vec<u32>,
    /// Triangles without area in either place.
    left_out: [Vec<bool>; 2],
}

const NONE: u32 = u32::MAX;

impl<'a> Settling<'a> {
    fn new(around: Surroundings, geometry: &'a Geometry) -> Self {
        let Surroundings { mut wishes, mut vertices, triangles } = around;
        vertices.sort_unstable_by_key(|v| v.0);
        vertices.dedup_by_key(|v| v.0);
        wishes.sort_unstable_by_key(|w| w.key);
        wishes.dedup_by_key(|w| w.key);
        let number = |key: SeamKey| vertices.binary_search_by_key(&key, |v| v.0).ok().map(|i| i as u32);
        // A vertex without triangles has nothing to move.
        wishes.retain(|w| number(w.key).is_some());
        let vertex: Vec<u32> = wishes.iter().filter_map(|w| number(w.key)).collect();
        let facing = triangles.iter().map(|facet| facet.facing).collect();
        let triangles: Vec<[u32; 3]> =
            triangles.iter().map(|facet| facet.vertices.map(|key| number(key).unwrap_or(NONE))).collect();
        let mut wish = vec![NONE; vertices.len()];
        vertex.iter().enumerate().for_each(|(i, &v)| wish[v as usize] = i as u32);
        let written = Written::new(geometry);
        let safe: Vec<DVec3> = vertices.iter().map(|v| DVec3::from(v.1.map(f64::from))).collect();
        let positions = [safe.clone(), safe.iter().map(|&p| written.place(p)).collect()];
        let left_out = [0, 1].map(|i| without_area(&positions[i], &triangles));
        let farthest = |v: u32| match wish[v as usize] {
            NONE => safe[v as usize],
            w => DVec3::from(wishes[w as usize].most().map(f64::from)),
        };
        let moving = MovingTriangles::new(|v| [safe[v as usize], farthest(v)], &triangles);
        let mut out = Self {
            written,
            parts: wishes.iter().map(|wish| if wish.is_near() { PARTS } else { 0 }).collect(),
            least: vec![0; wishes.len()],
            vertex,
            wish,
            positions,
            safe,
            at: VertexTable::new(vertices.len(), &triangles),
            moving,
            moved: Vec::new(),
            left_out,
            triangles,
            facing,
            wishes,
        };
        for i in 0..out.wishes.len() {
            if out.parts[i] > 0 {
                out.place(i);
            }
        }
        out
    }

    /// Puts the vertex of a wish where it lies now; its triangles are to be looked at.
    fn place(&mut self, i: usize) {
        let v = self.vertex[i] as usize;
        let at = DVec3::from(partly(&self.wishes[i], self.parts[i]).map(f64::from));
        self.positions[0][v] = at;
        self.positions[1][v] = self.written.place(at);
        self.moved.extend_from_slice(self.at.triangles(v));
    }

    /// How many parts are refused, all in all.
    fn refused(&self) -> usize {
        self.movable().map(|i| usize::from(PARTS - self.parts[i])).sum()
    }

    /// The wishes of which something may be granted.
    fn movable(&self) -> impl Iterator<Item = usize> {
        (0..self.wishes.len()).filter(|&i| self.wishes[i].is_near())
    }

    /// Grants what was refused, of one group of the wishes, to be taken back no farther than to where it is now; whether there was
    /// any. What was granted stays.
    fn raise(&mut self, cycle: usize, group: usize) -> bool {
        self.least.copy_from_slice(&self.parts);
        let is_own = |i: &usize| group_of(self.wishes[*i].key, cycle) == group;
        let refused: Vec<usize> = self.movable().filter(|&i| self.parts[i] < PARTS).filter(is_own).collect();
        for &i in &refused {
            self.parts[i] = PARTS;
            self.place(i);
        }
        !refused.is_empty()
    }

    /// Takes back what offends; whether anything did. What a single triangle shows is looked at until none offends, before
    /// the search for triangles that meet, which costs most.
    fn round(&mut self, execution: &Execution) -> Result<bool, ContourError> {
        let mut asked = std::mem::take(&mut self.moved);
        let mut fresh = asked.clone();
        while !fresh.is_empty() {
            for &t in &fresh {
                for (left_out, positions) in self.left_out.iter_mut().zip(&self.positions) {
                    left_out[t as usize] = is_without_area(positions, self.triangles[t as usize]);
                }
            }
            let offends = |t: &u32| self.is_spoilt(*t as usize) || self.is_left_out(*t);
            let offending: Vec<u32> = fresh.into_iter().filter(offends).collect();
            self.take_back(&offending);
            fresh = std::mem::take(&mut self.moved);
            asked.extend_from_slice(&fresh);
        }
        asked.sort_unstable();
        asked.dedup();
        let found = self.moving.meetings(
            &self.positions[1],
            &self.triangles,
            &self.left_out[1],
            &asked,
            execution,
        )?;
        Ok(self.take_back(found.as_flattened()))
    }

    fn is_left_out(&self, t: u32) -> bool {
        self.left_out.iter().any(|left_out| left_out[t as usize])
    }

    /// Takes back by half, of what may be, what moved the vertices of these triangles; whether there was any.
    fn take_back(&mut self, offending: &[u32]) -> bool {
        let mut back: Vec<u32> = Vec::new();
        for &t in offending {
            let moved = self.triangles[t as usize].map(|v| self.wish[v as usize]);
            back.extend(
                moved.into_iter().filter(|&w| w != NONE && self.parts[w as usize] > self.least[w as usize]),
            );
        }
        back.sort_unstable();
        back.dedup();
        for &w in &back {
            let (part, least) = (&mut self.parts[w as usize], self.least[w as usize]);
            *part = least + (*part - least) / 2;
            self.place(w as usize);
        }
        self.moved.sort_unstable();
        self.moved.dedup();
        !back.is_empty()
    }

    /// Whether a triangle has turned over or become a sliver.
    fn is_spoilt(&self, t: usize) -> bool {
        let corners = |at: &[DVec3]| self.triangles[t].map(|v| at[v as usize]);
        let (before, after) = (corners(&self.safe), corners(&self.positions[0]));
        let normal = |c: [DVec3; 3]| (c[1] - c[0]).cross(c[2] - c[0]);
        let (m, n) = (normal(before), normal(after));
        let height = |c: [DVec3; 3], n: DVec3| {
            let longest = (0..3).map(|i| c[i].distance(c[(i + 1) % 3])).fold(0.0, f64::max);
            n.length() / longest
        };
        let flat = height(after, n);
        let facing = DVec3::from(self.facing[t].map(f64::from));
        let is_turned =
            if facing.is_nan() { m.dot(n) <= 0.0 } else { m.dot(facing) > 0.0 && n.dot(facing) <= 0.0 };
        is_turned || flat < FLATTEST && flat < height(before, m)
    }
}
