//! A folder of numbered TIFF slices as a volume, along z by number.
//!
//! Names may differ in one number only, and that number must count 1, 2, 3... (from any start):
//! a slice that was lost in copying would otherwise shorten the part unnoticed. Other files than
//! TIFFs, hidden files and subfolders are ignored.

use std::path::{Path, PathBuf};

use super::page::Page;
use super::{read_slices, stack};
use crate::execution::Execution;
use crate::grid::{Geometry, VoxelBox};
use crate::volume::positioned::{PositionedFile, io_error};
use crate::volume::source::{SPACING_ASSUMED, check_box};
use crate::volume::{SampleType, Samples, VolumeError, VolumeSource};

/// A folder of slices.
#[derive(Debug)]
struct SeriesSource {
    geometry: Geometry,
    slices: Vec<(PathBuf, Page)>,
}

/// Opens a folder of slices.
///
/// # Errors
/// If there are none, one is missing or unlike the first, or their names do not count; see
/// [`VolumeError`].
pub(crate) fn open_folder(folder: &Path) -> Result<Box<dyn VolumeSource>, VolumeError> {
    let names = in_order(folder, slice_names(folder)?)?;
    let mut slices: Vec<(PathBuf, Page)> = Vec::with_capacity(names.len());
    for name in names {
        let path = folder.join(&name);
        let (mut pages, _) = stack::read_pages(&PositionedFile::open(&path)?)?;
        if pages.len() > 1 {
            return Err(VolumeError::Unsupported {
                path,
                feature: format!("a file of {} pages within a folder of slices", pages.len()),
                supported: "one page per file in a folder, or a single multi-page file",
            });
        }
        let Some(page) = pages.pop() else { continue };
        if let Some((first, one)) = slices.first()
            && (one.size() != page.size() || one.sample != page.sample)
        {
            return Err(VolumeError::UnequalSlices {
                one: first.display().to_string(),
                one_size: one.size(),
                one_type: one.sample,
                other: name,
                other_size: page.size(),
                other_type: page.sample,
            });
        }
        slices.push((path, page));
    }
    let Some((_, first)) = slices.first() else {
        return Err(VolumeError::NoSlices { folder: folder.to_owned() });
    };
    let geometry = Geometry::axis_aligned([first.width, first.height, slices.len()], [1.0; 3])
        .map_err(|error| VolumeError::Geometry { path: folder.to_owned(), error })?;
    Ok(Box::new(SeriesSource { geometry, slices }))
}

fn slice_names(folder: &Path) -> Result<Vec<String>, VolumeError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|error| io_error(folder, error))? {
        let entry = entry.map_err(|error| io_error(folder, error))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let lower = name.to_ascii_lowercase();
        let slice = (lower.ends_with(".tif") || lower.ends_with(".tiff")) && !name.starts_with('.');
        if slice && entry.path().is_file() {
            names.push(name);
        }
    }
    Ok(names)
}

/// A name cut into text and numbers, which take turns and begin with text (perhaps empty).
fn pieces(name: &str) -> Vec<&str> {
    let mut pieces = Vec::new();
    let mut rest = name;
    let mut digits = false;
    while !rest.is_empty() {
        let end = rest.find(|c: char| c.is_ascii_digit() != digits).unwrap_or(rest.len());
        let (piece, after) = rest.split_at(end);
        pieces.push(piece);
        (rest, digits) = (after, !digits);
    }
    pieces
}

/// The names in the order of the one number in which they differ, which must count without a gap.
fn in_order(folder: &Path, mut names: Vec<String>) -> Result<Vec<String>, VolumeError> {
    names.sort_unstable();
    let Some(first) = names.first().cloned() else { return Ok(names) };
    let mixed = |one: &str, other: &str, reason| VolumeError::MixedSeries {
        folder: folder.to_owned(),
        one: one.to_owned(),
        other: other.to_owned(),
        reason,
    };
    let model = pieces(&first);
    let mut counter = None;
    for name in &names[1..] {
        let own = pieces(name);
        if own.len() != model.len() || (0..own.len()).step_by(2).any(|i| own[i] != model[i]) {
            return Err(mixed(&first, name, "their names differ in more than a number"));
        }
        for i in (1..own.len()).step_by(2).filter(|&i| own[i] != model[i]) {
            if counter.is_some_and(|c| c != i) {
                return Err(mixed(&first, name, "more than one number in their names changes"));
            }
            counter = Some(i);
        }
    }
    let Some(counter) = counter else { return Ok(names) };
    let mut numbered = Vec::with_capacity(names.len());
    for name in names {
        let Ok(number) = pieces(&name)[counter].parse::<u64>() else {
            return Err(mixed(&first, &name, "the number is too long to count"));
        };
        numbered.push((number, name));
    }
    numbered.sort_unstable();
    for pair in numbered.windows(2) {
        let [(before, one), (after, other)] = pair else { continue };
        if before == after {
            return Err(mixed(one, other, "both have the same number"));
        }
        if after - before > 1 {
            return Err(VolumeError::MissingSlice {
                folder: folder.to_owned(),
                missing: before + 1,
                before: one.clone(),
                after: other.clone(),
            });
        }
    }
    Ok(numbered.into_iter().map(|(_, name)| name).collect())
}

impl VolumeSource for SeriesSource {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn sample_type(&self) -> SampleType {
        self.slices[0].1.sample
    }

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
        read_slices(part, &self.slices[0].1, out, execution, |z, columns, lines| {
            let (path, page) = &self.slices[z];
            page.read(&PositionedFile::open(path)?, columns, lines)
        })
    }

    fn notes(&self) -> Vec<String> {
        vec![SPACING_ASSUMED.to_owned()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(names: &[&str]) -> Result<Vec<String>, VolumeError> {
        in_order(Path::new("scan"), names.iter().map(|n| (*n).to_owned()).collect())
    }

    #[test]
    fn slices_are_ordered_by_their_number_and_not_by_their_name() {
        let names = order(&["s10_x2.tif", "s9_x2.tif", "s8_x2.tif", "s11_x2.tif"]).unwrap();
        assert_eq!(names, ["s8_x2.tif", "s9_x2.tif", "s10_x2.tif", "s11_x2.tif"]);
    }

    #[test]
    fn a_gap_a_double_and_two_series_are_refused_by_name() {
        let error = order(&["a1.tif", "a2.tif", "a4.tif"]).unwrap_err();
        let VolumeError::MissingSlice { missing, before, after, .. } = &error else { panic!("{error}") };
        assert_eq!((*missing, before.as_str(), after.as_str()), (3, "a2.tif", "a4.tif"));
        assert!(error.to_string().contains("slice number 3 is missing"));
        for names in [["a1.tif", "a01.tif"], ["a1.tif", "b2.tif"], ["a1_1.tif", "a2_2.tif"]] {
            assert!(matches!(order(&names), Err(VolumeError::MixedSeries { .. })), "{names:?}");
        }
    }
}
