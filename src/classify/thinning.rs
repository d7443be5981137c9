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
//! Halo: one voxel per step. A [`Thinning`] of some slices is right, after k steps, in those at
//! least k away from a slice that it would need but does not hold.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::bit_planes::{BitPlanes, WORD};
use super::error::ClassifyError;
use crate::execution::Execution;
use crate::material::MaterialTable;
use crate::volume::{Sample, Slab};

/// What thinning did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Thinned {
    /// Rounds in which cells were removed.
    pub rounds: usize,
    /// Further rounds that settled voxels no removable cell reached.
    pub settling_rounds: usize,
    /// Voxels settled that way.
    pub settled: u64,
}

/// What a step does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Step {
    /// Removes the cells that are removable.
    Thin,
    /// Gives the junction voxels that no removable cell reaches to a neighbour's material. Only
    /// when thinning is at its end in the whole volume, and always followed by thinning.
    Settle,
}

/// New members of one word: `bits` of row (y, z) go to plane `class`.
struct Change {
    y: usize,
    z: usize,
    word: usize,
    class: usize,
    bits: u64,
}

/// Gives every junction voxel (in none of the planes) of a volume a material.
///
/// # Errors
/// [`ClassifyError::NoCore`] if there is no voxel to start from; `radius` goes into its message.
/// [`ClassifyError::Cancelled`] if asked to stop.
pub fn thin<S: Sample>(
    slab: Slab<'_, S>,
    b: &mut BitPlanes,
    junction: &BitPlanes,
    materials: &MaterialTable,
    radius: [f64; 3],
    execution: &Execution,
) -> Result<Thinned, ClassifyError> {
    let all = b.voxel_slices();
    let mut thinning = Thinning::new(slab, b, junction.clone(), materials);
    let mut done = Thinned::default();
    let mut next = Step::Thin;
    loop {
        execution.check()?;
        let changed = thinning.step(next, &all);
        next = match (changed, next) {
            (0, _) if thinning.open_in(&all) == 0 => return Ok(done),
            (0, Step::Thin) => Step::Settle,
            (0, Step::Settle) => return Err(ClassifyError::NoCore { radius }),
            (_, Step::Thin) => {
                done.rounds += 1;
                Step::Thin
            }
            (_, Step::Settle) => {
                done.settling_rounds += 1;
                done.settled += changed;
                // A settled voxel can make cells removable again.
                Step::Thin
            }
        };
    }
}

/// The slices of a volume while they are being thinned.
pub struct Thinning<'a, S> {
    slab: Slab<'a, S>,
    means: Vec<f32>,
    b: &'a mut BitPlanes,
    open: BitPlanes,
    /// The rows with open voxels that the next step looks at, or `None` for all: where nothing changed
    /// nearby in a step, nothing can change in the next one of the same kind.
    front: Option<Vec<(usize, usize)>>,
}

impl<'a, S: Sample> Thinning<'a, S> {
    /// For planes `b` of materials and the voxels `open` that are in none of them, over the same
    /// slices, of which the slab holds the grey values.
    pub fn new(slab: Slab<'a, S>, b: &'a mut BitPlanes, open: BitPlanes, materials: &MaterialTable) -> Self {
        let means = materials.materials().iter().map(|m| m.mean as f32).collect();
        Self { slab, means, b, open, front: None }
    }

    /// The number of voxels without a material in the padded slices `slices`.
    #[must_use]
    pub fn open_in(&self, slices: &Range<usize>) -> u64 {
        self.open.counts_in(slices.clone())[0]
    }

    /// Whether further steps of the same kind can change nothing.
    #[must_use]
    pub fn at_rest(&self) -> bool {
        self.front.as_ref().is_some_and(Vec::is_empty)
    }

    /// Takes a step; returns how many voxels of the padded slices `core` got a material.
    pub fn step(&mut self, kind: Step, core: &Range<usize>) -> u64 {
        let front = match (self.front.take(), kind) {
            (Some(front), Step::Thin) => front,
            _ => self.all_rows(),
        };
        let (b, open) = (&*self.b, &self.open);
        let nearest = |x: usize, y: usize, z: usize, classes: &mut dyn Iterator<Item = usize>| {
            let v = self.slab.grey([x - 1, y - 1, z - 1]);
            let distances = classes.map(|c| ((v - self.means[c]).abs(), c));
            distances.min_by(|p, q| p.0.total_cmp(&q.0)).map(|(_, c)| c)
        };
        let settling = kind == Step::Settle;
        let changes: Vec<Change> = front
            .par_iter()
            .flat_map_iter(|&(y, z)| row_changes(b, open, y, z, settling, &nearest))
            .collect();
        let mut count = 0;
        for c in &changes {
            self.b.row_mut(c.class, c.y, c.z)[c.word] |= c.bits;
            self.open.row_mut(0, c.y, c.z)[c.word] &= !c.bits;
            if core.contains(&c.z) {
                count += u64::from(c.bits.count_ones());
            }
        }
        self.front = Some(self.rows_near(&changes));
        count
    }

    fn is_open(&self, (y, z): (usize, usize)) -> bool {
        self.open.row(0, y, z).iter().any(|&w| w != 0)
    }

    fn all_rows(&self) -> Vec<(usize, usize)> {
        let ys = 1..self.b.padded()[1] - 1;
        let slices = self.open.voxel_slices();
        let rows = slices.into_par_iter().flat_map_iter(|z| ys.clone().map(move |y| (y, z)));
        rows.filter(|&row| self.is_open(row)).collect()
    }

    /// The rows with open voxels that touch a changed one, in order.
    fn rows_near(&self, changes: &[Change]) -> Vec<(usize, usize)> {
        let (rows, slices) = (self.b.padded()[1], self.open.voxel_slices());
        let mut near = vec![false; rows * slices.len()];
        for c in changes {
            for z in (c.z - 1).max(slices.start)..(c.z + 2).min(slices.end) {
                let first = (z - slices.start) * rows + c.y;
                near[first - 1..=first + 1].fill(true);
            }
        }
        let place = |(i, _): (usize, &bool)| (i % rows, slices.start + i / rows);
        near.iter()
            .enumerate()
            .filter(|(_, near)| **near)
            .map(place)
            .filter(|&row| self.is_open(row))
            .collect()
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
        let held = b.slices();
        for i in 0..n {
            let rows =
                [(cell_y, cell_z), (cell_y + 1, cell_z), (cell_y, cell_z + 1), (cell_y + 1, cell_z + 1)];
            let word = |at: usize| {
                let held = rows.iter().filter(|(_, z)| held.contains(z));
                held.fold(0, |any, &(y, z)| any | b.row(i, y, z)[at])
            };
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
        let done =
            thin(Slab::whole(grey, b.size()), &mut b, &junction, &table, [3.0; 3], &Execution::default())
                .unwrap();
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
        let out = thin(
            Slab::whole(&[0u8; 6], b.size()),
            &mut b,
            &junction,
            &table,
            [3.0; 3],
            &Execution::default(),
        );
        assert!(matches!(out, Err(ClassifyError::NoCore { .. })));
    }
}
