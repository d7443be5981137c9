//! The last pass over a volume: slabs of labels and samples to pieces of mesh.

use std::ops::Range;
use std::time::Instant;

use super::{DualMethod, MeshSink, Method, PipelineError, curves};
use crate::classify::{KnownLabels, LabelStore, LabelVolume};
use crate::contour::dual::{Bound, Builder, DualOptions, Statistics};
use crate::contour::hermite::{GreyHermite, HALO, LabelHermite, PairQuality, Qualities};
use crate::contour::marching::march_pieces;
use crate::contour::{
    Border, CrossingRule, Level, Midpoints, Moves, Piece, Surroundings, Thresholds, layers_of, settle,
    surroundings,
};
use crate::execution::{CostLog, Execution, Stage};
use crate::grid::Geometry;
use crate::locate::{self, Located, LocatedHermite, Scan, Sites, View, models};
use crate::material::MaterialTable;
use crate::mesh::{InterfaceMesh, MeshMaterial, MeshPiece};
use crate::volume::{Sample, SampleWindow};

/// Its name as a stage.
pub(super) const STAGE: &str = "extracting the surface";

/// Slices of samples that contouring reads on each side of a slab.
pub(super) fn reach(method: &Method) -> usize {
    match method {
        Method::Marching => 1,
        Method::Dual(_) => HALO + 1,
    }
}

/// The same at most, for any blur, where models place crossings.
pub(super) fn reach_of_models(method: &Method) -> usize {
    locate::MOST_HALO + reach(method)
}

/// Bytes that dual contouring takes for each crossing, at its peak (docs/performance.md): in the octree alone, with
/// merging after it, and without simplification.
const OCTREE: u64 = 130;
const MERGED: u64 = 290;
const UNSIMPLIFIED: u64 = 530;

/// Where labels come from, and what decides the position of crossings.
pub(super) enum Crossings<'a> {
    /// A classified volume: thresholds.
    Thresholds {
        store: Box<LabelStore>,
        materials: &'a MaterialTable,
        /// Sigma of the blur, in voxels of mean edge, if known.
        blur: Option<f64>,
        /// What the models that place crossings need, if they are to be placed by models.
        scan: Option<&'a Scan>,
    },
    /// The samples are labels: midpoints.
    Midpoints { ids: &'a KnownLabels },
    /// Two materials: those of one grey value.
    Level { iso: f32, materials: &'a MaterialTable },
}

/// How to extract a surface.
pub(super) struct Surface<'a> {
    pub(super) geometry: &'a Geometry,
    pub(super) materials: Vec<MeshMaterial>,
    pub(super) border: Border,
    pub(super) method: Method,
    /// Slices of a slab.
    pub(super) slices: usize,
    /// Triangles of a piece.
    pub(super) piece: usize,
    pub(super) execution: &'a Execution,
}

impl Surface<'_> {
    /// Extracts the surface and hands it to `sink`.
    pub(super) fn extract<S: Sample>(
        &self,
        window: &mut SampleWindow<'_, S>,
        mut crossings: Crossings<'_>,
        sink: &mut dyn MeshSink,
        costs: &mut CostLog,
    ) -> Result<Option<Statistics>, PipelineError> {
        let curves = match &mut crossings {
            Crossings::Thresholds { store, scan: Some(scan), .. } => {
                let started = Instant::now();
                let sites = curves::locate(window, store, scan, self.slices, self.execution)?;
                costs.add("locate", started.elapsed().as_secs_f64());
                sites
            }
            _ => None,
        };
        let curves = curves.as_ref().map(|(scan, sites)| (scan, sites));
        match self.method {
            Method::Marching => {
                let started = Instant::now();
                let known = match (&mut crossings, curves) {
                    (Crossings::Thresholds { store, materials, .. }, Some((scan, sites))) => {
                        Some(self.settle(window, store, materials, scan, sites)?)
                    }
                    _ => None,
                };
                costs.add("settle", started.elapsed().as_secs_f64());
                let curves = curves.zip(known).map(|((scan, sites), known)| Curves { scan, sites, known });
                self.march(window, crossings, curves, sink, costs).map(|()| None)
            }
            Method::Dual(method) => self.dual(window, crossings, curves, &method, sink, costs).map(Some),
        }
    }

    /// Which vertices near curves may lie where models put them, in the whole volume. If that is seen at once, its models are
    /// kept.
    fn settle<S: Sample>(
        &self,
        window: &mut SampleWindow<'_, S>,
        store: &mut LabelStore,
        materials: &MaterialTable,
        scan: &Scan,
        sites: &Sites,
    ) -> Result<Settled, PipelineError> {
        let mut around = Surroundings::default();
        let mut kept = None;
        window.sweep(self.slices, locate::halo(scan.units) + 1 + Surroundings::BEYOND, |slab, core| {
            let layers = layers_of(&(core.start + 1..core.end + 1));
            let (labels, junction) = curves::part(store, slab)?;
            let view = scan.view(&slab, &labels, &junction, self.execution);
            let models = whole(&view, sites, core.clone(), Surroundings::BEYOND)?;
            let otherwise = Thresholds::new(slab, &junction, materials);
            let rule = located(&otherwise, scan, sites, &models, None);
            around.append(surroundings(&models.labels, &rule, self.border, layers, self.execution)?);
            if core.len() == slab.size()[2] {
                kept = Some(models);
            }
            Ok::<_, PipelineError>(())
        })?;
        let moves = settle(around, self.geometry, self.execution)?;
        Ok(Settled { moves, models: kept })
    }

    /// Marching: in slabs, and in pieces to the sink.
    fn march<S: Sample>(
        &self,
        window: &mut SampleWindow<'_, S>,
        mut crossings: Crossings<'_>,
        mut curves: Option<Curves<'_>>,
        sink: &mut dyn MeshSink,
        costs: &mut CostLog,
    ) -> Result<(), PipelineError> {
        let size = self.geometry.size();
        let stage = self.execution.stage(STAGE, size[2] as u64 + 1);
        sink.begin(self.geometry, &self.materials)?;
        let started = Instant::now();
        let mut out = Out { surface: self, sink, stage, first: [0, 0], seconds: 0.0 };
        let reach = curves.as_ref().map_or(reach(&self.method), |curves| locate::halo(curves.scan.units) + 1);
        window.sweep(self.slices, reach, |slab, core| {
            let layers = layers_of(&(core.start + 1..core.end + 1));
            match &mut crossings {
                Crossings::Thresholds { store, materials, .. } if let Some(curves) = &mut curves => {
                    let (labels, junction) = curves::part(store, slab)?;
                    let Curves { scan, sites, known } = curves;
                    let view = scan.view(&slab, &labels, &junction, self.execution);
                    let again = || whole(&view, sites, core.clone(), 0);
                    let models = known.models.take().map_or_else(again, Ok)?;
                    let otherwise = Thresholds::new(slab, &junction, materials);
                    let rule = located(&otherwise, scan, sites, &models, Some(&known.moves));
                    out.march(&models.labels, &rule, layers)
                }
                Crossings::Thresholds { store, materials, .. } => {
                    let (labels, junction) = store.read(layers.start..layers.end + 1)?;
                    out.march(&labels, &Thresholds::new(slab, &junction, materials), layers)
                }
                Crossings::Midpoints { ids } => {
                    let labels = LabelVolume::of_known(slab, ids, layers.start..layers.end + 1);
                    out.march(&labels, &Midpoints, layers)
                }
                Crossings::Level { iso, .. } => {
                    let labels = LabelVolume::of_threshold(slab, *iso, layers.start..layers.end + 1);
                    out.march(&labels, &Level::new(slab, *iso), layers)
                }
            }
        })?;
        let sink_seconds = out.seconds;
        costs.add("contour", started.elapsed().as_secs_f64() - sink_seconds);
        Ok(())
    }

    /// Dual contouring: leaves and Hermite data in slabs, then the surface as a whole, as one piece.
    fn dual<S: Sample>(
        &self,
        window: &mut SampleWindow<'_, S>,
        mut crossings: Crossings<'_>,
        curves: Option<(&Scan, &Sites)>,
        method: &DualMethod,
        sink: &mut dyn MeshSink,
        costs: &mut CostLog,
    ) -> Result<Statistics, PipelineError> {
        let (size, spacing) = (self.geometry.size(), self.geometry.spacing());
        sink.begin(self.geometry, &self.materials)?;
        let started = Instant::now();
        let stage = self.execution.stage(STAGE, size[2] as u64 + 1);
        let qualities = crossings.qualities();
        let mut builder = Builder::new(self.geometry);
        let reach = curves.map_or(reach(&self.method), |(scan, _)| locate::halo(scan.units) + HALO);
        window.sweep(self.slices, reach, |slab, core| {
            let layers = layers_of(&(core.start + 1..core.end + 1));
            let known = layers.start.saturating_sub(HALO)..(layers.end + 1 + HALO).min(size[2] + 2);
            let normals = method.normals;
            match &mut crossings {
                Crossings::Thresholds { store, materials, .. } if let Some((scan, sites)) = curves => {
                    let (labels, junction) = curves::part(store, slab)?;
                    let view = scan.view(&slab, &labels, &junction, self.execution);
                    let models = whole(&view, sites, core.clone(), HALO)?;
                    let otherwise = Thresholds::new(slab, &junction, materials);
                    let rule = located(&otherwise, scan, sites, &models, None);
                    let labels = &models.labels;
                    let rule = LocatedHermite::new(&rule, slab, labels, spacing, normals, &qualities);
                    builder.add(labels, &rule, layers, self.execution, &stage)?;
                }
                Crossings::Thresholds { store, materials, .. } => {
                    let (labels, junction) = store.read(known)?;
                    let rule = Thresholds::new(slab, &junction, materials);
                    let rule = GreyHermite::new(rule, slab, &labels, spacing, normals, &qualities);
                    builder.add(&labels, &rule, layers, self.execution, &stage)?;
                }
                Crossings::Midpoints { ids } => {
                    let labels = LabelVolume::of_known(slab, ids, known);
                    builder.add(
                        &labels,
                        &LabelHermite::new(&labels, spacing),
                        layers,
                        self.execution,
                        &stage,
                    )?;
                }
                Crossings::Level { iso, .. } => {
                    let labels = LabelVolume::of_threshold(slab, *iso, known);
                    let rule = Level::new(slab, *iso);
                    let rule = GreyHermite::new(rule, slab, &labels, spacing, normals, &qualities);
                    builder.add(&labels, &rule, layers, self.execution, &stage)?;
                }
            }
            self.check_memory(builder.crossings(), core.end, method)
        })?;
        drop(stage);
        costs.add("contour", started.elapsed().as_secs_f64());
        let noise = crossings.position_sigma(&qualities);
        let bound = method.tolerance.bound(self.geometry, noise, curves.is_some());
        let (placement, merge) = (method.placement, !method.octree_only);
        let options = DualOptions { bound, placement, merge, noise, deviation: true };
        let mut surface = builder.finish(self.geometry, &options, self.border, self.execution)?;
        costs.stages.append(&mut surface.costs.stages);
        let statistics = surface.statistics.clone();
        let mesh = InterfaceMesh::from_dual(surface, self.materials.clone())?;
        sink.add(MeshPiece::whole(mesh))?;
        Ok(statistics)
    }
}

/// The rule of crossings by models.
fn located<'a>(
    otherwise: &'a dyn CrossingRule,
    scan: &Scan,
    sites: &'a Sites,
    models: &'a locate::Models,
    moves: Option<&'a Moves>,
) -> Located<'a> {
    let locate::Models { labels, zone, patches } = models;
    Located { otherwise, labels, zone, sites, patches, units: scan.units, inflation: scan.inflation, moves }
}

/// The models of some slices ([`models`]), unless it was asked to stop while they were fitted.
fn whole(
    view: &View<'_>,
    sites: &Sites,
    core: Range<usize>,
    beyond: usize,
) -> Result<locate::Models, PipelineError> {
    let models = models(view, sites, core, beyond);
    view.execution.check()?;
    Ok(models)
}

/// What is known of the whole volume when it is marched.
struct Settled {
    moves: Moves,
    /// The models, if they are those of the whole volume.
    models: Option<locate::Models>,
}

/// What models say, to march by.
struct Curves<'a> {
    scan: &'a Scan,
    sites: &'a Sites,
    known: Settled,
}

impl Surface<'_> {
    /// Refuses a surface that the budget cannot hold as a whole, after its crossings in the first `slices`.
    fn check_memory(&self, crossings: u64, slices: usize, method: &DualMethod) -> Result<(), PipelineError> {
        let each = match method.tolerance.bound(self.geometry, 0.0, false) {
            Bound::None => UNSIMPLIFIED,
            Bound::Rms(_) | Bound::Triangles(_) if !method.octree_only => MERGED,
            _ => OCTREE,
        };
        let size = self.geometry.size();
        match self.execution.memory() {
            Some(budget) if crossings * each > budget => {
                // As many again in every slice that is left.
                let needed = crossings * each * size[2] as u64 / slices.max(1) as u64;
                Err(PipelineError::Memory { budget, needed, size })
            }
            _ => Ok(()),
        }
    }
}

impl Crossings<'_> {
    /// How well crossings are known.
    fn qualities(&self) -> Qualities {
        match self {
            Self::Thresholds { materials, blur, .. } => Qualities::new(materials, *blur),
            Self::Level { materials, .. } => Qualities::new(materials, None),
            Self::Midpoints { .. } => Qualities::alike(0, PairQuality::default()),
        }
    }

    /// Standard deviation of the positions of crossings, voxels of mean edge: of the pair where it is largest.
    fn position_sigma(&self, qualities: &Qualities) -> f64 {
        match self {
            // Anywhere between two voxels.
            Self::Midpoints { .. } => (1.0f64 / 12.0).sqrt(),
            _ => qualities.worst_position_sigma(),
        }
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
