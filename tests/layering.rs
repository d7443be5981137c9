//! Holds the layers of `docs/architecture.md`: a file uses its own folder and the layers above it in
//! the list, never one below.

use std::path::{Path, PathBuf};

/// From the top (used by all) to the bottom (uses all). A file alone is a layer of its own.
const LAYERS: [&str; 15] = [
    "execution",
    "grid",
    "triangle",
    "volume",
    "material",
    "classify",
    "contour",
    "locate",
    "mesh",
    "export",
    "phantom",
    "inspect",
    "pipeline",
    "report",
    "cli",
];

fn rust_files(folder: &Path, out: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(folder).expect("src").map(|e| e.expect("entry").path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            rust_files(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// The layers that a file names as `crate::LAYER`, also inside braces.
fn named(text: &str) -> Vec<&'static str> {
    let code: String =
        text.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
    let mut out = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        let names: Vec<&str> = match rest.strip_prefix('{') {
            Some(list) => list.split('}').next().unwrap_or("").split(',').map(str::trim).collect(),
            None => vec![rest],
        };
        for name in names {
            let word: String = name.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            out.extend(LAYERS.iter().filter(|layer| **layer == word));
        }
    }
    out
}

#[test]
fn no_file_uses_a_layer_below_its_own() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&src, &mut files);
    let place = |layer: &str| LAYERS.iter().position(|l| *l == layer);
    let (mut wrong, mut seen) = (Vec::new(), vec![false; LAYERS.len()]);
    for file in &files {
        let inside = file.strip_prefix(&src).expect("in src");
        let first = inside.iter().next().and_then(|c| c.to_str()).unwrap_or("");
        let layer = first.trim_end_matches(".rs");
        if ["lib", "main"].contains(&layer) {
            continue;
        }
        let Some(own) = place(layer) else {
            wrong.push(format!("{}: '{layer}' is not in the list of layers", inside.display()));
            continue;
        };
        seen[own] = true;
        let text = std::fs::read_to_string(file).expect("readable");
        for used in named(&text) {
            if place(used) > Some(own) {
                wrong.push(format!("{} uses {used}, which is below {layer}", inside.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen.iter().all(|s| *s), "a layer in the list has no file: {seen:?}");
}

#[test]
fn the_test_sees_a_violation() {
    assert_eq!(named("use crate::mesh::InterfaceMesh;"), ["mesh"]);
    assert_eq!(
        named("use crate::{grid::Pair, report::Picture};\nfn f() { crate::cli::main(); }"),
        ["grid", "report", "cli"]
    );
    assert!(named("/// like [`crate::mesh`]").is_empty());
}
