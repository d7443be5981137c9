//! Tests of the PLY writers, with the reader.

use glam::DVec3;
use proptest::prelude::*;

use super::*;
use crate::export::{Coordinates, PlyEncoding, PlyPieces, ReadOptions, read_mesh};
use crate::mesh::fixtures::{materials, parts, voxel_faces};
use crate::mesh::{kinds_from_labels, split};

const ENCODINGS: [PlyEncoding; 3] =
    [PlyEncoding::BinaryLittleEndian, PlyEncoding::BinaryBigEndian, PlyEncoding::Ascii];

fn sample(offset: f64, step: f64) -> InterfaceMesh {
    let m = voxel_faces([2, 2, 1], &[1, 2, 3, 0], 255);
    let (p, t, pairs) = parts(&m);
    let p: Vec<DVec3> = p.iter().map(|&p| p * step + offset).collect();
    let kinds = kinds_from_labels(p.len(), &t, &pairs);
    let mut materials = materials();
    materials[2].name = "stainless steel, 1.4301".to_owned();
    InterfaceMesh::new(p, kinds, t, pairs, materials).unwrap()
}

/// The same with sigmas, of which some are unknown.
fn known(mesh: &InterfaceMesh) -> InterfaceMesh {
    let sigma = |i: usize| if i % 5 == 3 { f32::NAN } else { 0.1 / (i + 1) as f32 };
    mesh.clone().with_sigmas((0..mesh.positions().len()).map(sigma).collect()).unwrap()
}

/// A mesh whose triangles and vertices are in the order of layers, cut after the given shares of its
/// triangles, as a run over slabs would leave it.
pub(crate) fn pieces(mesh: &InterfaceMesh, cuts: &[usize]) -> Vec<MeshPiece> {
    let (p, t, pairs) = parts(mesh);
    let sigmas = mesh.sigmas();
    let mut bounds: Vec<usize> = cuts.iter().map(|c| c % (t.len() + 1)).collect();
    bounds.extend([0, t.len()]);
    bounds.sort_unstable();
    let lowest = |from: usize| t[from..].iter().flatten().min().map_or(p.len(), |&v| v as usize);
    let mut top = 0;
    bounds
        .windows(2)
        .enumerate()
        .map(|(k, range)| {
            let (start, end) = (range[0], range[1]);
            let first = if k == 0 { 0 } else { lowest(start).min(p.len()) };
            let next = if end == t.len() { p.len() } else { lowest(end) };
            let highest = t[start..end].iter().flatten().max().map_or(0, |&v| v as usize + 1);
            top = highest.max(next).max(top);
            let local = t[start..end].iter().map(|t| t.map(|v| v - first as u32)).collect();
            let mesh = InterfaceMesh::new(
                p[first..top].to_vec(),
                mesh.kinds()[first..top].to_vec(),
                local,
                pairs[start..end].to_vec(),
                mesh.materials().to_vec(),
            );
            let sigmas = sigmas.map_or(Vec::new(), |sigmas| sigmas[first..top].to_vec());
            let mesh = mesh.unwrap().with_sigmas(sigmas).unwrap();
            MeshPiece {
                last_layer: [next - first, 0],
                owned: next - first,
                first_vertex: first as u64,
                first_triangle: start as u64,
                mesh,
            }
        })
        .collect()
}

#[test]
fn every_encoding_reads_back_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.ply");
    for encoding in ENCODINGS {
        // Exact in f32; and one that is not, near an origin far away.
        for (offset, step, word) in [(0.5, 0.25, "float"), (123_456.789, 0.001, "double")] {
            let m = sample(offset, step);
            write_ply(&path, &m, PlyOptions { encoding, ..PlyOptions::for_mesh(&m, step) }).unwrap();
            let text = std::fs::read(&path).unwrap();
            let head = String::from_utf8_lossy(&text[..600]).into_owned();
            assert!(head.contains(&format!("property {word} x\n")), "{head}");
            assert!(head.contains("comment unit mm\n"));
            assert!(head.contains("comment material 2 stainless steel, 1.4301 100\n"));
            assert!(!head.contains("sigma"));
            assert_eq!(read_mesh(&path, &ReadOptions::default()).unwrap(), m);
            let m = known(&m);
            write_ply(&path, &m, PlyOptions { encoding, ..PlyOptions::for_mesh(&m, step) }).unwrap();
            let text = std::fs::read(&path).unwrap();
            assert!(
                String::from_utf8_lossy(&text[..600]).contains("property uchar kind\nproperty float sigma\n")
            );
            assert_eq!(read_mesh(&path, &ReadOptions::default()).unwrap(), m);
        }
    }
}

#[test]
fn a_name_cannot_break_the_header() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.ply");
    let m = sample(0.0, 1.0);
    let mut materials = m.materials().to_vec();
    materials[1].name = "two\nend_header\r\nlines".to_owned();
    let (p, t, pairs) = parts(&m);
    let m = InterfaceMesh::new(p, m.kinds().to_vec(), t, pairs, materials).unwrap();
    write_ply(&path, &m, PlyOptions::default()).unwrap();
    let back = read_mesh(&path, &ReadOptions::default()).unwrap();
    assert_eq!(back.triangles(), m.triangles());
    assert_eq!(back.materials()[1].name, "two end_header  lines");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn the_bytes_do_not_depend_on_the_pieces(
        labels in prop::collection::vec(0u8..4, 24),
        cuts in prop::collection::vec(0usize..500, 0..6),
        double: bool,
        sigmas: bool,
    ) {
        let mesh = voxel_faces([3, 2, 4], &labels, 255);
        let mesh = if sigmas { known(&mesh) } else { mesh };
        let folder = tempfile::tempdir().unwrap();
        let [whole, cut] = ["whole.ply", "cut.ply"].map(|name| folder.path().join(name));
        let coordinates = if double { Coordinates::Double } else { Coordinates::Float };
        for encoding in ENCODINGS {
            let options = PlyOptions { coordinates, encoding };
            write_ply(&whole, &mesh, options).unwrap();
            let mut out = PlyStream::create(&cut, mesh.materials(), options).unwrap();
            for piece in pieces(&mesh, &cuts) {
                out.add(&piece).unwrap();
            }
            out.finish(&Execution::default()).unwrap();
            prop_assert!(std::fs::read(&whole).unwrap() == std::fs::read(&cut).unwrap());
        }
    }
}

#[test]
fn pieces_that_do_not_follow_each_other_are_refused_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.ply");
    let mesh = sample(0.0, 1.0);
    let all = pieces(&mesh, &[10, 20]);
    let create = || PlyStream::create(&path, mesh.materials(), PlyOptions::default()).unwrap();
    let mut out = create();
    out.add(&all[0]).unwrap();
    assert!(matches!(out.add(&all[2]), Err(ExportError::Pieces { .. })));
    assert!(matches!(out.finish(&Execution::default()), Err(ExportError::Pieces { .. })));
    let mut out = create();
    out.add(&all[0]).unwrap();
    let execution = Execution::default();
    execution.cancel_flag().store(true, std::sync::atomic::Ordering::Relaxed);
    let mut whole = create();
    whole.add(&MeshPiece::whole(mesh.clone())).unwrap();
    assert!(matches!(whole.finish(&execution), Err(ExportError::Cancelled(_))));
    // More vertices than there can be are refused when they come, not when they have been written.
    let mut far = all[0].clone();
    far.first_vertex = MOST_VERTICES - 3;
    out.counts = [far.first_vertex, 0];
    far.first_triangle = 0;
    let error = out.add(&far).unwrap_err();
    assert!(error.to_string().contains("2147483647"), "{error}");
    drop(out);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_shell_in_portions_is_the_shell_as_a_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, cut] = ["whole.ply", "cut.ply"].map(|name| folder.path().join(name));
    let mesh = known(&sample(0.0, 1.0));
    let (id, options) = (MaterialId(2), PlyOptions::default());
    let shell = split(&mesh, id);
    let as_mesh = shell.to_mesh(&mesh, id).unwrap();
    write_ply(&whole, &as_mesh, options).unwrap();
    let mut out = ShellPlyStream::create(&cut, mesh.materials(), id, options).unwrap();
    let n = as_mesh.positions().len();
    let portion = |vertices: std::ops::Range<usize>, triangles: &[[u32; 3]]| ShellPiece {
        positions: as_mesh.positions()[vertices.clone()].to_vec(),
        kinds: as_mesh.kinds()[vertices.clone()].to_vec(),
        sigmas: as_mesh.sigmas().unwrap()[vertices].to_vec(),
        triangles: triangles.to_vec(),
    };
    // The first triangle names vertices that come with the second portion.
    out.add(&portion(0..1, &shell.triangles[..1])).unwrap();
    assert!(out.add(&ShellPiece { kinds: Vec::new(), ..portion(1..n, &[]) }).is_err());
    assert!(out.add(&ShellPiece { sigmas: Vec::new(), ..portion(1..n, &[]) }).is_err());
    out.add(&portion(1..n, &shell.triangles[1..])).unwrap();
    out.finish(&Execution::default()).unwrap();
    assert!(std::fs::read(&whole).unwrap() == std::fs::read(&cut).unwrap());
    let air = ShellPlyStream::create(&cut, mesh.materials(), MaterialId::BACKGROUND, options);
    assert!(matches!(air, Err(ExportError::Pieces { .. })));
}

#[test]
fn a_file_comes_back_in_pieces_that_make_it_again() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, again] = ["whole.ply", "again.ply"].map(|name| folder.path().join(name));
    let mesh = known(&sample(0.25, 0.1));
    let options = PlyOptions { coordinates: Coordinates::Double, ..PlyOptions::default() };
    write_ply(&whole, &mesh, options).unwrap();
    let pieces = PlyPieces::open(&whole, &ReadOptions::default()).unwrap();
    assert_eq!(pieces.counts(), [mesh.positions().len() as u64, mesh.triangles().len() as u64]);
    let mut out = PlyStream::create(&again, pieces.materials(), options).unwrap();
    pieces.each(|piece| out.add(piece)).unwrap();
    out.finish(&Execution::default()).unwrap();
    assert!(std::fs::read(&whole).unwrap() == std::fs::read(&again).unwrap());
    // An index that is too high, and another layout.
    let mut bytes = std::fs::read(&whole).unwrap();
    let last = bytes.len() - 3;
    bytes[last] = 1;
    std::fs::write(&again, &bytes).unwrap();
    assert!(matches!(PlyPieces::open(&again, &ReadOptions::default()), Err(ExportError::Malformed { .. })));
    write_ply(&again, &mesh, PlyOptions { encoding: PlyEncoding::Ascii, ..options }).unwrap();
    assert!(matches!(PlyPieces::open(&again, &ReadOptions::default()), Err(ExportError::Malformed { .. })));
}

/// Our layout is read in blocks; the same file with one more element, of no entries, is read by the general
/// reader. Whatever is broken, both say the same.
#[test]
fn both_ways_of_reading_agree_on_broken_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.ply");
    let mesh = voxel_faces([2, 1, 1], &[1, 2], 255);
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        read_mesh(&path, &ReadOptions::default()).map_err(|e| e.to_string())
    };
    for coordinates in [Coordinates::Float, Coordinates::Double] {
        write_ply(&path, &mesh, PlyOptions { coordinates, ..PlyOptions::default() }).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let end = b"end_header\n";
        let head = bytes.windows(end.len()).position(|w| w == end).unwrap();
        let general = |bytes: &[u8]| {
            let extra = b"element extra 0\nproperty uchar extra\n";
            read(&[&bytes[..head], extra, &bytes[head..]].concat())
        };
        let body = head + end.len();
        assert_eq!(read(&bytes).unwrap(), general(&bytes).unwrap());
        for cut in (body..bytes.len()).step_by(3) {
            let cut = &bytes[..cut];
            assert_eq!(read(cut).unwrap_err(), general(cut).unwrap_err());
        }
        for at in body..bytes.len() {
            for flip in [0x02, 0x80] {
                let mut broken = bytes.clone();
                broken[at] ^= flip;
                assert_eq!(format!("{:?}", read(&broken)), format!("{:?}", general(&broken)), "{at} {flip}");
            }
        }
    }
}

/// A sparse file: it says that it is longer than 4 GiB, and what is read lies beyond.
#[cfg(unix)]
#[test]
fn faces_beyond_four_gibibytes_are_found() {
    use std::io::{BufReader, SeekFrom};

    use crate::export::{ply_decode::Layout, ply_read};

    let (vertices, faces) = (350_000_000, 2);
    let mut file = tempfile::tempfile().unwrap();
    let head = header(&materials(), PlyOptions::default(), false, [vertices, faces]).unwrap();
    file.write_all(&head).unwrap();
    file.set_len(head.len() as u64 + 13 * vertices + 15 * faces).unwrap();
    file.rewind().unwrap();
    let length = file.metadata().unwrap().len();
    assert!(length > 1 << 32);
    let mut input = BufReader::new(file);
    let ply_read::Start { header, used, .. } = ply_read::start(&mut input, length).unwrap();
    let layout = Layout::recognise(&header, used, length, &ReadOptions::default()).unwrap();
    let mut file = input.into_inner();
    file.seek(SeekFrom::Start(layout.offsets[1])).unwrap();
    let mut bytes = Vec::new();
    assert_eq!((file.read_to_end(&mut bytes).unwrap(), layout.offsets[2]), (30, length));
    assert!(Layout::recognise(&header, used, length - 1, &ReadOptions::default()).is_none());
}
