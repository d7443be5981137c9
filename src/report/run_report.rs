//! `report.json`: what a run was given, what it used, what came out, what is wrong with it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::classify::ClassifyCounts;
use crate::contour::Border;
use crate::contour::dual::Statistics;
use crate::execution::CostLog;
use crate::grid::{Geometry, MaterialId, VertexKind};
use crate::material::{Blur, EdgeProfile, Material, MaterialTable, Noise, Rejected};
use crate::mesh::{Defects, Junctions, MeshReport, Quality, SigmaMeasure};
use crate::pipeline::{DenoiseFound, Findings, IsoFound, KEPT_SHARE, PipelineOptions};

/// The report of a run; lengths in mm, areas in mm², volumes in mm³.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunReport {
    /// Tool and version.
    pub tool: String,
    /// What was read.
    pub input: InputReport,
    /// All options as used.
    pub options: PipelineOptions,
    /// What a user should know before trusting the result.
    pub warnings: Vec<String>,
    /// The filter against noise, and the noise before and after it; `None` without one.
    pub denoise: Option<DenoiseFound>,
    /// The materials, by id.
    pub materials: Vec<MaterialReport>,
    /// Modes of the histogram that were not taken for materials.
    pub rejected_modes: Vec<Rejected>,
    /// The thresholds of all pairs; empty for a volume of labels.
    pub thresholds: Vec<ThresholdReport>,
    /// The one grey value that parts two materials; `None` for other choices of materials.
    pub iso: Option<IsoFound>,
    /// Blur and the radius R used; `None` for a volume of labels and for a surface of one grey value.
    pub blur: Option<Blur>,
    /// The grey profile across all clean interfaces, and how well the blur found explains it; `None` where there
    /// were too few.
    #[serde(default)]
    pub edge_profile: Option<EdgeProfile>,
    /// Voxels per class after each pass, junction voxels, rounds of thinning; `None` where the
    /// blur is.
    pub classification: Option<ClassifyCounts>,
    /// What adaptive dual contouring did; `None` for marching.
    pub dual: Option<Statistics>,
    /// Number of vertices.
    pub vertices: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Each interface.
    pub pairs: Vec<PairReport>,
    /// The non-manifold edges.
    pub non_manifold_edges: NonManifoldReport,
    /// Triangle shapes.
    pub quality: Quality,
    /// Number of defects of all kinds; 0 is the promise for a closed border.
    pub defect_count: u64,
    /// Those among them that an open border does not explain: with an open border, all but the open
    /// edges on it. 0 is the promise.
    pub unexpected_defects: u64,
    /// All defects, located.
    pub defects: Defects,
    /// What each stage cost.
    pub costs: CostLog,
}

/// What was read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InputReport {
    /// The path as given.
    pub path: String,
    /// Number type of the samples.
    pub sample_type: crate::volume::SampleType,
    /// Size, spacing, origin, direction.
    pub geometry: Geometry,
    /// Number of voxels.
    pub voxels: u64,
    /// What the reader assumed or replaced: a spacing the file does not have, say.
    pub notes: Vec<String>,
}

/// One material.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MaterialReport {
    /// Id, name, mean grey value (or label), noise.
    #[serde(flatten)]
    pub material: Material,
    /// Its noise without slow drift, and how that is correlated; `None` where it was not measured.
    #[serde(default)]
    pub noise: Option<Noise>,
    /// The smallest and the largest of its local mean grey values: how far cupping and the like move it. `None`
    /// without voxels well inside.
    #[serde(default)]
    pub level_range: Option<[f64; 2]>,
    /// Voxels labelled with it in the end.
    pub labelled_voxels: u64,
    /// Those voxels times the volume of a voxel.
    pub voxel_volume: f64,
    /// Volume of its closed mesh; `None` for the background and for open shells.
    pub mesh_volume: Option<f64>,
    /// Area of its shell.
    pub area: Option<f64>,
    /// Connected components of its shell: outer surfaces and cavities each count.
    pub components: Option<u64>,
    /// Euler characteristic of its shell, over all components.
    pub euler_characteristic: Option<i64>,
}

/// The threshold of a pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ThresholdReport {
    /// The two materials, lower id first.
    pub materials: [MaterialId; 2],
    /// `t_xy`, halfway between their means; or the iso value.
    pub grey: f64,
}

/// One interface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairReport {
    /// The material behind.
    pub back: String,
    /// The material in front.
    pub front: String,
    /// Its triangles.
    pub triangles: u64,
    /// Its area.
    pub area: f64,
    /// Standard deviations of its vertices' positions, mm, if they are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma: Option<SigmaMeasure>,
}

/// The non-manifold edge report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NonManifoldReport {
    /// Edges where three or more interfaces meet.
    pub edges: u64,
    /// How many of them have how many incident interfaces.
    pub edges_by_interfaces: BTreeMap<u32, u64>,
    /// Junction curves made of them.
    pub curves: Vec<CurveReport>,
    /// Their length in all.
    pub length: f64,
    /// Points where junction curves end or branch.
    pub junction_points: u64,
    /// Edges with one triangle only, as an open border leaves them.
    pub boundary_edges: u64,
    /// Closed loops of boundary edges.
    pub boundary_loops: u64,
    /// Length of all boundary edges.
    pub boundary_length: f64,
}

/// One junction curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CurveReport {
    /// The materials that meet along it, by name.
    pub materials: Vec<String>,
    /// Whether it is a closed loop.
    pub closed: bool,
    /// Its length.
    pub length: f64,
    /// Its number of edges.
    pub edges: u64,
}

impl RunReport {
    /// The report of a run; `mesh` is the check and measure of its mesh, of which `merged_by_stl` vertices
    /// fall together in the coordinates of STL.
    #[must_use]
    pub fn new(
        input: InputReport,
        options: PipelineOptions,
        findings: &Findings,
        mesh: MeshReport,
        merged_by_stl: u64,
    ) -> Self {
        let table = &findings.materials;
        let voxel = findings.geometry.voxel_volume();
        let materials = table.materials().iter().zip(&findings.voxels).map(|(material, &voxels)| {
            let shell = mesh.measures.shells.iter().find(|s| s.material == material.id);
            MaterialReport {
                material: material.clone(),
                noise: findings.noise.get(usize::from(material.id.0)).cloned().flatten(),
                level_range: findings.levels.as_ref().and_then(|levels| levels.drift(material.id)),
                labelled_voxels: voxels,
                voxel_volume: voxels as f64 * voxel,
                mesh_volume: shell.and_then(|s| s.volume),
                area: shell.map(|s| s.area),
                components: shell.map(|s| s.components),
                euler_characteristic: shell.map(|s| s.euler_characteristic),
            }
        });
        let pairs = mesh.measures.pairs.iter().map(|p| PairReport {
            back: name(table, p.pair.back()),
            front: name(table, p.pair.front()),
            triangles: p.triangles,
            area: p.area,
            sigma: p.sigma,
        });
        let unexpected = match options.border {
            Border::Closed => mesh.defects.total(),
            Border::Open => unexplained_by_open_border(&mesh),
        };
        Self {
            tool: concat!("interfacet ", env!("CARGO_PKG_VERSION")).into(),
            input,
            warnings: warnings(&options, findings, &mesh.defects, merged_by_stl),
            options,
            materials: materials.collect(),
            rejected_modes: findings.rejected.clone(),
            thresholds: match &findings.iso {
                Some(iso) => {
                    vec![ThresholdReport { materials: [MaterialId(0), MaterialId(1)], grey: iso.grey }]
                }
                None if findings.classification.is_some() => thresholds(table),
                None => Vec::new(),
            },
            denoise: findings.denoise.clone(),
            iso: findings.iso.clone(),
            blur: findings.blur,
            edge_profile: findings.edge_profile.clone(),
            classification: findings.classification.clone(),
            dual: findings.dual.clone(),
            vertices: mesh.measures.vertices,
            triangles: mesh.measures.triangles,
            pairs: pairs.collect(),
            non_manifold_edges: non_manifold(&mesh.junctions, table),
            quality: mesh.quality,
            defect_count: mesh.defects.total(),
            unexpected_defects: unexpected,
            defects: mesh.defects,
            costs: findings.costs.clone(),
        }
    }
}

/// Defects other than open edges, and boundary edges that are not on the volume's border. (A shell is
/// open exactly along boundary edges and where it meets the border.)
fn unexplained_by_open_border(mesh: &MeshReport) -> u64 {
    let open = mesh.defects.boundary_edges.count + mesh.defects.open_edges.count;
    let on_border = |v: &u32| mesh.junctions.vertices.kind(*v).is_some_and(VertexKind::is_border);
    let inside = mesh.junctions.boundaries.curves.iter().filter(|c| !c.vertices.iter().all(on_border));
    mesh.defects.total() - open + inside.map(|c| c.edges).sum::<u64>()
}

fn name(table: &MaterialTable, id: MaterialId) -> String {
    table.get(id).map_or_else(|| "OUTSIDE".into(), |m| m.name.clone())
}

fn thresholds(table: &MaterialTable) -> Vec<ThresholdReport> {
    let ids: Vec<MaterialId> = table.materials().iter().map(|m| m.id).collect();
    let pairs = ids.iter().enumerate().flat_map(|(i, &x)| ids[i + 1..].iter().map(move |&y| [x, y]));
    pairs.map(|[x, y]| ThresholdReport { materials: [x, y], grey: table.threshold(x, y) }).collect()
}

fn non_manifold(junctions: &Junctions, table: &MaterialTable) -> NonManifoldReport {
    let curves = junctions.curves.iter().map(|c| CurveReport {
        materials: c.materials.iter().map(|&id| name(table, id)).collect(),
        closed: c.closed,
        length: c.length,
        edges: c.edges,
    });
    NonManifoldReport {
        edges: junctions.edges,
        edges_by_interfaces: junctions.edges_by_triangles.clone(),
        curves: curves.collect(),
        length: junctions.length,
        junction_points: junctions.points.len() as u64,
        boundary_edges: junctions.boundaries.edges,
        boundary_loops: junctions.boundaries.loops,
        boundary_length: junctions.boundaries.length,
    }
}

/// What a user should know before trusting the result.
fn warnings(
    options: &PipelineOptions,
    findings: &Findings,
    defects: &Defects,
    merged_by_stl: u64,
) -> Vec<String> {
    let mut out = Vec::new();
    if !defects.self_intersections_checked {
        out.push("self-intersections were not looked for".into());
    }
    for mode in &findings.rejected {
        out.push(format!(
            "a mode of the histogram at grey {:.6} was not taken for a material: {}; name it with --material if it is one",
            mode.grey, mode.reason
        ));
    }
    if let Some(mode) = findings.iso.as_ref().and_then(|iso| iso.otsu_mode.as_ref())
        && 10 * mode.agreeing < mode.with_two_classes
    {
        out.push(format!(
            "the slices' Otsu thresholds scatter: of {} slices only {} agree with the iso value {:.6} to within {:.6}; look at it in `interfacet info`, and give another with --iso",
            mode.with_two_classes, mode.agreeing, mode.grey, mode.window
        ));
    }
    if options.radius.is_none() && findings.blur.is_some_and(|b| b.sigma_mm.is_none()) {
        out.push("too few clean interfaces to estimate the blur; the usual radius was used".into());
    }
    if let Some((from, to)) = findings.blur.and_then(|b| b.lowered_from.map(|from| (from, b.radius))) {
        out.push(format!(
            "the radius R that the blur asks for ({:.2} voxels) would have lost thin parts, so {:.2} was used. Thin parts are found again but not measured: their mean grey, thickness, volume and holes are not reliable, and neither are interfaces between materials that are not neighbours in grey (set R with --radius)",
            from[0], to[0]
        ));
    }
    if merged_by_stl > 0 {
        out.push(format!(
            "{merged_by_stl} vertices fall together in the 32-bit coordinates of STL, as the volume lies far from the origin for its voxels' size: the STL files have defects there, the PLY files do not"
        ));
    }
    let unused = findings.materials.materials().iter().zip(&findings.voxels).filter(|(_, n)| **n == 0);
    for (material, _) in unused {
        out.push(format!(
            "no voxel became {} (grey {:.6}): it occurs only in parts thinner than the blur allows, or its grey value is only that of a blurred interface",
            material.name, material.mean
        ));
    }
    if let Some(counts) = findings.classification.as_ref().filter(|c| c.densest_kept_share() < KEPT_SHARE) {
        let densest = findings.materials.count() - 1;
        out.push(format!(
            "{} has {} voxels by grey value but only {} were kept: parts thinner than twice the blur radius are lost (try a smaller --radius)",
            findings.materials.materials()[densest].name, counts.alpha[densest], counts.densest_kept
        ));
    }
    out
}
