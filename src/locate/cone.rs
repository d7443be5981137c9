//! Where four materials meet in general: four rays from an apex, six planar sheets between them, blurred.
//!
//! Cone m is spanned by the three rays other than ray m, and holds material m; ray m is the curve in which the
//! other three materials meet. A cone is where three half-spaces overlap, so its share of the blur is one
//! orthant probability (`orthant`). The shares sum to one: the flattest cone has what the others leave, and may then
//! be as flat as a half-space (three blocks on a plate), or be what surrounds the other three. Notation and
//! parameters otherwise as in `corner`: apex, two tilts of each ray, four levels with priors, log sigma.
//!
//! Left out: curvature; and two of a ray's three sheets in one plane, where a cone has two rays and nothing between
//! (flush blocks: `corner`).

use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, SVector};

use super::batch::{BATCH, Batch, Batches, Row, Rows, Sums, assemble, dot};
use super::corner::principal_sigmas;
use super::frame::basis;
use super::least_squares::{ENOUGH, Fit, Model, Normal, Problem, minimise};
use super::orthant::{Distances, Planes, ZERO};
use super::sheet::{LevelPrior, Reading, Sample};

/// Parameters of four cones.
pub(super) const CONE: usize = 16;
/// Places of the parameters: the apex stands first.
const TILT: usize = 3;
const LEVEL: usize = 11;
const SIGMA: usize = 15;

/// Normals of a cone whose determinant is smaller are nearly dependent.
const FLATTEST: f64 = 0.06;

/// Four cones about an apex, in blur units.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cone {
    /// Where the rays meet.
    pub apex: DVec3,
    /// Unit vectors along the curves; ray m lies between the materials other than m.
    pub rays: [DVec3; 4],
    /// Grey level of each material.
    pub levels: [f64; 4],
    /// Logarithm of the factor on sigma.
    pub log_sigma: f64,
}

/// What is known before a fit of four cones.
#[derive(Debug, Clone, Copy)]
pub(super) struct ConePrior {
    /// Grey level of each material.
    pub levels: [LevelPrior; 4],
    /// Standard deviation of a grey value.
    pub noise: f64,
    /// Standard deviation of the logarithm of sigma; zero to hold sigma.
    pub log_sigma: f64,
}

/// Four cones and how well they fit.
#[derive(Debug, Clone)]
pub(super) struct ConeFit {
    /// The cones.
    pub cone: Cone,
    /// The fit. Its first parameters are the apex, then two tilts of each ray.
    pub fit: Fit<CONE>,
    /// Derivative of each ray by its tilts, at the fit.
    pub tangents: [[DVec3; 2]; 4],
    /// Samples used.
    pub samples: usize,
}

/// The three rays of cone `m`.
#[inline]
fn around(m: usize) -> [usize; 3] {
    [(m + 1) % 4, (m + 2) % 4, (m + 3) % 4]
}

/// Normals of the sheets of a cone, into it, sheet i opposite ray i of [`around`]; and twice signed lengths before
/// normalising. `None` if they are nearly dependent.
fn faces(rays: &[DVec3; 4], m: usize) -> Option<[(DVec3, f64); 3]> {
    let r = around(m).map(|i| rays[i]);
    let sign = r[0].dot(r[1].cross(r[2])).signum();
    let faces: [(DVec3, f64); 3] = std::array::from_fn(|i| {
        let c = r[(i + 1) % 3].cross(r[(i + 2) % 3]);
        let length = c.length().max(1e-12) * sign;
        (c / length, length)
    });
    let [a, b, c] = faces.map(|f| f.0);
    (a.dot(b.cross(c)).abs() >= FLATTEST).then_some(faces)
}

impl Cone {
    /// How much of each ray is in a combination of all that vanishes, largest 1; negative or small for the ray that
    /// lies within the cone of the others, or for which they are flat. `None` unless three are clearly positive.
    fn balance(&self) -> Option<([f64; 4], usize)> {
        let det = |m: usize| {
            let [a, b, c] = around(m).map(|i| self.rays[i]);
            // Cyclic permutations of four are odd.
            if m.is_multiple_of(2) { a.dot(b.cross(c)) } else { -a.dot(b.cross(c)) }
        };
        let all: [f64; 4] = std::array::from_fn(det);
        let largest = all.iter().fold(0.0f64, |m, &d| if d.abs() > m.abs() { d } else { m });
        if largest.abs() < 1e-6 {
            return None;
        }
        let all = all.map(|d| d / largest);
        let rest = (1..4).fold(0, |m, i| if all[i] < all[m] { i } else { m });
        (0..4).all(|m| m == rest || all[m] > 0.05).then_some((all, rest))
    }

    /// Whether the cones fill space and three of them are clear of being flat.
    #[must_use]
    pub(super) fn is_possible(&self) -> bool {
        self.balance().is_some_and(|(_, rest)| (0..4).all(|m| m == rest || faces(&self.rays, m).is_some()))
    }

    /// The material at a point.
    #[must_use]
    pub(super) fn material(&self, at: DVec3) -> usize {
        let r = at - self.apex;
        let rest = self.balance().map_or(0, |b| b.1);
        let within = |m: usize| faces(&self.rays, m).is_some_and(|f| f.iter().all(|(n, _)| n.dot(r) > 0.0));
        (0..4).find(|&m| m != rest && within(m)).unwrap_or(rest)
    }

    /// The normal of the sheet between materials `m` and `n`, from m to n.
    #[must_use]
    pub(super) fn normal(&self, m: usize, n: usize) -> DVec3 {
        let [i, j] = Self::sheet(m, n).map(|i| self.rays[i]);
        let normal = i.cross(j).normalize_or_zero();
        // Ray m lies on the side of cone n, which it bounds.
        if normal.dot(self.rays[m] - self.rays[n]) > 0.0 { normal } else { -normal }
    }

    /// Signed distance of a point from the plane of the sheet between materials `m` and `n`, positive on n's side.
    #[must_use]
    pub(super) fn distance(&self, m: usize, n: usize, at: DVec3) -> f64 {
        self.normal(m, n).dot(at - self.apex)
    }

    /// The rays beside the sheet between materials `m` and `n`.
    pub(super) fn sheet(m: usize, n: usize) -> [usize; 2] {
        let mut out = [0; 2];
        for (slot, i) in out.iter_mut().zip((0..4).filter(|&i| i != m && i != n)) {
            *slot = i;
        }
        out
    }

    /// Cones whose materials lie in about the given directions: rays at equal angles from three of them. `None`
    /// where these do not make four cones.
    #[cfg(test)]
    pub(super) fn of_directions(apex: DVec3, directions: &[DVec3; 4], levels: [f64; 4]) -> Option<Self> {
        let rays = std::array::from_fn(|m| {
            let [a, b, c] = around(m).map(|i| directions[i]);
            let ray = (b - a).cross(c - a).normalize_or_zero();
            if ray.dot(a - directions[m]) > 0.0 { ray } else { -ray }
        });
        let cone = Self { apex, rays, levels, log_sigma: 0.0 };
        cone.is_possible().then_some(cone)
    }

    /// Cones from the labels of samples alone: the directions of their mean places from the samples' middle.
    #[cfg(test)]
    pub(super) fn of_labels(samples: &[Sample], labels: &[u8], levels: [f64; 4]) -> Option<Self> {
        let mut sums = [DVec3::ZERO; 4];
        for (s, &label) in samples.iter().zip(labels) {
            if let Some(sum) = sums.get_mut(usize::from(label)) {
                *sum += s.at * s.at.length();
            }
        }
        Self::of_directions(DVec3::ZERO, &sums.map(|s| s.normalize_or_zero()), levels)
    }

    /// The point nearest to four lines, each through a point along a direction, weighted alike.
    #[must_use]
    pub(super) fn meet(lines: &[(DVec3, DVec3); 4]) -> Option<DVec3> {
        let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
        for &(point, along) in lines {
            let across =
                DMat3::IDENTITY - DMat3::from_cols(along * along.x, along * along.y, along * along.z);
            matrix += across;
            right += across * point;
        }
        (matrix.determinant() > 1e-3).then(|| matrix.inverse() * right)
    }

    /// The grey value at a point, blurred. `None` for impossible cones.
    #[cfg(test)]
    pub(super) fn blurred(&self, at: DVec3) -> Option<f64> {
        let known = Known::new(self, &[[DVec3::ZERO; 2]; 4])?;
        let (_, seen) = known.see(Batches::new(&[Sample { at, grey: 0.0 }]).first());
        Some(f64::from(known.values(&seen).1[0]))
    }

    /// Fits to samples from here. `None` if the cones are impossible, or no step is possible.
    #[must_use]
    pub(super) fn fit(&self, samples: &[Sample], prior: &ConePrior, iterations: usize) -> Option<ConeFit> {
        if !self.is_possible() {
            return None;
        }
        let batches = &Batches::new(samples);
        let model = Blurred { samples: batches, frames: self.rays.map(basis), noise: prior.noise };
        let mut problem = Problem {
            active: [true; CONE],
            prior: [(0.0, f64::INFINITY); CONE],
            most: [0.8; CONE],
            iterations,
            enough: ENOUGH,
        };
        let mut start = SVector::<f64, CONE>::zeros();
        for i in 0..3 {
            start[i] = self.apex[i];
        }
        for i in TILT..LEVEL {
            problem.most[i] = 0.35;
        }
        for m in 0..4 {
            start[LEVEL + m] = self.levels[m];
            problem.most[LEVEL + m] = f64::INFINITY;
            problem.prior[LEVEL + m] = (prior.levels[m].mean, prior.levels[m].sigma);
        }
        start[SIGMA] = self.log_sigma;
        problem.active[SIGMA] = prior.log_sigma > 0.0;
        problem.prior[SIGMA] = (0.0, prior.log_sigma.max(1e-6));
        problem.most[SIGMA] = 0.1;
        let fit = minimise(&model, &problem, start)?;
        let (cone, tangents) = model.cone(&fit.x);
        Some(ConeFit { cone, fit, tangents, samples: samples.len() })
    }
}

impl ConeFit {
    /// Standard deviation of the position of the sheet between materials `m` and `n` along its normal at a place,
    /// for white noise.
    #[must_use]
    pub(super) fn sheet_sigma(&self, m: usize, n: usize, at: DVec3) -> f64 {
        let r = at - self.cone.apex;
        let normal = self.cone.normal(m, n);
        let mut g = SVector::<f64, CONE>::zeros();
        for k in 0..3 {
            g[k] = -normal[k];
        }
        // The sheet follows its rays: a place between them moves by its parts along each.
        let [i, j] = Cone::sheet(m, n);
        let [a, b] = [self.cone.rays[i], self.cone.rays[j]];
        let (ab, ar, br) = (a.dot(b), a.dot(r), b.dot(r));
        let free = (1.0 - ab * ab).max(1e-9);
        for (ray, part) in [(i, (ar - ab * br) / free), (j, (br - ab * ar) / free)] {
            for k in 0..2 {
                g[TILT + 2 * ray + k] = -part * normal.dot(self.tangents[ray][k]);
            }
        }
        (g.transpose() * self.fit.covariance * g)[(0, 0)].max(0.0).sqrt()
    }

    /// The covariance of the apex.
    #[must_use]
    pub(super) fn apex_covariance(&self) -> Matrix3<f64> {
        self.fit.covariance.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// Standard deviations of the apex along its principal directions, ascending.
    #[must_use]
    pub(super) fn apex_sigmas(&self) -> [f64; 3] {
        principal_sigmas(&self.apex_covariance())
    }

    /// Misfit per sample.
    #[must_use]
    pub(super) fn reduced(&self) -> f64 {
        self.fit.chi2 / self.samples.max(1) as f64
    }
}

/// One cone made ready for many voxels: its material, the normals of its sheets with twice signed lengths before
/// normalising, and their shares.
struct One {
    material: usize,
    normals: [[f32; 3]; 3],
    lengths: [f32; 3],
    planes: Planes,
}

/// Four cones as every voxel needs them: three, and the rest.
struct Known {
    apex: [f32; 3],
    cones: [One; 3],
    rest: usize,
    shrink: f32,
    levels: [f32; 4],
    rays: [[f32; 3]; 4],
    /// Derivatives of the rays by their tilts.
    tangents: [[[f32; 3]; 2]; 4],
}

/// Only the share of all three planes counts.
const ALL: [bool; 8] = [false, false, false, false, false, false, false, true];
const WEIGHT: [f32; 8] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];

impl Known {
    fn new(cone: &Cone, tangents: &[[DVec3; 2]; 4]) -> Option<Self> {
        let vector = |v: DVec3| v.as_vec3().to_array();
        let (_, rest) = cone.balance()?;
        let one = |k: usize| {
            let material = around(rest)[k];
            let faces = faces(&cone.rays, material)?;
            let [a, b, c] = faces.map(|f| f.0);
            let planes = Planes::new([b.dot(c), c.dot(a), a.dot(b)], ALL);
            let (normals, lengths) = (faces.map(|f| vector(f.0)), faces.map(|f| f.1 as f32));
            Some(One { material, normals, lengths, planes })
        };
        Some(Self {
            apex: vector(cone.apex),
            cones: [one(0)?, one(1)?, one(2)?],
            rest,
            shrink: libm::exp(-cone.log_sigma) as f32,
            levels: cone.levels.map(|l| l as f32),
            rays: cone.rays.map(vector),
            tangents: tangents.map(|t| t.map(vector)),
        })
    }

    /// Places from the apex, and what is seen of each of the three cones: distances of its sheets, and its share.
    #[inline(always)]
    fn see(&self, batch: &Batch) -> ([Row; 3], [(Distances, Row); 3]) {
        let mut r = batch.at;
        for a in 0..3 {
            for i in 0..BATCH {
                r[a][i] -= self.apex[a];
            }
        }
        let [a, b, c] = &self.cones;
        (r, [self.share(a, &r), self.share(b, &r), self.share(c, &r)])
    }

    #[inline(always)]
    fn share(&self, one: &One, r: &[Row; 3]) -> (Distances, Row) {
        let mut h = [ZERO; 3];
        for p in 0..3 {
            for i in 0..BATCH {
                h[p][i] = dot(&one.normals[p], &[r[0][i], r[1][i], r[2][i]]) * self.shrink;
            }
        }
        let h = Distances::new(h);
        let share = one.planes.shares(&h)[7];
        (h, share)
    }

    /// Share of each cone, and grey values.
    #[inline(always)]
    fn values(&self, seen: &[(Distances, Row); 3]) -> ([Row; 4], Row) {
        let (mut shares, mut value, mut rest) = ([ZERO; 4], ZERO, [1.0; BATCH]);
        for k in 0..3 {
            for i in 0..BATCH {
                rest[i] -= seen[k].1[i];
            }
            shares[self.cones[k].material] = seen[k].1;
        }
        shares[self.rest] = rest;
        for m in 0..4 {
            for i in 0..BATCH {
                value[i] += self.levels[m] * shares[m][i];
            }
        }
        (shares, value)
    }
}

impl Rows<CONE> for Known {
    #[inline(always)]
    fn add(&self, batch: &Batch, reading: &Reading, sums: &mut Sums<CONE>) {
        let (r, seen) = self.see(batch);
        let (shares, value) = self.values(&seen);
        let [residuals, weights] = batch.residuals(reading, &value);
        let mut rows = [ZERO; CONE];
        let mut turn = [[ZERO; 3]; 4];
        for (c, (h, _)) in self.cones.iter().zip(&seen) {
            let jump = self.levels[c.material] - self.levels[self.rest];
            let [by_h, by_rho] = c.planes.slopes(h, &WEIGHT);
            let (n, rays) = (&c.normals, around(c.material));
            for p in 0..3 {
                let [j, k] = [(p + 1) % 3, (p + 2) % 3];
                let (first, second) = (&self.rays[rays[j]], &self.rays[rays[k]]);
                let per_length = 1.0 / c.lengths[p];
                for i in 0..BATCH {
                    let across = by_h[p][i] * jump * weights[i];
                    let (flux, with_j, with_k) = (
                        across * self.shrink,
                        by_rho[k][i] * jump * weights[i],
                        by_rho[j][i] * jump * weights[i],
                    );
                    rows[SIGMA][i] -= across * h.h[p][i];
                    // Derivative by the normal, then by the product of rays that it comes from.
                    let mut g = [0.0; 3];
                    for a in 0..3 {
                        rows[a][i] -= n[p][a] * flux;
                        g[a] = r[a][i] * flux + n[j][a] * with_j + n[k][a] * with_k;
                    }
                    let along = dot(&n[p], &g);
                    for a in 0..3 {
                        g[a] = (g[a] - n[p][a] * along) * per_length;
                    }
                    let (by_first, by_second) = (cross(second, &g), cross(&g, first));
                    for a in 0..3 {
                        turn[rays[j]][a][i] += by_first[a];
                        turn[rays[k]][a][i] += by_second[a];
                    }
                }
            }
        }
        for m in 0..4 {
            for i in 0..BATCH {
                let by = [turn[m][0][i], turn[m][1][i], turn[m][2][i]];
                rows[TILT + 2 * m][i] = dot(&self.tangents[m][0], &by);
                rows[TILT + 2 * m + 1][i] = dot(&self.tangents[m][1], &by);
                rows[LEVEL + m][i] = weights[i] * shares[m][i];
            }
        }
        sums.add(&rows, &residuals);
    }
}

/// Vector product.
#[inline(always)]
fn cross(a: &[f32; 3], b: &[f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

struct Blurred<'a> {
    samples: &'a Batches,
    /// Two tangents and each ray at the start.
    frames: [[DVec3; 3]; 4],
    noise: f64,
}

impl Blurred<'_> {
    /// The cones at `x`, and the derivatives of their rays.
    fn cone(&self, x: &SVector<f64, CONE>) -> (Cone, [[DVec3; 2]; 4]) {
        let mut tangents = [[DVec3::ZERO; 2]; 4];
        let rays = std::array::from_fn(|i| {
            let [u, v, n] = self.frames[i];
            let m = n + u * x[TILT + 2 * i] + v * x[TILT + 2 * i + 1];
            let length = m.length();
            let ray = m / length;
            tangents[i] = [u, v].map(|t| (t - ray * ray.dot(t)) / length);
            ray
        });
        let apex = DVec3::new(x[0], x[1], x[2]);
        let levels = std::array::from_fn(|m| x[LEVEL + m]);
        (Cone { apex, rays, levels, log_sigma: x[SIGMA] }, tangents)
    }
}

impl Model<CONE> for Blurred<'_> {
    fn normal_equations(&self, x: &SVector<f64, CONE>, equations: &mut Normal<CONE>) -> f64 {
        let (cone, tangents) = self.cone(x);
        let Some(known) = Known::new(&cone, &tangents) else { return f64::INFINITY };
        let reading = Reading::unclipped(self.noise);
        assemble(&known, self.samples, &reading, equations)
    }

    fn is_possible(&self, x: &SVector<f64, CONE>) -> bool {
        self.cone(x).0.is_possible()
    }
}

#[cfg(test)]
#[path = "cone_tests.rs"]
mod tests;
