//! Self-intersections: every pair of triangles that meets away from what it shares.

use rayon::prelude::*;

use super::size_trees::SizeTrees;
use super::triangle_pair::{folded, touch, touch_beyond_vertex};
use crate::execution::{Cancelled, Execution};
use crate::mesh::window::Window;

/// Asking triangles per parallel task.
const CHUNK: usize = 1 << 12;

/// What a search found.
pub(crate) struct Found {
    /// How many pairs there are.
    pub(crate) count: u64,
    /// The first of them in ascending order, lower triangle first.
    pub(crate) first: Vec<[u32; 2]>,
}

/// All pairs of triangles that meet where they must not, of which the window owns the later one; triangles
/// without area (flagged in `degenerate`) and pairs with the same three vertices are left out: they are
/// other defects. Numbers are local.
pub(crate) fn find(
    window: &Window<'_>,
    degenerate: &[bool],
    keep: usize,
    progress: bool,
    execution: &Execution,
) -> Result<Found, Cancelled> {
    let own = window.own_triangles().start;
    let trees = SizeTrees::new(window.positions(), window.triangles(), |t| !degenerate[t]);
    execution.check()?;
    let portions = trees.askers(CHUNK);
    let stage = progress.then(|| execution.stage("search self-intersections", portions.len() as u64));
    let found = portions
        .into_par_iter()
        .map(|(class, ranks)| {
            execution.check()?;
            let mut found = Found { count: 0, first: Vec::new() };
            trees.visit_overlaps(class, ranks, |t, u| {
                let (t, u) = (t.min(u), t.max(u));
                if u >= own && meet_wrongly(window, t, u) {
                    found.count += 1;
                    found.first.push([t as u32, u as u32]);
                    if found.first.len() >= 2 * keep.max(1 << 10) {
                        keep_lowest(&mut found.first, keep);
                    }
                }
            });
            keep_lowest(&mut found.first, keep);
            if let Some(stage) = &stage {
                stage.advance(1);
            }
            Ok(found)
        })
        .collect::<Result<Vec<_>, Cancelled>>()?;
    let count = found.iter().map(|f| f.count).sum();
    let mut first: Vec<_> = found.into_iter().flat_map(|f| f.first).collect();
    keep_lowest(&mut first, keep);
    Ok(Found { count, first })
}

fn keep_lowest(pairs: &mut Vec<[u32; 2]>, keep: usize) {
    pairs.sort_unstable();
    pairs.truncate(keep);
}

/// Whether triangles `t` and `u` meet anywhere but in the vertices and edges they share.
fn meet_wrongly(window: &Window<'_>, t: usize, u: usize) -> bool {
    let (a, b) = (window.triangles()[t], window.triangles()[u]);
    let shared = |v: u32, other: &[u32; 3]| other.contains(&v);
    let point = |v: u32| window.positions()[v as usize];
    let common: usize = a.iter().filter(|&&v| shared(v, &b)).count();
    match common {
        0 => touch(&a.map(point), &b.map(point)),
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
