//! Tests of wedges: derivatives, and fits to exactly blurred sectors.

use super::*;
use crate::locate::fixtures::{noisy, reading, rms, sectors, window};

fn wedge() -> Wedge<3, JUNCTION> {
    Wedge::new(
        DVec3::new(0.1, -0.2, 0.05),
        DVec3::new(0.2, 0.3, 0.9).normalize(),
        [DVec3::X, DVec3::new(-0.4, 1.0, 0.0), DVec3::new(-0.3, -1.0, 0.2)],
        [10.0, 100.0, 40.0],
    )
}

/// The largest difference of the stated derivative by parameter `i` from the numeric one over a window, and the largest
/// derivative.
fn derivative_error(wedge: &Wedge<3, JUNCTION>, i: usize) -> [f64; 2] {
    // Predictions are good to 1e-7 of the grey values.
    let h = 0.01;
    let mut worst = [0.0f64; 2];
    for sample in window(4.3, |_| 0.0) {
        let model = Blurred::<3, JUNCTION> {
            samples: Batches::new(&[sample]),
            flanks: &[],
            origin: wedge.origin,
            axes: wedge.axes,
            reading: reading(1.0),
        };
        let mut e = Normal::new(&[true; JUNCTION]);
        let misfit = model.normal_equations(&wedge.x, &mut e);
        // The grey value is zero: J^T r is the derivative times the prediction.
        let stated = e.right[i] / misfit.sqrt();
        let at = |x: &SVector<f64, JUNCTION>| {
            Known::<3>::new(wedge.origin, &wedge.axes, x).predict(&Batches::new(&[sample]))
        };
        let (mut up, mut down) = (wedge.x, wedge.x);
        up[i] += h;
        down[i] -= h;
        let numeric = (at(&up) - at(&down)) / (2.0 * h);
        worst = [worst[0].max((stated - numeric).abs()), worst[1].max(numeric.abs())];
    }
    worst
}

#[test]
fn derivatives_are_those_of_the_prediction() {
    let straight = wedge();
    // The Jacobian neglects how the section turns with the curve and what curvature does to places along a sheet, which
    // are of the order of tilt and curvature times distance (here 0.2 and 0.1): nothing in a straight wedge, and a share
    // in a bent one, at most 0.15 for the place.
    let mut bent = wedge();
    for i in 0..JUNCTION {
        if i < 4 {
            bent.x[i] += 0.03 * (i as f64 - 1.5);
        } else if (7..12).contains(&i) {
            bent.x[i] = 0.01 * (i as f64 - 9.5);
        }
    }
    bent.x[Places::<3>::SIGMA] = 0.05;
    for (i, twist) in [0.01, -0.01, 0.02].into_iter().enumerate() {
        bent.x[Places::<3>::TWIST + i] = twist;
    }
    for i in 0..JUNCTION {
        let [off, largest] = derivative_error(&straight, i);
        assert!(largest > 0.5, "{i}: {largest}");
        // What is left is the tables' interpolation: 3.6e-3 for sigma.
        assert!(off < 6e-3 * largest, "{i}: {off} of {largest}");
    }
    for i in 0..JUNCTION {
        let [off, largest] = derivative_error(&bent, i);
        assert!(off < 0.3 * largest, "bent, {i}: {off} of {largest}");
    }
}

/// A planar wedge in space: through `APEX` along `axes[2]`, sheets at angles `theta` in the section.
struct Truth<const R: usize> {
    axes: [DVec3; 3],
    theta: [f64; R],
}

const APEX: DVec3 = DVec3::new(0.17, -0.08, 0.11);

impl<const R: usize> Truth<R> {
    fn new(theta: [f64; R]) -> Self {
        let w = DVec3::new(0.3, -0.2, 0.93).normalize();
        let u = w.any_orthonormal_vector();
        Self { axes: [u, w.cross(u), w], theta }
    }

    fn in_space(&self, p: DVec2, z: f64) -> DVec3 {
        APEX + self.axes[0] * p.x + self.axes[1] * p.y + self.axes[2] * z
    }

    fn samples(&self, greys: &[f64; R]) -> Vec<Sample> {
        window(4.2, |at| {
            let q = at - APEX;
            sectors(&self.theta, greys, DVec2::new(self.axes[0].dot(q), self.axes[1].dot(q)))
        })
    }

    /// Where a fit starts: beside, tilted and turned.
    fn start<const N: usize>(&self, greys: [f64; R]) -> Wedge<R, N> {
        let rays = self.theta.map(|t| {
            let u = DVec2::from_angle(t + 0.17);
            self.axes[0] * u.x + self.axes[1] * u.y
        });
        let direction = (self.axes[2] + self.axes[0] * 0.08 - self.axes[1] * 0.06).normalize();
        Wedge::new(APEX + self.axes[0] * 0.5 - self.axes[1] * 0.3, direction, rays, greys)
    }
}

/// Distances of points of the curve, and errors of points of the sheets in stated standard deviations, over fits to noisy
/// windows.
fn fits<const R: usize, const N: usize>(theta: [f64; R], greys: [f64; R], noise: f64) -> [Vec<f64>; 2] {
    let truth = Truth::new(theta);
    let exact = truth.samples(&greys);
    let prior = Prior {
        levels: greys.map(|mean| LevelPrior { mean, sigma: 3.0 }),
        reading: reading(noise),
        log_sigma: 0.1,
        curvature: 0.12,
        bends: [None; R],
    };
    let (mut curve, mut pulls) = (Vec::new(), Vec::new());
    for seed in 0..40 {
        let samples = noisy(&exact, noise, seed);
        let start = truth.start::<N>(greys);
        let rough = start.fit(&samples, &[], &prior, Stage::Rough).unwrap().wedge.recentred(0.0);
        let fit = rough.fit(&samples, &[], &prior, Stage::Planar).unwrap();
        for z in [-2.0, 0.0, 2.0] {
            let at = truth.in_space(DVec2::ZERO, z);
            curve.push(fit.wedge.section(at).r.length());
            for (i, t) in theta.iter().enumerate() {
                let at = truth.in_space(DVec2::from_angle(*t) * 2.0, z);
                pulls.push(fit.wedge.sheet(i, at).0 / fit.sheet_sigma(i, at));
            }
        }
        // Beside every sheet, halfway into the sector.
        for i in 0..R {
            let end = if i + 1 < R { theta[i + 1] } else { theta[0] + 2.0 * PI };
            let at = truth.in_space(DVec2::from_angle(0.5 * (theta[i] + end)) * 2.0, 0.5);
            assert_eq!(fit.wedge.sector(at), i);
        }
    }
    [curve, pulls]
}

#[test]
fn planar_wedges_are_found_as_well_as_they_say() {
    let (degree, greys) = (PI / 180.0, [100.0, 20.0, 0.0]);
    for (what, theta, bound) in [
        ("90/90/180", [20.0, 110.0, 200.0], 0.06),
        ("60/120/180", [20.0, 140.0, 200.0], 0.06),
        ("120/60/180", [20.0, 80.0, 200.0], 0.06),
    ] {
        // One percent of the smallest contrast, as in docs/accuracy.md, is 0.2.
        let [curve, pulls] = fits::<3, JUNCTION>(theta.map(|t| t * degree), greys, 0.4);
        let [curve, pulls] = [rms(&curve), rms(&pulls)];
        assert!(curve < bound, "{what}: {curve}");
        assert!((0.75..1.25).contains(&pulls), "{what}: {pulls}");
    }
}

#[test]
fn sharp_edges_are_found_as_well_as_they_say() {
    for theta in [[0.3, 0.3 + 0.5 * PI], [0.3, 0.3 + PI / 3.0]] {
        let [curve, pulls] = fits::<2, EDGE>(theta, [100.0, 0.0], 1.0).map(|v| rms(&v));
        assert!(curve < 0.06, "{theta:?}: {curve}");
        assert!((0.75..1.25).contains(&pulls), "{theta:?}: {pulls}");
    }
}
