//! Test objects with exact geometry: volumes to extract from, and the truth to compare with.
//!
//! A [`Phantom`] is made from [`PhantomOptions`] alone. It knows its lattice, its materials and its
//! [`Truth`] (closest points on every interface and junction curve, exact volumes, topology), and
//! [`Phantom::rasterise`] turns it into a volume as a scanner with a known blur and known noise would.
//! [`compare`] measures a mesh against the truth.
//!
//! Guaranteed: the same options give the same bytes for any number of threads; distances, curves and
//! volumes are closed forms, limited by rounding only. Not modelled: beam hardening other than the
//! cupping option, scatter, rings, unsharpness that changes over the volume.

mod catalogue;
pub mod compare;
mod corners;
mod curve;
#[cfg(test)]
mod image_tests;
mod noise;
mod objects;
mod options;
mod pieces;
mod raster;
mod scene;
mod sidecar;
mod surface;
#[cfg(test)]
mod tests;
mod truth;

use glam::{DMat3, DVec3};

pub use catalogue::{SceneName, Topology};
pub use curve::Curve;
pub use options::{Noise, PhantomError, PhantomOptions};
pub use pieces::{CurvePiece, OnCurve};
pub use scene::Scene;
pub use sidecar::{Sidecar, SidecarEdge, SidecarMaterial};
pub use surface::Surface;
pub use truth::{Closest, Truth};

use crate::execution::Execution;
use crate::grid::Geometry;
use crate::material::MaterialTable;
use crate::volume::{SampleType, Samples};

/// A test object in its volume.
#[derive(Debug, Clone)]
pub struct Phantom {
    options: PhantomOptions,
    geometry: Geometry,
    materials: MaterialTable,
    truth: Truth,
}

impl Phantom {
    /// The phantom that `options` describe.
    ///
    /// # Errors
    /// [`PhantomError`] names the option that is not usable.
    pub fn new(options: &PhantomOptions) -> Result<Self, PhantomError> {
        options.check()?;
        let geometry = Geometry::axis_aligned(options.size, options.spacing)?;
        let materials = materials(options)?;
        let rotation = surface::rotation(options.rotation);
        let half = match options.extent {
            Some(extent) => 0.5 * DVec3::from(extent) * DVec3::from(options.spacing),
            None => DVec3::ONE,
        };
        let scale = scale(options, &geometry, &rotation, half)?;
        let voxel = geometry.voxel_edge() / scale;
        for (name, value, limit) in [
            ("thickness", options.thickness, options.scene.max_thickness()),
            ("fillet", options.fillet, options.scene.max_fillet()),
        ] {
            if value * voxel > limit {
                let range = format!("at most {:.1} voxels in a volume of this size", limit / voxel);
                return Err(PhantomError::Range { name, value, range });
            }
        }
        let limit = options.scene.max_voxel();
        if voxel > limit {
            let needed = (options.size.map(|n| n as f64).into_iter().fold(f64::INFINITY, f64::min) * voxel
                / limit)
                .ceil();
            let range = format!("such that the object's parts fit: about {needed} voxels per axis or more");
            return Err(PhantomError::Range { name: "size", value: options.size[0] as f64, range });
        }
        let shape = objects::Shape {
            thickness: options.thickness * voxel,
            half,
            angle: options.angle,
            fillet: options.fillet * voxel,
            voxel,
        };
        let middle = DVec3::from(options.size.map(|n| 0.5 * (n as f64 - 1.0)));
        let centre = geometry.world(middle + DVec3::from(options.shift));
        let blueprint = options.scene.blueprint(shape);
        let scene = blueprint.scene.placed(&rotation, scale, centre);
        let volumes = blueprint.volumes.iter().map(|v| v * scale.powi(3)).collect();
        let radius = scale
            * match options.scene.bounds(half) {
                catalogue::Bounds::Box(half) => half.length(),
                catalogue::Bounds::Ball(radius) => radius,
            };
        let truth = Truth::new(scene, (centre, radius), volumes, blueprint.topology)?;
        Ok(Self { options: options.clone(), geometry, materials, truth })
    }

    /// What it was made from.
    #[must_use]
    pub fn options(&self) -> &PhantomOptions {
        &self.options
    }

    /// The lattice of its volume.
    #[must_use]
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Its materials with their exact grey values (before cupping and noise).
    #[must_use]
    pub fn materials(&self) -> &MaterialTable {
        &self.materials
    }

    /// Its exact geometry in the world, mm.
    #[must_use]
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// Standard deviation of its noise as a grey value.
    #[must_use]
    pub fn noise_sigma(&self) -> f64 {
        match self.options.noise {
            Noise::Grey(sigma) => sigma,
            Noise::Percent(percent) => {
                let means = self.materials.materials();
                let contrast = means.windows(2).map(|w| w[1].mean - w[0].mean).fold(f64::INFINITY, f64::min);
                0.01 * percent * contrast
            }
        }
    }

    /// Sigma of its blur, mm per axis, without the voxel's own box.
    #[must_use]
    pub fn sigma_mm(&self) -> [f64; 3] {
        if self.options.binary {
            return [0.0; 3];
        }
        let spacing = self.geometry.spacing();
        match self.options.sigma_axes {
            Some(axes) => std::array::from_fn(|a| axes[a] * spacing[a]),
            None => [self.options.sigma * self.geometry.voxel_edge(); 3],
        }
    }

    /// The volume: area-sampled on the fine grid, blurred there, averaged over each voxel, with noise; or
    /// sampled at the voxels' centres, with noise.
    ///
    /// # Errors
    /// [`PhantomError::Cancelled`] if it was stopped.
    pub fn rasterise(&self, execution: &Execution) -> Result<Samples, PhantomError> {
        raster::rasterise(self, execution)
    }
}

/// mm per unit of the object: its rotated box fills the wanted share of the shortest side. A box with an extent
/// has mm for units; it must fit.
fn scale(
    options: &PhantomOptions,
    geometry: &Geometry,
    rotation: &DMat3,
    half: DVec3,
) -> Result<f64, PhantomError> {
    let sides = DVec3::from(geometry.spacing()) * DVec3::from(options.size.map(|n| n as f64));
    let reach = match options.scene.bounds(half) {
        catalogue::Bounds::Ball(radius) => DVec3::splat(radius),
        catalogue::Bounds::Box(half) => DVec3::from([0, 1, 2].map(|a| rotation.row(a).abs().dot(half))),
    };
    let Some(extent) = options.extent else {
        return Ok(0.5 * options.fill * sides.min_element() / reach.max_element());
    };
    // A hair more for rounding: a box as large as the volume is right.
    let over = (0..3).find(|&a| 2.0 * reach[a] > sides[a] * (1.0 + 1e-9));
    over.map_or(Ok(1.0), |a| {
        let range = format!(
            "so small that the turned box ({:.1} voxels along {}) fits into the volume",
            2.0 * reach[a] / geometry.spacing()[a],
            ["x", "y", "z"][a]
        );
        Err(PhantomError::Range { name: "extent", value: extent[a], range })
    })
}

fn materials(options: &PhantomOptions) -> Result<MaterialTable, PhantomError> {
    let scene = options.scene.materials();
    let names = scene.iter().map(|(name, _)| *name);
    let Some(greys) = &options.greys else {
        // The defaults are 16-bit values; 160 brings the brightest to 250, 2 to within i16.
        let divisor = match options.sample_type {
            SampleType::U8 => 160.0,
            SampleType::I16 => 2.0,
            SampleType::U16 | SampleType::F32 => 1.0,
        };
        return Ok(MaterialTable::new(scene.iter().map(|(name, grey)| (*name, grey / divisor)))?);
    };
    if greys.len() != scene.len() {
        return Err(PhantomError::Greys {
            got: greys.len(),
            scene: options.scene.name(),
            needed: scene.len(),
            names: names.collect::<Vec<_>>().join(", "),
        });
    }
    Ok(MaterialTable::new(names.zip(greys.iter().copied()))?)
}
