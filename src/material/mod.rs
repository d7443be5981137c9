//! Which grey value is which material: the histogram, the materials found in it, the scan's blur.

mod blur;
mod deep;
mod find;
mod histogram;
mod sampling;
mod table;

pub use blur::{Blur, DEFAULT_RADIUS, MAX_RADIUS, RADIUS_PER_SIGMA, estimate_blur, radius_per_axis};
pub use find::{
    FindError, Found, MIN_INSIDE_SHARE, Rejected, check_count, check_present, default_name, find_materials,
    measure_statistics,
};
pub use histogram::Histogram;
pub use table::{Material, MaterialTable, MaterialTableError};
