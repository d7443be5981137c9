//! Normals of crossings against the truth of a phantom.

#![allow(dead_code, clippy::unwrap_used, clippy::print_stdout)] // each user takes its part; one prints

use glam::DVec3;
use interfacet::classify::{BitPlanes, LabelVolume, classify};
use interfacet::contour::hermite::{GreyHermite, LabelHermite, Qualities};
use interfacet::contour::{HermiteRule, NormalRule, Thresholds};
use interfacet::execution::Execution;
use interfacet::grid::Pair;
use interfacet::material::MaterialTable;
use interfacet::phantom::{Noise, Phantom, PhantomOptions, SceneName};
use interfacet::volume::{Samples, Slab};

/// A crossing as estimated and as it is.
pub(crate) struct Found {
    /// Angle between the normals, degrees.
    pub(crate) degrees: f64,
    /// Distance of the position from the surface, voxels.
    pub(crate) off: f64,
    /// Distances from the nearest sharp edge and junction curve, voxels.
    pub(crate) edge: f64,
    pub(crate) junction: f64,
    pub(crate) weight: f32,
}

/// A phantom's volume and labels.
pub(crate) struct Scan {
    pub(crate) phantom: Phantom,
    samples: Vec<f32>,
    pub(crate) labels: LabelVolume,
    junction: BitPlanes,
    materials: MaterialTable,
    blur: f64,
}

pub(crate) fn options(scene: SceneName, size: usize, sigma: f64, percent: f64) -> PhantomOptions {
    let sample_type = interfacet::volume::SampleType::F32;
    let noise = Noise::Percent(percent);
    PhantomOptions { scene, size: [size; 3], sigma, noise, sample_type, ..PhantomOptions::default() }
}

impl Scan {
    /// Labelled by threshold if there are two materials, else classified.
    pub(crate) fn new(options: &PhantomOptions) -> Self {
        let phantom = Phantom::new(options).unwrap();
        let execution = Execution::default();
        let Samples::F32(samples) = phantom.rasterise(&execution).unwrap() else { unreachable!() };
        let slab = Slab::whole(&samples, options.size);
        let noise = Some(phantom.noise_sigma());
        let n = phantom.materials().count();
        let materials = phantom.materials().clone().with_statistics(&vec![(noise, None); n]);
        let blur = (options.sigma.powi(2) + 1.0 / 12.0).sqrt();
        let (labels, junction) = if n == 2 {
            let id = |i: usize| materials.materials()[i].id;
            let threshold = materials.threshold(id(0), id(1)) as f32;
            (LabelVolume::from_threshold(slab, threshold), BitPlanes::new(options.size, 1))
        } else {
            let edge = phantom.geometry().voxel_edge();
            let radius = phantom.geometry().spacing().map(|s| (2.5 * blur).max(1.0) * edge / s);
            let c = classify(slab, &materials, radius, &execution).unwrap();
            (c.labels, c.junction)
        };
        Self { phantom, samples, labels, junction, materials, blur }
    }

    /// The true materials of the voxels' centres instead.
    pub(crate) fn segmented(mut self) -> Self {
        let size = self.labels.size();
        let geometry = self.phantom.geometry();
        let labels: Vec<u8> = (0..size.iter().product())
            .map(|i: usize| {
                let p = [i % size[0], i / size[0] % size[1], i / size[0] / size[1]];
                self.phantom.truth().material_at(geometry.world(DVec3::from(p.map(|k| k as f64)))).0
            })
            .collect();
        self.labels = LabelVolume::from_labels(&labels, size).unwrap().0;
        self
    }

    pub(crate) fn grey(&self, rule: NormalRule) -> Vec<Found> {
        let slab = Slab::whole(&self.samples, self.labels.size());
        let thresholds = Thresholds::new(slab, &self.junction, &self.materials);
        let qualities = Qualities::new(&self.materials, Some(self.blur));
        let spacing = self.phantom.geometry().spacing();
        self.measure(&GreyHermite::new(thresholds, slab, &self.labels, spacing, rule, &qualities))
    }

    pub(crate) fn by_labels(&self) -> Vec<Found> {
        self.measure(&LabelHermite::new(&self.labels, self.phantom.geometry().spacing()))
    }

    /// Prints the time per crossing of all rules.
    pub(crate) fn time(&self) {
        let slab = Slab::whole(&self.samples, self.labels.size());
        let qualities = Qualities::new(&self.materials, Some(self.blur));
        let spacing = self.phantom.geometry().spacing();
        let edges: Vec<_> = crossings(&self.labels)
            .into_iter()
            .map(|(from, axis)| {
                let mut to = from;
                to[axis] += 1;
                (from, axis, [self.labels.at(from), self.labels.at(to)])
            })
            .collect();
        let run = |name: &str, rule: &dyn HermiteRule| {
            let started = std::time::Instant::now();
            let sum: f32 =
                edges.iter().map(|&(from, axis, labels)| rule.hermite(from, axis, labels).normal.x).sum();
            let each = started.elapsed().as_nanos() / edges.len() as u128;
            println!("{name}: {each} ns for each of {} crossings ({sum})", edges.len());
        };
        for rule in [NormalRule::Gradient, NormalRule::Smoothed, NormalRule::Sided, NormalRule::Auto] {
            let thresholds = Thresholds::new(slab, &self.junction, &self.materials);
            run(
                &format!("{rule:?}"),
                &GreyHermite::new(thresholds, slab, &self.labels, spacing, rule, &qualities),
            );
        }
        run("labels", &LabelHermite::new(&self.labels, spacing));
    }

    fn measure(&self, rule: &impl HermiteRule) -> Vec<Found> {
        let (truth, geometry) = (self.phantom.truth(), self.phantom.geometry());
        let edge = geometry.voxel_edge();
        let mut out = Vec::new();
        for (from, axis) in crossings(&self.labels) {
            let mut to = from;
            to[axis] += 1;
            let labels = [self.labels.at(from), self.labels.at(to)];
            let hermite = rule.hermite(from, axis, labels);
            let at = |t: f64| {
                let mut p = from.map(|k| k as f64 - 1.0);
                p[axis] += t;
                geometry.world(DVec3::from(p))
            };
            // The true crossing, if the true materials of the ends are these; wrong labels have none.
            let (mut low, mut high) = (0.0, 1.0);
            if [truth.material_at(at(0.0)), truth.material_at(at(1.0))] != labels {
                continue;
            }
            for _ in 0..40 {
                let t = 0.5 * (low + high);
                *if truth.material_at(at(t)) == labels[0] { &mut low } else { &mut high } = t;
            }
            let exact = at(low);
            let pair = Pair::new(labels[0], labels[1]).unwrap();
            let scene = truth.scene();
            let nearest = scene.surfaces().iter().enumerate().filter_map(|(i, s)| {
                let (found, front_outside) = scene.interface_at(i, s.foot(exact))?;
                let outside = if front_outside { pair.front() } else { pair.back() };
                let sign = if labels[1] == outside { 1.0 } else { -1.0 };
                (found == pair).then(|| (s.signed_distance(exact).abs(), sign * s.normal(exact), *s))
            });
            let Some((_, normal, surface)) = nearest.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
            let found = hermite.normal.as_dvec3();
            let p = at(f64::from(hermite.position));
            let far = |c: Option<(DVec3, f64)>| c.map_or(f64::INFINITY, |c| c.1 / edge);
            out.push(Found {
                degrees: normal.cross(found).length().atan2(normal.dot(found)).to_degrees(),
                off: surface.signed_distance(p) / edge,
                edge: far(truth.closest_edge(exact)),
                junction: far(truth.closest_junction(exact)),
                weight: hermite.weight,
            });
        }
        out
    }
}

/// Every edge with a crossing whose ends are inside the volume.
pub(crate) fn crossings(labels: &LabelVolume) -> Vec<([usize; 3], usize)> {
    let size = labels.size();
    let mut out = Vec::new();
    for z in 1..=size[2] {
        for y in 1..=size[1] {
            for x in 1..=size[0] {
                for axis in 0..3 {
                    let mut to = [x, y, z];
                    to[axis] += 1;
                    if to[axis] <= size[axis] && labels.at([x, y, z]) != labels.at(to) {
                        out.push(([x, y, z], axis));
                    }
                }
            }
        }
    }
    out
}

/// Mean, 95 % and largest of some values.
pub(crate) fn statistics(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 {
        return [f64::NAN; 3];
    }
    [values.iter().sum::<f64>() / n as f64, values[(n - 1) * 95 / 100], values[n - 1]]
}
