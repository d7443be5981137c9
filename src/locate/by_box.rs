//! Things found by place: which of those put in before may be near.

use std::collections::BTreeMap;

use glam::DVec3;

/// Things at places (voxels), each of a kind, by boxes.
#[derive(Debug)]
pub(super) struct ByBox<K, T> {
    side: f64,
    boxes: BTreeMap<([i32; 3], K), Vec<T>>,
}

impl<K: Ord + Copy, T: Copy> ByBox<K, T> {
    /// None yet; boxes of edge `side`.
    pub(super) fn new(side: f64) -> Self {
        Self { side, boxes: BTreeMap::new() }
    }

    fn box_of(&self, at: DVec3) -> [i32; 3] {
        (at / self.side).floor().as_ivec3().to_array()
    }

    /// Adds one.
    pub(super) fn insert(&mut self, kind: K, at: DVec3, thing: T) {
        self.boxes.entry((self.box_of(at), kind)).or_default().push(thing);
    }

    /// All of a kind that are within a box's edge of a place, and some that are farther; always in the same order.
    pub(super) fn near(&self, kind: K, at: DVec3) -> impl Iterator<Item = T> {
        let [x, y, z] = self.box_of(at);
        let around = (0..27).map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
        around.filter_map(move |key| self.boxes.get(&(key, kind))).flatten().copied()
    }
}
