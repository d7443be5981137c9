//! A small ball of one material in another: a pore or an inclusion, blurred, fitted to grey values.
//!
//! In blur units the share of a ball of radius r at distance s from its centre is, exactly,
//!
//! ```text
//! Phi(r - s) + Phi(r + s) - 1 - (phi(r - s) - phi(r + s)) / s
//! ```
//!
//! Six parameters: centre, radius, both grey levels; the level inside is held by what is known of it elsewhere, for a
//! small ball never reaches it. Only balls: a pore of another shape is refused by its misfit. Where the blur differs
//! along the axes a ball is an ellipsoid in blur units, and refused, too.

use glam::DVec3;
use nalgebra::SVector;

use super::gauss::TABLES;
use super::least_squares::{ENOUGH, Fit, Model, Normal, Problem, minimise, packed, packed_sigma};
use super::passage::Passage;
use super::sheet::{LevelPrior, Sample};

/// Parameters: centre, radius, levels inside and outside.
pub(super) const PARAMETERS: usize = 6;

/// Smallest radius, blur units.
const SMALLEST: f64 = 0.3;
/// Nearer to the centre its share is taken as that at the centre, which is flat.
const MIDDLE: f64 = 1e-3;

/// A fitted ball, in blur units about the window's middle.
#[derive(Debug, Clone)]
pub(super) struct Ball {
    /// The fit.
    pub fit: Fit<PARAMETERS>,
}

struct Blurred<'a> {
    samples: &'a [Sample],
    weight: f64,
}

/// The share of a ball of radius `r` at distance `s`, and its derivatives by both.
#[inline]
pub(super) fn share(r: f64, s: f64) -> [f64; 3] {
    let tables = &*TABLES;
    let s = s.max(MIDDLE);
    let (near, far) = (tables.density(r - s), tables.density(r + s));
    let step = (near - far) / s;
    let value = tables.distribution(r - s) + tables.distribution(r + s) - 1.0 - step;
    [value, r * step, step / s - r / s * (near + far)]
}

impl Model<PARAMETERS> for Blurred<'_> {
    fn normal_equations(&self, x: &SVector<f64, PARAMETERS>, equations: &mut Normal<PARAMETERS>) -> f64 {
        let centre = DVec3::new(x[0], x[1], x[2]);
        let contrast = x[4] - x[5];
        let mut chi2 = 0.0;
        for sample in self.samples {
            let away = sample.at - centre;
            let s = away.length();
            let [value, by_radius, by_distance] = share(x[3], s);
            let r = (x[5] + contrast * value - sample.grey) * self.weight;
            chi2 += r * r;
            let f = contrast * self.weight;
            let outwards = if s > MIDDLE { away / s } else { DVec3::ZERO };
            let move_centre = outwards * (-f * by_distance);
            let row = [
                move_centre.x,
                move_centre.y,
                move_centre.z,
                f * by_radius,
                value * self.weight,
                (1.0 - value) * self.weight,
            ];
            equations.add(&row, r);
        }
        chi2
    }

    fn is_possible(&self, x: &SVector<f64, PARAMETERS>) -> bool {
        x[3] > SMALLEST
    }
}

/// Fits a ball from about `centre` and `radius`. `levels`: inside, outside.
#[must_use]
pub(super) fn fit_ball(
    samples: &[Sample],
    centre: DVec3,
    radius: f64,
    levels: [LevelPrior; 2],
    noise: f64,
) -> Option<Ball> {
    let mut problem = Problem {
        active: [true; PARAMETERS],
        prior: [(0.0, f64::INFINITY); PARAMETERS],
        most: [0.5, 0.5, 0.5, 0.5, f64::INFINITY, f64::INFINITY],
        iterations: 15,
        enough: ENOUGH,
    };
    for (prior, level) in problem.prior[4..].iter_mut().zip(levels) {
        *prior = (level.mean, level.sigma);
    }
    let start = SVector::from([centre.x, centre.y, centre.z, radius, levels[0].mean, levels[1].mean]);
    let fit = minimise(&Blurred { samples, weight: 1.0 / noise }, &problem, start)?;
    Some(Ball { fit })
}

impl Ball {
    /// Its centre.
    #[must_use]
    pub(super) fn centre(&self) -> DVec3 {
        DVec3::new(self.fit.x[0], self.fit.x[1], self.fit.x[2])
    }

    /// Its radius.
    #[must_use]
    pub(super) fn radius(&self) -> f64 {
        self.fit.x[3]
    }

    /// Standard deviation of the radius, for white noise.
    #[must_use]
    pub(super) fn radius_sigma(&self) -> f64 {
        self.fit.covariance[(3, 3)].max(0.0).sqrt()
    }
}

/// A ball as it is kept: in blur units from a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct KeptBall {
    centre: [f32; 3],
    radius: f32,
    /// Lower triangle of the covariance of centre and radius, by rows.
    covariance: [f32; 10],
    /// Whether the first material of the pair is inside.
    first_inside: bool,
}

impl KeptBall {
    /// A ball whose window's middle is at `middle`.
    #[must_use]
    pub(super) fn new(ball: &Ball, middle: DVec3, first_inside: bool) -> Self {
        let centre = (ball.centre() + middle).as_vec3().to_array();
        Self { centre, radius: ball.radius() as f32, covariance: packed(&ball.fit.covariance), first_inside }
    }

    /// Distance of a place from the centre, and the direction to it.
    fn away(&self, at: DVec3) -> (f64, DVec3) {
        let away = at - DVec3::from(self.centre.map(f64::from));
        (away.length(), away.try_normalize().unwrap_or(DVec3::X))
    }

    /// Where its surface passes a place.
    #[must_use]
    pub(super) fn passage(&self, at: DVec3) -> Passage {
        let (away, outwards) = self.away(at);
        let passage = Passage { distance: away - f64::from(self.radius), normal: outwards };
        if self.first_inside { passage } else { passage.reversed() }
    }

    /// Standard deviation of its surface's place along the normal near a place, for white noise.
    #[must_use]
    pub(super) fn sigma(&self, at: DVec3) -> f64 {
        let (_, outwards) = self.away(at);
        packed_sigma(&self.covariance, &[outwards.x, outwards.y, outwards.z, 1.0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::locate::fixtures::{ball, noisy, rms, window};

    const LEVELS: [LevelPrior; 2] =
        [LevelPrior { mean: 20.0, sigma: 0.3 }, LevelPrior { mean: 120.0, sigma: 0.3 }];
    const CENTRE: DVec3 = DVec3::new(0.3, -0.2, 0.1);

    fn pore(radius: f64) -> Vec<Sample> {
        window(4.8, |at| 120.0 - 100.0 * ball(radius, at.distance(CENTRE)))
    }

    #[test]
    fn derivatives_are_those_of_the_share() {
        for (r, s) in [(1.7, 0.4), (1.7, 1.9), (0.8, 2.5), (3.0, 0.05)] {
            let h = 1e-4;
            let by = |a: [f64; 3], b: [f64; 3]| (a[0] - b[0]) / (2.0 * h);
            let [value, by_radius, by_distance] = share(r, s);
            assert!((value - ball(r, s)).abs() < 1e-6);
            assert!((by(share(r + h, s), share(r - h, s)) - by_radius).abs() < 1e-4, "{r} {s}");
            assert!((by(share(r, s + h), share(r, s - h)) - by_distance).abs() < 1e-4, "{r} {s}");
        }
    }

    #[test]
    fn pores_are_found_exactly() {
        for radius in [1.3, 1.7, 2.5] {
            let found = fit_ball(&pore(radius), DVec3::ZERO, 1.5, LEVELS, 1.0).unwrap();
            assert!((found.radius() - radius).abs() < 1e-3, "{radius}: {}", found.radius());
            assert!(found.centre().distance(CENTRE) < 1e-3);
            let kept = KeptBall::new(&found, DVec3::ZERO, true);
            let passage = kept.passage(CENTRE + DVec3::Y * 3.0);
            assert!((passage.distance - 3.0 + radius).abs() < 1e-3 && passage.normal.y > 0.999);
            // How well its surface is known does not depend on which material is named first.
            let turned = KeptBall::new(&found, DVec3::ZERO, false);
            for at in [DVec3::Y, DVec3::new(1.0, -0.4, 0.3)].map(|by| CENTRE + by * 3.0) {
                assert_eq!(kept.sigma(at).to_bits(), turned.sigma(at).to_bits());
            }
        }
    }

    #[test]
    fn stated_sigmas_of_the_radius_are_those_of_the_errors() {
        let levels = LEVELS.map(|l| LevelPrior { sigma: 1e-3, ..l });
        let pulls: Vec<f64> = (0..200)
            .map(|seed| {
                let found = fit_ball(&noisy(&pore(1.7), 3.0, seed), DVec3::ZERO, 1.5, levels, 3.0).unwrap();
                (found.radius() - 1.7) / found.radius_sigma()
            })
            .collect();
        let found = rms(&pulls);
        assert!((0.85..1.15).contains(&found), "{found}");
    }
}
