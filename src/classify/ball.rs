//! Balls of voxels, and dilation by them.
//!
//! A dilation by a ball is, row by row, the union of the neighbouring rows, each widened by the
//! half-chord that the ball has there. Rows with the same half-chord are united first; and since
//! widening by h is widening by one h times, a single sweep from the longest half-chord to the
//! shortest widens every group by its own (Fujimori and Suzuki §3.1 define the spheres; the sweep
//! is ours).

use super::bit_planes::{BitPlanes, WORD};

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

    /// Its voxels, as offsets (x, y, z) from the centre.
    pub fn offsets(&self) -> impl Iterator<Item = [isize; 3]> {
        let chords = self.by_half_chord.iter().zip(0..);
        let rows = chords.flat_map(|(rows, half)| rows.iter().map(move |&(y, z)| ([y, z], half)));
        rows.flat_map(|([y, z], half): (_, isize)| (-half..=half).map(move |x| [x, y, z]))
    }

    /// Number of voxels.
    #[must_use]
    pub fn voxels(&self) -> usize {
        self.by_half_chord.iter().enumerate().map(|(h, rows)| (2 * h + 1) * rows.len()).sum()
    }
}

/// Words of a row that are dilated together: they fit in registers.
const CHUNK: usize = 8;

/// Bit planes dilated by a ball, a row at a time: a voxel is set where any voxel of the ball around
/// it is. Voxels beyond the volume, and slices that the planes do not hold, count as not set.
/// Halo: [`Ball::reach`], along x less than 64.
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
        debug_assert!(ball.reach()[0] < WORD);
        Self { planes, ball, occupied: occupied_rows(planes) }
    }

    /// Writes row (y, z) of a dilated plane, in padded coordinates, to `out`, where a bit of `wanted` is set or
    /// nearby; the rest of `out`, and bits at the points of `OUTSIDE`, are not to be relied on.
    // Inlined into the callers' loops over slices, so that these can be compiled for wide registers.
    #[inline(always)]
    pub fn row(&self, plane: usize, y: usize, z: usize, wanted: &[u64], out: &mut [u64]) {
        let mut first = 0;
        while first < out.len() {
            let count = CHUNK.min(out.len() - first);
            let out = &mut out[first..first + count];
            if wanted[first..first + count].iter().all(|&w| w == 0) {
                out.fill(0);
            } else {
                match count {
                    8 => self.chunk::<8>(plane, y, z, first, out),
                    7 => self.chunk::<7>(plane, y, z, first, out),
                    6 => self.chunk::<6>(plane, y, z, first, out),
                    5 => self.chunk::<5>(plane, y, z, first, out),
                    4 => self.chunk::<4>(plane, y, z, first, out),
                    3 => self.chunk::<3>(plane, y, z, first, out),
                    2 => self.chunk::<2>(plane, y, z, first, out),
                    _ => self.chunk::<1>(plane, y, z, first, out),
                }
            }
            first += count;
        }
    }

    /// `C` words of a dilated row, from word `first` on.
    #[inline(always)]
    fn chunk<const C: usize>(&self, plane: usize, y: usize, z: usize, first: usize, out: &mut [u64]) {
        let (rows, held, words) = (self.planes.padded()[1], self.planes.slices(), self.planes.words());
        let mut here = [0u64; C];
        // The words before and after: a ball reaches no further.
        let (mut before, mut after) = (0u64, 0u64);
        let mut any = false;
        for group in self.ball.by_half_chord.iter().rev() {
            if any {
                let now = here;
                for i in 0..C {
                    let left = if i > 0 { now[i - 1] } else { before };
                    let right = if i + 1 < C { now[i + 1] } else { after };
                    here[i] = now[i] | now[i] << 1 | now[i] >> 1 | left >> 63 | right << 63;
                }
                before |= before << 1 | before >> 1 | now[0] << 63;
                after |= after << 1 | after >> 1 | now[C - 1] >> 63;
            }
            for &(dy, dz) in group {
                let (y, z) = (y.wrapping_add_signed(dy), z.wrapping_add_signed(dz));
                if y < rows
                    && held.contains(&z)
                    && self.occupied[((z - held.start) * self.planes.count() + plane) * rows + y]
                {
                    any = true;
                    let row = self.planes.row(plane, y, z);
                    for (a, b) in here.iter_mut().zip(&row[first..first + C]) {
                        *a |= b;
                    }
                    if first > 0 {
                        before |= row[first - 1];
                    }
                    if first + C < words {
                        after |= row[first + C];
                    }
                }
            }
        }
        out.copy_from_slice(&here);
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
            size in [1usize..700, 1usize..9, 1usize..9],
            radius in [0.3f64..6.0, 0.3f64..4.0, 0.3f64..4.0],
            seeds in proptest::collection::vec((0usize..700, 0usize..9, 0usize..9), 0..6),
        ) {
            let mut planes = BitPlanes::new(size, 2);
            let seeds: Vec<_> = seeds.iter().map(|s| (s.0 % size[0], s.1 % size[1], s.2 % size[2])).collect();
            for &(x, y, z) in &seeds {
                planes.row_mut(1, y + 1, z + 1)[(x + 1) / 64] |= 1 << ((x + 1) % 64);
            }
            let ball = Ball::new(radius);
            let dilation = Dilation::new(&planes, &ball);
            let (mut out, all) = (vec![0; planes.words()], vec![u64::MAX; planes.words()]);
            for z in 1..=size[2] {
                for y in 1..=size[1] {
                    dilation.row(0, y, z, &all, &mut out);
                    prop_assert!(out.iter().all(|&w| w == 0));
                    dilation.row(1, y, z, &all, &mut out);
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
