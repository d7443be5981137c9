//! A multi-page TIFF file as a volume: page by page along z.
//!
//! The chain of directories is followed once; a loop in it ends in an error. ImageJ writes stacks
//! of more than 4 GB with one directory only and the other pages behind the first: that is read as
//! the stack its description announces.

use std::collections::HashSet;
use std::path::Path;

use super::directory::{Directory, FileHeader, malformed, tag};
use super::page::Page;
use super::read_slices;
use crate::execution::Execution;
use crate::grid::{Geometry, VoxelBox};
use crate::volume::positioned::PositionedFile;
use crate::volume::raw::RawSource;
use crate::volume::source::{SPACING_ASSUMED, check_box};
use crate::volume::{SampleType, Samples, VolumeError, VolumeSource};

/// A multi-page TIFF.
#[derive(Debug)]
struct StackSource {
    file: PositionedFile,
    geometry: Geometry,
    pages: Vec<Page>,
}

/// Opens a multi-page TIFF file. A file of one page is a volume of one slice.
///
/// # Errors
/// Whatever is wrong with one of its directories; see [`VolumeError`].
pub(crate) fn open_file(path: &Path) -> Result<Box<dyn VolumeSource>, VolumeError> {
    let file = PositionedFile::open(path)?;
    let (pages, description) = read_pages(&file)?;
    let Some(first) = pages.first() else { return Err(malformed(&file, "it has no page")) };
    let unequal = |(i, page): (usize, &Page)| VolumeError::UnequalSlices {
        one: format!("{}: page 1", path.display()),
        one_size: first.size(),
        one_type: first.sample,
        other: format!("page {}", i + 1),
        other_size: page.size(),
        other_type: page.sample,
    };
    let alike = |page: &Page| page.size() == first.size() && page.sample == first.sample;
    if let Some(other) = pages.iter().enumerate().find(|(_, page)| !alike(page)) {
        return Err(unequal(other));
    }
    let geometry = |slices: usize| {
        Geometry::axis_aligned([first.width, first.height, slices], [1.0; 3])
            .map_err(|error| VolumeError::Geometry { path: path.to_owned(), error })
    };
    let imagej = ImageJ::parse(&description);
    if imagej.channels > 1 || (imagej.slices > 1 && imagej.frames > 1) {
        return Err(VolumeError::Unsupported {
            path: path.to_owned(),
            feature: format!(
                "an ImageJ stack of {} channels, {} slices and {} frames",
                imagej.channels, imagej.slices, imagej.frames
            ),
            supported: "one channel and one frame",
        });
    }
    if pages.len() == 1 && imagej.images > 1 {
        let Some(offset) = first.contiguous() else {
            return Err(malformed(&file, "a compressed ImageJ stack has one directory only"));
        };
        let (geometry, sample, endian) = (geometry(imagej.images)?, first.sample, first.endian);
        let source = RawSource::within(file, geometry, sample, endian, offset)?;
        return Ok(Box::new(source.with_notes(vec![SPACING_ASSUMED.to_owned()])));
    }
    let geometry = geometry(pages.len())?;
    Ok(Box::new(StackSource { file, geometry, pages }))
}

/// All pages, in the order of the chain of directories, and the first one's description.
pub(super) fn read_pages(file: &PositionedFile) -> Result<(Vec<Page>, String), VolumeError> {
    let header = FileHeader::read(file)?;
    let mut pages = Vec::new();
    let mut description = String::new();
    let mut seen = HashSet::new();
    let mut next = header.first;
    while next != 0 {
        if !seen.insert(next) {
            let reason = format!("after {} pages its directories lead back to an earlier one", pages.len());
            return Err(malformed(file, &reason));
        }
        let directory = Directory::read(file, header, next)?;
        if pages.is_empty() {
            description = directory.text(tag::DESCRIPTION)?;
        }
        pages.push(Page::new(&directory, next)?);
        next = directory.next;
    }
    // Pages may share their samples, but a few bytes that are shown as a thousand pages are a trap.
    let needed = pages.iter().fold(0, |sum: u64, page| sum.saturating_add(page.least_bytes()));
    if needed > file.len() {
        return Err(VolumeError::Truncated { path: file.path().to_owned(), needed, got: file.len() });
    }
    Ok((pages, description))
}

/// What ImageJ's description says about the stack.
struct ImageJ {
    images: usize,
    channels: usize,
    slices: usize,
    frames: usize,
}

impl ImageJ {
    fn parse(description: &str) -> Self {
        let ours = description.starts_with("ImageJ=");
        let value = |key: &str| {
            let mut lines = description.lines().filter(|_| ours);
            lines.find_map(|line| line.strip_prefix(key)?.strip_prefix('=')?.trim().parse().ok()).unwrap_or(1)
        };
        Self {
            images: value("images"),
            channels: value("channels"),
            slices: value("slices"),
            frames: value("frames"),
        }
    }
}

impl VolumeSource for StackSource {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn sample_type(&self) -> SampleType {
        self.pages[0].sample
    }

    /// A box costs its own rows, or where pages are compressed the strips and tiles it touches: at
    /// worst its slices, never the file from its start.
    fn cheap_partial_reads(&self) -> bool {
        true
    }

    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
        let mut out = Samples::none(self.sample_type());
        self.append(part, &mut out, &Execution::default())?;
        Ok(out)
    }

    fn append(&self, part: &VoxelBox, out: &mut Samples, execution: &Execution) -> Result<(), VolumeError> {
        check_box(part, self.geometry.size())?;
        read_slices(part, &self.pages[0], out, execution, |z, columns, lines| {
            self.pages[z].read(&self.file, columns, lines)
        })
    }

    fn notes(&self) -> Vec<String> {
        vec![SPACING_ASSUMED.to_owned()]
    }
}
