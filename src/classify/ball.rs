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

    /// Every plane dilated by the ball: a voxel is set where any voxel of the ball around it is.
    /// Voxels beyond the volume count as not set. Halo: [`Ball::reach`].
    #[must_use]
    pub fn dilate(&self, planes: &BitPlanes) -> BitPlanes {
        let padded = planes.padded();
        let words = planes.words();
        let occupied = occupied_rows(planes);
        let mut out = BitPlanes::new(padded.map(|n| n - 2), planes.count());
        let masks: Vec<u64> = (0..words).map(|w| planes.voxel_mask(w)).collect();
        out.fill_slices(|z, mut slice| {
            let mut wide = vec![0u64; words];
            let mut scratch = vec![0u64; words];
            for plane in 0..planes.count() {
                for y in 1..padded[1] - 1 {
                    wide.fill(0);
                    let mut any = false;
                    for rows in self.by_half_chord.iter().rev() {
                        if any {
                            widen(&wide, &mut scratch);
                            std::mem::swap(&mut wide, &mut scratch);
                        }
                        for &(dy, dz) in rows {
                            let (Some(y), Some(z)) = (y.checked_add_signed(dy), z.checked_add_signed(dz))
                            else {
                                continue;
                            };
                            if y < padded[1]
                                && z < padded[2]
                                && occupied[(z * planes.count() + plane) * padded[1] + y]
                            {
                                any = true;
                                for (a, b) in wide.iter_mut().zip(planes.row(plane, y, z)) {
                                    *a |= b;
                                }
                            }
                        }
                    }
                    if any {
                        for ((out, wide), mask) in slice.row(plane, y).iter_mut().zip(&wide).zip(&masks) {
                            *out = wide & mask;
                        }
                    }
                }
            }
        });
        out
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
    let padded = planes.padded();
    (0..padded[2])
        .into_par_iter()
        .flat_map_iter(|z| {
            (0..planes.count())
                .flat_map(move |p| (0..padded[1]).map(move |y| planes.row(p, y, z).iter().any(|&w| w != 0)))
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
            let out = Ball::new(radius).dilate(&planes);
            for z in 0..size[2] + 2 {
                for y in 0..size[1] + 2 {
                    for x in 0..size[0] + 2 {
                        let voxel = [x, y, z].iter().zip(size).all(|(&c, n)| c >= 1 && c <= n);
                        let near = |&(sx, sy, sz): &(usize, usize, usize)| {
                            let d = [(x, sx), (y, sy), (z, sz)];
                            (0..3).map(|a| ((d[a].0 as f64 - 1.0 - d[a].1 as f64) / radius[a]).powi(2)).sum::<f64>() <= 1.0 + 1e-9
                        };
                        prop_assert_eq!(out.bit(1, x, y, z), voxel && seeds.iter().any(near));
                        prop_assert!(!out.bit(0, x, y, z));
                    }
                }
            }
        }
    }
}
