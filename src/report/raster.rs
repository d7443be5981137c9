//! The z-buffer of a band of the picture: which triangle, cap or line each sample shows.
//!
//! Corners are snapped to 1/256 of a sample and covered by integer edge functions with a tie rule, so
//! triangles that share an edge neither overlap nor leave a gap. Among equal depths the triangle drawn first
//! wins: if triangles are drawn in ascending order, a band depends neither on any other nor on where the mesh was
//! cut into pieces.

use glam::DVec3;

use super::camera::HalfSpace;

/// Snapping: steps per sample.
const STEPS: i32 = 256;
/// Lines are drawn if they lie at most this much (in samples) behind the surface: they lie *on* it,
/// and a surface's depth at a sample's centre is not its depth on the line.
const LINE_BIAS: f32 = 2.0;

/// A projected vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    /// In 1/256 of a sample.
    x: i32,
    /// In 1/256 of a sample, downwards.
    y: i32,
    /// Depth in samples.
    z: f32,
}

impl Corner {
    /// From a projected point (samples).
    pub(super) fn new(p: DVec3) -> Self {
        let snap = |v: f64| (v * f64::from(STEPS)).round() as i32;
        Self { x: snap(p.x), y: snap(p.y), z: p.z as f32 }
    }

    /// In samples.
    pub(super) fn place(self) -> [f32; 2] {
        [self.x, self.y].map(|v| v as f32 / STEPS as f32)
    }
}

/// Twice the signed area of a projected triangle: negative if it is counter-clockwise on the
/// screen (whose y points down), so that its front is seen.
pub(super) fn signed_area([a, b, c]: [Corner; 3]) -> i64 {
    let d = |p: Corner, q: Corner| (i64::from(q.x) - i64::from(p.x), i64::from(q.y) - i64::from(p.y));
    let ((ux, uy), (vx, vy)) = (d(a, b), d(a, c));
    ux * vy - uy * vx
}

/// First and one-past-last sample whose centres lie in `low..=high` (snapped units).
pub(super) fn samples_between(low: i32, high: i32) -> (i64, i64) {
    let (low, high) = (i64::from(low), i64::from(high));
    let half = i64::from(STEPS) / 2;
    (
        (low - half + i64::from(STEPS) - 1).div_euclid(i64::from(STEPS)),
        (high - half).div_euclid(i64::from(STEPS)) + 1,
    )
}

/// First and one-past-last row of samples that a triangle may cover.
pub(super) fn rows_of([a, b, c]: [Corner; 3]) -> (i64, i64) {
    samples_between(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y))
}

/// A band of rows of samples, each of which shows an `S`.
pub(super) struct Band<S> {
    width: usize,
    /// First row, of the picture's samples.
    top: usize,
    depth: Vec<f32>,
    seen: Vec<S>,
}

impl<S: Copy> Band<S> {
    /// A band of `rows` rows from row `top` on that shows nothing but `empty`.
    pub(super) fn new(width: usize, top: usize, rows: usize, empty: S) -> Self {
        Self { width, top, depth: vec![f32::INFINITY; width * rows], seen: vec![empty; width * rows] }
    }

    fn rows(&self) -> usize {
        self.seen.len() / self.width
    }

    /// What the samples of a row (counted in the picture) show.
    pub(super) fn row(&self, y: usize) -> &[S] {
        let start = (y - self.top) * self.width;
        &self.seen[start..start + self.width]
    }

    /// Draws a triangle, as far as `keep` keeps it, where nothing nearer is; `look` says what it shows at
    /// a sample (x, y).
    pub(super) fn triangle(
        &mut self,
        corners: [Corner; 3],
        keep: Option<&HalfSpace>,
        mut look: impl FnMut(usize, usize) -> S,
    ) {
        let area = signed_area(corners);
        if area == 0 {
            return;
        }
        let [a, b, c] = if area > 0 { corners } else { [corners[0], corners[2], corners[1]] };
        let clip = |(low, high): (i64, i64), first: usize, n: usize| {
            (low.max(first as i64) as usize, high.min((first + n) as i64).max(0) as usize)
        };
        let (x0, x1) = clip(samples_between(a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x)), 0, self.width);
        let (y0, y1) = clip(rows_of(corners), self.top, self.rows());
        if x0 >= x1 || y0 >= y1 {
            return;
        }
        let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
        let scale = 1.0 / area.unsigned_abs() as f64;
        // Depth is a's plus the other two corners' weights: a true interpolation, never beyond them.
        let (to_b, to_c) = (f64::from(b.z - a.z) * scale, f64::from(c.z - a.z) * scale);
        for y in y0..y1 {
            let start = (y - self.top) * self.width;
            let mut w = edges.map(|e| e.at(x0, y));
            for x in x0..x1 {
                if w.iter().zip(&edges).all(|(w, e)| *w >= e.least) {
                    let z = (f64::from(a.z) + to_b * w[1] as f64 + to_c * w[2] as f64) as f32;
                    let kept = keep.is_none_or(|k| k.keeps(x as f64 + 0.5, y as f64 + 0.5, f64::from(z)));
                    if kept && z < self.depth[start + x] {
                        self.depth[start + x] = z;
                        self.seen[start + x] = look(x, y);
                    }
                }
                for (w, e) in w.iter_mut().zip(&edges) {
                    *w -= e.dy * i64::from(STEPS);
                }
            }
        }
    }

    /// Closes the cut: a sample shows what `cap` makes of what it has shown so far, at (x, y), and lies in the
    /// plane then.
    pub(super) fn cap(&mut self, plane: &HalfSpace, cap: impl Fn(&S, usize, usize) -> Option<S>) {
        for (i, (seen, depth)) in self.seen.iter_mut().zip(&mut self.depth).enumerate() {
            let (x, y) = (i % self.width, self.top + i / self.width);
            if let Some(capped) = cap(seen, x, y)
                && let Some(at) = plane.plane_depth(x as f64 + 0.5, y as f64 + 0.5)
            {
                *seen = capped;
                *depth = at as f32;
            }
        }
    }

    /// Draws a line of `radius` samples from `a` to `b` (projected points) where it is not hidden,
    /// into rows `rows`. The band must reach beyond them by `radius` + 1 rows where the picture does.
    pub(super) fn line(
        &mut self,
        look: S,
        [a, b]: [DVec3; 2],
        radius: f64,
        rows: std::ops::Range<usize>,
        keep: Option<&HalfSpace>,
    ) {
        let d = b - a;
        let length2 = d.x * d.x + d.y * d.y;
        let y0 = ((a.y.min(b.y) - radius).floor().max(rows.start as f64)) as usize;
        let y1 = (a.y.max(b.y) + radius).ceil().clamp(0.0, rows.end as f64) as usize;
        for y in y0..y1 {
            let centre = y as f64 + 0.5;
            // The axis comes within reach of this row only near it: look at that stretch.
            let (ta, tb) = if d.y.abs() > 1e-9 {
                let t = [centre - radius, centre + radius].map(|v| ((v - a.y) / d.y).clamp(0.0, 1.0));
                (t[0].min(t[1]), t[0].max(t[1]))
            } else {
                (0.0, 1.0)
            };
            let ends = [a.x + ta * d.x, a.x + tb * d.x];
            let x0 = (ends[0].min(ends[1]) - radius).floor().max(0.0) as usize;
            let x1 = (ends[0].max(ends[1]) + radius).ceil().clamp(0.0, self.width as f64) as usize;
            for x in x0..x1 {
                let (px, py) = (x as f64 + 0.5 - a.x, centre - a.y);
                let t = if length2 > 0.0 { ((px * d.x + py * d.y) / length2).clamp(0.0, 1.0) } else { 0.0 };
                let off = [px - t * d.x, py - t * d.y];
                if off[0] * off[0] + off[1] * off[1] > radius * radius {
                    continue;
                }
                // Visibility is asked on the axis, so a line keeps its width on a steep surface.
                let axis = a + t * d;
                let kept = keep.is_none_or(|k| {
                    k.plane_depth(axis.x, axis.y)
                        .map_or(k.keeps(axis.x, axis.y, axis.z), |z| axis.z >= z - f64::from(LINE_BIAS))
                });
                if kept && axis.z as f32 - LINE_BIAS <= self.farthest_near(axis.x, axis.y) {
                    self.seen[(y - self.top) * self.width + x] = look;
                }
            }
        }
    }

    /// The greatest depth at the sample that contains a point and its four neighbours.
    fn farthest_near(&self, x: f64, y: f64) -> f32 {
        let (x, y) = (x.floor() as i64, y.floor() as i64);
        let mut farthest = f32::NEG_INFINITY;
        for (dx, dy) in [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)] {
            let x = (x + dx).clamp(0, self.width as i64 - 1) as usize;
            let y = (y + dy - self.top as i64).clamp(0, self.rows() as i64 - 1) as usize;
            farthest = farthest.max(self.depth[y * self.width + x]);
        }
        farthest
    }
}

/// An edge function: twice the area that a sample's centre spans with the edge.
#[derive(Clone, Copy)]
struct Edge {
    from: Corner,
    dx: i64,
    dy: i64,
    /// The least value that counts as inside: 0 if the edge owns the samples on it, else 1. Of the two
    /// triangles at an edge, which run through it in opposite directions, one owns them.
    least: i64,
}

impl Edge {
    fn new(p: Corner, q: Corner) -> Self {
        let (dx, dy) = (i64::from(q.x) - i64::from(p.x), i64::from(q.y) - i64::from(p.y));
        let owns = dy > 0 || (dy == 0 && dx > 0);
        Self { from: p, dx, dy, least: i64::from(!owns) }
    }

    fn at(&self, x: usize, y: usize) -> i64 {
        let centre = |v: usize| v as i64 * i64::from(STEPS) + i64::from(STEPS) / 2;
        self.dx * (centre(y) - i64::from(self.from.y)) - self.dy * (centre(x) - i64::from(self.from.x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner(x: f64, y: f64, z: f64) -> Corner {
        Corner::new(DVec3::new(x, y, z))
    }

    #[test]
    fn a_fan_covers_every_sample_once_even_through_sample_centres() {
        // Eight corners on a square, all on sample centres, around a centre that is one, too.
        let ring = [(0, 0), (4, 0), (8, 0), (8, 4), (8, 8), (4, 8), (0, 8), (0, 4)]
            .map(|(x, y)| corner(f64::from(x) + 0.5, f64::from(y) + 0.5, 0.0));
        let hub = corner(3.5, 5.5, 0.0);
        let mut count = vec![0; 100];
        for k in 0..8 {
            let mut band = Band::new(10, 0, 10, 0);
            band.triangle([hub, ring[k], ring[(k + 1) % 8]], None, |_, _| 1);
            for (n, seen) in count.iter_mut().zip(&band.seen) {
                *n += i32::from(*seen == 1);
            }
        }
        assert!(count.iter().all(|n| *n <= 1));
        for y in 1..8 {
            for x in 1..8 {
                assert_eq!(count[y * 10 + x], 1, "sample {x} {y}");
            }
        }
    }

    #[test]
    fn the_nearer_triangle_is_seen_in_any_order_and_lines_behind_it_are_not() {
        let near = [corner(0.0, 0.0, 1.0), corner(0.0, 20.0, 1.0), corner(20.0, 0.0, 1.0)];
        let far = [corner(0.0, 0.0, 9.0), corner(20.0, 0.0, 9.0), corner(0.0, 20.0, 9.0)];
        for order in [[0, 1], [1, 0]] {
            let mut band = Band::new(10, 0, 10, 9);
            for id in order {
                band.triangle([near, far][id], None, |_, _| id);
            }
            assert!(band.row(5).iter().all(|s| *s == 0));
            band.line(3, [DVec3::new(0.0, 5.5, 9.0), DVec3::new(9.0, 5.5, 9.0)], 0.6, 0..10, None);
            assert!(band.row(5).iter().all(|s| *s == 0));
            band.line(3, [DVec3::new(0.0, 5.5, 1.0), DVec3::new(9.5, 5.5, 1.0)], 0.6, 0..10, None);
            assert!(band.row(5).iter().all(|s| *s == 3));
            assert!(band.row(6).iter().all(|s| *s == 0));
        }
        assert!(signed_area(near) < 0 && signed_area(far) > 0);
    }
}
