//! One image file directory of a TIFF: its tags as whole numbers and text.
//!
//! A tag's values are read only if they lie inside the file, so memory is bounded by the file's
//! length whatever the directory claims.

use crate::volume::VolumeError;
use crate::volume::collect::Endian;
use crate::volume::positioned::PositionedFile;

/// Tag numbers, as in the TIFF 6.0 specification.
pub(super) mod tag {
    pub(crate) const WIDTH: u16 = 256;
    pub(crate) const HEIGHT: u16 = 257;
    pub(crate) const BITS: u16 = 258;
    pub(crate) const COMPRESSION: u16 = 259;
    pub(crate) const PHOTOMETRIC: u16 = 262;
    pub(crate) const FILL_ORDER: u16 = 266;
    pub(crate) const DESCRIPTION: u16 = 270;
    pub(crate) const STRIP_OFFSETS: u16 = 273;
    pub(crate) const ORIENTATION: u16 = 274;
    pub(crate) const CHANNELS: u16 = 277;
    pub(crate) const ROWS_PER_STRIP: u16 = 278;
    pub(crate) const STRIP_LENGTHS: u16 = 279;
    pub(crate) const PREDICTOR: u16 = 317;
    pub(crate) const TILE_WIDTH: u16 = 322;
    pub(crate) const TILE_HEIGHT: u16 = 323;
    pub(crate) const TILE_OFFSETS: u16 = 324;
    pub(crate) const TILE_LENGTHS: u16 = 325;
    pub(crate) const SAMPLE_FORMAT: u16 = 339;
}

/// Byte order and offset width of a TIFF file, and where its first directory is.
#[derive(Debug, Clone, Copy)]
pub(super) struct FileHeader {
    pub(super) endian: Endian,
    /// BigTIFF: 64-bit offsets.
    pub(super) big: bool,
    pub(super) first: u64,
}

impl FileHeader {
    /// Reads the first bytes of a TIFF.
    pub(super) fn read(file: &PositionedFile) -> Result<Self, VolumeError> {
        let start = file.start(16)?;
        let endian = match start.get(..2) {
            Some(b"II") => Endian::Little,
            Some(b"MM") => Endian::Big,
            _ => return Err(malformed(file, "it does not begin with II or MM")),
        };
        let short = || malformed(file, "it ends within its header");
        match number(start.get(2..4).ok_or_else(short)?, endian) {
            42 => {
                let first = number(start.get(4..8).ok_or_else(short)?, endian);
                Ok(Self { endian, big: false, first })
            }
            43 if number(start.get(4..6).ok_or_else(short)?, endian) == 8 => {
                let first = number(start.get(8..16).ok_or_else(short)?, endian);
                Ok(Self { endian, big: true, first })
            }
            version => {
                Err(malformed(file, &format!("its version is {version}, not 42 (TIFF) or 43 (BigTIFF)")))
            }
        }
    }
}

struct Entry {
    tag: u16,
    kind: u16,
    count: u64,
    /// The value itself if it fits, else its offset.
    field: Vec<u8>,
}

/// One directory.
pub(super) struct Directory<'a> {
    file: &'a PositionedFile,
    header: FileHeader,
    entries: Vec<Entry>,
    /// Offset of the next directory; 0: none.
    pub(super) next: u64,
}

impl<'a> Directory<'a> {
    /// Reads the directory at `offset`.
    pub(super) fn read(
        file: &'a PositionedFile,
        header: FileHeader,
        offset: u64,
    ) -> Result<Self, VolumeError> {
        let outside = || malformed(file, &format!("a directory at offset {offset} reaches beyond its end"));
        let (count_len, entry_len) = if header.big { (8, 20) } else { (2, 12) };
        let mut count = vec![0; count_len];
        let bytes = |at: u64, buffer: &mut [u8]| file.read_exact(at, buffer).map_err(|_| outside());
        bytes(offset, &mut count)?;
        let count = number(&count, header.endian);
        let table = offset + count_len as u64;
        let len = count.checked_mul(entry_len as u64).filter(|len| *len <= file.len()).ok_or_else(outside)?;
        let mut raw = vec![0; len as usize];
        bytes(table, &mut raw)?;
        let entries = raw.chunks_exact(entry_len).map(|e| Entry {
            tag: number(&e[..2], header.endian) as u16,
            kind: number(&e[2..4], header.endian) as u16,
            count: number(if header.big { &e[4..12] } else { &e[4..8] }, header.endian),
            field: e[if header.big { 12 } else { 8 }..].to_vec(),
        });
        let entries = entries.collect();
        let mut next = vec![0; if header.big { 8 } else { 4 }];
        // Some writers leave out the offset of a next directory after the last one.
        let next = match bytes(table + len, &mut next) {
            Ok(()) => number(&next, header.endian),
            Err(_) => 0,
        };
        Ok(Self { file, header, entries, next })
    }

    /// The raw bytes of a tag's values, and the bytes of one value.
    fn bytes(&self, tag: u16) -> Result<Option<(Vec<u8>, usize, u16)>, VolumeError> {
        let Some(entry) = self.entries.iter().find(|e| e.tag == tag) else { return Ok(None) };
        let width = match entry.kind {
            1 | 2 | 6 | 7 => 1,
            3 | 8 => 2,
            4 | 9 | 11 | 13 => 4,
            5 | 10 | 12 | 16 | 17 | 18 => 8,
            kind => return Err(malformed(self.file, &format!("tag {tag} has the unknown type {kind}"))),
        };
        let len = entry.count.checked_mul(width as u64).filter(|len| *len <= self.file.len());
        let len = len.ok_or_else(|| {
            malformed(
                self.file,
                &format!("tag {tag} claims {} values, more than the file holds", entry.count),
            )
        })? as usize;
        if len <= entry.field.len() {
            return Ok(Some((entry.field[..len].to_vec(), width, entry.kind)));
        }
        let mut values = vec![0; len];
        let offset = number(&entry.field, self.header.endian);
        self.file
            .read_exact(offset, &mut values)
            .map_err(|_| malformed(self.file, &format!("the values of tag {tag} lie beyond its end")))?;
        Ok(Some((values, width, entry.kind)))
    }

    /// The values of a tag as whole numbers; empty if the tag is not there.
    pub(super) fn numbers(&self, tag: u16) -> Result<Vec<u64>, VolumeError> {
        let Some((bytes, width, kind)) = self.bytes(tag)? else { return Ok(Vec::new()) };
        if !matches!(kind, 1 | 3 | 4 | 13 | 16 | 18) {
            return Err(malformed(self.file, &format!("tag {tag} holds no whole numbers (type {kind})")));
        }
        Ok(bytes.chunks_exact(width).map(|v| number(v, self.header.endian)).collect())
    }

    /// The single value of a tag, or `default`.
    pub(super) fn number(&self, tag: u16, default: u64) -> Result<u64, VolumeError> {
        Ok(self.numbers(tag)?.first().copied().unwrap_or(default))
    }

    /// The text of a tag; empty if the tag is not there.
    pub(super) fn text(&self, tag: u16) -> Result<String, VolumeError> {
        let bytes = self.bytes(tag)?.map(|(bytes, ..)| bytes).unwrap_or_default();
        Ok(String::from_utf8_lossy(&bytes).trim_end_matches('\0').to_owned())
    }

    /// The file it is from.
    pub(super) fn file(&self) -> &'a PositionedFile {
        self.file
    }

    /// Header of the file it is from.
    pub(super) fn header(&self) -> FileHeader {
        self.header
    }
}

/// An unsigned number of up to eight bytes.
fn number(bytes: &[u8], endian: Endian) -> u64 {
    let step = |value: u64, byte: &u8| value << 8 | u64::from(*byte);
    match endian {
        Endian::Big => bytes.iter().fold(0, step),
        Endian::Little => bytes.iter().rev().fold(0, step),
    }
}

/// The file is no proper TIFF.
pub(super) fn malformed(file: &PositionedFile, reason: &str) -> VolumeError {
    VolumeError::Malformed { path: file.path().to_owned(), format: "TIFF", reason: reason.to_owned() }
}
