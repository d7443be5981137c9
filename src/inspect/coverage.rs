//! The exact share of each material in the cells of a slice of a fine grid, from the closed mesh.
//!
//! Method: along a row of cells in the direction of x, the material changes where the row meets a triangle. Every
//! triangle is cut by the planes of the grid into parts that lie in one cell each. A part whose projection on the
//! plane across the row is A takes A from the share of the material before it in all cells further along, and
//! in its own cell A times what lies behind it; the material after it gains as much. Summed over a closed
//! mesh, that is the exact volume of each material in each cell: no sampling, and a plane
//! along the row costs nothing in accuracy. What is in no other material is background.

use glam::DVec3;

use super::by_slice::BySlice;
use crate::grid::{MaterialId, Pair};

/// How far shares may be from 0 at a row's end; rounding is a million times smaller.
const CLOSED: f64 = 1e-6;

/// The mesh in the cells of the fine grid; cell i goes from i to i + 1.
pub(super) struct FineMesh<'a> {
    pub(super) positions: &'a [DVec3],
    pub(super) triangles: &'a [[u32; 3]],
    pub(super) pairs: &'a [Pair],
    /// -1 where the lattice's axes are left-handed, so that triangles seem to be wound the other way; else 1.
    pub(super) sign: f64,
    /// Which triangles reach into which slice of the grid.
    pub(super) by_slice: &'a BySlice,
    /// Cells along x and y.
    pub(super) size: [usize; 2],
    pub(super) materials: usize,
}

/// A part of a triangle in one cell.
struct Part {
    row: u32,
    cell: u32,
    pair: Pair,
    /// Signed area across the row.
    area: f64,
    /// That times the mean length of the cell behind it.
    share: f64,
}

/// A polygon in the making.
type Polygon = Vec<DVec3>;

/// Cuts a polygon by the plane `axis = value`: what is below, what is above.
fn cut(polygon: &[DVec3], axis: usize, value: f64, below: &mut Polygon, above: &mut Polygon) {
    below.clear();
    above.clear();
    for (i, &p) in polygon.iter().enumerate() {
        let q = polygon[(i + 1) % polygon.len()];
        let (dp, dq) = (p[axis] - value, q[axis] - value);
        if dp <= 0.0 {
            below.push(p);
        }
        if dp >= 0.0 {
            above.push(p);
        }
        if dp * dq < 0.0 {
            // From the lower end, so that both triangles at an edge get the same point.
            let (low, high, d) = if dp < 0.0 { (p, q, -dp) } else { (q, p, -dq) };
            let mut at = low + (high - low) * (d / (high[axis] - low[axis]));
            at[axis] = value;
            below.push(at);
            above.push(at);
        }
    }
}

/// Calls `take` with the part of a polygon in each layer of cells along an axis, within `0..limit`; what lies
/// below goes into the first, what lies above is dropped.
fn slices(polygon: &Polygon, axis: usize, limit: usize, mut take: impl FnMut(usize, &Polygon)) {
    let low = polygon.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
    let high = polygon.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
    let first = low.floor().clamp(0.0, limit as f64) as usize;
    let last = (high.ceil().clamp(0.0, limit as f64) as usize).max(first + 1);
    if first >= limit {
        return;
    }
    if last == first + 1 {
        take(first, polygon);
        return;
    }
    let (mut rest, mut below, mut above) = (polygon.clone(), Polygon::new(), Polygon::new());
    for cell in first..last {
        cut(&rest, axis, (cell + 1) as f64, &mut below, &mut above);
        if below.len() > 2 {
            take(cell, &below);
        }
        std::mem::swap(&mut rest, &mut above);
        if rest.len() < 3 {
            return;
        }
    }
}

impl FineMesh<'_> {
    /// All parts of triangles in slice `z`, row by row, along each.
    fn parts(&self, z: usize) -> Vec<Part> {
        let mut out = Vec::new();
        let (mut below, mut slab, mut scrap) = (Polygon::new(), Polygon::new(), Polygon::new());
        for &t in self.by_slice.of(z) {
            let pair = self.pairs[t as usize];
            let corners = self.triangles[t as usize].map(|v| self.positions[v as usize]);
            cut(&corners, 2, (z + 1) as f64, &mut below, &mut scrap);
            cut(&below, 2, z as f64, &mut scrap, &mut slab);
            if slab.len() < 3 {
                continue;
            }
            slices(&slab, 1, self.size[1], |row, polygon| {
                slices(polygon, 0, self.size[0], |cell, polygon| {
                    let (mut area, mut share) = (0.0, 0.0);
                    let a = polygon[0];
                    for two in polygon[1..].windows(2) {
                        let (b, c) = (two[0], two[1]);
                        let part = 0.5 * ((b.y - a.y) * (c.z - a.z) - (b.z - a.z) * (c.y - a.y));
                        area += part;
                        share += part * ((cell + 1) as f64 - (a.x + b.x + c.x) / 3.0).min(1.0);
                    }
                    if area != 0.0 || share != 0.0 {
                        let (row, cell) = (row as u32, cell as u32);
                        out.push(Part { row, cell, pair, area: self.sign * area, share: self.sign * share });
                    }
                });
            });
        }
        // Stable: parts of one cell stay in the order of triangles.
        out.sort_by_key(|part| (part.row, part.cell));
        out
    }

    /// Calls `run(row, cells, shares)` for runs of cells of slice `z` with the same shares of all materials, row by
    /// row. Shares add up to 1. Rows of nothing but background are one run.
    ///
    /// # Errors
    /// The row and the material that is still there at its end: the mesh is not closed.
    pub(super) fn runs(
        &self,
        z: usize,
        mut run: impl FnMut(usize, std::ops::Range<usize>, &[f64]),
    ) -> Result<(), (usize, MaterialId)> {
        let parts = self.parts(z);
        let mut rest = &parts[..];
        let (mut now, mut here) = (vec![0.0; self.materials], vec![0.0; self.materials]);
        let with_background = |shares: &[f64], out: &mut Vec<f64>| {
            out.clear();
            out.extend_from_slice(shares);
            out[0] = 1.0 - shares[1..].iter().sum::<f64>();
        };
        let mut full = Vec::with_capacity(self.materials);
        for row in 0..self.size[1] {
            now.fill(0.0);
            let mut at = 0;
            while let Some(part) = rest.first().filter(|part| part.row as usize == row) {
                let cell = part.cell as usize;
                if cell > at {
                    with_background(&now, &mut full);
                    run(row, at..cell, &full);
                }
                here.copy_from_slice(&now);
                while let Some(part) =
                    rest.first().filter(|p| (p.row as usize, p.cell as usize) == (row, cell))
                {
                    for (id, sign) in [(part.pair.back(), -1.0), (part.pair.front(), 1.0)] {
                        let k = usize::from(id.0);
                        if k < self.materials {
                            here[k] += sign * part.share;
                            now[k] += sign * part.area;
                        }
                    }
                    rest = &rest[1..];
                }
                with_background(&here, &mut full);
                run(row, cell..cell + 1, &full);
                at = cell + 1;
            }
            if at < self.size[0] {
                with_background(&now, &mut full);
                run(row, at..self.size[0], &full);
            }
            if let Some(left) = (1..self.materials).find(|&k| now[k].abs() > CLOSED) {
                return Err((row, MaterialId(left as u8)));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(low: DVec3, high: DVec3, turn: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let middle = 0.5 * (low + high);
        let (s, c) = (libm::sin(turn), libm::cos(turn));
        let corner = |i: usize| {
            let p = DVec3::from([0, 1, 2].map(|a| if i >> a & 1 == 1 { high[a] } else { low[a] })) - middle;
            middle + DVec3::new(c * p.x - s * p.y, s * p.x + c * p.y, p.z)
        };
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]);
        ((0..8).map(corner).collect(), triangles.collect())
    }

    fn total(positions: &[DVec3], triangles: &[[u32; 3]]) -> Result<f64, (usize, MaterialId)> {
        let pairs = vec![Pair::new(MaterialId(1), MaterialId(0)).unwrap(); triangles.len()];
        let z = |t: &[u32; 3]| {
            let z = t.map(|v| positions[v as usize].z - 0.5);
            [z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2])]
        };
        let by_slice = BySlice::new(12, 0.0, triangles.iter().map(z));
        let fine = FineMesh {
            positions,
            triangles,
            pairs: &pairs,
            sign: 1.0,
            by_slice: &by_slice,
            size: [14, 13],
            materials: 2,
        };
        let mut sum = 0.0;
        for z in 0..12 {
            fine.runs(z, |_, cells, shares| {
                assert!((-1e-9..1.0 + 1e-9).contains(&shares[1]), "{shares:?}");
                sum += cells.len() as f64 * shares[1];
            })?;
        }
        Ok(sum)
    }

    #[test]
    fn shares_of_a_block_add_up_to_its_volume_in_any_direction() {
        for turn in [0.0, 0.3, 0.785, 1.4] {
            let (low, high) = (DVec3::new(3.2, 4.1, 2.7), DVec3::new(9.9, 8.35, 10.4));
            let (positions, triangles) = block(low, high, turn);
            let sum = total(&positions, &triangles).unwrap();
            assert!((sum - (high - low).element_product()).abs() < 1e-9, "{turn}: {sum}");
        }
        // On the grid's own planes.
        let (positions, triangles) = block(DVec3::splat(3.0), DVec3::splat(7.0), 0.0);
        assert!((total(&positions, &triangles).unwrap() - 64.0).abs() < 1e-9);
    }

    #[test]
    fn a_hole_is_noticed() {
        let (positions, mut triangles) = block(DVec3::splat(3.2), DVec3::splat(9.1), 0.2);
        triangles.pop();
        assert_eq!(total(&positions, &triangles).unwrap_err().1, MaterialId(1));
    }
}
