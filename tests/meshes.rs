//! Meshes of other people's tests: closed ones are found closed, holes are counted.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // helpers of tests are tests; a skip is said aloud

use std::collections::HashMap;
use std::path::PathBuf;

use glam::DVec3;
use interfacet::execution::Execution;
use interfacet::export::{ReadOptions, read_mesh};
use interfacet::grid::{MaterialId, Pair};
use interfacet::mesh::{CheckOptions, InterfaceMesh, MeshMaterial, MeshReport, kinds_from_labels};

/// The folder with the meshes, or nothing, said aloud.
fn folder() -> Option<PathBuf> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data/mesh");
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED: {} is not there", folder.display());
    None
}

/// A tiny OFF reader: polygons become fans.
fn off(path: &PathBuf) -> InterfaceMesh {
    let text = std::fs::read_to_string(path).unwrap();
    let plain: String = text.lines().map(|l| l.split('#').next().unwrap().to_owned() + "\n").collect();
    let mut words = plain.split_whitespace();
    assert_eq!(words.next(), Some("OFF"), "{}", path.display());
    let mut count = || words.next().unwrap().parse::<usize>().unwrap();
    let (n, faces, _) = (count(), count(), count());
    let mut number = || words.next().unwrap().parse::<f64>().unwrap();
    let positions: Vec<_> = (0..n).map(|_| DVec3::new(number(), number(), number())).collect();
    let mut triangles = Vec::new();
    for _ in 0..faces {
        let k = number() as usize;
        let corners: Vec<u32> = (0..k).map(|_| number() as u32).collect();
        triangles.extend(corners[1..].windows(2).map(|two| [corners[0], two[0], two[1]]));
    }
    let pairs = vec![Pair::new(MaterialId(1), MaterialId(0)).unwrap(); triangles.len()];
    let material = |id| MeshMaterial { id: MaterialId(id), name: format!("m{id}"), mean: 0.0 };
    let kinds = kinds_from_labels(n, &triangles, &pairs);
    InterfaceMesh::new(positions, kinds, triangles, pairs, vec![material(0), material(1)]).unwrap()
}

fn report(path: &PathBuf) -> MeshReport {
    let is_off = path.extension().unwrap() == "off";
    let mesh = if is_off { off(path) } else { read_mesh(path, &ReadOptions::default()).unwrap() };
    MeshReport::new(&mesh, &CheckOptions::default(), &Execution::default()).unwrap()
}

fn all() -> HashMap<String, MeshReport> {
    let Some(folder) = folder() else { return HashMap::new() };
    let files = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    files.map(|p| (p.file_name().unwrap().to_str().unwrap().to_owned(), report(&p))).collect()
}

/// Name, Euler characteristic.
const CLOSED: [(&str, i64); 14] = [
    ("3torus.off", -4),
    ("anchor.off", -6),
    ("cube-meshed.off", 2),
    ("cube.off", 2),
    ("fandisk.off", 2),
    ("fandisk_large.off", 2),
    ("joint.off", -2),
    ("part.off", 2),
    ("pinion.off", 0),
    ("plate_holes.STL", -8),
    ("rotor.off", 0),
    ("sphere966.off", 2),
    ("torus.STL", 0),
    ("torus_quad.off", 0),
];

/// Name, number of boundary loops.
const HOLES: [(&str, u64); 8] = [
    ("mech-holes-shark.off", 4),
    ("holes.off", 7),
    ("elephant-with-holes.off", 106),
    ("blade.off", 2),
    ("corner_with_hole.off", 1),
    ("corner_tris_with_hole.off", 1),
    ("open_cube.off", 1),
    ("cube-ouvert.off", 1),
];

#[test]
fn closed_meshes_are_closed_and_holes_are_counted() {
    let all = all();
    if all.is_empty() {
        return;
    }
    for (name, euler) in CLOSED {
        let r = &all[name];
        assert!(r.defects.is_empty(), "{name}: {:?}", r.defects.by_kind());
        let shell = &r.measures.shells[0];
        assert_eq!(shell.euler_characteristic, euler, "{name}");
        assert!(shell.volume.unwrap() > 0.0, "{name}");
        assert_eq!(r.junctions.boundaries.edges, 0, "{name}");
    }
    for (name, loops) in HOLES {
        let r = &all[name];
        assert_eq!(r.junctions.boundaries.loops, loops, "{name}");
        assert_eq!(r.junctions.boundaries.open_curves, 0, "{name}");
        assert_eq!(r.defects.boundary_edges.count, r.junctions.boundaries.edges, "{name}");
        assert!(!r.defects.shells[0].closed && r.measures.shells[0].volume.is_none(), "{name}");
    }
    assert!((all["cube.off"].measures.shells[0].volume.unwrap() - 8.0).abs() < 1e-12);
    // An inside-out cuboid is closed, with a negative volume.
    assert!(all["beam.off"].measures.shells[0].volume.unwrap() < 0.0);
    // A hundred random triangles: all loose, many crossing.
    let soup = &all["soup.stl"];
    assert_eq!(soup.measures.shells[0].components, 100);
    assert_eq!(soup.junctions.boundaries.loops, 100);
    assert!(soup.defects.self_intersections.count > 100);
}

#[test]
fn the_command_says_what_it_found_and_exits_by_it() {
    let Some(folder) = folder() else { return };
    let run = |file: &str, args: &[&str]| {
        let path = folder.join(file);
        std::process::Command::new(env!("CARGO_BIN_EXE_interfacet"))
            .arg("check")
            .arg(path)
            .args(args)
            .output()
            .unwrap()
    };
    let good = run("torus.STL", &[]);
    let text = String::from_utf8(good.stdout).unwrap();
    assert_eq!(good.status.code(), Some(0), "{text}");
    assert!(text.contains("No defects.") && text.contains("8700 triangles"), "{text}");
    let bad = run("soup.stl", &["--json", "-", "--examples", "3"]);
    assert_eq!(bad.status.code(), Some(1));
    let json: serde_json::Value = serde_json::from_slice(&bad.stdout).unwrap();
    assert_eq!(json["defects"]["boundary_edges"]["count"], 300);
    assert_eq!(json["defects"]["boundary_edges"]["first"].as_array().unwrap().len(), 3);
    assert_eq!(json["measures"]["shells"][0]["components"], 100);
    let file = tempfile::tempdir().unwrap();
    let path = file.path().join("report.json");
    let both = run("cube.off", &["--json", path.to_str().unwrap()]);
    assert_eq!(both.status.code(), Some(1), "OFF is not read");
    assert!(!path.exists());
    let both = run("torus.STL", &["--json", path.to_str().unwrap()]);
    assert!(both.status.success() && !both.stdout.is_empty());
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    assert_eq!(json["defects"]["shells"][0]["manifold"], true);
}
