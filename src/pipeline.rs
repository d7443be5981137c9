//! The recipe: from a volume to a labelled mesh, in one function that reads as the pipeline.
//!
//! The volume is worked on in slabs of whole slices, as thick as the memory budget of the
//! [`Execution`] allows, and the mesh leaves in pieces: `docs/scale.md`. Slabs, pieces and threads change
//! no bit of the result.

mod curves;
mod denoise;
mod error;
mod memory_plan;
mod options;
mod sink;
mod surface;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::classify::{Classified, ClassifyCounts, ClassifyError, LabelIds, SlabPlan, classify_slabs, halo};
use crate::contour::dual::{self, Statistics};
use crate::execution::{CostLog, Execution};
use crate::grid::Geometry;
use crate::material::{
    Blur, EdgeProfile, Found, Levels, MAX_ESTIMATED_RADIUS, MaterialTable, Noise, OtsuMode, Rejected,
    ScanQuality, SliceThresholds, Survey, TwoClasses, radius_per_axis,
};
use crate::mesh::{InterfaceMesh, MeshMaterial};
use crate::volume::{Denoised, Sample, SampleWindow, VolumeSource};
use crate::with_sample_type;

pub use denoise::DenoiseFound;
pub use error::PipelineError;
pub use options::{
    Accuracy, DualMethod, IsoValue, MaterialChoice, Method, NamedGrey, PipelineOptions, Threshold, Tolerance,
};
pub use sink::{MeshSink, SinkError};

use memory_plan::MemoryPlan;
use options::table_of;
use sink::WholeMesh;
use surface::{Crossings, Surface};

/// All that was found on the way to a mesh.
#[derive(Debug, Clone)]
pub struct Findings {
    /// Where the volume lies.
    pub geometry: Geometry,
    /// What was done about noise; `None` if nothing was.
    pub denoise: Option<DenoiseFound>,
    /// The materials used.
    pub materials: MaterialTable,
    /// Modes of the histogram that were not taken for materials.
    pub rejected: Vec<Rejected>,
    /// The one grey value that parts two materials; `None` for other choices of materials.
    pub iso: Option<IsoFound>,
    /// The blur and the radius used; `None` for a volume of labels.
    pub blur: Option<Blur>,
    /// All clean interfaces on each other; `None` if there were too few or nobody looked.
    pub edge_profile: Option<EdgeProfile>,
    /// The noise of each material by id, without slow drift; empty if nobody looked.
    pub noise: Vec<Option<Noise>>,
    /// The local grey values of each material; `None` for a volume of labels and for a surface of one grey value.
    pub levels: Option<Levels>,
    /// Voxels per class after each pass; `None` for a volume of labels.
    pub classification: Option<ClassifyCounts>,
    /// Voxels of each material in the end.
    pub voxels: Vec<u64>,
    /// What adaptive dual contouring did; `None` for marching.
    pub dual: Option<Statistics>,
    /// What each stage cost.
    pub costs: CostLog,
}

/// The grey value of the surface between two materials that are parted by it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IsoFound {
    /// The grey value.
    pub grey: f64,
    /// How it was found; `None` if it was given.
    pub otsu_mode: Option<OtsuMode>,
}

/// A mesh and all that was found on the way to it.
#[derive(Debug, Clone)]
pub struct Extraction {
    /// What was found.
    pub findings: Findings,
    /// The labelled surface.
    pub mesh: InterfaceMesh,
}

/// If the densest material keeps less than this share of its voxels, its parts are thinner than the
/// classification allows, and an estimated radius is lowered. On the scans tried, a radius that fits
/// keeps 0.84 (the engine) to 0.999.
pub const KEPT_SHARE: f64 = 0.8;

/// What a lowered radius must gain in that share to be preferred.
const KEPT_GAIN: f64 = 0.05;

/// Stages in the order of a run, with their shares of its time on the volumes tried.
const STAGES: [(&str, f64); 4] = [
    ("finding materials", 1.0),
    ("estimating the blur", 0.3),
    ("classifying voxels", 2.0),
    (surface::STAGE, 8.0),
];

/// Extracts the labelled surface of a volume as one mesh in memory.
///
/// # Errors
/// [`PipelineError`]: the first stage that could not do its work, and why.
pub fn extract(
    source: &dyn VolumeSource,
    options: &PipelineOptions,
    execution: &Execution,
) -> Result<Extraction, PipelineError> {
    let mut whole = WholeMesh::default();
    let findings = extract_into(source, options, execution, None, &mut whole)?;
    Ok(Extraction { findings, mesh: whole.finish()? })
}

/// Extracts the labelled surface of a volume of any size, within the memory budget of the execution;
/// the mesh goes to `sink` piece by piece. `scratch` is a folder for labels that memory cannot hold; without
/// one they stay in memory.
///
/// # Errors
/// [`PipelineError`]: the first stage that could not do its work, and why;
/// [`PipelineError::Memory`], before anything is read, if the budget cannot hold a single slab.
pub fn extract_into(
    source: &dyn VolumeSource,
    options: &PipelineOptions,
    execution: &Execution,
    scratch: Option<&Path>,
    sink: &mut dyn MeshSink,
) -> Result<Findings, PipelineError> {
    options.check(source.geometry())?;
    let mut stages = STAGES.to_vec();
    if options.accuracy == Accuracy::Full {
        stages.insert(3, curves::STAGE);
    }
    if matches!(options.method, Method::Dual(_)) {
        // Contouring proper is a third of it.
        stages.extend(dual::STAGES.map(|(stage, share)| (stage, 5.0 * share)));
    }
    let Some(filter) = options.denoise else {
        execution.plan(&[&stages[..], sink.stages()].concat());
        return run(source, options, execution, scratch, plan(source, options, execution, sink)?, sink);
    };
    execution.plan(&[&[(denoise::STAGE, 4.0)], &stages[..], sink.stages()].concat());
    let (seen, mut costs) = (Denoised::new(source, filter)?, CostLog::default());
    let memory = plan(&seen, options, execution, sink)?;
    let (clean, found) = denoise::denoise(source, filter, execution, scratch, &memory, &mut costs)?;
    let memory = memory.reading(clean.reading());
    let mut findings = run(clean.source(), options, execution, scratch, memory, sink)?;
    costs.stages.append(&mut findings.costs.stages);
    Ok(Findings { denoise: Some(found), costs, ..findings })
}

/// The memory plan of a run on `source`, with what is not known yet taken to be at the upper end of the usual.
fn plan(
    source: &dyn VolumeSource,
    options: &PipelineOptions,
    execution: &Execution,
    sink: &dyn MeshSink,
) -> Result<MemoryPlan, PipelineError> {
    let geometry = source.geometry();
    let (budget, slab) = (execution.memory(), execution.slab());
    let reach = match options.accuracy {
        Accuracy::Paper => surface::reach(&options.method),
        Accuracy::Full => surface::reach_of_models(&options.method),
    };
    let mut memory = MemoryPlan::new(geometry.size(), source.sample_type(), reach, budget, slab);
    let materials = match &options.materials {
        MaterialChoice::Given(given) => given.len(),
        MaterialChoice::Find { count, names } => count.unwrap_or(names.len().max(4)),
        MaterialChoice::Labels => 3,
        MaterialChoice::Threshold(_) => 2,
    };
    let radius = options.radius.unwrap_or(MAX_ESTIMATED_RADIUS);
    let halo = halo(radius_per_axis(radius, geometry));
    memory.check(materials, halo, sink.memory())?;
    Ok(memory)
}

/// A run on a volume as it is.
fn run(
    source: &dyn VolumeSource,
    options: &PipelineOptions,
    execution: &Execution,
    scratch: Option<&Path>,
    memory: MemoryPlan,
    sink: &mut dyn MeshSink,
) -> Result<Findings, PipelineError> {
    with_sample_type!(source.sample_type(), S => {
        let window = SampleWindow::<S>::new(source, execution)?;
        let costs = CostLog::default();
        Run { source, options, execution, scratch, memory, window, costs }.run(sink)
    })
}

/// A run on a volume with samples of type `S`.
struct Run<'a, S> {
    source: &'a dyn VolumeSource,
    options: &'a PipelineOptions,
    execution: &'a Execution,
    scratch: Option<&'a Path>,
    memory: MemoryPlan,
    window: SampleWindow<'a, S>,
    costs: CostLog,
}

impl<S: Sample> Run<'_, S> {
    fn run(self, sink: &mut dyn MeshSink) -> Result<Findings, PipelineError> {
        match &self.options.materials {
            MaterialChoice::Labels => self.labels(sink),
            MaterialChoice::Threshold(threshold) => self.level(threshold, sink),
            choice => self.greys(choice, sink),
        }
    }

    /// The main job: materials, blur, classification, contouring (Fujimori and Suzuki).
    fn greys(mut self, choice: &MaterialChoice, sink: &mut dyn MeshSink) -> Result<Findings, PipelineError> {
        let geometry = self.source.geometry().clone();
        let Found { table: materials, rejected } = self.materials(choice)?;
        let ScanQuality { blur, profile, noise } = self.quality(&materials)?;
        let (blur, Classified { store, levels, counts }) = self.classify(&materials, blur)?;
        if let [material] = present(&materials, &counts.labelled)[..] {
            return Err(PipelineError::NoInterface { material: material.into() });
        }
        let levels = Levels::new(&levels, &materials);
        let scan = match self.options.accuracy {
            Accuracy::Paper => None,
            Accuracy::Full => {
                let misfits = profile.as_ref().map_or(&[][..], |p| &p.misfits);
                curves::scan(&geometry, &materials, &blur, &levels, &noise, misfits, range_of::<S>())
            }
        };
        let surface = Surface {
            geometry: &geometry,
            materials: MeshMaterial::from_table(&materials),
            border: self.options.border,
            method: self.options.method,
            slices: self.memory.contouring(materials.count(), &self.plan(&materials, &blur)?)?,
            piece: self.memory.piece,
            execution: self.execution,
        };
        let dual = surface.extract(
            &mut self.window,
            Crossings::Thresholds {
                store: Box::new(store),
                materials: &materials,
                blur: blur.sigma_mm.map(|mm| mm / geometry.voxel_edge()),
                scan: scan.as_ref(),
            },
            sink,
            &mut self.costs,
        )?;
        Ok(Findings {
            geometry,
            denoise: None,
            materials,
            rejected,
            iso: None,
            blur: Some(blur),
            edge_profile: profile,
            noise,
            levels: Some(levels),
            voxels: counts.labelled.clone(),
            dual,
            classification: Some(counts),
            costs: self.costs,
        })
    }

    /// The short way: the volume is segmented already, crossings are midpoints.
    fn labels(mut self, sink: &mut dyn MeshSink) -> Result<Findings, PipelineError> {
        let geometry = self.source.geometry().clone();
        let slices = self.memory.survey()?;
        let stage = self.execution.stage(STAGES[0].0, geometry.size()[2] as u64);
        let mut ids = LabelIds::default();
        let window = &mut self.window;
        self.costs.measure("labels", || {
            window.sweep(slices, 0, |slab, core| {
                stage.advance(core.len() as u64);
                Ok::<_, PipelineError>(ids.add(slab, core)?)
            })
        })?;
        drop(stage);
        let ids = ids.finish()?;
        let name = |id: &f64| format!("label{id}").replace(['.', '+'], "_");
        let materials = MaterialTable::new(ids.labels().iter().map(|id| (name(id), *id)))?;
        let surface = Surface {
            geometry: &geometry,
            materials: MeshMaterial::from_table(&materials),
            border: self.options.border,
            method: self.options.method,
            slices,
            piece: self.memory.piece,
            execution: self.execution,
        };
        let voxels = ids.voxels().to_vec();
        let dual =
            surface.extract(&mut self.window, Crossings::Midpoints { ids: &ids }, sink, &mut self.costs)?;
        let (rejected, blur, classification) = (Vec::new(), None, None);
        Ok(Findings {
            geometry,
            denoise: None,
            materials,
            rejected,
            iso: None,
            blur,
            edge_profile: None,
            noise: Vec::new(),
            levels: None,
            classification,
            voxels,
            dual,
            costs: self.costs,
        })
    }

    /// Two materials: the surface of one grey value, which is given or found (Li et al. §2.2).
    fn level(mut self, threshold: &Threshold, sink: &mut dyn MeshSink) -> Result<Findings, PipelineError> {
        let geometry = self.source.geometry().clone();
        let (slices, stage) = (self.survey_slices()?, self.execution.stage(STAGES[0].0, 0));
        let window = &mut self.window;
        let found = self.costs.measure("materials", || {
            let (grey, otsu_mode) = match threshold.iso {
                IsoValue::Given(iso) => (iso, None),
                IsoValue::OtsuMode => {
                    let mode = SliceThresholds::read(window, slices)?.mode()?;
                    (mode.grey, Some(mode))
                }
            };
            Ok::<_, PipelineError>((
                IsoFound { grey, otsu_mode },
                TwoClasses::read(window, grey as f32, slices)?,
            ))
        });
        drop(stage);
        let (iso, classes) = found?;
        let mut materials = classes.table()?;
        if !threshold.names.is_empty() {
            materials = materials.renamed(&threshold.names)?;
        }
        // Labels are made as they are needed: nothing of them is kept.
        let plan = SlabPlan { slices, steps: 1, scratch: Some(PathBuf::new()) };
        let surface = Surface {
            geometry: &geometry,
            materials: MeshMaterial::from_table(&materials),
            border: self.options.border,
            method: self.options.method,
            slices: slices.min(self.memory.contouring(materials.count(), &plan)?),
            piece: self.memory.piece,
            execution: self.execution,
        };
        let dual = surface.extract(
            &mut self.window,
            Crossings::Level { iso: iso.grey as f32, materials: &materials },
            sink,
            &mut self.costs,
        )?;
        let (voxels, rejected) = (classes.voxels().to_vec(), Vec::new());
        let (blur, classification) = (None, None);
        Ok(Findings {
            geometry,
            denoise: None,
            materials,
            rejected,
            iso: Some(iso),
            blur,
            edge_profile: None,
            noise: Vec::new(),
            levels: None,
            classification,
            voxels,
            dual,
            costs: self.costs,
        })
    }

    /// The materials of a grey volume, found or as given, with their noise measured.
    fn materials(&mut self, choice: &MaterialChoice) -> Result<Found, PipelineError> {
        let stage = self.execution.stage(STAGES[0].0, 0);
        let slices = self.survey_slices()?;
        let window = &mut self.window;
        let found = self.costs.measure("materials", || match choice {
            MaterialChoice::Given(given) => {
                let table = table_of(given)?;
                let survey = Survey::read(window, Some(&table), slices)?;
                survey.check_present()?;
                check_vertices(survey.crossings(&table))?;
                Ok(Found { table: survey.measure_statistics(table), rejected: Vec::new() })
            }
            MaterialChoice::Find { count, names } => {
                let survey = Survey::read(window, None, slices)?;
                let mut found = survey.find_materials(*count)?;
                if !names.is_empty() {
                    found.table = found.table.renamed(names)?;
                }
                check_vertices(survey.crossings(&found.table))?;
                Ok(found)
            }
            MaterialChoice::Labels | MaterialChoice::Threshold(_) => {
                Ok(Survey::read(window, None, slices)?.find_materials(None)?)
            }
        });
        drop(stage);
        found
    }

    /// How blurred the scan is; a radius that is given says nothing of it.
    fn quality(&mut self, materials: &MaterialTable) -> Result<ScanQuality, PipelineError> {
        let geometry = self.source.geometry();
        let given = self.options.radius.map(|radius| Blur::given(radius, geometry));
        if let (Some(blur), Accuracy::Paper) = (given, self.options.accuracy) {
            return Ok(ScanQuality { blur, profile: None, noise: Vec::new() });
        }
        let _stage = self.execution.stage(STAGES[1].0, 0);
        let slices = self.survey_slices()?;
        let window = &mut self.window;
        let mut found =
            self.costs.measure("blur", || ScanQuality::read(window, geometry, materials, slices))?;
        if let Some(Blur { radius, .. }) = given {
            found.blur = Blur { radius, ..found.blur };
        }
        Ok(found)
    }

    /// A window that has read everything keeps everything: only right if there is room for it later.
    fn survey_slices(&self) -> Result<usize, PipelineError> {
        let depth = self.source.geometry().size()[2];
        let slices = self.memory.survey()?;
        Ok(if self.memory.holds_all() { slices } else { slices.min(depth.div_ceil(2)) })
    }

    fn plan(&self, materials: &MaterialTable, blur: &Blur) -> Result<SlabPlan, PipelineError> {
        let halo = halo(blur.radius);
        self.memory.slabs(materials.count(), halo, self.scratch)
    }

    /// Classifies with the radius that the blur asks for, or with a lower estimate where that would lose
    /// too much of the densest material.
    fn classify(
        &mut self,
        materials: &MaterialTable,
        blur: Blur,
    ) -> Result<(Blur, Classified), PipelineError> {
        let geometry = self.source.geometry();
        let asked_for = (blur, self.attempt(materials, &blur)?);
        let mut lowered = None;
        while self.options.radius.is_none()
            && let (blur, attempt) = lowered.as_ref().unwrap_or(&asked_for)
            && kept_share(attempt).is_some_and(|share| share < KEPT_SHARE)
            && let Some(lower) = blur.lowered(geometry)
        {
            // At most two attempts are kept at a time.
            drop(lowered.take());
            lowered = Some((lower, self.attempt(materials, &lower)?));
        }
        let enough = kept_share(&asked_for.1).map(|share| share + KEPT_GAIN);
        let (blur, attempt) = match lowered {
            Some(lowered) if kept_share(&lowered.1) > enough => lowered,
            // If lowering gained nothing it was not thinness: streaks, bright specks, a mean set too high.
            _ => asked_for,
        };
        Ok((blur, attempt?))
    }

    /// One classification, which may fail for reasons that a lower radius mends.
    fn attempt(
        &mut self,
        materials: &MaterialTable,
        blur: &Blur,
    ) -> Result<Result<Classified, ClassifyError>, PipelineError> {
        self.execution.check()?;
        let plan = self.plan(materials, blur)?;
        let (window, execution) = (&mut self.window, self.execution);
        Ok(self
            .costs
            .measure("classify", || classify_slabs(window, materials, blur.radius, &plan, execution)))
    }
}

/// The smallest and the largest value of a sample type; infinite if there are too many in between to be clipped at.
fn range_of<S: Sample>() -> [f64; 2] {
    match S::LEVELS {
        0 => [f64::NEG_INFINITY, f64::INFINITY],
        levels => [0, levels - 1].map(|l| f64::from(S::at_level(l).to_f32())),
    }
}

/// The share of its voxels that the densest material kept; 0 if nothing at all was certain, `None`
/// for a failure of another kind.
fn kept_share(attempt: &Result<Classified, ClassifyError>) -> Option<f64> {
    match attempt {
        Ok(c) => Some(c.counts.densest_kept_share()),
        Err(ClassifyError::NoCore { .. }) => Some(0.0),
        Err(_) => None,
    }
}

/// The names of the materials that have voxels.
fn present<'a>(materials: &'a MaterialTable, voxels: &[u64]) -> Vec<&'a str> {
    let counted = materials.materials().iter().zip(voxels);
    counted.filter(|(_, n)| **n > 0).map(|(m, _)| m.name.as_str()).collect()
}

/// Refuses a surface that is certainly too large to be numbered, before it is made.
fn check_vertices(estimate: u64) -> Result<(), PipelineError> {
    // The estimate counts each crossing of the classes by grey value: within a few percent.
    let limit = i32::MAX.unsigned_abs().into();
    if estimate > limit + limit / 8 {
        return Err(PipelineError::TooManyVertices { vertices: estimate, limit });
    }
    Ok(())
}
