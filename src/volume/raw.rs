//! Uncompressed samples in a file: headerless, or behind a header that another reader parsed.
//!
//! Only the rows of the box are read, by positioned reads, so any number of threads may read at
//! once. The file's length is checked against size and type before anything is allocated.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::collect::{Collector, Endian};
use super::positioned::PositionedFile;
use super::source::{SPACING_ASSUMED, check_box};
use super::{SampleType, Samples, VolumeError, VolumeSource};
use crate::execution::Execution;
use crate::grid::{Geometry, VoxelBox};

/// How headerless samples lie in their file, x fastest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawLayout {
    /// Voxels per axis (x, y, z).
    pub size: [usize; 3],
    /// Number type of the samples.
    #[serde(rename = "type")]
    pub sample_type: SampleType,
    /// Byte order of the samples.
    #[serde(default)]
    pub endian: Endian,
    /// Bytes to skip at the file's start.
    #[serde(default)]
    pub offset: u64,
}

/// Opens headerless samples. The spacing is 1 mm.
///
/// # Errors
/// [`VolumeError::Truncated`] or [`VolumeError::Excess`] unless the file holds exactly the offset
/// and the samples; [`VolumeError::Geometry`] if the size is not usable.
pub(crate) fn open(path: &Path, layout: &RawLayout) -> Result<RawSource, VolumeError> {
    let geometry = Geometry::axis_aligned(layout.size, [1.0; 3])
        .map_err(|error| VolumeError::Geometry { path: path.to_owned(), error })?;
    let file = PositionedFile::open(path)?;
    let needed = sample_bytes(&geometry, layout.sample_type);
    let extra = file.len().saturating_sub(layout.offset).saturating_sub(needed);
    if extra > 0 {
        return Err(VolumeError::Excess { path: path.to_owned(), needed, extra });
    }
    let source = RawSource::new(file, geometry, layout.sample_type, layout.endian, layout.offset)?;
    Ok(source.with_notes(vec![SPACING_ASSUMED.to_owned()]))
}

/// Bytes that the samples of a volume take, uncompressed.
pub(crate) fn sample_bytes(geometry: &Geometry, sample: SampleType) -> u64 {
    // No overflow: a geometry has at most isize::MAX / 8 voxels.
    geometry.voxels() as u64 * sample.bytes() as u64
}

/// Uncompressed samples in a file, x fastest.
#[derive(Debug)]
pub(crate) struct RawSource {
    file: PositionedFile,
    geometry: Geometry,
    sample: SampleType,
    endian: Endian,
    offset: u64,
    notes: Vec<String>,
}

impl RawSource {
    /// Samples from `offset` on. Bytes behind them are noted if they are less than a slice, and
    /// refused otherwise: then the header has probably the wrong size.
    pub(crate) fn new(
        file: PositionedFile,
        geometry: Geometry,
        sample: SampleType,
        endian: Endian,
        offset: u64,
    ) -> Result<Self, VolumeError> {
        let mut source = Self::within(file, geometry, sample, endian, offset)?;
        let needed = sample_bytes(&source.geometry, sample);
        let extra = source.file.len() - offset - needed;
        if extra >= needed / source.geometry.size()[2] as u64 {
            return Err(VolumeError::Excess { path: source.file.path().to_owned(), needed, extra });
        }
        if extra > 0 {
            source.notes.push(format!("{extra} bytes behind the samples were left unread"));
        }
        Ok(source)
    }

    /// Samples from `offset` on, in a file where other things may follow them.
    pub(crate) fn within(
        file: PositionedFile,
        geometry: Geometry,
        sample: SampleType,
        endian: Endian,
        offset: u64,
    ) -> Result<Self, VolumeError> {
        let needed = sample_bytes(&geometry, sample);
        let got = file.len().saturating_sub(offset);
        if got < needed {
            return Err(VolumeError::Truncated { path: file.path().to_owned(), needed, got });
        }
        Ok(Self { file, geometry, sample, endian, offset, notes: Vec::new() })
    }

    /// Adds remarks of the reader that parsed the header.
    pub(crate) fn with_notes(mut self, notes: Vec<String>) -> Self {
        self.notes.extend(notes);
        self
    }
}

/// Rows of samples in a file, one behind the other: the lines of a plane, of all planes, of a strip.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows {
    /// Where the first row begins, in bytes.
    pub(crate) offset: u64,
    /// Bytes of a row.
    pub(crate) row: usize,
}

impl Rows {
    /// Hands the bytes `columns` of each of the rows `rows` to `push`, in order.
    pub(crate) fn read(
        self,
        file: &PositionedFile,
        columns: Range<usize>,
        rows: Range<u64>,
        mut push: impl FnMut(&[u8]) -> Result<(), VolumeError>,
    ) -> Result<(), VolumeError> {
        /// Bytes read at a time: enough to make system calls cheap, little enough for a cache.
        const BLOCK: usize = 1 << 20;
        // Whole rows are read together and cut, unless most of each row would be thrown away.
        if columns.len() * 4 < self.row {
            let mut buffer = vec![0; columns.len()];
            return rows.into_iter().try_for_each(|row| {
                file.read_exact(self.offset + row * self.row as u64 + columns.start as u64, &mut buffer)?;
                push(&buffer)
            });
        }
        let together = (BLOCK / self.row).max(1) as u64;
        let mut buffer = Vec::new();
        let mut first = rows.start;
        while first < rows.end {
            let count = together.min(rows.end - first);
            buffer.resize(count as usize * self.row, 0);
            file.read_exact(self.offset + first * self.row as u64, &mut buffer)?;
            if columns.len() == self.row {
                push(&buffer)?;
            } else {
                buffer.chunks_exact(self.row).try_for_each(|line| push(&line[columns.clone()]))?;
            }
            first += count;
        }
        Ok(())
    }
}

impl VolumeSource for RawSource {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn sample_type(&self) -> SampleType {
        self.sample
    }

    fn cheap_partial_reads(&self) -> bool {
        true
    }

    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
        let mut out = Samples::none(self.sample);
        self.append(part, &mut out, &Execution::default())?;
        Ok(out)
    }

    fn append(&self, part: &VoxelBox, out: &mut Samples, execution: &Execution) -> Result<(), VolumeError> {
        let size = self.geometry.size();
        check_box(part, size)?;
        let mut out = Collector::new(self.sample, part, out)?;
        let bytes = self.sample.bytes();
        let row = size[0] * bytes;
        if part.size()[..2] == size[..2] {
            let start = self.offset + (part.low[2] * size[1]) as u64 * row as u64;
            out.fill(self.endian, |position, block| {
                execution.check()?;
                self.file.read_exact(start + position, block)
            })?;
            return out.finish();
        }
        out.reserve_all()?;
        let rows = Rows { offset: self.offset, row };
        let columns = part.low[0] * bytes..part.high[0] * bytes;
        for z in part.low[2]..part.high[2] {
            execution.check()?;
            let lines = (z * size[1] + part.low[1]) as u64..(z * size[1] + part.high[1]) as u64;
            rows.read(&self.file, columns.clone(), lines, |bytes| out.push(bytes, self.endian))?;
        }
        out.finish()
    }

    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }
}
