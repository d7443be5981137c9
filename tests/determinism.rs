//! The same input gives the same files, byte for byte, whatever the number of threads.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // helpers of tests are tests; a skip is said aloud

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

fn program(arguments: &[&str]) {
    let run = Command::new(env!("CARGO_BIN_EXE_interfacet")).args(arguments).output().unwrap();
    assert!(run.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&run.stderr));
}

/// The files of a folder and those below it by name; of the report all but what the run cost.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut out = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(at) = open.pop() {
        for entry in std::fs::read_dir(at).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
                continue;
            }
            let mut bytes = std::fs::read(&path).unwrap();
            if path.file_name().unwrap() == "report.json" {
                let mut report: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
                assert!(report.as_object_mut().unwrap().remove("costs").is_some());
                bytes = report.to_string().into_bytes();
            }
            out.insert(path.strip_prefix(folder).unwrap().to_owned(), bytes);
        }
    }
    out
}

fn assert_same(input: &str, more: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let results = ["1", "2", "8", "8"].map(|threads| {
        let out = folder.path().join("result");
        let mut arguments = vec!["extract", input, "--threads", threads, "--out", out.to_str().unwrap()];
        arguments.extend(more);
        program(&arguments);
        contents(&out)
    });
    for name in ["assembly.ply", "junctions.vtk", "preview.png", "report.json"] {
        assert!(results[0].contains_key(Path::new(name)), "{name}");
    }
    assert!(results[0].keys().filter(|k| k.starts_with("materials")).count() >= 4);
    for result in &results[1..] {
        assert_eq!(result.keys().collect::<Vec<_>>(), results[0].keys().collect::<Vec<_>>());
        for (name, bytes) in result {
            assert!(*bytes == results[0][name], "{} differs", name.display());
        }
    }
}

#[test]
fn an_engine_is_the_same_with_any_number_of_threads() {
    let input = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data/engine/engine.mha");
    if !input.exists() {
        eprintln!("SKIPPED: {} is not there", input.display());
        return;
    }
    assert_same(input.to_str().unwrap(), &["--roi", "40:200,40:220,1:80"]);
}

#[test]
fn a_phantom_is_the_same_with_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("phantom.mha");
    let input = input.to_str().unwrap();
    program(&["phantom", PHANTOM, "--out", input]);
    assert_same(input, &["--count", "4"]);
}

/// Four materials that meet in curves and points.
const PHANTOM: &str = "four-materials";
