//! The recipe: from a volume to a labelled mesh, in one function that reads as the pipeline.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::classify::{Classification, ClassifyCounts, ClassifyError, LabelVolume, check_radius, classify};
use crate::contour::marching::march;
use crate::contour::{Border, ContourError, Midpoints, Thresholds};
use crate::execution::{Cancelled, CostLog, Execution};
use crate::grid::Geometry;
use crate::material::{
    Blur, FindError, Found, MaterialTable, MaterialTableError, Rejected, Survey, check_count, estimate_blur,
    radius_per_axis,
};
use crate::mesh::{InterfaceMesh, MeshError, MeshMaterial};
use crate::volume::{Sample, Slab, VolumeError, VolumeSource};
use crate::with_samples;

/// What to make of a volume.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct PipelineOptions {
    /// Where the materials come from.
    pub materials: MaterialChoice,
    /// Radius R of the blur in voxels (of mean edge length); estimated where `None`.
    pub radius: Option<f64>,
    /// What happens at the volume's border.
    pub border: Border,
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
}

impl Default for MaterialChoice {
    fn default() -> Self {
        Self::Find { count: None, names: Vec::new() }
    }
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
        }
        if let Some(radius) = self.radius {
            check_radius(radius_per_axis(radius, geometry))?;
        }
        Ok(())
    }
}

/// Why a volume did not become a mesh.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// It could not be read.
    #[error(transparent)]
    Volume(#[from] VolumeError),
    /// No materials were found.
    #[error(transparent)]
    Find(#[from] FindError),
    /// The materials given are not usable.
    #[error(transparent)]
    Materials(#[from] MaterialTableError),
    /// It could not be classified.
    #[error(transparent)]
    Classify(#[from] ClassifyError),
    /// The surface could not be extracted.
    #[error(transparent)]
    Contour(#[from] ContourError),
    /// All voxels became one material.
    #[error(
        "every voxel was given to the material '{material}', so there is no interface; check the materials' grey values (`interfacet info` shows the histogram), or try a smaller --radius"
    )]
    NoInterface {
        /// Its name.
        material: String,
    },
    /// The surface makes no mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A mesh and all that was found on the way to it.
#[derive(Debug, Clone)]
pub struct Extraction {
    /// Where the volume lies.
    pub geometry: Geometry,
    /// The materials used.
    pub materials: MaterialTable,
    /// Modes of the histogram that were not taken for materials.
    pub rejected: Vec<Rejected>,
    /// The blur and the radius used; `None` for a volume of labels.
    pub blur: Option<Blur>,
    /// Voxels per class after each pass; `None` for a volume of labels.
    pub classification: Option<ClassifyCounts>,
    /// Voxels of each material in the end.
    pub voxels: Vec<u64>,
    /// The labelled surface.
    pub mesh: InterfaceMesh,
    /// What each stage cost.
    pub costs: CostLog,
}

/// If the densest material keeps less than this share of its voxels, its parts are thinner than the
/// classification allows, and an estimated radius is lowered. On the scans tried, a radius that fits
/// keeps 0.84 (the engine) to 0.999.
pub const KEPT_SHARE: f64 = 0.8;

/// What a lowered radius must gain in that share to be preferred.
const KEPT_GAIN: f64 = 0.05;

/// Extracts the labelled surface of a volume.
///
/// # Errors
/// [`PipelineError`]: the first stage that could not do its work, and why.
pub fn extract(
    source: &dyn VolumeSource,
    options: &PipelineOptions,
    execution: &Execution,
) -> Result<Extraction, PipelineError> {
    options.check(source.geometry())?;
    let mut costs = CostLog::default();
    let stage = execution.stage("reading", 0);
    let samples = costs.measure("read", || source.read_all())?;
    drop(stage);
    execution.check()?;
    let geometry = source.geometry().clone();
    with_samples!(&samples, values => match &options.materials {
        MaterialChoice::Labels => from_labels(values, geometry, options, costs, execution),
        choice => from_greys(values, geometry, choice, options, costs, execution),
    })
}

/// The main job: materials, blur, classification, contouring (Fujimori and Suzuki).
fn from_greys<S: Sample>(
    samples: &[S],
    geometry: Geometry,
    choice: &MaterialChoice,
    options: &PipelineOptions,
    mut costs: CostLog,
    execution: &Execution,
) -> Result<Extraction, PipelineError> {
    let size = geometry.size();
    let slab = Slab::whole(samples, size);
    let stage = execution.stage("finding materials", 0);
    let Found { table: materials, rejected } =
        costs.measure("materials", || choose_materials(|given| Ok(Survey::of(slab, given)?), choice))?;
    let blur = costs.measure("blur", || match options.radius {
        Some(radius) => Blur::given(radius, &geometry),
        None => estimate_blur(slab, &geometry, &materials),
    });
    drop(stage);
    let classified = |blur: &Blur, costs: &mut CostLog| {
        execution.check()?;
        Ok::<_, PipelineError>(
            costs.measure("classify", || classify(slab, &materials, blur.radius, execution)),
        )
    };
    let asked_for = (blur, classified(&blur, &mut costs)?);
    let mut lowered = None;
    while options.radius.is_none()
        && let (blur, attempt) = lowered.as_ref().unwrap_or(&asked_for)
        && kept_share(attempt).is_some_and(|share| share < KEPT_SHARE)
        && let Some(lower) = blur.lowered(&geometry)
    {
        lowered = Some((lower, classified(&lower, &mut costs)?));
    }
    let enough = kept_share(&asked_for.1).map(|share| share + KEPT_GAIN);
    let (blur, attempt) = match lowered {
        Some(lowered) if kept_share(&lowered.1) > enough => lowered,
        // If lowering gained nothing it was not thinness: streaks, bright specks, a mean set too high.
        _ => asked_for,
    };
    let Classification { labels, junction, counts } = attempt?;
    if let [material] = present(&materials, &counts.labelled)[..] {
        return Err(PipelineError::NoInterface { material: material.into() });
    }
    let rule = Thresholds::new(slab, &junction, &materials);
    let patch = costs.measure("contour", || march(&labels, &rule, options.border, execution))?;
    let listed = MeshMaterial::from_table(&materials);
    let mesh = costs.measure("mesh", || InterfaceMesh::from_patch(patch, &geometry, listed))?;
    let voxels = counts.labelled.clone();
    Ok(Extraction {
        geometry,
        materials,
        rejected,
        blur: Some(blur),
        classification: Some(counts),
        voxels,
        mesh,
        costs,
    })
}

/// The share of its voxels that the densest material kept; 0 if nothing at all was certain, `None`
/// for a failure of another kind.
fn kept_share(attempt: &Result<Classification, ClassifyError>) -> Option<f64> {
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

/// The short way: the volume is segmented already, crossings are midpoints.
fn from_labels<S: Sample>(
    samples: &[S],
    geometry: Geometry,
    options: &PipelineOptions,
    mut costs: CostLog,
    execution: &Execution,
) -> Result<Extraction, PipelineError> {
    let (labels, ids) = costs.measure("labels", || LabelVolume::from_labels(samples, geometry.size()))?;
    execution.check()?;
    let name = |id: &f64| format!("label{id}").replace(['.', '+'], "_");
    let materials = MaterialTable::new(ids.iter().map(|id| (name(id), *id)))?;
    let patch = costs.measure("contour", || march(&labels, &Midpoints, options.border, execution))?;
    let listed = MeshMaterial::from_table(&materials);
    let mesh = costs.measure("mesh", || InterfaceMesh::from_patch(patch, &geometry, listed))?;
    let voxels = labels.counts();
    let (rejected, blur, classification) = (Vec::new(), None, None);
    Ok(Extraction { geometry, materials, rejected, blur, classification, voxels, mesh, costs })
}

/// The materials of a grey volume, found or as given, with their noise measured. `survey` surveys it, for
/// the materials given if they are.
fn choose_materials<S: Sample>(
    survey: impl FnOnce(Option<&MaterialTable>) -> Result<Survey<S>, VolumeError>,
    choice: &MaterialChoice,
) -> Result<Found, PipelineError> {
    match choice {
        MaterialChoice::Given(given) => {
            let table = table_of(given)?;
            let survey = survey(Some(&table))?;
            survey.check_present()?;
            Ok(Found { table: survey.measure_statistics(table), rejected: Vec::new() })
        }
        MaterialChoice::Find { count, names } => {
            let mut found = survey(None)?.find_materials(*count)?;
            if !names.is_empty() {
                found.table = found.table.renamed(names)?;
            }
            Ok(found)
        }
        MaterialChoice::Labels => Ok(survey(None)?.find_materials(None)?),
    }
}

fn table_of(given: &[NamedGrey]) -> Result<MaterialTable, MaterialTableError> {
    MaterialTable::new(given.iter().map(|m| (m.name.clone(), m.grey)))
}
