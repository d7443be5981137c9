//! Junction cell thinning (Fujimori and Suzuki §3.2), in rounds that look only at the state before
//! them, so that neither threads nor tiling can change the result.
//!
//! A cell whose corners are of one material x and junction *offers* x to its junction corners. In a
//! round every junction voxel takes an offer it has; of several it takes the material whose mean
//! grey value is nearest to its own, then the one with the lower id. When no cell is removable any
//! more, the voxels that are left (the published remarkable cases, where any choice is
//! topologically equivalent) take, by the same rule, a material of a voxel in a cell they share.
//!
//! Departure: the published loop removes one cell at a time, in an order it does not state.
//! Halo: one voxel per round.

use rayon::prelude::*;

use super::bit_planes::{BitPlanes, WORD};
use super::error::ClassifyError;
use crate::execution::Execution;
use crate::material::MaterialTable;
use crate::volume::Sample;

/// What thinning did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Thinned {
    /// Rounds in which cells were removed.
    pub rounds: usize,
    /// Further rounds that settled voxels no removable cell reached.
    pub settling_rounds: usize,
    /// Voxels settled that way.
    pub settled: u64,
}

/// New members of one word: `bits` of row (y, z) go to plane `class`.
struct Change {
    y: usize,
    z: usize,
    word: usize,
    class: usize,
    bits: u64,
}

/// Gives every junction voxel (in none of the planes) a material.
///
/// # Errors
/// [`ClassifyError::NoCore`] if there is no voxel to start from; `radius` goes into its message.
/// [`ClassifyError::Cancelled`] if asked to stop.
pub fn thin<S: Sample>(
    samples: &[S],
    b: &mut BitPlanes,
    junction: &BitPlanes,
    materials: &MaterialTable,
    radius: [f64; 3],
    execution: &Execution,
) -> Result<Thinned, ClassifyError> {
    let size = b.padded().map(|n| n - 2);
    let means: Vec<f32> = materials.materials().iter().map(|m| m.mean as f32).collect();
    let nearest = |x: usize, y: usize, z: usize, classes: &mut dyn Iterator<Item = usize>| {
        let v = samples[((z - 1) * size[1] + y - 1) * size[0] + x - 1].to_f32();
        classes.map(|c| ((v - means[c]).abs(), c)).min_by(|p, q| p.0.total_cmp(&q.0)).map(|(_, c)| c)
    };
    let mut open = junction.clone();
    let is_open = |open: &BitPlanes, (y, z): (usize, usize)| open.row(0, y, z).iter().any(|&w| w != 0);
    let all_rows = || (1..=size[2]).flat_map(|z| (1..=size[1]).map(move |y| (y, z)));
    // The rows that a round looks at: where nothing changed nearby in the round before, nothing can
    // change in this one.
    let mut rows: Vec<(usize, usize)> = all_rows().filter(|&row| is_open(&open, row)).collect();
    let rows_per_slice = size[1] + 2;
    let mut near = vec![false; rows_per_slice * (size[2] + 2)];
    let mut done = Thinned { rounds: 0, settling_rounds: 0, settled: 0 };
    let mut settling = false;
    loop {
        execution.check()?;
        let changes: Vec<Change> = rows
            .par_iter()
            .flat_map_iter(|&(y, z)| row_changes(b, &open, y, z, settling, &nearest))
            .collect();
        if changes.is_empty() {
            rows = all_rows().filter(|&row| is_open(&open, row)).collect();
            if rows.is_empty() {
                return Ok(done);
            }
            if settling {
                return Err(ClassifyError::NoCore { radius });
            }
            settling = true;
            continue;
        }
        for c in &changes {
            b.row_mut(c.class, c.y, c.z)[c.word] |= c.bits;
            open.row_mut(0, c.y, c.z)[c.word] &= !c.bits;
            if settling {
                done.settled += u64::from(c.bits.count_ones());
            }
        }
        if settling {
            done.settling_rounds += 1
        } else {
            done.rounds += 1
        }
        // A settled voxel can make cells removable again.
        settling = false;
        for c in &changes {
            for z in c.z - 1..=c.z + 1 {
                near[z * rows_per_slice + c.y - 1..=z * rows_per_slice + c.y + 1].fill(true);
            }
        }
        rows.clear();
        for (i, near) in near.iter_mut().enumerate().filter(|(_, near)| **near) {
            *near = false;
            let row = (i % rows_per_slice, i / rows_per_slice);
            if is_open(&open, row) {
                rows.push(row);
            }
        }
    }
}

/// The class, of those offered, whose mean is nearest to the grey value of voxel (x, y, z).
type Nearest<'a> = dyn Fn(usize, usize, usize, &mut dyn Iterator<Item = usize>) -> Option<usize> + Sync + 'a;

/// What the open voxels of row (y, z) become in this round.
fn row_changes(
    b: &BitPlanes,
    open: &BitPlanes,
    y: usize,
    z: usize,
    settling: bool,
    nearest: &Nearest<'_>,
) -> Vec<Change> {
    let n = b.count();
    let mut out = Vec::new();
    let mut offers = vec![0u64; n];
    for w in 0..b.words() {
        let here = open.row(0, y, z)[w];
        if here == 0 {
            continue;
        }
        offers.fill(0);
        add_offers(b, y, z, w, settling, &mut offers);
        let (mut one, mut two) = (0, 0);
        for o in &mut offers {
            *o &= here;
            two |= one & *o;
            one |= *o;
        }
        let mut several = two;
        while several != 0 {
            let bit = several.trailing_zeros() as usize;
            several &= several - 1;
            let mut classes = (0..n).filter(|&c| offers[c] >> bit & 1 == 1);
            if let Some(best) = nearest(w * WORD + bit, y, z, &mut classes) {
                for (c, o) in offers.iter_mut().enumerate() {
                    if c != best {
                        *o &= !(1 << bit);
                    }
                }
            }
        }
        let taken = offers.iter().enumerate().filter(|(_, bits)| **bits != 0);
        out.extend(taken.map(|(class, &bits)| Change { y, z, word: w, class, bits }));
    }
    out
}

/// Collects the offers to the voxels of word `w` of row (y, z), a bit set per material.
///
/// In a thinning round an offer comes from a cell whose corners show exactly one material; when
/// settling, from any cell, for every material it shows. Only whole cells count: those that do not
/// reach beyond the volume.
fn add_offers(b: &BitPlanes, y: usize, z: usize, w: usize, settling: bool, offers: &mut [u64]) {
    let padded = b.padded();
    let n = offers.len();
    let mut right = vec![0u64; n];
    let mut left = vec![0u64; n];
    for (cell_y, cell_z) in [(y - 1, z - 1), (y, z - 1), (y - 1, z), (y, z)] {
        let whole = |low: usize, count: usize| low >= 1 && low + 1 < count - 1;
        // A volume one voxel thin has no whole cells; there the flat ones must do.
        if (padded[1] > 3 && !whole(cell_y, padded[1])) || (padded[2] > 3 && !whole(cell_z, padded[2])) {
            continue;
        }
        for i in 0..n {
            let rows =
                [(cell_y, cell_z), (cell_y + 1, cell_z), (cell_y, cell_z + 1), (cell_y + 1, cell_z + 1)];
            let word = |at: usize| rows.iter().fold(0, |any, &(y, z)| any | b.row(i, y, z)[at]);
            let middle = word(w);
            let before = if w > 0 { word(w - 1) >> 63 } else { 0 };
            let after = if w + 1 < b.words() { word(w + 1) << 63 } else { 0 };
            right[i] = middle | middle >> 1 | after;
            left[i] = middle | middle << 1 | before;
        }
        let last = padded[0] - 2;
        let end = |x: usize| if padded[0] > 3 && x / WORD == w { !(1u64 << (x % WORD)) } else { u64::MAX };
        for (cell, whole_cells) in [(&mut right, end(last)), (&mut left, end(1))] {
            let (mut one, mut two) = (0, 0);
            for &shown in cell.iter() {
                two |= one & shown;
                one |= shown;
            }
            for (offer, &shown) in offers.iter_mut().zip(cell.iter()) {
                *offer |= whole_cells & if settling { shown } else { shown & !two };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of voxels: digits are materials, '.' is junction.
    fn planes(rows: &[&str], n: usize) -> (BitPlanes, BitPlanes) {
        let size = [rows[0].len(), rows.len(), 1];
        let mut b = BitPlanes::new(size, n);
        for (y, row) in rows.iter().enumerate() {
            for (x, c) in row.chars().enumerate() {
                if let Some(class) = c.to_digit(10) {
                    b.row_mut(class as usize, y + 1, 1)[(x + 1) / WORD] |= 1 << ((x + 1) % WORD);
                }
            }
        }
        let junction = super::super::pair::junction(&b);
        (b, junction)
    }

    fn text(b: &BitPlanes) -> Vec<String> {
        let [nx, ny, _] = b.padded();
        let class = |x, y| (0..b.count()).find(|&c| b.bit(c, x, y, 1));
        (1..ny - 1)
            .map(|y| (1..nx - 1).map(|x| class(x, y).map_or('.', |c| char::from(b'0' + c as u8))).collect())
            .collect()
    }

    fn thinned(rows: &[&str], grey: &[f32]) -> (Vec<String>, Thinned) {
        let table = MaterialTable::new([("air", 0.0), ("al", 10.0), ("fe", 30.0)]).unwrap();
        let (mut b, junction) = planes(rows, 3);
        let done = thin(grey, &mut b, &junction, &table, [3.0; 3], &Execution::default()).unwrap();
        (text(&b), done)
    }

    #[test]
    fn a_round_looks_only_at_the_state_before_it() {
        // One voxel per side and round; the middle one hears of both and takes the nearer mean.
        let (out, done) = thinned(&["0.....1", "0.....1"], &[6.0; 14]);
        assert_eq!(out, ["0001111", "0001111"]);
        assert_eq!(done.rounds, 3);
        let (out, _) = thinned(&["0.....1", "0.....1"], &[2.0; 14]);
        assert_eq!(out, ["0000111", "0000111"]);
    }

    #[test]
    fn a_remarkable_case_is_settled_by_the_nearest_grey_value() {
        // The published figure 7: no cell is removable, one voxel is left.
        let rows = ["010", "2.2", "010"];
        let (out, done) = thinned(&rows, &[29.0; 9]);
        assert_eq!(out, ["010", "222", "010"]);
        assert_eq!((done.settling_rounds, done.settled), (1, 1));
        assert_eq!(thinned(&rows, &[9.0; 9]).0, ["010", "212", "010"]);
    }

    #[test]
    fn without_any_certain_voxel_there_is_nothing_to_thin() {
        let table = MaterialTable::new([("air", 0.0), ("al", 10.0)]).unwrap();
        let (mut b, junction) = planes(&["...", "..."], 2);
        let out = thin(&[0u8; 6], &mut b, &junction, &table, [3.0; 3], &Execution::default());
        assert!(matches!(out, Err(ClassifyError::NoCore { .. })));
    }
}
