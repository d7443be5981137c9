//! The one numbering of a cell: a cube between eight neighbouring voxel centres.
//!
//! ```text
//!        6────────7        corner c sits at x = bit 0, y = bit 1, z = bit 2 of c
//!       ╱│       ╱│
//!      4─┼──────5 │        edge 4·axis + k runs along `axis`; k counts the edges by the two
//!      │ │      │ │        other coordinates, the lower axis first
//!      │ 2──────┼─3
//!      │╱       │╱         face 2·axis + s lies at coordinate s of `axis`
//!      0────────1
//! ```

/// Corners of a cell.
pub const CORNERS: usize = 8;
/// Edges of a cell.
pub const EDGES: usize = 12;
/// Faces of a cell.
pub const FACES: usize = 6;

/// Offset of corner `c` from the cell's lowest corner, per axis.
#[must_use]
pub const fn corner_offset(c: usize) -> [usize; 3] {
    [c & 1, (c >> 1) & 1, (c >> 2) & 1]
}

/// Lattice point at corner `c` of the cell whose lowest corner is `low`.
#[must_use]
pub const fn corner_at(low: [usize; 3], c: usize) -> [usize; 3] {
    let offset = corner_offset(c);
    [low[0] + offset[0], low[1] + offset[1], low[2] + offset[2]]
}

/// The two axes other than `axis`, ascending.
#[must_use]
pub const fn other_axes(axis: usize) -> [usize; 2] {
    match axis {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    }
}

/// Axis along which edge `e` runs.
#[must_use]
pub const fn edge_axis(e: usize) -> usize {
    e / 4
}

/// The two corners of edge `e`, the one with the lower coordinate first.
#[must_use]
pub const fn edge_corners(e: usize) -> [usize; 2] {
    let axis = e / 4;
    let [a, b] = other_axes(axis);
    let low = ((e & 1) << a) | (((e >> 1) & 1) << b);
    [low, low | (1 << axis)]
}

/// Edge between corners `p` and `q`, which must differ in exactly one coordinate.
#[must_use]
pub const fn edge_between(p: usize, q: usize) -> usize {
    let axis = (p ^ q).trailing_zeros() as usize;
    let [a, b] = other_axes(axis);
    4 * axis + ((p >> a) & 1) + 2 * ((p >> b) & 1)
}

/// The four corners of face `f` in ring order, counter-clockwise seen along the *positive* axis
/// direction from below; entry 0 is the corner with the lowest coordinates.
#[must_use]
pub const fn face_ring(f: usize) -> [usize; 4] {
    let axis = f / 2;
    let [a, b] = other_axes(axis);
    let base = (f & 1) << axis;
    [base, base | (1 << a), base | (1 << a) | (1 << b), base | (1 << b)]
}

/// The two faces that share edge `e`.
#[must_use]
pub const fn edge_faces(e: usize) -> [usize; 2] {
    let [a, b] = other_axes(e / 4);
    [2 * a + (e & 1), 2 * b + ((e >> 1) & 1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_edge_lies_on_its_two_faces_and_joins_its_two_corners() {
        for e in 0..EDGES {
            let [p, q] = edge_corners(e);
            assert_eq!((p ^ q).count_ones(), 1);
            assert_eq!(edge_between(p, q), e);
            for f in edge_faces(e) {
                let ring = face_ring(f);
                assert!(ring.contains(&p) && ring.contains(&q));
            }
        }
        for f in 0..FACES {
            let ring = face_ring(f);
            for k in 0..4 {
                let e = edge_between(ring[k], ring[(k + 1) % 4]);
                assert!(edge_faces(e).contains(&f));
            }
        }
    }
}
