//! Finding the materials of a volume: how many there are and their mean grey values.
//!
//! 1. *Modes.* The histogram of all voxels drowns small materials in the grey values of blurred
//!    interfaces, so every voxel is weighted by how homogeneous its 3 x 3 x 3 neighbourhood is,
//!    `1 / (1 + variance / v0)²` with v0 the 25 % quantile of the variances. The modes of that
//!    histogram, slightly smoothed, are candidates.
//! 2. *Substance.* A blurred interface between two other materials can show a mode as well, but no
//!    inside. With thresholds halfway between the candidates, the candidate with the smallest share
//!    of voxels whose 27 neighbours are all of its own class is dropped, until each has at least
//!    [`MIN_INSIDE_SHARE`].
//! 3. *Background.* Nothing in a scan is less dense than air. A class darker than the one that
//!    covers most of the volume's border, and much rarer, is an artefact of reconstruction (the
//!    corners outside the field of view) and is counted as background.
//! 4. *Means* and noise are taken over the voxels deepest inside of each class ([`deep`](super::deep)).
//!
//! On a given number of materials the weakest candidates are dropped down to it; if there are too
//! few modes, multi-level Otsu splits the histogram. Not guaranteed: materials whose grey values are
//! closer than about 4 % of the range, or that occur only in parts thinner than three voxels, are
//! not told apart; name them with `--material`.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::counts::GreyCounts;
use super::deep::deep_statistics;
use super::histogram::Histogram;
use super::neighbourhood::{Neighbourhood, class_ranges};
use super::sampling::{class_of, thresholds};
use super::survey::{OutOfMemory, Survey};
use super::table::{MaterialTable, MaterialTableError};
use crate::grid::MaterialId;
use crate::volume::{Sample, Slab};

/// Share of a material's voxels that must be surrounded by their own class. On the scans tried,
/// blurred interfaces reach 0.2 to 2 %, the thinnest real material (valve guides about eight voxels
/// wide, a pot three voxels thick) 12 to 15 %.
pub const MIN_INSIDE_SHARE: f64 = 0.10;

/// Bins of the histogram, and its smoothing in bins.
const BINS: usize = 256;
const SMOOTHING: f64 = 3.0;
/// How far a mode must rise above its valleys, as a natural logarithm.
const PROMINENCE: f64 = 0.25;
/// A class darker than air is an artefact if it has less than this share of air's voxels.
const DARKER_THAN_AIR: f64 = 0.05;

/// Why no materials can be found.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum FindError {
    /// A constant volume.
    #[error(
        "all voxels have the same grey value {value}, so there is no interface to find; check the number type, the offset and the region (--type, --offset, --roi)"
    )]
    Constant {
        /// The grey value.
        value: f32,
    },
    /// One material only.
    #[error(
        "only one material was found, near grey value {mean:.6}; an interface needs two (air counts). If there are more, name them with --material NAME=GREY or give their number with --count"
    )]
    One {
        /// Its mean grey value.
        mean: f64,
    },
    /// Too small to look for materials.
    #[error(
        "the volume of {size:?} voxels is too small to find materials in; name them with --material NAME=GREY"
    )]
    TooSmall {
        /// Voxels per axis.
        size: [usize; 3],
    },
    /// A number of materials that is not possible.
    #[error(
        "{count} material(s) asked for, but 2 to {limit} can be looked for (--count; the air around a part counts); more are possible if named with --material"
    )]
    Count {
        /// As given.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
    /// A material given that the volume does not hold.
    #[error(
        "no voxel's grey value is nearest to that of material '{name}' ({mean}): those of the volume go from {low} to {high}. Correct the grey value (`interfacet info` shows the histogram), or leave the material out"
    )]
    Absent {
        /// Its name.
        name: String,
        /// Its mean as given.
        mean: f64,
        /// The smallest grey value of the volume.
        low: f32,
        /// The largest.
        high: f32,
    },
    /// No slice with two classes of grey values.
    #[error(
        "none of the {slices} slices shows two classes of grey values, so Otsu's method has no threshold to offer; give one with --iso (`interfacet info` shows the histogram)"
    )]
    NoTwoClasses {
        /// Slices of the volume.
        slices: usize,
    },
    /// An iso value that is no number.
    #[error("the iso value {iso} is not a finite number; give a grey value of the volume (--iso)")]
    IsoNotFinite {
        /// As given.
        iso: f64,
    },
    /// An iso value that does not part the volume.
    #[error(
        "the iso value {iso} parts nothing: the grey values go from {low} to {high}, and material is what is at or above the iso value. Give one above {low} and up to {high} (--iso)"
    )]
    IsoOutside {
        /// The iso value.
        iso: f64,
        /// The smallest grey value of the volume.
        low: f32,
        /// The largest.
        high: f32,
    },
    /// There is no memory for what must be kept of the volume.
    #[error("{bytes} bytes of memory to look for materials are not available")]
    Memory {
        /// Bytes asked for.
        bytes: usize,
    },
    /// The means found make no table.
    #[error(transparent)]
    Table(#[from] MaterialTableError),
}

impl From<OutOfMemory> for FindError {
    fn from(OutOfMemory { bytes }: OutOfMemory) -> Self {
        Self::Memory { bytes }
    }
}

/// A mode that was not taken for a material, and why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    /// Its grey value.
    pub grey: f64,
    /// Share of its voxels surrounded by their own class.
    pub inside_share: f64,
    /// Why it was not taken.
    pub reason: String,
}

/// Materials found in a volume.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// The materials, with statistics.
    pub table: MaterialTable,
    /// Modes that were not taken.
    pub rejected: Vec<Rejected>,
}

/// A class during the search.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Class {
    pub(super) grey: f64,
    pub(super) voxels: f64,
    pub(super) border: f64,
    pub(super) inside: f64,
    pub(super) sum: f64,
}

/// Whether a number of materials can be looked for.
///
/// # Errors
/// [`FindError::Count`] if it cannot.
pub fn check_count(count: Option<usize>) -> Result<(), FindError> {
    const LIMIT: usize = 64;
    match count {
        Some(count) if !(2..=LIMIT).contains(&count) => Err(FindError::Count { count, limit: LIMIT }),
        _ => Ok(()),
    }
}

/// Finds the materials of a volume in memory; `count` asks for a number of them. See
/// [`Survey::find_materials`] for one that is read slab by slab.
///
/// # Errors
/// [`FindError`] says why there are none and what to do.
///
/// # Panics
/// If the slab does not hold all slices.
pub fn find_materials<S: Sample>(slab: Slab<'_, S>, count: Option<usize>) -> Result<Found, FindError> {
    check_count(count)?;
    Survey::of(slab, None)?.find_materials(count)
}

impl<S: Sample> Survey<S> {
    /// Finds the materials of the volume surveyed; `count` asks for a number of them.
    ///
    /// # Errors
    /// [`FindError`] says why there are none and what to do.
    pub fn find_materials(&self, count: Option<usize>) -> Result<Found, FindError> {
        find(self, count)
    }

    /// Checks that each material given is the nearest by grey value to at least one voxel. One that is
    /// not was mistyped or belongs to another scan, and would silently be missing from the mesh.
    ///
    /// # Errors
    /// [`FindError::Absent`] names it.
    pub fn check_present(&self) -> Result<(), FindError> {
        let Some((table, _, seen)) = &self.given else { return Ok(()) };
        let GreyCounts { low, high, .. } = self.counts;
        match table.materials().iter().zip(seen).find(|(_, seen)| !**seen) {
            Some((m, _)) => Err(FindError::Absent { name: m.name.clone(), mean: m.mean, low, high }),
            None => Ok(()),
        }
    }

    /// The table with noise sigma and number of inside voxels measured for materials whose mean grey
    /// values were given. No voxels where the volume is too small for it.
    #[must_use]
    pub fn measure_statistics(&self, table: MaterialTable) -> MaterialTable {
        let greys: Vec<f64> = table.materials().iter().map(|m| m.mean).collect();
        let deep = deep_statistics(&self.points, &greys);
        let statistics: Vec<_> = deep.iter().map(|d| (d.sigma(), Some(d.voxels))).collect();
        table.with_statistics(&statistics)
    }
}

fn find<S: Sample>(survey: &Survey<S>, count: Option<usize>) -> Result<Found, FindError> {
    check_count(count)?;
    let constant = || FindError::Constant { value: survey.counts.low };
    let plain = survey.counts.histogram(4096).ok_or_else(constant)?;
    if survey.points.is_empty() {
        return Err(FindError::TooSmall { size: survey.size });
    }
    let weighted = homogeneous_histogram(&survey.points, &plain).smoothed(SMOOTHING);
    let mut greys: Vec<f64> = weighted.modes(PROMINENCE).into_iter().map(|bin| weighted.value(bin)).collect();
    let mut rejected = Vec::new();
    if count.is_some_and(|n| greys.len() < n) {
        greys = weighted.otsu_means(count.unwrap_or(2));
    }
    let mut classes = measure(survey, &greys);
    let share = |c: &Class| c.inside / c.voxels.max(1.0);
    while classes.len() > 1 {
        let weakest = (0..classes.len())
            .min_by(|&a, &b| share(&classes[a]).total_cmp(&share(&classes[b])))
            .unwrap_or(0);
        let enough = match count {
            Some(n) => classes.len() <= n,
            None => share(&classes[weakest]) >= MIN_INSIDE_SHARE,
        };
        if enough {
            break;
        }
        reject(&mut rejected, &classes[weakest], "too few of its voxels are surrounded by their own kind");
        greys.remove(weakest);
        classes = measure(survey, &greys);
    }
    if count.is_none() {
        while classes.len() > 2 {
            let covers_border = classes.iter().map(|c| c.border).fold(0.0, f64::max);
            let air = classes.iter().position(|c| c.border >= covers_border).unwrap_or(0);
            if air == 0 || classes[0].voxels > DARKER_THAN_AIR * classes[air].voxels {
                break;
            }
            reject(&mut rejected, &classes[0], "darker than the air at the volume's border and much rarer");
            greys.remove(0);
            classes = measure(survey, &greys);
        }
    }
    if classes.len() < 2 {
        return Err(FindError::One { mean: classes.first().map_or(plain.low, mean) });
    }
    let deep = deep_statistics(&survey.points, &greys);
    let means = deep.iter().zip(&classes).map(|(d, c)| d.mean().unwrap_or(c.grey));
    let table = MaterialTable::new((0..deep.len()).map(default_name).zip(means))?;
    let statistics: Vec<_> = deep.iter().map(|d| (d.sigma(), Some(d.voxels))).collect();
    Ok(Found { table: table.with_statistics(&statistics), rejected })
}

/// The name of material `id` when nobody gave one.
#[must_use]
pub fn default_name(id: usize) -> String {
    if id == usize::from(MaterialId::BACKGROUND.0) { "air".into() } else { format!("material{id}") }
}

pub(super) fn reject(rejected: &mut Vec<Rejected>, class: &Class, reason: &str) {
    let inside_share = class.inside / class.voxels.max(1.0);
    rejected.push(Rejected { grey: class.grey, inside_share, reason: reason.into() });
}

pub(super) fn mean(class: &Class) -> f64 {
    if class.inside > 0.0 { class.sum / class.inside } else { class.grey }
}

/// The histogram in which homogeneous neighbourhoods weigh most. Its range leaves out the rarest
/// grey values (one in 10^5 at each end), which outliers would stretch.
fn homogeneous_histogram<S: Sample>(points: &[Neighbourhood<S>], plain: &Histogram) -> Histogram {
    let (low, high) = (plain.quantile(1e-5), plain.quantile(1.0 - 1e-5));
    let (low, high) = if high > low { (low, high) } else { (plain.low, plain.high) };
    let mut out = Histogram::new(low, high, BINS);
    let v0 = f64::from(lower_quartile(points)).max(out.bin_width().powi(2));
    // Weights are worked out by all threads, a block at a time, and added in order.
    for block in points.chunks(1 << 18) {
        let weigh = |point: &Neighbourhood<S>| {
            let weight = (1.0 + f64::from(point.variance) / v0).powi(-2);
            (out.bin(f64::from(point.grey.to_f32())), weight)
        };
        let weights: Vec<(usize, f64)> = block.par_iter().map(weigh).collect();
        for (bin, weight) in weights {
            out.counts[bin] += weight;
        }
    }
    out
}

/// The variance that a quarter of the points stays below.
fn lower_quartile<S: Sample>(points: &[Neighbourhood<S>]) -> f32 {
    // Positive numbers ascend as their bits do: the upper half of the bits first, then the lower.
    let mut rank = points.len() / 4;
    let mut upper = None;
    for _ in 0..2 {
        let mut counts = vec![0_usize; 1 << 16];
        for bits in points.iter().map(|p| p.variance.to_bits()) {
            match upper {
                None => counts[(bits >> 16) as usize] += 1,
                Some(upper) if bits >> 16 == upper => counts[(bits & 0xffff) as usize] += 1,
                Some(_) => {}
            }
        }
        let mut half = 0;
        while half + 1 < counts.len() && rank >= counts[half] {
            rank -= counts[half];
            half += 1;
        }
        match upper {
            None => upper = Some(half as u32),
            Some(upper) => return f32::from_bits(upper << 16 | half as u32),
        }
    }
    0.0
}

/// Statistics of the classes around `greys` (ascending), with thresholds halfway between them.
fn measure<S: Sample>(survey: &Survey<S>, greys: &[f64]) -> Vec<Class> {
    let thresholds = thresholds(greys);
    let ranges = class_ranges(&thresholds);
    let fresh = || greys.iter().map(|&grey| Class { grey, ..Class::default() }).collect::<Vec<_>>();
    // Fixed chunks, summed in order: the same sums for any number of threads.
    let parts: Vec<Vec<Class>> = survey
        .points
        .par_chunks(1 << 14)
        .map(|chunk| {
            let mut classes = fresh();
            for point in chunk {
                let own = class_of(&thresholds, point.grey);
                let class = &mut classes[own];
                class.voxels += 1.0;
                if point.depth(ranges[own]) > 0 {
                    class.inside += 1.0;
                    class.sum += f64::from(point.grey.to_f32());
                }
            }
            classes
        })
        .collect();
    let mut total = fresh();
    for part in parts {
        for (t, p) in total.iter_mut().zip(part) {
            t.voxels += p.voxels;
            t.inside += p.inside;
            t.sum += p.sum;
        }
    }
    for &v in &survey.border {
        total[class_of(&thresholds, v)].border += 1.0;
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks of grey along x with a soft ramp of three voxels between them, and a little noise.
    fn blocks(greys: &[f32], width: usize) -> (Vec<f32>, [usize; 3]) {
        let size = [greys.len() * width, 24, 24];
        let samples = (0..size.iter().product::<usize>())
            .map(|i| {
                let x = i % size[0];
                let (block, inside) = (x / width, x % width);
                let noise = ((i * 2_654_435_761) >> 7 & 255) as f32 / 255.0 - 0.5;
                let next = greys.get(block + 1).copied().unwrap_or(greys[block]);
                let ramp = (inside as f32 - (width as f32 - 3.0)).max(0.0) / 3.0;
                greys[block] + (next - greys[block]) * ramp + 2.0 * noise
            })
            .collect();
        (samples, size)
    }

    #[test]
    fn materials_are_found_and_ramps_are_not() {
        let (samples, size) = blocks(&[10.0, 60.0, 200.0, 10.0], 16);
        let found = find_materials(Slab::whole(&samples, size), None).unwrap();
        let means: Vec<f64> = found.table.materials().iter().map(|m| m.mean).collect();
        assert_eq!(means.len(), 3, "{found:?}");
        for (mean, expected) in means.iter().zip([10.0, 60.0, 200.0]) {
            assert!((mean - expected).abs() < 1.0, "{means:?}");
        }
    }

    #[test]
    fn a_wanted_number_of_materials_is_given() {
        let (samples, size) = blocks(&[10.0, 60.0, 200.0, 10.0], 16);
        for n in 2..=5 {
            assert_eq!(find_materials(Slab::whole(&samples, size), Some(n)).unwrap().table.count(), n);
        }
        assert!(matches!(find_materials(Slab::whole(&samples, size), Some(1)), Err(FindError::Count { .. })));
    }

    #[test]
    fn a_material_that_no_voxel_is_nearest_to_is_named() {
        let table = |greys: [f64; 3]| MaterialTable::new(["a", "b", "c"].into_iter().zip(greys)).unwrap();
        let check = |samples: &[u8], greys| {
            let slab = Slab::whole(samples, [samples.len(), 1, 1]);
            Survey::of(slab, Some(&table(greys))).unwrap().check_present()
        };
        let samples: Vec<u8> = (0..100).map(|i| [10, 100][i % 2]).collect();
        for (greys, absent) in
            [([10.0, 100.0, 250.0], "c"), ([-900.0, 10.0, 100.0], "a"), ([10.0, 50.0, 100.0], "b")]
        {
            let error = check(&samples, greys).unwrap_err();
            assert!(matches!(&error, FindError::Absent { name, .. } if name == absent), "{error}");
        }
        assert!(check(&[10u8, 60, 100], [10.0, 50.0, 100.0]).is_ok());
    }

    #[test]
    fn constant_and_single_material_volumes_are_named() {
        assert!(matches!(
            find_materials(Slab::whole(&[7u8; 1000], [10; 3]), None),
            Err(FindError::Constant { .. })
        ));
        let (samples, size) = blocks(&[10.0], 24);
        assert!(matches!(find_materials(Slab::whole(&samples, size), None), Err(FindError::One { .. })));
    }
}
