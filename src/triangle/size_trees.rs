//! Finds all pairs of triangles whose boxes overlap, however uneven the triangles are in size.
//!
//! Method: triangles are put into classes by the longest side of their box, a factor of eight wide;
//! each class is sorted along a Morton curve and gets an implicit binary tree of boxes over leaves of
//! [`LEAF`] triangles. Each triangle asks the tree of its own class and the trees of all *smaller*
//! classes. So large triangles never inflate the boxes that small ones have to visit, and a large
//! slanted triangle discards subtrees that lie off its plane. In their own class, triangles ask in
//! groups of neighbours along the curve, which walk the tree once together.
//!
//! Guarantee: every pair of triangles that have a point in common is visited, once. Boxes are f32
//! rounded outwards. Not guaranteed: that visited pairs do meet; that is for exact predicates.

use std::ops::Range;

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

/// Triangles per leaf: 4 and 8 took the same time on a million triangles, 2 took more.
const LEAF: usize = 4;
/// Triangles that walk the tree of their own class together, a multiple of [`LEAF`].
const GROUP: usize = 16;
/// Classes at most; the last one takes everything smaller.
const CLASSES: usize = 8;

/// The lowest and the highest coordinates of points; infinite for none.
pub(super) fn bounds(positions: &[DVec3]) -> (DVec3, DVec3) {
    positions
        .par_chunks(1 << 14)
        .map(|c| c.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), &p| (l.min(p), h.max(p))))
        .reduce(|| (DVec3::INFINITY, DVec3::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// An axis-aligned box, closed.
#[derive(Debug, Clone, Copy)]
struct Aabb {
    low: Vec3A,
    high: Vec3A,
}

impl Aabb {
    const EMPTY: Self = Self { low: Vec3A::INFINITY, high: Vec3A::NEG_INFINITY };

    fn join(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    fn overlaps(&self, other: &Self) -> bool {
        (self.low.cmple(other.high) & other.low.cmple(self.high)).all()
    }
}

/// One class: its triangles along the Morton curve and the tree over them.
struct Tree {
    order: Vec<u32>,
    boxes: Vec<Aabb>,
    /// Heap order, root at 1; the leaves are the last `leaves` nodes, of which those past the end
    /// of the list are empty.
    nodes: Vec<Aabb>,
    leaves: usize,
}

/// The trees of a mesh; see the module header.
pub(crate) struct SizeTrees<'a> {
    positions: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    /// Taken off coordinates before rounding to f32, so that far origins cost no precision.
    centre: DVec3,
    trees: Vec<Tree>,
}

impl<'a> SizeTrees<'a> {
    /// Trees over the triangles that `keep` accepts.
    pub(crate) fn new(
        positions: &'a [DVec3],
        triangles: &'a [[u32; 3]],
        keep: impl Fn(usize) -> bool + Sync,
    ) -> Self {
        let (low, high) = bounds(positions);
        let centre = if positions.is_empty() { DVec3::ZERO } else { low * 0.5 + high * 0.5 };
        let mut this = Self { positions, triangles, centre, trees: Vec::new() };
        // Class by exponent of the longest side, in steps of three (a factor of eight).
        let exponent = |t: usize| {
            let b = this.box_of(t);
            ((b.high - b.low).max_element().max(f32::MIN_POSITIVE).to_bits() >> 23) as i32
        };
        let kept = || (0..triangles.len()).into_par_iter().filter(|&t| keep(t));
        let largest = kept().map(exponent).max().unwrap_or(0);
        let scale = this.morton_scale(low, high);
        let mut keyed: Vec<(u64, u32)> = kept()
            .map(|t| {
                let class = (((largest - exponent(t)) / 3) as u64).min(CLASSES as u64 - 1);
                let b = this.box_of(t);
                (class << 60 | morton(((b.low + b.high) * 0.5).as_dvec3() * scale), t as u32)
            })
            .collect();
        keyed.par_sort_unstable();
        let trees = keyed
            .chunk_by(|a, b| a.0 >> 60 == b.0 >> 60)
            .map(|class| this.tree(class.par_iter().map(|&(_, t)| t).collect()))
            .collect();
        this.trees = trees;
        this
    }

    fn morton_scale(&self, low: DVec3, high: DVec3) -> f64 {
        // Centred coordinates become -2^19..2^19.
        let extent = (high - low).max_element();
        if extent > 0.0 { f64::from(1 << 20) / extent } else { 0.0 }
    }

    fn box_of(&self, t: usize) -> Aabb {
        let [a, b, c] = self.triangles[t].map(|v| self.positions[v as usize] - self.centre);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let down = |v: f64| (v as f32).next_down();
        let up = |v: f64| (v as f32).next_up();
        Aabb {
            low: Vec3A::new(down(low.x), down(low.y), down(low.z)),
            high: Vec3A::new(up(high.x), up(high.y), up(high.z)),
        }
    }

    fn tree(&self, order: Vec<u32>) -> Tree {
        let boxes: Vec<Aabb> = order.par_iter().map(|&t| self.box_of(t as usize)).collect();
        let leaves = order.len().div_ceil(LEAF).next_power_of_two();
        let mut nodes = vec![Aabb::EMPTY; 2 * leaves];
        let join = |boxes: &[Aabb]| boxes.iter().fold(Aabb::EMPTY, |a, &b| a.join(b));
        for (leaf, boxes) in boxes.chunks(LEAF).enumerate() {
            nodes[leaves + leaf] = join(boxes);
        }
        for node in (1..leaves).rev() {
            nodes[node] = nodes[2 * node].join(nodes[2 * node + 1]);
        }
        Tree { order, boxes, nodes, leaves }
    }

    /// The triangles that ask, in portions of `size` of one class: (class, ranks in it).
    pub(crate) fn askers(&self, size: usize) -> Vec<(usize, Range<usize>)> {
        let portions = |(class, tree): (usize, &Tree)| {
            let n = tree.order.len();
            (0..n).step_by(size).map(move |first| (class, first..(first + size).min(n))).collect::<Vec<_>>()
        };
        self.trees.iter().enumerate().flat_map(portions).collect()
    }

    /// Calls `visit(t, u)` for every triangle `t` of this class and of these ranks and every triangle `u` that
    /// it is responsible for and whose box overlaps its own.
    pub(crate) fn visit_overlaps(
        &self,
        class: usize,
        ranks: Range<usize>,
        mut visit: impl FnMut(usize, usize),
    ) {
        let own = &self.trees[class];
        let mut leaves = Vec::new();
        for first in ranks.clone().step_by(GROUP) {
            let group = first..(first + GROUP).min(ranks.end);
            let all = own.boxes[group.clone()].iter().fold(Aabb::EMPTY, |a, &b| a.join(b));
            leaves.clear();
            own.leaves(&all, first, |_| true, |leaf| leaves.push(leaf));
            for rank in group {
                let (t, query) = (own.order[rank] as usize, own.boxes[rank]);
                for &leaf in &leaves {
                    if own.nodes[own.leaves + leaf].overlaps(&query) {
                        own.leaf(leaf, &query, rank + 1, |u| visit(t, u as usize));
                    }
                }
                if class + 1 < self.trees.len() {
                    let slab = Slab::of(self.triangles[t].map(|v| self.positions[v as usize] - self.centre));
                    for smaller in &self.trees[class + 1..] {
                        let found = |leaf| smaller.leaf(leaf, &query, 0, |u| visit(t, u as usize));
                        smaller.leaves(&query, 0, |b| slab.may_meet(b), found);
                    }
                }
            }
        }
    }
}

impl Tree {
    /// Calls `found` for the leaves that reach rank `first` or beyond and whose boxes overlap `query`.
    fn leaves(
        &self,
        query: &Aabb,
        first: usize,
        admit: impl Fn(&Aabb) -> bool,
        mut found: impl FnMut(usize),
    ) {
        // A node at depth d of a tree of 2^h leaves spans ranks; subtrees wholly before `first`
        // are skipped, which makes each pair of a class come up once.
        let mut stack = [0usize; 64];
        let mut top = 1;
        stack[0] = 1;
        let height = self.leaves.trailing_zeros();
        while top > 0 {
            top -= 1;
            let node = stack[top];
            let depth = node.ilog2();
            let past = ((node + 1) << (height - depth)) - self.leaves;
            if past * LEAF <= first || !self.nodes[node].overlaps(query) || !admit(&self.nodes[node]) {
                continue;
            }
            if node >= self.leaves {
                found(node - self.leaves);
            } else {
                stack[top] = 2 * node + 1;
                stack[top + 1] = 2 * node;
                top += 2;
            }
        }
    }

    /// Calls `found` for the triangles of a leaf from rank `first` on whose boxes overlap `query`.
    fn leaf(&self, leaf: usize, query: &Aabb, first: usize, mut found: impl FnMut(u32)) {
        for rank in (leaf * LEAF).max(first)..((leaf + 1) * LEAF).min(self.order.len()) {
            if self.boxes[rank].overlaps(query) {
                found(self.order[rank]);
            }
        }
    }
}

/// The plane of a triangle, thickened by a bound on rounding.
struct Slab {
    normal: DVec3,
    offset: f64,
    slack: f64,
}

impl Slab {
    fn of([a, b, c]: [DVec3; 3]) -> Self {
        let normal = (b - a).cross(c - a);
        // Generous against rounding: in the normal (products of lengths), the offset and the boxes.
        let reach = a.abs().max(b.abs()).max(c.abs()).max_element();
        let sides = (b - a).abs().max((c - a).abs()).max_element();
        Self { normal, offset: normal.dot(a), slack: 1e-13 * sides * sides * (reach + sides) }
    }

    fn may_meet(&self, b: &Aabb) -> bool {
        let (low, high) = (b.low.as_dvec3(), b.high.as_dvec3());
        let (centre, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let distance = (self.normal.dot(centre) - self.offset).abs();
        let apart = distance > self.normal.abs().dot(half) * (1.0 + 1e-12) + self.slack;
        !apart // admits whatever overflowed to something that is not a number
    }
}

/// Interleaves 20 bits of each coordinate, given in -2^19..2^19.
fn morton(p: DVec3) -> u64 {
    let spread = |v: f64| {
        let mut x = (v + f64::from(1 << 19)).clamp(0.0, f64::from((1 << 20) - 1)) as u64;
        x = (x | x << 32) & 0x001f_0000_0000_ffff;
        x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn all_overlaps_are_visited_once_for_very_uneven_triangles() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for i in 0..600u32 {
            let size = 10f64.powi(-((i % 5) as i32));
            let at = DVec3::new(rng.random(), rng.random(), rng.random()) + 1000.0;
            for _ in 0..3 {
                let d = DVec3::new(rng.random(), rng.random(), rng.random());
                positions.push(at + (d - 0.5) * size);
            }
            triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
        }
        let trees = SizeTrees::new(&positions, &triangles, |_| true);
        let mut seen = std::collections::HashMap::new();
        for (class, ranks) in trees.askers(100) {
            trees.visit_overlaps(class, ranks, |t, u| {
                *seen.entry((t.min(u), t.max(u))).or_insert(0) += 1;
            });
        }
        assert!(seen.values().all(|&n| n == 1));
        for t in 0..600usize {
            for u in t + 1..600 {
                let c = |t: usize| triangles[t].map(|v| positions[v as usize]);
                if crate::triangle::triangle_pair::touch(&c(t), &c(u)) {
                    assert!(seen.contains_key(&(t, u)), "{t} {u}");
                }
            }
        }
    }
}
