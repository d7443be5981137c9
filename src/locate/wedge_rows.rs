//! What voxels see of a wedge: predicted grey values and their derivatives, for a batch at a time.
//!
//! The formulas are those of `wedge.rs`. The sector in which the direction from a voxel away from the apex lies is told
//! by the sides of its two rays on which the voxel lies, so no angle of a voxel is needed.

use glam::{DMat3, DVec3};
use nalgebra::SVector;

use super::batch::{BATCH, Batch, Row, Rows, Sums, dot};
use super::normal::{bell, density, distribution, wedge};
use super::sheet::Reading;
use super::wedge::Places;

/// Parameters of a wedge with `R` rays, as every voxel needs them.
pub(super) struct Known<const R: usize> {
    origin: [f32; 3],
    /// Axes of the frame.
    axes: [[f32; 3]; 3],
    curve: Curve,
    /// One over the factor on sigma.
    pub(super) shrink: f32,
    u: [[f32; 2]; R],
    /// By how much rays turn along the curve.
    twist: [f32; R],
    /// Curvatures, in units of the wedge's own sigma.
    k: [f32; R],
    pub(super) mu: [f32; R],
}

/// The curve `a0 + a1 z + a2 z^2 / 2`.
#[derive(Clone, Copy)]
pub(super) struct Curve {
    pub a0: [f32; 2],
    pub a1: [f32; 2],
    pub a2: [f32; 2],
}

impl Curve {
    /// Of these parameters.
    pub(super) fn new<const R: usize, const N: usize>(x: &SVector<f64, N>) -> Self {
        let pair = |i: usize| [x[i] as f32, x[i + 1] as f32];
        Self { a0: pair(Places::<R>::A0), a1: pair(Places::<R>::A1), a2: pair(Places::<R>::A2) }
    }

    fn is_straight(&self) -> bool {
        self.a2.iter().all(|a| a.abs() < f32::MIN_POSITIVE)
    }

    /// Tilt of the curve at z, and q from the curve there.
    #[inline(always)]
    fn at(&self, q: [f32; 3], z: f32) -> [[f32; 2]; 2] {
        let Self { a0, a1, a2 } = self;
        let half = 0.5 * z * z;
        let tilt = [a1[0] + a2[0] * z, a1[1] + a2[1] * z];
        [tilt, [q[0] - (a0[0] + a1[0] * z + a2[0] * half), q[1] - (a0[1] + a1[1] * z + a2[1] * half)]]
    }

    /// The section that a point q (in the frame) lies in: z where the curve is nearest, and q seen from the curve there, in
    /// the plane normal to it; `[z, x, y]`. A line's is exact, a parabola's by two steps of Newton's method. Blurred
    /// along the curve by `raise` (its square), a point is raised by half the curvature of its own circle about the curve's
    /// centre.
    #[inline(always)]
    pub(super) fn section(&self, straight: bool, q: [f32; 3], raise: f32) -> [f32; 3] {
        let Self { a0, a1, a2 } = self;
        let mut z = q[2];
        if straight {
            let lean = (q[0] - a0[0]) * a1[0] + (q[1] - a0[1]) * a1[1];
            z = (z + lean) / (1.0 + a1[0] * a1[0] + a1[1] * a1[1]);
        } else {
            for _ in 0..2 {
                let [t, o] = self.at(q, z);
                let f = q[2] - z + o[0] * t[0] + o[1] * t[1];
                let slope = 1.0 + t[0] * t[0] + t[1] * t[1] - o[0] * a2[0] - o[1] * a2[1];
                z += f / slope.max(0.3);
            }
        }
        let [t, mut o] = self.at(q, z);
        if !straight {
            let lift = 0.5 * raise / (1.0 - o[0] * a2[0] - o[1] * a2[1]).max(0.3);
            o = [o[0] - a2[0] * lift, o[1] - a2[1] * lift];
        }
        // Lengths along the tilt are seen shortened in a plane of constant z.
        let root = (1.0 + t[0] * t[0] + t[1] * t[1]).sqrt();
        let stretch = (o[0] * t[0] + o[1] * t[1]) / (root + 1.0);
        [z, o[0] + t[0] * stretch, o[1] + t[1] * stretch]
    }

    /// The section of a single point.
    pub(super) fn section_of(&self, q: DVec3) -> [f64; 3] {
        self.section(self.is_straight(), q.as_vec3().to_array(), 0.0).map(f64::from)
    }
}

/// What the voxels of a batch see of one ray.
pub(super) struct Ray {
    /// Its direction in the voxel's section.
    pub u: [Row; 2],
    /// Place along it, and to its left.
    pub c: Row,
    pub d: Row,
    /// The density across at d (less what curvature moves the sheet), and the share along, at c.
    across: Row,
    along: Row,
    /// Derivative of what passes the ray when it turns, and when it bends, but for `across`.
    arm: Row,
    bend: Row,
    /// How far curvature moves the sheet.
    moved: Row,
    /// Share between the direction away from the voxel and the ray.
    share: Row,
}

pub(super) const ZERO: Row = [0.0; BATCH];
const EMPTY: Ray = Ray {
    u: [ZERO; 2],
    c: ZERO,
    d: ZERO,
    across: ZERO,
    along: ZERO,
    arm: ZERO,
    bend: ZERO,
    moved: ZERO,
    share: ZERO,
};

impl<const R: usize> Known<R> {
    pub(super) fn new<const N: usize>(origin: DVec3, axes: &DMat3, x: &SVector<f64, N>) -> Self {
        let shrink = (-x[Places::<R>::SIGMA]).exp();
        let theta = |i: usize| x[Places::<R>::THETA + i % R];
        Self {
            origin: origin.as_vec3().to_array(),
            axes: axes.to_cols_array_2d().map(|axis| axis.map(|c| c as f32)),
            curve: Curve::new::<R, N>(x),
            shrink: shrink as f32,
            u: std::array::from_fn(|i| [theta(i).cos() as f32, theta(i).sin() as f32]),
            twist: std::array::from_fn(|i| x[Places::<R>::TWIST + i] as f32),
            k: std::array::from_fn(|i| (x[Places::<R>::K + i] / shrink) as f32),
            mu: std::array::from_fn(|i| x[Places::<R>::MU + i] as f32),
        }
    }

    /// Sections of the voxels: z, and places in units of the wedge's own sigma.
    #[inline(always)]
    fn sections<const STRAIGHT: bool>(&self, batch: &Batch) -> [Row; 3] {
        let (mut zs, mut xs, mut ys) = (ZERO, ZERO, ZERO);
        let sigma2 = 1.0 / (self.shrink * self.shrink);
        let (o, [a, b, c]) = (&self.origin, &self.axes);
        for i in 0..BATCH {
            let p = [batch.at[0][i] - o[0], batch.at[1][i] - o[1], batch.at[2][i] - o[2]];
            let q = [dot(a, &p), dot(b, &p), dot(c, &p)];
            let [z, x, y] = self.curve.section(STRAIGHT, q, sigma2);
            zs[i] = z;
            xs[i] = x * self.shrink;
            ys[i] = y * self.shrink;
        }
        [zs, xs, ys]
    }

    /// Sections, and what is seen of each ray.
    #[inline(always)]
    pub(super) fn see(&self, batch: &Batch) -> (Row, [Ray; R]) {
        let [z, x, y] = if self.curve.is_straight() {
            self.sections::<true>(batch)
        } else {
            self.sections::<false>(batch)
        };
        let mut rays = [EMPTY; R];
        for k in 0..R {
            self.ray(k, &z, &x, &y, &mut rays[k]);
        }
        (z, rays)
    }

    #[inline(always)]
    fn ray(&self, k: usize, z: &Row, x: &Row, y: &Row, ray: &mut Ray) {
        let ([vx, vy], twist, bent) = (self.u[k], self.twist[k], self.k[k]);
        for i in 0..BATCH {
            // Twists are small: sine and cosine to third order.
            let t = twist * z[i];
            let (sin, cos) = (t - t * t * t * (1.0 / 6.0), 1.0 - 0.5 * t * t);
            let (ux, uy) = (vx * cos - vy * sin, vy * cos + vx * sin);
            ray.u[0][i] = ux;
            ray.u[1][i] = uy;
            let (c, d) = (ux * x[i] + uy * y[i], ux * y[i] - uy * x[i]);
            let seen = wedge(c, d);
            let low = density(seen.bells[0]);
            ray.c[i] = c;
            ray.d[i] = d;
            ray.across[i] = density(seen.bells[1]);
            ray.along[i] = seen.along;
            ray.arm[i] = low + c * seen.along;
            ray.bend[i] = 0.5 * ((1.0 + c * c) * seen.along + c * low);
            ray.share[i] = seen.share;
        }
        if bent != 0.0 {
            // The sheet moves by k c^2 / 2: the mean over the Gaussian along it, seen through the part of it that is there.
            for i in 0..BATCH {
                let (d, along) = (ray.d[i], ray.along[i]);
                // Beside the sheet, not on it, the circle that it follows is nearer or farther.
                let bend = ray.bend[i] / (1.0 - bent * d).clamp(0.5, 2.0);
                let there = along > 1e-6;
                let moved = if there { bent * bend / along.max(1e-6) } else { 0.0 };
                let (from, to) = (-d, moved - d);
                let bells = [bell(from), bell(to)];
                let passed = distribution(to, bells[1]) - distribution(from, bells[0]);
                ray.bend[i] = if there { bend } else { ray.bend[i] };
                ray.moved[i] = moved;
                ray.across[i] = density(bells[1]);
                ray.share[i] += along * passed;
            }
        }
    }

    /// The share of each sector in the Gaussian about each voxel.
    #[inline(always)]
    pub(super) fn sectors(&self, rays: &[Ray; R]) -> [Row; R] {
        let mut out = [ZERO; R];
        for k in 0..R {
            let (here, next, out) = (&rays[k], &rays[(k + 1) % R], &mut out[k]);
            for i in 0..BATCH {
                let narrow = (here.d[i] < 0.0) & (next.d[i] >= 0.0);
                let wide = !((next.d[i] < 0.0) & (here.d[i] >= 0.0));
                // Whether the sector is wider than half a turn.
                let turn = here.u[0][i] * next.u[1][i] - here.u[1][i] * next.u[0][i];
                let around = if turn <= 0.0 { wide } else { narrow };
                out[i] = next.share[i] - here.share[i] + if around { 1.0 } else { 0.0 };
            }
        }
        out
    }

    #[inline(always)]
    pub(super) fn values(&self, sectors: &[Row; R]) -> Row {
        let mut out = ZERO;
        for k in 0..R {
            for i in 0..BATCH {
                out[i] += self.mu[k] * sectors[k][i];
            }
        }
        out
    }

    /// Predicted grey value of the first voxel.
    #[cfg(test)]
    pub(super) fn predict(&self, batches: &super::batch::Batches) -> f64 {
        let (_, rays) = self.see(batches.first());
        f64::from(self.values(&self.sectors(&rays))[0])
    }
}

impl<const R: usize> Known<R> {
    /// The rows of the Jacobian, by what voxels see.
    #[inline(always)]
    pub(super) fn rows<const N: usize>(
        &self,
        z: &Row,
        rays: &[Ray; R],
        sectors: &[Row; R],
        weights: &Row,
    ) -> [Row; N] {
        let mut rows = [ZERO; N];
        let (mut nx, mut ny, mut wider) = (ZERO, ZERO, ZERO);
        for k in 0..R {
            let ray = &rays[k];
            let jump = self.mu[(k + R - 1) % R] - self.mu[k];
            for i in 0..BATCH {
                let across = jump * weights[i] * ray.across[i];
                // The line integral along the ray.
                let flux = across * ray.along[i];
                nx[i] -= ray.u[1][i] * flux;
                ny[i] += ray.u[0][i] * flux;
                wider[i] += flux * (ray.d[i] - ray.moved[i]);
                let turned = across * ray.arm[i];
                rows[Places::<R>::THETA + k][i] = turned;
                rows[Places::<R>::TWIST + k][i] = turned * z[i];
                rows[Places::<R>::K + k][i] = across * ray.bend[i] / self.shrink;
                rows[Places::<R>::MU + k][i] = weights[i] * sectors[k][i];
            }
        }
        self.add_moved(z, &[nx, ny], &mut rows);
        rows[Places::<R>::SIGMA] = wider;
        rows
    }

    /// Adds to the rows what the apex's place and course make, by what its move in the section makes.
    #[inline(always)]
    pub(super) fn add_moved<const N: usize>(&self, z: &Row, normals: &[Row; 2], rows: &mut [Row; N]) {
        let sigma2 = 1.0 / (self.shrink * self.shrink);
        for a in 0..2 {
            for i in 0..BATCH {
                let n = normals[a][i] * self.shrink;
                rows[Places::<R>::A0 + a][i] += n;
                rows[Places::<R>::A1 + a][i] += n * z[i];
                rows[Places::<R>::A2 + a][i] += n * (0.5 * (z[i] * z[i] + sigma2));
            }
        }
    }
}

impl<const R: usize, const N: usize> Rows<N> for Known<R> {
    #[inline(always)]
    fn add(&self, batch: &Batch, reading: &Reading, sums: &mut Sums<N>) {
        let (z, rays) = self.see(batch);
        let sectors = self.sectors(&rays);
        let [residuals, weights] = batch.residuals(reading, &self.values(&sectors));
        sums.add(&self.rows::<N>(&z, &rays, &sectors, &weights), &residuals);
    }
}
