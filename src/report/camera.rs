//! The orthographic camera: from the world to samples of the picture.
//!
//! ```text
//!            up                     azimuth 0, elevation 0: the eye is far out on -y, +x points
//!            │  ╱ away (depth)      right and +z up. The azimuth walks the eye counter-clockwise
//!            │ ╱                    seen from above (90: the eye is on +x), the elevation lifts
//!            └────── right          it (90: from above).
//! ```

use glam::DVec3;

/// Share of the picture left free on every side.
const MARGIN: f64 = 0.05;

/// An orthographic camera. A *sample* is a point at which the picture is evaluated; there are
/// several per pixel. Sample (i, j) has its centre at (i + 0.5, j + 0.5), j downwards.
#[derive(Debug, Clone)]
pub(super) struct Camera {
    right: DVec3,
    up: DVec3,
    /// Unit vector towards the eye.
    eye: DVec3,
    /// The world point shown in the middle of the picture.
    centre: DVec3,
    /// Samples per mm.
    scale: f64,
    /// The middle of the picture, in samples.
    middle: [f64; 2],
}

/// The part of the world to be kept by a cut, seen through a camera: where
/// `slope · (sample x, sample y, depth) + offset >= 0`.
#[derive(Debug, Clone, Copy)]
pub(super) struct HalfSpace {
    slope: DVec3,
    offset: f64,
}

/// What a camera has to show: gathers points and chooses the camera for them. The order of points does not
/// matter.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    right: DVec3,
    up: DVec3,
    eye: DVec3,
    /// Bounds of the points, along the three axes above.
    low: DVec3,
    high: DVec3,
}

impl Fit {
    /// Without a point yet, for a camera that looks from `azimuth` and `elevation` (degrees).
    pub(super) fn new(azimuth: f64, elevation: f64) -> Self {
        let (sa, ca) = azimuth.to_radians().sin_cos();
        let (se, ce) = elevation.to_radians().sin_cos();
        Self {
            right: DVec3::new(ca, sa, 0.0),
            up: DVec3::new(-sa * se, ca * se, ce),
            eye: DVec3::new(sa * ce, -ca * ce, se),
            low: DVec3::INFINITY,
            high: DVec3::NEG_INFINITY,
        }
    }

    /// Adds a point.
    pub(super) fn include(&mut self, p: DVec3) {
        let seen = DVec3::new(self.right.dot(p), self.up.dot(p), self.eye.dot(p));
        self.low = self.low.min(seen);
        self.high = self.high.max(seen);
    }

    /// Adds the points of another one for the same camera.
    pub(super) fn join(&mut self, other: &Self) {
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
    }

    /// Whether there is no point yet.
    pub(super) fn is_empty(&self) -> bool {
        self.low.x > self.high.x
    }

    /// The camera that shows the points as large as `samples` (width, height) allow.
    pub(super) fn camera(&self, samples: [usize; 2]) -> Camera {
        let Self { right, up, eye, low, high } = *self;
        let size = high - low;
        let fit = |extent: f64, n: usize| (1.0 - 2.0 * MARGIN) * n as f64 / extent;
        let scale = fit(size.x, samples[0]).min(fit(size.y, samples[1]));
        let mid = 0.5 * (low + high);
        Camera {
            right,
            up,
            eye,
            centre: right * mid.x + up * mid.y + eye * mid.z,
            // A single point has no extent; any scale shows it.
            scale: if scale.is_finite() && scale > 0.0 { scale } else { 1.0 },
            middle: samples.map(|n| 0.5 * n as f64),
        }
    }
}

impl Camera {
    /// Where a world point is seen: sample x, sample y (downwards), depth (growing away from the
    /// eye). All three in samples.
    pub(super) fn project(&self, p: DVec3) -> DVec3 {
        let d = (p - self.centre) * self.scale;
        DVec3::new(self.middle[0] + self.right.dot(d), self.middle[1] - self.up.dot(d), -self.eye.dot(d))
    }

    /// A world direction in camera axes: right, up, towards the eye.
    pub(super) fn turn(&self, v: DVec3) -> DVec3 {
        DVec3::new(self.right.dot(v), self.up.dot(v), self.eye.dot(v))
    }

    /// The half of the world behind the plane `axis = position` (mm), seen from the eye. If the eye
    /// looks along the plane, the half below it.
    pub(super) fn behind(&self, axis: usize, position: f64) -> HalfSpace {
        let side = if self.eye[axis] > -1e-12 { -1.0 } else { 1.0 };
        // The coordinate along `axis` is affine in what `project` returns; this inverts it.
        let slope = side / self.scale * DVec3::new(self.right[axis], -self.up[axis], -self.eye[axis]);
        let at_middle = side * (self.centre[axis] - position);
        let offset = at_middle - slope.x * self.middle[0] - slope.y * self.middle[1];
        HalfSpace { slope, offset }
    }
}

impl HalfSpace {
    /// Whether a projected point is kept.
    pub(super) fn keeps(&self, x: f64, y: f64, depth: f64) -> bool {
        self.slope.dot(DVec3::new(x, y, depth)) + self.offset >= 0.0
    }

    /// Depth of the plane at a sample; `None` if the eye looks along the plane.
    pub(super) fn plane_depth(&self, x: f64, y: f64) -> Option<f64> {
        let steep = self.slope.z.abs() > 1e-9 * self.slope.length();
        steep.then(|| -(self.slope.x * x + self.slope.y * y + self.offset) / self.slope.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fitted(points: impl Iterator<Item = DVec3>, azimuth: f64, elevation: f64, n: [usize; 2]) -> Camera {
        let mut fit = Fit::new(azimuth, elevation);
        assert!(fit.is_empty());
        points.for_each(|p| fit.include(p));
        fit.camera(n)
    }

    fn cube() -> impl Iterator<Item = DVec3> {
        (0..8).map(|i| DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2)))
    }

    #[test]
    fn the_front_view_has_x_to_the_right_and_z_up() {
        let camera = fitted(cube(), 0.0, 0.0, [100, 100]);
        let p = camera.project(DVec3::new(1.0, 0.0, 1.0));
        assert!((p - DVec3::new(95.0, 5.0, -45.0)).length() < 1e-9, "{p}");
        let above = fitted(cube(), 0.0, 90.0, [100, 100]);
        let p = above.project(DVec3::new(1.0, 1.0, 0.0));
        assert!((p - DVec3::new(95.0, 5.0, 45.0)).length() < 1e-9, "{p}");
        let side = fitted(cube(), 90.0, 0.0, [100, 100]);
        assert!((side.turn(DVec3::X) - DVec3::Z).length() < 1e-12);
    }

    #[test]
    fn a_cut_keeps_what_is_behind_its_plane() {
        for (azimuth, elevation) in [(35.0, 25.0), (-120.0, -40.0), (0.0, 90.0), (200.0, 3.0)] {
            let camera = fitted(cube(), azimuth, elevation, [300, 200]);
            for axis in 0..3 {
                let half = camera.behind(axis, 0.4);
                let towards_eye = camera.turn([DVec3::X, DVec3::Y, DVec3::Z][axis]).z;
                for p in cube() {
                    let s = camera.project(p);
                    let is_behind = (p[axis] > 0.4) != (towards_eye > -1e-12);
                    assert_eq!(half.keeps(s.x, s.y, s.z), is_behind);
                    if let Some(depth) = half.plane_depth(s.x, s.y) {
                        assert_eq!(depth <= s.z, is_behind);
                    }
                }
            }
        }
    }
}
