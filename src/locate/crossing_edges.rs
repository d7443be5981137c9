//! The lattice edges whose ends have different labels, found 64 at a time.

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_those_of_a_search_voxel_by_voxel() {
        // Rows that end before, at and beyond the ends of words; the first bit of a row is the border.
        for (k, x) in [1, 2, 61, 62, 63, 64, 65, 126, 127, 130].into_iter().enumerate() {
            let size = [x, 4, 5];
            let random = |i: usize| (i * 7919 + k * 104_729).wrapping_mul(2_654_435_761) >> 12;
            // Most voxels alike, so that some edges have the same label at both ends.
            let label = |i: usize| if random(i) % 3 == 0 { (random(i / 5) % 5) as u8 } else { 0 };
            let labels: Vec<u8> = (0..size.iter().product()).map(label).collect();
            let (whole, _) = LabelVolume::from_labels(&labels, size).unwrap();
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
