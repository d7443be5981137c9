//! The last pass over a volume: slabs of labels and samples to pieces of mesh.

use std::ops::Range;
use std::time::Instant;

use super::{MeshSink, PipelineError};
use crate::classify::{KnownLabels, LabelStore, LabelVolume};
use crate::contour::marching::march_pieces;
use crate::contour::{Border, CrossingRule, Level, Midpoints, Piece, Thresholds, layers_of};
use crate::execution::{CostLog, Execution, Stage};
use crate::grid::Geometry;
use crate::material::MaterialTable;
use crate::mesh::{MeshMaterial, MeshPiece};
use crate::volume::{Sample, SampleWindow};

/// Its name as a stage.
pub(super) const STAGE: &str = "extracting the surface";

/// Where labels come from, and what decides the position of crossings.
pub(super) enum Crossings<'a> {
    /// A classified volume: thresholds.
    Thresholds { store: Box<LabelStore>, materials: &'a MaterialTable },
    /// The samples are labels: midpoints.
    Midpoints { ids: &'a KnownLabels },
    /// Two materials: those of one grey value.
    Level { iso: f32 },
}

/// How to extract a surface.
pub(super) struct Surface<'a> {
    pub(super) geometry: &'a Geometry,
    pub(super) materials: Vec<MeshMaterial>,
    pub(super) border: Border,
    /// Slices of a slab.
    pub(super) slices: usize,
    /// Triangles of a piece.
    pub(super) piece: usize,
    pub(super) execution: &'a Execution,
}

impl Surface<'_> {
    /// Extracts the surface in slabs and hands it to `sink` in pieces.
    pub(super) fn extract<S: Sample>(
        &self,
        window: &mut SampleWindow<'_, S>,
        mut crossings: Crossings<'_>,
        sink: &mut dyn MeshSink,
        costs: &mut CostLog,
    ) -> Result<(), PipelineError> {
        let size = self.geometry.size();
        let stage = self.execution.stage(STAGE, size[2] as u64 + 1);
        sink.begin(self.geometry, &self.materials)?;
        let started = Instant::now();
        let mut out = Out { surface: self, sink, stage, first: [0, 0], seconds: 0.0 };
        window.sweep(self.slices, 1, |slab, core| {
            let layers = layers_of(&(core.start + 1..core.end + 1));
            match &mut crossings {
                Crossings::Thresholds { store, materials } => {
                    let (labels, junction) = store.read(layers.start..layers.end + 1)?;
                    out.march(&labels, &Thresholds::new(slab, &junction, materials), layers)
                }
                Crossings::Midpoints { ids } => {
                    let labels = LabelVolume::of_known(slab, ids, layers.start..layers.end + 1);
                    out.march(&labels, &Midpoints, layers)
                }
                Crossings::Level { iso } => {
                    let labels = LabelVolume::of_threshold(slab, *iso, layers.start..layers.end + 1);
                    out.march(&labels, &Level::new(slab, *iso), layers)
                }
            }
        })?;
        let sink_seconds = out.seconds;
        costs.add("contour", started.elapsed().as_secs_f64() - sink_seconds);
        Ok(())
    }
}

/// Pieces on their way to the sink.
struct Out<'a> {
    surface: &'a Surface<'a>,
    sink: &'a mut dyn MeshSink,
    stage: Stage<'a>,
    /// Number of the next vertex and triangle.
    first: [u64; 2],
    /// Time spent in the sink.
    seconds: f64,
}

impl Out<'_> {
    fn march<C: CrossingRule>(
        &mut self,
        labels: &LabelVolume,
        rule: &C,
        layers: Range<usize>,
    ) -> Result<(), PipelineError> {
        let Surface { border, execution, piece, .. } = *self.surface;
        let most = self.sink.piece().unwrap_or(piece);
        march_pieces(labels, rule, border, layers, most, execution, &mut |piece| self.hand_on(piece))
    }

    fn hand_on(&mut self, piece: Piece) -> Result<(), PipelineError> {
        let layers = piece.layers.len() as u64;
        let Surface { geometry, materials, .. } = self.surface;
        let piece = MeshPiece::from_contour(piece, geometry, materials.clone(), self.first)?;
        let limit = i32::MAX.unsigned_abs().into();
        let vertices = self.first[0] + piece.mesh.positions().len() as u64;
        if vertices > limit {
            return Err(PipelineError::TooManyVertices { vertices, limit });
        }
        self.first[0] += piece.owned as u64;
        self.first[1] += piece.mesh.triangles().len() as u64;
        let started = Instant::now();
        self.sink.add(piece)?;
        self.seconds += started.elapsed().as_secs_f64();
        self.stage.advance(layers);
        Ok(())
    }
}
