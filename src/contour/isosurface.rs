//! The surface of one grey value: contouring of two materials without any classification.

use super::crossing::Level;
use super::error::ContourError;
use super::marching::march;
use super::patch::{Border, Patch};
use crate::classify::LabelVolume;
use crate::execution::Execution;
use crate::volume::{Sample, Slab};

/// Extracts the surface between grey values below `threshold` (material 0) and the others (material 1),
/// for a slab that holds the whole volume. Crossings by linear interpolation; topology as everywhere in
/// [`marching`](super::marching), ambiguous faces by the bilinear interpolant.
///
/// # Errors
/// As [`march`].
pub fn isosurface<S: Sample>(
    slab: Slab<'_, S>,
    threshold: f32,
    border: Border,
    execution: &Execution,
) -> Result<Patch, ContourError> {
    let labels = LabelVolume::from_threshold(slab, threshold);
    march(&labels, &Level::new(slab, threshold), border, execution)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classify::{BitPlanes, alpha};
    use crate::contour::Thresholds;
    use crate::material::MaterialTable;

    #[test]
    fn an_isosurface_is_the_contour_of_two_materials() {
        let size = [66, 5, 6];
        let samples: Vec<u16> =
            (0..66 * 5 * 6).map(|i: u32| (i.wrapping_mul(i).wrapping_mul(7919) % 1009) as u16).collect();
        let slab = Slab::whole(&samples, size);
        let table = MaterialTable::new([("air", 300.0), ("iron", 800.0)]).unwrap();
        let labels = LabelVolume::from_planes(&alpha(slab, &table, 1..size[2] + 1));
        assert_eq!(LabelVolume::from_threshold(slab, 550.0), labels);
        let credible = BitPlanes::new(size, 1);
        for border in [Border::Closed, Border::Open] {
            let execution = Execution::default();
            let expected = march(&labels, &Thresholds::new(slab, &credible, &table), border, &execution);
            assert_eq!(isosurface(slab, 550.0, border, &execution).unwrap(), expected.unwrap());
        }
    }
}
