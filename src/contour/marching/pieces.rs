//! Contouring run by run: bounded pieces of surface, in order, from the planes at hand.

use std::ops::Range;

use rayon::prelude::*;

use super::count::LayerCount;
use super::fill::{VertexSlices, put_plane};
use super::lattice::Plane;
use super::{Job, RUN};
use crate::classify::LabelVolume;
use crate::contour::crossing::CrossingRule;
use crate::contour::error::ContourError;
use crate::contour::patch::Border;
use crate::contour::pattern::PatternTable;
use crate::contour::piece::{Piece, SeamKey};
use crate::execution::{Execution, Stage};

/// Extracts the interfaces in a run of layers as pieces, in order: consecutive layers that have at most
/// `max_triangles` triangles together, or one layer. Layer z lies between the padded planes z and z + 1;
/// a volume of n slices has the layers 0..=n. Merged, the pieces of all layers are what
/// [`march`](super::march) makes, bit for bit, however they were cut.
///
/// `labels` and what `rule` reads need to hold the padded planes from `layers.start` to `layers.end`,
/// both included (voxels are in the padded planes 1..=n). At most as many pieces as there are threads are
/// in memory at a time, and two bytes for each cell with a crossing in about as many layers.
///
/// # Errors
/// Any error of `emit`, which ends the work; [`ContourError::MissingPlanes`] if `labels` holds too little;
/// [`ContourError::TooManyVertices`] or [`ContourError::TooManyTriangles`] for a single piece;
/// [`ContourError::Cancelled`] if asked to stop.
pub fn march_pieces<C: CrossingRule, E: From<ContourError>>(
    labels: &LabelVolume,
    rule: &C,
    border: Border,
    layers: Range<usize>,
    max_triangles: usize,
    execution: &Execution,
    emit: &mut dyn FnMut(Piece) -> Result<(), E>,
) -> Result<(), E> {
    let (held, all) = (labels.codes().slices(), labels.codes().padded()[2] - 1);
    if layers.end > all || (!layers.is_empty() && (layers.start < held.start || layers.end >= held.end)) {
        let [needed, held] = [[layers.start, layers.end], [held.start, held.end.saturating_sub(1)]];
        return Err(ContourError::MissingPlanes { needed, held }.into());
    }
    let stage = execution.stage("contouring", 2 * layers.len() as u64);
    let job = Job { labels, rule, border, table: PatternTable::get(), execution };
    let threads = rayon::current_num_threads();
    let mut pending = Pending { layers: layers.start..layers.start, counts: Vec::new(), max_triangles };
    while pending.layers.end < layers.end {
        let batch = pending.layers.end..(pending.layers.end + 2 * RUN * threads).min(layers.end);
        pending.layers.end = batch.end;
        pending.counts.extend(job.count(batch, &stage)?);
        let last = pending.layers.end == layers.end;
        loop {
            let group: Vec<_> = std::iter::from_fn(|| pending.take(last)).take(threads).collect();
            if group.is_empty() {
                break;
            }
            let pieces = group.into_par_iter().map(|(layers, counts)| job.piece(layers, &counts, &stage));
            for piece in pieces.collect::<Result<Vec<_>, ContourError>>()? {
                emit(piece)?;
            }
        }
    }
    Ok(())
}

/// Layers that are counted and not yet made into pieces.
struct Pending {
    layers: Range<usize>,
    counts: Vec<LayerCount>,
    max_triangles: usize,
}

impl Pending {
    /// Takes the layers of the next piece, if it is known where that ends; `last` says that no more
    /// layers will come.
    fn take(&mut self, last: bool) -> Option<(Range<usize>, Vec<LayerCount>)> {
        let mut triangles = 0;
        let fits = |c: &LayerCount| {
            triangles += c.triangles;
            triangles <= self.max_triangles
        };
        let full = self.counts.iter().map(fits).position(|fits| !fits);
        let n = match full {
            Some(n) => n.max(1),
            None if last && !self.counts.is_empty() => self.counts.len(),
            None => return None,
        };
        let start = self.layers.start;
        self.layers.start += n;
        Some((start..start + n, self.counts.drain(..n).collect()))
    }
}

impl<C: CrossingRule> Job<'_, C> {
    /// The piece of these layers.
    fn piece(
        &self,
        layers: Range<usize>,
        counts: &[LayerCount],
        stage: &Stage<'_>,
    ) -> Result<Piece, ContourError> {
        let [below, above] =
            [layers.start, layers.end].map(|z| Plane::new(self.labels, self.rule, self.border, z));
        let mut patch = self.fill(layers.start, counts, above.vertices() as usize, stage)?;
        let owned = counts.iter().map(|c| c.vertices).sum::<usize>();
        let last = counts.last().map_or([0, 0], |c| [c.vertices, c.triangles]);
        let last_layer = [owned - last[0], patch.triangles.len() - last[1]];
        let mut seam = VertexSlices::of(&mut patch.positions, &mut patch.kinds, &mut patch.sigmas);
        put_plane(self, &above, &mut seam, &mut owned.clone());
        let [seam_below, seam_above] = [below, above].map(|plane| keys(&plane));
        Ok(Piece { layers, patch, owned, last_layer, seam_below, seam_above })
    }
}

/// Keys of the vertices in a plane, in order of their numbers.
fn keys(plane: &Plane) -> Vec<u64> {
    let [x_edges, y_edges] = &plane.edges;
    let kinds = [
        (SeamKey::X_EDGE, x_edges),
        (SeamKey::Y_EDGE, y_edges),
        (SeamKey::Z_FACE, &plane.nodes),
        (SeamKey::Z_KINK, &plane.kinks),
    ];
    let keys = kinds
        .into_iter()
        .flat_map(|(kind, rows)| rows.iter().map(move |(x, y)| SeamKey::new(kind, [x, y, plane.z]).0));
    keys.collect()
}
