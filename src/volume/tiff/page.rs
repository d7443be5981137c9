//! One page of a TIFF: what it is, where its rows are, and reading a part of it.
//!
//! Uncompressed strips are read by position, only the rows asked for. Compressed strips and tiles
//! are decoded by the `tiff` crate, one at a time and only those that the part touches; before
//! that their size is checked against what their compressed bytes can hold.

use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use ::tiff::decoder::{Decoder, Limits};

use super::directory::{Directory, malformed, tag};
use crate::volume::collect::Endian;
use crate::volume::positioned::PositionedFile;
use crate::volume::raw::Rows;
use crate::volume::stream::DEFLATE_LIMIT;
use crate::volume::{SampleType, VolumeError};

/// What a writer could use instead of something unsupported.
const SUPPORTED: &str = "grey pages of one channel (black is zero, not turned), of 8- or 16-bit unsigned, \
     16-bit signed or 32-bit floating-point samples, uncompressed or compressed by LZW, deflate or PackBits";

/// No tile or strip that is decoded at once is larger than this many bytes: a page of
/// 32768 x 8192 samples of 32 bits.
const LARGEST_CHUNK: u64 = 1 << 30;

/// A page: a grey image of one channel.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Page {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) sample: SampleType,
    pub(super) endian: Endian,
    data: Data,
}

/// Where the samples of a page are.
#[derive(Debug, Clone, PartialEq)]
enum Data {
    /// Uncompressed strips of `rows` rows each, at these offsets. One offset stands for strips that
    /// lie one behind the other.
    Strips { offsets: Vec<u64>, rows: usize },
    /// Compressed strips, or tiles, of the directory at this offset. `expansion`: bytes that its
    /// compression can make of one.
    Chunks { directory: u64, width: usize, height: usize, expansion: u64 },
}

impl Page {
    /// What the directory at `offset` describes.
    pub(super) fn new(directory: &Directory<'_>, offset: u64) -> Result<Self, VolumeError> {
        let file = directory.file();
        let side = |tag: u16, name: &str| -> Result<usize, VolumeError> {
            let value = directory.number(tag, 0)?;
            usize::try_from(value).ok().filter(|v| (1..=1 << 24).contains(v)).ok_or_else(|| {
                VolumeError::Header {
                    path: file.path().to_owned(),
                    field: name.to_owned(),
                    value: value.to_string(),
                    expected: "1 or more pixels (and not more than millions)".to_owned(),
                }
            })
        };
        let (width, height) = (side(tag::WIDTH, "ImageWidth")?, side(tag::HEIGHT, "ImageLength")?);
        let sample = sample_type(directory)?;
        let data = data(directory, offset, [width, height], sample)?;
        Ok(Self { width, height, sample, endian: directory.header().endian, data })
    }

    /// Width and height in pixels.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Where the samples begin, if all rows lie one behind the other, uncompressed.
    pub(super) fn contiguous(&self) -> Option<u64> {
        match &self.data {
            Data::Strips { offsets, rows } if *rows >= self.height => offsets.first().copied(),
            _ => None,
        }
    }

    /// Bytes that this page must take in its file at least.
    pub(super) fn least_bytes(&self) -> u64 {
        let bytes = self.width as u64 * self.height as u64 * self.sample.bytes() as u64;
        match self.data {
            Data::Strips { .. } => bytes,
            Data::Chunks { expansion, .. } => bytes / expansion,
        }
    }

    /// The samples of some columns of some lines, as bytes, and their byte order.
    pub(super) fn read(
        &self,
        file: &PositionedFile,
        columns: Range<usize>,
        lines: Range<usize>,
    ) -> Result<(Vec<u8>, Endian), VolumeError> {
        match &self.data {
            Data::Strips { offsets, rows } => {
                let bytes = self.read_strips(file, offsets, *rows, columns, lines)?;
                Ok((bytes, self.endian))
            }
            Data::Chunks { directory, width, height, .. } => {
                let bytes = self.decode(file, *directory, [*width, *height], columns, lines)?;
                Ok((bytes, Endian::NATIVE))
            }
        }
    }

    fn read_strips(
        &self,
        file: &PositionedFile,
        offsets: &[u64],
        rows: usize,
        columns: Range<usize>,
        lines: Range<usize>,
    ) -> Result<Vec<u8>, VolumeError> {
        let bytes = self.sample.bytes();
        let columns = columns.start * bytes..columns.end * bytes;
        let mut out = Vec::new();
        let mut line = lines.start;
        while line < lines.end {
            let strip = line / rows;
            let end = lines.end.min((strip + 1) * rows);
            let within = (line - strip * rows) as u64..(end - strip * rows) as u64;
            let strip = Rows { offset: offsets[strip], row: self.width * bytes };
            strip.read(file, columns.clone(), within, |row| {
                out.extend_from_slice(row);
                Ok(())
            })?;
            line = end;
        }
        Ok(out)
    }

    /// Decodes the chunks that a part touches, one band of chunks at a time.
    fn decode(
        &self,
        file: &PositionedFile,
        directory: u64,
        chunk: [usize; 2],
        columns: Range<usize>,
        lines: Range<usize>,
    ) -> Result<Vec<u8>, VolumeError> {
        let fail = |error: ::tiff::TiffError| malformed(file, &error.to_string());
        let mut limits = Limits::default();
        limits.decoding_buffer_size = LARGEST_CHUNK as usize;
        limits.intermediate_buffer_size = usize::try_from(file.len()).unwrap_or(usize::MAX);
        let reader = OnePage::new(file, directory, self.endian).map_err(|e| fail(e.into()))?;
        let mut decoder = Decoder::new(reader).map_err(fail)?.with_limits(limits);
        let bytes = self.sample.bytes();
        let across = self.width.div_ceil(chunk[0]);
        let mut out = Vec::new();
        for band in lines.start / chunk[1]..lines.end.div_ceil(chunk[1]) {
            let top = band * chunk[1];
            let rows = lines.start.max(top)..lines.end.min(top + chunk[1]);
            let begin = out.len();
            let out_row = columns.len() * bytes;
            for tile in columns.start / chunk[0]..columns.end.div_ceil(chunk[0]) {
                let index =
                    u32::try_from(band * across + tile).map_err(|_| malformed(file, "too many tiles"))?;
                let layout = decoder.image_chunk_buffer_layout(index).map_err(fail)?;
                let mut decoded = vec![0; layout.len];
                decoder.read_chunk_bytes(index, &mut decoded).map_err(fail)?;
                // Only now, that data really came out, room is made for it.
                out.resize(begin + rows.len() * out_row, 0);
                let left = tile * chunk[0];
                let wanted = columns.start.max(left)..columns.end.min(left + chunk[0]);
                let row = (self.width - left).min(chunk[0]) * bytes;
                for (i, y) in rows.clone().enumerate() {
                    let from = (y - top) * row + (wanted.start - left) * bytes;
                    let to = begin + i * out_row + (wanted.start - columns.start) * bytes;
                    let len = wanted.len() * bytes;
                    let source = decoded.get(from..from + len).ok_or_else(|| {
                        malformed(file, "a strip or tile is smaller than its directory says")
                    })?;
                    out[to..to + len].copy_from_slice(source);
                }
            }
        }
        Ok(out)
    }
}

fn unsupported(directory: &Directory<'_>, feature: String) -> VolumeError {
    VolumeError::Unsupported { path: directory.file().path().to_owned(), feature, supported: SUPPORTED }
}

fn sample_type(directory: &Directory<'_>) -> Result<SampleType, VolumeError> {
    let refuse = |feature: String| Err(unsupported(directory, feature));
    match directory.number(tag::PHOTOMETRIC, 1)? {
        1 => {}
        0 => return refuse("a page where white is zero".into()),
        2 => return refuse("a colour page (RGB)".into()),
        3 => return refuse("a page with a colour palette".into()),
        6 => return refuse("a colour page (YCbCr)".into()),
        other => return refuse(format!("photometric interpretation {other}")),
    }
    let channels = directory.number(tag::CHANNELS, 1)?;
    if channels != 1 {
        return refuse(format!("a page of {channels} channels"));
    }
    match directory.number(tag::ORIENTATION, 1)? {
        // 0 is no valid orientation, but some scanners write it for "not known".
        0 | 1 => {}
        other => return refuse(format!("a turned or mirrored page (orientation {other})")),
    }
    if directory.number(tag::FILL_ORDER, 1)? != 1 {
        return refuse("a page with its bits in reverse order".into());
    }
    let format = directory.number(tag::SAMPLE_FORMAT, 1)?;
    match (directory.number(tag::BITS, 1)?, format) {
        // Format 4 is "not defined", to be taken as unsigned.
        (8, 1 | 4) => Ok(SampleType::U8),
        (16, 1 | 4) => Ok(SampleType::U16),
        (16, 2) => Ok(SampleType::I16),
        (32, 3) => Ok(SampleType::F32),
        (bits, 1 | 4) => refuse(format!("a page of {bits}-bit unsigned samples")),
        (bits, 2) => refuse(format!("a page of {bits}-bit signed samples")),
        (bits, 3) => refuse(format!("a page of {bits}-bit floating-point samples")),
        (bits, other) => refuse(format!("a page of {bits}-bit samples of format {other}")),
    }
}

fn data(
    directory: &Directory<'_>,
    at: u64,
    [width, height]: [usize; 2],
    sample: SampleType,
) -> Result<Data, VolumeError> {
    let file = directory.file();
    let row = width as u64 * sample.bytes() as u64;
    let compression = directory.number(tag::COMPRESSION, 1)?;
    let refuse = |feature: String| Err(unsupported(directory, feature));
    let expansion = match compression {
        1 => 1,
        // A code of at least nine bits stands for at most 4096 bytes.
        5 => 4096,
        8 | 32946 => DEFLATE_LIMIT,
        // Two bytes stand for at most 128.
        32773 => 64,
        2..=4 => return refuse("fax compression".into()),
        6 | 7 => return refuse("JPEG compression".into()),
        50000 => return refuse("Zstandard compression".into()),
        other => return refuse(format!("compression {other}")),
    };
    let predictor = directory.number(tag::PREDICTOR, 1)?;
    if compression == 1 && predictor != 1 {
        return refuse(format!("predictor {predictor} without compression"));
    }
    let tiles = directory.numbers(tag::TILE_OFFSETS)?;
    let tiled = !tiles.is_empty();
    let (offsets, lengths, chunk) = if tiled {
        let side = |tag| -> Result<usize, VolumeError> {
            let value = directory.number(tag, 0)?;
            usize::try_from(value)
                .ok()
                .filter(|v| (1..=1 << 24).contains(v))
                .ok_or_else(|| malformed(file, &format!("its tiles are {value} pixels wide or high")))
        };
        let chunk = [side(tag::TILE_WIDTH)?, side(tag::TILE_HEIGHT)?];
        (tiles, directory.numbers(tag::TILE_LENGTHS)?, chunk)
    } else {
        let rows = directory.number(tag::ROWS_PER_STRIP, u64::from(u32::MAX))?.clamp(1, height as u64);
        let offsets = directory.numbers(tag::STRIP_OFFSETS)?;
        (offsets, directory.numbers(tag::STRIP_LENGTHS)?, [width, rows as usize])
    };
    let needed = width.div_ceil(chunk[0]) * height.div_ceil(chunk[1]);
    if offsets.len() != needed {
        let reason = format!("a page has {} strips or tiles where its size asks for {needed}", offsets.len());
        return Err(malformed(file, &reason));
    }
    if compression == 1 && !tiled {
        return strips(file, offsets, row, chunk[1], height);
    }
    if lengths.len() != needed {
        return Err(malformed(file, "its strips or tiles have no lengths"));
    }
    let largest = chunk[0] as u64 * chunk[1] as u64 * sample.bytes() as u64;
    if largest > LARGEST_CHUNK {
        return refuse(format!("a strip or tile of {largest} bytes"));
    }
    // Each strip or tile must be able to hold what is to come out of it, before room is made for it.
    for (i, length) in lengths.iter().enumerate() {
        let rows = if tiled { chunk[1] } else { chunk[1].min(height - i * chunk[1]) };
        let needed = chunk[0] as u64 * rows as u64 * sample.bytes() as u64;
        let got = (*length).min(file.len()).saturating_mul(expansion);
        if got < needed {
            return Err(VolumeError::Truncated { path: file.path().to_owned(), needed, got });
        }
    }
    Ok(Data::Chunks { directory: at, width: chunk[0], height: chunk[1], expansion })
}

/// Uncompressed strips, which must all lie inside the file.
fn strips(
    file: &PositionedFile,
    offsets: Vec<u64>,
    row: u64,
    rows: usize,
    height: usize,
) -> Result<Data, VolumeError> {
    let strip = row * rows as u64;
    let last = row * (height - (offsets.len() - 1) * rows) as u64;
    for (i, offset) in offsets.iter().enumerate() {
        let needed = if i + 1 < offsets.len() { strip } else { last };
        let got = file.len().saturating_sub(*offset);
        if got < needed {
            return Err(VolumeError::Truncated { path: file.path().to_owned(), needed, got });
        }
    }
    let contiguous = offsets.windows(2).all(|pair| pair[1] == pair[0] + strip);
    Ok(if contiguous {
        Data::Strips { offsets: offsets[..1].to_vec(), rows: height }
    } else {
        Data::Strips { offsets, rows }
    })
}

/// The file as if its header named the directory at a given offset as the first: so any page is
/// reached at once, without a walk along all directories before it.
struct OnePage<'a> {
    file: &'a PositionedFile,
    /// The changed first bytes.
    start: Vec<u8>,
    position: u64,
    block: Vec<u8>,
    block_at: u64,
}

impl<'a> OnePage<'a> {
    fn new(file: &'a PositionedFile, directory: u64, endian: Endian) -> io::Result<Self> {
        let mut start = vec![0; 16];
        let got = file.read_up_to(0, &mut start)?;
        start.truncate(got);
        // Version 43, in either byte order: BigTIFF.
        let big = matches!(start.get(2..4), Some([43, 0] | [0, 43]));
        let offset = if big { 8..16 } else { 4..8 };
        let value = match endian {
            Endian::Little => directory.to_le_bytes()[..offset.len()].to_vec(),
            Endian::Big => directory.to_be_bytes()[8 - offset.len()..].to_vec(),
        };
        start.get_mut(offset).ok_or(io::ErrorKind::UnexpectedEof)?.copy_from_slice(&value);
        start.truncate(if big { 16 } else { 8 });
        Ok(Self { file, start, position: 0, block: Vec::new(), block_at: 0 })
    }
}

impl Read for OnePage<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        /// Directories are read number by number; a block saves most system calls.
        const BLOCK: usize = 1 << 16;
        if let Some(start) = usize::try_from(self.position).ok().and_then(|at| self.start.get(at..))
            && !start.is_empty()
        {
            let n = start.len().min(buffer.len());
            buffer[..n].copy_from_slice(&start[..n]);
            self.position += n as u64;
            return Ok(n);
        }
        if buffer.len() >= BLOCK {
            let n = self.file.read_up_to(self.position, buffer)?;
            self.position += n as u64;
            return Ok(n);
        }
        let inside = |at: u64, len: usize, position: u64| position >= at && position < at + len as u64;
        if !inside(self.block_at, self.block.len(), self.position) {
            self.block.resize(BLOCK, 0);
            let n = self.file.read_up_to(self.position, &mut self.block)?;
            self.block.truncate(n);
            self.block_at = self.position;
        }
        let from = &self.block[(self.position - self.block_at) as usize..];
        let n = from.len().min(buffer.len());
        buffer[..n].copy_from_slice(&from[..n]);
        self.position += n as u64;
        Ok(n)
    }
}

impl Seek for OnePage<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.position.checked_add_signed(by),
            SeekFrom::End(by) => self.file.len().checked_add_signed(by),
        };
        // Close to the type's end a position plus a block would overflow, and no file is so long.
        let position = position.filter(|p| *p <= i64::MAX as u64).ok_or(io::ErrorKind::InvalidInput)?;
        self.position = position;
        Ok(position)
    }
}
