//! The normal distribution, tabulated: density and distribution function.
//!
//! Everything is in units of the blur's sigma. Fits ask for these values a billion times, so they are read
//! from tables: cubic Hermite interpolation between nodes whose values and slopes are exact. Largest errors
//! (tests): 3e-9.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};
use std::sync::LazyLock;

/// Beyond this everything is saturated.
const END: f64 = 6.5;
/// Nodes per unit.
const NODES: usize = 32;
/// The tables, once made.
pub(super) static TABLES: LazyLock<Tables> = LazyLock::new(Tables::new);

/// See the module's header.
#[derive(Debug)]
pub(super) struct Tables {
    /// Value and slope (times the step) of the distribution function, and of the density, at each node.
    step: Vec<[f64; 4]>,
}

/// Value at `t` (0 to 1) between nodes with values `a`, `b` and slopes `p`, `q` per step.
#[inline]
fn hermite(t: f64, a: f64, p: f64, b: f64, q: f64) -> f64 {
    let d = b - a;
    a + t * (p + t * ((3.0 * d - 2.0 * p - q) + t * (p + q - 2.0 * d)))
}

pub(super) fn exact_density(x: f64) -> f64 {
    libm::exp(-0.5 * x * x) / TAU.sqrt()
}

fn exact_distribution(x: f64) -> f64 {
    0.5 * libm::erfc(-x * FRAC_1_SQRT_2)
}

/// Where the distribution function has the value `share`, within its range.
pub(super) fn quantile(share: f64) -> f64 {
    bisect([-END, END], 50, share, exact_distribution)
}

/// Where a rising function has a value, between two places, after so many halvings.
pub(super) fn bisect(
    [mut low, mut high]: [f64; 2],
    rounds: usize,
    value: f64,
    rising: impl Fn(f64) -> f64,
) -> f64 {
    for _ in 0..rounds {
        let middle = 0.5 * (low + high);
        if rising(middle) < value {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
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
        Self { step }
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_where_the_distribution_has_their_value() {
        for i in -40..=40 {
            let x = f64::from(i) * 0.1;
            assert!((quantile(exact_distribution(x)) - x).abs() < 1e-7, "{x}");
        }
        assert!(quantile(0.5).abs() < 1e-12 && quantile(0.0) < -6.0 && quantile(1.0) > 6.0);
    }

    #[test]
    fn tables_agree_with_the_functions() {
        let t = &*TABLES;
        for i in 0..4000 {
            let x = f64::from(i) * 0.0033 - 6.6;
            assert!((t.distribution(x) - exact_distribution(x)).abs() < 3e-9, "{x}");
            assert!((t.density(x) - exact_density(x)).abs() < 1e-8, "{x}");
        }
    }
}
