//! MetaImage volumes: `.mha` (header and voxels in one file) and `.mhd` with a `.raw` beside it.
//!
//! The file is written aside in the same folder and renamed when it is complete, so that a reader
//! never sees half of it. Voxels are little endian, x fastest. An `.mhd` appears after its `.raw`.

use std::ffi::OsString;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use thiserror::Error;

use super::{ExportError, write_atomically};
use crate::grid::Geometry;
use crate::volume::{SampleType, Samples};

/// Why a MetaImage cannot be written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MetaImageError {
    /// A name that is neither `.mha` nor `.mhd`.
    #[error("{}: a MetaImage file is named .mha (one file) or .mhd (header, with a .raw beside it)", path.display())]
    Extension {
        /// The name as given.
        path: PathBuf,
    },
    /// The number of samples does not fit the geometry.
    #[error("{got} samples for a volume of {size:?} voxels")]
    Length {
        /// Samples given.
        got: usize,
        /// Voxels per axis.
        size: [usize; 3],
    },
    /// The file could not be written.
    #[error(transparent)]
    Export(#[from] ExportError),
}

/// How to write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MetaImageOptions {
    /// Compress the voxels with zlib.
    pub compress: bool,
}

impl Default for MetaImageOptions {
    fn default() -> Self {
        Self { compress: true }
    }
}

/// Writes a volume to `path`, `.mha` or `.mhd`, replacing what is there.
///
/// # Errors
/// [`MetaImageError`]; nothing is left behind then, except for a complete `.raw` or `.zraw` whose `.mhd` failed.
pub fn write(
    path: &Path,
    geometry: &Geometry,
    samples: &Samples,
    options: &MetaImageOptions,
) -> Result<(), MetaImageError> {
    if samples.len() != geometry.voxels() {
        return Err(MetaImageError::Length { got: samples.len(), size: geometry.size() });
    }
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match extension.as_str() {
        "mha" => write_atomically(path, |file| {
            let (voxels, compressed) = encoded(samples, options.compress)?;
            header(file, geometry, samples.sample_type(), compressed, "LOCAL")?;
            match voxels {
                Some(bytes) => file.write_all(&bytes),
                None => raw(samples, file),
            }
        })?,
        "mhd" => {
            let data = path.with_extension(if options.compress { "zraw" } else { "raw" });
            let mut size = None;
            write_atomically(&data, |file| {
                let (voxels, compressed) = encoded(samples, options.compress)?;
                size = compressed;
                match voxels {
                    Some(bytes) => file.write_all(&bytes),
                    None => raw(samples, file),
                }
            })?;
            let name = data.file_name().map(OsString::from).unwrap_or_default();
            write_atomically(path, |file| {
                header(file, geometry, samples.sample_type(), size, &name.to_string_lossy())
            })?;
        }
        _ => return Err(MetaImageError::Extension { path: path.to_owned() }),
    }
    Ok(())
}

/// The compressed voxels and their number, or nothing if they are not to be compressed. They are held
/// in memory because the header, which comes first, states their number.
fn encoded(samples: &Samples, compress: bool) -> io::Result<(Option<Vec<u8>>, Option<u64>)> {
    if !compress {
        return Ok((None, None));
    }
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    raw(samples, &mut encoder)?;
    let bytes = encoder.finish()?;
    let count = bytes.len() as u64;
    Ok((Some(bytes), Some(count)))
}

/// The voxels, little endian.
fn raw(samples: &Samples, out: &mut impl Write) -> io::Result<()> {
    fn each<T: Copy, const N: usize>(
        values: &[T],
        out: &mut impl Write,
        bytes: impl Fn(T) -> [u8; N],
    ) -> io::Result<()> {
        let mut buffer = Vec::with_capacity(N << 14);
        for chunk in values.chunks(1 << 14) {
            buffer.clear();
            buffer.extend(chunk.iter().flat_map(|&v| bytes(v)));
            out.write_all(&buffer)?;
        }
        Ok(())
    }
    match samples {
        Samples::U8(v) => out.write_all(v),
        Samples::U16(v) => each(v, out, u16::to_le_bytes),
        Samples::I16(v) => each(v, out, i16::to_le_bytes),
        Samples::F32(v) => each(v, out, f32::to_le_bytes),
    }
}

fn header(
    out: &mut impl Write,
    geometry: &Geometry,
    kind: SampleType,
    compressed: Option<u64>,
    data: &str,
) -> io::Result<()> {
    let list = |v: [f64; 3]| v.map(|x| x.to_string()).join(" ");
    let element = match kind {
        SampleType::U8 => "MET_UCHAR",
        SampleType::U16 => "MET_USHORT",
        SampleType::I16 => "MET_SHORT",
        SampleType::F32 => "MET_FLOAT",
    };
    writeln!(out, "ObjectType = Image")?;
    writeln!(out, "NDims = 3")?;
    writeln!(out, "BinaryData = True")?;
    writeln!(out, "BinaryDataByteOrderMSB = False")?;
    match compressed {
        Some(bytes) => writeln!(out, "CompressedData = True\nCompressedDataSize = {bytes}")?,
        None => writeln!(out, "CompressedData = False")?,
    }
    // MetaImage lists the world direction of one index axis after the other.
    writeln!(out, "TransformMatrix = {}", geometry.direction().map(list).join(" "))?;
    writeln!(out, "Offset = {}", list(geometry.origin()))?;
    writeln!(out, "CenterOfRotation = 0 0 0")?;
    writeln!(out, "ElementSpacing = {}", list(geometry.spacing()))?;
    writeln!(out, "DimSize = {}", geometry.size().map(|n| n.to_string()).join(" "))?;
    writeln!(out, "ElementType = {element}")?;
    // Must be the last line.
    writeln!(out, "ElementDataFile = {data}")
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    fn volume() -> (Geometry, Samples) {
        let geometry = Geometry::axis_aligned([2, 3, 1], [0.5, 0.25, 1.0]).unwrap();
        (geometry, Samples::U16(vec![1, 2, 3, 4, 500, 65535]))
    }

    fn split(bytes: &[u8]) -> (String, Vec<u8>) {
        let tag = b"ElementDataFile = LOCAL\n";
        let at = bytes.windows(tag.len()).position(|w| w == tag).unwrap() + tag.len();
        (String::from_utf8(bytes[..at].to_vec()).unwrap(), bytes[at..].to_vec())
    }

    #[test]
    fn an_mha_holds_header_and_voxels_compressed_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let (geometry, samples) = volume();
        let want: Vec<u8> = vec![1, 0, 2, 0, 3, 0, 4, 0, 0xf4, 1, 0xff, 0xff];
        for compress in [false, true] {
            let path = folder.path().join("a.mha");
            write(&path, &geometry, &samples, &MetaImageOptions { compress }).unwrap();
            let (header, data) = split(&std::fs::read(&path).unwrap());
            assert!(header.contains("DimSize = 2 3 1\n"));
            assert!(header.contains("ElementSpacing = 0.5 0.25 1\n"));
            assert!(header.contains("TransformMatrix = 1 0 0 0 1 0 0 0 1\n"));
            if compress {
                assert!(header.contains(&format!("CompressedDataSize = {}\n", data.len())));
                let mut plain = Vec::new();
                flate2::read::ZlibDecoder::new(&data[..]).read_to_end(&mut plain).unwrap();
                assert_eq!(plain, want);
            } else {
                assert_eq!(data, want);
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn an_mhd_names_its_data_file_and_other_names_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (geometry, samples) = volume();
        let path = folder.path().join("b.mhd");
        write(&path, &geometry, &samples, &MetaImageOptions { compress: false }).unwrap();
        assert!(std::fs::read_to_string(&path).unwrap().ends_with("ElementDataFile = b.raw\n"));
        assert_eq!(std::fs::read(folder.path().join("b.raw")).unwrap().len(), 12);
        let path = folder.path().join("b.tif");
        assert!(matches!(
            write(&path, &geometry, &samples, &MetaImageOptions::default()),
            Err(MetaImageError::Extension { .. })
        ));
    }
}
