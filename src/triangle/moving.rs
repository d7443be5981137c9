//! Triangles whose vertices move within known bounds, asked again and again which of them meet where they must not.
//!
//! Method: each triangle is filed under the cells of a lattice that its bounds (the box of all places of its vertices) reach,
//! once. Two triangles can only meet in a cell that both have; of the cells that they share only the lowest one tests them.
//! Finding what meets a few triangles costs no look at the others, where [`super::meetings::Search`] passes over all of them
//! to build its trees.
//!
//! Guarantee: what is found is what that search finds ([`super::meetings::meet_wrongly`]), in the same order.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::meetings::meet_wrongly;
use crate::execution::{Cancelled, Execution};

/// Edge of a cell, in the unit of the bounds: lattice units, of which a triangle of marching spans one.
const CELL: f64 = 2.0;
/// Bounds are widened by this: places are rounded when written.
const ROUNDING: f64 = 1e-3;
/// Bits of a cell's coordinate in a key, of which half the values are below zero.
const BITS: u32 = 21;

/// See the module's header.
#[derive(Debug)]
pub(crate) struct MovingTriangles {
    /// Key of a cell and a triangle; sorted.
    filed: Vec<(u64, u32)>,
    /// The lowest and the highest cell of each triangle.
    cells: Vec<[IVec3; 2]>,
}

/// A key that grows with z, then y, then x.
fn key(cell: IVec3) -> u64 {
    let biased = |c: i32| (i64::from(c) + (1 << (BITS - 1))).clamp(0, (1 << BITS) - 1) as u64;
    biased(cell.z) << (2 * BITS) | biased(cell.y) << BITS | biased(cell.x)
}

/// The rows of cells along x of a box of cells: their first and their last one.
fn rows([low, high]: [IVec3; 2]) -> impl Iterator<Item = [IVec3; 2]> {
    let ends = move |y, z| [low.x, high.x].map(|x| IVec3::new(x, y, z));
    (low.z..=high.z).flat_map(move |z| (low.y..=high.y).map(move |y| ends(y, z)))
}

impl MovingTriangles {
    /// Of triangles whose vertices stay between `bounds`, two places for each.
    pub(crate) fn new(bounds: impl Fn(u32) -> [DVec3; 2] + Sync, triangles: &[[u32; 3]]) -> Self {
        let cell = |p: DVec3| (p / CELL).floor().as_ivec3();
        let cells_of = |t: &[u32; 3]| {
            let ends = t.map(&bounds);
            let low = ends.iter().flatten().fold(DVec3::INFINITY, |low, &p| low.min(p));
            let high = ends.iter().flatten().fold(DVec3::NEG_INFINITY, |high, &p| high.max(p));
            [cell(low - ROUNDING), cell(high + ROUNDING)]
        };
        let cells: Vec<[IVec3; 2]> = triangles.par_iter().map(cells_of).collect();
        let keys = |(t, cells): (usize, &[IVec3; 2])| {
            rows(*cells).flat_map(move |[first, last]| (key(first)..=key(last)).map(move |k| (k, t as u32)))
        };
        let mut filed: Vec<(u64, u32)> = cells.par_iter().enumerate().flat_map_iter(keys).collect();
        filed.par_sort_unstable();
        Self { filed, cells }
    }

    /// The pairs, ascending and lower triangle first, of which at least one is `asked` for (each once) and none `left_out`, which
    /// flags all that have no area.
    ///
    /// # Errors
    /// [`Cancelled`] if asked to stop.
    pub(crate) fn meetings(
        &self,
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        left_out: &[bool],
        asked: &[u32],
        execution: &Execution,
    ) -> Result<Vec<[u32; 2]>, Cancelled> {
        let mut is_asked = vec![false; triangles.len()];
        asked.iter().for_each(|&t| is_asked[t as usize] = true);
        let bounds = |t: u32| {
            let [a, b, c] = triangles[t as usize].map(|v| positions[v as usize]);
            [a.min(b).min(c), a.max(b).max(c)]
        };
        let meets = |t: u32, found: &mut Vec<[u32; 2]>| {
            let own = self.cells[t as usize];
            let [low, high] = bounds(t);
            for ends in rows(own) {
                let [first, last] = ends.map(key);
                let start = self.filed.partition_point(|filed| filed.0 < first);
                let row = self.filed[start..].iter().take_while(|filed| filed.0 <= last);
                for &(cell, u) in row {
                    // Of two that are asked the lower asks.
                    if u == t || left_out[u as usize] || (is_asked[u as usize] && u < t) {
                        continue;
                    }
                    let [other_low, other_high] = bounds(u);
                    let overlap = low.cmple(other_high) & other_low.cmple(high);
                    let is_lowest = || key(own[0].max(self.cells[u as usize][0])) == cell;
                    if overlap.all() && is_lowest() {
                        let [a, b] = [t.min(u), t.max(u)];
                        if meet_wrongly(positions, triangles[a as usize], triangles[b as usize]) {
                            found.push([a, b]);
                        }
                    }
                }
            }
        };
        let found = asked.par_chunks(1 << 8).map(|asked| {
            execution.check()?;
            let mut found = Vec::new();
            asked.iter().filter(|&&t| !left_out[t as usize]).for_each(|&t| meets(t, &mut found));
            Ok(found)
        });
        let mut found = found.collect::<Result<Vec<_>, Cancelled>>()?.concat();
        found.sort_unstable();
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::triangle::{Search, without_area};
    use rand::{RngExt, SeedableRng};

    #[test]
    fn finds_what_a_search_of_all_finds_while_vertices_move() {
        let mut met = 0;
        for seed in 0..40 {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let count = 200u32;
            let side = [3.0, 6.0, 15.0, 60.0][seed as usize % 4];
            let mut place = |middle: DVec3, off: f64| {
                middle + DVec3::from_array([0; 3].map(|_: i32| rng.random_range(-off..off)))
            };
            let from: Vec<DVec3> = (0..count).map(|_| place(DVec3::splat(1.3), side)).collect();
            let to: Vec<DVec3> = from.iter().map(|&p| place(p, 1.0)).collect();
            let mut near = |v: u32| (v + rng.random_range(0..5)) % count;
            let triangles: Vec<[u32; 3]> = (0..count).map(|v| [near(v), near(v), near(v)]).collect();
            let moving = MovingTriangles::new(|v| [from[v as usize], to[v as usize]], &triangles);
            for step in 0..3 {
                let positions: Vec<DVec3> =
                    from.iter().zip(&to).map(|(&a, &b)| a.lerp(b, 0.5 * f64::from(step))).collect();
                let left_out = without_area(&positions, &triangles);
                for every in [1, 9] {
                    let asked: Vec<u32> = (0..count).filter(|t| t.is_multiple_of(every)).collect();
                    let search = Search::new(&positions, &triangles, &left_out);
                    let expected =
                        search.run(|t| (t as u32).is_multiple_of(every), &Execution::default()).unwrap();
                    let found =
                        moving.meetings(&positions, &triangles, &left_out, &asked, &Execution::default());
                    assert_eq!(found.unwrap(), expected.first, "{seed} {step} {every}");
                    met += expected.first.len();
                }
            }
        }
        assert!(met > 1000, "{met} pairs are too few for a test");
    }
}
