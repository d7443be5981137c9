//! Balls of voxels, and dilation by them.
//!
//! A dilation by a ball is, row by row, the union of the neighbouring rows, each widened by the
//! half-chord that the ball has there. Rows with the same half-chord are united first; and since
//! widening by h is widening by one h times, a single sweep from the longest half-chord to the
//! shortest widens every group by its own (Fujimori and Suzuki §3.1 define the spheres; the sweep
//! is ours).

use super::bit_planes::BitPlanes;

/// A ball of voxels: in the world a sphere, on an anisotropic lattice an ellipsoid.
#[derive(Debug, Clone, PartialEq)]
pub struct Ball {
    radius: [f64; 3],
    /// Row offsets (dy, dz) by half-chord.
    by_half_chord: Vec<Vec<(isize, isize)>>,
}

impl Ball {
    /// The voxels whose offset (x, y, z) from the centre has `sum (offset / radius)² <= 1`;
    /// `radius` in voxels per axis. A radius below one voxel leaves no neighbour along its axis.
    #[must_use]
    pub fn new(radius: [f64; 3]) -> Self {
        // Offsets exactly on the sphere are inside, whatever the rounding.
        const TOLERANCE: f64 = 1e-9;
        let reach = |a: usize| (radius[a] + TOLERANCE).floor().max(0.0) as isize;
        let part = |a: usize, d: isize| if d == 0 { 0.0 } else { (d as f64 / radius[a]).powi(2) };
        let mut by_half_chord = vec![Vec::new(); reach(0) as usize + 1];
        for dz in -reach(2)..=reach(2) {
            for dy in -reach(1)..=reach(1) {
                let rest = 1.0 + TOLERANCE - part(1, dy) - part(2, dz);
                if rest >= 0.0 {
                    let half_chord = (0..=reach(0)).rev().find(|&dx| part(0, dx) <= rest).unwrap_or(0);
                    by_half_chord[half_chord as usize].push((dy, dz));
                }
            }
        }
        Self { radius, by_half_chord }
    }

    /// Radius in voxels per axis.
    #[must_use]
    pub fn radius(&self) -> [f64; 3] {
        self.radius
    }

    /// How far the ball reaches from its centre, in voxels per axis.
    #[must_use]
    pub fn reach(&self) -> [usize; 3] {
        let far = |pick: fn(&(isize, isize)) -> isize| {
            self.by_half_chord.iter().flatten().map(|o| pick(o).unsigned_abs()).max().unwrap_or(0)
        };
        [self.by_half_chord.len() - 1, far(|o| o.0), far(|o| o.1)]
    }

    /// Number of voxels.
    #[must_use]
    pub fn voxels(&self) -> usize {
        self.by_half_chord.iter().enumerate().map(|(h, rows)| (2 * h + 1) * rows.len()).sum()
    }
}

/// Bit planes dilated by a ball, a row at a time: a voxel is set where any voxel of the ball around
/// it is. Voxels beyond the volume, and slices that the planes do not hold, count as not set.
/// Halo: [`Ball::reach`].
pub struct Dilation<'a> {
    planes: &'a BitPlanes,
    ball: &'a Ball,
    /// Which rows have any bit, in the order slice, plane, row.
    occupied: Vec<bool>,
}

impl<'a> Dilation<'a> {
    /// The dilation of `planes` by `ball`.
    #[must_use]
    pub fn new(planes: &'a BitPlanes, ball: &'a Ball) -> Self {
        Self { planes, ball, occupied: occupied_rows(planes) }
    }

    /// Writes row (y, z) of a dilated plane, in padded coordinates, to `out`; bits at the points of
    /// `OUTSIDE` are not to be relied on. `scratch` is as long as `out`. Returns whether any bit is set.
    pub fn row(&self, plane: usize, y: usize, z: usize, out: &mut [u64], scratch: &mut [u64]) -> bool {
        let (rows, held) = (self.planes.padded()[1], self.planes.slices());
        out.fill(0);
        let mut any = false;
        for group in self.ball.by_half_chord.iter().rev() {
            if any {
                widen(out, scratch);
                out.copy_from_slice(scratch);
            }
            for &(dy, dz) in group {
                let (y, z) = (y.wrapping_add_signed(dy), z.wrapping_add_signed(dz));
                if y < rows
                    && held.contains(&z)
                    && self.occupied[((z - held.start) * self.planes.count() + plane) * rows + y]
                {
                    any = true;
                    for (a, b) in out.iter_mut().zip(self.planes.row(plane, y, z)) {
                        *a |= b;
                    }
                }
            }
        }
        any
    }
}

/// Widens a row by one bit on both sides.
fn widen(row: &[u64], out: &mut [u64]) {
    let n = row.len();
    for w in 0..n {
        let before = if w > 0 { row[w - 1] >> 63 } else { 0 };
        let after = if w + 1 < n { row[w + 1] << 63 } else { 0 };
        out[w] = row[w] | row[w] << 1 | row[w] >> 1 | before | after;
    }
}

/// Which rows have any bit, in the order slice, plane, row.
fn occupied_rows(planes: &BitPlanes) -> Vec<bool> {
    use rayon::prelude::*;
    let rows = planes.padded()[1];
    planes
        .slices()
        .into_par_iter()
        .flat_map_iter(|z| {
            (0..planes.count())
                .flat_map(move |p| (0..rows).map(move |y| planes.row(p, y, z).iter().any(|&w| w != 0)))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_ball_holds_the_voxels_within_its_radius() {
        assert_eq!(Ball::new([0.5; 3]).voxels(), 1);
        assert_eq!(Ball::new([1.0; 3]).voxels(), 7);
        assert_eq!(Ball::new([3.0; 3]).voxels(), 123);
        assert_eq!(Ball::new([3.0, 3.0, 1.5]).reach(), [3, 3, 1]);
    }

    proptest! {
        #[test]
        fn dilation_is_what_a_plain_loop_over_the_ball_gives(
            size in [1usize..70, 1usize..9, 1usize..9],
            radius in [0.3f64..6.0, 0.3f64..4.0, 0.3f64..4.0],
            seeds in proptest::collection::vec((0usize..70, 0usize..9, 0usize..9), 0..6),
        ) {
            let mut planes = BitPlanes::new(size, 2);
            let seeds: Vec<_> = seeds.iter().map(|s| (s.0 % size[0], s.1 % size[1], s.2 % size[2])).collect();
            for &(x, y, z) in &seeds {
                planes.row_mut(1, y + 1, z + 1)[(x + 1) / 64] |= 1 << ((x + 1) % 64);
            }
            let ball = Ball::new(radius);
            let dilation = Dilation::new(&planes, &ball);
            let (mut out, mut scratch) = (vec![0; planes.words()], vec![0; planes.words()]);
            for z in 1..=size[2] {
                for y in 1..=size[1] {
                    prop_assert!(!dilation.row(0, y, z, &mut out, &mut scratch));
                    let any = dilation.row(1, y, z, &mut out, &mut scratch);
                    prop_assert_eq!(any, out.iter().any(|&w| w != 0));
                    for x in 1..=size[0] {
                        let near = |&(sx, sy, sz): &(usize, usize, usize)| {
                            let d = [(x, sx), (y, sy), (z, sz)];
                            (0..3).map(|a| ((d[a].0 as f64 - 1.0 - d[a].1 as f64) / radius[a]).powi(2)).sum::<f64>() <= 1.0 + 1e-9
                        };
                        prop_assert_eq!(out[x / 64] >> (x % 64) & 1 == 1, seeds.iter().any(near));
                    }
                }
            }
        }
    }
}
