//! What the fits look at: grey values, labels, and what is known of the scan, in one place.

use glam::DVec3;

use super::frame::BlurUnits;
use super::sheet::{LevelPrior, Reading, Sample};
use crate::classify::{BitPlanes, LabelVolume, WORD};
use crate::execution::Execution;
use crate::grid::MaterialId;
use crate::material::{Levels, Misfit};
use crate::volume::Greys;

/// What is known of a scan before its interfaces are located.
#[derive(Debug, Clone)]
pub struct Scan {
    /// The blur, averaging over a voxel included.
    pub units: BlurUnits,
    /// Whether the blur was measured; if not it is a guess.
    pub is_blur_known: bool,
    /// Grey level of each material, anywhere in the volume.
    pub levels: Levels,
    /// Mean grey level of each material, and the smallest difference between two.
    pub means: Vec<f64>,
    /// See `means`.
    pub contrast: f64,
    /// Whether each material is nowhere thick, so that its labels are no better than its mean grey value.
    pub is_thin: Vec<bool>,
    /// Grey values midway between the means of neighbouring materials, ascending.
    pub thresholds: Vec<f32>,
    /// Standard deviation of a grey value in each material; positive.
    pub noise: Vec<f64>,
    /// What single grey values at the interfaces of a pair are off by beside noise, as a share of the contrast.
    pub misfits: Vec<Misfit>,
    /// The lowest and the highest grey value that there can be; infinite if there is no end.
    pub clip: [f64; 2],
    /// By how much standard deviations of fits are larger than for white noise.
    pub inflation: f64,
}

impl Scan {
    /// Share and spread of `misfits`; of a pair that was not measured the medians of those that were.
    fn misfit(&self, pair: [usize; 2]) -> [f64; 2] {
        if let Some(own) = self.misfits.iter().find(|m| m.pair == pair) {
            return [own.share, own.spread];
        }
        let median = |share: fn(&Misfit) -> f64| {
            let mut shares: Vec<f64> = self.misfits.iter().map(share).collect();
            shares.sort_by(f64::total_cmp);
            shares.get(shares.len() / 2).copied().unwrap_or(0.0)
        };
        [median(|m| m.share), median(|m| m.spread)]
    }

    /// The material whose level in the table of materials is nearest.
    #[must_use]
    pub fn class(&self, grey: f32) -> MaterialId {
        MaterialId(self.thresholds.iter().take_while(|t| grey >= **t).count() as u8)
    }

    /// The scan, seen through some slices.
    #[must_use]
    pub fn view<'a>(
        &'a self,
        slab: &'a dyn Greys,
        labels: &'a LabelVolume,
        uncertain: &'a BitPlanes,
        execution: &'a Execution,
    ) -> View<'a> {
        View { scan: self, slab, labels, uncertain, units: self.units, execution }
    }
}

/// A level this near to an end of the scale (as a share of the smallest contrast) is clipped, and may be off by so much.
const CLIPPED: f64 = 0.01;
const UNSEEN: f64 = 0.5;

/// Grey values and labels of some slices, and what is known of the scan.
pub struct View<'a> {
    /// Grey values.
    pub slab: &'a dyn Greys,
    /// Labels of the same slices.
    pub labels: &'a LabelVolume,
    /// Voxels that no single interface explains: labels are not certain, or a curve is near.
    pub uncertain: &'a BitPlanes,
    /// The scan.
    pub scan: &'a Scan,
    /// The scan's blur.
    pub units: BlurUnits,
    /// Once it is cancelled nothing more is fitted; what is found then is not to be used.
    pub execution: &'a Execution,
}

/// A voxel seen from a fit.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// Its label.
    pub label: MaterialId,
    /// Whether no single interface explains it.
    pub uncertain: bool,
    /// Place in blur units from the middle of the ball; grey value without the drift of its material's level.
    pub sample: Sample,
}

/// About how many voxels an ellipsoid with these half axes has, rather more.
fn ball_voxels(r: DVec3) -> usize {
    ((r + 0.5).element_product() * (4.0 / 3.0 * std::f64::consts::PI)) as usize
}

impl View<'_> {
    /// The label of a voxel.
    #[inline]
    #[must_use]
    pub fn label(&self, voxel: [usize; 3]) -> MaterialId {
        self.labels.at(voxel.map(|c| c + 1))
    }

    /// Whether no single interface explains a voxel.
    #[inline]
    #[must_use]
    pub fn is_uncertain(&self, [x, y, z]: [usize; 3]) -> bool {
        self.uncertain.bit(0, x + 1, y + 1, z + 1)
    }

    /// The voxels of the ball of `radius` blur units about `centre` (voxels), as far as they are here.
    pub fn ball(&self, centre: DVec3, radius: f64, out: &mut Vec<Seen>) {
        out.clear();
        let r = self.units.voxel(DVec3::splat(radius));
        let (size, slices) = (self.slab.size(), self.slab.slices());
        let low: [usize; 3] = std::array::from_fn(|a| (centre[a] - r[a]).ceil().max(0.0) as usize);
        let end: [usize; 3] =
            std::array::from_fn(|a| ((centre[a] + r[a]).floor() + 1.0).clamp(0.0, size[a] as f64) as usize);
        let drift = self.drift(centre);
        let mut greys = [0.0; WORD];
        out.reserve(ball_voxels(r));
        for z in low[2].max(slices.start)..end[2].min(slices.end) {
            for y in low[1]..end[1] {
                let flat = DVec3::new(0.0, y as f64 - centre.y, z as f64 - centre.z) * self.units.per_voxel;
                let half = radius * radius - flat.length_squared();
                if half < 0.0 {
                    continue;
                }
                let place = |x: usize| flat + DVec3::X * ((x as f64 - centre.x) * self.units.per_voxel.x);
                let is_within = |x: &usize| place(*x).x.powi(2) <= half;
                let Some(first) = (low[0]..end[0]).find(is_within) else { continue };
                let run = first..(first..end[0]).find(|x| !is_within(x)).unwrap_or(end[0]);
                for from in run.clone().step_by(WORD) {
                    let count = (run.end - from).min(WORD);
                    self.slab.greys([from, y, z], &mut greys[..count]);
                    let labels = self.labels.word_from([from + 1, y + 1, z + 1]);
                    let uncertain = self.uncertain.bits_from(0, from + 1, y + 1, z + 1);
                    for (k, grey) in greys[..count].iter().enumerate() {
                        let (at, label) = (place(from + k), labels.at(k));
                        let slope = drift.get(usize::from(label.0)).copied().unwrap_or(DVec3::ZERO);
                        let grey = f64::from(*grey) - slope.dot(at);
                        out.push(Seen {
                            label,
                            uncertain: uncertain >> k & 1 == 1,
                            sample: Sample { at, grey },
                        });
                    }
                }
            }
        }
    }

    /// The samples of the ball of `radius` about `centre` (blur units from `middle`, which is in voxels), in blur units from
    /// `middle`; `seen` are the voxels, from `centre`.
    pub fn samples(
        &self,
        middle: DVec3,
        centre: DVec3,
        radius: f64,
        seen: &mut Vec<Seen>,
        out: &mut Vec<Sample>,
    ) {
        self.ball(middle + self.units.voxel(centre), radius, seen);
        out.clear();
        out.extend(seen.iter().map(|s| Sample { at: s.sample.at + centre, ..s.sample }));
    }

    /// By how much each material's level changes per blur unit.
    fn drift(&self, centre: DVec3) -> Vec<DVec3> {
        let step = 2.0;
        (0..self.scan.noise.len())
            .map(|m| {
                let id = MaterialId(m as u8);
                let slope = |a: usize| {
                    let d = self.units.voxel(DVec3::AXES[a] * step);
                    (self.mean(id, centre + d) - self.mean(id, centre - d)) / (2.0 * step)
                };
                DVec3::new(slope(0), slope(1), slope(2))
            })
            .collect()
    }

    /// Grey level of a material at a place in voxels.
    #[must_use]
    pub fn mean(&self, material: MaterialId, voxel: DVec3) -> f64 {
        f64::from(self.scan.levels.mean(material, voxel.as_vec3().to_array()))
    }

    /// The same with its standard deviation.
    #[must_use]
    pub fn level(&self, material: MaterialId, voxel: DVec3) -> LevelPrior {
        let sigma = f64::from(self.scan.levels.sigma(material, voxel.as_vec3().to_array()));
        let mean = self.mean(material, voxel);
        // A level beyond the end of the scale can be anywhere beyond.
        let clipped = self.scan.clip.iter().any(|end| (mean - end).abs() < CLIPPED * self.scan.contrast);
        let sigma = if clipped { sigma.hypot(UNSEEN * self.scan.contrast) } else { sigma };
        LevelPrior { mean, sigma }
    }

    /// What a grey value is worth where these materials meet, for a model that is itself off by the share `model` of their
    /// contrast.
    #[must_use]
    pub fn reading(&self, materials: &[MaterialId], model: f64) -> Reading {
        let scan = self.scan;
        let ids = || materials.iter().map(|m| usize::from(m.0));
        let count = materials.len().max(1) as f64;
        let noise = ids().map(|m| scan.noise[m].powi(2)).sum::<f64>() / count;
        let ends = ids().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], m| {
            [a.min(scan.means[m]), b.max(scan.means[m])]
        });
        // Of several pairs the mean: each is seen by a part of the voxels.
        let (mut sum, mut pairs, mut slack) = (0.0, 0, 1.0f64);
        for a in ids() {
            for b in ids().filter(|b| a < *b) {
                let [share, spread] = scan.misfit([a, b]);
                sum += (share * (scan.means[b] - scan.means[a])).powi(2);
                slack = slack.max(spread);
                pairs += 1;
            }
        }
        let off = (sum / f64::from(pairs.max(1))).sqrt().hypot((ends[1] - ends[0]) * model);
        Reading { noise: noise.sqrt().hypot(off), white: noise.sqrt(), clip: scan.clip, slack }
    }
}
