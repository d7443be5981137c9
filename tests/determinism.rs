//! The same input gives the same files, byte for byte, whatever the number of threads; with local models, which look
//! far beyond their slices, for any slabs as well.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use common::{assert_same, program, shared};

const THREADS: [&[&str]; 4] = [&["--threads", "1"], &["--threads", "2"], &["-j8"], &["-j8"]];

#[test]
fn an_engine_is_the_same_with_any_number_of_threads() {
    let Some(input) = shared("engine/engine.mha") else { return };
    assert_same(&input, &["--roi", "40:200,40:220,1:80"], &THREADS);
}

#[test]
fn a_phantom_is_the_same_with_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("phantom.mha");
    let input = input.to_str().unwrap();
    program(&["phantom", PHANTOM, "--out", input]);
    assert_same(input, &["--count", "4"], &THREADS);
}

#[test]
fn a_dual_surface_is_the_same_with_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("phantom.mha");
    let input = input.to_str().unwrap();
    program(&["phantom", PHANTOM, "--out", input]);
    let threads: [&[&str]; 5] =
        [&["--threads", "1"], &["--threads", "2"], &["--threads", "3"], &["-j8"], &["-j8"]];
    assert_same(input, &["--count", "4", "--method", "dual"], &threads);
    assert_same(input, &["--count", "4", "--method", "dual", "--target-triangles", "5000"], &threads[..3]);
    if let Some(input) = shared("engine/engine.mha") {
        assert_same(&input, &["--method", "dual", "--roi", "40:200,40:220,1:80"], &threads[..3]);
    }
}

#[test]
fn models_are_the_same_with_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("phantom.mha");
    let input = input.to_str().unwrap();
    program(&["phantom", PHANTOM, "--size", "48", "--fill", "0.85", "--out", input]);
    let full = ["--count", "4", "--accuracy", "full"];
    assert_same(input, &full, &THREADS[..3]);
    assert_same(input, &[&full[..], &["--method", "dual"]].concat(), &THREADS[..3]);
}

/// Curves, corners and points where four materials meet, models everywhere: whatever the models of a slab read beyond it
/// must be there. Spacings differ, so that the blur's axes do.
#[test]
fn models_are_the_same_in_slabs() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("phantom.mha");
    let input = input.to_str().unwrap();
    let ways: [&[&str]; 5] = [
        &[],
        &["--slab", "1", "--threads", "1"],
        &["--slab", "7", "--threads", "3"],
        &["--slab", "20", "--threads", "2"],
        &["--slab", "34"],
    ];
    for (scene, ways) in [(PHANTOM, &ways[..]), ("press-fit-ring", &ways[..3])] {
        let size = ["--size", "48,44,60", "--spacing", "0.3,0.3,0.25", "--fill", "0.85", "--out", input];
        program(&[&["phantom", scene][..], &size].concat());
        assert_same(input, &["--accuracy", "full"], ways);
        assert_same(input, &["--accuracy", "full", "--method", "dual"], &ways[..3]);
    }
}

/// Levels from places all over the volume, labels from seeds beside the slab.
#[test]
fn thin_parts_are_the_same_in_slabs() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("phantom.mha");
    let input = input.to_str().unwrap();
    let ways: [&[&str]; 3] = [&[], &["--slab", "1", "--threads", "1"], &["--slab", "13", "--threads", "3"]];
    for scene in [&["thin-layer", "--thickness", "2.5"][..], &["pores"]] {
        let size = ["--size", "56,52,60", "--fill", "0.85", "--out", input];
        program(&[&["phantom"], scene, &size].concat());
        assert_same(input, &["--accuracy", "full"], &ways);
    }
}

/// Four materials that meet in curves and points.
const PHANTOM: &str = "four-materials";
