//! What to make of a volume.

use serde::{Deserialize, Serialize};

use super::PipelineError;
use crate::classify::check_radius;
use crate::contour::dual::{Bound, Placement};
use crate::contour::{Border, NormalRule};
use crate::grid::Geometry;
use crate::material::{FindError, MaterialTable, MaterialTableError, check_count, radius_per_axis};
use crate::volume::Denoise;

/// What to make of a volume.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct PipelineOptions {
    /// The filter that takes noise out of the volume before all else, if any.
    pub denoise: Option<Denoise>,
    /// Where the materials come from.
    pub materials: MaterialChoice,
    /// Radius R of the blur in voxels (of mean edge length); estimated where `None`.
    pub radius: Option<f64>,
    /// What happens at the volume's border.
    pub border: Border,
    /// How the surface is made.
    pub method: Method,
    /// How well crossings are placed.
    pub accuracy: Accuracy,
}

/// How well the crossings of a grey volume with several materials are placed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Accuracy {
    /// As published: linear interpolation between two voxels, and midpoints near junctions.
    Paper,
    /// By models of the blurred scene fitted to the grey values: see [`crate::locate`].
    #[default]
    Full,
}

/// How the surface is made.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Generalized marching cubes: triangles in every cell (Fujimori and Suzuki).
    #[default]
    Marching,
    /// Adaptive dual contouring: few triangles where the surface is flat, sharp edges kept (Li et al. 2022).
    Dual(DualMethod),
}

/// How adaptive dual contouring simplifies.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DualMethod {
    /// How far the surface may move.
    pub tolerance: Tolerance,
    /// Where a vertex goes whose best place is outside its block.
    pub placement: Placement,
    /// Whether to stop at the octree, as the paper does, and not to merge vertices beyond its blocks.
    pub octree_only: bool,
    /// How normals are estimated; segmented volumes have one way only.
    pub normals: NormalRule,
}

/// How far simplification may move the surface.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tolerance {
    /// What the noise of the scan asks for: see [`Tolerance::LEAST`], [`Tolerance::PER_SIGMA`] and [`Tolerance::LEAST_OF_MODELS`].
    #[default]
    Auto,
    /// Root mean square distance in voxels (of mean edge length); negative: no simplification.
    Voxels(f64),
    /// The same in mm.
    Millimetres(f64),
    /// The paper's parameter: sum of squared distances in voxels squared; negative: no simplification.
    Phi(f64),
    /// The one that gives about this many triangles.
    Triangles(u64),
}

impl Tolerance {
    /// The tolerance of a scan without noise, in voxels.
    pub const LEAST: f64 = 0.1;
    /// The same where models place the crossings: what is well known is not to be thrown away.
    pub const LEAST_OF_MODELS: f64 = 0.02;
    /// By how much fits lessen the noise that single crossings have, about.
    pub const GAIN_OF_MODELS: f64 = 3.0;
    /// The tolerance of a noisy scan in standard deviations of its crossings: below about one of them
    /// hardly anything may collapse.
    pub const PER_SIGMA: f64 = 1.5;

    /// The bound for a volume that lies as `geometry` says and whose crossings are known to a standard deviation of
    /// `sigma` voxels, by models of the blurred scene or not.
    #[must_use]
    pub fn bound(self, geometry: &Geometry, sigma: f64, by_models: bool) -> Bound {
        let unless_negative = |value: f64, bound: Bound| if value < 0.0 { Bound::None } else { bound };
        match self {
            Self::Auto if by_models => {
                Bound::Rms(Self::LEAST_OF_MODELS.max(Self::PER_SIGMA / Self::GAIN_OF_MODELS * sigma))
            }
            Self::Auto => Bound::Rms(Self::LEAST.max(Self::PER_SIGMA * sigma)),
            Self::Voxels(rms) => unless_negative(rms, Bound::Rms(rms)),
            Self::Millimetres(mm) => unless_negative(mm, Bound::Rms(mm / geometry.voxel_edge())),
            Self::Phi(sum) => unless_negative(sum, Bound::Sum(sum)),
            Self::Triangles(count) => Bound::Triangles(count),
        }
    }
}

/// Where the materials come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MaterialChoice {
    /// Found in the volume: their number too, unless it is given.
    Find {
        /// How many, if known.
        count: Option<usize>,
        /// Their names by ascending grey value, the background's first; as many as there are. Empty:
        /// `air`, `material1`, ...
        names: Vec<String>,
    },
    /// Given by name and mean grey value, in ascending order, the background first.
    Given(Vec<NamedGrey>),
    /// The volume holds labels, not grey values: each label is a material, the lowest the
    /// background.
    Labels,
    /// Two materials, parted by one grey value.
    Threshold(Threshold),
}

impl Default for MaterialChoice {
    fn default() -> Self {
        Self::Find { count: None, names: Vec::new() }
    }
}

/// Two materials, parted by one grey value: the background below, material at or above it. Every voxel
/// belongs to one of them by its own grey value alone, and the surface is that of the grey value.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Threshold {
    /// Which grey value.
    pub iso: IsoValue,
    /// Names of the background and of the material. Empty: `air`, `material1`.
    pub names: Vec<String>,
}

/// A grey value to make a surface of.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IsoValue {
    /// The mode of the slices' Otsu thresholds (Li et al. 2022, §2.2).
    #[default]
    OtsuMode,
    /// This one.
    Given(f64),
}

/// A material given by the user.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedGrey {
    /// Its name.
    pub name: String,
    /// Its mean grey value.
    pub grey: f64,
}

impl PipelineOptions {
    /// What can be refused before a volume of this geometry is read, which may take minutes.
    ///
    /// # Errors
    /// [`PipelineError`] names the option.
    pub fn check(&self, geometry: &Geometry) -> Result<(), PipelineError> {
        match &self.materials {
            MaterialChoice::Find { count, names } => {
                check_count(*count)?;
                if !names.is_empty() {
                    // Any grey values will do to find out whether the names do.
                    MaterialTable::new(names.iter().cloned().zip((0..).map(f64::from)))?;
                }
            }
            MaterialChoice::Given(given) => drop(table_of(given)?),
            MaterialChoice::Labels => {}
            MaterialChoice::Threshold(Threshold { iso, names }) => {
                if let IsoValue::Given(iso) = *iso
                    && !(iso as f32).is_finite()
                {
                    return Err(FindError::IsoNotFinite { iso }.into());
                }
                if !names.is_empty() {
                    MaterialTable::new([("0", 0.0), ("1", 1.0)])?.renamed(names)?;
                }
            }
        }
        self.check_denoise(geometry)?;
        if let Method::Dual(DualMethod { tolerance, .. }) = self.method {
            let value = match tolerance {
                Tolerance::Voxels(v) | Tolerance::Millimetres(v) | Tolerance::Phi(v) => v,
                Tolerance::Auto | Tolerance::Triangles(_) => 0.0,
            };
            if !value.is_finite() {
                return Err(PipelineError::Tolerance { value });
            }
        }
        if let Some(radius) = self.radius {
            check_radius(radius_per_axis(radius, geometry))?;
        }
        Ok(())
    }
}

/// The table of materials given.
pub(super) fn table_of(given: &[NamedGrey]) -> Result<MaterialTable, MaterialTableError> {
    MaterialTable::new(given.iter().map(|m| (m.name.clone(), m.grey)))
}
