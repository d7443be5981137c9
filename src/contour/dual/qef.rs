//! The quadratic error function of a vertex: sum of squared distances to the planes of its crossings.
//!
//! E(x) = sum w (n · (x - p))² (000_f7f54f44c17ac186 eq. 9). Kept as the Gram matrix of [A b], about a point near
//! by, in `f64`; merging adds. Its Cholesky factor is the triangular matrix that the QR method of eq. 12
//! and 13 gives, but for signs, so minimum and residual are the same; the tests compare them.

use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// Eigenvalues under this part of the largest are left out: what is flat within noise stays flat.
const CUTOFF: f64 = 0.1;
/// But none over this one: a few planes across a large face are an edge, however many lie in the face. The
/// sum of squares that one plane across gives; noise of a tenth of a voxel then moves the vertex by as much.
const CERTAIN: f64 = 1.0;

/// Planes of crossings, added up.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Qef {
    /// AᵀA.
    matrix: [f64; 6],
    /// Aᵀb.
    vector: DVec3,
    /// bᵀb.
    square: f64,
    /// Sum of the crossings' positions, and their number.
    sum: DVec3,
    count: f64,
}

/// Where a vertex may lie.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// Corners of its block.
    pub(super) bounds: [DVec3; 2],
    /// Coordinates that it must have, on the volume's border.
    pub(super) fixed: [Option<f64>; 3],
}

impl Place {
    /// Whether a point may be taken.
    pub(super) fn holds(&self, x: DVec3) -> bool {
        self.clamp(x) == x
    }

    /// The nearest point that may be taken.
    pub(super) fn clamp(&self, x: DVec3) -> DVec3 {
        let mut x = x.clamp(self.bounds[0], self.bounds[1]);
        for (a, fixed) in self.fixed.iter().enumerate() {
            if let Some(value) = fixed {
                x[a] = *value;
            }
        }
        x
    }
}

/// Where a vertex is put when the minimiser lies outside its block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Placement {
    /// At the best point of its block.
    #[default]
    Clamped,
    /// At the mean of its crossings, as the paper does.
    Paper,
}

impl Placement {
    /// The vertex of a QEF.
    pub(super) fn vertex(self, qef: &Qef, place: &Place) -> DVec3 {
        match self {
            Self::Clamped => qef.minimiser_within(place),
            Self::Paper => {
                let x = qef.minimiser_of(place);
                if place.holds(x) { x } else { place.clamp(qef.mass_point()) }
            }
        }
    }
}

impl Qef {
    /// Adds the plane through `through` with unit normal `normal`, `weight` times, of a crossing at `at`.
    #[inline]
    pub(super) fn add(&mut self, at: DVec3, through: DVec3, normal: DVec3, weight: f64) {
        let n = normal;
        let d = n.dot(through);
        let m = n * weight;
        let products = [m.x * n.x, m.x * n.y, m.x * n.z, m.y * n.y, m.y * n.z, m.z * n.z];
        self.matrix.iter_mut().zip(products).for_each(|(sum, p)| *sum += p);
        self.vector += m * d;
        self.square += weight * d * d;
        self.sum += at;
        self.count += 1.0;
    }

    /// Adds the planes of another one about the same point.
    #[inline]
    pub(super) fn merge(&mut self, other: &Self) {
        self.matrix.iter_mut().zip(other.matrix).for_each(|(sum, p)| *sum += p);
        self.vector += other.vector;
        self.square += other.square;
        self.sum += other.sum;
        self.count += other.count;
    }

    /// The same planes about a point that lies `offset` before this one.
    pub(super) fn shifted(&self, offset: DVec3) -> Self {
        let along = self.matrix() * offset;
        Self {
            vector: self.vector + along,
            square: self.square + 2.0 * offset.dot(self.vector) + offset.dot(along),
            sum: self.sum + offset * self.count,
            ..*self
        }
    }

    /// A lower bound of the error anywhere: its minimum, but for rounding.
    pub(super) fn least_error(&self) -> f64 {
        let matrix = self.matrix();
        // A plane across each axis, with little weight: it can be inverted, and the minimum falls.
        let ridge = 1e-9 * (matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z);
        let inverse = (matrix + DMat3::from_diagonal(DVec3::splat(ridge))).inverse();
        let mass = self.mass_point();
        let slope = self.slope(mass);
        let least = self.error(mass) - slope.dot(inverse * slope);
        if least.is_finite() { least * (1.0 - 1e-3) - 1e-3 } else { 0.0 }
    }

    /// AᵀA.
    pub(super) fn matrix(&self) -> DMat3 {
        let [xx, xy, xz, yy, yz, zz] = self.matrix;
        DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
    }

    /// The mean of the crossings.
    pub(super) fn mass_point(&self) -> DVec3 {
        self.sum / self.count.max(1.0)
    }

    /// Number of planes.
    pub(super) fn count(&self) -> f64 {
        self.count
    }

    /// The sum of squared distances at `x`, lengths squared.
    pub(super) fn error(&self, x: DVec3) -> f64 {
        (x.dot(self.matrix() * x) - 2.0 * x.dot(self.vector) + self.square).max(0.0)
    }

    /// Half the gradient of the error at `x`.
    pub(super) fn slope(&self, x: DVec3) -> DVec3 {
        self.matrix() * x - self.vector
    }

    /// How far the origin lies from a face that bends and has these planes, lengths. Where normals turn evenly, the
    /// face between two points leaves the tangent plane of either half as far as the other one's tangent plane does: the mean of the distances along
    /// the normals there and here.
    pub(super) fn beside(&self) -> f64 {
        let eigen = SymmetricEigen::new(Matrix3::from_column_slice(&self.matrix().to_cols_array()));
        let normal = DVec3::from_slice(eigen.eigenvectors.column(eigen.eigenvalues.imax()).as_slice());
        let there = normal.dot(self.vector) / eigen.eigenvalues.sum();
        0.5 * (there + normal.dot(self.mass_point())).abs()
    }

    /// The minimiser nearest to the mass point, also beyond the block.
    pub(super) fn minimiser_of(&self, place: &Place) -> DVec3 {
        let free = place.fixed.map(|f| f.is_none());
        let start = DVec3::from([0, 1, 2].map(|a| place.fixed[a].unwrap_or(self.mass_point()[a])));
        self.minimiser_in(free, start)
    }

    /// The minimiser in `place`: where it would lie beyond, it is clamped and the other coordinates are
    /// found again.
    pub(super) fn minimiser_within(&self, place: &Place) -> DVec3 {
        self.minimiser_near(self.mass_point(), place)
    }

    /// The same, but nearest to a point of one's own.
    pub(super) fn minimiser_near(&self, start: DVec3, place: &Place) -> DVec3 {
        let mut free = place.fixed.map(|f| f.is_none());
        let start = place.clamp(start);
        let mut x = start;
        // Each round but the last takes away an axis at least.
        for _ in 0..4 {
            x = self.minimiser_in(free, x);
            let inside = place.clamp(x);
            let beyond = inside.cmpne(x);
            x = inside;
            if !beyond.any() {
                break;
            }
            (0..3).for_each(|a| free[a] &= !beyond.test(a));
        }
        if self.error(x) <= self.error(start) { x } else { start }
    }

    /// The minimiser over the free coordinates, as near to `start` as small eigenvalues leave open.
    fn minimiser_in(&self, free: [bool; 3], start: DVec3) -> DVec3 {
        let mask = DVec3::from(free.map(|f| f64::from(u8::from(f))));
        let matrix = DMat3::from_diagonal(mask) * self.matrix() * DMat3::from_diagonal(mask);
        let slope = self.slope(start) * mask;
        start - Certain::new(&matrix).solve(slope)
    }
}

/// The directions in which planes say where a vertex lies: eigenvectors of eigenvalues that are not small.
#[derive(Debug, Clone, Copy)]
pub(super) struct Certain {
    vectors: [DVec3; 3],
    values: [f64; 3],
    count: usize,
}

impl Certain {
    /// Of AᵀA.
    pub(super) fn new(matrix: &DMat3) -> Self {
        Self::one(matrix).unwrap_or_else(|| Self::all(matrix))
    }

    /// The only one, where planes lie in one face, as most do: the sixteenth power of the matrix has nothing
    /// else left. `None` where there may be more.
    fn one(matrix: &DMat3) -> Option<Self> {
        let trace = matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z;
        let mut power = *matrix * (1.0 / trace);
        for _ in 0..4 {
            power = power * power;
        }
        let columns = [power.x_axis, power.y_axis, power.z_axis];
        let longest = columns.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))?;
        let vector = longest.normalize();
        let value = vector.dot(*matrix * vector);
        // No eigenvalue is larger than all others together; what is not a number is not found here.
        let found =
            trace - value <= least(value) && (*matrix * vector - vector * value).length() <= 1e-12 * value;
        found.then_some(Self { vectors: [vector; 3], values: [value; 3], count: 1 })
    }

    fn all(matrix: &DMat3) -> Self {
        let eigen = SymmetricEigen::new(Matrix3::from_column_slice(&matrix.to_cols_array()));
        let least = least(eigen.eigenvalues.max());
        let mut out = Self { vectors: [DVec3::ZERO; 3], values: [0.0; 3], count: 0 };
        for i in (0..3).filter(|&i| eigen.eigenvalues[i] > least) {
            out.vectors[out.count] = DVec3::from_slice(eigen.eigenvectors.column(i).as_slice());
            out.values[out.count] = eigen.eigenvalues[i];
            out.count += 1;
        }
        out
    }

    fn each(&self) -> impl Iterator<Item = (DVec3, f64)> {
        self.vectors.into_iter().zip(self.values).take(self.count)
    }

    /// Solves for a right-hand side along these directions.
    fn solve(&self, right: DVec3) -> DVec3 {
        self.each().map(|(vector, value)| vector * (vector.dot(right) / value)).sum()
    }

    /// The part of `d` that is left open.
    pub(super) fn leaves_open(&self, d: DVec3) -> DVec3 {
        d - self.each().map(|(vector, _)| vector * vector.dot(d)).sum::<DVec3>()
    }
}

/// Eigenvalues up to this one are small, beside the largest.
fn least(largest: f64) -> f64 {
    (CUTOFF * largest.max(0.0)).min(CERTAIN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    fn put(qef: &mut Qef, at: DVec3, normal: DVec3) {
        qef.add(at, at, normal, 1.0);
    }

    fn minimiser(qef: &Qef) -> DVec3 {
        qef.minimiser_of(&Place { bounds: [DVec3::MIN, DVec3::MAX], fixed: [None; 3] })
    }

    fn vector(r: f64) -> impl Strategy<Value = DVec3> {
        [-r..r, -r..r, -r..r].prop_map(DVec3::from)
    }

    fn planes() -> impl Strategy<Value = Vec<(DVec3, DVec3)>> {
        let normal = vector(1.0).prop_filter("long enough", |n| n.length() > 0.1);
        prop::collection::vec((vector(16.0), normal.prop_map(DVec3::normalize)), 3..40)
    }

    proptest! {
        #[test]
        fn the_gram_matrix_gives_what_qr_gives(planes in planes()) {
            let mut qef = Qef::default();
            planes.iter().for_each(|(p, n)| put(&mut qef, *p, *n));
            let rows = planes.len();
            let ab = DMatrix::from_fn(rows, 4, |i, j| {
                let (p, n) = planes[i];
                if j < 3 { n[j] } else { n.dot(p) }
            });
            // Eq. 12: upper triangle [A^ b^; 0 r].
            let r = ab.qr().r();
            prop_assume!((0..3).all(|i| r[(i, i)].abs() > 0.5));
            let a = r.view((0, 0), (3, 3)).into_owned();
            let x = a.solve_upper_triangular(&DVector::from_fn(3, |i, _| r[(i, 3)])).unwrap();
            let x = DVec3::new(x[0], x[1], x[2]);
            let residual = if rows > 3 { r[(3, 3)].powi(2) } else { 0.0 };
            prop_assert!((qef.error(x) - residual).abs() < 1e-8 * (1.0 + qef.square));
            if Certain::new(&qef.matrix()).count == 3 {
                prop_assert!(minimiser(&qef).distance(x) < 1e-7);
            }
        }

        #[test]
        fn one_direction_is_found_as_the_eigenvectors_tell(
            normal in vector(1.0).prop_filter("long enough", |n| n.length() > 0.1),
            off in prop::collection::vec(vector(0.3), 3..40),
        ) {
            let mut qef = Qef::default();
            off.iter().for_each(|o| put(&mut qef, DVec3::ZERO, (normal.normalize() + *o).normalize()));
            let (one, all) = (Certain::one(&qef.matrix()), Certain::all(&qef.matrix()));
            if let Some(one) = one {
                prop_assert_eq!(all.count, 1);
                prop_assert!((one.values[0] - all.values[0]).abs() < 1e-9 * all.values[0]);
                prop_assert!(one.vectors[0].dot(all.vectors[0]).abs() > 1.0 - 1e-12);
                prop_assert!(one.leaves_open(one.vectors[0]).length() < 1e-12);
            }
        }

        #[test]
        fn the_minimiser_stays_in_its_place_and_is_the_best_there(planes in planes(), fix in any::<[bool; 3]>()) {
            let mut qef = Qef::default();
            planes.iter().for_each(|(p, n)| put(&mut qef, *p, *n));
            let place = Place { bounds: [DVec3::splat(-2.0), DVec3::splat(2.0)], fixed: fix.map(|f| f.then_some(0.5)) };
            let x = qef.minimiser_within(&place);
            prop_assert_eq!(x, place.clamp(x));
            prop_assert!(qef.error(x) <= qef.error(place.clamp(qef.mass_point())) * (1.0 + 1e-9) + 1e-9);
        }
    }

    #[test]
    fn an_edge_is_found_however_large_one_of_its_faces() {
        let mut qef = Qef::default();
        for i in 0..400 {
            put(&mut qef, DVec3::new(f64::from(i % 20), f64::from(i / 20), 2.0), DVec3::Z);
        }
        for i in 0..20 {
            put(&mut qef, DVec3::new(19.5, f64::from(i), 1.0), DVec3::X);
        }
        let x = minimiser(&qef);
        assert!((x.x - 19.5).abs() < 1e-9 && (x.z - 2.0).abs() < 1e-9, "{x}");
    }

    #[test]
    fn an_edge_is_found_and_what_it_leaves_open_stays_in_the_middle() {
        let mut qef = Qef::default();
        for i in 0..4 {
            let y = f64::from(i);
            put(&mut qef, DVec3::new(3.0, y, 1.0), DVec3::X);
            put(&mut qef, DVec3::new(1.0, y, 5.0), DVec3::Z);
        }
        assert!(minimiser(&qef).distance(DVec3::new(3.0, 1.5, 5.0)) < 1e-12);
        assert!(qef.error(minimiser(&qef)) < 1e-12);
        let place =
            Place { bounds: [DVec3::ZERO, DVec3::new(2.0, 8.0, 8.0)], fixed: [None, Some(7.5), None] };
        assert!(qef.minimiser_within(&place).distance(DVec3::new(2.0, 7.5, 5.0)) < 1e-12);
    }

    #[test]
    fn a_vertex_knows_how_far_it_lies_beside_a_face_that_bends() {
        // Of a sphere, from whose middle the vertex looks along any direction.
        let (radius, up) = (40.0, DVec3::new(0.3, -0.5, 0.8).normalize());
        let (a, b) = up.any_orthonormal_pair();
        for reach in [1.5, 4.0, 8.0] {
            let mut qef = Qef::default();
            for i in 0..400 {
                // A sunflower: even over a disc.
                let (r, turn) = (reach * (f64::from(i) / 400.0).sqrt(), 2.399_963 * f64::from(i));
                let normal = (up + (a * turn.cos() + b * turn.sin()) * r / radius).normalize();
                put(&mut qef, normal * radius, normal);
            }
            let vertex = minimiser(&qef);
            let (off, about) = (vertex.length() - radius, qef.shifted(-vertex));
            assert!((about.beside() / off - 1.0).abs() < 0.1, "{reach}: {} for {off}", about.beside());
            let misfit = about.error(DVec3::ZERO) / about.count();
            assert!((3.0 * misfit / (off * off) - 1.0).abs() < 0.2, "{reach}: {misfit} for {off}");
        }
    }
}
