//! Interfaces of a mesh against the true ones, and triangles that belong nowhere.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Lengths;
use super::nearest::Triangles;
use super::statistics::{Distances, Sample};
use crate::execution::{Cancelled, Execution};
use crate::grid::{MaterialId, Pair};
use crate::mesh::InterfaceMesh;
use crate::phantom::Truth;

/// A mesh point farther than this from the truth (in voxels) is disturbed: a third material has spoilt it.
/// It is also the largest error that is allowed anywhere clear of junctions.
pub const DISTURBED: f64 = 0.35;

/// Distances of the points in each surrounding, told apart by some distance; `None` where there are none. The last
/// three share all points among them, in the order near a junction, near an edge, clear.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Groups {
    /// Farther from every junction curve than the distance, whether near a sharp edge or not.
    pub off_junctions: Option<Distances>,
    /// Farther than the distance from every junction curve and every sharp edge.
    pub clear: Option<Distances>,
    /// Of `off_junctions`: within the distance of a sharp edge, which any blur rounds.
    pub near_edge: Option<Distances>,
    /// Within the distance of a junction curve.
    pub near_junction: Option<Distances>,
}

/// Distances of all points, and of those in each surrounding.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Split {
    /// All points.
    pub all: Option<Distances>,
    /// Told apart by [`CompareOptions::clear`](super::CompareOptions::clear); in JSON the fields stand beside `all`.
    #[serde(flatten)]
    pub wide: Groups,
    /// Told apart by [`CompareOptions::near`](super::CompareOptions::near).
    #[serde(default)]
    pub close: Groups,
}

/// One pair's interface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairComparison {
    /// The material behind.
    pub back: u8,
    /// The material in front.
    pub front: u8,
    /// Whether the two meet in the truth. If not, all its triangles are false.
    pub in_truth: bool,
    /// Its triangles in the mesh.
    pub triangles: usize,
    /// Their area, mm².
    pub mesh_area: f64,
    /// Area of the true interface, mm² (from samples: good to about a percent).
    pub truth_area: f64,
    /// From the mesh to the truth.
    pub mesh_to_truth: Split,
    /// From the truth to the mesh.
    pub truth_to_mesh: Split,
    /// How far from the junction curves, in voxels, the mesh is disturbed: the largest distance at which a
    /// point more than [`DISTURBED`] from the truth lies, points near sharp edges left out; 0 if there is none.
    pub disturbed_reach: f64,
}

/// A number of triangles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// How many.
    pub triangles: usize,
    /// Their area, mm².
    pub area: f64,
    /// Their share of the area of all triangles (without the border), percent.
    pub share_percent: f64,
}

/// Triangles of a pair that does not meet in the truth, or whose centre is farther than the clear distance
/// from their pair's true interface.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct FalseTriangles {
    /// With their centre within the clear distance of a junction curve.
    pub near: Tally,
    /// Beyond it.
    pub clear: Tally,
    /// Of `near` and `clear`: those of pairs that do not meet in the truth.
    pub wrong_pair: Tally,
}

pub(super) struct Surfaces {
    pub(super) pairs: Vec<PairComparison>,
    pub(super) false_triangles: FalseTriangles,
    pub(super) vertex_errors: Vec<f64>,
}

/// A sample and where it is.
#[derive(Clone, Copy)]
struct Placed {
    sample: Sample,
    /// Distance of the closest junction curve in mm; infinite if there is none.
    junction: f64,
    /// Distance of the closest sharp edge in mm; infinite if there is none.
    edge: f64,
}

impl Placed {
    /// `p` is where the point lies.
    fn new(sample: Sample, truth: &Truth, p: DVec3) -> Self {
        let distance = |closest: Option<(DVec3, f64)>| closest.map_or(f64::INFINITY, |c| c.1);
        Self { sample, junction: distance(truth.closest_junction(p)), edge: distance(truth.closest_edge(p)) }
    }
}

pub(super) fn compare(
    mesh: &InterfaceMesh,
    truth: &Truth,
    lengths: &Lengths,
    execution: &Execution,
) -> Result<Surfaces, Cancelled> {
    let mut pairs: Vec<Pair> = mesh.pairs().iter().copied().chain(truth.pairs().iter().copied()).collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs.retain(|p| !p.contains(MaterialId::OUTSIDE));
    let truth_samples = truth.all_samples(lengths.step);
    let mut out = Surfaces {
        pairs: Vec::new(),
        false_triangles: FalseTriangles::default(),
        vertex_errors: vec![f64::NAN; mesh.positions().len()],
    };
    let stage = execution.stage("comparing interfaces", 2 * pairs.len() as u64);
    for pair in pairs {
        execution.check()?;
        let own: Vec<usize> = (0..mesh.triangles().len()).filter(|&t| mesh.pairs()[t] == pair).collect();
        let in_truth = truth.pairs().contains(&pair);
        tally_false(mesh, truth, lengths, &own, in_truth, &mut out.false_triangles);
        let forward = if in_truth { forward(mesh, truth, lengths, pair, &own, &mut out) } else { Vec::new() };
        stage.advance(1);
        execution.check()?;
        let points: Vec<(DVec3, f64)> =
            truth_samples.iter().filter(|s| s.0 == pair).map(|s| (s.1, s.2)).collect();
        let found = Triangles::new(mesh.positions(), own.iter().map(|&t| mesh.triangles()[t]));
        let backward = found.map_or_else(Vec::new, |t| backward(truth, &points, &t));
        stage.advance(1);
        out.pairs.push(PairComparison {
            back: pair.back().0,
            front: pair.front().0,
            in_truth,
            triangles: own.len(),
            mesh_area: own.iter().map(|&t| area(mesh.corners(t))).sum(),
            truth_area: points.iter().map(|p| p.1).sum(),
            mesh_to_truth: split(&forward, lengths),
            truth_to_mesh: split(&backward, lengths),
            disturbed_reach: disturbed_reach(&forward, lengths),
        });
    }
    let total: f64 = out.pairs.iter().map(|p| p.mesh_area).sum();
    let tallies = &mut out.false_triangles;
    for tally in [&mut tallies.near, &mut tallies.clear, &mut tallies.wrong_pair] {
        tally.share_percent = if total > 0.0 { 100.0 * tally.area / total } else { 0.0 };
    }
    Ok(out)
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

fn is_clear(truth: &Truth, p: DVec3, clear: f64) -> bool {
    truth.closest_junction(p).is_none_or(|(_, distance)| distance > clear)
}

fn split(samples: &[Placed], lengths: &Lengths) -> Split {
    Split {
        all: Distances::of(samples.iter().map(|s| s.sample), lengths.voxel),
        wide: groups(samples, lengths.clear, lengths.voxel),
        close: groups(samples, lengths.near, lengths.voxel),
    }
}

fn groups(samples: &[Placed], distance: f64, voxel: f64) -> Groups {
    // Arguments: off the junctions, near an edge.
    let part = |keep: fn(bool, bool) -> bool| {
        let kept = samples.iter().filter(|s| keep(s.junction > distance, s.edge <= distance));
        Distances::of(kept.map(|s| s.sample), voxel)
    };
    Groups {
        off_junctions: part(|off, _| off),
        clear: part(|off, near_edge| off && !near_edge),
        near_edge: part(|off, near_edge| off && near_edge),
        near_junction: part(|off, _| !off),
    }
}

fn disturbed_reach(samples: &[Placed], lengths: &Lengths) -> f64 {
    let disturbed = |s: &&Placed| s.sample.signed.abs() > DISTURBED * lengths.voxel;
    samples
        .iter()
        .filter(disturbed)
        .filter(|s| s.edge > lengths.clear && s.junction.is_finite())
        .map(|s| s.junction / lengths.voxel)
        .fold(0.0, f64::max)
}

/// Centres of the equal parts of a triangle with edges of at most `step`: all parts have the same area.
fn parts([a, b, c]: [DVec3; 3], step: f64) -> impl Iterator<Item = (DVec3, f64)> {
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    // A triangle hundreds of steps long is a defect; it needs no more points to be seen.
    let m = ((longest / step).ceil() as usize).clamp(1, 256);
    let (u, v) = ((b - a) / m as f64, (c - a) / m as f64);
    let weight = area([a, b, c]) / (m * m) as f64;
    (0..m).flat_map(move |i| {
        let upright = (0..m - i).map(move |j| (i as f64 + 1.0 / 3.0, j as f64 + 1.0 / 3.0));
        let inverted =
            (0..(m - i).saturating_sub(1)).map(move |j| (i as f64 + 2.0 / 3.0, j as f64 + 2.0 / 3.0));
        upright.chain(inverted).map(move |(i, j)| (a + i * u + j * v, weight))
    })
}

fn forward(
    mesh: &InterfaceMesh,
    truth: &Truth,
    lengths: &Lengths,
    pair: Pair,
    own: &[usize],
    out: &mut Surfaces,
) -> Vec<Placed> {
    let place = |p: DVec3, weight: f64| {
        truth.closest(pair, p).map(|found| Placed::new(Sample { signed: found.signed(), weight }, truth, p))
    };
    let mut samples: Vec<Placed> = own
        .par_iter()
        .flat_map_iter(|&t| parts(mesh.corners(t), lengths.step))
        .filter_map(|(p, weight)| place(p, weight))
        .collect();
    let mut vertices: Vec<u32> = own.iter().flat_map(|&t| mesh.triangles()[t]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    let at: Vec<Option<Placed>> =
        vertices.par_iter().map(|&v| place(mesh.positions()[v as usize], 0.0)).collect();
    for (v, found) in vertices.iter().zip(&at) {
        let Some(Placed { sample, .. }) = found else { continue };
        let worst = &mut out.vertex_errors[*v as usize];
        if worst.is_nan() || sample.signed.abs() > worst.abs() {
            *worst = sample.signed;
        }
    }
    samples.extend(at.into_iter().flatten());
    samples
}

fn backward(truth: &Truth, points: &[(DVec3, f64)], mesh: &Triangles) -> Vec<Placed> {
    points
        .par_iter()
        .map(|&(p, weight)| Placed::new(Sample { signed: mesh.signed(p), weight }, truth, p))
        .collect()
}

fn tally_false(
    mesh: &InterfaceMesh,
    truth: &Truth,
    lengths: &Lengths,
    own: &[usize],
    in_truth: bool,
    out: &mut FalseTriangles,
) {
    let found: Vec<(f64, bool)> = own
        .par_iter()
        .filter_map(|&t| {
            let corners = mesh.corners(t);
            let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
            let right = in_truth
                && truth.closest(mesh.pairs()[t], centre).is_some_and(|c| c.distance <= lengths.clear);
            (!right).then(|| (area(corners), is_clear(truth, centre, lengths.clear)))
        })
        .collect();
    for (area, clear) in found {
        let add = |tally: &mut Tally| {
            tally.triangles += 1;
            tally.area += area;
        };
        add(if clear { &mut out.clear } else { &mut out.near });
        if !in_truth {
            add(&mut out.wrong_pair);
        }
    }
}
