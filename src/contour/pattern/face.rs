//! The curves on a cell's face, resolved by the face's four corners alone, so that the two cells
//! that share it always agree.
//!
//! Going round the face, the four corners show one of fifteen patterns: AAAA has no curve; AAAB
//! and AABB have one segment; AABC has a star of three spokes; ABCD a star of four; ABAC two
//! segments that cut off B and C; ABAB two segments, and one bit says which diagonal stays joined.

use super::partition::Classes;
use crate::grid::cube::{edge_between, face_ring};

/// The curves on one face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaceCurves {
    /// One material.
    None,
    /// One segment between the crossings on two ring edges.
    One([usize; 2]),
    /// Two segments between ring edges.
    Two([[usize; 2]; 2]),
    /// A star: spokes from a face node to the crossings on three ring edges. The material that
    /// has two neighbouring corners spans the ring edge that is missing.
    Triple([usize; 3]),
    /// A star with a spoke to each ring edge.
    Quadruple,
}

/// The corners of face `f` counter-clockwise seen from *outside* the cell. Ring edge k runs from
/// corner k to corner k + 1.
#[must_use]
pub fn outward_ring(f: usize) -> [usize; 4] {
    let [a, b, c, d] = face_ring(f);
    // `face_ring` is counter-clockwise about the positive axis for x and z, clockwise for y.
    let counter_clockwise_from_above = f / 2 != 1;
    let seen_from_above = f & 1 == 1;
    if counter_clockwise_from_above == seen_from_above { [a, b, c, d] } else { [a, d, c, b] }
}

/// The cell edges along the outward ring of face `f`.
#[must_use]
pub fn ring_edges(f: usize) -> [usize; 4] {
    let ring = outward_ring(f);
    std::array::from_fn(|k| edge_between(ring[k], ring[(k + 1) % 4]))
}

/// Whether face `f` shows ABAB, so that a bit must say which diagonal is joined.
#[must_use]
pub fn is_ambiguous(classes: &Classes, f: usize) -> bool {
    let [a, b, c, d] = face_ring(f).map(|corner| classes[corner]);
    a == c && b == d && a != b
}

/// The curves on face `f`. For an ambiguous face, `join_first` says that the diagonal through the
/// face's lowest corner is joined (its other two corners are cut off).
#[must_use]
pub fn curves(classes: &Classes, f: usize, join_first: bool) -> FaceCurves {
    let ring = outward_ring(f).map(|corner| classes[corner]);
    let crossed: Vec<usize> = (0..4).filter(|&k| ring[k] != ring[(k + 1) % 4]).collect();
    // The segment that cuts off corner k joins the ring edges before and after it.
    let cut_off = |k: usize| [(k + 3) % 4, k];
    match crossed[..] {
        [] => FaceCurves::None,
        [e, g] => FaceCurves::One([e, g]),
        [e, g, h] => FaceCurves::Triple([e, g, h]),
        _ if ring[0] == ring[2] && ring[1] == ring[3] => {
            // Entry 0 of every ring is the face's lowest corner.
            if join_first {
                FaceCurves::Two([cut_off(1), cut_off(3)])
            } else {
                FaceCurves::Two([cut_off(0), cut_off(2)])
            }
        }
        _ if ring[0] == ring[2] => FaceCurves::Two([cut_off(1), cut_off(3)]),
        _ if ring[1] == ring[3] => FaceCurves::Two([cut_off(0), cut_off(2)]),
        _ => FaceCurves::Quadruple,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    /// The label pairs along the curves as seen from one cell, in terms of lattice positions: for
    /// every curve piece its two ends (as face-plane edge positions, or the node) and labels.
    fn seen(labels: [u8; 4], f: usize, join_low: bool) -> Vec<String> {
        let ring = face_ring(f);
        let mut classes = [0u8; 8];
        // The other four corners do not matter; give them something different.
        for (c, class) in classes.iter_mut().enumerate() {
            *class = 50 + c as u8;
        }
        for k in 0..4 {
            classes[ring[k]] = labels[k];
        }
        let out = outward_ring(f);
        let position = |corner: usize| ring.iter().position(|&r| r == corner).unwrap();
        let name = |k: usize| {
            let mut ends = [position(out[k]), position(out[(k + 1) % 4])];
            ends.sort_unstable();
            format!("{ends:?}")
        };
        let mut pieces: Vec<String> = match curves(&classes, f, join_low) {
            FaceCurves::None => vec![],
            FaceCurves::One([a, b]) => vec![[name(a), name(b)]],
            FaceCurves::Two(s) => s.iter().map(|[a, b]| [name(*a), name(*b)]).collect(),
            FaceCurves::Triple(s) => s.iter().map(|a| [name(*a), "node".into()]).collect(),
            FaceCurves::Quadruple => (0..4).map(|a| [name(a), "node".into()]).collect(),
        }
        .into_iter()
        .map(|mut ends| {
            ends.sort();
            ends.join(" - ")
        })
        .collect();
        pieces.sort();
        pieces
    }

    #[test]
    fn all_fifteen_face_patterns_agree_from_both_sides() {
        let mut patterns = HashMap::new();
        for code in 0..256usize {
            let labels: [u8; 4] = std::array::from_fn(|k| ((code >> (2 * k)) & 3) as u8);
            let canonical: Vec<usize> =
                labels.iter().map(|l| labels.iter().position(|m| m == l).unwrap()).collect();
            for axis in 0..3 {
                for join in [false, true] {
                    let below = seen(labels, 2 * axis + 1, join);
                    let above = seen(labels, 2 * axis, join);
                    assert_eq!(below, above, "labels {labels:?} axis {axis}");
                    patterns.entry((canonical.clone(), axis, join)).or_insert(below);
                }
            }
        }
        assert_eq!(patterns.len(), 15 * 3 * 2);
    }
}
