//! A junction beside a sharp edge: a wedge one of whose sheets bends a few units from the curve.
//!
//! A head sunk a few voxels into a plate, a collar, a step under a lid: within the blur of where three materials meet the interface
//! of two of them turns. No single wedge explains the grey values there, and windows that are small enough to leave the bend out see
//! too little. The model is the wedge (`wedge.rs`), whose sheet `i` leaves at a length l(z) = l + l' z and goes on in a direction turned by psi
//! (counter-clockwise positive). What the wedge has wrong is the sector between the sheet as it would go on and as it does, whose apex
//! is the bend b = a + l u_i:
//!
//! ```text
//! v = v_wedge + (mu_{i-1} - mu_i) (C(b; theta_i + psi) - C(b; theta_i))
//! ```
//!
//! with C, the share between the direction away and a ray, as for the wedge; so derivatives are line integrals along the two rays that
//! leave the bend. The sheet is plane; the wedge's others may curve. Three parameters more: length, its slope, turn.
//!
//! Not told: what bends twice (a groove), two sheets that bend, and another junction nearby.

use std::f64::consts::PI;

use glam::{DMat3, DVec2, DVec3};
use nalgebra::SVector;

use super::batch::{Batches, assemble};
use super::knee_rows::KnownKnee;
use super::least_squares::{Fit, Model, Normal, minimise, promise};
use super::passage::Passage;
use super::sheet::{Reading, Sample};
use super::sites::CurveKind;
use super::wedge::{
    JUNCTION, Places, Prior, Section, Stage, WRONG, Wedge, WedgeFit, is_in_order, sheet_slopes,
};
use crate::grid::MaterialId;

/// Parameters of a knee: those of a wedge, and the length up to the bend, its slope along the curve, and the turn.
pub(super) const KNEED: usize = JUNCTION + 3;
pub(super) const LENGTH: usize = JUNCTION;
pub(super) const SLOPE: usize = JUNCTION + 1;
pub(super) const TURN: usize = JUNCTION + 2;

/// Standard deviation of the slope of the length: curves that part or meet faster have a corner here.
const SLOPES: f64 = 0.3;
/// Bends nearer than the first or farther than the second are not looked for, blur units.
const LENGTHS: [f64; 2] = [0.6, 5.5];
/// Turns by less than the first or more than the second neither, radians.
const TURNS: [f64; 2] = [0.35, 2.8];
/// The bent sheet may run towards the next by no more than this, radians.
const TOWARDS: f64 = 0.3;

/// See the module's header; in blur units about its window's middle.
#[derive(Debug, Clone)]
pub struct Knee {
    /// The wedge, with the bend's parameters after its own.
    pub wedge: Wedge<3, KNEED>,
    /// The sheet that bends.
    pub ray: usize,
}

/// A knee and how well it fits.
#[derive(Debug, Clone)]
pub struct KneeFit {
    /// The knee.
    pub knee: Knee,
    /// As a wedge's, with all parameters.
    pub fit: WedgeFit<3, KNEED>,
}

struct Blurred<'a> {
    samples: &'a Batches,
    origin: DVec3,
    axes: DMat3,
    reading: Reading,
    ray: usize,
}

impl Model<KNEED> for Blurred<'_> {
    fn normal_equations(&self, x: &SVector<f64, KNEED>, equations: &mut Normal<KNEED>) -> f64 {
        let known = KnownKnee::new(self.origin, &self.axes, x, self.ray);
        assemble(&known, self.samples, &self.reading, equations)
    }

    fn is_possible(&self, x: &SVector<f64, KNEED>) -> bool {
        let theta = |i: usize| x[Places::<3>::THETA + i % 3];
        let gap = |i: usize| (theta(i + 1) - theta(i)).rem_euclid(2.0 * PI);
        let turn = x[TURN];
        let room = if turn > 0.0 { gap(self.ray) } else { gap((self.ray + 2) % 3) };
        is_in_order::<3, KNEED>(x)
            && (LENGTHS[0]..=LENGTHS[1]).contains(&x[LENGTH])
            && (TURNS[0]..=TURNS[1]).contains(&turn.abs())
            && turn.abs() < room + TOWARDS
    }
}

/// One of the sheets seen from a place.
#[derive(Debug, Clone, Copy)]
struct Sheet {
    /// Which ray it belongs to, and whether it is the part beyond the bend.
    ray: usize,
    beyond: bool,
    /// Signed distance, and the distance of the nearest point that it has.
    off: f64,
    away: f64,
    /// Its unit normal in space.
    normal: DVec3,
    /// Place along it, from the apex or the bend.
    along: f64,
}

impl Knee {
    /// A wedge with a sheet that bends.
    #[must_use]
    pub(super) fn new(wedge: &Wedge<3, JUNCTION>, ray: usize, length: f64, turn: f64) -> Self {
        let mut wedge = Self::with_bend(wedge, length, turn);
        wedge.x[Places::<3>::K + ray] = 0.0;
        Self { wedge, ray }
    }

    /// A wedge with the parameters of a bend, its sheets still as curved as they were.
    fn with_bend(wedge: &Wedge<3, JUNCTION>, length: f64, turn: f64) -> Wedge<3, KNEED> {
        let mut x = SVector::<f64, KNEED>::zeros();
        x.fixed_rows_mut::<JUNCTION>(0).copy_from(&wedge.x);
        (x[LENGTH], x[TURN]) = (length, turn);
        Wedge { origin: wedge.origin, axes: wedge.axes, x }
    }

    /// The wedge without the bend.
    #[must_use]
    pub(super) fn straight(&self) -> Wedge<3, JUNCTION> {
        let x = self.wedge.x.fixed_rows::<JUNCTION>(0).into_owned();
        Wedge { origin: self.wedge.origin, axes: self.wedge.axes, x }
    }

    /// The same knee with its frame moved to the curve, as [`Wedge::recentred`].
    #[must_use]
    pub(super) fn recentred(&self) -> Self {
        let mut wedge = self.wedge.recentred(0.0);
        for p in [LENGTH, SLOPE, TURN] {
            wedge.x[p] = self.wedge.x[p];
        }
        Self { wedge, ray: self.ray }
    }

    /// The misfit from here, without a step.
    #[must_use]
    pub(super) fn misfit(&self, samples: &Batches, reading: &Reading) -> f64 {
        let mut equations = Normal::new(&[false; KNEED]);
        let known = KnownKnee::new(self.wedge.origin, &self.wedge.axes, &self.wedge.x, self.ray);
        assemble(&known, samples, reading, &mut equations)
    }

    /// The same scene as a junction at the bend with the bend at the apex, if `narrow` is a sector beside the bent sheet: so narrow a one that it
    /// is none.
    #[must_use]
    pub(super) fn turned_over(&self, narrow: usize) -> Option<Self> {
        let (i, m) = match self.ray {
            ray if ray == narrow => (ray, (narrow + 1) % 3),
            ray if ray == (narrow + 1) % 3 => (ray, narrow),
            _ => return None,
        };
        let k = 3 - i - m;
        let theta = |j: usize| Places::<3>::THETA + j;
        let mut x = self.wedge.x;
        let u = self.wedge.ray(i, 0.0) * self.length(0.0);
        x[Places::<3>::A0] += u.x;
        x[Places::<3>::A0 + 1] += u.y;
        let back = self.wedge.x[theta(i)] + PI;
        x[theta(i)] += self.turn();
        x[theta(k)] = back;
        x[TURN] = (self.wedge.x[theta(k)] - back + PI).rem_euclid(2.0 * PI) - PI;
        for j in 0..3 {
            (x[Places::<3>::K + j], x[Places::<3>::TWIST + j]) = (0.0, 0.0);
        }
        // The curve runs where the bend did.
        for a in 0..2 {
            x[Places::<3>::A1 + a] += self.wedge.ray(i, 0.0)[a] * self.wedge.x[SLOPE];
        }
        Some(Self { wedge: Wedge { x, ..self.wedge.clone() }, ray: k })
    }

    /// By how much a bend of a wedge's sheet `ray` at a length promises to lower its misfit, beside what the wedge itself can do.
    #[must_use]
    pub(super) fn promise(
        wedge: &Wedge<3, JUNCTION>,
        (ray, length): (usize, f64),
        samples: &Batches,
        prior: &Prior<3>,
    ) -> f64 {
        let Wedge { origin, axes, x } = Self::with_bend(wedge, length, 0.0);
        let problem = Wedge::<3, KNEED>::problem(prior, Stage::Curved);
        let model = Blurred { samples, origin, axes, reading: prior.reading, ray };
        promise(&model, &problem, &x, TURN)
    }

    /// Fits to samples from here.
    #[must_use]
    pub(super) fn fit(&self, samples: &[Sample], prior: &Prior<3>, stage: Stage) -> Option<KneeFit> {
        let Self { wedge, ray } = self;
        let mut problem = Wedge::<3, KNEED>::problem(prior, stage);
        for p in [LENGTH, SLOPE, TURN] {
            problem.active[p] = true;
            problem.most[p] = 0.4;
        }
        problem.prior[SLOPE] = (0.0, SLOPES);
        problem.active[Places::<3>::K + ray] = false;
        let batches = Batches::new(samples);
        let model = Blurred {
            samples: &batches,
            origin: wedge.origin,
            axes: wedge.axes,
            reading: prior.reading,
            ray: *ray,
        };
        let fit: Fit<KNEED> = minimise(&model, &problem, wedge.x)?;
        let wedge = Wedge { x: fit.x, ..wedge.clone() };
        let knee = Self { wedge: wedge.clone(), ray: *ray };
        Some(KneeFit { knee, fit: WedgeFit { wedge, fit, samples: samples.len() } })
    }

    /// Length up to the bend in the section at z.
    #[must_use]
    pub(super) fn length(&self, z: f64) -> f64 {
        (self.wedge.x[LENGTH] + self.wedge.x[SLOPE] * z).max(0.0)
    }

    /// A point seen from the bend: in the section at z, along the sheet before and to its left.
    fn seen_at_bend(&self, Section { r, z }: Section) -> DVec2 {
        let u = self.wedge.ray(self.ray, z);
        DVec2::new(u.dot(r) - self.length(z), u.perp_dot(r))
    }

    fn turn(&self) -> f64 {
        self.wedge.x[TURN]
    }

    /// The sector in which a point lies.
    #[must_use]
    pub(super) fn sector(&self, at: DVec3) -> usize {
        self.sector_of(self.wedge.section(at))
    }

    fn sector_of(&self, section: Section) -> usize {
        let from = self.seen_at_bend(section);
        let turned = DVec2::from_angle(self.turn());
        // Between the sheet as it would go on and as it does.
        let is_left = from.y >= 0.0;
        let is_past = turned.perp_dot(from) >= 0.0;
        let (own, before) = (self.ray, (self.ray + 2) % 3);
        let straight = self.wedge.sector_of(section);
        match straight {
            _ if self.turn() > 0.0 && is_left && !is_past && straight == own => before,
            _ if self.turn() < 0.0 && !is_left && is_past && straight == before => own,
            _ => straight,
        }
    }

    /// Distances from the junction curve and from the bend, blur units, and place along the curve.
    #[must_use]
    pub(super) fn around(&self, at: DVec3) -> ([f64; 2], f64) {
        let section = self.wedge.section(at);
        ([section.r.length(), self.seen_at_bend(section).length()], section.z)
    }

    /// The point of a curve of a kind at z.
    #[must_use]
    pub(super) fn point(&self, kind: CurveKind, z: f64) -> DVec3 {
        let apex = self.wedge.point(z);
        match kind {
            CurveKind::Junction => apex,
            CurveKind::Edge => {
                let u = self.wedge.ray(self.ray, z) * self.length(z);
                apex + self.wedge.axes * DVec3::new(u.x, u.y, 0.0)
            }
        }
    }

    /// The direction of a curve of a kind at z.
    #[must_use]
    pub(super) fn direction(&self, kind: CurveKind, z: f64) -> DVec3 {
        let step = 0.5;
        (self.point(kind, z + step) - self.point(kind, z - step)).normalize_or_zero()
    }

    /// All its sheets, seen from a place.
    fn sheets(&self, section: Section) -> [Sheet; 4] {
        let wedge = &self.wedge;
        let end = self.length(section.z);
        std::array::from_fn(|k| {
            if k < 3 {
                let (off, along, normal) = wedge.sheet_of(k, section);
                let end = if k == self.ray { end } else { f64::INFINITY };
                let beside = (along - along.clamp(0.0, end)).abs();
                return Sheet { ray: k, beyond: false, off, away: off.hypot(beside), normal, along };
            }
            let from = self.seen_at_bend(section);
            let turned = DVec2::from_angle(self.turn());
            let (along, off) = (turned.dot(from), turned.perp_dot(from));
            let u = wedge.ray(self.ray, section.z);
            let normal = wedge.in_space(turned.rotate(u).perp(), section.z);
            Sheet { ray: self.ray, beyond: true, off, away: off.hypot(along.min(0.0)), normal, along }
        })
    }

    /// The sheet between two materials that is nearest to a place, and whether it goes from the first to the second.
    fn nearest_sheet(
        &self,
        materials: &[MaterialId; 3],
        [a, b]: [MaterialId; 2],
        section: Section,
    ) -> Option<(Sheet, bool)> {
        let own = self.sheets(section).into_iter().filter_map(|sheet| {
            let (before, after) = (materials[(sheet.ray + 2) % 3], materials[sheet.ray]);
            let along = (before, after) == (a, b);
            (along || (before, after) == (b, a)).then_some((sheet, along))
        });
        own.min_by(|x, y| x.0.away.total_cmp(&y.0.away))
    }

    /// As [`super::site::Site::passage`].
    #[must_use]
    pub(super) fn passage(
        &self,
        materials: &[MaterialId; 3],
        pair: [MaterialId; 2],
        at: DVec3,
    ) -> Option<Passage> {
        let section = self.wedge.section(at);
        let (sheet, along) = self.nearest_sheet(materials, pair, section)?;
        let passage = Passage { distance: sheet.off, normal: sheet.normal };
        Some(if along { passage } else { passage.reversed() })
    }

    /// A number for the sheet between two materials near a place: its ray, or one more than those for what is beyond the bend.
    pub(super) fn sheet(
        &self,
        materials: &[MaterialId; 3],
        pair: [MaterialId; 2],
        at: DVec3,
    ) -> Option<usize> {
        let (sheet, _) = self.nearest_sheet(materials, pair, self.wedge.section(at))?;
        Some(if sheet.beyond { 3 } else { sheet.ray })
    }

    /// Whether a label at a place is another than the knee says (`materials` of its sectors), though none of its sheets is near.
    pub(super) fn is_contradicted(&self, materials: &[MaterialId; 3], label: MaterialId, at: DVec3) -> bool {
        let section = self.wedge.section(at);
        materials[self.sector_of(section)] != label
            && (!materials.contains(&label) || self.sheets(section).iter().all(|sheet| sheet.away > WRONG))
    }
}

impl KneeFit {
    /// Standard deviation of the point of a curve of a kind at z, in the worst direction.
    #[must_use]
    pub(super) fn curve_sigma(&self, kind: CurveKind, z: f64) -> f64 {
        match kind {
            CurveKind::Junction => self.fit.apex_sigma(z)[1],
            CurveKind::Edge => {
                let at = self.knee.point(kind, z);
                let sigmas = [false, true].map(|beyond| self.sheet_sigma(self.knee.ray, beyond, at));
                // Both sheets cross at the turn.
                sigmas[0].hypot(sigmas[1]) / self.knee.turn().sin().abs().max(0.3)
            }
        }
    }

    /// Standard deviation of the place of the interface between two materials along its normal, for white noise.
    #[must_use]
    pub(super) fn sigma(&self, materials: &[MaterialId; 3], pair: [MaterialId; 2], at: DVec3) -> Option<f64> {
        let (sheet, _) = self.knee.nearest_sheet(materials, pair, self.knee.wedge.section(at))?;
        Some(self.sheet_sigma(sheet.ray, sheet.beyond, at))
    }

    fn sheet_sigma(&self, ray: usize, beyond: bool, at: DVec3) -> f64 {
        if !beyond {
            return self.fit.sheet_sigma(ray, at);
        }
        let wedge = &self.knee.wedge;
        let section = wedge.section(at);
        let (z, from) = (section.z, self.knee.seen_at_bend(section));
        let turned = DVec2::from_angle(self.knee.turn());
        let u = wedge.ray(ray, z);
        let along = turned.dot(from).max(0.0);
        // What moves the sheet: as one that leaves the apex in its direction does for the apex's parameters; and the bend.
        let mut row = sheet_slopes::<3, KNEED>(ray, turned.rotate(u), 0.0, z, 1.0);
        let swung = self.knee.length(z) * turned.x + along;
        row[Places::<3>::THETA + ray] = swung;
        row[Places::<3>::TWIST + ray] = swung * z;
        row[LENGTH] = -turned.y;
        row[SLOPE] = -turned.y * z;
        row[TURN] = along;
        self.fit.sigma_of(row)
    }

    /// The point of the interface between two materials nearest to a place, at least `margin` away from the junction curve, and its
    /// standard deviation.
    #[must_use]
    pub(super) fn on_sheet(
        &self,
        materials: &[MaterialId; 3],
        pair: [MaterialId; 2],
        at: DVec3,
        margin: f64,
    ) -> Option<(DVec3, f64)> {
        let knee = &self.knee;
        let wedge = &knee.wedge;
        let mut on = at;
        let mut found = knee.nearest_sheet(materials, pair, wedge.section(on))?.0;
        for _ in 0..3 {
            let section = wedge.section(on);
            found = knee.sheets(section)[if found.beyond { 3 } else { found.ray }];
            on -= found.normal * found.off;
            let end = knee.length(section.z);
            let (least, most) = match (found.beyond, found.ray == knee.ray) {
                (true, _) => (0.0, f64::INFINITY),
                (false, true) => (margin.min(end), end),
                (false, false) => (margin, f64::INFINITY),
            };
            let u = wedge.ray(found.ray, section.z);
            let u = if found.beyond { DVec2::from_angle(knee.turn()).rotate(u) } else { u };
            on += wedge.in_space(u, section.z) * (found.along.clamp(least, most) - found.along);
        }
        Some((on, self.sheet_sigma(found.ray, found.beyond, on)))
    }
}

#[cfg(test)]
#[path = "knee_tests.rs"]
mod tests;
