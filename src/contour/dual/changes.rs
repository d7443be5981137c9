//! What was done to the triangles of a mesh, so that it can be taken back.
//!
//! A *slot* is a triangle's place in the list. A change gives some slots new triangles, all at once, and builds on
//! the changes that made what was in these slots before. So one can be taken back once those that built
//! on it have been, and taking back needs no look at the mesh.

/// No change.
const NONE: u32 = u32::MAX;

/// Changes in the order in which they were made.
#[derive(Debug, Clone)]
pub(super) struct Changes {
    slots: Vec<SlotChange>,
    /// Behind the last slot of each change.
    ends: Vec<u32>,
    /// The latest change of each slot that has not been taken back.
    last: Vec<u32>,
    undone: usize,
}

/// What a change did to one slot.
#[derive(Debug, Clone, Copy)]
struct SlotChange {
    slot: u32,
    before: [u32; 3],
    /// The change before this one in the slot.
    previous: u32,
}

/// The finaliser of the generator splitmix64 (Steele, Lea and Flood 2014): tells changes of equal worth apart.
pub(super) fn mix(mut x: u64) -> u64 {
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

impl Changes {
    /// None yet, of a list with this many slots.
    pub(super) fn new(slots: usize) -> Self {
        Self { slots: Vec::new(), ends: Vec::new(), last: vec![NONE; slots], undone: 0 }
    }

    /// How many changes were made, those taken back counted.
    pub(super) fn made(&self) -> usize {
        self.ends.len()
    }

    /// How many were taken back.
    pub(super) fn undone(&self) -> usize {
        self.undone
    }

    /// Whether a slot holds what a change put there.
    pub(super) fn is_changed(&self, slot: usize) -> bool {
        self.last[slot] != NONE
    }

    /// Puts triangles into slots, as one change.
    pub(super) fn make(
        &mut self,
        triangles: &mut [[u32; 3]],
        new: impl IntoIterator<Item = (u32, [u32; 3])>,
    ) {
        let number = self.ends.len() as u32;
        for (slot, triangle) in new {
            let s = slot as usize;
            let before = std::mem::replace(&mut triangles[s], triangle);
            let previous = std::mem::replace(&mut self.last[s], number);
            self.slots.push(SlotChange { slot, before, previous });
        }
        self.ends.push(self.slots.len() as u32);
    }

    /// Takes back all changes of these slots and, before them, the later ones that built on them: then the
    /// triangles of the slots are what they were at first. `triangles` must be as the changes left them.
    /// Calls `taken` with the number of each, the latest first where they build on each other. Returns the
    /// slots that changed, ascending.
    pub(super) fn undo(
        &mut self,
        triangles: &mut [[u32; 3]],
        slots: impl IntoIterator<Item = u32>,
        mut taken: impl FnMut(u32),
    ) -> Vec<u32> {
        let mut changed = Vec::new();
        for slot in slots {
            while self.last[slot as usize] != NONE {
                self.take_back(triangles, self.last[slot as usize], &mut changed, &mut taken);
            }
        }
        ascending(changed)
    }

    /// The same for the latest change of each slot only.
    pub(super) fn undo_latest(
        &mut self,
        triangles: &mut [[u32; 3]],
        slots: impl IntoIterator<Item = u32>,
        mut taken: impl FnMut(u32),
    ) -> Vec<u32> {
        let mut changed = Vec::new();
        let latest: Vec<(u32, u32)> = slots.into_iter().map(|s| (s, self.last[s as usize])).collect();
        for (slot, change) in latest {
            // It may have gone with another one.
            if change != NONE && self.last[slot as usize] == change {
                self.take_back(triangles, change, &mut changed, &mut taken);
            }
        }
        ascending(changed)
    }

    fn take_back(
        &mut self,
        triangles: &mut [[u32; 3]],
        change: u32,
        changed: &mut Vec<u32>,
        taken: &mut impl FnMut(u32),
    ) {
        // Each change in the stack is later than the one below it.
        let mut stack = vec![change];
        while let Some(&change) = stack.last() {
            let first = change.checked_sub(1).map_or(0, |before| self.ends[before as usize]);
            let own = &self.slots[first as usize..self.ends[change as usize] as usize];
            let last = &self.last;
            if let Some(later) = own.iter().map(|s| last[s.slot as usize]).find(|&l| l != change) {
                stack.push(later);
                continue;
            }
            for s in own {
                triangles[s.slot as usize] = s.before;
                self.last[s.slot as usize] = s.previous;
                changed.push(s.slot);
            }
            self.undone += 1;
            taken(change);
            stack.pop();
        }
    }
}

fn ascending(mut slots: Vec<u32>) -> Vec<u32> {
    slots.sort_unstable();
    slots.dedup();
    slots
}
