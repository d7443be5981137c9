//! Where interfaces lie, below a voxel: local models fitted to grey values.
//!
//! Published crossings are linear interpolations between two voxels, and midpoints near junctions. Here three
//! models of the blurred scene are fitted to the grey values around instead: a curved sheet between two materials
//! (`sheet`), a wedge of three sheets at a junction curve and one of two at a sharp edge (`wedge`). The voxels near
//! curves get the labels that the models say, and crossings are theirs, with a standard deviation each.
//! Method, figures and limits: `docs/locate.md`.
//!
//! - `gauss`, `frame`, `least_squares`: the normal distribution, blur units, Levenberg-Marquardt.
//! - `sheet`, `wedge`: the models.
//! - `view`: what is fitted to. `patches`, `junction_sites`, `edge_sites`: where, from which start, and when a fit is
//!   accepted; `flanks`: what patches tell wedges.
//! - `site`, `sites`: what a wedge says nearby, and which one speaks for a place.
//! - `passes`: the order of all this, in slabs. `rule`, `hermite`: what contouring asks.
//!
//! Guaranteed: the same result for any slabs and threads. Every decision is local: a pass reads [`halo`] slices
//! beyond its own. Not guaranteed: corners, where curves meet, are not modelled yet; there the published rules
//! stand.

mod crossing_edges;
mod edge_sites;
#[cfg(test)]
mod fixtures;
mod flanks;
mod frame;
mod gauss;
mod hermite;
mod junction_sites;
mod least_squares;
mod passage;
mod passes;
mod patches;
mod rule;
mod sheet;
mod site;
mod sites;
mod view;
mod wedge;

pub use frame::BlurUnits;
pub use hermite::LocatedHermite;
pub use passage::Passage;
pub use passes::{MOST_HALO, Models, Sheets, find_curves, find_junctions, find_sheets, halo, models};
pub use patches::{Flat, Patches, Rough};
pub use rule::{Found, Located};
pub use sheet::{LevelPrior, Sample};
pub use site::Site;
pub use sites::{Answer, CurveKind, Sites};
pub use view::{Scan, Seen, View};
