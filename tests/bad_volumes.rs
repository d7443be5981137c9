//! Odd, truncated, lying and hostile files: each is read right or refused with a message, without a
//! panic, in seconds, and with no more memory than a small file justifies.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // helpers of tests, like the tests themselves

use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use interfacet::volume::{Endian, OpenOptions, RawLayout, SampleType, Samples, VolumeError, open};
use proptest::prelude::*;
use tempfile::TempDir;

const TIME: Duration = Duration::from_secs(5);
const MEMORY_KIB: u64 = 200 * 1024;

/// `interfacet info --json` on a file, in a process of its own that the system denies more memory
/// than the limit (`RLIMIT_DATA`: heap and every private mapping), killed when its time is over.
fn info(arguments: &[&str], file: &Path) -> Output {
    let binary = env!("CARGO_BIN_EXE_interfacet");
    let mut command = if cfg!(target_os = "linux") {
        let mut shell = Command::new("sh");
        shell.args(["-c", &format!("ulimit -d {MEMORY_KIB} && exec \"$@\""), "sh", binary]);
        shell
    } else {
        Command::new(binary)
    };
    command.arg("info").args(arguments).arg("--json").arg(file);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    // The pipes are emptied meanwhile, or a long answer would block the child.
    let mut pipes: Vec<Box<dyn Read + Send>> =
        vec![Box::new(child.stdout.take().unwrap()), Box::new(child.stderr.take().unwrap())];
    let readers: Vec<_> = pipes
        .drain(..)
        .map(|mut pipe| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                pipe.read_to_end(&mut bytes).map(|_| bytes)
            })
        })
        .collect();
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if start.elapsed() > TIME {
            child.kill().unwrap();
            panic!("{} took more than {TIME:?}", file.display());
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    let mut bytes = readers.into_iter().map(|reader| reader.join().unwrap().unwrap());
    let (stdout, stderr) = (bytes.next().unwrap(), bytes.next().unwrap());
    Output { status, stdout, stderr }
}

/// The size that was read, or the message of the refusal. Anything else fails the test.
fn read_or_refused(arguments: &[&str], file: &Path) -> Result<[usize; 3], String> {
    let output = info(arguments, file);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    let name = file.display();
    assert!(!message.contains("panicked"), "{name}: {message}");
    assert!(!message.contains("bytes of memory"), "{name} made us ask for too much memory: {message}");
    match output.status.code() {
        Some(0) => {
            let info: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            Ok(serde_json::from_value(info["size"].clone()).unwrap())
        }
        Some(1) => {
            assert!(message.starts_with("error: ") && message.len() > 20, "{name}: `{message}`");
            Err(message)
        }
        other => panic!("{name}: ended with {other:?}: {message}"),
    }
}

fn shared(folder: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/bad").join(folder);
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("SKIPPED: {} is not there", path.display());
    None
}

/// Every file of a folder, with what became of it.
fn all_of(folder: &Path) -> Vec<(String, Result<[usize; 3], String>)> {
    let mut names: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert!(!names.is_empty());
    names
        .iter()
        .map(|name| (name.to_string_lossy().into_owned(), read_or_refused(&[], &folder.join(name))))
        .collect()
}

#[test]
#[cfg(target_os = "linux")]
fn the_memory_limit_of_these_tests_is_enforced() {
    // 300 MB of zeros that are really there: in thin slices they are read slab by slab, but three slices
    // of 100 MB must be held together.
    let folder = tempfile::tempdir().unwrap();
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::fast());
    for _ in 0..300 {
        packed.write_all(&vec![0; 1 << 20]).unwrap();
    }
    let packed = packed.finish().unwrap();
    let of_size = |size: &str| {
        let header = format!(
            "NDims = 3\nDimSize = {size}\nElementType = MET_UCHAR\nCompressedData = True\nElementDataFile = LOCAL\n"
        );
        let output = info(&[], &write(&folder, "large.mha", &[header.as_bytes(), &packed]));
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (good, message) = of_size("1024 1024 300");
    assert!(good, "{message}");
    let (good, message) = of_size("10240 10240 3");
    assert!(!good && message.contains("bytes of memory"), "{message}");
}

#[test]
fn every_bad_tiff_is_read_right_or_refused() {
    let Some(folder) = shared("tiff") else { return };
    for (name, result) in all_of(&folder) {
        let grey = match name.as_str() {
            "12in16bit.tif" => Some([100, 100, 1]),
            "16bit.MM.cropped.tif" | "16bit.MM.deflate.tif" | "16bit.cropped.tif" | "16bit.deflate.tif" => {
                Some([64, 64, 1])
            }
            "16bit.s.tif" | "uint16_1_4660.tif" => Some([10, 10, 1]),
            _ => None,
        };
        match (grey, result) {
            (Some(size), result) => assert_eq!(result, Ok(size), "{name}"),
            (None, Ok(size)) => panic!("{name} should have been refused, but was read as {size:?}"),
            (None, Err(_)) => {}
        }
    }
    // One picture in both byte orders, plain and compressed.
    let read = |name: &str| open(&folder.join(name), &OpenOptions::default()).unwrap().read_all().unwrap();
    let plain = read("16bit.cropped.tif");
    for name in ["16bit.MM.cropped.tif", "16bit.MM.deflate.tif", "16bit.deflate.tif"] {
        assert_eq!(read(name), plain, "{name}");
    }
    assert_eq!(read("uint16_1_4660.tif"), Samples::U16(vec![4660; 100]));
}

#[test]
fn every_bad_nrrd_is_read_right_or_refused() {
    let Some(folder) = shared("nrrd") else { return };
    let balls = [
        "BallBinary30x30x30.nhdr",
        "BallBinary30x30x30.nrrd",
        "BallBinary30x30x30_byteskip_minus_one.nhdr",
        "BallBinary30x30x30_byteskip_minus_one_nifti.nhdr",
        "BallBinary30x30x30_gz.nrrd",
        "BallBinary30x30x30_gz_byteskip_minus_one.nrrd",
        "BallBinary30x30x30_gz_lineskip.nrrd",
    ];
    for (name, result) in all_of(&folder) {
        if balls.contains(&name.as_str()) {
            assert_eq!(result, Ok([30; 3]), "{name}");
        } else {
            let message = result.expect_err(&name);
            let word = match name.as_str() {
                "BallBinary30x30x30_byteskip_minus_five.nhdr" => "`-5`",
                "BallBinary30x30x30_bz2.nrrd" => "bzip2",
                // Its 352 bytes of NIfTI header would be taken for voxels.
                "BallBinary30x30x30_nifti.nhdr" => "follow",
                "BallBinary30x30x30.raw" => "--size",
                "test_simple4d_raw.nrrd" => "dimension: 4",
                "test2d_ascii.nrrd" => "dimension: 2",
                "test1d_ascii.nrrd" | "test_customFields.nrrd" => "dimension: 1",
                _ => "not known",
            };
            assert!(message.contains(word), "{name}: {message}");
        }
    }
    let read = |name: &str| open(&folder.join(name), &OpenOptions::default()).unwrap().read_all().unwrap();
    let first = read(balls[0]);
    let Samples::I16(values) = &first else { panic!("{:?}", first.sample_type()) };
    assert!(values.iter().any(|v| *v != values[0]), "there is a ball in it");
    for name in &balls[1..] {
        assert_eq!(read(name), first, "{name}");
    }
    let raw = ["--size", "30,30,30", "--type", "i16"];
    assert_eq!(read_or_refused(&raw, &folder.join("BallBinary30x30x30.raw")), Ok([30; 3]));
}

fn write(folder: &TempDir, name: &str, parts: &[&[u8]]) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, parts.concat()).unwrap();
    path
}

fn refused(path: &Path, options: &OpenOptions) -> VolumeError {
    match open(path, options).and_then(|source| source.read_all().map(|_| ())) {
        Err(error) => error,
        Ok(()) => panic!("{} was read", path.display()),
    }
}

const PLAIN: OpenOptions = OpenOptions { raw: None, spacing: None };

fn meta(size: &str, rest: &str) -> String {
    format!("ObjectType = Image\nNDims = 3\nDimSize = {size}\n{rest}ElementDataFile = LOCAL\n")
}

#[test]
fn a_missing_file_is_named() {
    for name in ["no/such/file.mha", "no/such/file.nrrd", "no/such/file.tif", "no/such/file"] {
        let error = refused(Path::new(name), &PLAIN);
        assert!(matches!(error, VolumeError::Io { .. }) && error.to_string().contains(name), "{error}");
    }
    let folder = tempfile::tempdir().unwrap();
    let header = write(
        &folder,
        "a.mhd",
        &[b"NDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\nElementDataFile = gone.raw\n"],
    );
    assert!(refused(&header, &PLAIN).to_string().contains("gone.raw"));
}

#[test]
fn headers_that_lie_about_the_size_are_refused_before_memory_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ("30000 30000 30000", "", "27000000000000 bytes of samples are needed but 64"),
        ("4 4 5", "", "80 bytes of samples are needed but 64"),
        ("4 4 3", "", "48 bytes of samples, but 16"),
        ("99999999999999999999 1 1", "", "99999999999999999999"),
        ("4294967296 4294967296 4294967296", "", "4294967296"),
        ("-4 4 4", "", "-4"),
        ("0 4 4", "", "[0, 4, 4]"),
        ("4 4", "", "three positive whole numbers"),
        ("4 4 4", "ElementSpacing = 0 1 1\n", "[0.0, 1.0, 1.0]"),
        ("4 4 4", "ElementSpacing = 1 -1 1\n", "-1.0"),
        ("4 4 4", "ElementSpacing = 1 nan 1\n", "NaN"),
        ("4 4 4", "TransformMatrix = 1 0 0 1 0 0 0 0 1\n", "linearly independent"),
        ("4 4 4", "HeaderSize = 9223372036854775807\n", "0 are there"),
        ("4 4 4", "HeaderSize = -2\n", "`-2`"),
        ("4 4 4", "ElementNumberOfChannels = 3\n", "ElementNumberOfChannels = 3"),
        ("4 4 4", "CompressedData = True\nCompressedDataSize = 4000000000\n", "4000000000"),
        ("4 4 4", "CompressedData = True\nCompressedDataSize = -5\n", "-5"),
        ("4 4 4", "NDims = 3\n", "twice"),
    ];
    for (i, (size, rest, word)) in cases.into_iter().enumerate() {
        let text = meta(size, &format!("ElementType = MET_UCHAR\n{rest}"));
        let path = write(&folder, &format!("{i}.mha"), &[text.as_bytes(), &[7; 64]]);
        let message = refused(&path, &PLAIN).to_string();
        assert!(message.contains(word), "{size} {rest}: {message}");
        read_or_refused(&[], &path).unwrap_err();
    }
}

#[test]
fn features_that_are_not_read_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let [plain, list] =
        ["NDims = 3\nDimSize = 4 4 4\nElementType = MET_UCHAR\n", "ElementDataFile = LIST\na\n"];
    let meta = |rest: &str| format!("{plain}{rest}");
    let nrrd = |rest: &str| format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: 4 4 4\n{rest}\n");
    let cases = [
        ("a.mhd", meta(list), "LIST"),
        ("b.mhd", meta("ElementDataFile = s%03d.raw 1 4 1\n"), "s%03d.raw"),
        ("c.mha", meta("BinaryData = False\nElementDataFile = LOCAL\n"), "BinaryData"),
        ("d.mha", plain.replace("UCHAR", "DOUBLE") + "ElementDataFile = LOCAL\n", "MET_DOUBLE"),
        ("e.mha", plain.replace("= 3", "= 2") + "ElementDataFile = LOCAL\n", "NDims = 2"),
        ("f.mha", meta(""), "ElementDataFile"),
        ("g.mha", "not a header at all".to_owned(), "Name = value"),
        ("a.nrrd", nrrd("encoding: hex\n"), "hex"),
        ("b.nrrd", nrrd("encoding: raw\ndata file: LIST\n"), "LIST"),
        ("c.nrrd", nrrd("encoding: raw\nkinds: vector domain domain\n"), "vector"),
        ("d.nrrd", nrrd("encoding: raw\nspace directions: none (1,0,0) (0,1,0)\n"), "space directions"),
        ("e.nrrd", nrrd("encoding: raw\nspace units: \"furlong\" \"furlong\" \"furlong\"\n"), "furlong"),
        ("f.nrrd", nrrd("encoding: raw\nspacings: 1 1\n"), "spacings"),
        ("g.nrrd", nrrd("").replace("uchar", "double") + "encoding: raw\n", "double"),
        ("h.nrrd", nrrd("line skip: 99\nencoding: raw\n"), "line skip"),
        ("i.nrrd", nrrd("line skip: 9223372036854775807\nencoding: raw\n"), "line skip"),
        ("j.nrrd", nrrd("byte skip: 9223372036854775807\nencoding: raw\n"), "0 are there"),
        ("k.nrrd", "NRRD0009\n\n".to_owned(), "NRRD0009"),
        ("l.nrrd", nrrd("encoding: raw\n").replace("uchar", "short"), "endian"),
        ("m.tif", "II*\0".to_owned(), "header"),
        ("n.tif", "nothing".to_owned(), "II or MM"),
        ("o.xyz", "nothing".to_owned(), "MetaImage (.mha, .mhd), NRRD"),
        ("p.raw", "nothing".to_owned(), "--size"),
    ];
    for (name, text, word) in cases {
        let message = refused(&write(&folder, name, &[text.as_bytes()]), &PLAIN).to_string();
        assert!(message.contains(word), "{name}: {message}");
    }
    let message = refused(&folder.path().join("no_such").join(".."), &PLAIN).to_string();
    assert!(!message.is_empty());
    let empty = tempfile::tempdir().unwrap();
    assert!(refused(empty.path(), &PLAIN).to_string().contains("no TIFF slices"));
}

#[test]
fn a_truncated_and_an_overlong_raw_file_are_refused_with_both_lengths() {
    let folder = tempfile::tempdir().unwrap();
    let path = write(&folder, "v.raw", &[&[1; 100]]);
    let options = |size, offset| OpenOptions {
        raw: Some(RawLayout { size, sample_type: SampleType::U16, endian: Endian::Little, offset }),
        spacing: None,
    };
    assert!(matches!(
        refused(&path, &options([4, 4, 4], 0)),
        VolumeError::Truncated { needed: 128, got: 100, .. }
    ));
    assert!(matches!(
        refused(&path, &options([4, 4, 3], 0)),
        VolumeError::Excess { needed: 96, extra: 4, .. }
    ));
    assert!(matches!(refused(&path, &options([4, 4, 3], u64::MAX)), VolumeError::Truncated { got: 0, .. }));
    assert!(open(&path, &options([4, 4, 3], 4)).is_ok());
    let known = write(&folder, "v.mha", &[b"x"]);
    assert!(matches!(refused(&known, &options([4, 4, 3], 4)), VolumeError::LayoutNotNeeded { .. }));
    let spacing = OpenOptions { spacing: Some([1.0, 0.0, 1.0]), ..options([4, 4, 3], 4) };
    assert!(matches!(refused(&path, &spacing), VolumeError::Geometry { .. }));
}

#[test]
fn not_a_number_is_refused_with_its_voxel() {
    let folder = tempfile::tempdir().unwrap();
    let mut values = [1.5_f32; 64];
    values[37] = f32::NAN;
    values[40] = f32::NEG_INFINITY;
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let text = meta("4 4 4", "ElementType = MET_FLOAT\n");
    let path = write(&folder, "v.mha", &[text.as_bytes(), &bytes]);
    let error = refused(&path, &PLAIN);
    assert!(matches!(error, VolumeError::NotFinite { count: 2, first: [1, 1, 2], .. }), "{error}");
}

#[test]
fn compressed_streams_that_end_early_run_on_or_are_damaged_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let pack = |n: usize| {
        let mut out = GzEncoder::new(Vec::new(), Compression::default());
        out.write_all(&(0..n).map(|i| (i * 7 % 256) as u8).collect::<Vec<_>>()).unwrap();
        out.finish().unwrap()
    };
    let header = b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 10 10 10\nencoding: gzip\n\n";
    let read = |name: &str, data: &[u8]| refused(&write(&folder, name, &[header, data]), &PLAIN);
    assert!(matches!(read("a.nrrd", &pack(900)), VolumeError::Truncated { needed: 1000, got: 900, .. }));
    assert!(matches!(read("b.nrrd", &pack(1100)), VolumeError::Excess { .. }));
    let whole = pack(1000);
    assert!(matches!(read("c.nrrd", &whole[..whole.len() / 2]), VolumeError::Truncated { .. }));
    let mut damaged = whole.clone();
    damaged[20] ^= 0xff;
    read("d.nrrd", &damaged);
    // A little file that claims, and a bomb that really holds, far more than it should.
    let claim = b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 20000 20000 20000\nencoding: gzip\n\n";
    let path = write(&folder, "claim.nrrd", &[claim, &whole]);
    assert!(matches!(refused(&path, &PLAIN), VolumeError::Truncated { .. }));
    let mut bomb = GzEncoder::new(Vec::new(), Compression::fast());
    for _ in 0..400 {
        bomb.write_all(&vec![0; 1 << 20]).unwrap();
    }
    let bomb = bomb.finish().unwrap();
    let last = b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 10 10 10\nbyte skip: -1\nencoding: gzip\n\n";
    for (name, header) in [("bomb.nrrd", &header[..]), ("last.nrrd", &last[..])] {
        let path = write(&folder, name, &[header, &bomb]);
        assert!(read_or_refused(&[], &path).unwrap_err().contains("follow"));
    }
}

/// Small valid volumes of every format with a header.
fn valid_files() -> Vec<(&'static str, Vec<u8>)> {
    let samples: Vec<u8> = (0..120).map(|i| (i * 37 % 251) as u8).collect();
    let packed = {
        let mut out = ZlibEncoder::new(Vec::new(), Compression::default());
        out.write_all(&samples).unwrap();
        out.finish().unwrap()
    };
    let gzip = {
        let mut out = GzEncoder::new(Vec::new(), Compression::default());
        out.write_all(&samples).unwrap();
        out.finish().unwrap()
    };
    let extra = "ElementType = MET_UCHAR\nElementSpacing = 1 2 3.5\nOffset = 1 2 3\nTransformMatrix = 1 0 0 0 1 0 0 0 1\n";
    let nrrd = |encoding: &str| {
        format!("NRRD0005\ntype: uchar\ndimension: 3\nsizes: 4 5 6\nspace directions: (1,0,0) (0,2,0) (0,0,3.5)\nbyte skip: 0\nencoding: {encoding}\n\n").into_bytes()
    };
    let tiff = |compression| {
        let mut out = std::io::Cursor::new(Vec::new());
        let mut encoder = tiff::encoder::TiffEncoder::new(&mut out).unwrap().with_compression(compression);
        for page in samples.chunks(20) {
            encoder.write_image::<tiff::encoder::colortype::Gray8>(4, 5, page).unwrap();
        }
        out.into_inner()
    };
    vec![
        ("a.mha", [meta("4 5 6", extra).as_bytes(), &samples].concat()),
        ("b.mha", [meta("4 5 6", &format!("{extra}CompressedData = True\n")).as_bytes(), &packed].concat()),
        ("a.nrrd", [nrrd("raw"), samples.clone()].concat()),
        ("b.nrrd", [nrrd("gzip"), gzip].concat()),
        (
            "c.nrrd",
            [nrrd("text"), samples.iter().map(|v| format!("{v} ")).collect::<String>().into_bytes()].concat(),
        ),
        ("a.tif", tiff(tiff::encoder::Compression::Uncompressed)),
        ("b.tif", tiff(tiff::encoder::Compression::Lzw)),
        ("c.tif", tiff(tiff::encoder::Compression::Deflate(Default::default()))),
        ("d.tif", tiff(tiff::encoder::Compression::Packbits)),
    ]
}

#[test]
fn the_files_to_be_mutated_are_valid() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in valid_files() {
        let source = open(&write(&folder, name, &[&bytes]), &PLAIN).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(source.geometry().size(), [4, 5, 6], "{name}");
        let Samples::U8(values) = source.read_all().unwrap() else { panic!("{name}") };
        assert!(values.iter().enumerate().all(|(i, v)| usize::from(*v) == i * 37 % 251), "{name}");
    }
}

/// Reads what can be read; whatever happens, it must not be a panic.
fn must_not_panic(path: &Path) {
    match open(path, &PLAIN) {
        Err(error) => assert!(!error.to_string().is_empty()),
        // A mutated header may rightly claim up to a thousand times the file: still little.
        Ok(source) => match source.read_all() {
            Err(error) => assert!(!error.to_string().is_empty()),
            Ok(samples) => assert_eq!(samples.len(), source.geometry().voxels()),
        },
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 700, failure_persistence: None, ..ProptestConfig::default() })]

    /// Bytes changed, digits above all, and the end cut off.
    #[test]
    fn a_damaged_file_never_panics(
        which in 0..9_usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), any::<bool>()), 0..6),
        keep in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let (name, mut bytes) = valid_files().swap_remove(which);
        for (at, value, header) in changes {
            // Half of the changes hit the first bytes, where most headers are.
            let n = if header { bytes.len().min(64) } else { bytes.len() };
            let at = at.index(n);
            bytes[at] = if bytes[at].is_ascii_digit() && value < 200 { b'0' + value % 10 } else { value };
        }
        if let Some(keep) = keep {
            bytes.truncate(keep.index(bytes.len()));
        }
        let folder = tempfile::tempdir().unwrap();
        must_not_panic(&write(&folder, name, &[&bytes]));
    }

    /// Directory entries of a TIFF changed as wholes: tag, type, count, value.
    #[test]
    fn a_tiff_with_other_tags_never_panics(
        which in 5..9_usize,
        changes in prop::collection::vec((0..6_usize, 0..20_usize, 0..4_usize, prop_oneof![
            any::<u32>(), 0..20_u32, Just(u32::MAX), Just(65_535), Just(1 << 24), 250..345_u32,
        ]), 1..5),
    ) {
        let (name, mut bytes) = valid_files().swap_remove(which);
        let number = |bytes: &[u8], at: usize, n: usize| {
            bytes[at..at + n].iter().rev().fold(0_usize, |v, b| v << 8 | usize::from(*b))
        };
        for (page, entry, field, value) in changes {
            let mut at = number(&bytes, 4, 4);
            for _ in 0..page {
                if at + 2 > bytes.len() { break }
                let link = at + 2 + 12 * number(&bytes, at, 2);
                if link + 4 > bytes.len() { break }
                let next = number(&bytes, link, 4);
                if next == 0 || next + 2 > bytes.len() { break }
                at = next;
            }
            if at + 2 > bytes.len() { continue }
            let entries = number(&bytes, at, 2).max(1);
            let start = at + 2 + 12 * (entry % entries) + [0, 2, 4, 8][field];
            let len = [2, 2, 4, 4][field];
            if start + len <= bytes.len() {
                bytes[start..start + len].copy_from_slice(&value.to_le_bytes()[..len]);
            }
        }
        let folder = tempfile::tempdir().unwrap();
        must_not_panic(&write(&folder, name, &[&bytes]));
    }
}
