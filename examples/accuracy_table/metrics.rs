//! The figures that targets are set for, and the targets.

use serde::Serialize;

use interfacet::phantom::compare::{Comparison, Distances, EdgeSplit, Groups, PointComparison, Split};

/// Figures of one comparison; in voxels, volumes in percent; absent where there is nothing to measure.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(crate) struct Metrics {
    /// RMS, 99 %, largest error of interfaces farther than 3 voxels from junctions: the worst of all pairs and of both
    /// ways.
    pub away: Option<[f64; 3]>,
    /// The same farther than that from sharp edges too.
    pub away_clear: Option<[f64; 3]>,
    /// The same within 3 voxels of a junction.
    pub near_junction: Option<[f64; 3]>,
    /// RMS, 95 %, largest of junction curves with wedges of 50 degrees and more and a radius of 6 and more: the worse
    /// of both ways.
    pub curve: Option<[f64; 3]>,
    /// The same with narrower wedges.
    pub narrow_curve: Option<[f64; 3]>,
    /// The same of tighter curves.
    pub tight_curve: Option<[f64; 3]>,
    /// RMS, largest of points of four materials.
    pub points: Option<[f64; 2]>,
    /// The same of ends and kinks of junction curves.
    pub kinks: Option<[f64; 2]>,
    /// Points and kinks that are missed.
    pub missed: usize,
    /// RMS, 99 %, largest of sharp edges of 90 degrees, farther than 3 voxels from corners and junctions.
    pub right_edge: Option<[f64; 3]>,
    /// The same within that distance.
    pub right_edge_ends: Option<[f64; 3]>,
    /// Interfaces of the truth of which the mesh has no triangle.
    pub missing_interfaces: usize,
    /// The largest volume error of any material, percent.
    pub volume: Option<f64>,
    /// The largest error of a sphere's radius; infinite where one is missing.
    pub sphere: Option<f64>,
    /// Whether all shells have the components and the Euler characteristic they should.
    pub right_topology: bool,
}

fn figures(d: &Distances) -> [f64; 3] {
    [d.voxels.rms, d.voxels.p99, d.voxels.max]
}

/// The largest of each figure.
fn worst<const N: usize>(all: impl Iterator<Item = [f64; N]>) -> Option<[f64; N]> {
    all.reduce(|a, b| std::array::from_fn(|k| a[k].max(b[k])))
}

impl Metrics {
    /// The figures of a comparison.
    pub(crate) fn of(found: &Comparison) -> Self {
        let group = |of: fn(&Groups) -> Option<Distances>| {
            let both = |pair: &[Split; 2]| pair.map(|split| of(&split.close));
            let pairs = found.pairs.iter().map(|p| [p.mesh_to_truth, p.truth_to_mesh]);
            worst(pairs.flat_map(|pair| both(&pair)).flatten().map(|d| figures(&d)))
        };
        let curves =
            |pick: fn(&interfacet::phantom::compare::JunctionComparison) -> [Option<Distances>; 2]| {
                let both = found.junctions.as_ref().map_or([None; 2], pick);
                worst(both.into_iter().flatten().map(|d| [d.voxels.rms, d.voxels.p95, d.voxels.max]))
            };
        let points = |of: fn(&interfacet::phantom::compare::JunctionComparison) -> PointComparison| {
            let figures = found.junctions.as_ref().map(of)?.distances?.voxels;
            Some([figures.rms, figures.max])
        };
        let edges = |of: fn(&EdgeSplit) -> Option<Distances>| {
            worst(found.edges.iter().filter_map(|e| of(&e.right)).map(|d| figures(&d)))
        };
        let largest = |all: &mut dyn Iterator<Item = f64>| worst(all.map(|v| [v.abs()])).map(|[v]| v);
        Self {
            away: group(|g| g.off_junctions),
            away_clear: group(|g| g.clear),
            near_junction: group(|g| g.near_junction),
            curve: curves(|j| [j.plain.mesh_to_truth, j.plain.truth_to_mesh]),
            narrow_curve: curves(|j| [j.narrow.mesh_to_truth, j.narrow.truth_to_mesh]),
            tight_curve: curves(|j| [j.tight.mesh_to_truth, j.tight.truth_to_mesh]),
            points: points(|j| j.points),
            kinks: points(|j| j.kinks),
            missed: found.junctions.as_ref().map_or(0, |j| j.points.missed + j.kinks.missed),
            right_edge: edges(|e| e.off_ends),
            right_edge_ends: edges(|e| e.at_ends),
            volume: largest(&mut found.materials.iter().filter_map(|m| m.volume_error_percent)),
            sphere: largest(
                &mut found.spheres.iter().map(|s| s.fit.map_or(f64::INFINITY, |fit| fit.radius_error)),
            ),
            missing_interfaces: found.pairs.iter().filter(|p| p.in_truth && p.triangles == 0).count(),
            right_topology: found.materials.iter().all(|m| m.topology == m.expected),
        }
    }
}

/// A row of the table of targets.
#[derive(Debug, Serialize)]
pub(crate) struct Target {
    /// What it is about.
    pub title: &'static str,
    /// The names of its figures.
    pub figures: &'static [&'static str],
    /// What is wanted of each figure, by column of the table; none: for information.
    pub wanted: [&'static [f64]; 3],
    /// Its figures.
    #[serde(skip)]
    pub of: fn(&Metrics) -> Option<Vec<f64>>,
}

const NOTHING: [&[f64]; 3] = [&[]; 3];

/// The table of targets.
pub(crate) const TARGETS: [Target; 13] = [
    Target {
        title: "interfaces farther than 3 voxels from junctions",
        figures: &["RMS", "99 %", "max"],
        wanted: [&[0.02, 0.06, 0.15], &[0.05, 0.15, 0.3], &[0.04, 0.12, 0.25]],
        of: |m| m.away.map(Vec::from),
    },
    Target {
        title: "the same, and from sharp edges",
        figures: &["RMS", "99 %", "max"],
        wanted: [&[0.02, 0.06, 0.15], &[0.05, 0.15, 0.3], &[0.04, 0.12, 0.25]],
        of: |m| m.away_clear.map(Vec::from),
    },
    Target {
        title: "interfaces within 3 voxels of a junction",
        figures: &["RMS"],
        wanted: [&[0.03], &[0.04], &[0.06]],
        of: |m| m.near_junction.map(|f| vec![f[0]]),
    },
    Target {
        title: "junction curves, wedges of 50 degrees and more, radius 6 and more",
        figures: &["RMS", "max"],
        wanted: [&[0.05, 0.15], &[0.08, 0.25], &[0.12, 0.4]],
        of: |m| m.curve.map(|f| vec![f[0], f[2]]),
    },
    Target {
        title: "the same, narrower wedges",
        figures: &["RMS", "max"],
        wanted: [&[0.15, 0.5], &[0.3, 0.8], &[0.3, 0.8]],
        of: |m| m.narrow_curve.map(|f| vec![f[0], f[2]]),
    },
    Target {
        title: "junction curves of a radius under 6",
        figures: &["RMS", "max"],
        wanted: NOTHING,
        of: |m| m.tight_curve.map(|f| vec![f[0], f[2]]),
    },
    Target {
        title: "junction points (four materials)",
        figures: &["max"],
        wanted: [&[0.1], &[0.15], &[0.25]],
        of: |m| m.points.map(|f| vec![f[1]]),
    },
    Target {
        title: "ends and kinks of junction curves",
        figures: &["RMS", "max"],
        wanted: NOTHING,
        of: |m| m.kinks.map(Vec::from),
    },
    Target {
        title: "sharp edges of 90 degrees, farther than 3 voxels from corners and junctions",
        figures: &["RMS", "max"],
        wanted: [&[0.05, 0.2], &[0.1, 0.3], &[0.12, 0.4]],
        of: |m| m.right_edge.map(|f| vec![f[0], f[2]]),
    },
    Target {
        title: "the same, within 3 voxels of them",
        figures: &["RMS", "max"],
        wanted: NOTHING,
        of: |m| m.right_edge_ends.map(|f| vec![f[0], f[2]]),
    },
    Target {
        title: "volume per material, percent",
        figures: &["error"],
        wanted: [&[0.05], &[0.1], &[0.1]],
        of: |m| m.volume.map(|v| vec![v]),
    },
    Target {
        title: "radius of a sphere by least squares",
        figures: &["error"],
        wanted: [&[0.01], &[0.02], &[0.02]],
        of: |m| m.sphere.map(|v| vec![v]),
    },
    Target {
        title: "interfaces without a triangle, points and kinks without a vertex",
        figures: &["missing", "missed"],
        wanted: NOTHING,
        of: |m| Some(vec![m.missing_interfaces as f64, m.missed as f64]),
    },
];
