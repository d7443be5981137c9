//! Entries of triangles filed under vertices: the common ground of the edge and the vertex table.
//!
//! Method: vertices are cut into buckets, and each bucket counts, places and sorts its own entries in
//! memory that fits a cache. A bucket reads only those runs of triangles whose vertices reach
//! into it; as meshes are stored layer by layer these are few. Where they are not, buckets are made larger,
//! at the price of fewer parallel tasks. The result does not depend on the buckets.

use std::ops::Range;

use rayon::prelude::*;

/// Triangles in a run (few in tests, as small meshes are to have many) whose span of vertices is known.
const RUN: usize = if cfg!(test) { 1 << 3 } else { 1 << 10 };
/// The smallest bucket, in vertices, as a power of two.
const SHIFT: u32 = if cfg!(test) { 4 } else { 15 };
/// How often each run may be read, on average, before buckets are made larger.
const READS: usize = 6;

/// Up to three entries of each triangle, each under a vertex; ascending as `finish` orders them.
pub(crate) struct Filed<T> {
    shift: u32,
    buckets: Vec<Bucket<T>>,
}

struct Bucket<T> {
    /// `start[k]..start[k + 1]` are the places of the entries under the bucket's k-th vertex.
    start: Vec<usize>,
    entries: Vec<T>,
}

impl<T: Copy + Default + Ord + Send + Sync> Filed<T> {
    /// Files `entries(t, triangle)` of every triangle under vertices below `keys`.
    pub(crate) fn new(
        keys: usize,
        triangles: &[[u32; 3]],
        entries: impl Fn(usize, &[u32; 3]) -> [Option<(u32, T)>; 3] + Sync,
    ) -> Self {
        let spans: Vec<[u32; 2]> = triangles
            .par_chunks(RUN)
            .map(|run| run.iter().flatten().fold([u32::MAX, 0], |[l, h], &v| [l.min(v), h.max(v)]))
            .collect();
        let reads =
            |shift: u32| spans.iter().map(|[l, h]| ((h >> shift) - (l >> shift)) as usize + 1).sum::<usize>();
        let mut shift = SHIFT;
        while keys >> shift > 0 && reads(shift) > READS * spans.len().max(1) {
            shift += 2;
        }
        let bucket = |b: usize| {
            let range = b << shift..((b + 1) << shift).min(keys);
            Bucket::new(range, triangles, &spans, &entries)
        };
        let buckets = (0..keys.div_ceil(1 << shift)).into_par_iter().map(bucket).collect();
        Self { shift, buckets }
    }

    /// The entries under a vertex.
    pub(crate) fn of(&self, key: usize) -> &[T] {
        let bucket = &self.buckets[key >> self.shift];
        let k = key & ((1 << self.shift) - 1);
        &bucket.entries[bucket.start[k]..bucket.start[k + 1]]
    }
}

impl<T: Copy + Default + Ord> Bucket<T> {
    fn new(
        range: Range<usize>,
        triangles: &[[u32; 3]],
        spans: &[[u32; 2]],
        entries: &impl Fn(usize, &[u32; 3]) -> [Option<(u32, T)>; 3],
    ) -> Self {
        let each = |found: &mut dyn FnMut(usize, T)| {
            for (i, [low, high]) in spans.iter().enumerate() {
                if *low as usize >= range.end || (*high as usize) < range.start {
                    continue;
                }
                let run = i * RUN..((i + 1) * RUN).min(triangles.len());
                for (t, triangle) in run.clone().zip(&triangles[run]) {
                    for (key, entry) in entries(t, triangle).into_iter().flatten() {
                        if range.contains(&(key as usize)) {
                            found(key as usize - range.start, entry);
                        }
                    }
                }
            }
        };
        let mut start = vec![0; range.len() + 1];
        each(&mut |k, _| start[k + 1] += 1);
        for k in 0..range.len() {
            start[k + 1] += start[k];
        }
        let mut next = start.clone();
        let mut list = vec![T::default(); start[range.len()]];
        each(&mut |k, entry| {
            list[next[k]] = entry;
            next[k] += 1;
        });
        for ends in start.windows(2) {
            list[ends[0]..ends[1]].sort_unstable();
        }
        Self { start, entries: list }
    }
}
