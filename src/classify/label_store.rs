//! [`LabelStore`]: labels and junction flags of a whole volume, in memory or in a scratch file.
//!
//! A voxel takes the bits of its label's code and one for `junction`: 3 bits for up to three materials.
//! The scratch file has no name: it is gone when the store is, however the process ends.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;

use super::bit_planes::{BitPlanes, WORD};
use super::bricks::Brick;
use super::error::ClassifyError;
use super::label_volume::LabelVolume;
use crate::grid::MaterialId;

/// Labels and junction flags of a volume; see the module's header.
#[derive(Debug)]
pub struct LabelStore {
    size: [usize; 3],
    materials: usize,
    place: Place,
}

#[derive(Debug)]
enum Place {
    Memory(LabelVolume, BitPlanes),
    /// Slice by slice: the words of the code planes, then those of the junction plane.
    Scratch(File),
}

/// Labels and junction flags of some slices.
pub type Stored<'a> = (Cow<'a, LabelVolume>, Cow<'a, BitPlanes>);

impl LabelStore {
    /// An empty store in memory for a volume of `size` voxels.
    #[must_use]
    pub fn in_memory(size: [usize; 3], materials: usize) -> Self {
        let labels = LabelVolume::undecided(size, materials, 0..size[2] + 2);
        Self { size, materials, place: Place::Memory(labels, BitPlanes::new(size, 1)) }
    }

    /// An empty store in an unnamed file in `folder`.
    ///
    /// # Errors
    /// [`ClassifyError::Scratch`] if the file cannot be made.
    pub fn in_file(size: [usize; 3], materials: usize, folder: &Path) -> Result<Self, ClassifyError> {
        let file = tempfile::tempfile_in(folder).map_err(scratch)?;
        Ok(Self { size, materials, place: Place::Scratch(file) })
    }

    /// A store of what is in memory already.
    #[must_use]
    pub fn of(labels: LabelVolume, junction: BitPlanes) -> Self {
        Self { size: labels.size(), materials: labels.materials(), place: Place::Memory(labels, junction) }
    }

    /// Bytes that a store of a volume of `size` voxels takes, in memory or on disk.
    #[must_use]
    pub fn bytes(size: [usize; 3], materials: usize) -> u64 {
        let one = LabelVolume::undecided(size, materials, 1..2);
        let slice = one.codes().bytes() + one.codes().bytes() / one.codes().count();
        slice as u64 * (size[2] as u64 + 2)
    }

    /// Number of materials.
    #[must_use]
    pub fn materials(&self) -> usize {
        self.materials
    }

    /// Puts down the slices of a brick.
    ///
    /// # Errors
    /// [`ClassifyError::Scratch`] if the scratch file cannot be written.
    pub fn write(&mut self, brick: &Brick) -> Result<(), ClassifyError> {
        let (labels, junction, slices) = (brick.labels(), brick.junction(), brick.slices());
        match &mut self.place {
            Place::Memory(all, flags) => {
                all.set_slices(labels, slices.clone());
                flags.set_slices(slices.start, junction.slice_data(slices));
                Ok(())
            }
            Place::Scratch(file) => {
                let put = || -> io::Result<()> {
                    for z in slices {
                        let codes = labels.codes().slice_data(z..z + 1);
                        let flags = junction.slice_data(z..z + 1);
                        let bytes = 8 * (codes.len() + flags.len()) as u64;
                        file.seek(SeekFrom::Start((z - 1) as u64 * bytes))?;
                        file.write_all(bytemuck::cast_slice(codes))?;
                        file.write_all(bytemuck::cast_slice(flags))?;
                    }
                    Ok(())
                };
                put().map_err(scratch)
            }
        }
    }

    /// The labels and flags of at least the padded slices `slices`; those of `OUTSIDE` are made.
    ///
    /// # Errors
    /// [`ClassifyError::Scratch`] if the scratch file cannot be read.
    pub fn read(&mut self, slices: Range<usize>) -> Result<Stored<'_>, ClassifyError> {
        match &mut self.place {
            Place::Memory(labels, junction) => Ok((Cow::Borrowed(labels), Cow::Borrowed(junction))),
            Place::Scratch(file) => {
                let mut labels = LabelVolume::undecided(self.size, self.materials, slices.clone());
                let mut junction = BitPlanes::window(self.size, 1, slices);
                let mut get = || -> io::Result<()> {
                    for z in junction.voxel_slices() {
                        let (codes, flags) = (labels.slice_mut(z), junction.slice_mut(z));
                        let bytes = 8 * (codes.len() + flags.len()) as u64;
                        file.seek(SeekFrom::Start((z - 1) as u64 * bytes))?;
                        file.read_exact(bytemuck::cast_slice_mut(codes))?;
                        file.read_exact(bytemuck::cast_slice_mut(flags))?;
                    }
                    Ok(())
                };
                get().map_err(scratch)?;
                Ok((Cow::Owned(labels), Cow::Owned(junction)))
            }
        }
    }

    /// Gives voxels (z, y, x; ascending) a material; they are no longer flagged as junction.
    ///
    /// # Errors
    /// [`ClassifyError::Scratch`] if the file cannot be read or written.
    pub fn relabel(
        &mut self,
        voxels: impl Iterator<Item = ([u32; 3], MaterialId)>,
    ) -> Result<(), ClassifyError> {
        let mut voxels = voxels.peekable();
        while let Some(&([z, ..], _)) = voxels.peek() {
            let slice = z as usize + 1;
            let mut set = |labels: &mut LabelVolume, junction: &mut BitPlanes| {
                while let Some(([_, y, x], material)) = voxels.next_if(|v| v.0[0] == z) {
                    let [x, y] = [x, y].map(|c| c as usize + 1);
                    labels.set([x, y, slice], material);
                    junction.row_mut(0, y, slice)[x / WORD] &= !(1 << (x % WORD));
                }
            };
            if let Place::Memory(labels, junction) = &mut self.place {
                set(labels, junction);
                continue;
            }
            let (labels, junction) = self.read(slice..slice + 1)?;
            let (mut labels, mut junction) = (labels.into_owned(), junction.into_owned());
            set(&mut labels, &mut junction);
            self.write(&Brick::stored(labels, junction))?;
        }
        Ok(())
    }
}

fn scratch(source: io::Error) -> ClassifyError {
    ClassifyError::Scratch { source }
}
