//! What voxels see of a corner: predicted grey values and their derivatives, for a batch at a time.
//!
//! The share of a subset of planes falls with distance i by the flux through plane i inside the others, and changes
//! with the correlation of two planes by that along their line (`orthant`); the rest is the chain rule. Derivatives
//! are exact for planes; for bent ones those of the first order in the bends.

use glam::{DMat3, DVec3};

use super::batch::{BATCH, Batch, Batches, Row, Rows, Sums, dot, multiply};
use super::corner::{BEND, CORNER, Corner, LEVEL, MATERIALS, SIGMA, TILT};
use super::orthant::{Distances, Planes, ZERO};
use super::sheet::Reading;

type Vector = [f32; 3];

/// A corner as every voxel needs it.
pub(super) struct Known {
    apex: Vector,
    normals: [Vector; 3],
    /// One over the factor on sigma.
    shrink: f32,
    /// How planes bend: columns, and traces.
    forms: [[Vector; 3]; 3],
    traces: [f32; 3],
    /// Derivatives of the normals by their tilts, and the tangents that bends are told in.
    tangents: [[Vector; 2]; 3],
    frames: [[Vector; 2]; 3],
    /// Whether planes are or may get bent.
    bends: bool,
    levels: [f32; MATERIALS],
    planes: Planes,
    /// Coefficients of the shares of subsets, for the grey value, and for each material's share.
    weights: [f32; 8],
    of: [[f32; 8]; MATERIALS],
}

fn vector(v: DVec3) -> Vector {
    v.as_vec3().to_array()
}

/// The alternating sums of values of octants: coefficients of the shares of subsets.
fn subset_weights(mut octants: [f64; 8]) -> [f64; 8] {
    for i in 0..3 {
        for o in 0..8 {
            if o & (1 << i) != 0 {
                octants[o] -= octants[o ^ (1 << i)];
            }
        }
    }
    octants
}

/// What subsets make of their shares with these coefficients: small whole numbers, most of them zero.
#[inline(always)]
fn mixed(of: &[f32; 8], shares: &[Row; 8]) -> Row {
    let mut out = ZERO;
    for s in 0..8 {
        if of[s].abs() > 0.5 {
            for i in 0..BATCH {
                out[i] += of[s] * shares[s][i];
            }
        }
    }
    out
}

#[inline(always)]
fn at(rows: &[Row; 3], i: usize) -> Vector {
    [rows[0][i], rows[1][i], rows[2][i]]
}

#[inline(always)]
fn applied(form: &[Vector; 3], r: &Vector) -> Vector {
    // Symmetric: columns are rows.
    [dot(&form[0], r), dot(&form[1], r), dot(&form[2], r)]
}

impl Known {
    /// With derivatives of normals by tilts, frames, and whether planes may get bent.
    pub(super) fn new(
        corner: &Corner,
        tangents: &[[DVec3; 2]; 3],
        frames: &[[DVec3; 3]; 3],
        bends: bool,
    ) -> Self {
        let of: [[f64; 8]; MATERIALS] = std::array::from_fn(|m| {
            subset_weights(corner.materials.map(|o| if usize::from(o) == m { 1.0 } else { 0.0 }))
        });
        let wanted = std::array::from_fn(|s| of.iter().any(|w| w[s].abs() > 0.5));
        let weights: [f64; 8] =
            std::array::from_fn(|s| (0..MATERIALS).map(|m| corner.levels[m] * of[m][s]).sum());
        Self {
            tangents: tangents.map(|t| t.map(vector)),
            frames: frames.map(|[u, v, _]| [u, v].map(vector)),
            bends,
            weights: weights.map(|w| w as f32),
            of: of.map(|of| of.map(|w| w as f32)),
            ..Self::of_planes(corner, wanted)
        }
    }

    /// For shares of the octants alone.
    fn of_planes(corner: &Corner, wanted: [bool; 8]) -> Self {
        let n = corner.normals;
        let trace = |form: DMat3| form.x_axis.x + form.y_axis.y + form.z_axis.z;
        Self {
            apex: vector(corner.apex),
            normals: n.map(vector),
            shrink: libm::exp(-corner.log_sigma) as f32,
            forms: corner.forms.map(|f| [f.x_axis, f.y_axis, f.z_axis].map(vector)),
            traces: corner.forms.map(|f| trace(f) as f32),
            tangents: [[[0.0; 3]; 2]; 3],
            frames: [[[0.0; 3]; 2]; 3],
            bends: corner.forms.iter().any(|f| *f != DMat3::ZERO),
            levels: corner.levels.map(|l| l as f32),
            planes: Planes::new([n[1].dot(n[2]), n[2].dot(n[0]), n[0].dot(n[1])], wanted),
            weights: [0.0; 8],
            of: [[0.0; 8]; MATERIALS],
        }
    }

    /// Places from the apex.
    #[inline(always)]
    fn places(&self, batch: &Batch) -> [Row; 3] {
        let mut r = batch.at;
        for a in 0..3 {
            for i in 0..BATCH {
                r[a][i] -= self.apex[a];
            }
        }
        r
    }

    #[inline(always)]
    fn distances(&self, r: &[Row; 3]) -> Distances {
        let mut h = [ZERO; 3];
        for p in 0..3 {
            for i in 0..BATCH {
                h[p][i] = dot(&self.normals[p], &at(r, i)) * self.shrink;
            }
        }
        if self.bends {
            let raise = 1.0 / self.shrink;
            for p in 0..3 {
                for i in 0..BATCH {
                    // As `corner::sag`.
                    let (r, d) = (at(r, i), h[p][i] * raise);
                    let rise = dot(&r, &applied(&self.forms[p], &r));
                    let k = rise / (dot(&r, &r) - d * d).max(1e-6);
                    let sag = 0.5 * rise / (1.0 - k * d).clamp(0.5, 2.0);
                    h[p][i] -= sag * self.shrink + 0.5 * self.traces[p] * raise;
                }
            }
        }
        Distances::new(h)
    }

    /// Each material's share, and the grey value of planes that are not turned where they bend.
    #[inline(always)]
    fn values(&self, h: &Distances) -> ([Row; MATERIALS], Row) {
        let shares = self.planes.shares(h);
        let (mut materials, mut value) = ([ZERO; MATERIALS], ZERO);
        for m in 0..MATERIALS {
            materials[m] = mixed(&self.of[m], &shares);
            for i in 0..BATCH {
                value[i] += self.levels[m] * materials[m][i];
            }
        }
        (materials, value)
    }

    /// Adds what it does to the grey value that bent planes are turned at a place.
    #[inline(always)]
    fn turn(&self, r: &[Row; 3], by_rho: &[Row; 3], value: &mut Row) {
        let n = &self.normals;
        for i in 0..BATCH {
            let r = at(r, i);
            let [f, g, h] = &self.forms;
            let turned = [applied(f, &r), applied(g, &r), applied(h, &r)];
            for p in 0..3 {
                let [j, k] = [(p + 1) % 3, (p + 2) % 3];
                let rho = (-dot(&turned[j], &n[k]) - dot(&turned[k], &n[j])).clamp(-0.3, 0.3);
                value[i] += by_rho[p][i] * rho;
            }
        }
    }

    /// Shares of the octants; none of padding.
    #[inline(always)]
    fn octants(&self, batch: &Batch) -> [Row; 8] {
        let mut shares = self.planes.shares(&self.distances(&self.places(batch)));
        for p in 0..3 {
            for o in 0..8 {
                if o & (1 << p) == 0 {
                    let other = shares[o | 1 << p];
                    for i in 0..BATCH {
                        shares[o][i] -= other[i];
                    }
                }
            }
        }
        for share in &mut shares {
            for i in 0..BATCH {
                share[i] = share[i].max(0.0) * batch.counts[i];
            }
        }
        shares
    }

    /// The grey value at a place.
    #[cfg(test)]
    pub(super) fn predict(&self, batches: &Batches) -> f64 {
        let r = self.places(batches.first());
        let h = self.distances(&r);
        let mut value = self.values(&h).1;
        self.turn(&r, &self.planes.slopes(&h, &self.weights)[1], &mut value);
        f64::from(value[0])
    }
}

impl Rows<CORNER> for Known {
    #[inline(always)]
    fn add(&self, batch: &Batch, reading: &Reading, sums: &mut Sums<CORNER>) {
        let r = self.places(batch);
        let h = self.distances(&r);
        let (materials, mut value) = self.values(&h);
        let [mut by_h, mut by_rho] = self.planes.slopes(&h, &self.weights);
        if self.bends {
            self.turn(&r, &by_rho, &mut value);
        }
        let [residuals, weights] = batch.residuals(reading, &value);
        for p in 0..3 {
            for i in 0..BATCH {
                by_h[p][i] *= weights[i];
                by_rho[p][i] *= weights[i];
            }
        }
        let mut rows = [ZERO; CORNER];
        for m in 0..MATERIALS {
            for i in 0..BATCH {
                rows[LEVEL + m][i] = weights[i] * materials[m][i];
            }
        }
        for p in 0..3 {
            let (n, [j, k]) = (&self.normals, [(p + 1) % 3, (p + 2) % 3]);
            for i in 0..BATCH {
                let (r, flux) = (at(&r, i), by_h[p][i] * self.shrink);
                rows[SIGMA][i] -= by_h[p][i] * h.h[p][i];
                // Correlations of plane p stand at the place of the plane that is not part of them.
                let mut turn = [0.0; 3];
                for a in 0..3 {
                    turn[a] = r[a] * flux + n[j][a] * by_rho[k][i] + n[k][a] * by_rho[j][i];
                    rows[a][i] -= n[p][a] * flux;
                }
                for t in 0..2 {
                    rows[TILT + 2 * p + t][i] = dot(&self.tangents[p][t], &turn);
                }
            }
            if self.bends {
                let raise = 1.0 / (self.shrink * self.shrink);
                let [u, v] = &self.frames[p];
                for i in 0..BATCH {
                    let (r, flux) = (at(&r, i), by_h[p][i] * self.shrink);
                    let lean = applied(&self.forms[p], &r);
                    for a in 0..3 {
                        rows[a][i] += lean[a] * flux;
                    }
                    rows[SIGMA][i] -= by_h[p][i] * self.traces[p] / self.shrink;
                    let (a, b, h) = (dot(u, &r), dot(v, &r), -0.5 * flux);
                    let s = -dot(u, &n[j]) * by_rho[k][i] - dot(u, &n[k]) * by_rho[j][i];
                    let t = -dot(v, &n[j]) * by_rho[k][i] - dot(v, &n[k]) * by_rho[j][i];
                    rows[BEND + 3 * p][i] = h * (a * a + raise) + a * s;
                    rows[BEND + 3 * p + 1][i] = h * 2.0 * a * b + b * s + a * t;
                    rows[BEND + 3 * p + 2][i] = h * (b * b + raise) + b * t;
                }
            }
        }
        sums.add(&rows, &residuals);
    }
}

/// Sums over voxels of products of the octants' shares among themselves and with the grey values, and what labels say.
pub(super) struct Survey {
    /// Products of shares, lower triangle.
    pub square: [[f64; 8]; 8],
    /// Of shares and grey values.
    pub grey: [f64; 8],
    /// Of squared grey values.
    pub total: f64,
    /// Votes for each material in each octant: a voxel's label counts with the fourth power of the octant's share.
    pub votes: [[f64; MATERIALS]; 8],
}

/// Surveys the octants of three planes; labels from [`MATERIALS`] on do not count.
pub(super) fn survey(corner: &Corner, batches: &Batches, labels: &[u8]) -> Survey {
    struct Work<'a> {
        known: Known,
        batches: &'a Batches,
        labels: &'a [u8],
    }
    impl pulp::NullaryFnOnce for Work<'_> {
        type Output = Survey;

        #[inline(always)]
        fn call(self) -> Survey {
            let mut out =
                Survey { square: [[0.0; 8]; 8], grey: [0.0; 8], total: 0.0, votes: [[0.0; MATERIALS]; 8] };
            let mut labels = self.labels.chunks(BATCH);
            let sum = |a: &Row, b: &Row| {
                let mut lanes = [0.0; 8];
                multiply(a, b, &mut lanes);
                lanes.iter().map(|v| f64::from(*v)).sum::<f64>()
            };
            for batch in self.batches.all() {
                let shares = self.known.octants(batch);
                for i in 0..8 {
                    for j in 0..=i {
                        out.square[i][j] += sum(&shares[i], &shares[j]);
                    }
                    out.grey[i] += sum(&shares[i], &batch.grey);
                }
                for (i, &label) in labels.next().unwrap_or_default().iter().enumerate() {
                    if usize::from(label) < MATERIALS {
                        for o in 0..8 {
                            let square = shares[o][i] * shares[o][i];
                            out.votes[o][usize::from(label)] += f64::from(square * square);
                        }
                    }
                }
                for i in 0..BATCH {
                    out.total += f64::from(batch.grey[i] * batch.counts[i]) * f64::from(batch.grey[i]);
                }
            }
            out
        }
    }
    let known = Known::of_planes(corner, [true; 8]);
    pulp::Arch::new().dispatch(Work { known, batches, labels })
}
