//! MetaImage: `.mha` (samples behind the header) and `.mhd` (samples in a file beside it).
//!
//! Read are three-dimensional images of one channel, uncompressed or zlib-compressed, of either
//! byte order. `TransformMatrix` lists the world directions of the x, y and z axes one after the
//! other, as ITK writes them; its aliases and those of `Offset` are honoured. The world is taken as
//! it is in the file: `AnatomicalOrientation` is not applied. Samples in text form, in lists or
//! patterns of files, and other number types are refused.

use std::path::Path;

use super::collect::Endian;
use super::header::{Fields, HeaderLines, shortened};
use super::positioned::PositionedFile;
use super::raw::{RawSource, sample_bytes};
use super::source::SPACING_ASSUMED;
use super::stream::{Skip, StreamExtent, StreamSource};
use super::{SampleType, VolumeError, VolumeSource};
use crate::grid::Geometry;

/// What a writer could use instead of something unsupported.
const SUPPORTED: &str = "three-dimensional MetaImage of one channel, MET_UCHAR, MET_USHORT, MET_SHORT or \
     MET_FLOAT, binary, with ElementDataFile LOCAL or the name of one file";

/// Opens a MetaImage.
///
/// # Errors
/// Whatever is wrong with its header or with the length of its data; see [`VolumeError`].
pub(crate) fn open(path: &Path) -> Result<Box<dyn VolumeSource>, VolumeError> {
    let file = PositionedFile::open(path)?;
    let (fields, local_offset) = parse(&file)?;
    let mut notes = Vec::new();
    let geometry = geometry(&fields, &mut notes)?;
    let sample = sample_type(&fields)?;
    let big = fields.flag(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"])?.unwrap_or(false);
    let endian = if big { Endian::Big } else { Endian::Little };

    let name = fields.need("ElementDataFile", "where the samples are")?;
    let local = name.eq_ignore_ascii_case("LOCAL");
    if name.starts_with("LIST") || name.contains('%') {
        let feature = format!("ElementDataFile = {} (samples in several files)", shortened(name));
        return Err(fields.unsupported(feature, SUPPORTED));
    }
    let (data, start) = if local { (file, local_offset) } else { (fields.data_file(name)?, 0) };
    let skip = match fields.whole(&["HeaderSize"])?.unwrap_or(0) {
        -1 => Skip::ToLast,
        n => Skip::Bytes(u64::try_from(n).map_err(|_| {
            fields.bad("HeaderSize", &n.to_string(), "-1 (the samples are at the file's end) or more")
        })?),
    };
    if fields.flag(&["CompressedData"])?.unwrap_or(false) {
        let len = match fields.whole(&["CompressedDataSize"])? {
            None | Some(0) => None,
            Some(n) => Some(u64::try_from(n).map_err(|_| {
                fields.bad("CompressedDataSize", &n.to_string(), "the positive number of compressed bytes")
            })?),
        };
        let Skip::Bytes(skip) = skip else {
            return Err(fields.unsupported("HeaderSize = -1 with compressed samples".into(), SUPPORTED));
        };
        let extent = StreamExtent { offset: start.saturating_add(skip), len };
        let source = StreamSource::new(data, extent, Skip::Bytes(0), geometry, sample, endian)?;
        return Ok(Box::new(source.with_notes(notes)));
    }
    let offset = match skip {
        Skip::Bytes(n) => start.saturating_add(n),
        Skip::ToLast => {
            let needed = sample_bytes(&geometry, sample);
            let got = data.len().saturating_sub(start);
            (start + got)
                .checked_sub(needed)
                .filter(|&o| o >= start)
                .ok_or_else(|| VolumeError::Truncated { path: data.path().to_owned(), needed, got })?
        }
    };
    Ok(Box::new(RawSource::new(data, geometry, sample, endian, offset)?.with_notes(notes)))
}

/// The fields, and where the header ends.
fn parse(file: &PositionedFile) -> Result<(Fields, u64), VolumeError> {
    let malformed =
        |reason: String| VolumeError::Malformed { path: file.path().to_owned(), format: "MetaImage", reason };
    let mut lines = HeaderLines::new(file)?;
    let mut fields = Fields::new(file.path());
    while let Some(line) = lines.next_line() {
        if line.trim().is_empty() || line.trim_start().starts_with('#') {
            continue;
        }
        let Some((name, value)) = line.split_once('=') else {
            return Err(malformed(format!("`{}` is not a line `Name = value`", shortened(&line))));
        };
        fields.add(name, value)?;
        // By definition the last field: what follows is data.
        if name.trim().eq_ignore_ascii_case("ElementDataFile") {
            return Ok((fields, lines.offset()));
        }
    }
    Err(malformed("the header has no line `ElementDataFile = ...`, which must end it".into()))
}

fn geometry(fields: &Fields, notes: &mut Vec<String>) -> Result<Geometry, VolumeError> {
    let dimensions = fields.need("NDims", "the number of axes")?;
    if dimensions != "3" {
        let feature = format!("NDims = {} (an image of another dimension than 3)", shortened(dimensions));
        return Err(fields.unsupported(feature, SUPPORTED));
    }
    let channels = fields.whole(&["ElementNumberOfChannels"])?.unwrap_or(1);
    if channels != 1 {
        return Err(fields.unsupported(format!("ElementNumberOfChannels = {channels}"), SUPPORTED));
    }
    let size = fields.size("DimSize")?;
    let unit = fields.get(&["DistanceUnits"]).unwrap_or_default();
    let mm = fields.millimetres("DistanceUnits", unit)?;
    let spacing = fields.numbers(&["ElementSpacing"])?.or(fields.numbers(&["ElementSize"])?);
    if spacing.is_none() {
        notes.push(SPACING_ASSUMED.to_owned());
    }
    let origin = fields.numbers(&["Offset", "Position", "Origin"])?.unwrap_or([0.0; 3]);
    let matrix = fields.numbers(&["TransformMatrix", "Orientation", "Rotation"])?;
    let [a, b, c, d, e, f, g, h, i] = matrix.unwrap_or([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    Geometry::new(
        size,
        spacing.unwrap_or([1.0; 3]).map(|s| s * mm),
        origin.map(|o| o * mm),
        [[a, b, c], [d, e, f], [g, h, i]],
    )
    .map_err(|error| VolumeError::Geometry { path: fields.path().to_owned(), error })
}

fn sample_type(fields: &Fields) -> Result<SampleType, VolumeError> {
    if fields.flag(&["BinaryData"])? == Some(false) {
        return Err(fields.unsupported("BinaryData = False (samples as text)".into(), SUPPORTED));
    }
    match fields.need("ElementType", "the number type of the samples")? {
        "MET_UCHAR" => Ok(SampleType::U8),
        "MET_USHORT" => Ok(SampleType::U16),
        "MET_SHORT" => Ok(SampleType::I16),
        "MET_FLOAT" => Ok(SampleType::F32),
        other => Err(fields.unsupported(format!("ElementType = {}", shortened(other)), SUPPORTED)),
    }
}
