//! TIFFs of every kind, written by the test: by hand, and by the `tiff` crate's encoder.

use super::*;

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
