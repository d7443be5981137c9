//! Specks: a few voxels of a material that sites which disagree leave between them, or beside what they say.
//!
//! They would be shells of their own. Where curves have been heard, what hangs together by faces of at most [`MOST`] voxels
//! becomes the material that most of its neighbours have. A true part so small is far below what is safe
//! (`docs/locate.md`).

use rayon::prelude::*;

use crate::classify::{BitPlanes, LabelVolume, WORD};
use crate::grid::MaterialId;

/// Voxels of the largest speck.
const MOST: usize = 4;

/// Removes specks in and beside `zone`, in the slices that `labels` holds.
pub(super) fn remove_specks(labels: &mut LabelVolume, zone: &BitPlanes) {
    let rows = labels.codes().voxel_slices().into_par_iter();
    let height = labels.size()[1];
    let voxels: Vec<[usize; 3]> = rows
        .flat_map_iter(|z| (1..=height).map(move |y| [y, z]))
        .flat_map_iter(|[y, z]| {
            let words = zone.row(0, y, z).iter().enumerate().filter(|(_, word)| **word != 0);
            words.flat_map(move |(w, &word)| {
                (0..WORD).filter(move |bit| word >> bit & 1 == 1).map(move |bit| [w * WORD + bit, y, z])
            })
        })
        .collect();
    settle(labels, &voxels, MOST);
}

/// Removes the specks of up to `most` voxels that these voxels (padded) are of or touch. Every speck is judged by the labels as
/// they were, so the order does not matter.
pub(super) fn settle(labels: &mut LabelVolume, voxels: &[[usize; 3]], most: usize) {
    let before = &*labels;
    let (slices, size) = (before.codes().voxel_slices(), before.size());
    let is_voxel = |v: &[usize; 3]| (0..2).all(|a| (1..=size[a]).contains(&v[a])) && slices.contains(&v[2]);
    let found: Vec<([usize; 3], MaterialId)> = voxels
        .par_iter()
        .flat_map_iter(|&voxel| {
            let all = std::iter::once(voxel).chain(neighbours(voxel));
            let specks = all.filter(is_voxel).filter_map(|at| speck(before, at, most));
            specks
                .flat_map(|(part, material)| part.into_iter().map(move |v| (v, material)))
                .collect::<Vec<_>>()
        })
        .collect();
    for (voxel, material) in found {
        labels.set(voxel, material);
    }
}

fn neighbours([x, y, z]: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    [[x - 1, y, z], [x + 1, y, z], [x, y - 1, z], [x, y + 1, z], [x, y, z - 1], [x, y, z + 1]].into_iter()
}

/// The speck that a voxel (padded) is of, and what it is to become; `None` if it is of none.
fn speck(labels: &LabelVolume, voxel: [usize; 3], most: usize) -> Option<(Vec<[usize; 3]>, MaterialId)> {
    let held = labels.codes().slices();
    let own = labels.at(voxel);
    let mut part = vec![voxel];
    let mut around: Vec<MaterialId> = Vec::new();
    let mut next = 0;
    while next < part.len() {
        for at in neighbours(part[next]) {
            if !held.contains(&at[2]) {
                // It may go on there.
                return None;
            }
            let label = labels.at(at);
            if label != own {
                around.push(label);
            } else if !part.contains(&at) {
                part.push(at);
                if part.len() > most {
                    return None;
                }
            }
        }
        next += 1;
    }
    // The most frequent, of several the lowest; never the world outside.
    around.retain(|m| *m != MaterialId::OUTSIDE);
    around.sort_unstable();
    let commonest = |best: Option<(usize, MaterialId)>, group: &[MaterialId]| {
        best.filter(|b| b.0 >= group.len()).or(Some((group.len(), group[0])))
    };
    let (_, material) = around.chunk_by(|a, b| a == b).fold(None, commonest)?;
    Some((part, material))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specks_go_and_parts_stay() {
        let size = [12, 9, 8];
        let index = |[x, y, z]: [usize; 3]| (z * size[1] + y) * size[0] + x;
        let mut grey = vec![0u8; size.iter().product()];
        for z in 0..8 {
            for y in 0..9 {
                for x in 7..12 {
                    grey[index([x, y, z])] = 1;
                }
            }
        }
        // A single voxel, three in a row, and a part of five.
        for voxel in [[2, 2, 2], [2, 5, 5], [3, 5, 5], [4, 5, 5]] {
            grey[index(voxel)] = 1;
        }
        for x in 1..6 {
            grey[index([x, 7, 2])] = 2;
        }
        let (mut labels, _) = LabelVolume::from_labels(&grey, size).unwrap();
        let mut zone = BitPlanes::window(size, 1, labels.codes().slices());
        let set = |zone: &mut BitPlanes, [x, y, z]: [usize; 3]| {
            zone.row_mut(0, y + 1, z + 1)[(x + 1) / WORD] |= 1 << ((x + 1) % WORD);
        };
        // The first is beside the zone, the second in it, the third far away at one end.
        for voxel in [[3, 2, 2], [3, 5, 5], [1, 7, 2]] {
            set(&mut zone, voxel);
        }
        remove_specks(&mut labels, &zone);
        let at = |[x, y, z]: [usize; 3]| labels.at([x + 1, y + 1, z + 1]).0;
        assert_eq!([at([2, 2, 2]), at([3, 5, 5])], [0, 0]);
        assert_eq!([at([2, 5, 5]), at([4, 5, 5])], [0, 0]);
        assert_eq!([at([1, 7, 2]), at([5, 7, 2]), at([8, 4, 4])], [2, 2, 1]);
    }
}
