//! What may be contracted on small meshes, and that the topology of shells stays whatever is contracted.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;

fn pair(back: u8, front: u8) -> Pair {
    Pair::new(MaterialId(back), MaterialId(front)).unwrap()
}

#[derive(Clone)]
struct Toy {
    vertices: usize,
    triangles: Vec<[u32; 3]>,
    pairs: Vec<Pair>,
}

impl Toy {
    fn new(triangles: &[[u32; 3]]) -> Self {
        let vertices = triangles.iter().flatten().max().map_or(0, |v| *v as usize + 1);
        Self { vertices, triangles: triangles.to_vec(), pairs: vec![pair(1, 0); triangles.len()] }
    }

    fn complex(&mut self) -> Complex<'_> {
        Complex::new(self.vertices, self.vertices, &mut self.triangles, &self.pairs)
    }

    /// Whether an edge may be contracted, either way.
    fn may(&mut self, a: u32, b: u32) -> bool {
        let complex = self.complex();
        let (kept, gone) = if complex.kind(a) >= complex.kind(b) { (a, b) } else { (b, a) };
        complex.link(kept, gone).is_some()
    }

    fn kinds(&mut self) -> Vec<Kind> {
        let n = self.vertices as u32;
        let complex = self.complex();
        (0..n).map(|v| complex.kind(v)).collect()
    }
}

/// The side of a prism with `n` sides and `levels` + 1 rims, closed by a vertex at each end.
fn tube(n: u32, levels: u32) -> Toy {
    let at = |k: u32, level: u32| level * n + k % n;
    let (bottom, top) = ((levels + 1) * n, (levels + 1) * n + 1);
    let mut triangles = Vec::new();
    for k in 0..n {
        for level in 0..levels {
            let [a, b, c, d] = [at(k, level), at(k + 1, level), at(k + 1, level + 1), at(k, level + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
        triangles.extend([[at(k + 1, 0), at(k, 0), bottom], [at(k, levels), at(k + 1, levels), top]]);
    }
    Toy::new(&triangles)
}

#[test]
fn a_tube_is_not_pinched_off() {
    // Around it three edges long: contracting one leaves two, which cut it in two.
    let mut thin = tube(3, 4);
    assert!(thin.kinds().iter().all(|k| *k == Kind::Smooth));
    assert!(!thin.may(3, 4) && !thin.may(6, 7));
    assert!(thin.may(3, 6), "along it");
    let mut wide = tube(4, 4);
    assert!(wide.may(4, 5) && wide.may(4, 8));
}

#[test]
fn a_tetrahedron_and_a_pillow_stay() {
    let mut tetrahedron = Toy::new(&[[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]);
    assert!((0..4).all(|a| (0..a).all(|b| !tetrahedron.may(a, b))));
    // Two fans over one rim of three: as few triangles as a double cone has.
    let mut pillow = Toy::new(&[[0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 0, 4], [2, 1, 4], [0, 2, 4]]);
    assert!(!pillow.may(0, 1), "the rim");
    assert!(pillow.may(0, 3), "leaves a tetrahedron");
    let mut octahedron = tube(4, 0);
    octahedron.triangles.retain(|t| !is_gone(*t));
    assert!(octahedron.may(0, 1));
}

/// Three sheets, of pairs 1-0, 2-1 and 2-0, on a closed curve of `n` vertices, each closed by a vertex: two lenses back to
/// back.
fn lenses(n: u32) -> Toy {
    let mut toy = Toy { vertices: n as usize + 3, triangles: Vec::new(), pairs: Vec::new() };
    for (top, own) in [(n, pair(1, 0)), (n + 1, pair(2, 1)), (n + 2, pair(2, 0))] {
        for k in 0..n {
            let (a, b) = (k, (k + 1) % n);
            toy.triangles.push(if top == n + 2 { [b, a, top] } else { [a, b, top] });
            toy.pairs.push(own);
        }
    }
    toy
}

#[test]
fn a_junction_curve_does_not_collapse() {
    for n in 3..6 {
        let mut toy = lenses(n);
        let kinds = toy.kinds();
        assert!(kinds[..n as usize].iter().all(|k| *k == Kind::Curve));
        assert!(kinds[n as usize..].iter().all(|k| *k == Kind::Smooth));
        assert_eq!(toy.may(0, 1), n > 3, "along the curve, which keeps three edges");
        assert!(toy.may(0, n), "a sheet's vertex onto the curve");
    }
    // A smooth vertex becomes part of one on the curve, never the other way round.
    let mut toy = lenses(4);
    assert_eq!(toy.complex().link(4, 0), None);
}

#[test]
fn two_curves_do_not_come_together() {
    // A band between two curves, both of which carry a cap and an outer sheet: an annulus one edge wide.
    let n = 5;
    let mut toy = Toy { vertices: 2 * n as usize + 4, triangles: Vec::new(), pairs: Vec::new() };
    for k in 0..n {
        let (a, b) = (k, (k + 1) % n);
        let (c, d) = (a + n, b + n);
        toy.triangles.extend([[a, b, d], [a, d, c]]);
        toy.pairs.extend([pair(1, 0); 2]);
        for (rim, top) in [([a, b], 2 * n), ([d, c], 2 * n + 2)] {
            toy.triangles.extend([[rim[0], rim[1], top], [rim[1], rim[0], top + 1]]);
            toy.pairs.extend([pair(2, 1), pair(2, 0)]);
        }
    }
    assert!(toy.kinds()[..2 * n as usize].iter().all(|k| *k == Kind::Curve));
    assert!(!toy.may(0, n) && !toy.may(0, n + 1), "across the band");
    assert!(toy.may(0, 1), "along it");
}

#[test]
fn ends_of_curves_are_points_and_stay() {
    // An open fan: its rim is a curve of boundary edges, with the middle on it.
    let mut fan = Toy::new(&[[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
    assert_eq!(fan.kinds(), [Kind::Curve; 5]);
    assert!(!fan.may(0, 2), "from rim to rim");
    // Two fans at one vertex.
    let mut two = Toy::new(&[[0, 1, 2], [0, 2, 3], [0, 3, 1], [0, 4, 5], [0, 5, 6], [0, 6, 4]]);
    assert_eq!(two.kinds()[0], Kind::Point);
    // Four sheets of changing pairs: two curves cross in a point.
    let mut toy = lenses(4);
    toy.pairs[0] = pair(3, 0);
    let kinds = toy.kinds();
    assert_eq!(kinds[0], Kind::Point);
    assert_eq!(kinds[1], Kind::Point);
    assert!(!toy.may(0, 1), "two points");
    assert!(toy.may(1, 2), "a curve's vertex onto the point");
    assert!(!Complex::new(7, 0, &mut toy.triangles, &toy.pairs).link(0, 4).is_some_and(|_| true));
}

/// Vertices less edges plus triangles of each shell, and the number of its pieces; `None` if an edge is not used once each way.
fn shells(triangles: &[[u32; 3]], pairs: &[Pair]) -> Option<BTreeMap<u8, (i64, usize)>> {
    let mut out = BTreeMap::new();
    for id in [0, 1, 2].map(MaterialId) {
        let own = triangles.iter().zip(pairs).filter(|(t, _)| !is_gone(**t));
        let own: Vec<[u32; 3]> = own
            .filter_map(|(&[a, b, c], p)| match id {
                id if id == p.back() => Some([a, b, c]),
                id if id == p.front() => Some([a, c, b]),
                _ => None,
            })
            .collect();
        let mut uses: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        let mut piece: BTreeMap<u32, u32> = own.iter().flatten().map(|&v| (v, v)).collect();
        fn find(piece: &BTreeMap<u32, u32>, mut v: u32) -> u32 {
            while piece[&v] != v {
                v = piece[&v];
            }
            v
        }
        for &[a, b, c] in &own {
            for (p, q) in [(a, b), (b, c), (c, a)] {
                *uses.entry((p, q)).or_default() += 1;
                let (p, q) = (find(&piece, p), find(&piece, q));
                piece.insert(p.max(q), p.min(q));
            }
        }
        if uses.iter().any(|(&(p, q), &n)| n != 1 || uses.get(&(q, p)) != Some(&1)) {
            return None;
        }
        let euler = piece.len() as i64 - uses.len() as i64 / 2 + own.len() as i64;
        out.insert(id.0, (euler, piece.iter().filter(|(v, p)| v == p).count()));
    }
    Some(out)
}

proptest! {
    #[test]
    fn shells_keep_their_topology_in_any_order(order in prop::collection::vec(any::<(u16, u16)>(), 400), kind in 0..4) {
        let mut toy = match kind {
            0 => tube(5, 6),
            1 => lenses(9),
            2 => tube(3, 9),
            _ => {
                // A ring: the ends of a tube lead into each other.
                let (n, levels) = (4, 5);
                let at = |k: u32, level: u32| level % levels * n + k % n;
                let quads = (0..n).flat_map(|k| (0..levels).map(move |l| (k, l)));
                let halves = |(k, l): (u32, u32)| {
                    let [a, b, c, d] = [at(k, l), at(k + 1, l), at(k + 1, l + 1), at(k, l + 1)];
                    [[a, b, c], [a, c, d]]
                };
                Toy::new(&quads.flat_map(halves).collect::<Vec<_>>())
            }
        };
        let expected = shells(&toy.triangles, &toy.pairs);
        prop_assert!(expected.is_some());
        let pairs = toy.pairs.clone();
        let n = toy.vertices as u32;
        let mut made = 0;
        let mut complex = toy.complex();
        let mut left: Vec<u32> = (0..n).collect();
        for (a, b) in order {
            let kept = left[usize::from(a) % left.len()];
            let around: Vec<u32> = complex.neighbours(kept).collect();
            if around.is_empty() {
                continue;
            }
            let gone = around[usize::from(b) % around.len()];
            if complex.link(kept, gone).is_none() {
                continue;
            }
            let new = complex.contracted(kept, gone);
            complex.set_star(kept, new.iter().filter(|(_, t)| !is_gone(*t)).map(|(slot, _)| *slot));
            new.into_iter().for_each(|(slot, t)| complex.triangles[slot as usize] = t);
            left.retain(|v| *v != gone);
            made += 1;
            let triangles = &*complex.triangles;
            prop_assert_eq!(&shells(triangles, &pairs), &expected);
            let fresh = {
                let mut triangles: Vec<_> = triangles.iter().zip(&pairs).filter(|(t, _)| !is_gone(**t)).collect();
                triangles.sort_unstable();
                let (mut t, p): (Vec<[u32; 3]>, Vec<Pair>) = triangles.into_iter().unzip();
                Complex::new(n as usize, n as usize, &mut t, &p).kinds
            };
            for &v in &left {
                prop_assert_eq!(complex.kind(v), fresh[v as usize], "what a vertex is stays");
            }
        }
        prop_assert!(made > 2, "{}", made);
    }
}

#[test]
fn sheets_that_passed_through_each_other_do_not_match_up() {
    let mut toy = lenses(4);
    let rim = |x: f64, y: f64| DVec3::new(x, y, 0.0);
    let at = |heights: [f64; 3]| {
        let tops = heights.map(|z| DVec3::new(0.0, 0.0, z));
        [&[rim(1.0, 0.0), rim(0.0, 1.0), rim(-1.0, 0.0), rim(0.0, -1.0)][..], &tops].concat()
    };
    let complex = toy.complex();
    let all = |positions: &[DVec3]| (0..12).all(|slot| complex.matches_up(positions, slot));
    // Material 0 outside, 1 under the first sheet, 2 under the second one.
    assert!(all(&at([1.0, 0.0, -1.0])));
    assert!(!all(&at([0.0, 1.0, -1.0])), "the lens of material 1 is turned inside out");
    assert!(!all(&at([1.0, -1.0, 0.0])));
}
