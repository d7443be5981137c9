//! The code bits at a cell's corners, and the walk over the cells of a row that have a crossing.

use super::code_rows::{CodeRow, MAX_PLANES, half_word};
use crate::classify::{LabelVolume, WORD};

/// Cells in a half word: the corners of so many lie in a window of one word.
const HALF: usize = WORD / 2;

/// The codes at a cell's corners: bit c of byte p is bit p of the code at corner c.
#[derive(Debug, Clone, Copy)]
pub(in crate::contour) struct Corners {
    bits: [u8; MAX_PLANES],
    planes: usize,
}

impl Corners {
    /// The code at corner `c`.
    #[inline]
    pub(super) fn code(&self, c: usize) -> u8 {
        (0..self.planes).fold(0, |code, p| code | (self.bits[p] >> c & 1) << p)
    }

    /// The corners whose code differs from that of corner 0, as a bit set, and whether they all
    /// have the same one.
    #[inline]
    pub(super) fn differing(&self) -> (u8, bool) {
        let (mut differ, mut two) = (0u8, true);
        for &bits in &self.bits[..self.planes] {
            // Turned over if corner 0 has the bit.
            let d = bits ^ (bits & 1).wrapping_neg();
            two &= d == 0 || differ == 0 || d == differ;
            differ |= d;
        }
        (differ, two)
    }

    /// The codes at the corners as one number, if they take no more than two bits each.
    pub(super) fn two_planes(&self) -> Option<usize> {
        (self.planes <= 2).then(|| usize::from(self.bits[0]) | usize::from(self.bits[1]) << 8)
    }
}

/// Calls `visit_cell(x, corners)` for the cells of row y of layer z whose bit is set in `active`, ascending.
pub(super) fn visit_cells(
    labels: &LabelVolume,
    [y, z]: [usize; 2],
    active: &[u64],
    mut visit_cell: impl FnMut(usize, Corners),
) {
    // Loops over two or three planes are worth unrolling: up to seven materials.
    match labels.codes().count() {
        0..=2 => visit::<2>(labels, [y, z], active, &mut visit_cell),
        3 => visit::<3>(labels, [y, z], active, &mut visit_cell),
        _ => visit::<MAX_PLANES>(labels, [y, z], active, &mut visit_cell),
    }
}

fn visit<const P: usize>(
    labels: &LabelVolume,
    [y, z]: [usize; 2],
    active: &[u64],
    visit_cell: &mut impl FnMut(usize, Corners),
) {
    let planes = labels.codes().count();
    // In the order of corners: y is bit 1, z is bit 2.
    let mut rows = [[&[] as &[u64]; 4]; P];
    for (k, [y, z]) in [[y, z], [y + 1, z], [y, z + 1], [y + 1, z + 1]].into_iter().enumerate() {
        let row = CodeRow::new(labels, y, z);
        rows.iter_mut().enumerate().take(planes).for_each(|(p, rows)| rows[k] = row.plane(p));
    }
    for (w, &word) in active.iter().enumerate().filter(|(_, word)| **word != 0) {
        for half in [0, 1] {
            let mut cells = word >> (half * HALF) & u64::from(u32::MAX);
            if cells == 0 {
                continue;
            }
            let mut windows = [[0; 4]; P];
            for (window, rows) in windows.iter_mut().zip(&rows).take(planes) {
                window.iter_mut().zip(rows).for_each(|(out, row)| *out = half_word(row, 2 * w + half));
            }
            while cells != 0 {
                let bit = cells.trailing_zeros();
                cells &= cells - 1;
                let mut corners = Corners { bits: [0; MAX_PLANES], planes: P };
                for (bits, window) in corners.bits.iter_mut().zip(&windows) {
                    let [a, b, c, d] = window.map(|word| word >> bit & 3);
                    *bits = (a | b << 2 | c << 4 | d << 6) as u8;
                }
                visit_cell(w * WORD + half * HALF + bit as usize, corners);
            }
        }
    }
}
