//! What defines a phantom: [`PhantomOptions`], and why they are refused.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::catalogue::SceneName;
use crate::execution::Cancelled;
use crate::grid::GeometryError;
use crate::material::MaterialTableError;
use crate::volume::SampleType;

/// How strong the noise is that is added to every voxel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Noise {
    /// Standard deviation in percent of the smallest difference of two materials' grey values.
    Percent(f64),
    /// Standard deviation as a grey value.
    Grey(f64),
}

/// Everything that defines a phantom: the same options give the same bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PhantomOptions {
    /// The object.
    pub scene: SceneName,
    /// Voxels per axis.
    pub size: [usize; 3],
    /// Voxel spacing per axis, mm.
    pub spacing: [f64; 3],
    /// Rotation of the object about the x, then y, then z axis, degrees.
    pub rotation: [f64; 3],
    /// Shift of the object's centre from the volume's centre, in voxels per axis. The default is
    /// a fraction of a voxel, so that nothing lies on the lattice by accident.
    pub shift: [f64; 3],
    /// Extent of the rotated object's box as a share of the volume's shortest side (0 to 1).
    pub fill: f64,
    /// Thickness of a thin part or gap, in voxels (edges of the cube with a voxel's volume).
    /// Only some scenes have one.
    pub thickness: f64,
    /// Degrees of the aluminium wedge of the scene `wedge`: 15 to 135.
    pub angle: f64,
    /// Radius of the rounded edges of the scene `fillet`, in voxels.
    pub fillet: f64,
    /// Edges of the box in voxels per axis, before it is turned; `fill` has no say then. Only the scene
    /// `cube` has them; `None`: a cube.
    pub extent: Option<[f64; 3]>,
    /// Every voxel has the grey value of the material at its centre (noise and cupping apart): neither area
    /// sampling nor blur.
    pub binary: bool,
    /// Sigma of the Gaussian blur, in voxels (edges of the cube with a voxel's volume), the same length
    /// in mm in every direction. The box of the voxel adds 1/12 to its square.
    pub sigma: f64,
    /// Sigma in voxels per axis instead of `sigma`: an anisotropic blur.
    pub sigma_axes: Option<[f64; 3]>,
    /// Cupping: how much darker, relative to its difference from the background, a material is in the
    /// middle of the object than at its outermost points; quadratic in the distance.
    pub cupping: f64,
    /// Gaussian noise, added last.
    pub noise: Noise,
    /// Sigma in voxels of the Gaussian by which the noise is filtered before it is brought to its standard
    /// deviation: noise of a reconstruction filter or of interpolation. 0: white noise.
    pub noise_correlation: f64,
    /// Seed of the noise.
    pub seed: u64,
    /// Number type of the samples.
    pub sample_type: SampleType,
    /// Grey value per material, ascending. `None`: those of the scene, scaled to the number type.
    pub greys: Option<Vec<f64>>,
    /// The blur is computed on a grid this many times finer per axis (at least 3 for exact phantoms).
    pub fine: usize,
}

impl Default for PhantomOptions {
    fn default() -> Self {
        Self {
            scene: SceneName::PressFitRing,
            size: [96; 3],
            spacing: [1.0; 3],
            rotation: [7.3, 11.9, 4.1],
            shift: [0.31, -0.17, 0.23],
            fill: 0.75,
            thickness: 4.0,
            angle: 60.0,
            fillet: 3.0,
            extent: None,
            binary: false,
            sigma: 1.15,
            sigma_axes: None,
            cupping: 0.0,
            noise: Noise::Percent(1.0),
            noise_correlation: 0.0,
            seed: 1,
            sample_type: SampleType::U16,
            greys: None,
            fine: 3,
        }
    }
}

/// Why a phantom cannot be made.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PhantomError {
    /// A value outside its range.
    #[error("{name} is {value}, but it must be {range}")]
    Range {
        /// Which option.
        name: &'static str,
        /// As given.
        value: f64,
        /// What it must be.
        range: String,
    },
    /// An extent for a scene that has none.
    #[error("the scene {scene} has no extent of its own; only cube has one")]
    Extent {
        /// The scene.
        scene: &'static str,
    },
    /// The wrong number of grey values.
    #[error("{got} grey values given, but the scene {scene} has {needed} materials ({names})")]
    Greys {
        /// How many were given.
        got: usize,
        /// The scene.
        scene: &'static str,
        /// How many materials it has.
        needed: usize,
        /// Their names.
        names: String,
    },
    /// No scene has this name.
    #[error("there is no scene '{name}'; the scenes are {known}")]
    UnknownScene {
        /// The name as given.
        name: String,
        /// All names.
        known: String,
    },
    /// Size or spacing make no lattice.
    #[error(transparent)]
    Geometry(#[from] GeometryError),
    /// Grey values that make no table.
    #[error(transparent)]
    Materials(#[from] MaterialTableError),
    /// Two surfaces cross in a curve for which there is no closed form.
    #[error("surfaces {first} and {second} of the scene cross in a curve without a closed form")]
    Crossing {
        /// Index of one surface.
        first: usize,
        /// Index of the other.
        second: usize,
    },
    /// A truth file that is not one.
    #[error("not a phantom file: {0}")]
    Json(#[from] serde_json::Error),
    /// A truth file of a later version.
    #[error("a phantom file of version {version}; this program reads version {known}")]
    Version {
        /// As written in the file.
        version: u32,
        /// The one that can be read.
        known: u32,
    },
    /// Stopped before it was done.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl PhantomOptions {
    /// Checks the ranges of all options that the lattice does not check itself.
    pub(super) fn check(&self) -> Result<(), PhantomError> {
        let range = |name, value: f64, ok: bool, range: &str| {
            if ok { Ok(()) } else { Err(PhantomError::Range { name, value, range: range.to_owned() }) }
        };
        let all = |values: &[f64]| values.iter().copied().find(|v| !v.is_finite());
        if let Some(value) = all(&self.rotation) {
            range("rotation", value, false, "a finite number of degrees")?;
        }
        if let Some(value) = all(&self.shift) {
            range("shift", value, false, "a finite number of voxels")?;
        }
        range("fill", self.fill, self.fill > 0.0 && self.fill <= 1.0, "above 0 and at most 1")?;
        let t = self.thickness;
        range("thickness", t, t > 0.0 && t.is_finite(), "a positive number of voxels")?;
        range("angle", self.angle, (15.0..=135.0).contains(&self.angle), "15 to 135 degrees")?;
        let radius = self.fillet;
        range("fillet", radius, radius > 0.0 && radius.is_finite(), "a positive number of voxels")?;
        if self.extent.is_some() && !self.scene.uses_extent() {
            return Err(PhantomError::Extent { scene: self.scene.name() });
        }
        for extent in self.extent.into_iter().flatten() {
            range("extent", extent, extent > 0.0 && extent.is_finite(), "a positive number of voxels")?;
        }
        for sigma in self.sigma_axes.map_or(vec![self.sigma], |s| s.to_vec()) {
            range("sigma", sigma, (0.0..=20.0).contains(&sigma), "0 to 20 voxels")?;
        }
        range("cupping", self.cupping, (0.0..1.0).contains(&self.cupping), "at least 0 and below 1")?;
        let (Noise::Percent(noise) | Noise::Grey(noise)) = self.noise;
        range("noise", noise, noise >= 0.0 && noise.is_finite(), "zero or positive")?;
        let correlation = self.noise_correlation;
        range("noise correlation", correlation, (0.0..=20.0).contains(&correlation), "0 to 20 voxels")?;
        let fine = self.fine as f64;
        range("fine", fine, (1.0..=9.0).contains(&fine), "1 to 9")?;
        Ok(())
    }
}
