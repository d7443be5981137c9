//! Where interfaces lie, below a voxel: local models fitted to grey values.
//!
//! Published crossings are linear interpolations between two voxels, and midpoints near junctions. Here
//! models of the blurred scene are fitted to the grey values around instead: a curved sheet between two materials
//! (`sheet`), a wedge of three sheets at a junction curve and one of two at a sharp edge (`wedge`), three planes or
//! four cones where curves meet (`corner`, `cone`). The voxels near curves get the labels that the models say, and
//! crossings are theirs, with a standard deviation each.
//! Method, figures and limits: `docs/locate.md`.
//!
//! - `gauss`, `frame`, `least_squares`: the normal distribution, blur units, Levenberg-Marquardt.
//! - `batch`, `normal`: many voxels at a time, with SIMD instructions.
//! - `sheet`, `wedge` (`wedge_rows`), `knee` (`knee_rows`; a junction beside an edge, looked for by `knee_fit`), `corner` with `corner_fit` (`corner_rows`) and `orthant`, `cone`: the models.
//! - `view`: what is fitted to. `patches`, `junction_sites`, `edge_sites`: where, from which start, and when a fit is
//!   accepted; `flanks`: what patches tell wedges.
//! - `corner_sites`, `cone_sites`: the same for corners; `corner_planes`: what patches tell them; `corner_starts`:
//!   which octant holds what.
//! - `flat_cores`: labels of parts a little too thin for the published classification, before all else.
//! - `slab_model`, `ball_model`: two interfaces near to each other. `ridges`, `thin`: labels of thin parts, then; `thin_faces`: their patches; `thin_levels`: the levels of materials that are
//!   nowhere thick.
//! - `site`, `corner_site`, `sites`: what a wedge or a corner says nearby, and which one speaks for a place.
//! - `specks`: what neighbouring sites leave between them. `passes`: the order of all this, in slabs. `rule`, `hermite`, `wishes`: what contouring asks.
//!
//! Guaranteed: the same result for any slabs and threads. Every decision is local: a pass reads [`halo`] slices
//! beyond its own. Where no model is accepted, the published rules stand.

mod ball_model;
#[allow(clippy::needless_range_loop)] // loops over batches, for SIMD
mod batch;
mod blend;
mod by_box;
#[allow(clippy::needless_range_loop)] // loops over batches, for SIMD
mod cone;
mod cone_sites;
mod corner;
mod corner_fit;
mod corner_planes;
#[allow(clippy::needless_range_loop)] // loops over batches, for SIMD
mod corner_rows;
mod corner_site;
mod corner_sites;
mod corner_starts;
#[cfg(test)]
mod corner_trials;
mod crossing_edges;
mod edge_sites;
#[cfg(test)]
mod fixtures;
mod flanks;
mod flat_cores;
mod flat_starts;
mod frame;
mod gauss;
mod hermite;
mod junction_fit;
mod junction_sites;
mod knee;
mod knee_fit;
mod knee_rows;
mod least_squares;
mod normal;
#[allow(clippy::needless_range_loop)] // loops over batches, for SIMD
mod orthant;
mod passage;
mod passes;
mod patches;
mod ridges;
mod rule;
mod sheet;
mod site;
mod sites;
mod slab_model;
mod specks;
mod steadied;
mod thin;
mod thin_faces;
mod thin_levels;
mod view;
mod wedge;
#[allow(clippy::needless_range_loop)] // loops over batches, for SIMD
mod wedge_rows;
mod wishes;

pub use corner_site::CornerSite;
pub use flat_cores::{find_flat_cores, reach as flat_reach};
pub use frame::BlurUnits;
pub use hermite::LocatedHermite;
pub use passage::Passage;
pub use passes::{
    MOST_HALO, Models, SheetIndex, Sheets, find_curves, find_junctions, find_sheets, halo, models,
};
pub use patches::{Flat, Patches, Rough};
pub use rule::{Found, Located};
pub use sheet::{LevelPrior, Reading, Sample};
pub use site::Site;
pub use sites::{Answer, CurveKind, Sites};
pub use thin::{Relabelled, find_thin, reach as thin_reach};
pub use thin_levels::{Place, Places};
pub use view::{Scan, Seen, View};
