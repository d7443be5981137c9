//! The same input gives the same files, byte for byte, whatever the number of threads.

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

/// Four materials that meet in curves and points.
const PHANTOM: &str = "four-materials";
