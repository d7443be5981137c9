//! Pieces of surface, made from the slices at hand and merged, are the surface made at once, bit for bit.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::ops::Range;

use interfacet::classify::{BitPlanes, LabelVolume};
use interfacet::contour::marching::{march, march_pieces};
use interfacet::contour::{Border, ContourError, CrossingRule, Midpoints, Patch, Piece, Thresholds, merge};
use interfacet::execution::Execution;
use interfacet::material::MaterialTable;
use interfacet::volume::Slab;
use proptest::prelude::*;

fn mix(mut h: u64, values: &[usize]) -> u64 {
    for &v in values {
        h = (h ^ v as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
        h ^= h >> 32;
    }
    h.wrapping_mul(0xD6E8_FEB8_6659_FD93) >> 20
}

/// A volume of random lumps with grey values that mostly, but not always, suit their labels.
struct Block {
    size: [usize; 3],
    labels: LabelVolume,
    greys: Vec<u16>,
    junction: BitPlanes,
    materials: MaterialTable,
}

impl Block {
    fn new(size: [usize; 3], materials: u64, smooth: usize, seed: u64) -> Option<Self> {
        let at = |i: usize| [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])];
        let label = |i: usize| (mix(seed, &at(i).map(|v| v >> smooth)) % materials) as u8;
        let labels: Vec<u8> = (0..size.iter().product()).map(label).collect();
        let noise = |i: usize| (mix(seed ^ 1, &[i]) % 1200) as u16;
        let greys = labels.iter().enumerate().map(|(i, &l)| u16::from(l) * 1000 + noise(i)).collect();
        let (volume, found) = LabelVolume::from_labels(&labels, size).ok()?;
        let table = found.iter().map(|l| (format!("m{l}"), 1000.0 * l + 600.0));
        let mut junction = BitPlanes::new(size, 1);
        junction.fill_slices(|z, mut slice| {
            for y in 1..=size[1] {
                let sparse = |w: usize| mix(seed, &[w, y, z]) & mix(seed ^ 2, &[w, y, z]);
                slice.row(0, y).iter_mut().enumerate().for_each(|(w, word)| *word = sparse(w));
            }
        });
        Some(Self { size, labels: volume, greys, junction, materials: MaterialTable::new(table).unwrap() })
    }

    /// Calls `work` with the labels and the rule of the padded planes `planes` only.
    fn part<T>(&self, planes: Range<usize>, work: impl FnOnce(&LabelVolume, &Thresholds<'_, u16>) -> T) -> T {
        let slice = self.size[0] * self.size[1];
        let voxels = planes.start.max(1)..planes.end.min(self.size[2] + 1);
        let samples = &self.greys[(voxels.start - 1) * slice..(voxels.end - 1) * slice];
        let junction = self.junction.clone().moved(voxels.clone());
        let slab = Slab::new(samples, self.size, voxels.start - 1);
        work(&self.labels.window(planes), &Thresholds::new(slab, &junction, &self.materials))
    }
}

fn pieces(
    labels: &LabelVolume,
    rule: &impl CrossingRule,
    border: Border,
    layers: Range<usize>,
    max_triangles: usize,
) -> Vec<Piece> {
    let mut out = Vec::new();
    let mut emit = |piece| {
        out.push(piece);
        Ok::<(), ContourError>(())
    };
    march_pieces(labels, rule, border, layers, max_triangles, &Execution::default(), &mut emit).unwrap();
    out
}

fn assert_same(merged: &Piece, whole: &Patch) {
    let bits = |patch: &Patch| patch.positions.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
    assert_eq!(bits(&merged.patch), bits(whole));
    assert!(merged.patch == *whole);
    assert_eq!(merged.owned, whole.positions.len());
    assert!(merged.seam_below.is_empty() && merged.seam_above.is_empty());
}

/// Cuts 0..end at some of the places in `cuts`.
fn runs(end: usize, cuts: u64) -> Vec<Range<usize>> {
    let mut ends: Vec<usize> = (1..end).filter(|z| cuts >> (z % 64) & 1 == 1).chain([0, end]).collect();
    ends.sort_unstable();
    ends.windows(2).map(|w| w[0]..w[1]).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn merged_pieces_are_the_whole_surface(
        size in [1usize..9, 1usize..9, 1usize..14],
        wide: bool,
        materials in 2u64..9,
        smooth in 0usize..3,
        max_triangles in 1usize..3000,
        seed: u64,
        cuts: u64,
    ) {
        let size = if wide { [size[0] + 58, size[1], size[2]] } else { size };
        let Some(block) = Block::new(size, materials, smooth, seed) else { return Ok(()) };
        let layers = size[2] + 1;
        for border in [Border::Closed, Border::Open] {
            let all = 0..size[2] + 2;
            let by_threshold = block.part(all, |labels, rule| march(labels, rule, border, &Execution::default()));
            let by_midpoint = march(&block.labels, &Midpoints, border, &Execution::default());
            let [mut thresholds, mut midpoints] = [Vec::new(), Vec::new()];
            for run in runs(layers, cuts) {
                block.part(run.start..run.end + 1, |labels, rule| {
                    thresholds.extend(pieces(labels, rule, border, run.clone(), max_triangles));
                    midpoints.extend(pieces(labels, &Midpoints, border, run.clone(), max_triangles));
                });
            }
            let within = |p: &Piece| p.layers.len() == 1 || p.patch.triangles.len() <= max_triangles;
            prop_assert!(thresholds.iter().all(within));
            for piece in &thresholds {
                let [v, t] = piece.last_layer;
                let earlier = piece.patch.triangles[..t].iter().flatten();
                // What earlier layers share with the last one lies in its lower plane.
                let z = (piece.layers.end - 1) as f32 - 1.0;
                prop_assert!(earlier.into_iter().all(|&i| (i as usize) < v || piece.patch.positions[i as usize][2] <= z));
            }
            // Merging pairs first makes no difference.
            let pairs = thresholds.chunks(2).map(|two| merge(two.to_vec()).unwrap());
            assert_same(&merge(pairs).unwrap(), by_threshold.as_ref().unwrap());
            assert_same(&merge(midpoints).unwrap(), by_midpoint.as_ref().unwrap());
        }
    }
}

#[test]
fn pieces_that_do_not_fit_are_refused_and_named() {
    let block = Block::new([6, 6, 9], 3, 1, 5).unwrap();
    let other = Block::new([6, 6, 9], 3, 1, 6).unwrap();
    let rule = Midpoints;
    let made =
        |block: &Block, layers| pieces(&block.labels, &rule, Border::Closed, layers, usize::MAX).remove(0);
    let (low, high) = (made(&block, 0..4), made(&block, 4..10));
    assert!(merge([low.clone(), high.clone()]).is_ok());
    let refused = |a: &Piece, b: &Piece| merge([a.clone(), b.clone()]).unwrap_err();
    assert!(matches!(refused(&low, &made(&block, 5..10)), ContourError::PiecesApart { end: 4, start: 5 }));
    let error = refused(&low, &made(&other, 4..10));
    assert!(matches!(error, ContourError::SeamDiffers { layer: 4, .. }));
    assert!(error.to_string().contains("of the padded lattice"), "{error}");
    let mut moved = high.clone();
    moved.patch.positions[0][0] += 0.25;
    assert!(matches!(refused(&low, &moved), ContourError::SeamMoved { layer: 4, .. }));
    let mut damaged = high.clone();
    damaged.patch.triangles[0] = [u32::MAX; 3];
    assert!(matches!(refused(&low, &damaged), ContourError::BrokenPiece { layer: 4 }));
    let part = block.labels.window(3..7);
    let mut emit = |_| Ok::<(), ContourError>(());
    let missing = march_pieces(&part, &rule, Border::Closed, 3..7, 100, &Execution::default(), &mut emit);
    assert!(matches!(missing, Err(ContourError::MissingPlanes { needed: [3, 7], held: [3, 6] })));
}

#[test]
fn an_error_of_the_receiver_ends_the_work() {
    let block = Block::new([20, 20, 20], 4, 0, 5).unwrap();
    let mut received = 0;
    let mut emit = |_| {
        received += 1;
        if received == 3 { Err("full".to_owned()) } else { Ok(()) }
    };
    struct Message(String);
    impl From<ContourError> for Message {
        fn from(error: ContourError) -> Self {
            Self(error.to_string())
        }
    }
    let mut emit = |piece| emit(piece).map_err(Message);
    let layers = 0..21;
    let end =
        march_pieces(&block.labels, &Midpoints, Border::Open, layers, 1, &Execution::default(), &mut emit);
    assert!(end.is_err_and(|Message(text)| text == "full"));
    assert_eq!(received, 3);
}
