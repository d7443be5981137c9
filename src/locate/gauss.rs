//! The normal distribution, tabulated: density, distribution function, and the share of a round Gaussian that
//! lies in a wedge.
//!
//! Everything is in units of the blur's sigma. Fits ask for these values a billion times, so they are read
//! from tables: cubic Hermite interpolation between nodes whose values and slopes are exact. Largest errors
//! (tests): 3e-9 for the distribution function, 2e-5 for the wedge.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};
use std::sync::LazyLock;

/// Beyond this everything is saturated.
const END: f64 = 6.5;
/// Nodes per unit.
const NODES: usize = 32;
/// Distances at which wedges are tabulated end here: farther away an edge is all that a voxel sees.
const FAR: f64 = 8.0;
/// Rows of the table of wedges per unit of distance, and steps over half a turn.
const ROWS: usize = 20;
const STEPS: usize = 72;

/// The tables, once made.
pub(super) static TABLES: LazyLock<Tables> = LazyLock::new(Tables::new);

/// See the module's header.
#[derive(Debug)]
pub(super) struct Tables {
    /// Value and slope (times the step) of the distribution function, and of the density, at each node.
    step: Vec<[f64; 4]>,
    /// Value, slope along the angle and slope along the distance (times the steps) of the wedge.
    wedge: Vec<[f64; 3]>,
}

/// Value at `t` (0 to 1) between nodes with values `a`, `b` and slopes `p`, `q` per step.
#[inline]
fn hermite(t: f64, a: f64, p: f64, b: f64, q: f64) -> f64 {
    let d = b - a;
    a + t * (p + t * ((3.0 * d - 2.0 * p - q) + t * (p + q - 2.0 * d)))
}

fn exact_density(x: f64) -> f64 {
    libm::exp(-0.5 * x * x) / TAU.sqrt()
}

fn exact_distribution(x: f64) -> f64 {
    0.5 * libm::erfc(-x * FRAC_1_SQRT_2)
}

/// Density over the angle of a round Gaussian seen from a point at distance `rho` from its centre, at `angle`
/// from the direction that points away from the centre.
fn angular_density(rho: f64, angle: f64) -> f64 {
    let (c, d) = (-rho * libm::cos(angle), rho * libm::sin(angle));
    exact_density(d) * (exact_density(c) + c * exact_distribution(c))
}

impl Tables {
    fn new() -> Self {
        let h = 1.0 / NODES as f64;
        let nodes = (2.0 * END) as usize * NODES + 2;
        let step = (0..nodes)
            .map(|i| {
                let x = i as f64 * h - END;
                let f = exact_density(x);
                [exact_distribution(x), f * h, f, -x * f * h]
            })
            .collect();
        let (dr, da) = (1.0 / ROWS as f64, PI / STEPS as f64);
        let mut wedge = Vec::new();
        for row in 0..=(FAR as usize * ROWS) {
            let rho = row as f64 * dr;
            let mut sum = 0.0;
            for i in 0..=STEPS {
                let angle = i as f64 * da;
                if i > 0 {
                    // Composite Simpson: the density is smooth over 1 / rho.
                    const PARTS: usize = 8;
                    let s = da / PARTS as f64;
                    let start = angle - da;
                    for k in 0..PARTS {
                        let x = start + k as f64 * s;
                        sum += s / 6.0
                            * (angular_density(rho, x)
                                + 4.0 * angular_density(rho, x + 0.5 * s)
                                + angular_density(rho, x + s));
                    }
                }
                let (c, d) = (-rho * libm::cos(angle), rho * libm::sin(angle));
                // The centre moves away from the wedge: what passes its far side leaves it.
                let along = -exact_density(d) * exact_distribution(c) * libm::sin(angle);
                wedge.push([sum, angular_density(rho, angle) * da, along * dr]);
            }
        }
        // What the sum lacks to one half at half a turn, of the order of 1e-10, is rounding of the quadrature.
        Self { step, wedge }
    }

    /// Node and place after it.
    #[inline]
    fn node(x: f64) -> (usize, f64) {
        let at = (x.clamp(-END, END) + END) * NODES as f64;
        let i = at as usize;
        (i, at - i as f64)
    }

    /// The density.
    #[inline]
    #[must_use]
    pub(super) fn density(&self, x: f64) -> f64 {
        let (i, t) = Self::node(x);
        let (a, b) = (&self.step[i], &self.step[i + 1]);
        hermite(t, a[2], a[3], b[2], b[3])
    }

    /// The distribution function.
    #[inline]
    #[must_use]
    pub(super) fn distribution(&self, x: f64) -> f64 {
        let (i, t) = Self::node(x);
        let (a, b) = (&self.step[i], &self.step[i + 1]);
        hermite(t, a[0], a[1], b[0], b[1])
    }

    /// The share of a round Gaussian in the wedge with its apex at distance `rho` from the centre that spreads
    /// from the direction away from the centre over `angle`, 0 to pi (at which it is one half).
    #[inline]
    #[must_use]
    pub(super) fn wedge(&self, rho: f64, angle: f64) -> f64 {
        if rho >= FAR {
            // Only the edge of the wedge is near, if it is.
            let (c, d) = (-rho * libm::cos(angle), rho * libm::sin(angle));
            return if c < 0.0 { 0.0 } else { self.distribution(-d) };
        }
        let (row, u) = {
            let at = rho * ROWS as f64;
            let i = at as usize;
            (i, at - i as f64)
        };
        let at = (angle * (STEPS as f64 / PI)).clamp(0.0, STEPS as f64 - 1e-9);
        let i = at as usize;
        let t = at - i as f64;
        let k = row * (STEPS + 1) + i;
        let [a, b] = [&self.wedge[k], &self.wedge[k + 1]];
        let [c, d] = [&self.wedge[k + STEPS + 1], &self.wedge[k + STEPS + 2]];
        let near = hermite(t, a[0], a[1], b[0], b[1]);
        let far = hermite(t, c[0], c[1], d[0], d[1]);
        let (p, q) = (a[2] + t * (b[2] - a[2]), c[2] + t * (d[2] - c[2]));
        hermite(u, near, p, far, q)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_agree_with_the_functions() {
        let t = &*TABLES;
        for i in 0..4000 {
            let x = f64::from(i) * 0.0033 - 6.6;
            assert!((t.distribution(x) - exact_distribution(x)).abs() < 3e-9, "{x}");
            assert!((t.density(x) - exact_density(x)).abs() < 1e-8, "{x}");
        }
    }

    #[test]
    fn wedges_of_half_a_turn_are_halves_and_quarters_are_products() {
        let t = &*TABLES;
        for i in 0..70 {
            let rho = f64::from(i) * 0.1137;
            assert!((t.wedge(rho, PI) - 0.5).abs() < 1e-6, "{rho} {}", t.wedge(rho, PI));
            for k in 1..40 {
                let a = f64::from(k) * 0.0785;
                // Quadrant with one side at angle a, the other at a - pi/2: both from the reference.
                let (x, y) = (-rho * a.cos(), -rho * a.sin());
                let quadrant = exact_distribution(x) * exact_distribution(y);
                let other = (a - PI / 2.0).abs();
                let second = t.wedge(rho, other);
                let between = if a > PI / 2.0 { t.wedge(rho, a) - second } else { t.wedge(rho, a) + second };
                assert!((between - quadrant).abs() < 2e-5, "{rho} {a}: {between} {quadrant}");
            }
        }
    }
}
