//! What the text headers (MetaImage, NRRD) have in common: fields, numbers, units, data files.

use std::path::{Path, PathBuf};

use super::VolumeError;
use super::positioned::PositionedFile;

/// No text header is longer; a file that has no end of header before is no volume.
const LONGEST_HEADER: usize = 1 << 20;

/// The fields of a header, in order, with names in lower case.
#[derive(Debug)]
pub(crate) struct Fields {
    path: PathBuf,
    fields: Vec<(String, String)>,
}

impl Fields {
    /// No fields yet.
    pub(crate) fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), fields: Vec::new() }
    }

    /// The file whose header it is.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Adds a field; a second one of the same name is refused.
    pub(crate) fn add(&mut self, name: &str, value: &str) -> Result<(), VolumeError> {
        let name = name.trim().to_ascii_lowercase();
        if self.get(&[&name]).is_some() {
            return Err(self.bad(&name, value, "this field once (it is given twice)"));
        }
        self.fields.push((name, value.trim().to_owned()));
        Ok(())
    }

    /// The value of the first of these names that is given.
    pub(crate) fn get(&self, names: &[&str]) -> Option<&str> {
        names.iter().find_map(|name| {
            self.fields.iter().find(|(n, _)| n.eq_ignore_ascii_case(name)).map(|(_, v)| v.as_str())
        })
    }

    /// The value of a field that must be given.
    pub(crate) fn need(&self, field: &'static str, why: &'static str) -> Result<&str, VolumeError> {
        self.get(&[field]).ok_or_else(|| VolumeError::MissingField { path: self.path.clone(), field, why })
    }

    /// `N` numbers, or `None` if no field of these names is given.
    pub(crate) fn numbers<const N: usize>(&self, names: &[&str]) -> Result<Option<[f64; N]>, VolumeError> {
        let Some(value) = self.get(names) else { return Ok(None) };
        let numbers: Option<Vec<f64>> = value.split_ascii_whitespace().map(|v| v.parse().ok()).collect();
        match numbers.and_then(|v| <[f64; N]>::try_from(v).ok()) {
            Some(numbers) => Ok(Some(numbers)),
            None => Err(self.bad(names[0], value, &format!("{N} numbers separated by blanks"))),
        }
    }

    /// Voxels along three axes.
    pub(crate) fn size(&self, field: &'static str) -> Result<[usize; 3], VolumeError> {
        let value = self.need(field, "the voxels along x, y and z")?;
        let numbers: Option<Vec<usize>> = value.split_ascii_whitespace().map(|v| v.parse().ok()).collect();
        numbers
            .and_then(|v| v.try_into().ok())
            .ok_or_else(|| self.bad(field, value, "three positive whole numbers separated by blanks"))
    }

    /// A whole number, or `None` if no field of these names is given.
    pub(crate) fn whole(&self, names: &[&str]) -> Result<Option<i64>, VolumeError> {
        let Some(value) = self.get(names) else { return Ok(None) };
        value.parse().map(Some).map_err(|_| self.bad(names[0], value, "a whole number"))
    }

    /// A yes-or-no field in the many ways MetaImage writers spell it.
    pub(crate) fn flag(&self, names: &[&str]) -> Result<Option<bool>, VolumeError> {
        let Some(value) = self.get(names) else { return Ok(None) };
        match value.to_ascii_lowercase().as_str() {
            "true" | "t" | "1" | "yes" => Ok(Some(true)),
            "false" | "f" | "0" | "no" => Ok(Some(false)),
            _ => Err(self.bad(names[0], value, "True or False")),
        }
    }

    /// A field has a value that makes no sense.
    pub(crate) fn bad(&self, field: &str, value: &str, expected: &str) -> VolumeError {
        let value = shortened(value);
        VolumeError::Header { path: self.path.clone(), field: field.into(), value, expected: expected.into() }
    }

    /// The file uses something that is not read.
    pub(crate) fn unsupported(&self, feature: String, supported: &'static str) -> VolumeError {
        VolumeError::Unsupported { path: self.path.clone(), feature, supported }
    }

    /// Millimetres per unit of length called `unit`.
    pub(crate) fn millimetres(&self, field: &str, unit: &str) -> Result<f64, VolumeError> {
        match unit.trim().trim_matches('"').to_lowercase().as_str() {
            "" | "?" | "mm" | "millimeter" | "millimetre" | "millimeters" | "millimetres" => Ok(1.0),
            "um" | "µm" | "μm" | "micron" | "microns" | "micrometer" | "micrometre" => Ok(1e-3),
            "nm" | "nanometer" | "nanometre" => Ok(1e-6),
            "cm" | "centimeter" | "centimetre" => Ok(10.0),
            "m" | "meter" | "metre" => Ok(1000.0),
            "in" | "inch" | "inches" => Ok(25.4),
            _ => Err(self.bad(field, unit, "a unit of length (nm, um, mm, cm, m or inch)")),
        }
    }

    /// The data file that a detached header names: beside the header, unless its path is absolute.
    pub(crate) fn data_file(&self, name: &str) -> Result<PositionedFile, VolumeError> {
        PositionedFile::open(&self.path.parent().unwrap_or(Path::new("")).join(name))
    }
}

/// A value as it goes into a message: printable, and not longer than a line.
pub(crate) fn shortened(value: &str) -> String {
    let mut text: String = value.chars().take(60).flat_map(char::escape_debug).collect();
    if value.chars().nth(60).is_some() {
        text.push_str("...");
    }
    text
}

/// The lines of a header, one at a time, each with the offset where the next one begins.
pub(crate) struct HeaderLines {
    bytes: Vec<u8>,
    at: usize,
}

impl HeaderLines {
    /// The start of a file, as far as a header may reach.
    pub(crate) fn new(file: &PositionedFile) -> Result<Self, VolumeError> {
        Ok(Self { bytes: file.start(LONGEST_HEADER)?, at: 0 })
    }

    /// The next line without its end (LF or CRLF), or `None` at the end of the header's bytes.
    pub(crate) fn next_line(&mut self) -> Option<String> {
        let rest = self.bytes.get(self.at..).filter(|rest| !rest.is_empty())?;
        let len = rest.iter().position(|&b| b == b'\n');
        let line = &rest[..len.unwrap_or(rest.len())];
        let line = String::from_utf8_lossy(line.strip_suffix(b"\r").unwrap_or(line)).into_owned();
        self.at += len.map_or(rest.len(), |n| n + 1);
        Some(line)
    }

    /// Where the next line begins: after the header's last line, where its samples begin.
    pub(crate) fn offset(&self) -> u64 {
        self.at as u64
    }
}
