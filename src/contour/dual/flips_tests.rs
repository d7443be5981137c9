//! Flips keep the topology, never lower the lowest q, and come out the same however they are computed.

use std::collections::BTreeMap;

use proptest::prelude::*;
use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::grid::MaterialId;

struct Toy {
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    pairs: Vec<Pair>,
}

impl Toy {
    fn mesh(&self) -> FlipMesh<'_> {
        FlipMesh { positions: &self.positions, pairs: &self.pairs, locked: &[] }
    }

    fn flipped(&self, options: &FlipOptions) -> (Vec<[u32; 3]>, Flips) {
        let mut triangles = self.triangles.clone();
        let flips = flip(self.mesh(), &mut triangles, options, &Execution::default()).unwrap();
        (triangles, flips)
    }

    fn meetings(&self, triangles: &[[u32; 3]]) -> usize {
        let left_out = without_area(&self.positions, triangles);
        let search = Search::new(&self.positions, triangles, &left_out);
        search.run(|_| true, &Execution::default()).unwrap().first.len()
    }

    fn lowest_q(&self, triangles: &[[u32; 3]]) -> f64 {
        let corners = |t: &[u32; 3]| t.map(|v| self.positions[v as usize]);
        triangles.iter().map(|t| triangle_quality(corners(t))).fold(f64::INFINITY, f64::min)
    }
}

fn pair(a: u8, b: u8) -> Pair {
    Pair::new(MaterialId(a), MaterialId(b)).unwrap()
}

/// Sheets of `n` by `n` squares in random halves, bumpy by `bump`, that hang on one common edge. Points are off
/// by less than a quarter along the sheet, so that no half is turned over.
fn sheets(seed: u64, n: u32, sheets: u8, bump: f64) -> Toy {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut toy = Toy { positions: Vec::new(), triangles: Vec::new(), pairs: Vec::new() };
    for x in 0..=n {
        toy.positions.push(DVec3::new(f64::from(x), 0.0, 0.0));
    }
    for sheet in 0..sheets {
        let angle = std::f64::consts::TAU * f64::from(sheet) / f64::from(sheets);
        let (out, up) =
            (DVec3::new(0.0, angle.cos(), angle.sin()), DVec3::new(0.0, -angle.sin(), angle.cos()));
        let first = toy.positions.len() as u32;
        for y in 1..=n {
            for x in 0..=n {
                let mut off = |by: f64| (rng.random::<f64>() - 0.5) * by;
                let at =
                    DVec3::X * (f64::from(x) + off(0.48)) + out * (f64::from(y) + off(0.48)) + up * off(bump);
                toy.positions.push(at);
            }
        }
        let at = |x: u32, y: u32| if y == 0 { x } else { first + (y - 1) * (n + 1) + x };
        for (x, y) in (0..n).flat_map(|y| (0..n).map(move |x| (x, y))) {
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            let halves = if rng.random() { [[a, b, c], [c, d, a]] } else { [[b, c, d], [d, a, b]] };
            toy.triangles.extend(halves);
            toy.pairs.extend([pair(sheet, (sheet + 1) % sheets.max(2)); 2]);
        }
    }
    toy
}

/// Every edge with its uses: pair and direction, in order.
type Uses = BTreeMap<[u32; 2], Vec<(Pair, bool)>>;

fn uses(triangles: &[[u32; 3]], pairs: &[Pair]) -> Uses {
    let mut uses = Uses::new();
    for (&[a, b, c], &pair) in triangles.iter().zip(pairs) {
        for [p, q] in [[a, b], [b, c], [c, a]] {
            uses.entry([p.min(q), p.max(q)]).or_default().push((pair, p < q));
        }
    }
    uses.values_mut().for_each(|u| u.sort_unstable());
    uses
}

/// Splits off the edges inside an interface, which have two opposite uses of one pair.
fn split(uses: Uses) -> (Uses, Uses) {
    let inner = |u: &[(Pair, bool)]| u.len() == 2 && u[0].0 == u[1].0 && u[0].1 != u[1].1;
    uses.into_iter().partition(|(_, u)| inner(u))
}

/// Triangles with their pairs, however numbered and rotated.
fn as_set(triangles: &[[u32; 3]], pairs: &[Pair]) -> Vec<([u32; 3], Pair)> {
    let turned =
        |&[a, b, c]: &[u32; 3]| [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap_or_default();
    let mut set: Vec<_> = triangles.iter().map(turned).zip(pairs.iter().copied()).collect();
    set.sort_unstable();
    set
}

fn options(tolerance: f64, angle: f64) -> FlipOptions {
    FlipOptions { tolerance, angle, rounds: 10 }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn topology_stays_and_the_lowest_q_does_not_fall(
        seed in any::<u64>(),
        count in 1u8..=3,
        bump in 0.0..0.5f64,
        tolerance in 0.0..0.5f64,
    ) {
        let toy = sheets(seed, 9, count, bump);
        let (after, flips) = toy.flipped(&options(tolerance, 40.0));
        let (inner, rest) = split(uses(&toy.triangles, &toy.pairs));
        let (inner_after, rest_after) = split(uses(&after, &toy.pairs));
        prop_assert_eq!(rest, rest_after, "junctions and borders");
        prop_assert_eq!(inner.len(), inner_after.len());
        let mut triangles = after.clone();
        triangles.iter_mut().for_each(|t| t.sort_unstable());
        triangles.sort_unstable();
        triangles.dedup();
        prop_assert_eq!(triangles.len(), after.len());
        prop_assert!(toy.lowest_q(&after) >= toy.lowest_q(&toy.triangles));
        let changed = (0..after.len()).filter(|&t| after[t] != toy.triangles[t]);
        prop_assert!(changed.clone().all(|t| flips.changes.is_changed(t)));
        prop_assert!(changed.count() >= flips.count().min(1));
        prop_assert_eq!(toy.meetings(&after), toy.meetings(&toy.triangles));
        // Taking everything back gives the first triangles, in their slots.
        let (mut back, mut flips) = (after, flips);
        flips.changes.undo(&mut back, 0..toy.triangles.len() as u32, |_| ());
        prop_assert_eq!(flips.count(), 0);
        prop_assert_eq!(back, toy.triangles);
    }

    #[test]
    fn neither_threads_nor_the_order_of_triangles_show(seed in any::<u64>()) {
        let toy = sheets(seed, 40, 3, 0.1);
        let run = |threads: usize, toy: &Toy| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| toy.flipped(&options(0.2, 30.0)))
        };
        let (after, flips) = run(1, &toy);
        prop_assert!(flips.count() > 100);
        prop_assert_eq!(&run(3, &toy).0, &after);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut order: Vec<usize> = (0..after.len()).collect();
        order.shuffle(&mut rng);
        let turned = |t: usize| {
            let [a, b, c] = toy.triangles[t];
            [[a, b, c], [b, c, a], [c, a, b]][rng.random_range(0..3)]
        };
        let shuffled = Toy {
            positions: toy.positions.clone(),
            triangles: order.iter().copied().map(turned).collect(),
            pairs: order.iter().map(|&t| toy.pairs[t]).collect(),
        };
        let (other, _) = run(2, &shuffled);
        prop_assert_eq!(as_set(&other, &shuffled.pairs), as_set(&after, &toy.pairs));
    }

    #[test]
    fn flips_that_make_triangles_meet_are_taken_back(seed in any::<u64>()) {
        // The same bumpy sheet twice, one close above the other, which is locked.
        let mut toy = sheets(seed, 12, 1, 0.6);
        let (points, n) = (toy.positions.len() as u32, toy.triangles.len());
        for i in 0..points as usize {
            toy.positions.push(toy.positions[i] + DVec3::Z * 0.01);
        }
        toy.triangles.extend_from_within(..);
        toy.pairs.extend_from_within(..);
        for t in &mut toy.triangles[n..] {
            *t = t.map(|v| v + points);
        }
        prop_assert_eq!(toy.meetings(&toy.triangles), 0);
        let locked: Vec<bool> = (0..2 * n).map(|t| t >= n).collect();
        let mesh = FlipMesh { locked: &locked, ..toy.mesh() };
        let (options, execution) = (options(0.5, 60.0), Execution::default());
        let mut after = toy.triangles.clone();
        let all = flip_only(mesh, &mut after, &options, &execution).unwrap();
        prop_assert!(toy.meetings(&after) > 0, "nothing to test");
        let mut after = toy.triangles.clone();
        let flips = flip(mesh, &mut after, &options, &execution).unwrap();
        prop_assert_eq!(toy.meetings(&after), 0);
        prop_assert_eq!(&after[n..], &toy.triangles[n..]);
        prop_assert!(flips.count() > 0 && flips.changes.undone() > 0);
        prop_assert_eq!(flips.changes.made(), all.count());
    }
}

#[test]
fn the_surface_moves_by_the_tolerance_at_most() {
    let toy = sheets(5, 20, 1, 0.3);
    assert_eq!(toy.flipped(&options(0.0, 40.0)).1.count(), 0);
    let few = toy.flipped(&options(0.02, 40.0)).1.count();
    let many = toy.flipped(&options(0.2, 40.0)).1.count();
    assert!(0 < few && few < many, "{few} {many}");
    let flat = sheets(5, 20, 1, 0.0);
    assert!(flat.flipped(&options(1e-12, 1.0)).1.count() > many);
    // And by angle.
    assert!(toy.flipped(&options(0.2, 10.0)).1.count() < many);
}

/// A square in halves along its long diagonal *ab*, so that a flip to *cd* is worth while.
fn rhombus() -> Toy {
    let positions = [[-2.0, 0.0], [2.0, 0.0], [0.0, 1.0], [0.0, -1.0], [-5.0, 0.0], [0.0, 0.0]];
    Toy {
        positions: positions.map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec(),
        triangles: vec![[0, 1, 2], [1, 0, 3]],
        pairs: vec![pair(1, 0); 2],
    }
}

#[test]
fn an_edge_is_flipped_unless_something_forbids_it() {
    let options = options(0.1, 10.0);
    let toy = rhombus();
    let (after, flips) = toy.flipped(&options);
    assert_eq!((after, flips.rounds), (vec![[2, 0, 3], [3, 1, 2]], 2));
    let stays = |change: &dyn Fn(&mut Toy)| {
        let mut toy = rhombus();
        change(&mut toy);
        assert_eq!(toy.flipped(&options).0, toy.triangles);
    };
    stays(&|toy| toy.pairs[1] = pair(2, 0));
    stays(&|toy| toy.triangles[1] = [0, 1, 3]); // wound the other way
    stays(&|toy| toy.positions[2].z = 0.9); // not near-coplanar
    stays(&|toy| {
        // A square: no gain.
        toy.positions[2].y = 2.0;
        toy.positions[3].y = -2.0;
    });
    stays(&|toy| {
        // cd is an edge already, elsewhere.
        toy.positions[4].z = 3.0;
        toy.triangles.push([4, 2, 3]);
        toy.pairs.push(pair(2, 1));
    });
    stays(&|toy| {
        // A third triangle makes ab a junction edge.
        toy.positions[4] = DVec3::new(0.0, 0.0, 4.0);
        toy.triangles.push([0, 1, 4]);
        toy.pairs.push(pair(2, 1));
    });
    let mut after = toy.triangles.clone();
    let locked = FlipMesh { locked: &[false, true], ..toy.mesh() };
    let flips = flip(locked, &mut after, &options, &Execution::default()).unwrap();
    assert_eq!((after, flips.count()), (toy.triangles.clone(), 0));
    // Not convex: the quad would be folded, however flat it is.
    let mut dart = rhombus();
    dart.positions[3] = DVec3::new(-3.0, 0.3, 0.0);
    dart.positions[2] = DVec3::new(-3.0, 3.0, 0.0);
    dart.triangles[1] = [1, 0, 3];
    assert_eq!(dart.flipped(&options).0, dart.triangles);
}

#[test]
fn a_flip_can_be_stopped() {
    let execution = Execution::default();
    execution.cancel_flag().store(true, std::sync::atomic::Ordering::Relaxed);
    let toy = rhombus();
    let stopped = flip(toy.mesh(), &mut toy.triangles.clone(), &options(0.1, 10.0), &execution);
    assert!(stopped.is_err());
}
