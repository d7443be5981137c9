//! The plain way to find materials, which looks at the whole volume again for every question:
//! what the survey must agree with to the last bit.

use rayon::prelude::*;

use super::deep::Moments;
use super::find::{Class, FindError, Found, MIN_INSIDE_SHARE, default_name, mean, reject};
use super::histogram::Histogram;
use super::table::MaterialTable;
use crate::volume::Sample;

const BINS: usize = 256;
const SMOOTHING: f64 = 3.0;
const PROMINENCE: f64 = 0.25;
const SAMPLES: usize = 4_000_000;
const DARKER_THAN_AIR: f64 = 0.05;
const MAX_DEPTH: usize = 3;
const MIN_VOXELS: u64 = 100;
const MIN_SHARE: f64 = 0.05;

/// Interior voxels (those with a full 3 x 3 x 3 neighbourhood) on a regular grid of about `wanted`
/// points: the same points for any number of threads. Empty if an axis has fewer than 3 voxels.
fn interior_grid(size: [usize; 3], wanted: usize) -> Vec<[usize; 3]> {
    if size.iter().any(|&n| n < 3) {
        return Vec::new();
    }
    let points = |stride: usize| size.iter().map(|&n| (n - 2).div_ceil(stride)).product::<usize>();
    let longest = size.into_iter().max().unwrap_or(1);
    let stride = (1..longest).find(|&stride| points(stride) <= wanted).unwrap_or(longest);
    let axis = |n: usize| (1..n - 1).step_by(stride);
    axis(size[2])
        .flat_map(|z| axis(size[1]).flat_map(move |y| axis(size[0]).map(move |x| [x, y, z])))
        .collect()
}

/// Position of a voxel in a volume of `size`, x fastest.
fn position(size: [usize; 3], [x, y, z]: [usize; 3]) -> usize {
    (z * size[1] + y) * size[0] + x
}

/// Position offsets of the 27 voxels of a 3 x 3 x 3 neighbourhood.
fn neighbourhood(size: [usize; 3]) -> [isize; 27] {
    std::array::from_fn(|i| {
        let [dx, dy, dz] = [i % 3, i / 3 % 3, i / 9].map(|d| d as isize - 1);
        (dz * size[1] as isize + dy) * size[0] as isize + dx
    })
}

fn histogram<S: Sample>(samples: &[S], bins: usize) -> Option<Histogram> {
    let (low, high) = range(samples)?;
    let empty = || vec![0u64; bins];
    let scale = bins as f64 / (high - low);
    let counts = samples
        .par_chunks(1 << 16)
        .fold(empty, |mut counts, chunk| {
            for v in chunk {
                let bin = (f64::from(v.to_f32()) - low) * scale;
                counts[(bin.max(0.0) as usize).min(bins - 1)] += 1;
            }
            counts
        })
        .reduce(empty, |a, b| a.iter().zip(&b).map(|(a, b)| a + b).collect());
    Some(Histogram { low, high, counts: counts.into_iter().map(|c| c as f64).collect() })
}

/// Smallest and largest value; `None` if they are the same or not finite.
fn range<S: Sample>(samples: &[S]) -> Option<(f64, f64)> {
    let (low, high) = samples
        .par_chunks(1 << 16)
        .map(|chunk| {
            chunk.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| {
                let v = v.to_f32();
                (low.min(v), high.max(v))
            })
        })
        .reduce(|| (f32::INFINITY, f32::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
    (low.is_finite() && high.is_finite() && low < high).then_some((f64::from(low), f64::from(high)))
}

pub(super) fn find_materials<S: Sample>(
    samples: &[S],
    size: [usize; 3],
    count: Option<usize>,
) -> Result<Found, FindError> {
    let constant = || FindError::Constant { value: samples.first().map_or(0.0, |v| v.to_f32()) };
    let plain = histogram(samples, 4096).ok_or_else(constant)?;
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

/// The table with noise sigma and number of inside voxels measured in a volume (x fastest) for
/// materials whose mean grey values were given. Unchanged where the volume is too small for it.
#[must_use]
pub(super) fn measure_statistics<S: Sample>(
    samples: &[S],
    size: [usize; 3],
    table: MaterialTable,
) -> MaterialTable {
    let grid = interior_grid(size, SAMPLES);
    let greys: Vec<f64> = table.materials().iter().map(|m| m.mean).collect();
    let deep = deep_statistics(samples, size, &grid, &greys);
    let statistics: Vec<_> = deep.iter().map(|d| (d.sigma(), Some(d.voxels))).collect();
    table.with_statistics(&statistics)
}

/// The histogram in which homogeneous neighbourhoods weigh most. Its range leaves out the rarest
/// grey values (one in 10^5 at each end), which outliers would stretch.
fn homogeneous_histogram<S: Sample>(
    samples: &[S],
    size: [usize; 3],
    grid: &[[usize; 3]],
    plain: &Histogram,
) -> Histogram {
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

/// For each class around `greys` (ascending, thresholds halfway between): the moments of its deepest
/// voxels among those of `grid`, which has interior voxels of a volume of `size` (x fastest).
fn deep_statistics<S: Sample>(
    samples: &[S],
    size: [usize; 3],
    grid: &[[usize; 3]],
    greys: &[f64],
) -> Vec<Moments> {
    let thresholds: Vec<f32> = greys.windows(2).map(|w| (0.5 * (w[0] + w[1])) as f32).collect();
    let class_of = |v: f32| thresholds.iter().filter(|&&t| v >= t).count();
    let depth_of = |voxel: [usize; 3], own: usize| {
        // Where the volume ends nothing is known, so no voxel is deeper than its distance from there.
        let room = (0..3).map(|a| voxel[a].min(size[a] - 1 - voxel[a])).fold(MAX_DEPTH, usize::min);
        (1..=room)
            .take_while(|&d| shell(voxel, d).all(|p| class_of(samples[position(size, p)].to_f32()) == own))
            .count()
    };
    let fresh = || -> Vec<[Moments; MAX_DEPTH]> {
        greys.iter().map(|&base| [Moments::about(base); MAX_DEPTH]).collect()
    };
    // Fixed chunks, summed in order: the same sums for any number of threads.
    let parts: Vec<_> = grid
        .par_chunks(1 << 14)
        .map(|chunk| {
            let mut found = fresh();
            for &voxel in chunk {
                let grey = samples[position(size, voxel)].to_f32();
                let own = class_of(grey);
                for moments in &mut found[own][..depth_of(voxel, own)] {
                    moments.add(f64::from(grey));
                }
            }
            found
        })
        .collect();
    let mut total = fresh();
    for part in &parts {
        for (t, p) in total.iter_mut().flatten().zip(part.iter().flatten()) {
            t.merge(p);
        }
    }
    total
        .iter()
        .map(|depths| {
            let enough = (MIN_SHARE * depths[0].voxels as f64).max(MIN_VOXELS as f64);
            *depths.iter().rev().find(|m| m.voxels as f64 >= enough).unwrap_or(&depths[0])
        })
        .collect()
}

/// The 26 voxels `d` steps away.
fn shell(voxel: [usize; 3], d: usize) -> impl Iterator<Item = [usize; 3]> {
    (0..27usize).filter(|&i| i != 13).map(move |i| {
        let steps = [i % 3, i / 3 % 3, i / 9];
        std::array::from_fn(|a| voxel[a] + steps[a] * d - d)
    })
}
