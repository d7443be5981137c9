//! What every [`VolumeSource`] must do, and a file of every kind that is read, written by the test.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use rayon::prelude::*;
use tempfile::TempDir;

use super::source::crop;
use super::*;
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

/// A TIFF by hand: what common writers do not write.
struct TiffWriter {
    bytes: Vec<u8>,
    endian: Endian,
    big: bool,
}

impl TiffWriter {
    fn new(endian: Endian, big: bool) -> Self {
        let mut tiff = Self { bytes: Vec::new(), endian, big };
        tiff.bytes.extend_from_slice(if endian == Endian::Big { b"MM" } else { b"II" });
        tiff.number(if big { 43 } else { 42 }, 2);
        if big {
            tiff.number(8, 2);
            tiff.number(0, 2);
        }
        tiff.number(0, tiff.word());
        tiff
    }

    fn word(&self) -> usize {
        if self.big { 8 } else { 4 }
    }

    fn encoded(&self, value: u64, len: usize) -> Vec<u8> {
        match self.endian {
            Endian::Little => value.to_le_bytes()[..len].to_vec(),
            Endian::Big => value.to_be_bytes()[8 - len..].to_vec(),
        }
    }

    fn number(&mut self, value: u64, len: usize) {
        self.bytes.extend(self.encoded(value, len));
    }

    fn data(&mut self, data: &[u8]) -> u64 {
        let at = self.bytes.len() as u64;
        self.bytes.extend_from_slice(data);
        at
    }

    /// A directory; returns its offset and where its link to the next one is.
    fn directory(&mut self, entries: &[(u16, Vec<u64>)], text: &str) -> (u64, usize) {
        let word = self.word();
        let mut fields = Vec::new();
        for (tag, values) in entries {
            let raw: Vec<u8> = values.iter().flat_map(|&v| self.encoded(v, word)).collect();
            let field = if values.len() == 1 {
                raw
            } else {
                let at = self.data(&raw);
                self.encoded(at, word)
            };
            fields.push((*tag, if self.big { 16 } else { 4 }, values.len() as u64, field));
        }
        if !text.is_empty() {
            let at = self.data(text.as_bytes());
            fields.push((270, 2, text.len() as u64, self.encoded(at, word)));
        }
        fields.sort_by_key(|f| f.0);
        let at = self.bytes.len() as u64;
        self.number(fields.len() as u64, if self.big { 8 } else { 2 });
        for (tag, kind, count, field) in fields {
            self.number(u64::from(tag), 2);
            self.number(kind, 2);
            self.number(count, word);
            self.bytes.extend(field);
        }
        self.number(0, word);
        (at, self.bytes.len() - word)
    }

    fn link(&mut self, from: usize, to: u64) {
        let value = self.encoded(to, self.word());
        self.bytes[from..from + value.len()].copy_from_slice(&value);
    }

    fn first_link(&self) -> usize {
        if self.big { 8 } else { 4 }
    }
}

fn page_tags(sample: SampleType, rows: u64) -> Vec<(u16, Vec<u64>)> {
    let (bits, format) = match sample {
        SampleType::U8 => (8, 1),
        SampleType::U16 => (16, 1),
        SampleType::I16 => (16, 2),
        SampleType::F32 => (32, 3),
    };
    vec![
        (256, vec![7]),
        (257, vec![5]),
        (258, vec![bits]),
        (262, vec![1]),
        (278, vec![rows]),
        (339, vec![format]),
    ]
}

/// Pages written last to first, in strips of two rows that do not lie in order.
fn scattered_pages(sample: SampleType, endian: Endian, big: bool, bytes: &[u8]) -> TiffWriter {
    let mut tiff = TiffWriter::new(endian, big);
    let row = SIZE[0] * sample.bytes();
    let mut next = 0;
    for page in bytes.chunks(row * SIZE[1]).rev() {
        let strips: Vec<&[u8]> = page.chunks(2 * row).collect();
        let mut offsets: Vec<u64> = strips.iter().rev().map(|strip| tiff.data(strip)).collect();
        offsets.reverse();
        let mut tags = page_tags(sample, 2);
        tags.push((273, offsets));
        tags.push((279, strips.iter().map(|s| s.len() as u64).collect()));
        let (at, link) = tiff.directory(&tags, "");
        tiff.link(link, next);
        next = at;
    }
    tiff.link(tiff.first_link(), next);
    tiff
}

#[test]
fn tiff_by_hand_conforms() {
    for_all(|folder, sample, endian, all, bytes| {
        let options = OpenOptions { spacing: Some(SPACING), raw: None };
        for big in [false, true] {
            let tiff = scattered_pages(sample, endian, big, bytes);
            check(&write(folder, "pages.tif", &[&tiff.bytes]), &options, all, SPACING);
        }
        // ImageJ's way beyond 4 GB: one directory, all pages behind the first, and more after them.
        let mut tiff = TiffWriter::new(endian, false);
        let offset = tiff.data(bytes);
        let mut tags = page_tags(sample, 5);
        tags.extend([(273, vec![offset]), (279, vec![bytes.len() as u64 / 11])]);
        let (at, _) = tiff.directory(&tags, "ImageJ=1.53t\nimages=11\nslices=11\nloop=false\n\0");
        tiff.link(4, at);
        check(&write(folder, "imagej.tif", &[&tiff.bytes]), &options, all, SPACING);
        // Tiles of 4 x 3, uncompressed, the last ones padded.
        let mut tiff = TiffWriter::new(endian, false);
        let mut link = 4;
        let b = sample.bytes();
        for page in bytes.chunks(35 * b) {
            let mut offsets = Vec::new();
            for (top, left) in [(0, 0), (0, 4), (3, 0), (3, 4)] {
                let mut tile = vec![0xee; 12 * b];
                for y in top..(top + 3).min(5) {
                    let row = &page[(y * 7 + left) * b..(y * 7 + (left + 4).min(7)) * b];
                    tile[(y - top) * 4 * b..][..row.len()].copy_from_slice(row);
                }
                offsets.push(tiff.data(&tile));
            }
            let mut tags = page_tags(sample, 5);
            tags.retain(|(tag, _)| *tag != 278);
            tags.extend([(322, vec![4]), (323, vec![3]), (324, offsets), (325, vec![12 * b as u64; 4])]);
            let (at, next) = tiff.directory(&tags, "");
            tiff.link(link, at);
            link = next;
        }
        check(&write(folder, "tiles.tif", &[&tiff.bytes]), &options, all, SPACING);
    });
}

mod encoded {
    use super::*;
    use ::tiff::encoder::{Compression, TiffEncoder, TiffKindBig, colortype};
    use std::io::Cursor;

    fn compressions() -> Vec<Compression> {
        vec![
            Compression::Uncompressed,
            Compression::Lzw,
            Compression::Deflate(Default::default()),
            Compression::Packbits,
        ]
    }

    fn pages(all: &Samples, slices: std::ops::Range<usize>, compression: Compression) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut out).unwrap().with_compression(compression);
        let (w, h) = (SIZE[0] as u32, SIZE[1] as u32);
        for z in slices {
            let range = z * 35..(z + 1) * 35;
            match all {
                Samples::U8(v) => encoder.write_image::<colortype::Gray8>(w, h, &v[range]),
                Samples::U16(v) => encoder.write_image::<colortype::Gray16>(w, h, &v[range]),
                Samples::I16(v) => encoder.write_image::<colortype::GrayI16>(w, h, &v[range]),
                Samples::F32(v) => encoder.write_image::<colortype::Gray32Float>(w, h, &v[range]),
            }
            .unwrap();
        }
        out.into_inner()
    }

    #[test]
    fn compressed_files_and_folders_of_tiff_conform() {
        for sample in TYPES {
            let all = samples(sample);
            for compression in compressions() {
                let folder = tempfile::tempdir().unwrap();
                let path = write(&folder, "stack.tif", &[&pages(&all, 0..11, compression)]);
                let options = OpenOptions { spacing: Some(SPACING), raw: None };
                check(&path, &options, &all, SPACING);

                let slices = tempfile::tempdir().unwrap();
                for z in 0..SIZE[2] {
                    // From 5 to 15: the order of names is not the order of numbers.
                    write(&slices, &format!("s_{}_v2.TIF", z + 5), &[&pages(&all, z..z + 1, compression)]);
                }
                write(&slices, "readme.txt", &[b"not a slice"]);
                write(&slices, "._s_3_v2.tif", &[b"what a Mac leaves behind"]);
                check(slices.path(), &options, &all, SPACING);
                fs::remove_file(slices.path().join("s_9_v2.TIF")).unwrap();
                let error = open(slices.path(), &options).err().unwrap();
                assert!(matches!(error, VolumeError::MissingSlice { missing: 9, .. }), "{error}");
            }
        }
    }

    #[test]
    fn a_big_tiff_is_read() {
        let all = samples(SampleType::U16);
        let Samples::U16(values) = &all else { unreachable!() };
        let mut out = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::<_, TiffKindBig>::new_generic(&mut out).unwrap();
        for page in values.chunks(35) {
            encoder.write_image::<colortype::Gray16>(7, 5, page).unwrap();
        }
        let folder = tempfile::tempdir().unwrap();
        // No extension: found by its first bytes.
        check(&write(&folder, "big", &[&out.into_inner()]), &OpenOptions::default(), &all, [1.0; 3]);
    }

    #[test]
    fn unequal_slices_are_refused_with_both_sizes() {
        let folder = tempfile::tempdir().unwrap();
        let encode = |name: &str, w: u32, h: u32, wide: bool| {
            let mut out = Cursor::new(Vec::new());
            let mut encoder = TiffEncoder::new(&mut out).unwrap();
            let n = (w * h) as usize;
            if wide {
                encoder.write_image::<colortype::Gray16>(w, h, &vec![3; n]).unwrap();
            } else {
                encoder.write_image::<colortype::Gray8>(w, h, &vec![3; n]).unwrap();
            }
            write(&folder, name, &[&out.into_inner()]);
        };
        encode("s1.tif", 4, 3, false);
        encode("s2.tif", 4, 5, false);
        let error = open(folder.path(), &OpenOptions::default()).err().unwrap().to_string();
        assert!(
            error.contains("4 x 3 u8") && error.contains("4 x 5 u8") && error.contains("s2.tif"),
            "{error}"
        );
        encode("s2.tif", 4, 3, true);
        let error = open(folder.path(), &OpenOptions::default()).err().unwrap().to_string();
        assert!(error.contains("4 x 3 u8") && error.contains("4 x 3 u16"), "{error}");
    }
}

#[test]
fn a_loop_of_directories_ends_in_an_error() {
    let bytes = encode(&samples(SampleType::U8), Endian::Little);
    let tiff = scattered_pages(SampleType::U8, Endian::Little, false, &bytes);
    let folder = tempfile::tempdir().unwrap();
    let first = u32::from_le_bytes(tiff.bytes[4..8].try_into().unwrap());
    // The last directory in the chain was written first: its link is the only zero one.
    let mut looped = tiff.bytes.clone();
    let mut at = first as usize;
    let link = loop {
        let link = at + 2 + 12 * usize::from(u16::from_le_bytes([looped[at], looped[at + 1]]));
        let next = u32::from_le_bytes(looped[link..link + 4].try_into().unwrap());
        if next == 0 {
            break link;
        }
        at = next as usize;
    };
    looped[link..link + 4].copy_from_slice(&first.to_le_bytes());
    let error = open(&write(&folder, "loop.tif", &[&looped]), &OpenOptions::default()).err().unwrap();
    assert!(error.to_string().contains("lead back"), "{error}");
}

#[test]
fn a_few_bytes_shown_as_many_pages_or_as_a_large_tile_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |name: &str, tiff: &TiffWriter| {
        let path = write(&folder, name, &[&tiff.bytes]);
        match open(&path, &OpenOptions::default()).and_then(|source| source.read_all()) {
            Err(error) => error,
            Ok(_) => panic!("{name} was read"),
        }
    };
    let mut tiff = TiffWriter::new(Endian::Little, false);
    let strip = tiff.data(&[5; 60_000]);
    let mut link = tiff.first_link();
    for _ in 0..500 {
        let tags =
            [(256, vec![300]), (257, vec![200]), (258, vec![8]), (273, vec![strip]), (279, vec![60_000])];
        let (at, next) = tiff.directory(&tags, "");
        tiff.link(link, at);
        link = next;
    }
    assert!(matches!(refused("alias.tif", &tiff), VolumeError::Truncated { needed: 30_000_000, .. }));

    for compression in [1, 5, 8, 32773] {
        let mut tiff = TiffWriter::new(Endian::Little, false);
        let tile = tiff.data(&zlib(&[1; 4096]));
        let tags = [
            (256, vec![64]),
            (257, vec![64]),
            (258, vec![8]),
            (259, vec![compression]),
            (322, vec![30_000]),
            (323, vec![30_000]),
            (324, vec![tile]),
            (325, vec![30]),
        ];
        let (at, _) = tiff.directory(&tags, "");
        tiff.link(tiff.first_link(), at);
        assert!(matches!(refused("tile.tif", &tiff), VolumeError::Truncated { needed: 900_000_000, .. }));
    }
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
