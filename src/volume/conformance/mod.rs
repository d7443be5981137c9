//! What every [`VolumeSource`] must do, and a file of every kind that is read, written by the test.

mod tiff;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use rayon::prelude::*;
use tempfile::TempDir;

use super::source::crop;
use super::*;
use crate::execution::Execution;
use crate::grid::{Geometry, VoxelBox};

/// No two axes alike, so that no two of them can be taken for one another.
const SIZE: [usize; 3] = [7, 5, 11];
const SPACING: [f64; 3] = [0.5, 0.75, 1.25];
const TYPES: [SampleType; 4] = [SampleType::U8, SampleType::U16, SampleType::I16, SampleType::F32];

/// Samples that differ from voxel to voxel (for u8: from all voxels near), in both bytes.
fn samples(sample: SampleType) -> Samples {
    let n = SIZE.iter().product::<usize>() as u32;
    match sample {
        SampleType::U8 => Samples::U8((0..n).map(|i| (i * 37 % 251) as u8).collect()),
        SampleType::U16 => Samples::U16((0..n).map(|i| (i * 167 + 3) as u16).collect()),
        SampleType::I16 => Samples::I16((0..n).map(|i| (i as i32 * 167 - 31_000) as i16).collect()),
        SampleType::F32 => Samples::F32((0..n).map(|i| i as f32 * -1.37e-3 + 0.2).collect()),
    }
}

fn encode(samples: &Samples, endian: Endian) -> Vec<u8> {
    let big = endian == Endian::Big;
    match samples {
        Samples::U8(v) => v.clone(),
        Samples::U16(v) => {
            v.iter().flat_map(|x| if big { x.to_be_bytes() } else { x.to_le_bytes() }).collect()
        }
        Samples::I16(v) => {
            v.iter().flat_map(|x| if big { x.to_be_bytes() } else { x.to_le_bytes() }).collect()
        }
        Samples::F32(v) => {
            v.iter().flat_map(|x| if big { x.to_be_bytes() } else { x.to_le_bytes() }).collect()
        }
    }
}

fn crop_samples(all: &Samples, size: [usize; 3], part: &VoxelBox) -> Samples {
    match all {
        Samples::U8(v) => Samples::U8(crop(v, size, part)),
        Samples::U16(v) => Samples::U16(crop(v, size, part)),
        Samples::I16(v) => Samples::I16(crop(v, size, part)),
        Samples::F32(v) => Samples::F32(crop(v, size, part)),
    }
}

/// Boxes of every shape: whole, single voxels in the corners, rows, slices, and many in between.
fn boxes(size: [usize; 3]) -> Vec<VoxelBox> {
    let mut boxes = vec![VoxelBox::whole(size)];
    for corner in 0..8 {
        let low: [usize; 3] = std::array::from_fn(|a| if corner >> a & 1 == 1 { size[a] - 1 } else { 0 });
        boxes.push(VoxelBox { low, high: low.map(|v| v + 1) });
    }
    // A full-period generator: the same boxes on every run, with no order in them.
    let mut state = 12_345_usize;
    let mut below = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % n
    };
    for _ in 0..120 {
        let low: [usize; 3] = std::array::from_fn(|a| below(size[a]));
        let high = std::array::from_fn(|a| low[a] + 1 + below(size[a] - low[a]));
        boxes.push(VoxelBox { low, high });
    }
    boxes
}

/// The suite: whatever a source is, it must pass this.
fn conforms(source: &dyn VolumeSource, expected: &Samples, what: &str) {
    let size = source.geometry().size();
    assert_eq!(source.sample_type(), expected.sample_type(), "{what}");
    assert_eq!(&source.read_all().unwrap(), expected, "{what}");
    boxes(size).into_par_iter().for_each(|part| {
        assert_eq!(source.read(&part).unwrap(), crop_samples(expected, size, &part), "{what}: {part:?}");
    });
    slices_conform(source, expected, what);
    for axis in 0..3 {
        let (mut empty, mut beyond) = (VoxelBox::whole(size), VoxelBox::whole(size));
        empty.high[axis] = 0;
        beyond.high[axis] += 1;
        for part in [empty, beyond] {
            assert!(matches!(source.read(&part), Err(VolumeError::Box { .. })), "{what}: {part:?}");
        }
    }
    assert!(source.notes().iter().all(|note| !note.is_empty()));
}

/// Slices in runs, with gaps, and from an earlier slice again, of the whole volume and of frames in it.
fn slices_conform(source: &dyn VolumeSource, expected: &Samples, what: &str) {
    let size = source.geometry().size();
    let execution = Execution::default();
    let bounded = VoxelBox { low: [1, 0, 1], high: [size[0], size[1] - 1, size[2]] };
    for frame in [VoxelBox::whole(size), bounded] {
        let depth = frame.size()[2];
        let mut reader = source.slices(&frame).unwrap();
        let mut out = Samples::none(source.sample_type());
        let mut wanted = Samples::none(source.sample_type());
        for slices in [0..1, 1..2, 3..4, 0..depth, 1..2, 3..depth] {
            reader.read(slices.clone(), &mut out, &execution).unwrap();
            let part = slices::slices_of(&frame, slices).unwrap();
            wanted.append(crop_samples(expected, size, &part)).unwrap();
            assert_eq!(out, wanted, "{what}: {part:?}");
        }
        for slices in [1..1, 0..depth + 1] {
            assert!(matches!(reader.read(slices, &mut out, &execution), Err(VolumeError::Box { .. })));
        }
    }
    let other = if source.sample_type() == SampleType::U8 { SampleType::U16 } else { SampleType::U8 };
    let mut out = Samples::none(other);
    let refused = source.append(&VoxelBox::whole(size), &mut out, &execution);
    assert!(matches!(refused, Err(VolumeError::Type { .. })), "{what}");
}

fn close(a: [f64; 3], b: [f64; 3]) -> bool {
    (0..3).all(|i| (a[i] - b[i]).abs() < 1e-12)
}

/// Opens a file that must be the test volume.
fn check(path: &Path, options: &OpenOptions, expected: &Samples, spacing: [f64; 3]) -> Box<dyn VolumeSource> {
    let what = format!("{} {:?}", path.display(), expected.sample_type());
    let source = open(path, options).unwrap_or_else(|error| panic!("{what}: {error}"));
    assert_eq!(source.geometry().size(), SIZE, "{what}");
    assert!(close(source.geometry().spacing(), spacing), "{what}");
    conforms(source.as_ref(), expected, &what);
    source
}

fn write(folder: &TempDir, name: &str, parts: &[&[u8]]) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, parts.concat()).unwrap();
    path
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut out = ZlibEncoder::new(Vec::new(), Compression::default());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::default());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

/// Runs a check for every number type and byte order.
fn for_all(mut test: impl FnMut(&TempDir, SampleType, Endian, &Samples, &[u8])) {
    for sample in TYPES {
        for endian in [Endian::Little, Endian::Big] {
            let folder = tempfile::tempdir().unwrap();
            let samples = samples(sample);
            test(&folder, sample, endian, &samples, &encode(&samples, endian));
        }
    }
}

#[test]
fn memory_and_a_region_of_it_conform() {
    for sample in TYPES {
        let all = samples(sample);
        let geometry = Geometry::new(
            SIZE,
            SPACING,
            [1.0, 2.0, 3.0],
            [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        )
        .unwrap();
        let source = MemorySource::new(geometry.clone(), all.clone()).unwrap();
        conforms(&source, &all, "memory");
        let part = VoxelBox { low: [1, 2, 3], high: [6, 4, 9] };
        let region = RegionOfInterest::new(Box::new(source.clone()), part).unwrap();
        conforms(&region, &crop_samples(&all, SIZE, &part), "region");
        // Two steps of x are 1 mm along world y, and so on.
        assert!(close(region.geometry().origin(), [1.0 + 1.5, 2.0 + 0.5, 3.0 + 3.75]));
        assert!(
            RegionOfInterest::new(Box::new(source.clone()), VoxelBox { low: [0; 3], high: [8, 1, 1] })
                .is_err()
        );
        let respaced = Respaced::new(Box::new(source), [1.0, 2.0, 3.0]).unwrap();
        conforms(&respaced, &all, "respaced");
        assert!(respaced.notes()[0].contains("0.5 x 0.75 x 1.25"), "{:?}", respaced.notes());
    }
}

#[test]
fn headerless_samples_conform() {
    for_all(|folder, sample_type, endian, all, bytes| {
        let path = write(folder, "v.raw", &[b"front", bytes]);
        let raw = Some(RawLayout { size: SIZE, sample_type, endian, offset: 5 });
        let options = OpenOptions { raw: raw.clone(), spacing: Some(SPACING) };
        let source = check(&path, &options, all, SPACING);
        assert!(source.cheap_partial_reads());
        check(&path, &OpenOptions { raw, spacing: None }, all, [1.0; 3]);
    });
}

fn meta_header(sample: SampleType, endian: Endian, rest: &str) -> String {
    let [x, y, z] = SIZE;
    let element = match sample {
        SampleType::U8 => "MET_UCHAR",
        SampleType::U16 => "MET_USHORT",
        SampleType::I16 => "MET_SHORT",
        SampleType::F32 => "MET_FLOAT",
    };
    let msb = if endian == Endian::Big { "True" } else { "False" };
    format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = {msb}\n\
         Offset = 10 -20 30.5\nTransformMatrix = 0 1 0 -1 0 0 0 0 1\nElementSpacing = 0.5 0.75 1.25\n\
         DimSize = {x} {y} {z}\nElementType = {element}\n{rest}"
    )
}

#[test]
fn metaimage_conforms() {
    for_all(|folder, sample, endian, all, bytes| {
        let options = OpenOptions::default();
        let header = |rest: &str| meta_header(sample, endian, rest).into_bytes();
        let packed = zlib(bytes);
        let sized = format!(
            "CompressedData = True\nCompressedDataSize = {}\nElementDataFile = LOCAL\n",
            packed.len()
        );
        write(folder, "data.raw", &[bytes]);
        write(folder, "long.raw", &[b"a header of another program", bytes]);
        write(folder, "data.zraw", &[&packed]);
        write(folder, "data.gz", &[&gzip(bytes)]);
        let kinds: [(&str, Vec<u8>, &[u8]); 8] = [
            ("local.mha", header("ElementDataFile = LOCAL\n"), bytes),
            ("crlf.mha", header("ElementDataFile = LOCAL\r\n"), bytes),
            ("detached.mhd", header("ElementDataFile = data.raw\n"), b""),
            ("end.mhd", header("HeaderSize = -1\nElementDataFile = long.raw\n"), b""),
            ("offset.mhd", header("HeaderSize = 27\nElementDataFile = long.raw"), b""),
            ("packed.mha", sized.into_bytes(), &packed),
            ("packed.mhd", header("CompressedData = True\nElementDataFile = data.zraw\n"), b""),
            ("gzip.mhd", header("CompressedData = True\nElementDataFile = data.gz\n"), b""),
        ];
        for (name, text, data) in kinds {
            let text = if name == "packed.mha" { header(std::str::from_utf8(&text).unwrap()) } else { text };
            let source = check(&write(folder, name, &[&text, data]), &options, all, SPACING);
            assert!(close(source.geometry().origin(), [10.0, -20.0, 30.5]));
            assert!(close(source.geometry().direction()[0], [0.0, 1.0, 0.0]));
            assert!(close(source.geometry().direction()[1], [-1.0, 0.0, 0.0]));
            assert_eq!(source.cheap_partial_reads(), !name.starts_with(['p', 'g']));
        }
    });
}

fn nrrd_header(sample: SampleType, endian: Endian, rest: &str) -> Vec<u8> {
    let [x, y, z] = SIZE;
    let kind = match sample {
        SampleType::U8 => "unsigned char",
        SampleType::U16 => "ushort",
        SampleType::I16 => "int16_t",
        SampleType::F32 => "float",
    };
    let endian = if endian == Endian::Big { "big" } else { "little" };
    format!("NRRD0005\n# made by a test\ntype: {kind}\ndimension: 3\nsizes: {x} {y} {z}\nendian: {endian}\nkey:=value: 3\n{rest}")
        .into_bytes()
}

#[test]
fn nrrd_conforms() {
    for_all(|folder, sample, endian, all, bytes| {
        let options = OpenOptions::default();
        let spacings = "spacings: 0.5 0.75 1.25\n";
        let vectors = "space: left-posterior-superior\nspace directions: (0,0.5,0) (-0.75,0,0) (0,0,1.25)\nspace origin: (10,-20,30.5)\n";
        let header = |rest: &str| nrrd_header(sample, endian, rest);
        let packed = gzip(bytes);
        let text =
            crate::with_samples!(all, v => v.iter().map(|x| x.to_string()).collect::<Vec<_>>().join(" "));
        fs::create_dir(folder.path().join("sub")).unwrap();
        write(folder, "sub/data.raw", &[b"one\ntwo\nxyz", bytes]);
        write(folder, "data.gz", &[&packed]);
        write(folder, "front.gz", &[&gzip(&[b"a front", bytes].concat())]);
        let kinds: [(&str, String, &[u8]); 9] = [
            ("raw.nrrd", format!("{vectors}encoding: raw\n\n"), bytes),
            ("spacings.nrrd", format!("{spacings}encoding: raw\n\n"), bytes),
            ("gzip.nrrd", format!("{spacings}encoding: gzip\n\n"), &packed),
            ("text.nrrd", format!("{spacings}encoding: ascii\n\n"), text.as_bytes()),
            (
                "skips.nhdr",
                format!("{spacings}encoding: raw\nline skip: 2\nbyte skip: 3\ndata file: sub/data.raw\n"),
                b"",
            ),
            ("last.nhdr", format!("{spacings}encoding: raw\nbyteskip: -1\ndatafile: ./sub/data.raw\n"), b""),
            ("gzip.nhdr", format!("{vectors}encoding: gz\ndata file: data.gz\n"), b""),
            ("front.nhdr", format!("{spacings}encoding: gz\nbyte skip: 7\ndata file: front.gz\n"), b""),
            ("front_last.nhdr", format!("{spacings}encoding: gz\nbyte skip: -1\ndata file: front.gz\n"), b""),
        ];
        for (name, rest, data) in kinds {
            let source = check(&write(folder, name, &[&header(&rest), data]), &options, all, SPACING);
            if rest.contains("directions") {
                assert!(close(source.geometry().origin(), [10.0, -20.0, 30.5]));
                assert!(close(source.geometry().direction()[1], [-1.0, 0.0, 0.0]));
            }
        }
    });
}

#[test]
fn units_of_length_become_millimetres() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = encode(&samples(SampleType::U8), Endian::Little);
    let text = meta_header(SampleType::U8, Endian::Little, "DistanceUnits = um\nElementDataFile = LOCAL\n");
    let source = open(&write(&folder, "a.mha", &[text.as_bytes(), &bytes]), &OpenOptions::default()).unwrap();
    assert!(close(source.geometry().spacing(), [0.5e-3, 0.75e-3, 1.25e-3]));
    assert!(close(source.geometry().origin(), [0.010, -0.020, 0.0305]));
    let rest = "space units: \"cm\" \"cm\" \"cm\"\nspacings: 1 2 3\nencoding: raw\n\n";
    let text = nrrd_header(SampleType::U8, Endian::Little, rest);
    let source = open(&write(&folder, "a.nrrd", &[&text, &bytes]), &OpenOptions::default()).unwrap();
    assert!(close(source.geometry().spacing(), [10.0, 20.0, 30.0]));
    let text = nrrd_header(SampleType::U8, Endian::Little, "encoding: raw\n\n");
    let source = open(&write(&folder, "b.nrrd", &[&text, &bytes]), &OpenOptions::default()).unwrap();
    assert!(source.notes()[0].contains("1 mm was taken"));
}
