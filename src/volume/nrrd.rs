//! NRRD: `.nrrd` (samples behind the header) and `.nhdr` (samples in a file beside it).
//!
//! Read are three-dimensional scalar volumes, encoded raw, gzip or text (which is held in memory),
//! with line and byte skips. Of a `byte skip` of -1 with gzip, which the format leaves open, the
//! last bytes of the decompressed stream are taken. Space directions win over spacings; without
//! either the spacing is 1 mm. The world is taken as it is in the file: `space` (left or right,
//! anterior or posterior) is not applied, nor are axis mins. Fields that say nothing about where
//! samples are and what they mean in space are ignored, as are keys (`name:=value`).

use std::io::Read;
use std::path::Path;

use super::collect::Endian;
use super::header::{Fields, HeaderLines, shortened};
use super::positioned::{PositionedFile, io_error};
use super::raw::{RawSource, sample_bytes};
use super::source::SPACING_ASSUMED;
use super::stream::{Skip, StreamExtent, StreamSource};
use super::{MemorySource, SampleType, Samples, VolumeError, VolumeSource};
use crate::grid::Geometry;

/// What a writer could use instead of something unsupported.
const SUPPORTED: &str = "three-dimensional scalar NRRD of unsigned char, unsigned short, short or float, in the \
     encoding raw, gzip or text, in one file or one header and one data file";

/// Opens an NRRD volume.
///
/// # Errors
/// Whatever is wrong with its header or with the length of its data; see [`VolumeError`].
pub(crate) fn open(path: &Path) -> Result<Box<dyn VolumeSource>, VolumeError> {
    let file = PositionedFile::open(path)?;
    let (fields, attached) = parse(&file)?;
    let mut notes = Vec::new();
    let geometry = geometry(&fields, &mut notes)?;
    let sample = sample_type(&fields)?;
    let encoding = Encoding::of(&fields)?;

    let (data, start) = match fields.get(&["data file", "datafile"]) {
        Some(name) if name.starts_with("LIST") || name.contains('%') => {
            let feature = format!("`data file: {}` (samples in several files)", shortened(name));
            return Err(fields.unsupported(feature, SUPPORTED));
        }
        Some(name) => (fields.data_file(name)?, 0),
        None => match attached {
            Some(offset) => (file, offset),
            None => {
                let why = "the header has no samples behind it";
                return Err(VolumeError::MissingField { path: path.to_owned(), field: "data file", why });
            }
        },
    };
    let start = skip_lines(&fields, &data, start)?;
    let skip = match fields.whole(&["byte skip", "byteskip"])?.unwrap_or(0) {
        -1 => Skip::ToLast,
        n => Skip::Bytes(u64::try_from(n).map_err(|_| {
            fields.bad("byte skip", &n.to_string(), "-1 (the samples are at the file's end) or more")
        })?),
    };
    match encoding {
        Encoding::Raw => {
            let endian = endian(&fields, sample)?;
            let offset = match skip {
                Skip::Bytes(n) => start.saturating_add(n),
                Skip::ToLast => {
                    let needed = sample_bytes(&geometry, sample);
                    let got = data.len().saturating_sub(start);
                    data.len()
                        .checked_sub(needed)
                        .filter(|&o| o >= start)
                        .ok_or_else(|| VolumeError::Truncated { path: data.path().to_owned(), needed, got })?
                }
            };
            Ok(Box::new(RawSource::new(data, geometry, sample, endian, offset)?.with_notes(notes)))
        }
        Encoding::Gzip => {
            let endian = endian(&fields, sample)?;
            let extent = StreamExtent { offset: start, len: None };
            let source = StreamSource::new(data, extent, skip, geometry, sample, endian)?;
            Ok(Box::new(source.with_notes(notes)))
        }
        Encoding::Text => {
            let Skip::Bytes(skip) = skip else {
                return Err(fields.unsupported("a byte skip of -1 with text".into(), SUPPORTED));
            };
            let samples = read_text(&data, start.saturating_add(skip), &geometry, sample)?;
            Ok(Box::new(MemorySource::new(geometry, samples)?))
        }
    }
}

/// The fields, and where the samples begin if the header is followed by an empty line.
fn parse(file: &PositionedFile) -> Result<(Fields, Option<u64>), VolumeError> {
    let malformed =
        |reason: String| VolumeError::Malformed { path: file.path().to_owned(), format: "NRRD", reason };
    let mut lines = HeaderLines::new(file)?;
    let magic = lines.next_line().unwrap_or_default();
    match magic.strip_prefix("NRRD000") {
        Some("1" | "2" | "3" | "4" | "5") => {}
        _ => {
            return Err(malformed(format!(
                "it begins with `{}`, not with NRRD0001 to NRRD0005",
                shortened(&magic)
            )));
        }
    }
    let mut fields = Fields::new(file.path());
    while let Some(line) = lines.next_line() {
        if line.is_empty() {
            return Ok((fields, Some(lines.offset())));
        }
        if line.starts_with('#') {
            continue;
        }
        match line.split_once(':') {
            Some((_, value)) if value.starts_with('=') => {} // a key, free for anyone's use
            Some((name, value)) => fields.add(name, value)?,
            None => return Err(malformed(format!("`{}` is not a line `name: value`", shortened(&line)))),
        }
    }
    Ok((fields, None))
}

enum Encoding {
    Raw,
    Gzip,
    Text,
}

impl Encoding {
    fn of(fields: &Fields) -> Result<Self, VolumeError> {
        let name = fields.need("encoding", "how the samples are written")?;
        match name.to_ascii_lowercase().as_str() {
            "raw" => Ok(Self::Raw),
            "gzip" | "gz" => Ok(Self::Gzip),
            "txt" | "text" | "ascii" => Ok(Self::Text),
            _ => Err(fields.unsupported(format!("the encoding `{}`", shortened(name)), SUPPORTED)),
        }
    }
}

fn sample_type(fields: &Fields) -> Result<SampleType, VolumeError> {
    let name = fields.need("type", "the number type of the samples")?;
    match name.to_ascii_lowercase().split_ascii_whitespace().collect::<Vec<_>>().join(" ").as_str() {
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Ok(SampleType::U8),
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Ok(SampleType::U16),
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
            Ok(SampleType::I16)
        }
        "float" => Ok(SampleType::F32),
        _ => Err(fields.unsupported(format!("the type `{}`", shortened(name)), SUPPORTED)),
    }
}

fn endian(fields: &Fields, sample: SampleType) -> Result<Endian, VolumeError> {
    match fields.get(&["endian"]) {
        _ if sample == SampleType::U8 => Ok(Endian::Little),
        Some(value) if value.eq_ignore_ascii_case("little") => Ok(Endian::Little),
        Some(value) if value.eq_ignore_ascii_case("big") => Ok(Endian::Big),
        Some(value) => Err(fields.bad("endian", value, "little or big")),
        None => {
            fields.need("endian", "samples of more than one byte have a byte order").map(|_| Endian::Little)
        }
    }
}

fn geometry(fields: &Fields, notes: &mut Vec<String>) -> Result<Geometry, VolumeError> {
    let dimension = fields.need("dimension", "the number of axes")?;
    if dimension != "3" {
        let feature = format!("`dimension: {}` (a volume of another dimension than 3)", shortened(dimension));
        return Err(fields.unsupported(feature, SUPPORTED));
    }
    let size = fields.size("sizes")?;
    for kind in fields.get(&["kinds"]).unwrap_or_default().split_ascii_whitespace() {
        if !["domain", "space", "time", "none", "???"].contains(&kind.to_ascii_lowercase().as_str()) {
            return Err(fields.unsupported(format!("an axis of kind `{}`", shortened(kind)), SUPPORTED));
        }
    }
    let scale = scale(fields)?;
    let origin = match fields.get(&["space origin"]) {
        Some(value) => vector(value)
            .ok_or_else(|| fields.bad("space origin", value, "one vector of three numbers, (x,y,z)"))?,
        None => [0.0; 3],
    };
    let spacing_and_direction = match fields.get(&["space directions"]) {
        Some(value) => {
            let expected = "three vectors of three numbers, (x,y,z) (x,y,z) (x,y,z)";
            let columns = vectors(value).ok_or_else(|| fields.bad("space directions", value, expected))?;
            (columns.map(|c| c.iter().map(|v| v * v).sum::<f64>().sqrt()), columns)
        }
        None => {
            let spacing = fields.numbers(&["spacings"])?;
            if spacing.is_none() {
                notes.push(SPACING_ASSUMED.to_owned());
            }
            (spacing.unwrap_or([1.0; 3]), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        }
    };
    let (spacing, direction) = spacing_and_direction;
    let scaled = std::array::from_fn(|a| spacing[a] * scale[a]);
    Geometry::new(size, scaled, std::array::from_fn(|a| origin[a] * scale[a]), direction)
        .map_err(|error| VolumeError::Geometry { path: fields.path().to_owned(), error })
}

/// Millimetres per unit of each axis.
fn scale(fields: &Fields) -> Result<[f64; 3], VolumeError> {
    let names = ["space units", "units"];
    let Some((name, value)) = names.iter().find_map(|n| Some((*n, fields.get(&[n])?))) else {
        return Ok([1.0; 3]);
    };
    let units: Vec<&str> = value.split_ascii_whitespace().collect();
    // Space units are those of world axes: only equal ones are a scale of the whole.
    if units.len() != 3 || (name == "space units" && units.iter().any(|unit| *unit != units[0])) {
        return Err(fields.bad(name, value, "the same unit three times"));
    }
    Ok([
        fields.millimetres(name, units[0])?,
        fields.millimetres(name, units[1])?,
        fields.millimetres(name, units[2])?,
    ])
}

/// `(x,y,z)`.
fn vector(text: &str) -> Option<[f64; 3]> {
    let inside = text.trim().strip_prefix('(')?.strip_suffix(')')?;
    let numbers: Option<Vec<f64>> = inside.split(',').map(|v| v.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

/// `(x,y,z) (x,y,z) (x,y,z)`, with or without blanks between.
fn vectors(text: &str) -> Option<[[f64; 3]; 3]> {
    let mut rest = text.trim();
    let mut found = Vec::new();
    while !rest.is_empty() {
        let end = rest.find(')')? + 1;
        found.push(vector(&rest[..end])?);
        rest = rest[end..].trim_start();
    }
    found.try_into().ok()
}

/// Where the samples begin after the lines to be skipped.
fn skip_lines(fields: &Fields, data: &PositionedFile, start: u64) -> Result<u64, VolumeError> {
    let lines = fields.whole(&["line skip", "lineskip"])?.unwrap_or(0);
    let mut left =
        u64::try_from(lines).map_err(|_| fields.bad("line skip", &lines.to_string(), "0 or more lines"))?;
    let mut at = start;
    let mut block = vec![0; 1 << 16];
    while left > 0 {
        let got = data.read_up_to(at, &mut block).map_err(|error| io_error(data.path(), error))?;
        if got == 0 {
            return Err(fields.bad(
                "line skip",
                &lines.to_string(),
                "at most as many lines as the data file has",
            ));
        }
        let ends = block[..got].iter().enumerate().filter(|(_, b)| **b == b'\n').map(|(i, _)| i);
        let mut used = got;
        for end in ends {
            left -= 1;
            if left == 0 {
                used = end + 1;
                break;
            }
        }
        at += used as u64;
    }
    Ok(at)
}

/// Numbers separated by blanks (or commas).
fn read_text(
    data: &PositionedFile,
    start: u64,
    geometry: &Geometry,
    sample: SampleType,
) -> Result<Samples, VolumeError> {
    let needed = geometry.voxels();
    // Every number but the last takes two bytes at least.
    let at_most = data.len().saturating_sub(start) / 2 + 1;
    if at_most < needed as u64 {
        let (needed, got) = (sample_bytes(geometry, sample), at_most * sample.bytes() as u64);
        return Err(VolumeError::Truncated { path: data.path().to_owned(), needed, got });
    }
    let mut bytes = Vec::new();
    data.reader(start).read_to_end(&mut bytes).map_err(|error| io_error(data.path(), error))?;
    let text = String::from_utf8_lossy(&bytes);
    let words = text.split(|c: char| c.is_ascii_whitespace() || c == ',').filter(|w| !w.is_empty());
    Ok(match sample {
        SampleType::U8 => Samples::U8(numbers(data, words, needed)?),
        SampleType::U16 => Samples::U16(numbers(data, words, needed)?),
        SampleType::I16 => Samples::I16(numbers(data, words, needed)?),
        SampleType::F32 => Samples::F32(numbers(data, words, needed)?),
    })
}

fn numbers<'a, T: std::str::FromStr>(
    data: &PositionedFile,
    words: impl Iterator<Item = &'a str>,
    needed: usize,
) -> Result<Vec<T>, VolumeError> {
    let mut values = Vec::new();
    for word in words {
        values.push(word.parse().map_err(|_| VolumeError::Malformed {
            path: data.path().to_owned(),
            format: "NRRD",
            reason: format!(
                "sample {} is `{}`, which the header's type cannot hold",
                values.len(),
                shortened(word)
            ),
        })?);
    }
    let bytes = |n: usize| (n * size_of::<T>()) as u64;
    let path = || data.path().to_owned();
    match values.len() {
        got if got < needed => {
            Err(VolumeError::Truncated { path: path(), needed: bytes(needed), got: bytes(got) })
        }
        got if got > needed => {
            Err(VolumeError::Excess { path: path(), needed: bytes(needed), extra: bytes(got - needed) })
        }
        _ => Ok(values),
    }
}
