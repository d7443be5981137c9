//! One look at a volume whose materials are known: how blurred it is, and how noisy.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;

use super::blur::Blur;
use super::blur_axes::{Fitted, blur, weighted_quantile};
use super::edge_fit::fit;
use super::edge_patches::{Patches, REACH};
use super::edge_profile::{EdgeProfile, Misfit};
use super::local_noise::{self, Lines, Noise};
use super::sampling::steps;
use super::table::MaterialTable;
use crate::grid::Geometry;
use crate::volume::{Sample, SampleWindow, Slab, VolumeError};

/// Slices that this look must see on both sides of those it looks at.
pub const QUALITY_HALO: usize = if REACH + 1 > local_noise::REACH { REACH + 1 } else { local_noise::REACH };

/// What a scan is like.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanQuality {
    /// Its blur, and the radius that asks for.
    pub blur: Blur,
    /// All interfaces on each other; `None` if there were too few.
    pub profile: Option<EdgeProfile>,
    /// The noise of each material, by id; `None` where too few voxels are well inside.
    pub noise: Vec<Option<Noise>>,
}

impl ScanQuality {
    /// Of a volume in memory.
    ///
    /// # Panics
    /// If the slab does not hold all slices.
    #[must_use]
    pub fn of<S: Sample>(slab: Slab<'_, S>, geometry: &Geometry, materials: &MaterialTable) -> Self {
        let mut look = Look::new(geometry, materials);
        steps(slab.size()).for_each(|core| look.add(slab, core));
        look.finish(S::LEVELS > 0)
    }

    /// Of a volume in one pass of a window on it, by slabs of `thickness` slices (and [`QUALITY_HALO`]). The
    /// same for any thickness.
    ///
    /// # Errors
    /// [`VolumeError`] if the volume cannot be read.
    pub fn read<S: Sample>(
        window: &mut SampleWindow<'_, S>,
        geometry: &Geometry,
        materials: &MaterialTable,
        thickness: usize,
    ) -> Result<Self, VolumeError> {
        let mut look = Look::new(geometry, materials);
        window.sweep(thickness, QUALITY_HALO, |slab, core| {
            look.add(slab, core);
            Ok::<_, VolumeError>(())
        })?;
        Ok(look.finish(S::LEVELS > 0))
    }
}

struct Look<'a> {
    geometry: &'a Geometry,
    patches: Patches<'a>,
    lines: Lines,
}

impl<'a> Look<'a> {
    fn new(geometry: &'a Geometry, materials: &'a MaterialTable) -> Self {
        let (size, spacing) = (geometry.size(), geometry.spacing());
        Self { geometry, patches: Patches::new(size, spacing, materials), lines: Lines::new(size, materials) }
    }

    fn add<S: Sample>(&mut self, slab: Slab<'_, S>, core: Range<usize>) {
        self.patches.add(slab, core.clone());
        self.lines.add(slab, core);
    }

    fn finish(self, whole: bool) -> ScanQuality {
        let spacing = self.geometry.spacing();
        let patches = self.patches.finish();
        let fitted: Vec<Fitted> = patches
            .into_par_iter()
            .filter_map(|(patch, weight)| fit(&patch, spacing).map(|fit| (patch, fit, weight)))
            .collect();
        let noise = self.lines.finish(whole);
        let (blur, mut profile) = blur(self.geometry, &fitted);
        if let Some(profile) = &mut profile {
            profile.misfits = misfits(&fitted, &noise);
        }
        ScanQuality { blur, profile, noise }
    }
}

/// The median over the lower quartile, to this power, is what a logarithmic normal distribution has at nine in ten over the
/// median.
const NINE_IN_TEN: f64 = 1.9;
/// What white noise alone makes of that, over the voxels of a patch.
const BY_NOISE: f64 = 1.1;
/// Fewest patches of a pair that tell something.
const MIN_PATCHES: usize = 12;

/// What the interfaces of each pair show beyond the noise of their materials.
fn misfits(fitted: &[Fitted], noise: &[Option<Noise>]) -> Vec<Misfit> {
    // Squared deviations of each pair's interfaces, and what noise explains of them.
    let mut beyond: BTreeMap<[usize; 2], Vec<(f64, f64, f64)>> = BTreeMap::new();
    for (patch, fit, weight) in fitted {
        let [a, b] = patch.materials;
        let known = || [a, b].into_iter().filter_map(|m| noise[m].as_ref().map(|n| n.sigma * n.sigma));
        let count = known().count();
        if count > 0 {
            let contrast = fit.plateaus[1] - fit.plateaus[0];
            let noise = known().sum::<f64>() / count as f64;
            let [all, noise] = [fit.rms * fit.rms, noise].map(|v| v / (contrast * contrast));
            beyond.entry([a.min(b), a.max(b)]).or_default().push((all, noise, *weight));
        }
    }
    let told = beyond.into_iter().filter(|(_, patches)| patches.len() >= MIN_PATCHES);
    told.map(|(pair, found)| {
        let patches = found.len();
        let beyond: Vec<(f64, f64)> = found.iter().map(|f| (f.0 - f.1, f.2)).collect();
        let all: Vec<(f64, f64)> = found.iter().map(|f| (f.0, f.2)).collect();
        let [quartile, median] = [0.25, 0.5].map(|part| weighted_quantile(&all, part));
        let share = weighted_quantile(&beyond, 0.5).max(0.0).sqrt();
        let spread = if quartile > 0.0 {
            (libm::pow(median / quartile, NINE_IN_TEN) / BY_NOISE).max(1.0)
        } else {
            1.0
        };
        Misfit { pair, patches, share, spread }
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::DEFAULT_RADIUS;
    use crate::material::edge_fit::normal_cdf;

    #[test]
    fn the_blur_of_a_tilted_step_is_found_on_an_anisotropic_lattice() {
        let size = [40, 30, 30];
        let spacing = [0.4, 0.4, 0.5];
        let geometry = Geometry::axis_aligned(size, spacing).unwrap();
        let n = glam::DVec3::new(1.0, 0.2, 0.15).normalize();
        for sigma in [0.35, 0.5, 0.8] {
            let samples: Vec<u16> = (0..36_000)
                .map(|i| {
                    let p = [i % 40, i / 40 % 30, i / 1200].map(|c| c as f64);
                    let d = n.dot(glam::DVec3::from(std::array::from_fn(|a| p[a] * spacing[a]))) - 9.0;
                    (4000.0 + 7600.0 * normal_cdf(d / sigma)) as u16
                })
                .collect();
            let table = MaterialTable::new([("air", 4000.0), ("al", 11600.0)]).unwrap();
            let blur = ScanQuality::of(Slab::whole(&samples, size), &geometry, &table).blur;
            let found = blur.sigma_mm.unwrap();
            assert!((found / sigma - 1.0).abs() < 0.001, "{found} for {sigma}, {} profiles", blur.profiles);
            assert!((blur.radius[0] / blur.radius[2] - 1.25).abs() < 1e-9);
        }
    }

    #[test]
    fn without_profiles_the_usual_radius_is_taken() {
        let geometry = Geometry::axis_aligned([20; 3], [1.0; 3]).unwrap();
        let table = MaterialTable::new([("air", 0.0), ("al", 10.0)]).unwrap();
        let blur = ScanQuality::of(Slab::whole(&[0u8; 8000], [20; 3]), &geometry, &table).blur;
        assert_eq!((blur.sigma_mm, blur.sigma_axes_mm, blur.profiles), (None, None, 0));
        assert!((blur.radius[0] - DEFAULT_RADIUS).abs() < 1e-9);
    }
}
