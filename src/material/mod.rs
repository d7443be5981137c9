//! Which grey value is which material: the histogram, the materials found in it, the scan's blur.

mod blur;
mod blur_axes;
mod counts;
mod deep;
mod edge_fit;
mod edge_patches;
mod edge_profile;
mod find;
mod histogram;
mod level_fit;
mod level_sums;
mod levels;
mod local_noise;
mod neighbourhood;
mod noise;
#[cfg(test)]
mod reference;
mod sampling;
mod scan_quality;
mod slice_otsu;
mod survey;
#[cfg(test)]
mod survey_tests;
mod table;
mod two_classes;

pub use blur::{Blur, DEFAULT_RADIUS, MAX_ESTIMATED_RADIUS, MAX_RADIUS, RADIUS_PER_SIGMA, radius_per_axis};
pub use counts::GreyCounts;
pub use edge_profile::{EdgeProfile, Misfit, ProfileBin};
pub use find::{FindError, Found, MIN_INSIDE_SHARE, Rejected, check_count, default_name, find_materials};
pub use histogram::Histogram;
pub use level_sums::{CellSums, LevelSums};
pub use levels::Levels;
pub use local_noise::Noise;
pub use noise::read_noise;
pub use scan_quality::{QUALITY_HALO, ScanQuality};
pub use slice_otsu::{CONTRAST_SHARE, OtsuMode, SliceThresholds};
pub use survey::{OutOfMemory, SURVEY_HALO, Survey, survey_bytes};
pub use table::{Material, MaterialTable, MaterialTableError};
pub use two_classes::TwoClasses;
