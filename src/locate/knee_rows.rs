//! What voxels see of a knee: predicted grey values and their derivatives, for a batch at a time.
//!
//! As `wedge_rows.rs`, and what the bent sheet adds (`knee.rs`): the sector between the two rays that leave the bend, one where the
//! sheet would have gone on, one where it goes.

use glam::DMat3;
use glam::DVec3;
use nalgebra::SVector;

use super::batch::{BATCH, Batch, Row, Rows, Sums};
use super::knee::{KNEED, LENGTH, SLOPE, TURN};
use super::normal::{Wedge, density, wedge};
use super::sheet::Reading;
use super::wedge::Places;
use super::wedge_rows::{Known, Ray, ZERO};

/// Parameters of a knee, as every voxel needs them.
pub(super) struct KnownKnee {
    known: Known<3>,
    ray: usize,
    /// Length up to the bend and its slope, in units of the knee's own sigma.
    length: [f32; 2],
    /// Cosine and sine of the turn.
    turn: [f32; 2],
}

/// What the voxels of a batch see of the bend.
struct Bend {
    /// Length up to it.
    length: Row,
    /// What leaves the sector behind the sheet for that before it; negative the other way.
    share: Row,
    /// The line integrals along both rays, and what passes them when they turn.
    flux: [Row; 2],
    arm: [Row; 2],
    /// Distances to the left of them.
    d: [Row; 2],
}

impl KnownKnee {
    pub(super) fn new(origin: DVec3, axes: &DMat3, x: &SVector<f64, KNEED>, ray: usize) -> Self {
        let known = Known::new(origin, axes, x);
        let length = [x[LENGTH], x[SLOPE]].map(|l| l as f32 * known.shrink);
        Self { known, ray, length, turn: [x[TURN].cos() as f32, x[TURN].sin() as f32] }
    }

    fn before(&self) -> usize {
        (self.ray + 2) % 3
    }

    /// Difference of the grey levels beside the bent sheet.
    fn jump(&self) -> f32 {
        self.known.mu[self.before()] - self.known.mu[self.ray]
    }

    #[inline(always)]
    fn bend(&self, z: &Row, ray: &Ray) -> Bend {
        let mut out = Bend { length: ZERO, share: ZERO, flux: [ZERO; 2], arm: [ZERO; 2], d: [ZERO; 2] };
        let [cos, sin] = self.turn;
        for (i, z) in z.iter().enumerate() {
            let length = self.length[0] + self.length[1] * z;
            let (c, d) = (ray.c[i] - length, ray.d[i]);
            let on = [c, cos * c + sin * d];
            let off = [d, cos * d - sin * c];
            let seen: [Wedge; 2] = [wedge(on[0], off[0]), wedge(on[1], off[1])];
            let (left, right) = ((off[0] < 0.0) & (off[1] >= 0.0), (off[1] < 0.0) & (off[0] >= 0.0));
            let around = if sin >= 0.0 {
                if left { 1.0 } else { 0.0 }
            } else if right {
                -1.0
            } else {
                0.0
            };
            out.length[i] = length;
            out.share[i] = seen[1].share - seen[0].share + around;
            for k in 0..2 {
                let (low, across) = (density(seen[k].bells[0]), density(seen[k].bells[1]));
                out.flux[k][i] = across * seen[k].along;
                out.arm[k][i] = across * (low + on[k] * seen[k].along);
                out.d[k][i] = off[k];
            }
        }
        out
    }

    /// Adds what the bend makes to predicted grey values.
    #[inline(always)]
    fn add_to(&self, bend: &Bend, values: &mut Row) {
        for (value, share) in values.iter_mut().zip(&bend.share) {
            *value += self.jump() * share;
        }
    }

    /// Predicted grey value of the first voxel.
    #[cfg(test)]
    pub(super) fn predict(&self, batches: &super::batch::Batches) -> f64 {
        let (z, rays) = self.known.see(batches.first());
        let mut values = self.known.values(&self.known.sectors(&rays));
        self.add_to(&self.bend(&z, &rays[self.ray]), &mut values);
        f64::from(values[0])
    }
}

impl Rows<KNEED> for KnownKnee {
    #[inline(always)]
    fn add(&self, batch: &Batch, reading: &Reading, sums: &mut Sums<KNEED>) {
        let known = &self.known;
        let (z, rays) = known.see(batch);
        let sectors = known.sectors(&rays);
        let ray = &rays[self.ray];
        let bend = self.bend(&z, ray);
        let mut values = known.values(&sectors);
        self.add_to(&bend, &mut values);
        let [residuals, weights] = batch.residuals(reading, &values);
        let mut rows = known.rows::<KNEED>(&z, &rays, &sectors, &weights);
        let ([cos, sin], jump) = (self.turn, self.jump());
        let mut normals = [ZERO; 2];
        for i in 0..BATCH {
            let weight = jump * weights[i];
            let (u, [on, off]) = ([ray.u[0][i], ray.u[1][i]], bend.flux.map(|flux| weight * flux[i]));
            let turned = [u[0] * cos - u[1] * sin, u[1] * cos + u[0] * sin];
            normals[0][i] = u[1] * on - turned[1] * off;
            normals[1][i] = turned[0] * off - u[0] * on;
            let arms = bend.arm.map(|arm| weight * arm[i]);
            // The bend moves sideways when its ray turns.
            let swung = bend.length[i] * (cos * off - on) + arms[1] - arms[0];
            rows[Places::<3>::THETA + self.ray][i] += swung;
            rows[Places::<3>::TWIST + self.ray][i] += swung * z[i];
            let longer = -sin * off * known.shrink;
            rows[LENGTH][i] = longer;
            rows[SLOPE][i] = longer * z[i];
            rows[TURN][i] = arms[1];
            rows[Places::<3>::SIGMA][i] += off * bend.d[1][i] - on * bend.d[0][i];
            rows[Places::<3>::MU + self.before()][i] += weights[i] * bend.share[i];
            rows[Places::<3>::MU + self.ray][i] -= weights[i] * bend.share[i];
        }
        known.add_moved(&z, &normals, &mut rows);
        sums.add(&rows, &residuals);
    }
}
