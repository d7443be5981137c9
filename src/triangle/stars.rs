//! A certificate for most vertices of a sound mesh: no two triangles at this vertex meet wrongly.
//!
//! Method: the triangles at vertex v are to form closed fans, each neighbour once ahead and once behind. They
//! are seen along the sum n of their normals. If all run counter-clockwise there, and all of them
//! together turn once around v, they tile the plane around v: so two of them have nothing in common
//! there, and less in space, but v and, if they are neighbours in the fan, the edge they share.
//!
//! Turning once, without angles: let y be a linear function on that plane, and count the triangles which lead from
//! y < 0 to y >= 0. Each turn has one at least, as each triangle turns by less than half a circle. So if there is
//! one only, there is one turn, and one fan.
//!
//! Rounding: with w = n x (an axis), y = w.a of a neighbour at v + a is a difference of two products, and n, w
//! are exact as they are (w.n = 0 exactly), so only the sign of a y under 4 u |n| |a| can be wrong, u = 2^-53. A
//! triangle counts as counter-clockwise only if n.(a x b) exceeds [`MARGIN`] |n| |a| |b|, far more than its own
//! error (20 u) and than what follows. Take the triangle that sweeps over the lowest direction of a turn
//! (or the highest; the same holds mirrored). If both of its ends had y >= 0, or were so close to y = 0 that
//! they can be taken for it, then n.(a x b) would not exceed 10 u |n| |a| |b|. So one end is truly below and is seen
//! so; every turn has such a neighbour and one truly above, in turns, and no turn goes uncounted.
//! Wrong signs can only add to the count, and deny a certificate.

use glam::DVec3;
use rayon::prelude::*;

use super::vertex_table::VertexTable;

/// See the module header: 64 u would do.
const MARGIN: f64 = 1e-13;
/// The least square of a bound that underflow cannot have touched.
const TINY: f64 = 1e-250;
/// Vertices with more triangles are left to the exact tests.
const MOST: usize = 24;

/// For each vertex, whether none of its triangles meet wrongly. `false` says nothing.
pub(super) fn certified(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<bool> {
    let table = VertexTable::new(positions.len(), triangles);
    (0..positions.len())
        .into_par_iter()
        .with_min_len(1 << 10)
        .map(|v| is_graph(positions, triangles, v as u32, table.triangles(v)))
        .collect()
}

fn is_graph(positions: &[DVec3], triangles: &[[u32; 3]], v: u32, star: &[u32]) -> bool {
    let count = star.len();
    if !(3..=MOST).contains(&count) {
        return false;
    }
    let at = positions[v as usize];
    // Vertices ahead and behind in each triangle, and where they are seen from v.
    let (mut ahead, mut behind) = ([0; MOST], [0; MOST]);
    let mut arms = [[DVec3::ZERO; 2]; MOST];
    let (mut areas, mut normal) = ([DVec3::ZERO; MOST], DVec3::ZERO);
    for (k, &t) in star.iter().enumerate() {
        let [x, y, z] = triangles[t as usize];
        [ahead[k], behind[k]] = if x == v {
            [y, z]
        } else if y == v {
            [z, x]
        } else {
            [x, y]
        };
        arms[k] = [ahead[k], behind[k]].map(|w| positions[w as usize] - at);
        areas[k] = arms[k][0].cross(arms[k][1]);
        normal += areas[k];
    }
    let (ahead, behind) = (&ahead[..count], &behind[..count]);
    // As many of both, so none can be missing or twice in the other list.
    let once = |&w: &u32, list: &[u32]| list.iter().filter(|&&x| x == w).count() == 1;
    if !ahead.iter().all(|w| once(w, behind) && once(w, ahead)) {
        return false;
    }
    let m = normal.abs();
    let across = if m.x <= m.y && m.x <= m.z {
        DVec3::new(0.0, normal.z, -normal.y)
    } else if m.y <= m.z {
        DVec3::new(-normal.z, 0.0, normal.x)
    } else {
        DVec3::new(normal.y, -normal.x, 0.0)
    };
    let mut turns = 0;
    for k in 0..count {
        let [a, b] = arms[k];
        let bound = normal.length_squared() * a.length_squared() * b.length_squared() * (MARGIN * MARGIN);
        let area = normal.dot(areas[k]);
        // Written so that whatever is not a number is no certificate.
        if !(area > 0.0 && bound > TINY && area * area > bound && area.is_finite()) {
            return false;
        }
        turns += usize::from(across.dot(a) < 0.0 && across.dot(b) >= 0.0);
    }
    turns == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A fan around vertex 0 at these places, closed.
    fn fan(rim: &[[f64; 3]]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let n = rim.len() as u32;
        let positions = [DVec3::ZERO].into_iter().chain(rim.iter().map(|&p| DVec3::from_array(p))).collect();
        (positions, (0..n).map(|k| [0, 1 + k, 1 + (k + 1) % n]).collect())
    }

    fn holds((positions, triangles): &(Vec<DVec3>, Vec<[u32; 3]>)) -> bool {
        certified(positions, triangles)[0]
    }

    fn around(turns: u32, count: u32, height: f64) -> Vec<[f64; 3]> {
        let angle = |k| std::f64::consts::TAU * f64::from(turns * k) / f64::from(count);
        (0..count).map(|k| [angle(k).cos(), angle(k).sin(), height]).collect()
    }

    #[test]
    fn one_turn_is_certified_and_nothing_else() {
        for count in 3..12 {
            assert!(holds(&fan(&around(1, count, 0.0))), "{count}");
            assert!(holds(&fan(&around(1, count, 0.7))), "{count}, a cone");
            assert!(!holds(&fan(&around(2, count + 5, 0.1))), "{count}, twice around");
        }
        // Along the axes, where signs are zeros.
        assert!(holds(&fan(&[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])));
        // Open, doubled, turned and folded fans.
        let (positions, triangles) = fan(&around(1, 6, 0.1));
        assert!(!holds(&(positions.clone(), triangles[1..].to_vec())));
        assert!(!holds(&(positions.clone(), [&triangles[..], &triangles[2..3]].concat())));
        let mut turned = triangles.clone();
        turned[2].swap(1, 2);
        assert!(!holds(&(positions, turned)));
        let mut rim = around(1, 6, 0.1);
        rim.swap(2, 3);
        assert!(!holds(&fan(&rim)));
        // Two fans at one vertex.
        let (mut positions, mut triangles) = fan(&around(1, 5, 0.1));
        let (more, others) = fan(&around(1, 5, 0.2));
        positions.extend(&more[1..]);
        triangles.extend(others.iter().map(|t| t.map(|v| if v == 0 { 0 } else { v + 5 })));
        assert!(!holds(&(positions, triangles)));
    }

    #[test]
    fn flat_or_minute_fans_are_left_to_the_exact_tests() {
        let scaled =
            |by: f64| fan(&around(1, 6, 0.1).into_iter().map(|p| p.map(|c| c * by)).collect::<Vec<_>>());
        assert!(holds(&scaled(1e-20)) && holds(&scaled(1e20)));
        assert!(!holds(&scaled(1e-60)) && !holds(&scaled(1e200)));
        let needle = [[1.0, 0.0, 0.0], [1.0, 1e-14, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]];
        assert!(!holds(&fan(&needle)));
    }
}
