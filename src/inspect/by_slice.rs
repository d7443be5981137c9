//! Which triangles (or segments) reach into which slice of the volume.

use std::ops::Range;

/// For each slice of a volume, the things that overlap it, ascending.
pub(super) struct BySlice {
    /// Where each slice's list begins, and the end of the last.
    starts: Vec<usize>,
    list: Vec<u32>,
}

impl BySlice {
    /// Of things given by their lowest and highest z in voxels; slice k goes from `k - 0.5 - reach` to
    /// `k + 0.5 + reach`.
    pub(super) fn new(slices: usize, reach: f64, things: impl Iterator<Item = [f64; 2]> + Clone) -> Self {
        let range = |[low, high]: [f64; 2]| -> Range<usize> {
            let first = (low + 0.5 - reach).floor().max(0.0) as usize;
            let end = (high + 0.5 + reach).floor() + 1.0;
            first..(end.max(0.0) as usize).min(slices)
        };
        let mut starts = vec![0; slices + 1];
        for thing in things.clone() {
            range(thing).for_each(|k| starts[k + 1] += 1);
        }
        for k in 0..slices {
            starts[k + 1] += starts[k];
        }
        let mut next = starts.clone();
        let mut list = vec![0; starts[slices]];
        for (i, thing) in things.enumerate() {
            for k in range(thing) {
                list[next[k]] = i as u32;
                next[k] += 1;
            }
        }
        Self { starts, list }
    }

    /// Those of a slice.
    pub(super) fn of(&self, slice: usize) -> &[u32] {
        &self.list[self.starts[slice]..self.starts[slice + 1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn things_are_listed_in_every_slice_that_they_reach() {
        let things = [[-0.4, 0.4], [0.4, 1.6], [9.0, 9.0]];
        let index = BySlice::new(3, 0.0, things.into_iter());
        assert_eq!((index.of(0), index.of(1), index.of(2)), (&[0, 1][..], &[1][..], &[1][..]));
        let wide = BySlice::new(3, 1.0, things.into_iter());
        assert_eq!((wide.of(1), wide.of(2)), (&[0, 1][..], &[1][..]));
    }
}
