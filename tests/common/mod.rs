//! What several tests need to run the program and to look at its results.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // helpers of tests are tests; a skip is said aloud

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Runs the program, which must succeed.
pub(crate) fn program(arguments: &[&str]) {
    let run = Command::new(env!("CARGO_BIN_EXE_interfacet")).args(arguments).output().unwrap();
    assert!(run.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&run.stderr));
}

/// A file or folder of the shared data, or `None` (said aloud) where this machine does not have it.
pub(crate) fn shared(name: &str) -> Option<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !path.exists() {
        eprintln!("SKIPPED: {} is not there", path.display());
        return None;
    }
    Some(path.to_str().unwrap().to_owned())
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

/// Extracts `input` with the options `more` (as published, unless they say another accuracy) and, in turn, each of `ways`: all
/// must give the same files, byte for byte.
pub(crate) fn assert_same(input: &str, more: &[&str], ways: &[&[&str]]) {
    let folder = tempfile::tempdir().unwrap();
    let run = |way: &&[&str]| {
        let out = folder.path().join("result");
        let mut arguments = vec!["extract", input, "--out", out.to_str().unwrap()];
        if !more.contains(&"--accuracy") {
            arguments.extend(["--accuracy", "paper"]);
        }
        arguments.extend(more.iter().chain(*way));
        program(&arguments);
        contents(&out)
    };
    let results: Vec<_> = ways.iter().map(run).collect();
    for name in ["assembly.ply", "junctions.vtk", "preview.png", "report.json"] {
        assert!(results[0].contains_key(Path::new(name)), "{name}");
    }
    assert!(results[0].keys().filter(|k| k.starts_with("materials")).count() >= 2);
    for (result, way) in results.iter().zip(ways).skip(1) {
        assert_eq!(result.keys().collect::<Vec<_>>(), results[0].keys().collect::<Vec<_>>());
        for (name, bytes) in result {
            assert!(*bytes == results[0][name], "{} differs with {way:?}", name.display());
        }
    }
}
