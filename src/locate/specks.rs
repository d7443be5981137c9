//! Specks and islands: voxels of a material that sites which disagree, or speak where they should not, leave between them
//! or beside what they say. They would be shells of their own.
//!
//! *Specks* are up to [`MOST`] voxels that hang together by faces: they become the material that most of their neighbours
//! have. A true part so small is far below what is safe (`docs/locate.md`). *Islands* are larger, within a box
//! of [`FAR`] voxels about their first or last voxel, and were no part of their own before curves were heard: they are new,
//! or cut off from something larger. No model has looked for a part there (thin parts are labelled before), so what curves
//! said of them and around them is taken back; what is an island still becomes what is around it.

use rayon::prelude::*;

use crate::classify::{BitPlanes, LabelVolume, WORD, set_bits};
use crate::grid::MaterialId;

/// Voxels of the largest speck.
pub(super) const MOST: usize = 4;
/// An island's voxels are no farther than this from its first or its last voxel along any axis, voxels.
pub(super) const FAR: usize = 8;
/// What was no farther than this before was a part of its own.
const WAS: usize = 12;
/// Rounds of taking back, which may leave other islands, and of filling.
const ROUNDS: [bool; 3] = [true, false, false];

/// Removes specks and islands in and beside `zone`, in the slices that `labels` holds; `before` are the labels before curves
/// were heard.
pub(super) fn remove_specks(labels: &mut LabelVolume, before: &LabelVolume, zone: &BitPlanes) {
    for take_back in ROUNDS {
        let now = &*labels;
        // A part's first and last voxel differ from three neighbours on one side.
        let is_end = |[a, b, c, d, e, f]: [u64; 6]| a & c & e | b & d & f;
        let mut found: Vec<Part> =
            about(now, zone, is_end).into_par_iter().filter_map(|voxel| island(now, before, voxel)).collect();
        if found.is_empty() {
            break;
        }
        found.par_sort_unstable();
        found.dedup();
        if take_back {
            for voxel in found.iter().flat_map(|(part, _)| part).flat_map(|v| around(*v)) {
                if is_voxel(labels, &voxel) {
                    let was = before.at(voxel);
                    labels.set(voxel, was);
                }
            }
        } else {
            apply(labels, found);
        }
    }
    let borders = about(labels, zone, |differ| differ.into_iter().fold(0, |any, word| any | word));
    settle(labels, &borders);
}

/// The voxels (padded) in `zone` or beside it that `wanted` picks, told for a word of voxels at a time which differ from their
/// neighbour at the lower and the upper side along x, y and z.
fn about(labels: &LabelVolume, zone: &BitPlanes, wanted: impl Fn([u64; 6]) -> u64 + Sync) -> Vec<[usize; 3]> {
    let codes = labels.codes();
    let held = codes.slices();
    let row = |[y, z]: [usize; 2]| {
        let beside = [[y - 1, z], [y + 1, z], [y, z - 1], [y, z + 1]];
        let beside = beside.map(|[y, z]| held.contains(&z).then_some([y, z]));
        let own = zone.row(0, y, z);
        let spoken = |w: usize| {
            let others = beside.iter().flatten().map(|&[y, z]| zone.row(0, y, z)[w]);
            let [left, right] = neighbours_in_row(own, w);
            others.fold(own[w] | left | right, |any, word| any | word)
        };
        let differ = |w: usize| {
            let mut differ = [0u64; 6];
            for p in 0..codes.count() {
                let own = codes.row(p, y, z);
                let across = beside.map(|at| at.map_or(own[w], |[y, z]| codes.row(p, y, z)[w]));
                let sides = neighbours_in_row(own, w).into_iter().chain(across);
                differ.iter_mut().zip(sides).for_each(|(differ, side)| *differ |= own[w] ^ side);
            }
            differ
        };
        let mut out = Vec::new();
        for w in 0..codes.words() {
            let spoken = spoken(w) & codes.voxel_mask(w);
            if spoken != 0 {
                let found = spoken & wanted(differ(w));
                out.extend(set_bits(found).map(|bit| [w * WORD + bit, y, z]));
            }
        }
        out
    };
    codes
        .voxel_slices()
        .into_par_iter()
        .flat_map_iter(|z| (1..=labels.size()[1]).map(move |y| [y, z]))
        .flat_map_iter(row)
        .collect()
}

/// A word of a row as seen from one voxel farther on, and from one before.
fn neighbours_in_row(row: &[u64], w: usize) -> [u64; 2] {
    let before = if w > 0 { row[w - 1] >> (WORD - 1) } else { 0 };
    let behind = row.get(w + 1).map_or(0, |next| next << (WORD - 1));
    [row[w] << 1 | before, row[w] >> 1 | behind]
}

/// Voxels that hang together (padded), and what they are to become.
pub(super) type Part = (Vec<[usize; 3]>, MaterialId);

fn apply(labels: &mut LabelVolume, found: Vec<Part>) {
    for (part, material) in found {
        for voxel in part {
            labels.set(voxel, material);
        }
    }
}

/// Removes the specks that these voxels (padded) are of or touch. Every speck is judged by the labels as
/// they were, so the order does not matter.
pub(super) fn settle(labels: &mut LabelVolume, voxels: &[[usize; 3]]) {
    let found = specks(labels, voxels);
    apply(labels, found);
}

/// The specks that these voxels (padded) are of or touch; some more than once.
pub(super) fn specks(labels: &LabelVolume, voxels: &[[usize; 3]]) -> Vec<Part> {
    let around = |voxel: &[usize; 3]| -> Vec<Part> {
        touched(labels, *voxel).filter_map(|at| speck(labels, at)).collect()
    };
    voxels.par_iter().flat_map_iter(around).collect()
}

/// Whether a place (padded) is a voxel that is held.
fn is_voxel(labels: &LabelVolume, v: &[usize; 3]) -> bool {
    let size = labels.size();
    (0..2).all(|a| (1..=size[a]).contains(&v[a])) && labels.codes().voxel_slices().contains(&v[2])
}

/// A voxel and those that it shares faces with.
fn touched(labels: &LabelVolume, voxel: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    std::iter::once(voxel).chain(neighbours(voxel)).filter(|v| is_voxel(labels, v))
}

fn neighbours([x, y, z]: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    [[x - 1, y, z], [x + 1, y, z], [x, y - 1, z], [x, y + 1, z], [x, y, z - 1], [x, y, z + 1]].into_iter()
}

/// A voxel and the 26 around it.
fn around([x, y, z]: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..27).map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1])
}

/// The voxels (ascending) that hang together with `from` and have its label, if they are all held and within `far` (at most [`WAS`])
/// of `middle` along each axis.
fn part_within(
    labels: &LabelVolume,
    from: [usize; 3],
    middle: [usize; 3],
    far: usize,
) -> Option<Vec<[usize; 3]>> {
    let side = 2 * far + 1;
    let held = labels.codes().slices();
    let own = labels.at(from);
    let mut seen = [0u64; (2 * WAS + 1).pow(3).div_ceil(64)];
    let mut mark = |v: &[usize; 3]| -> Option<bool> {
        let [x, y, z]: [usize; 3] = std::array::from_fn(|a| (v[a] + far).wrapping_sub(middle[a]));
        if x.max(y).max(z) >= side {
            return None;
        }
        let index = (z * side + y) * side + x;
        let is_new = seen[index / 64] >> (index % 64) & 1 == 0;
        seen[index / 64] |= 1 << (index % 64);
        Some(is_new)
    };
    mark(&from)?;
    let (mut part, mut open) = (Vec::with_capacity(64), Vec::with_capacity(64));
    part.push(from);
    open.push(from);
    // Depth first: what is large is soon left.
    while let Some(voxel) = open.pop() {
        for at in neighbours(voxel) {
            if !held.contains(&at[2]) {
                return None;
            }
            if labels.at(at) == own && mark(&at)? {
                part.push(at);
                open.push(at);
            }
        }
    }
    part.sort_unstable();
    Some(part)
}

/// The island whose first or last voxel this is (padded), and what is around it.
fn island(labels: &LabelVolume, before: &LabelVolume, voxel: [usize; 3]) -> Option<Part> {
    let own = labels.at(voxel);
    let part = part_within(labels, voxel, voxel, FAR)?;
    let was_there = |at: &[usize; 3]| before.at(*at) == own && part_within(before, *at, voxel, WAS).is_some();
    if part.iter().any(was_there) {
        return None;
    }
    let beside = part.iter().flat_map(|v| neighbours(*v)).map(|at| labels.at(at)).filter(|m| *m != own);
    let material = commonest(beside.collect())?;
    Some((part, material))
}

/// The most frequent, of several the lowest; never the world outside.
fn commonest(mut all: Vec<MaterialId>) -> Option<MaterialId> {
    all.retain(|m| *m != MaterialId::OUTSIDE);
    all.sort_unstable();
    let more = |best: Option<(usize, MaterialId)>, group: &[MaterialId]| {
        best.filter(|b| b.0 >= group.len()).or(Some((group.len(), group[0])))
    };
    all.chunk_by(|a, b| a == b).fold(None, more).map(|b| b.1)
}

/// The speck that a voxel (padded) is of, and what it is to become; `None` if it is of none.
fn speck(labels: &LabelVolume, voxel: [usize; 3]) -> Option<Part> {
    // Asked for every voxel of a border: nothing is allocated for those that are of no speck.
    let held = labels.codes().slices();
    let own = labels.at(voxel);
    let mut part = [voxel; MOST];
    let mut around = [MaterialId::OUTSIDE; 6 * MOST];
    let (mut count, mut beside, mut next) = (1, 0, 0);
    while next < count {
        for at in neighbours(part[next]) {
            if !held.contains(&at[2]) {
                // It may go on there.
                return None;
            }
            let label = labels.at(at);
            if label != own {
                around[beside] = label;
                beside += 1;
            } else if !part[..count].contains(&at) {
                *part.get_mut(count)? = at;
                count += 1;
            }
        }
        next += 1;
    }
    commonest(around[..beside].to_vec()).map(|material| (part[..count].to_vec(), material))
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
        let before = labels.clone();
        remove_specks(&mut labels, &before, &zone);
        let at = |[x, y, z]: [usize; 3]| labels.at([x + 1, y + 1, z + 1]).0;
        assert_eq!([at([2, 2, 2]), at([3, 5, 5])], [0, 0]);
        assert_eq!([at([2, 5, 5]), at([4, 5, 5])], [0, 0]);
        assert_eq!([at([1, 7, 2]), at([5, 7, 2]), at([8, 4, 4])], [2, 2, 1]);
    }
    #[test]
    fn islands_are_taken_back_and_parts_that_were_there_stay() {
        let size = [30, 20, 20];
        let ball = |v: [usize; 3], centre: [usize; 3], squared: usize| {
            (0..3).map(|a| v[a].abs_diff(centre[a]).pow(2)).sum::<usize>() <= squared
        };
        let volume = |label: &dyn Fn([usize; 3]) -> u8| {
            let all = (0..size.iter().product::<usize>())
                .map(|i| [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])]);
            let grey: Vec<u8> = all.map(label).collect();
            LabelVolume::from_labels(&grey, size).unwrap().0
        };
        // A wall; a ball that was there, and now is smaller; a rod of the wall's, now cut; one that is new.
        let wall = |v: [usize; 3]| v[0] >= 26;
        let rod = |v: [usize; 3]| v[0] >= 17 && ball([0, v[1], v[2]], [0, 5, 14], 3);
        let before = volume(&|v| if ball(v, [6, 6, 6], 12) { 2 } else { u8::from(wall(v) || rod(v)) });
        let mut labels = volume(&|v| {
            let is_cut = rod(v) && v[0] != 23;
            if ball(v, [6, 6, 6], 9) { 2 } else { u8::from(wall(v) || is_cut || ball(v, [15, 14, 5], 8)) }
        });
        let mut zone = BitPlanes::window(size, 1, labels.codes().slices());
        for (z, y, x) in (0..20).flat_map(|z| (0..20).flat_map(move |y| (3..25).map(move |x| (z, y, x)))) {
            zone.row_mut(0, y + 1, z + 1)[(x + 1) / WORD] |= 1 << ((x + 1) % WORD);
        }
        remove_specks(&mut labels, &before, &zone);
        let at = |[x, y, z]: [usize; 3]| labels.at([x + 1, y + 1, z + 1]).0;
        assert_eq!([at([6, 6, 6]), at([6, 6, 9]), at([15, 14, 5])], [2, 2, 0]);
        assert_eq!([at([18, 5, 14]), at([23, 5, 14]), at([26, 5, 14])], [1, 1, 1]);
    }
}
