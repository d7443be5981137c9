//! Corner partitions: which corners of a cell share a material, whatever the materials are.
//!
//! A partition is written as its *restricted growth string*: corner 0 has class 0, and a class that
//! appears for the first time is one more than all before it. There are 4,140 of them (the eighth
//! Bell number), 128 with at most two classes.

use crate::grid::cube::CORNERS;

/// Number of partitions of eight corners.
pub const PARTITIONS: usize = 4140;

/// The class of each corner.
pub type Classes = [u8; CORNERS];

/// All partitions in lexicographic order, and the way from labels to a partition's index.
#[derive(Debug)]
pub struct Partitions {
    classes: Vec<Classes>,
    /// Index of a partition by the mixed-radix value of its growth string (8! of them).
    by_radix: Vec<u16>,
    /// Index of a two-class partition by the mask of corners that differ from corner 0, halved
    /// (corner 0 itself never differs).
    by_mask: Vec<u16>,
}

/// The growth string of eight labels.
pub(crate) fn classes_of<L: Copy + PartialEq>(labels: &[L; CORNERS]) -> Classes {
    let mut classes = [0; CORNERS];
    let mut count = 1;
    for c in 1..CORNERS {
        classes[c] = match (0..c).find(|&d| labels[d] == labels[c]) {
            Some(d) => classes[d],
            None => {
                count += 1;
                count - 1
            }
        };
    }
    classes
}

/// Mixed-radix value of a growth string: the digit of corner c is at most c.
fn radix(classes: &Classes) -> usize {
    (1..CORNERS).rev().fold(0, |value, c| value * (c + 1) + usize::from(classes[c]))
}

impl Partitions {
    /// Enumerates all partitions.
    #[must_use]
    pub fn new() -> Self {
        let mut classes = Vec::with_capacity(PARTITIONS);
        extend(&mut [0; CORNERS], 1, 0, &mut classes);
        let mut by_radix = vec![u16::MAX; (1..=CORNERS).product()];
        let mut by_mask = vec![u16::MAX; 128];
        for (i, c) in classes.iter().enumerate() {
            by_radix[radix(c)] = i as u16;
            if c.iter().all(|&k| k < 2) {
                let mask =
                    c.iter().enumerate().fold(0usize, |m, (corner, &k)| m | (usize::from(k) << corner));
                by_mask[mask >> 1] = i as u16;
            }
        }
        Self { classes, by_radix, by_mask }
    }

    /// The classes of partition `index`.
    #[must_use]
    pub fn classes(&self, index: usize) -> &Classes {
        &self.classes[index]
    }

    /// The partition of eight labels.
    #[must_use]
    pub fn index<L: Copy + PartialEq>(&self, labels: &[L; CORNERS]) -> usize {
        usize::from(self.by_radix[radix(&classes_of(labels))])
    }

    /// The partition of eight corners with at most two labels; bit c of `mask` says that corner c
    /// has the second one.
    #[must_use]
    pub fn index_of_mask(&self, mask: u8) -> usize {
        let differs = if mask & 1 == 1 { !mask } else { mask };
        usize::from(self.by_mask[usize::from(differs >> 1)])
    }

    /// All partitions, in order of their index.
    pub fn iter(&self) -> impl Iterator<Item = &Classes> {
        self.classes.iter()
    }
}

impl Default for Partitions {
    fn default() -> Self {
        Self::new()
    }
}

fn extend(classes: &mut Classes, corner: usize, highest: u8, out: &mut Vec<Classes>) {
    if corner == CORNERS {
        out.push(*classes);
        return;
    }
    for class in 0..=highest + 1 {
        classes[corner] = class;
        extend(classes, corner + 1, highest.max(class), out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_4140_partitions_and_each_is_found_again() {
        let all = Partitions::new();
        assert_eq!(all.iter().count(), PARTITIONS);
        let at_most = |n: u8| all.iter().filter(|c| c.iter().all(|&k| k < n)).count();
        assert_eq!((at_most(2), at_most(3)), (128, 1094));
        for (i, classes) in all.iter().enumerate() {
            // Other names for the same classes make the same partition.
            let renamed = classes.map(|k| 200 - 7 * k);
            assert_eq!(all.index(classes), i);
            assert_eq!(all.index(&renamed), i);
        }
        for mask in 0..=255u8 {
            let labels: [u8; 8] = std::array::from_fn(|c| (mask >> c) & 1);
            assert_eq!(all.index_of_mask(mask), all.index(&labels));
        }
    }
}
