//! Compressed samples (zlib or gzip) behind a header that another reader parsed.
//!
//! A stream is decompressed from its start up to the last row of the box, and no further. Memory
//! grows with the bytes that come out, up to the box; a stream that is shorter than the header
//! says, or (seen when the last row is read) longer, is refused.

use std::io::{self, BufRead, BufReader, Read};

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};

use super::collect::{Collector, Endian};
use super::positioned::{PositionedFile, io_error};
use super::raw::sample_bytes;
use super::source::check_box;
use super::{SampleType, Samples, VolumeError, VolumeSource};
use crate::grid::{Geometry, VoxelBox};

/// Deflate cannot make more than this of one byte (zlib's documentation: 1032 to 1).
pub(crate) const DEFLATE_LIMIT: u64 = 1032;

/// Where a compressed stream lies in its file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StreamExtent {
    /// First byte.
    pub(crate) offset: u64,
    /// Bytes, or `None` up to the end of the file.
    pub(crate) len: Option<u64>,
}

/// What to skip of the decompressed bytes before the samples begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Skip {
    /// This many bytes.
    Bytes(u64),
    /// Whatever there is: the samples are the last bytes.
    ToLast,
}

/// Compressed samples in a file, x fastest.
#[derive(Debug)]
pub(crate) struct StreamSource {
    file: PositionedFile,
    extent: StreamExtent,
    skip: u64,
    geometry: Geometry,
    sample: SampleType,
    endian: Endian,
    notes: Vec<String>,
}

impl StreamSource {
    /// Compressed samples. With [`Skip::ToLast`] the stream is decompressed once to learn its length.
    pub(crate) fn new(
        file: PositionedFile,
        extent: StreamExtent,
        skip: Skip,
        geometry: Geometry,
        sample: SampleType,
        endian: Endian,
    ) -> Result<Self, VolumeError> {
        let there = file.len().saturating_sub(extent.offset);
        if let Some(len) = extent.len.filter(|&len| len > there) {
            return Err(VolumeError::Truncated { path: file.path().to_owned(), needed: len, got: there });
        }
        let needed = sample_bytes(&geometry, sample);
        let at_most = extent.len.unwrap_or(there).saturating_mul(DEFLATE_LIMIT);
        if at_most < needed {
            return Err(VolumeError::Truncated { path: file.path().to_owned(), needed, got: at_most });
        }
        let mut source = Self { file, extent, skip: 0, geometry, sample, endian, notes: Vec::new() };
        source.skip = match skip {
            Skip::Bytes(n) => n,
            Skip::ToLast => source.prefix(needed)?,
        };
        Ok(source)
    }

    /// Adds remarks of the reader that parsed the header.
    pub(crate) fn with_notes(mut self, notes: Vec<String>) -> Self {
        self.notes.extend(notes);
        self
    }

    fn decoder(&self) -> Result<Box<dyn Read + '_>, VolumeError> {
        let len = self.extent.len.unwrap_or(u64::MAX);
        let mut input = BufReader::with_capacity(1 << 16, self.file.reader(self.extent.offset).take(len));
        let start = input.fill_buf().map_err(|error| io_error(self.file.path(), error))?;
        // MetaImage writers use zlib, some use gzip: the first two bytes tell.
        Ok(if start.starts_with(&[0x1f, 0x8b]) {
            Box::new(MultiGzDecoder::new(input))
        } else {
            Box::new(ZlibDecoder::new(input))
        })
    }

    /// Bytes before the last `needed` bytes of the stream.
    fn prefix(&self, needed: u64) -> Result<u64, VolumeError> {
        /// Nobody puts a longer header than this in front of samples.
        const LONGEST: u64 = 1 << 24;
        let path = self.file.path();
        let mut decoder = self.decoder()?.take(needed + LONGEST + 1);
        let total = io::copy(&mut decoder, &mut io::sink()).map_err(|error| io_error(path, error))?;
        match total.checked_sub(needed) {
            None => Err(VolumeError::Truncated { path: path.to_owned(), needed, got: total }),
            Some(extra) if extra > LONGEST => {
                Err(VolumeError::Excess { path: path.to_owned(), needed, extra })
            }
            Some(extra) => Ok(extra),
        }
    }

    /// Reads on until `buffer` is full. `done` counts the bytes of samples behind us.
    fn fill(&self, decoder: &mut dyn Read, buffer: &mut [u8], done: &mut u64) -> Result<(), VolumeError> {
        let mut at = 0;
        while at < buffer.len() {
            match decoder.read(&mut buffer[at..]) {
                Ok(n) if n > 0 => at += n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() != io::ErrorKind::UnexpectedEof => {
                    return Err(io_error(self.file.path(), error));
                }
                _ => {
                    let (needed, got) = (sample_bytes(&self.geometry, self.sample), *done + at as u64);
                    return Err(VolumeError::Truncated { path: self.file.path().to_owned(), needed, got });
                }
            }
        }
        *done += at as u64;
        Ok(())
    }

    fn pass(
        &self,
        decoder: &mut dyn Read,
        scratch: &mut [u8],
        mut bytes: u64,
        done: &mut u64,
    ) -> Result<(), VolumeError> {
        while bytes > 0 {
            let step = bytes.min(scratch.len() as u64);
            self.fill(decoder, &mut scratch[..step as usize], done)?;
            bytes -= step;
        }
        Ok(())
    }
}

impl VolumeSource for StreamSource {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn sample_type(&self) -> SampleType {
        self.sample
    }

    fn cheap_partial_reads(&self) -> bool {
        false
    }

    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
        let size = self.geometry.size();
        check_box(part, size)?;
        let bytes = self.sample.bytes();
        let mut out = Collector::new(self.sample, part);
        let mut decoder = self.decoder()?;
        let mut scratch = vec![0; 1 << 16];
        self.pass(&mut decoder, &mut scratch, self.skip, &mut 0)?;
        let mut done = 0;
        // A row has at most Geometry::MAX_AXIS samples: 128 KiB.
        let mut row = vec![0; (part.high[0] - part.low[0]) * bytes];
        for z in part.low[2]..part.high[2] {
            for y in part.low[1]..part.high[1] {
                let begin = ((z * size[1] + y) * size[0] + part.low[0]) as u64 * bytes as u64;
                self.pass(&mut decoder, &mut scratch, begin - done, &mut done)?;
                self.fill(&mut decoder, &mut row, &mut done)?;
                out.push(&row, self.endian)?;
            }
        }
        if part.high == size && matches!(decoder.read(&mut scratch[..1]), Ok(1)) {
            return Err(VolumeError::Excess { path: self.file.path().to_owned(), needed: done, extra: 1 });
        }
        out.finish()
    }

    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }
}
