//! Which wishes can be granted: those after which no triangles meet.
//!
//! All are granted at once. Then triangles that meet where they must not, that have turned over or become slivers are
//! looked for, and their vertices go halfway back, and all the way the next time; again, until nothing offends. With no moves the
//! surface is what marching promises, so this ends there at the latest. All vertices go back together and triangles are
//! judged by exact tests of places as they will be written, so neither threads nor slabs show in the result.

use glam::DVec3;

use super::error::ContourError;
use super::marching::Surroundings;
use super::moves::{Move, Moves, Wish};
use super::piece::SeamKey;
use crate::execution::Execution;
use crate::grid::Geometry;
use crate::triangle::{Search, VertexTable, is_without_area, without_area};

/// A wish is granted in so many parts.
const PARTS: u8 = 2;
/// A triangle may not turn by more than the angle of this cosine.
const TURNED: f64 = 0.0;
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
    let mut settling = Settling::new(around);
    while settling.round(geometry, execution)? {}
    let granted = settling.wishes.iter().zip(&settling.parts).filter(|(_, part)| **part > 0);
    Ok(Moves::new(granted.map(|(w, &part)| Move { key: w.key, at: partly(w, part), sigma: w.sigma }).collect()))
}

/// Where a vertex lies of whose wish so many parts are granted.
fn partly(wish: &Wish, part: u8) -> [f32; 3] {
    if part == PARTS {
        return wish.at;
    }
    let share = f32::from(part) / f32::from(PARTS);
    [0, 1, 2].map(|a| wish.safe[a] + share * (wish.at[a] - wish.safe[a]))
}

struct Settling {
    wishes: Vec<Wish>,
    /// How many parts of each are granted.
    parts: Vec<u8>,
    /// The vertex of each wish.
    vertex: Vec<u32>,
    /// The wish of each vertex, or [`NONE`].
    wish: Vec<u32>,
    positions: Vec<[f32; 3]>,
    /// By construction, lattice units.
    safe: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    at: VertexTable,
    /// Triangles that are to be looked at.
    asked: Vec<bool>,
}

const NONE: u32 = u32::MAX;

impl Settling {
    fn new(around: Surroundings) -> Self {
        let Surroundings { mut wishes, mut vertices, triangles } = around;
        vertices.sort_unstable_by_key(|v| v.0);
        vertices.dedup_by_key(|v| v.0);
        wishes.sort_unstable_by_key(|w| w.key);
        wishes.dedup_by_key(|w| w.key);
        let number = |key: SeamKey| vertices.binary_search_by_key(&key, |v| v.0).ok().map(|i| i as u32);
        // A vertex without triangles has nothing to move.
        wishes.retain(|w| number(w.key).is_some());
        let vertex: Vec<u32> = wishes.iter().filter_map(|w| number(w.key)).collect();
        let triangles: Vec<[u32; 3]> =
            triangles.iter().map(|t| t.map(|key| number(key).unwrap_or(NONE))).collect();
        let mut wish = vec![NONE; vertices.len()];
        vertex.iter().enumerate().for_each(|(i, &v)| wish[v as usize] = i as u32);
        let positions: Vec<[f32; 3]> = vertices.iter().map(|v| v.1).collect();
        let safe = positions.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        let at = VertexTable::new(vertices.len(), &triangles);
        let parts = vec![PARTS; wishes.len()];
        let mut out = Self { parts, vertex, wish, positions, safe, at, asked: Vec::new(), triangles, wishes };
        out.asked = vec![false; out.triangles.len()];
        (0..out.wishes.len()).for_each(|i| out.place(i));
        out
    }

    /// Puts the vertex of a wish where it lies now; its triangles are to be looked at.
    fn place(&mut self, i: usize) {
        let v = self.vertex[i] as usize;
        self.positions[v] = partly(&self.wishes[i], self.parts[i]);
        for &t in self.at.triangles(v) {
            self.asked[t as usize] = true;
        }
    }

    /// Looks at what moved last and takes back what offends; whether anything did.
    fn round(&mut self, geometry: &Geometry, execution: &Execution) -> Result<bool, ContourError> {
        let lattice: Vec<DVec3> = self.positions.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        // As a mesh has them in single precision.
        let written: Vec<DVec3> =
            lattice.iter().map(|&p| geometry.world(p).as_vec3().as_dvec3()).collect();
        let mut offends = vec![false; self.triangles.len()];
        for (t, offends) in offends.iter_mut().enumerate().filter(|(t, _)| self.asked[*t]) {
            *offends = self.is_spoilt(t, &lattice) || is_without_area(&written, self.triangles[t]);
        }
        for positions in [&lattice, &written] {
            let left_out = without_area(positions, &self.triangles);
            let search = Search::new(positions, &self.triangles, &left_out);
            let found = search.run(|t| self.asked[t], execution).map_err(ContourError::from)?;
            for t in found.first.into_iter().flatten() {
                offends[t as usize] = true;
            }
        }
        self.asked.fill(false);
        let mut back: Vec<u32> = Vec::new();
        for (t, _) in offends.iter().enumerate().filter(|(_, offends)| **offends) {
            let moved = self.triangles[t].map(|v| self.wish[v as usize]);
            back.extend(moved.into_iter().filter(|&w| w != NONE && self.parts[w as usize] > 0));
        }
        back.sort_unstable();
        back.dedup();
        for &w in &back {
            self.parts[w as usize] -= 1;
            self.place(w as usize);
        }
        Ok(!back.is_empty())
    }

    /// Whether a triangle has turned over or become a sliver.
    fn is_spoilt(&self, t: usize, now: &[DVec3]) -> bool {
        let corners = |at: &[DVec3]| self.triangles[t].map(|v| at[v as usize]);
        let (before, after) = (corners(&self.safe), corners(now));
        let normal = |c: [DVec3; 3]| (c[1] - c[0]).cross(c[2] - c[0]);
        let (m, n) = (normal(before), normal(after));
        let height = |c: [DVec3; 3], n: DVec3| {
            let longest = (0..3).map(|i| c[i].distance(c[(i + 1) % 3])).fold(0.0, f64::max);
            n.length() / longest
        };
        let flat = height(after, n);
        !(m.dot(n) > TURNED * m.length() * n.length() && (flat >= FLATTEST || flat >= height(before, m)))
    }
}
