//! Odd, truncated, lying and hostile files: read right, or refused with a message; never a panic,
//! a hang, or memory that the file's own size does not justify.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // helpers of tests are tests; a skip is said aloud

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const SECONDS: u64 = 5;
const KILOBYTES: u64 = 200_000;

struct Outcome {
    code: Option<i32>,
    stdout: String,
    stderr: String,
}

/// Runs `interfacet check FILE` under the limits of time and memory.
fn check(file: &Path) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    let (out, err) = (folder.path().join("out"), folder.path().join("err"));
    let to = |path: &PathBuf| Stdio::from(std::fs::File::create(path).unwrap());
    let mut child = Command::new(env!("CARGO_BIN_EXE_interfacet"))
        .arg("check")
        .arg(file)
        .stdin(Stdio::null())
        .stdout(to(&out))
        .stderr(to(&err))
        .spawn()
        .unwrap();
    let (start, mut peak) = (Instant::now(), 0);
    let code = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status.code();
        }
        // Peak resident memory, where the system tells.
        if let Ok(status) = std::fs::read_to_string(format!("/proc/{}/status", child.id())) {
            let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
            let kb = line.and_then(|l| l.trim().trim_end_matches(" kB").parse::<u64>().ok());
            peak = peak.max(kb.unwrap_or(0));
        }
        let (slow, fat) = (start.elapsed() > Duration::from_secs(SECONDS), peak > KILOBYTES);
        if slow || fat {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("{}: {:?}, {peak} kB", file.display(), start.elapsed());
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    let text = |path| String::from_utf8_lossy(&std::fs::read(path).unwrap()).into_owned();
    Outcome { code, stdout: text(&out), stderr: text(&err) }
}

fn folder(name: &str) -> Option<PathBuf> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data/bad").join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED: {} is not there", folder.display());
    None
}

/// Either a report, or one line that names the file and says what is wrong.
fn read_or_refused(file: &Path, outcome: &Outcome) -> bool {
    let Outcome { code, stdout, stderr } = outcome;
    assert!(!stderr.contains("panicked"), "{}: {stderr}", file.display());
    let read = stdout.contains("triangles") && stderr.is_empty() && matches!(code, Some(0 | 1));
    let name = file.file_name().unwrap().to_str().unwrap();
    let refused = stdout.is_empty()
        && *code == Some(1)
        && stderr.starts_with("error: ")
        && stderr.contains(name)
        && stderr.trim_end().lines().count() == 1
        && stderr.len() < 1000;
    assert!(read != refused, "{}: {code:?}\n{stdout}\n{stderr}", file.display());
    read
}

/// Every file of a folder, with whether it is valid, however unusual.
fn every_file(name: &str, valid: &[(&str, &str)]) {
    let Some(folder) = folder(name) else { return };
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let file = entry.unwrap().path();
        let outcome = check(&file);
        let read = read_or_refused(&file, &outcome);
        let name = file.file_name().unwrap().to_str().unwrap();
        let expected = valid.iter().find(|v| v.0 == name);
        assert_eq!(read, expected.is_some(), "{name}\n{}{}", outcome.stdout, outcome.stderr);
        if let Some((_, counts)) = expected {
            assert!(outcome.stdout.starts_with(counts), "{name}\n{}", outcome.stdout);
            seen += 1;
        }
    }
    assert_eq!(seen, valid.len());
}

#[test]
fn ply_files() {
    every_file(
        "ply",
        &[
            ("cube.ply", "8 vertices, 12 triangles"),
            ("cube_binary.ply", "8 vertices, 12 triangles"),
            ("cube_binary_header_with_RN_newline.ply", "8 vertices, 12 triangles"),
            ("cube_binary_starts_with_nl.ply", "8 vertices, 12 triangles"),
            ("cube_uv.ply", "24 vertices, 12 triangles"),
            ("float-color.ply", "3 vertices, 1 triangles"),
        ],
    );
}

#[test]
fn stl_files() {
    every_file(
        "stl",
        &[
            ("20mmbox-CR.stl", "8 vertices, 12 triangles"),
            ("20mmbox-CRLF.stl", "8 vertices, 12 triangles"),
            ("20mmbox-LF.stl", "8 vertices, 12 triangles"),
            ("20mmbox-nonstandard.stl", "8 vertices, 12 triangles"),
            ("issue1580-back-to-back.stl", ""),
            ("issue1580-back-to-back2.stl", ""),
            ("issue1580-zero-area-triangle.stl", ""),
            ("issue945e.stl", ""),
            ("issue945f.stl", ""),
            ("busted.STL", ""),
        ],
    );
}

/// Writes `bytes` to a file of this name and checks it.
fn made(name: &str, bytes: &[u8]) -> (bool, Outcome) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(name);
    std::fs::write(&file, bytes).unwrap();
    let outcome = check(&file);
    (read_or_refused(&file, &outcome), outcome)
}

#[test]
fn lying_counts_are_refused_at_once() {
    let header = |vertices: &str, faces: &str, list: &str, format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
             property float z\nelement face {faces}\nproperty list {list} int vertex_indices\nend_header\n"
        )
        .into_bytes()
    };
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for (vertices, faces) in [
            ("4000000000", "1"),
            ("0", "4000000000"),
            ("18446744073709551615", "1"),
            ("1", "99999999999999999999"),
        ] {
            let (read, outcome) = made("lie.ply", &header(vertices, faces, "uchar", format));
            assert!(!read, "{}", outcome.stdout);
        }
    }
    // A list that promises four thousand million entries.
    let mut lie = header("0", "1", "uint", "binary_little_endian");
    lie.extend([0xff; 16]);
    assert!(!made("lie.ply", &lie).0);
    // Entries without properties would take no bytes each, for ever.
    let nothing = b"ply\nformat ascii 1.0\nelement vertex 9999999999\nelement face 0\nend_header\n";
    assert!(!made("lie.ply", nothing).0);
    let mut stl = vec![0; 84 + 50];
    stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let (read, outcome) = made("lie.stl", &stl);
    assert!(!read && outcome.stderr.contains("4294967295 triangles"), "{}", outcome.stderr);
}

#[test]
fn indices_labels_and_numbers_out_of_range_are_refused() {
    let ply = |x: &str, face: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\nproperty int material_back\n\
             property int material_front\nend_header\n{x} 0 0\n1 0 0\n0 1 0\n{face}\n"
        )
    };
    assert!(made("good.ply", ply("0", "3 0 1 2 2 1").as_bytes()).0);
    assert!(made("good.ply", ply("0", "3 0 1 2 1 -1").as_bytes()).0, "outside as -1");
    // Line ends of an old Macintosh, and of Windows.
    assert!(made("cr.ply", ply("0", "3 0 1 2 2 1").replace('\n', "\r").as_bytes()).0);
    assert!(made("crlf.ply", ply("0", "3 0 1 2 2 1").replace('\n', "\r\n").as_bytes()).0);
    let twice = ply("0", "3 0 1 2 2 1").replace("property float z", "property float x\nproperty float z");
    assert!(!made("twice.ply", twice.as_bytes()).0, "a name that comes twice");
    for (x, face) in [
        ("0", "3 0 1 3 2 1"),
        ("0", "3 0 1 -1 2 1"),
        ("0", "2 0 1 2 1"),
        ("0", "3 0 1 2 1 1"),
        ("0", "3 0 1 2 254 1"),
        ("0", "3 0 1 2 70000 1"),
        ("nan", "3 0 1 2 2 1"),
        ("1e999", "3 0 1 2 2 1"),
        ("0", "3 0 1"),
        ("0", ""),
    ] {
        let (read, outcome) = made("bad.ply", ply(x, face).as_bytes());
        assert!(!read, "{x} {face}: {}", outcome.stdout);
    }
}

#[test]
fn every_truncation_and_many_flips_of_a_file_do_no_harm() {
    // In this process, as thousands of them would take long in others.
    use interfacet::export::{ReadOptions, read_mesh};
    let ply = b"ply\nformat binary_little_endian 1.0\ncomment material 1 a 2\nelement vertex 4\nproperty float x\n\
        property float y\nproperty double z\nproperty uchar kind\nelement face 2\n\
        property list uchar int vertex_indices\nproperty uchar material_back\nproperty char material_front\nend_header\n";
    let mut bytes = ply.to_vec();
    for p in [[0f32, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
        bytes.extend(p.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(0f64.to_le_bytes());
        bytes.push(2);
    }
    for f in [[0i32, 1, 2], [2, 1, 3]] {
        bytes.push(3);
        bytes.extend(f.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend([1, 255]);
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("m.ply");
    let read = |bytes: &[u8]| {
        std::fs::write(&file, bytes).unwrap();
        read_mesh(&file, &ReadOptions::default())
    };
    assert_eq!(read(&bytes).unwrap().triangles().len(), 2);
    for cut in 0..bytes.len() {
        assert!(read(&bytes[..cut]).is_err(), "{cut}");
    }
    for at in 0..bytes.len() {
        for flip in [0x01, 0x80, 0xff] {
            let mut broken = bytes.clone();
            broken[at] ^= flip;
            if let Err(error) = read(&broken) {
                assert!(error.to_string().contains("m.ply"));
            }
        }
    }
    let stl = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n\
        endloop\nendfacet\nendsolid a\n";
    for cut in 0..stl.len() {
        // All but the ends that leave the last word whole.
        let whole = stl[..cut].contains("endsolid");
        assert_eq!(read(&stl.as_bytes()[..cut]).is_ok(), whole, "{cut}");
    }
}
