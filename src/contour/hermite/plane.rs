//! A plane through heights over a small window, on this side of any edge.
//!
//! Heights that no plane can explain have an edge among them, or a face that bends. Then the plane is fitted
//! to half-windows, or quarters, on any side of the middle; the one that fits best is kept (the idea of
//! essentially non-oscillating schemes: never difference across a jump), and grows by all heights that agree
//! with it.

/// Lattice columns on each side of the middle that a window can have.
pub(super) const MAX_REACH: usize = 3;
const WIDTH: usize = 2 * MAX_REACH + 1;
/// Most columns in a window.
pub(super) const MAX_COLUMNS: usize = WIDTH * WIDTH;

/// Height of the interface over one column of the lattice.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Column {
    /// Columns from the middle of the window.
    pub(super) at: [f32; 2],
    /// Lattice units, from any level.
    pub(super) height: f32,
    /// How much it counts.
    pub(super) weight: f32,
    /// Square of the standard deviation that it may have.
    pub(super) variance: f32,
}

impl Column {
    fn is_middle(&self) -> bool {
        self.at.iter().all(|&a| a == 0.0)
    }
}

/// The plane `height = level + slope · (u, v)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plane {
    pub(super) level: f32,
    pub(super) slope: [f32; 2],
    /// Mean square of the distances, corrected for what the fit takes up; infinite if the plane explains any
    /// heights of its columns.
    variance: f32,
}

impl Plane {
    /// How far a height lies above the plane, along the columns.
    fn residual(&self, c: &Column) -> f32 {
        c.height - self.level - self.slope[0] * c.at[0] - self.slope[1] * c.at[1]
    }
}

/// Sums over columns: number, weight, and weighted u, v, h, uu, uv, vv, uh, vh, hh, variance.
type Sums = [f32; 12];

fn sums(c: &Column) -> Sums {
    let ([u, v], h, w) = (c.at, c.height, c.weight);
    let [wu, wv, wh] = [w * u, w * v, w * h];
    [1.0, w, wu, wv, wh, wu * u, wu * v, wv * v, wu * h, wv * h, wh * h, w * c.variance]
}

fn add(a: &mut Sums, b: &Sums) {
    for (a, b) in a.iter_mut().zip(b) {
        *a += b;
    }
}

/// Least squares. Columns in one line tell the slope along it only; the other is taken as level.
fn solve(sums: &Sums) -> Plane {
    let [n, w, u, v, h, uu, uv, vv, uh, vh, hh, _] = *sums;
    let (mu, mv, mh) = (u / w, v / w, h / w);
    let (uu, uv, vv) = (uu - u * mu, uv - u * mv, vv - v * mv);
    let (uh, vh, hh) = (uh - u * mh, vh - v * mh, hh - h * mh);
    let determinant = uu * vv - uv * uv;
    let tiny = 1e-3 * w;
    let (slope, unknowns) = if determinant > tiny * tiny.max(uu.max(vv) * 0.1) {
        ([(vv * uh - uv * vh) / determinant, (uu * vh - uv * uh) / determinant], 3.0)
    } else if uu + vv > tiny {
        // Along the line's direction (a, b), the larger eigenvector.
        let (a, b) = if uu >= vv { (uu, uv) } else { (uv, vv) };
        let along = (a * uh + b * vh) / (a * a * uu + 2.0 * a * b * uv + b * b * vv);
        ([a * along, b * along], 2.0)
    } else {
        ([0.0; 2], 1.0)
    };
    let left = (hh - slope[0] * uh - slope[1] * vh).max(0.0) / w;
    let variance =
        if n > unknowns + 0.5 && unknowns > 2.5 { left * n / (n - unknowns) } else { f32::INFINITY };
    Plane { level: mh - slope[0] * mu - slope[1] * mv, slope, variance }
}

/// Directions around the middle: rays at even numbers, what lies between them at odd ones.
const SECTORS: usize = 16;

/// Sector of each column but the middle.
const SECTOR: [[u8; WIDTH]; WIDTH] = {
    let mut out = [[0; WIDTH]; WIDTH];
    let (mut i, r) = (0, MAX_REACH as i32);
    while i < WIDTH {
        let mut j = 0;
        while j < WIDTH {
            out[i][j] = sector(i as i32 - r, j as i32 - r);
            j += 1;
        }
        i += 1;
    }
    out
};

const fn sector(u: i32, v: i32) -> u8 {
    // Turn by quarters until u > 0 and v >= 0.
    let (mut u, mut v, mut quarter) = (u, v, 0);
    while !(u > 0 && v >= 0 || u == 0 && v == 0) {
        (u, v) = (v, -u);
        quarter += 4;
    }
    quarter
        + if v == 0 {
            0
        } else if v < u {
            1
        } else if v == u {
            2
        } else {
            3
        }
}

/// Most that a face can bend, in levels per square of a column: a radius of 4 voxels where it lies level, of
/// 11 where it is as steep as the axes allow. More is an edge.
const MOST_BEND: f32 = 0.125;

/// How well heights must be explained.
#[derive(Debug, Clone, Copy)]
pub(super) struct Demand {
    /// A plane explains heights if their mean square distance is at most this many times their variance.
    pub(super) accepted: f32,
    /// A height agrees with a plane if the square of its distance is at most this many times its variance.
    pub(super) agrees: f32,
}

/// The plane on this side of any edge. The first column must be that of the crossing asked for, every part
/// of the window has it; the others are those of a window of `reach`. Also whether one smooth face has all
/// columns of the window.
pub(super) fn fit(columns: &[Column], reach: usize, demand: Demand) -> Option<(Plane, bool)> {
    let (own, others) = columns.split_first()?;
    let mut all = sums(own);
    for c in others {
        add(&mut all, &sums(c));
    }
    let whole = solve(&all);
    let allowed = demand.accepted * all[11] / all[1];
    let full = is_full(columns, reach);
    if whole.variance <= allowed || others.len() < 3 {
        return Some((whole, full));
    }
    if full && bends(columns, &whole, reach, allowed) {
        return Some((whole, true));
    }
    let best = best_part(own, others, allowed).unwrap_or(whole);
    let mut agreeing = sums(own);
    let mut n = 1;
    for c in others {
        let r = best.residual(c);
        if r * r <= demand.agrees * c.variance {
            add(&mut agreeing, &sums(c));
            n += 1;
        }
    }
    Some((if n >= 4 { solve(&agreeing) } else { best }, false))
}

fn is_full(columns: &[Column], reach: usize) -> bool {
    // A crossing beside the middle is one more than the window has.
    columns.len() == (2 * reach + 1).pow(2) + usize::from(!columns[0].is_middle())
}

/// Whether a full window is explained by a face that bends evenly: then its slope in the middle is that of
/// the plane, because what bends is even and the slope is odd.
fn bends(columns: &[Column], whole: &Plane, reach: usize, allowed: f32) -> bool {
    let r = reach as f32;
    // Mean square of u over the window, and mean of its fourth power.
    let square = r * (r + 1.0) / 3.0;
    let fourth = square * (3.0 * r * r + 3.0 * r - 1.0) / 5.0;
    let (mut left, mut uu, mut uv, mut vv) = (0.0, 0.0, 0.0, 0.0);
    for c in columns {
        let (d, [u, v]) = (whole.residual(c), c.at);
        left += d * d;
        uu += d * (u * u - square);
        uv += d * u * v;
        vv += d * (v * v - square);
    }
    let n = columns.len() as f32;
    let (even, mixed) = (n * (fourth - square * square), n * square * square);
    let bend = [uu / even, uv / mixed, vv / even];
    left -= bend[0] * uu + bend[1] * uv + bend[2] * vv;
    bend.iter().all(|b| b.abs() <= MOST_BEND) && left <= (n - 6.0) * allowed
}

/// The best half, or the best quarter if no half is explained.
fn best_part(own: &Column, others: &[Column], allowed: f32) -> Option<Plane> {
    let mut parts = [[0.0f32; 12]; SECTORS];
    for c in others {
        let [i, j] = std::array::from_fn(|k| {
            // The column in the middle, if the crossing is beside it, lies on the ray towards it.
            let at = if c.is_middle() { -own.at[k].signum() * f32::from(own.at[k] != 0.0) } else { c.at[k] };
            (at + MAX_REACH as f32) as usize
        });
        add(&mut parts[usize::from(SECTOR[i][j])], &sums(c));
    }
    let mut best: Option<Plane> = None;
    for width in [9, 5] {
        for start in (0..SECTORS).step_by(2) {
            let mut part = sums(own);
            for k in start..start + width {
                add(&mut part, &parts[k % SECTORS]);
            }
            let plane = solve(&part);
            if plane.variance < best.map_or(f32::INFINITY, |b| b.variance) {
                best = Some(plane);
            }
        }
        if best.is_some_and(|b| b.variance <= allowed) {
            break;
        }
    }
    best
}
