//! Where sheets meet in a curve: blurred sectors about a curved axis, fitted to grey values.
//!
//! With three sheets it is a junction curve, with two a sharp edge of one interface. Formulas:
//! `../shared/notes/junctions.md`, "Method", here in blur units (sigma one). Sections across the axis t are polar:
//! sheet i leaves the apex `a(z)` in direction `theta_i`; counter-clockwise of it lies sector i. With
//! `r = q - a(z)`, `c_i = u_i . r`, `d_i = u_i x r` the share of a round Gaussian about r between the direction
//! -r and ray i is `C_i` (a wedge, tabulated), and the grey value is
//! `v = mu_ref + sum_i (mu_{i-1} - mu_i) C_i`, where `ref` is the sector in direction -r. Its derivatives are closed:
//! what passes a ray when it moves is the line integral of the Gaussian along it.
//!
//! Along the curve rays turn (`tau_i` per unit): beside a curved sheet the angle between two sheets changes, and what is
//! alike all along a curve in space is not in blur units of unlike axes.
//!
//! The apex runs along `a0 + a1 z + a2 z^2 / 2`, sheet i curves by `k_i`; blurred, both are raised by half their
//! curvature (as the trace in `sheet.rs`). A factor on sigma is fitted, too, and the grey levels.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec2, DVec3};
use nalgebra::SVector;

use super::batch::{Batches, assemble};
use super::frame::basis;
use super::least_squares::{ENOUGH, ENOUGH_TO_START, Fit, Model, Normal, Problem, minimise};
use super::sheet::{LevelPrior, Reading, Sample};
use super::view::Seen;
use super::wedge_rows::{Curve, Known};
use crate::grid::MaterialId;

/// Places of the parameters of a wedge with `R` rays.
#[derive(Debug, Clone, Copy)]
pub(super) struct Places<const R: usize>;

impl<const R: usize> Places<R> {
    pub(super) const A0: usize = 0;
    pub(super) const A1: usize = 2;
    pub(super) const THETA: usize = 4;
    pub(super) const K: usize = 4 + R;
    pub(super) const A2: usize = 4 + 2 * R;
    pub(super) const MU: usize = 6 + 2 * R;
    pub(super) const SIGMA: usize = 6 + 3 * R;
    pub(super) const TWIST: usize = 7 + 3 * R;
}

/// Parameters of a wedge with three rays, and with two.
pub(super) const JUNCTION: usize = 19;
/// See [`JUNCTION`].
pub(super) const EDGE: usize = 15;

/// A wedge in blur units about its window's middle.
#[derive(Debug, Clone)]
pub struct Wedge<const R: usize, const N: usize> {
    /// Where z is zero.
    pub origin: DVec3,
    /// Columns: two axes of the section, and the direction of the curve.
    pub axes: DMat3,
    /// The parameters.
    pub x: SVector<f64, N>,
}

/// A wedge and how well it fits.
#[derive(Debug, Clone)]
pub struct WedgeFit<const R: usize, const N: usize> {
    /// The wedge.
    pub wedge: Wedge<R, N>,
    /// The fit; its parameters are the wedge's.
    pub fit: Fit<N>,
    /// Samples used.
    pub samples: usize,
}

/// A place on one of the sheets, known from a fit of that interface alone away from the curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flank {
    /// Which sheet.
    pub ray: usize,
    /// The place, blur units from the window's middle.
    pub at: DVec3,
    /// Standard deviation along the sheet's normal, blur units.
    pub sigma: f64,
}

struct Blurred<'a, const R: usize, const N: usize> {
    samples: Batches,
    flanks: &'a [Flank],
    origin: DVec3,
    axes: DMat3,
    reading: Reading,
}

/// Distance from the circle that a sheet of curvature k follows, of a place c along its ray and d to the left.
#[inline]
fn off_sheet(k: f64, c: f64, d: f64) -> f64 {
    d - 0.5 * k * c * c / (1.0 - k * d).clamp(0.5, 2.0)
}

/// By how much sheet `i`, in direction u, moves to its left a distance c along its ray in the section at z, for each
/// parameter; times `scale`.
pub(super) fn sheet_slopes<const R: usize, const N: usize>(
    i: usize,
    u: DVec2,
    c: f64,
    z: f64,
    scale: f64,
) -> [f64; N] {
    let mut row = [0.0; N];
    let n = u.perp() * scale;
    for (p, factor) in [(Places::<R>::A0, 1.0), (Places::<R>::A1, z), (Places::<R>::A2, 0.5 * z * z)] {
        row[p] = n.x * factor;
        row[p + 1] = n.y * factor;
    }
    row[Places::<R>::THETA + i] = c * scale;
    row[Places::<R>::TWIST + i] = c * z * scale;
    row[Places::<R>::K + i] = 0.5 * c * c * scale;
    row
}

impl<const R: usize, const N: usize> Blurred<'_, R, N> {
    /// How far a flank lies from its sheet, in its standard deviations, and the derivatives.
    fn lean(&self, x: &SVector<f64, N>, flank: &Flank) -> (f64, [f64; N]) {
        let q = self.axes.transpose() * (flank.at - self.origin);
        let [z, rx, ry] = Curve::new::<R, N>(x).section_of(q);
        let r = DVec2::new(rx, ry);
        let u = DVec2::from_angle(x[Places::<R>::THETA + flank.ray] + z * x[Places::<R>::TWIST + flank.ray]);
        let (c, d, k) = (u.dot(r).max(0.0), u.perp_dot(r), x[Places::<R>::K + flank.ray]);
        let weight = 1.0 / flank.sigma;
        // Where the sheet moves ahead, the flank falls back.
        let row = sheet_slopes::<R, N>(flank.ray, u, c, z, -weight);
        (off_sheet(k, c, d) * weight, row)
    }
}

impl<const R: usize, const N: usize> Model<N> for Blurred<'_, R, N> {
    fn normal_equations(&self, x: &SVector<f64, N>, equations: &mut Normal<N>) -> f64 {
        let known = Known::<R>::new(self.origin, &self.axes, x);
        let mut chi2 = assemble(&known, &self.samples, &self.reading, equations);
        for flank in self.flanks {
            let (r, row) = self.lean(x, flank);
            chi2 += r * r;
            equations.add(&row, r);
        }
        chi2
    }

    fn is_possible(&self, x: &SVector<f64, N>) -> bool {
        is_in_order::<R, N>(x)
    }
}

/// Whether rays are in order: a sector turned inside out is another arrangement.
pub(super) fn is_in_order<const R: usize, const N: usize>(x: &SVector<f64, N>) -> bool {
    let gap = |i: usize| (x[Places::<R>::THETA + (i + 1) % R] - x[Places::<R>::THETA + i]).rem_euclid(TAU);
    let turn: f64 = (0..R).map(gap).sum();
    (0..R).all(|i| gap(i) >= NARROWEST) && (turn - TAU).abs() < 1e-6
}

/// Sectors narrower than this are not looked for: the sheets beside them merge within the blur.
const NARROWEST: f64 = 0.12;

/// A point as a wedge sees it.
#[derive(Debug, Clone, Copy)]
pub struct Section {
    /// The point from the curve, in the plane normal to it.
    pub r: DVec2,
    /// Where on the curve that is.
    pub z: f64,
}

/// How far a fit goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Place, direction and rays.
    Rough,
    /// Grey levels and sigma, too.
    Planar,
    /// Curvatures, too.
    Curved,
}

/// What is known before a fit.
#[derive(Debug, Clone, Copy)]
pub struct Prior<const R: usize> {
    /// Grey level of each sector.
    pub levels: [LevelPrior; R],
    /// What a grey value is worth.
    pub reading: Reading,
    /// Standard deviation of the logarithm of the blur's sigma against the estimate for the volume.
    pub log_sigma: f64,
    /// Standard deviation of curvatures, per blur unit.
    pub curvature: f64,
    /// Curvature of each sheet across the curve and its standard deviation, where patches know it.
    pub bends: [Option<(f64, f64)>; R],
}

impl<const R: usize, const N: usize> Wedge<R, N> {
    /// A planar wedge: through `origin` along `direction`, sheets towards `rays` (ordered counter-clockwise seen
    /// against the direction).
    #[must_use]
    pub fn new(origin: DVec3, direction: DVec3, rays: [DVec3; R], levels: [f64; R]) -> Self {
        let axes = DMat3::from_cols_array_2d(&basis(direction).map(|a| a.to_array()));
        let mut x = SVector::<f64, N>::zeros();
        for (i, ray) in rays.iter().enumerate() {
            x[Places::<R>::THETA + i] = f64::atan2(ray.dot(axes.y_axis), ray.dot(axes.x_axis));
            x[Places::<R>::MU + i] = levels[i];
        }
        Self { origin, axes, x }
    }

    /// Fits to samples from here.
    #[must_use]
    pub fn fit(
        &self,
        samples: &[Sample],
        flanks: &[Flank],
        prior: &Prior<R>,
        stage: Stage,
    ) -> Option<WedgeFit<R, N>> {
        let model = Blurred::<R, N> {
            samples: Batches::new(samples),
            flanks,
            origin: self.origin,
            axes: self.axes,
            reading: prior.reading,
        };
        let problem = Self::problem(prior, stage);
        let fit = minimise(&model, &problem, self.x)?;
        let wedge = Self { x: fit.x, ..self.clone() };
        Some(WedgeFit { wedge, fit, samples: samples.len() + flanks.len() })
    }

    /// What moves in a stage, by how much, and what is known of it before; nothing of parameters beyond a wedge's.
    pub(super) fn problem(prior: &Prior<R>, stage: Stage) -> Problem<N> {
        let mut problem = Problem {
            active: [false; N],
            prior: [(0.0, f64::INFINITY); N],
            most: [0.8; N],
            iterations: if stage == Stage::Rough { 12 } else { 10 },
            enough: if stage == Stage::Curved { ENOUGH } else { ENOUGH_TO_START },
        };
        for i in 0..4 + R {
            problem.active[i] = true;
        }
        for i in 0..2 {
            problem.most[Places::<R>::A1 + i] = 0.4;
            problem.prior[Places::<R>::A2 + i] = (0.0, prior.curvature);
            problem.active[Places::<R>::A2 + i] = stage == Stage::Curved;
        }
        for i in 0..R {
            problem.most[Places::<R>::THETA + i] = 0.4;
            problem.prior[Places::<R>::K + i] = prior.bends[i].unwrap_or((0.0, prior.curvature));
            problem.active[Places::<R>::K + i] = stage == Stage::Curved;
            problem.most[Places::<R>::TWIST + i] = 0.1;
            problem.prior[Places::<R>::TWIST + i] = (0.0, prior.curvature);
            problem.active[Places::<R>::TWIST + i] = stage == Stage::Curved;
            problem.active[Places::<R>::MU + i] = true;
            problem.most[Places::<R>::MU + i] = f64::INFINITY;
            problem.prior[Places::<R>::MU + i] = (prior.levels[i].mean, prior.levels[i].sigma);
        }
        problem.active[Places::<R>::SIGMA] = stage != Stage::Rough && prior.log_sigma > 0.0;
        problem.prior[Places::<R>::SIGMA] = (0.0, prior.log_sigma.max(1e-6));
        problem.most[Places::<R>::SIGMA] = 0.1;
        problem
    }

    fn vec(&self, i: usize) -> DVec2 {
        DVec2::new(self.x[i], self.x[i + 1])
    }

    /// The apex in the section at z, without blur.
    #[must_use]
    pub fn apex(&self, z: f64) -> DVec2 {
        self.vec(Places::<R>::A0) + self.vec(Places::<R>::A1) * z + self.vec(Places::<R>::A2) * (0.5 * z * z)
    }

    /// The point of the curve at z.
    #[must_use]
    pub fn point(&self, z: f64) -> DVec3 {
        let a = self.apex(z);
        self.origin + self.axes * DVec3::new(a.x, a.y, z)
    }

    /// Direction of the curve at z.
    #[must_use]
    pub fn direction(&self, z: f64) -> DVec3 {
        let a = self.vec(Places::<R>::A1) + self.vec(Places::<R>::A2) * z;
        (self.axes * DVec3::new(a.x, a.y, 1.0)).normalize()
    }

    /// Direction of ray `i` in the section at z.
    pub(super) fn ray(&self, i: usize, z: f64) -> DVec2 {
        DVec2::from_angle(self.x[Places::<R>::THETA + i] + z * self.x[Places::<R>::TWIST + i])
    }

    /// Directions of the rays in space at z.
    #[must_use]
    pub fn rays(&self, z: f64) -> [DVec3; R] {
        std::array::from_fn(|i| {
            let u = self.ray(i, z);
            self.axes * DVec3::new(u.x, u.y, 0.0)
        })
    }

    /// Angle of each sector, that between its ray and the next.
    #[must_use]
    pub fn angles(&self) -> [f64; R] {
        std::array::from_fn(|i| {
            let theta = |i: usize| self.x[Places::<R>::THETA + i % R];
            (theta(i + 1) - theta(i)).rem_euclid(TAU)
        })
    }

    /// The narrowest sector, and its angle.
    #[must_use]
    pub(super) fn narrowest(&self) -> (usize, f64) {
        let angles = self.angles();
        let i = (1..R).fold(0, |least, i| if angles[i] < angles[least] { i } else { least });
        (i, angles[i])
    }

    /// How far from the curve its narrowest sector is narrower than what labels and single sheets need, blur units; no farther than
    /// a fit sees.
    #[must_use]
    pub fn blind(&self) -> f64 {
        (0.5 * WIDTH / (0.5 * self.narrowest().1).tan()).min(MOST_BLIND)
    }

    /// Whether a place lies in the narrowest sector or within `beside` of it, blur units.
    #[must_use]
    pub fn is_narrow_at(&self, at: DVec3, beside: f64) -> bool {
        self.is_narrow_of(self.section(at), beside)
    }

    /// The same of a point in this section.
    pub(super) fn is_narrow_of(&self, at: Section, beside: f64) -> bool {
        let (i, _) = self.narrowest();
        let ((after, c, _), (before, d, _)) = (self.sheet_of(i, at), self.sheet_of((i + 1) % R, at));
        c.max(d) > 0.0 && after > -beside && before < beside
    }

    /// Grey levels of the sectors.
    #[must_use]
    pub fn levels(&self) -> [f64; R] {
        std::array::from_fn(|i| self.x[Places::<R>::MU + i])
    }

    /// Curvatures of the sheets.
    #[must_use]
    pub fn curvatures(&self) -> [f64; R] {
        std::array::from_fn(|i| self.x[Places::<R>::K + i])
    }

    /// The curvature of the curve, per blur unit.
    #[must_use]
    pub fn bend(&self) -> f64 {
        self.vec(Places::<R>::A2).length()
    }

    /// The factor on sigma.
    #[must_use]
    pub fn sigma(&self) -> f64 {
        self.x[Places::<R>::SIGMA].exp()
    }

    /// The same wedge with its frame moved to the curve at z and turned along it; first order in curvature.
    #[must_use]
    pub fn recentred(&self, z: f64) -> Self {
        let (origin, direction) = (self.point(z), self.direction(z));
        let mut out = Self::new(origin, direction, self.rays(z), self.levels());
        for i in 0..R {
            out.x[Places::<R>::K + i] = self.x[Places::<R>::K + i];
            out.x[Places::<R>::TWIST + i] = self.x[Places::<R>::TWIST + i];
        }
        let bend = self.vec(Places::<R>::A2);
        let bend = out.axes.transpose() * (self.axes * DVec3::new(bend.x, bend.y, 0.0));
        out.x[Places::<R>::A2] = bend.x;
        out.x[Places::<R>::A2 + 1] = bend.y;
        out.x[Places::<R>::SIGMA] = self.x[Places::<R>::SIGMA];
        out
    }

    /// The section that a point lies in.
    #[must_use]
    pub fn section(&self, at: DVec3) -> Section {
        let q = self.axes.transpose() * (at - self.origin);
        let [z, x, y] = Curve::new::<R, N>(&self.x).section_of(q);
        Section { r: DVec2::new(x, y), z }
    }

    /// The sector in which a point lies.
    #[must_use]
    pub fn sector(&self, at: DVec3) -> usize {
        self.sector_of(self.section(at))
    }

    pub(super) fn sector_of(&self, Section { r, z }: Section) -> usize {
        let (rho, angle) = (r.length(), r.to_angle());
        // Distance counter-clockwise from each ray, turned by its curvature over this distance.
        let past = |i: usize| {
            let turned = (0.5 * self.x[Places::<R>::K + i] * rho).clamp(-0.7, 0.7);
            let theta = self.x[Places::<R>::THETA + i] + z * self.x[Places::<R>::TWIST + i];
            let turns = (angle - theta - turned) / TAU;
            turns - turns.floor()
        };
        let all: [f64; R] = std::array::from_fn(past);
        (1..R).fold(0, |m, i| if all[i] < all[m] { i } else { m })
    }

    /// Whether a label at a place is another than the wedge says (`materials` of its sectors), though none of its sheets is near:
    /// another sheet is.
    #[must_use]
    pub(super) fn is_contradicted(
        &self,
        materials: &[MaterialId; R],
        label: MaterialId,
        at: Section,
    ) -> bool {
        materials[self.sector_of(at)] != label
            && (!materials.contains(&label)
                || (0..R).all(|i| {
                    let (distance, along, _) = self.sheet_of(i, at);
                    distance.hypot(along.min(0.0)) > WRONG
                }))
    }

    /// Those of some voxels, seen, as samples in the wedge's space and with their sections, that are of other sheets: where they
    /// are, and how far their blur reaches.
    pub(super) fn others<'a>(
        &self,
        materials: &[MaterialId; R],
        voxels: impl Iterator<Item = ((&'a Seen, &'a Sample), &'a Section)>,
    ) -> Vec<(DVec3, f64)> {
        voxels
            .filter(|((seen, _), section)| self.is_contradicted(materials, seen.label, **section))
            .map(|((seen, sample), _)| (sample.at, BLURRED[usize::from(!materials.contains(&seen.label))]))
            .collect()
    }

    /// Signed distance of a point from sheet `i` (positive counter-clockwise of it, as if it went on behind
    /// the apex), its place along the ray, and the sheet's unit normal there (towards sector i).
    #[must_use]
    pub fn sheet(&self, i: usize, at: DVec3) -> (f64, f64, DVec3) {
        self.sheet_of(i, self.section(at))
    }

    /// The same of a point in this section.
    pub(super) fn sheet_of(&self, i: usize, Section { r, z }: Section) -> (f64, f64, DVec3) {
        let u = self.ray(i, z);
        let k = self.x[Places::<R>::K + i];
        let (c, d) = (u.dot(r), u.perp_dot(r));
        let ahead = c.max(0.0);
        let off = off_sheet(k, ahead, d);
        let n = u.perp() - u * (k * ahead);
        (off, c, self.in_space(n, z))
    }

    /// A direction in the section at z, as a unit vector in space.
    pub(super) fn in_space(&self, n: DVec2, z: f64) -> DVec3 {
        let along = self.vec(Places::<R>::A1) + self.vec(Places::<R>::A2) * z;
        // From the plane normal to the curve to space: turned about what is normal to both axis and curve.
        let tilt = along.length();
        let normal = if tilt > 1e-9 {
            let towards = along / tilt;
            let cos = 1.0 / (1.0 + tilt * tilt).sqrt();
            let part = n.dot(towards);
            let flat = n + towards * (part * (cos - 1.0));
            DVec3::new(flat.x, flat.y, -part * tilt * cos)
        } else {
            DVec3::new(n.x, n.y, 0.0)
        };
        self.axes * normal / n.length()
    }
}

impl<const R: usize, const N: usize> WedgeFit<R, N> {
    /// Standard deviation of the position of sheet `i` along its normal near a point, for white noise.
    #[must_use]
    pub fn sheet_sigma(&self, i: usize, at: DVec3) -> f64 {
        let Section { r, z } = self.wedge.section(at);
        let u = self.wedge.ray(i, z);
        let c = u.dot(r).max(0.0);
        self.sigma_of(sheet_slopes::<R, N>(i, u, c, z, 1.0))
    }

    /// Standard deviation of what changes so much with each parameter.
    pub(super) fn sigma_of(&self, slopes: [f64; N]) -> f64 {
        let g = SVector::from(slopes);
        (g.transpose() * self.fit.covariance * g)[(0, 0)].max(0.0).sqrt()
    }

    /// Standard deviations of the apex at z along its best and worst direction.
    #[must_use]
    pub fn apex_sigma(&self, z: f64) -> [f64; 2] {
        let c = &self.fit.covariance;
        let h = [1.0, z, 0.5 * z * z];
        let p = [Places::<R>::A0, Places::<R>::A1, Places::<R>::A2];
        let of = |a: usize, b: usize| -> f64 {
            (0..3)
                .flat_map(|i| (0..3).map(move |j| (i, j)))
                .map(|(i, j)| h[i] * h[j] * c[(p[i] + a, p[j] + b)])
                .sum()
        };
        let (xx, xy, yy) = (of(0, 0), of(0, 1), of(1, 1));
        let (mean, root) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        [(mean - root).max(0.0).sqrt(), (mean + root).max(0.0).sqrt()]
    }

    /// Misfit per sample.
    #[must_use]
    pub fn reduced(&self) -> f64 {
        self.fit.chi2 / self.samples.max(1) as f64
    }

    /// Whether the wedge explains its grey values: as well as noise allows, or but for a small share of the contrast.
    #[must_use]
    pub fn explains(&self, reading: &Reading, contrast: f64) -> bool {
        is_explained(self.reduced(), self.samples, reading, contrast)
    }

    /// A curved fit from this planar one, whether or not it explains more: priors hold curvatures that the grey values do not
    /// show. A planar fit that is kept where curvature is not significant states standard deviations that leave out what it
    /// is off by for that: they covered 42 % of true errors instead of 68 %.
    #[must_use]
    pub fn curved(self, samples: &[Sample], flanks: &[Flank], prior: &Prior<R>) -> Self {
        self.wedge.fit(samples, flanks, prior, Stage::Curved).unwrap_or(self)
    }

    /// This planar fit, or a curved one from it if that explains the same data enough better.
    #[must_use]
    pub fn or_curved(self, samples: &[Sample], flanks: &[Flank], prior: &Prior<R>) -> Self {
        let total = |fit: &Self| fit.fit.chi2 + fit.fit.strain;
        match self.wedge.fit(samples, flanks, prior, Stage::Curved) {
            Some(curved) if total(&curved) + GAIN < total(&self) => curved,
            _ => self,
        }
    }
}

/// Whether a misfit per sample is what noise allows, at the scan's worse interfaces too, or a small share of the contrast.
pub(super) fn is_explained(reduced: f64, samples: usize, reading: &Reading, contrast: f64) -> bool {
    reduced < most_reduced(samples, reading, contrast)
}

/// The misfit per sample that noise may leave, with this slack for the scan's worse interfaces.
pub(super) fn by_noise(samples: usize, slack: f64) -> f64 {
    slack * (1.0 + 7.0 * (2.0 / samples as f64).sqrt())
}

/// The misfit per sample that may be left.
pub(super) fn most_reduced(samples: usize, reading: &Reading, contrast: f64) -> f64 {
    by_noise(samples, reading.slack).max((RESIDUAL * contrast / reading.noise).powi(2))
}

/// Residuals up to this share of the contrast are the model's: with little noise they would be seen.
pub(super) const RESIDUAL: f64 = 0.008;
/// What the curved model must gain in chi squared.
const GAIN: f64 = 12.0;

/// Labels need a ball of some 2.5 sigma of one material, sheets are seen alone from each other from there on, blur units.
const WIDTH: f64 = 4.2;
/// See [`Wedge::blind`].
const MOST_BLIND: f64 = 8.0;

/// A voxel this far (blur units) on the wrong side contradicts a wedge: another sheet is there, whose blur reaches so far,
/// and farther if it is of a material that the wedge has not, whose contrast may be larger.
pub(super) const WRONG: f64 = 1.3;
pub(super) const BLURRED: [f64; 2] = [2.4, 3.0];

/// The smallest angle of a sector that a wedge may have.
pub(super) const SMALLEST_ANGLE: f64 = PI / 15.0;

#[cfg(test)]
#[path = "wedge_tests.rs"]
mod tests;
