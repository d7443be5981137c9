//! Opening a volume of any known format.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::positioned::PositionedFile;
use super::respaced::Respaced;
use super::{RawLayout, VolumeError, VolumeSource, metaimage, nrrd, raw, tiff};

/// What the file cannot say about itself.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpenOptions {
    /// Size, type, byte order and offset of headerless samples; for files without a header only.
    pub raw: Option<RawLayout>,
    /// Millimetres per voxel along x, y and z. Replaces the file's own spacing, if it has one, and
    /// [`VolumeSource::notes`] says so. Without it formats that have no spacing get 1 mm.
    pub spacing: Option<[f64; 3]>,
}

enum Format {
    MetaImage,
    Nrrd,
    Tiff,
}

impl Format {
    fn name(&self) -> &'static str {
        match self {
            Self::MetaImage => "MetaImage",
            Self::Nrrd => "NRRD",
            Self::Tiff => "TIFF",
        }
    }

    fn of_name(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "mha" | "mhd" => Some(Self::MetaImage),
            "nrrd" | "nhdr" => Some(Self::Nrrd),
            "tif" | "tiff" | "btf" | "tf8" => Some(Self::Tiff),
            _ => None,
        }
    }

    fn of_start(start: &[u8]) -> Option<Self> {
        if start.starts_with(b"NRRD000") {
            Some(Self::Nrrd)
        } else if tiff::is_tiff(start) {
            Some(Self::Tiff)
        } else if start.starts_with(b"ObjectType") || start.starts_with(b"NDims") {
            Some(Self::MetaImage)
        } else {
            None
        }
    }
}

/// Opens a volume: a folder of TIFF slices, a file of a format known by its name or its first
/// bytes, or headerless samples if their layout is given. Nothing but headers is read yet.
///
/// ```no_run
/// use interfacet::volume::{OpenOptions, open};
///
/// let options = OpenOptions { spacing: Some([0.1, 0.1, 0.25]), ..OpenOptions::default() };
/// let volume = open("scan/slices".as_ref(), &options)?;
/// println!("{:?} voxels of {}", volume.geometry().size(), volume.sample_type());
/// # Ok::<(), interfacet::volume::VolumeError>(())
/// ```
///
/// # Errors
/// [`VolumeError`] says what is wrong, with the value, the limit and what to do.
pub fn open(path: &Path, options: &OpenOptions) -> Result<Box<dyn VolumeSource>, VolumeError> {
    let source = open_as_it_is(path, options)?;
    match options.spacing {
        None => Ok(source),
        Some(spacing) => match Respaced::new(source, spacing) {
            Ok(source) => Ok(Box::new(source)),
            Err(error) => Err(VolumeError::Geometry { path: path.to_owned(), error }),
        },
    }
}

fn open_as_it_is(path: &Path, options: &OpenOptions) -> Result<Box<dyn VolumeSource>, VolumeError> {
    let needless = |format| Err(VolumeError::LayoutNotNeeded { path: path.to_owned(), format });
    if path.is_dir() {
        return if options.raw.is_some() { needless("folder of TIFF") } else { tiff::open_folder(path) };
    }
    let named = Format::of_name(path);
    let format = match (named, &options.raw) {
        (Some(format), _) => Some(format),
        // Samples may look like anything: whoever gives a layout is believed.
        (None, Some(_)) => None,
        (None, None) => Format::of_start(&PositionedFile::open(path)?.start(16)?),
    };
    match (format, &options.raw) {
        (Some(format), Some(_)) => needless(format.name()),
        (Some(Format::MetaImage), None) => metaimage::open(path),
        (Some(Format::Nrrd), None) => nrrd::open(path),
        (Some(Format::Tiff), None) => tiff::open_file(path),
        (None, Some(layout)) => Ok(Box::new(raw::open(path, layout)?)),
        (None, None) => {
            let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
            let headerless = ["raw", "bin", "dat", "vol", "img"].contains(&extension.as_str());
            Err(VolumeError::UnknownFormat { path: path.to_owned(), headerless })
        }
    }
}
