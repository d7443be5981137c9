//! Every pair of triangles that meets where it must not: anywhere but in the vertices and edges it shares.
//!
//! Which vertices two triangles share is told by their numbers, not by places: two vertices in one place
//! do meet. Triangles without area are left out (they are other defects), so are pairs with the same
//! three vertices. Most neighbours are cleared by a look at their common vertex
//! ([`super::stars`]). All decisions are exact ([`super::triangle_pair`]), all pairs that can meet are looked at
//! ([`super::size_trees`]); neither threads nor the order of the search show in the result.

use glam::DVec3;
use rayon::prelude::*;

use super::apart::surely_apart;
use super::nearby::nearby;
use super::size_trees::SizeTrees;
use super::stars::certified;
use super::triangle_pair::{folded, is_degenerate, touch, touch_beyond_vertex};
use crate::execution::{Cancelled, Execution};

/// Asking triangles per parallel task.
const CHUNK: usize = 1 << 12;

/// What a search found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Meetings {
    /// How many pairs there are.
    pub(crate) count: u64,
    /// The first of them in ascending order, lower triangle first.
    pub(crate) first: Vec<[u32; 2]>,
}

/// A search for all pairs of triangles that meet where they must not.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Search<'a> {
    positions: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    left_out: &'a [bool],
    keep: usize,
    stage: Option<&'static str>,
}

/// Whether a triangle has no area: exactly, or because it repeats a vertex.
pub(crate) fn is_without_area(positions: &[DVec3], [a, b, c]: [u32; 3]) -> bool {
    let corners = [a, b, c].map(|v| positions[v as usize]);
    a == b || b == c || c == a || is_degenerate(&corners)
}

/// Flags the triangles without area, which [`Search`] must leave out.
pub(crate) fn without_area(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<bool> {
    triangles.par_iter().map(|&t| is_without_area(positions, t)).collect()
}

impl<'a> Search<'a> {
    /// A search among `triangles` but those flagged in `left_out`, which has one entry for each and must flag
    /// all [`without_area`].
    pub(crate) fn new(positions: &'a [DVec3], triangles: &'a [[u32; 3]], left_out: &'a [bool]) -> Self {
        Self { positions, triangles, left_out, keep: usize::MAX, stage: None }
    }

    /// Lists the first `keep` pairs only; all are counted.
    pub(crate) fn keep(mut self, keep: usize) -> Self {
        self.keep = keep;
        self
    }

    /// Shows progress as a stage of this name.
    pub(crate) fn stage(mut self, name: &'static str) -> Self {
        self.stage = Some(name);
        self
    }

    /// Looks for the pairs of which at least one triangle is `asked` for.
    pub(crate) fn run(
        &self,
        asked: impl Fn(usize) -> bool + Sync,
        execution: &Execution,
    ) -> Result<Meetings, Cancelled> {
        let near = nearby(self.positions, self.triangles, &asked);
        let keep = |t: usize| !self.left_out[t] && near.as_ref().is_none_or(|near| near[t]);
        let trees = SizeTrees::new(self.positions, self.triangles, keep);
        execution.check()?;
        // Looking at all vertices does not pay for a few triangles.
        let sound = if near.is_some() { Vec::new() } else { certified(self.positions, self.triangles) };
        execution.check()?;
        let portions = trees.askers(CHUNK);
        let stage = self.stage.map(|name| execution.stage(name, portions.len() as u64));
        let found = portions
            .into_par_iter()
            .map(|(class, ranks)| {
                execution.check()?;
                let mut found = Meetings { count: 0, first: Vec::new() };
                trees.visit_overlaps(class, ranks, |t, u| {
                    let (t, u) = (t.min(u), t.max(u));
                    let (a, b) = (self.triangles[t], self.triangles[u]);
                    let is_sound = |v: u32| sound.get(v as usize).copied().unwrap_or(false);
                    let cleared = || a.iter().any(|&v| b.contains(&v) && is_sound(v));
                    let wanted = (asked(u) || asked(t)) && !cleared();
                    if wanted && meet_wrongly(self.positions, a, b) {
                        found.count += 1;
                        found.first.push([t as u32, u as u32]);
                        if found.first.len() >= self.keep.max(1 << 10).saturating_mul(2) {
                            keep_lowest(&mut found.first, self.keep);
                        }
                    }
                });
                keep_lowest(&mut found.first, self.keep);
                if let Some(stage) = &stage {
                    stage.advance(1);
                }
                Ok(found)
            })
            .collect::<Result<Vec<_>, Cancelled>>()?;
        let count = found.iter().map(|f| f.count).sum();
        let mut first: Vec<_> = found.into_iter().flat_map(|f| f.first).collect();
        keep_lowest(&mut first, self.keep);
        Ok(Meetings { count, first })
    }
}

fn keep_lowest(pairs: &mut Vec<[u32; 2]>, keep: usize) {
    pairs.sort_unstable();
    pairs.truncate(keep);
}

/// Whether two triangles meet anywhere but in the vertices and edges they share.
pub(super) fn meet_wrongly(positions: &[DVec3], a: [u32; 3], b: [u32; 3]) -> bool {
    let shared = |v: u32, other: &[u32; 3]| other.contains(&v);
    let point = |v: u32| positions[v as usize];
    let common: usize = a.iter().filter(|&&v| shared(v, &b)).count();
    match common {
        0 => {
            let (a, b) = (a.map(point), b.map(point));
            !surely_apart(&a, &b) && touch(&a, &b)
        }
        1 => {
            // Both are turned so that the common vertex comes first.
            let from = |t: &[u32; 3], other: &[u32; 3]| {
                let i = (0..3).find(|&i| shared(t[i], other)).unwrap_or(0);
                [t[i], t[(i + 1) % 3], t[(i + 2) % 3]].map(point)
            };
            touch_beyond_vertex(&from(&a, &b), &from(&b, &a))
        }
        2 => {
            let lone = |t: &[u32; 3], other: &[u32; 3]| {
                let i = (0..3).find(|&i| !shared(t[i], other)).unwrap_or(0);
                [t[(i + 1) % 3], t[(i + 2) % 3], t[i]].map(point)
            };
            let ([p, q, r], [_, _, s]) = (lone(&a, &b), lone(&b, &a));
            folded(p, q, r, s)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Few places on a small lattice for many triangles: they touch, share, fold and lie in one plane.
    fn soup(seed: u64, triangles: usize, side: i32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let positions: Vec<_> = (0..triangles)
            .map(|_| DVec3::from_array([0; 3].map(|_: i32| f64::from(rng.random_range(0..side)))) * 0.3 + 7.1)
            .collect();
        let n = triangles as u32;
        let near = |rng: &mut rand_chacha::ChaCha8Rng, v: u32| (v + rng.random_range(0..4)) % n;
        let triangles = (0..n).map(|v| [near(&mut rng, v), near(&mut rng, v), near(&mut rng, v)]).collect();
        (positions, triangles)
    }

    fn brute_force(positions: &[DVec3], triangles: &[[u32; 3]], left_out: &[bool]) -> Vec<[u32; 2]> {
        let mut pairs = Vec::new();
        for u in (0..triangles.len()).filter(|&u| !left_out[u]) {
            for t in (0..u).filter(|&t| !left_out[t]) {
                let (a, b) = (triangles[t], triangles[u]);
                let corners = |t: [u32; 3]| t.map(|v| positions[v as usize]);
                let apart = a.iter().all(|v| !b.contains(v));
                // Exact tests only, without what is cleared before them.
                let meet =
                    if apart { touch(&corners(a), &corners(b)) } else { meet_wrongly(positions, a, b) };
                if meet {
                    pairs.push([t as u32, u as u32]);
                }
            }
        }
        pairs.sort_unstable();
        pairs
    }

    #[test]
    fn a_search_finds_what_brute_force_finds_all_of_it_or_of_some_triangles() {
        let mut met = 0;
        for seed in 0..60 {
            let side = [3, 5, 12, 40][seed as usize % 4];
            let (positions, triangles) = soup(seed, 150, side);
            let left_out = without_area(&positions, &triangles);
            let expected = brute_force(&positions, &triangles, &left_out);
            met += expected.len();
            let search = Search::new(&positions, &triangles, &left_out);
            let all = search.run(|_| true, &Execution::default()).unwrap();
            assert_eq!(all, Meetings { count: expected.len() as u64, first: expected.clone() });
            let asked = |t: usize| t % 7 == 3;
            let some = search.run(asked, &Execution::default()).unwrap();
            let of_some: Vec<_> =
                expected.into_iter().filter(|p| p.iter().any(|&t| asked(t as usize))).collect();
            assert_eq!(some.first, of_some);
            let few = search.keep(3).run(asked, &Execution::default()).unwrap();
            assert_eq!(few.count, some.count);
            assert_eq!(few.first, some.first[..some.first.len().min(3)]);
        }
        assert!(met > 1000, "{met} pairs are too few for a test");
    }

    /// A sheet of closed fans, on places of a lattice that crumple it by `bump`: flat, folded, touching.
    fn sheet(seed: u64, n: u32, bump: i32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut off = || f64::from(rng.random_range(-bump..=bump)) * 0.3;
        let places =
            (0..n * n).map(|i| DVec3::new(f64::from(i % n) + off(), f64::from(i / n) + off(), off()));
        let positions = places.collect();
        let at = |x: u32, y: u32| y * n + x;
        let squares = (0..n - 1).flat_map(|y| (0..n - 1).map(move |x| (x, y)));
        let halves =
            |(x, y)| [[at(x, y), at(x + 1, y), at(x + 1, y + 1)], [at(x, y), at(x + 1, y + 1), at(x, y + 1)]];
        (positions, squares.flat_map(halves).collect())
    }

    #[test]
    fn certificates_lose_no_pair() {
        let (mut met, mut cleared) = (0, 0);
        for seed in 0..60 {
            let (positions, triangles) = sheet(seed, 10, seed as i32 % 4);
            let left_out = without_area(&positions, &triangles);
            let expected = brute_force(&positions, &triangles, &left_out);
            met += expected.len();
            cleared += certified(&positions, &triangles).iter().filter(|&&c| c).count();
            let all = Search::new(&positions, &triangles, &left_out).run(|_| true, &Execution::default());
            assert_eq!(all.unwrap().first, expected, "{seed}");
            let few = |t: usize| t % 40 == 5;
            let some =
                Search::new(&positions, &triangles, &left_out).run(few, &Execution::default()).unwrap();
            let of_few: Vec<_> =
                expected.into_iter().filter(|p| p.iter().any(|&t| few(t as usize))).collect();
            assert_eq!(some.first, of_few, "{seed}");
        }
        assert!(met > 1000 && cleared > 1000, "{met} pairs, {cleared} vertices cleared");
    }

    #[test]
    fn a_search_can_be_stopped() {
        let (positions, triangles) = soup(1, 50, 5);
        let left_out = without_area(&positions, &triangles);
        let execution = Execution::default();
        execution.cancel_flag().store(true, std::sync::atomic::Ordering::Relaxed);
        assert_eq!(Search::new(&positions, &triangles, &left_out).run(|_| true, &execution), Err(Cancelled));
    }
}
