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

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::deep::deep_statistics;
use super::histogram::Histogram;
use super::sampling::{interior_grid, neighbourhood, position};
use super::table::{MaterialTable, MaterialTableError};
use crate::grid::MaterialId;
use crate::volume::Sample;

/// Share of a material's voxels that must be surrounded by their own class. On the scans tried,
/// blurred interfaces reach 0.2 to 2 %, the thinnest real material (valve guides about eight voxels
/// wide, a pot three voxels thick) 12 to 15 %.
pub const MIN_INSIDE_SHARE: f64 = 0.10;

/// Bins of the histogram, and its smoothing in bins.
const BINS: usize = 256;
const SMOOTHING: f64 = 3.0;
/// How far a mode must rise above its valleys, as a natural logarithm.
const PROMINENCE: f64 = 0.25;
/// Voxels looked at.
const SAMPLES: usize = 4_000_000;
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
    /// The means found make no table.
    #[error(transparent)]
    Table(#[from] MaterialTableError),
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
struct Class {
    grey: f64,
    voxels: f64,
    border: f64,
    inside: f64,
    sum: f64,
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

/// Finds the materials of a volume (x fastest); `count` asks for a number of them.
///
/// # Errors
/// [`FindError`] says why there are none and what to do.
pub fn find_materials<S: Sample>(
    samples: &[S],
    size: [usize; 3],
    count: Option<usize>,
) -> Result<Found, FindError> {
    check_count(count)?;
    let constant = || FindError::Constant { value: samples.first().map_or(0.0, |v| v.to_f32()) };
    let plain = Histogram::of(samples, 4096).ok_or_else(constant)?;
    let grid = interior_grid(size, SAMPLES);
    if grid.is_empty() {
        return Err(FindError::TooSmall { size });
    }
    let weighted = homogeneous_histogram(samples, size, &grid, &plain).smoothed(SMOOTHING);
    let mut greys: Vec<f64> = weighted.modes(PROMINENCE).into_iter().map(|bin| weighted.value(bin)).collect();
    let mut rejected = Vec::new();
    if count.is_some_and(|n| greys.len() < n) {
        greys = weighted.otsu_means(count.unwrap_or(2));
    }
    let mut classes = measure(samples, size, &grid, &greys);
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
        classes = measure(samples, size, &grid, &greys);
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
            classes = measure(samples, size, &grid, &greys);
        }
    }
    if classes.len() < 2 {
        return Err(FindError::One { mean: classes.first().map_or(plain.low, mean) });
    }
    let deep = deep_statistics(samples, size, &grid, &greys);
    let means = deep.iter().zip(&classes).map(|(d, c)| d.mean().unwrap_or(c.grey));
    let table = MaterialTable::new((0..deep.len()).map(default_name).zip(means))?;
    let statistics: Vec<_> = deep.iter().map(|d| (d.sigma(), Some(d.voxels))).collect();
    Ok(Found { table: table.with_statistics(&statistics), rejected })
}

/// Checks that each material given is the nearest by grey value to at least one voxel. One that is
/// not was mistyped or belongs to another scan, and would silently be missing from the mesh.
///
/// # Errors
/// [`FindError::Absent`] names it.
pub fn check_present<S: Sample>(samples: &[S], table: &MaterialTable) -> Result<(), FindError> {
    use rayon::prelude::*;
    let materials = table.materials();
    let thresholds: Vec<f32> = materials.windows(2).map(|w| (0.5 * (w[0].mean + w[1].mean)) as f32).collect();
    let fresh = || (vec![false; materials.len()], f32::INFINITY, f32::NEG_INFINITY);
    let (seen, low, high) = samples
        .par_chunks(1 << 16)
        .fold(fresh, |(mut seen, mut low, mut high), chunk| {
            for v in chunk {
                let v = v.to_f32();
                seen[thresholds.partition_point(|&t| v >= t)] = true;
                (low, high) = (low.min(v), high.max(v));
            }
            (seen, low, high)
        })
        .reduce(fresh, |(mut seen, low, high), (other, l, h)| {
            seen.iter_mut().zip(other).for_each(|(a, b)| *a |= b);
            (seen, low.min(l), high.max(h))
        });
    match materials.iter().zip(seen).find(|(_, seen)| !seen) {
        Some((m, _)) => Err(FindError::Absent { name: m.name.clone(), mean: m.mean, low, high }),
        None => Ok(()),
    }
}

/// The table with noise sigma and number of inside voxels measured in a volume (x fastest) for
/// materials whose mean grey values were given. Unchanged where the volume is too small for it.
#[must_use]
pub fn measure_statistics<S: Sample>(samples: &[S], size: [usize; 3], table: MaterialTable) -> MaterialTable {
    let grid = interior_grid(size, SAMPLES);
    let greys: Vec<f64> = table.materials().iter().map(|m| m.mean).collect();
    let deep = deep_statistics(samples, size, &grid, &greys);
    let statistics: Vec<_> = deep.iter().map(|d| (d.sigma(), Some(d.voxels))).collect();
    table.with_statistics(&statistics)
}

/// The name of material `id` when nobody gave one.
#[must_use]
pub fn default_name(id: usize) -> String {
    if id == usize::from(MaterialId::BACKGROUND.0) { "air".into() } else { format!("material{id}") }
}

fn reject(rejected: &mut Vec<Rejected>, class: &Class, reason: &str) {
    let inside_share = class.inside / class.voxels.max(1.0);
    rejected.push(Rejected { grey: class.grey, inside_share, reason: reason.into() });
}

fn mean(class: &Class) -> f64 {
    if class.inside > 0.0 { class.sum / class.inside } else { class.grey }
}

/// The histogram in which homogeneous neighbourhoods weigh most. Its range leaves out the rarest
/// grey values (one in 10^5 at each end), which outliers would stretch.
fn homogeneous_histogram<S: Sample>(
    samples: &[S],
    size: [usize; 3],
    grid: &[[usize; 3]],
    plain: &Histogram,
) -> Histogram {
    use rayon::prelude::*;
    let around = neighbourhood(size);
    let local: Vec<(f32, f32)> = grid
        .par_iter()
        .map(|&voxel| {
            let at = position(size, voxel);
            let centre = samples[at].to_f32();
            // Differences from the centre keep the variance exact for large grey values.
            let (sum, squares) = around.iter().fold((0.0f64, 0.0f64), |(s, q), &o| {
                let d = f64::from(samples[at.wrapping_add_signed(o)].to_f32() - centre);
                (s + d, q + d * d)
            });
            (centre, (squares / 27.0 - (sum / 27.0).powi(2)).max(0.0) as f32)
        })
        .collect();
    let (low, high) = (plain.quantile(1e-5), plain.quantile(1.0 - 1e-5));
    let (low, high) = if high > low { (low, high) } else { (plain.low, plain.high) };
    let mut out = Histogram::new(low, high, BINS);
    let mut variances: Vec<f32> = local.iter().map(|l| l.1).collect();
    let quarter = variances.len() / 4;
    let v0 =
        f64::from(*variances.select_nth_unstable_by(quarter, f32::total_cmp).1).max(out.bin_width().powi(2));
    for (grey, variance) in local {
        let bin = out.bin(f64::from(grey));
        out.counts[bin] += (1.0 + f64::from(variance) / v0).powi(-2);
    }
    out
}

/// Statistics of the classes around `greys` (ascending), with thresholds halfway between them.
fn measure<S: Sample>(samples: &[S], size: [usize; 3], grid: &[[usize; 3]], greys: &[f64]) -> Vec<Class> {
    use rayon::prelude::*;
    let thresholds: Vec<f32> = greys.windows(2).map(|w| (0.5 * (w[0] + w[1])) as f32).collect();
    let class_of = |v: f32| thresholds.iter().filter(|&&t| v >= t).count();
    let around = neighbourhood(size);
    let fresh = || greys.iter().map(|&grey| Class { grey, ..Class::default() }).collect::<Vec<_>>();
    // Fixed chunks, summed in order: the same sums for any number of threads.
    let parts: Vec<Vec<Class>> = grid
        .par_chunks(1 << 14)
        .map(|chunk| {
            let mut classes = fresh();
            for &voxel in chunk {
                let at = position(size, voxel);
                let v = samples[at].to_f32();
                let own = class_of(v);
                let class = &mut classes[own];
                class.voxels += 1.0;
                if around.iter().all(|&o| class_of(samples[at.wrapping_add_signed(o)].to_f32()) == own) {
                    class.inside += 1.0;
                    class.sum += f64::from(v);
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
    for z in 0..size[2] {
        for y in 0..size[1] {
            let on_side = z == 0 || z + 1 == size[2] || y == 0 || y + 1 == size[1];
            let xs = if on_side { (0..size[0]).collect() } else { vec![0, size[0] - 1] };
            for x in xs {
                total[class_of(samples[position(size, [x, y, z])].to_f32())].border += 1.0;
            }
        }
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
        let found = find_materials(&samples, size, None).unwrap();
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
            assert_eq!(find_materials(&samples, size, Some(n)).unwrap().table.count(), n);
        }
        assert!(matches!(find_materials(&samples, size, Some(1)), Err(FindError::Count { .. })));
    }

    #[test]
    fn a_material_that_no_voxel_is_nearest_to_is_named() {
        let table = |greys: [f64; 3]| MaterialTable::new(["a", "b", "c"].into_iter().zip(greys)).unwrap();
        let samples: Vec<u8> = (0..100).map(|i| [10, 100][i % 2]).collect();
        for (greys, absent) in
            [([10.0, 100.0, 250.0], "c"), ([-900.0, 10.0, 100.0], "a"), ([10.0, 50.0, 100.0], "b")]
        {
            let error = check_present(&samples, &table(greys)).unwrap_err();
            assert!(matches!(&error, FindError::Absent { name, .. } if name == absent), "{error}");
        }
        assert!(check_present(&[10u8, 60, 100], &table([10.0, 50.0, 100.0])).is_ok());
    }

    #[test]
    fn constant_and_single_material_volumes_are_named() {
        assert!(matches!(find_materials(&[7u8; 1000], [10; 3], None), Err(FindError::Constant { .. })));
        let (samples, size) = blocks(&[10.0], 24);
        assert!(matches!(find_materials(&samples, size, None), Err(FindError::One { .. })));
    }
}
