//! Without simplification, dual contouring has one polygon for each voxel face between unlike voxels: the
//! numbers of the report against a count that knows nothing of contouring.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // helpers of tests are tests; a skip is said aloud

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use interfacet::report::RunReport;
use interfacet::volume::{OpenOptions, open};

/// Number of polygons of each pair, as the ids of the material behind and of the one in front.
type Counts = BTreeMap<[u8; 2], u64>;

/// What stands for the world beyond the volume.
const OUTSIDE: u8 = 255;

/// Faces between unlike voxels, and those of material (not 0, the background) on the volume's border.
/// `labels` are the ids of materials, x fastest.
fn unlike_faces(labels: &[u8], size: [usize; 3]) -> Counts {
    let mut counts = Counts::new();
    let at = |[x, y, z]: [usize; 3]| labels[x + size[0] * (y + size[1] * z)];
    for z in 0..size[2] {
        for y in 0..size[1] {
            for x in 0..size[0] {
                let here = [x, y, z];
                for axis in 0..3 {
                    let mut next = here;
                    next[axis] += 1;
                    let (a, last) = (at(here), next[axis] == size[axis]);
                    let b = if last { OUTSIDE } else { at(next) };
                    let faces = [(a, b), (a, OUTSIDE)];
                    // The second: the voxel at the low end has a face on the border, too.
                    for (a, b) in faces.into_iter().take(1 + usize::from(here[axis] == 0)) {
                        let pair = if b == OUTSIDE { [a, b] } else { [a.max(b), a.min(b)] };
                        if a != b && pair != [0, OUTSIDE] {
                            *counts.entry(pair).or_default() += 1;
                        }
                    }
                }
            }
        }
    }
    counts
}

/// Crossings and polygons of each pair, as `report.json` has them.
fn reported(input: &Path, more: &[&str]) -> [Counts; 2] {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("result");
    let run = Command::new(env!("CARGO_BIN_EXE_interfacet"))
        .arg("extract")
        .arg(input)
        .arg("--out")
        .arg(&out)
        .args(["--labels", "--method", "dual", "--tolerance", "-1", "--check", "topology"])
        .args(more)
        .output()
        .unwrap();
    let report: RunReport = serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    // Where noise is cut open, two corners of a shell may touch in a vertex (marching leaves such vertices, too). There
    // are no other defects, and with a closed border none.
    let touching = report.defects.non_manifold_vertices.count;
    assert_eq!(report.unexpected_defects, touching, "{more:?}");
    assert!(touching == 0 || more.contains(&"open"), "{more:?}: {touching}");
    assert_eq!(run.status.success(), touching == 0, "{more:?}");
    let dual = report.dual.unwrap();
    assert!(dual.nodes.pseudo_leaf == 0 && dual.collapses.made == 0 && dual.deviation.is_none(), "{dual:?}");
    let ids = |p: interfacet::Pair| [p.back().0, p.front().0];
    let crossings = dual.polygons.iter().map(|p| (ids(p.pair), p.crossings)).collect();
    [crossings, dual.polygons.iter().map(|p| (ids(p.pair), p.polygons)).collect()]
}

/// Pseudo-random, the same everywhere.
fn mix(seed: u64, i: usize) -> u64 {
    let h = (seed ^ i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
    (h ^ h >> 32).wrapping_mul(0xD6E8_FEB8_6659_FD93) >> 24
}

#[test]
fn faces_are_counted_right() {
    // 2 beside 1 beside 0, along x; the last has no faces towards the outside.
    let counts = unlike_faces(&[2, 1, 0], [3, 1, 1]);
    let expected = [([1, 0], 1), ([2, 1], 1), ([1, OUTSIDE], 4), ([2, OUTSIDE], 5)];
    assert_eq!(counts, expected.into_iter().collect());
}

#[test]
fn random_labels_have_a_polygon_for_each_face_between_unlike_voxels() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("labels.raw");
    // Over one root of 32 cells and over several; any two of the materials touch.
    for (seed, size, materials) in [(1, [9, 7, 8], 4), (2, [40, 6, 35], 3), (3, [12, 11, 10], 7)] {
        let voxels = size.iter().product();
        let labels: Vec<u8> = (0..voxels).map(|i| (mix(seed, i / 2) % materials) as u8).collect();
        std::fs::write(&input, &labels).unwrap();
        let mut expected = unlike_faces(&labels, size);
        let [x, y, z] = size;
        let layout = format!("{x},{y},{z}");
        let raw = ["--size", &layout, "--type", "u8", "--spacing", "0.3,0.2,0.5"];
        for open in [false, true] {
            if open {
                expected.retain(|pair, _| pair[1] != OUTSIDE);
            }
            let border = ["--border", if open { "open" } else { "closed" }];
            let [crossings, polygons] = reported(&input, &[&raw[..], &border].concat());
            assert_eq!(crossings, expected, "seed {seed} {border:?}");
            assert_eq!(polygons, expected, "seed {seed} {border:?}");
        }
    }
}

#[test]
fn a_woven_composite_has_a_polygon_for_each_face_between_unlike_voxels() {
    let input = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/weave/small_weave_tag.tif");
    if !input.exists() {
        eprintln!("SKIPPED: {} is not there", input.display());
        return;
    }
    let source = open(&input, &OpenOptions::default()).unwrap();
    let size = source.geometry().size();
    let samples = source.read(&interfacet::grid::VoxelBox::whole(size)).unwrap();
    // Its labels are 0, 1 and 2: those of the materials.
    let labels: Vec<u8> = (0..samples.len()).map(|i| samples.get(i) as u8).collect();
    let expected = unlike_faces(&labels, size);
    let [crossings, polygons] = reported(&input, &[]);
    assert_eq!(crossings, expected);
    assert_eq!(polygons, expected);
    for (pair, count) in [([1, 0], 176_984), ([2, 0], 63_954), ([2, 1], 85_659)] {
        assert_eq!(polygons.get(&pair), Some(&count), "{pair:?}");
    }
}
