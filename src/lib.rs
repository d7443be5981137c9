//! interfacet turns an industrial CT volume of an assembly made of several materials into one
//! labelled, non-manifold surface mesh: every triangle knows the material behind it and the
//! material in front of it, every vertex knows whether it lies on an interface, a junction curve, a
//! junction point or the volume's border, and each material's closed shell can be split off.
//!
//! # A tour
//!
//! | step | module | in, out |
//! |---|---|---|
//! | read | [`volume`] | a file or folder -> samples of any box ([`VolumeSource`]) |
//! | find | [`material`] | samples -> mean grey values ([`MaterialTable`]), blur radius R |
//! | classify | [`classify`] | samples -> a material per voxel, junction voxels remembered |
//! | contour | [`contour`] | labelled voxels -> labelled triangles in lattice units |
//! | mesh | [`mesh`] | -> [`InterfaceMesh`] in the world; checks, measures, shells, junction curves |
//! | export | [`export`] | -> PLY, STL, junction curves |
//! | report | [`report`] | -> `report.json`, pictures |
//!
//! [`extract`] in [`pipeline`] does the first five; it reads as the recipe. [`phantom`] makes test
//! volumes with exact truth and compares meshes with it; [`inspect`] compares a mesh with its own scan. [`execution`] carries progress and
//! cancellation. Everything runs on the current rayon pool; no result depends on its size.
//!
//! ```
//! use interfacet::{Execution, Geometry, MemorySource, PipelineOptions, Samples, extract};
//!
//! // A small aluminium block in air, with soft edges.
//! let size = [24, 24, 24];
//! let grey = |i: usize| {
//!     let inside = [i % 24, i / 24 % 24, i / 576].map(|c| 7 - c.abs_diff(12) as i32);
//!     u16::try_from(4000 + 1900 * inside.into_iter().min().unwrap_or(0).clamp(-2, 2) + 3800).unwrap_or(0)
//! };
//! let samples = Samples::U16((0..24 * 24 * 24).map(grey).collect());
//! let source = MemorySource::new(Geometry::axis_aligned(size, [0.2; 3])?, samples)?;
//! let extraction = extract(&source, &PipelineOptions::default(), &Execution::default())?;
//! assert_eq!(extraction.findings.materials.count(), 2);
//! let shells = interfacet::mesh::measure(&extraction.mesh).shells;
//! assert_eq!(shells[0].euler_characteristic, 2); // one closed block
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Words
//!
//! A *voxel* is a grey value at a lattice point, its centre; a *cell* is the cube between eight
//! voxel centres. A *material* has a dense id by ascending grey value; 0 is the background, 255 the
//! world `OUTSIDE` the volume. A [`Pair`] is two different materials, `back` and `front`; an
//! *interface* is the surface between them, its normal pointing to the front. A *junction* is where
//! three or more materials meet: in voxels that grey values cannot decide, along *junction curves*,
//! in *junction points*. A *crossing* is where a cell edge meets an interface. *R* is the radius of
//! the scan's blur, in voxels.

pub mod classify;
pub mod cli;
pub mod contour;
pub mod execution;
pub mod export;
pub mod grid;
pub mod inspect;
pub mod locate;
pub mod material;
pub mod mesh;
pub mod phantom;
pub mod pipeline;
pub mod report;
pub mod triangle;
pub mod volume;

pub use contour::Border;
pub use execution::Execution;
pub use grid::{Geometry, MaterialId, Pair, VertexKind};
pub use material::MaterialTable;
pub use mesh::InterfaceMesh;
pub use pipeline::{Extraction, MaterialChoice, NamedGrey, PipelineOptions, extract};
pub use volume::{MemorySource, Samples, VolumeSource};
