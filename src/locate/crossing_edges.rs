//! The lattice edges whose ends have different labels, and the cells where materials meet, found 64 at a time.

use crate::classify::{BitPlanes, LabelVolume, WORD};

/// Calls `visit` with the lower end (in voxels) and the axis of every edge between voxels with different
/// labels whose lower end lies in slice `z`, in the order of y, axis, x.
///
/// # Panics
/// If `labels` do not hold slice z, or the next one if there is one.
pub(super) fn crossing_edges(labels: &LabelVolume, z: usize, mut visit: impl FnMut([usize; 3], usize)) {
    let codes = labels.codes();
    let size = labels.size();
    let pz = z + 1;
    let words = codes.words();
    for y in 0..size[1] {
        let py = y + 1;
        for axis in 0..3 {
            let there = match axis {
                0 => [py, pz],
                1 if py < size[1] => [py + 1, pz],
                2 if pz < size[2] => [py, pz + 1],
                _ => continue,
            };
            for w in 0..words {
                let mut bits = differing(codes, [py, pz], there, axis == 0, w) & codes.voxel_mask(w);
                if axis == 0 {
                    bits &= next_mask(codes, w);
                }
                while bits != 0 {
                    let bit = bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    visit([w * WORD + bit - 1, y, z], axis);
                }
            }
        }
    }
}

/// Voxels whose neighbour along x is a voxel as well.
fn next_mask(codes: &BitPlanes, w: usize) -> u64 {
    let next = if w + 1 < codes.words() { codes.voxel_mask(w + 1) << (WORD - 1) } else { 0 };
    codes.voxel_mask(w) >> 1 | next
}

/// Bits of word `w` whose points differ from those of the other row, or from their neighbours along x.
fn differing(codes: &BitPlanes, here: [usize; 2], there: [usize; 2], along_x: bool, w: usize) -> u64 {
    (0..codes.count()).fold(0, |any, p| {
        let row = codes.row(p, here[0], here[1]);
        let other = if along_x {
            let next = row.get(w + 1).map_or(0, |next| next << (WORD - 1));
            row[w] >> 1 | next
        } else {
            codes.row(p, there[0], there[1])[w]
        };
        any | (row[w] ^ other)
    })
}

/// Bit k: whether the voxel k after `from` along x and its upper neighbour along `axis` have different labels. Beyond the volume
/// lies `OUTSIDE`; of the last bit along x nothing is known.
///
/// # Panics
/// If `labels` do not hold the slices.
pub(super) fn differing_from(labels: &LabelVolume, from: [usize; 3], axis: usize) -> u64 {
    let codes = labels.codes();
    let [x, y, z] = from.map(|c| c + 1);
    let [_, to_y, to_z] = [0, 1, 2].map(|a| from[a] + 1 + usize::from(a == axis));
    (0..codes.count()).fold(0, |any, p| {
        let own = codes.bits_from(p, x, y, z);
        let other = if axis == 0 { own >> 1 } else { codes.bits_from(p, x, to_y, to_z) };
        any | (own ^ other)
    })
}

/// Bit k: whether three labels or more meet in the cell whose lowest voxel is the one k after `low` along x.
///
/// # Panics
/// If `labels` do not hold the slices.
pub(super) fn junction_cells(labels: &LabelVolume, low: [usize; 3]) -> u64 {
    let codes = labels.codes();
    let planes = codes.count();
    let [x, y, z] = low.map(|c| c + 1);
    let corner = |p: usize, c: usize| codes.bits_from(p, x + (c & 1), y + (c >> 1 & 1), z + (c >> 2));
    // The first corner's code, and that of the first corner that differs from it.
    let (mut first, mut other) = ([0; 8], [0; 8]);
    let (mut two, mut three) = (0, 0);
    for (p, first) in first[..planes].iter_mut().enumerate() {
        *first = corner(p, 0);
    }
    for c in 1..8 {
        let mut own = [0; 8];
        let (mut not_first, mut not_other) = (0, 0);
        for p in 0..planes {
            own[p] = corner(p, c);
            not_first |= own[p] ^ first[p];
            not_other |= own[p] ^ other[p];
        }
        three |= two & not_first & not_other;
        let new = not_first & !two;
        for p in 0..planes {
            other[p] |= own[p] & new;
        }
        two |= new;
    }
    three
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// Most voxels alike, so that some edges have the same label at both ends.
    fn volume(size: [usize; 3], seed: usize) -> LabelVolume {
        let random = |i: usize| (i * 7919 + seed * 104_729).wrapping_mul(2_654_435_761) >> 12;
        let label = |i: usize| if random(i) % 3 == 0 { (random(i / 5) % 5) as u8 } else { 0 };
        let labels: Vec<u8> = (0..size.iter().product()).map(label).collect();
        LabelVolume::from_labels(&labels, size).unwrap().0
    }

    #[test]
    fn words_of_edges_and_of_cells_are_those_of_single_voxels() {
        for x in [3, 62, 64, 130] {
            let size = [x, 5, 4];
            let volume = volume(size, x);
            let label = |v: [usize; 3]| volume.at(v.map(|c| c + 1));
            let mut junctions = 0;
            for low in (0..4).flat_map(|z| (0..5).flat_map(move |y| [0, 1, x / 2, x - 1].map(|x| [x, y, z])))
            {
                let wide = (x - low[0]).min(WORD - 1);
                for axis in 0..3 {
                    let bits = differing_from(&volume, low, axis);
                    for k in 0..wide {
                        let from = [low[0] + k, low[1], low[2]];
                        let mut to = from;
                        to[axis] += 1;
                        assert_eq!(bits >> k & 1 == 1, label(from) != label(to), "{from:?} {axis}");
                    }
                }
                let bits = junction_cells(&volume, low);
                for k in 0..wide {
                    let corner = |c: usize| [low[0] + k + (c & 1), low[1] + (c >> 1 & 1), low[2] + (c >> 2)];
                    let met: BTreeSet<_> = (0..8).map(|c| label(corner(c))).collect();
                    assert_eq!(bits >> k & 1 == 1, met.len() > 2, "{low:?} {k}");
                    junctions += usize::from(met.len() > 2);
                }
            }
            assert!(junctions > 0);
        }
    }

    #[test]
    fn edges_are_those_of_a_search_voxel_by_voxel() {
        // Rows that end before, at and beyond the ends of words; the first bit of a row is the border.
        for (k, x) in [1, 2, 61, 62, 63, 64, 65, 126, 127, 130].into_iter().enumerate() {
            let size = [x, 4, 5];
            let whole = volume(size, k);
            let label = |v: [usize; 3]| whole.at(v.map(|c| c + 1));
            // All of the volume, and a window that ends inside: padded slices 2 to 4 are voxels' 1 to 3.
            for (volume, slices) in [(&whole, 0..size[2]), (&whole.window(2..5), 1..3)] {
                for z in slices {
                    let mut found = Vec::new();
                    crossing_edges(volume, z, |from, axis| found.push((from, axis)));
                    let mut expected = Vec::new();
                    for y in 0..size[1] {
                        for axis in 0..3 {
                            for x in 0..size[0] {
                                let (from, mut to) = ([x, y, z], [x, y, z]);
                                to[axis] += 1;
                                if to[axis] < size[axis] && label(from) != label(to) {
                                    expected.push((from, axis));
                                }
                            }
                        }
                    }
                    assert_eq!(found, expected, "size {size:?}, slice {z}");
                }
            }
        }
    }
}
