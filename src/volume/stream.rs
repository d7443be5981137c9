//! Compressed samples (zlib or gzip) behind a header that another reader parsed.
//!
//! A stream is decompressed from its start up to the last row of the box, and no further; a reader of
//! slices goes on where it stopped, so that a pass over the volume decompresses it once. Memory
//! grows with the bytes that come out, up to the box; a stream that is shorter than the header
//! says, or (seen when the last row is read) longer, is refused.

use std::io::{self, BufRead, BufReader, Read};
use std::ops::Range;

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};

use super::collect::{Collector, Endian};
use super::positioned::{PositionedFile, io_error};
use super::raw::sample_bytes;
use super::slices::{SliceReader, slices_of};
use super::source::check_box;
use super::{SampleType, Samples, VolumeError, VolumeSource};
use crate::execution::Execution;
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

    fn decoder(&self) -> Result<Box<dyn Read + Send + '_>, VolumeError> {
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
}

/// A stream under way: what it has passed, it does not decompress again.
struct Pass<'a> {
    source: &'a StreamSource,
    decoder: Box<dyn Read + Send + 'a>,
    scratch: Vec<u8>,
    /// Bytes of samples behind us.
    done: u64,
}

impl<'a> Pass<'a> {
    /// A pass from the first sample on.
    fn begin(source: &'a StreamSource, execution: &Execution) -> Result<Self, VolumeError> {
        let mut pass = Self { source, decoder: source.decoder()?, scratch: vec![0; 1 << 16], done: 0 };
        pass.skip(source.skip, execution)?;
        pass.done = 0;
        Ok(pass)
    }

    /// Reads on until `buffer` is full.
    fn fill(&mut self, buffer: &mut [u8]) -> Result<(), VolumeError> {
        let path = self.source.file.path();
        let mut at = 0;
        while at < buffer.len() {
            match self.decoder.read(&mut buffer[at..]) {
                Ok(n) if n > 0 => at += n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() != io::ErrorKind::UnexpectedEof => {
                    return Err(io_error(path, error));
                }
                _ => {
                    let needed = sample_bytes(&self.source.geometry, self.source.sample);
                    let got = self.done + at as u64;
                    return Err(VolumeError::Truncated { path: path.to_owned(), needed, got });
                }
            }
        }
        self.done += at as u64;
        Ok(())
    }

    fn skip(&mut self, mut bytes: u64, execution: &Execution) -> Result<(), VolumeError> {
        let mut scratch = std::mem::take(&mut self.scratch);
        while bytes > 0 {
            execution.check()?;
            let step = bytes.min(scratch.len() as u64);
            self.fill(&mut scratch[..step as usize])?;
            bytes -= step;
        }
        self.scratch = scratch;
        Ok(())
    }

    /// Reads the rows of `part`, which must not lie behind us.
    fn read(&mut self, part: &VoxelBox, out: &mut Samples, execution: &Execution) -> Result<(), VolumeError> {
        let StreamSource { geometry, sample, endian, file, .. } = self.source;
        let (size, bytes) = (geometry.size(), sample.bytes());
        let mut out = Collector::new(*sample, part, out)?;
        // A row has at most Geometry::MAX_AXIS samples: 128 KiB.
        let mut row = vec![0; (part.high[0] - part.low[0]) * bytes];
        for z in part.low[2]..part.high[2] {
            execution.check()?;
            for y in part.low[1]..part.high[1] {
                let begin = ((z * size[1] + y) * size[0] + part.low[0]) as u64 * bytes as u64;
                self.skip(begin - self.done, execution)?;
                self.fill(&mut row)?;
                out.push(&row, *endian)?;
            }
        }
        if part.high == size && matches!(self.decoder.read(&mut self.scratch[..1]), Ok(1)) {
            let needed = self.done;
            return Err(VolumeError::Excess { path: file.path().to_owned(), needed, extra: 1 });
        }
        out.finish()
    }
}

/// The slices of a frame of a stream, in one pass as long as they ascend.
struct StreamReader<'a> {
    source: &'a StreamSource,
    frame: VoxelBox,
    /// The pass under way, and the first slice that is not behind it.
    pass: Option<(Pass<'a>, usize)>,
}

impl SliceReader for StreamReader<'_> {
    fn read(
        &mut self,
        slices: Range<usize>,
        out: &mut Samples,
        execution: &Execution,
    ) -> Result<(), VolumeError> {
        let part = slices_of(&self.frame, slices.clone())?;
        // An error leaves no pass, so that none goes on from an unknown place.
        let mut pass = match self.pass.take() {
            Some((pass, next)) if next <= slices.start => pass,
            _ => Pass::begin(self.source, execution)?,
        };
        pass.read(&part, out, execution)?;
        self.pass = Some((pass, slices.end));
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
        let mut out = Samples::none(self.sample);
        self.append(part, &mut out, &Execution::default())?;
        Ok(out)
    }

    fn append(&self, part: &VoxelBox, out: &mut Samples, execution: &Execution) -> Result<(), VolumeError> {
        self.slices(part)?.read(0..part.size()[2], out, execution)
    }

    fn slices(&self, frame: &VoxelBox) -> Result<Box<dyn SliceReader + '_>, VolumeError> {
        check_box(frame, self.geometry.size())?;
        Ok(Box::new(StreamReader { source: self, frame: *frame, pass: None }))
    }

    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }
}
