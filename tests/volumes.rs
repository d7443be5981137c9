//! Real volumes, as they come: sizes, types, spacings and statistics that are known otherwise.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // helpers of tests, like the tests themselves

use std::path::{Path, PathBuf};

use interfacet::grid::VoxelBox;
use interfacet::volume::{OpenOptions, SampleType, Samples, VolumeSource, open};

/// The shared data, or `None` (said aloud) where this machine does not have it.
fn data(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if path.exists() {
        return Some(path);
    }
    eprintln!("SKIPPED: {} is not there", path.display());
    None
}

fn opened(name: &str, spacing: Option<[f64; 3]>) -> Option<Box<dyn VolumeSource>> {
    let path = data(name)?;
    Some(open(&path, &OpenOptions { raw: None, spacing }).unwrap_or_else(|error| panic!("{error}")))
}

fn bytes(source: &dyn VolumeSource) -> Vec<u8> {
    match source.read_all().unwrap() {
        Samples::U8(values) => values,
        other => panic!("{:?}", other.sample_type()),
    }
}

fn expect(source: &dyn VolumeSource, size: [usize; 3], spacing: [f64; 3]) {
    assert_eq!(source.geometry().size(), size);
    assert_eq!(source.sample_type(), SampleType::U8);
    for (got, want) in source.geometry().spacing().into_iter().zip(spacing) {
        assert!((got - want).abs() < 1e-12, "{got} {want}");
    }
}

fn most_frequent(values: &[u8], from: u8, to: u8) -> u8 {
    let mut counts = [0_usize; 256];
    values.iter().for_each(|v| counts[usize::from(*v)] += 1);
    (from..=to).max_by_key(|v| counts[usize::from(*v)]).unwrap_or(from)
}

#[test]
fn the_engine_is_read_and_its_padding_is_what_the_readme_says() {
    let Some(engine) = opened("engine/engine.mha", None) else { return };
    expect(engine.as_ref(), [256, 256, 108], [1.0; 3]);
    let values = bytes(engine.as_ref());
    assert!((130..=150).contains(&most_frequent(&values, 60, 200)), "aluminium is near 140");
    assert_eq!(values.iter().max(), Some(&255));

    let Some(padded) = opened("engine/engine_padded.mha", None) else { return };
    expect(padded.as_ref(), [256, 256, 128], [1.0; 3]);
    let all = bytes(padded.as_ref());
    assert_eq!(&all[..values.len()], &values[..]);
    let stray: Vec<usize> = (values.len()..all.len()).filter(|&i| all[i] != 0).collect();
    assert_eq!(stray, [all.len() - 1], "one stray voxel at (255, 255, 127)");
}

#[test]
fn the_tooth_and_the_teapot_are_read_and_a_part_is_the_part_of_the_whole() {
    let Some(tooth) = opened("tooth/tooth.nrrd", None) else { return };
    expect(tooth.as_ref(), [103, 94, 161], [1.0; 3]);
    let values = bytes(tooth.as_ref());
    let peaks =
        [most_frequent(&values, 60, 120), most_frequent(&values, 140, 190), most_frequent(&values, 210, 250)];
    for (peak, known) in peaks.into_iter().zip([77, 163, 234]) {
        assert!(peak.abs_diff(known) <= 3, "peaks at {peaks:?}");
    }
    let Some(teapot) = opened("teapot/teapot.nrrd", None) else { return };
    expect(teapot.as_ref(), [256, 256, 178], [1.0; 3]);
    let all = bytes(teapot.as_ref());
    let part = VoxelBox { low: [100, 50, 170], high: [103, 52, 172] };
    let mut wanted = Vec::new();
    for z in 170..172 {
        for y in 50..52 {
            wanted.extend_from_slice(&all[(z * 256 + y) * 256 + 100..][..3]);
        }
    }
    assert_eq!(teapot.read(&part).unwrap(), Samples::U8(wanted));
}

#[test]
fn the_slices_of_the_switch_are_one_volume() {
    let Some(switch) = opened("switch/slices", Some([0.092; 3])) else { return };
    expect(switch.as_ref(), [164, 164, 486], [0.092; 3]);
    assert!(switch.notes().iter().any(|note| note.contains("0.092")));
    let values = bytes(switch.as_ref());
    assert_eq!(most_frequent(&values, 0, 255), 96, "air");
    let metal = values.iter().filter(|v| **v >= 140).count();
    assert!((10_000..2_000_000).contains(&metal), "{metal} voxels of metal");
}

#[test]
fn the_weave_is_read_and_its_labels_touch_as_often_as_known() {
    let Some(weave) = opened("weave/small_weave.tif", None) else { return };
    expect(weave.as_ref(), [150; 3], [1.0; 3]);
    bytes(weave.as_ref());
    let Some(labels) = opened("weave/small_weave_tag.tif", None) else { return };
    expect(labels.as_ref(), [150; 3], [1.0; 3]);
    let labels = bytes(labels.as_ref());
    // Faces between unlike voxels, counted independently: any slip in rows or pages changes them.
    let mut faces = [[0_usize; 3]; 3];
    for (i, &here) in labels.iter().enumerate() {
        let at = [i % 150, i / 150 % 150, i / 22_500];
        for (axis, step) in [1, 150, 22_500].into_iter().enumerate() {
            if at[axis] < 149 {
                let there = labels[i + step];
                faces[usize::from(here.min(there))][usize::from(here.max(there))] += 1;
            }
        }
    }
    assert_eq!([faces[0][1], faces[0][2], faces[1][2]], [176_984, 63_954, 85_659]);
}

#[test]
fn the_frog_has_its_own_spacing_and_its_labels() {
    let Some(frog) = opened("frog/frog_labels.mha", None) else { return };
    expect(frog.as_ref(), [500, 470, 136], [1.0, 1.0, 1.5]);
    let values = bytes(frog.as_ref());
    let mut present = [false; 256];
    values.iter().for_each(|v| present[usize::from(*v)] = true);
    let labels = present.iter().filter(|p| **p).count();
    assert!((26..=27).contains(&labels), "{labels} labels");
    let Some(given) = opened("frog/frog_labels.mha", Some([0.5, 0.5, 0.5])) else { return };
    assert!(
        given.notes().iter().any(|note| note.contains("0.5 x 0.5 x 0.5") && note.contains("1 x 1 x 1.5"))
    );
}
