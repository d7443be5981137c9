//! [`Picture`]: pixels in memory, and how they become a PNG file.

use std::io::{Cursor, Write};
use std::path::Path;

use image::{ExtendedColorType, ImageEncoder, codecs::png};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::Rgb;
use crate::execution::Cancelled;
use crate::export::{ExportError, write_atomically};
use crate::volume::VolumeError;

/// Why there is no picture.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PictureError {
    /// A picture without pixels, or with too many.
    #[error("a picture of {width} x {height} pixels is not possible: each side needs 1 to {limit}")]
    Size {
        /// Width as asked for.
        width: usize,
        /// Height as asked for.
        height: usize,
        /// The most pixels along one side.
        limit: usize,
    },
    /// An option that is out of its range.
    #[error("{what} is {value}, but must be {needed}")]
    Option {
        /// Which option.
        what: &'static str,
        /// Its value as given.
        value: f64,
        /// What it must be.
        needed: &'static str,
    },
    /// No triangle is left to draw.
    #[error(
        "there is nothing to draw: none of the mesh's {triangles} triangles belongs to what is to be shown"
    )]
    Nothing {
        /// Triangles of the whole mesh.
        triangles: usize,
    },
    /// A slice that does not exist.
    #[error("there is no slice {index} along {axis}: the volume has slices 0 to {last}")]
    Slice {
        /// `x`, `y` or `z`.
        axis: char,
        /// The slice asked for.
        index: usize,
        /// The last slice there is.
        last: usize,
    },
    /// A crop that is empty or reaches beyond the slice.
    #[error("the crop {crop:?} is not inside the slice of {size:?} voxels")]
    Crop {
        /// Low and high (exclusive) per axis of the slice.
        crop: [[usize; 2]; 2],
        /// Voxels per axis of the slice.
        size: [usize; 2],
    },
    /// The volume could not be read.
    #[error(transparent)]
    Volume(#[from] VolumeError),
    /// The PNG encoder refused.
    #[error("cannot encode the picture: {0}")]
    Encode(#[from] image::ImageError),
    /// The file could not be written, or a mesh not be read.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// What is behind the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Background {
    /// White.
    #[default]
    White,
    /// Nothing: alpha is 0.
    Transparent,
}

/// A picture: 8-bit red, green, blue, alpha (not premultiplied), row by row from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    width: usize,
    height: usize,
    rgba: Vec<u8>,
}

impl Picture {
    /// The most pixels along one side.
    pub const MAX_SIDE: usize = 16_384;

    /// A picture of background only.
    ///
    /// # Errors
    /// [`PictureError::Size`] if a side is 0 or above [`Picture::MAX_SIDE`].
    pub fn new(width: usize, height: usize, background: Background) -> Result<Self, PictureError> {
        let limit = Self::MAX_SIDE;
        if [width, height].iter().any(|&n| n == 0 || n > limit) {
            return Err(PictureError::Size { width, height, limit });
        }
        let fill = match background {
            Background::White => [255; 4],
            Background::Transparent => [255, 255, 255, 0],
        };
        Ok(Self { width, height, rgba: fill.repeat(width * height) })
    }

    /// Pixels per row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, four bytes each, row by row from the top.
    #[must_use]
    pub fn rgba(&self) -> &[u8] {
        &self.rgba
    }

    /// All pixels, to be drawn on.
    pub(super) fn rgba_mut(&mut self) -> &mut [u8] {
        &mut self.rgba
    }

    /// Colour and alpha of the pixel in column `x` of row `y`, or `None` beyond the picture.
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> Option<(Rgb, u8)> {
        if x >= self.width || y >= self.height {
            return None;
        }
        let i = 4 * (y * self.width + x);
        let [r, g, b, a] = [0, 1, 2, 3].map(|k| self.rgba[i + k]);
        Some((Rgb(r, g, b), a))
    }

    /// The bytes of a PNG file: RGB if every pixel is opaque, RGBA otherwise.
    ///
    /// # Errors
    /// [`PictureError::Encode`] if the encoder refuses.
    pub fn to_png(&self) -> Result<Vec<u8>, PictureError> {
        let mut bytes = Cursor::new(Vec::new());
        let encoder = png::PngEncoder::new_with_quality(
            &mut bytes,
            png::CompressionType::Default,
            png::FilterType::Adaptive,
        );
        let (w, h) = (self.width as u32, self.height as u32);
        if self.rgba.chunks_exact(4).all(|p| p[3] == 255) {
            let rgb: Vec<u8> = self.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
            encoder.write_image(&rgb, w, h, ExtendedColorType::Rgb8)?;
        } else {
            encoder.write_image(&self.rgba, w, h, ExtendedColorType::Rgba8)?;
        }
        Ok(bytes.into_inner())
    }

    /// Writes a PNG file: under another name in the same folder first, so that a file of this name
    /// is either the old one or complete.
    ///
    /// # Errors
    /// [`PictureError::Encode`], or [`PictureError::Export`] if the file system refuses.
    pub fn save_png(&self, path: &Path) -> Result<(), PictureError> {
        let bytes = self.to_png()?;
        Ok(write_atomically(path, |out| out.write_all(&bytes))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_saved_picture_reads_back_and_leaves_nothing_aside() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.png");
        let mut picture = Picture::new(3, 2, Background::White).unwrap();
        picture.rgba_mut()[4..8].copy_from_slice(&[1, 2, 3, 255]);
        picture.save_png(&path).unwrap();
        let read = image::open(&path).unwrap();
        assert_eq!(read.color(), image::ColorType::Rgb8);
        assert_eq!(read.to_rgba8().into_raw(), picture.rgba());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);

        let clear = Picture::new(3, 2, Background::Transparent).unwrap();
        let read = image::load_from_memory(&clear.to_png().unwrap()).unwrap();
        assert_eq!(read.color(), image::ColorType::Rgba8);
    }

    #[test]
    fn impossible_sizes_and_places_are_refused() {
        assert!(matches!(Picture::new(0, 5, Background::White), Err(PictureError::Size { .. })));
        assert!(matches!(Picture::new(5, 1 << 20, Background::White), Err(PictureError::Size { .. })));
        let picture = Picture::new(3, 2, Background::White).unwrap();
        assert_eq!(picture.pixel(3, 0), None);
        let nowhere = tempfile::tempdir().unwrap().path().join("gone").join("p.png");
        assert!(matches!(picture.save_png(&nowhere), Err(PictureError::Export(_))));
    }
}
