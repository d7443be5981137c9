//! The mean weighted by a Gaussian of the distance.

use super::kernel::reach;
use super::separable::Separable;

/// Where the Gaussian is cut off, in standard deviations: 0.3 % of it lie beyond along an axis.
pub(super) const CUT: f64 = 3.0;

/// A Gaussian of standard deviation `sigma` mm.
pub(super) fn gaussian(sigma: f64, spacing: [f64; 3]) -> Separable {
    let reach = reach(CUT * sigma, spacing);
    Separable::new([0, 1, 2].map(|axis| {
        let weight = |n: usize| (-0.5 * (n as f64 * spacing[axis] / sigma).powi(2)).exp();
        (0..=reach[axis] as usize).map(weight).collect()
    }))
}
