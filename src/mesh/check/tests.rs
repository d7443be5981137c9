//! Each kind of defect, put into a sound mesh and found there exactly.

use glam::DVec3;

use super::*;
use crate::mesh::fixtures::{mesh, pair, parts, voxel_faces};
use crate::triangle::EdgeTable;

fn found(m: &InterfaceMesh) -> Defects {
    check(m, &CheckOptions::default(), &Execution::default()).unwrap()
}

/// Name and count of everything found.
fn kinds(d: &Defects) -> Vec<(&'static str, u64)> {
    d.by_kind().into_iter().filter(|k| k.1 > 0).collect()
}

fn two_cubes() -> InterfaceMesh {
    voxel_faces([2, 1, 1], &[1, 2], 0)
}

#[test]
fn sound_meshes_have_no_defects() {
    for m in [
        voxel_faces([1, 1, 1], &[1], 0),
        two_cubes(),
        voxel_faces([2, 1, 1], &[1, 2], 255),
        // Air touches the outside: no triangles between the two, and two at each rim edge.
        voxel_faces([2, 1, 1], &[1, 0], 255),
        voxel_faces([2, 2, 1], &[1, 2, 3, 0], 255),
        voxel_faces([2, 2, 2], &[1, 2, 3, 3, 1, 2, 2, 2], 255),
        // A closed shell with an inner void.
        voxel_faces([3, 3, 3], &std::array::from_fn::<u8, 27, _>(|i| u8::from(i != 13)), 0),
    ] {
        let d = found(&m);
        assert!(d.is_empty(), "{d:?}");
        assert!(d.unreferenced_vertices.is_empty());
        assert!(d.shells.iter().all(|s| s.closed && s.manifold));
    }
}

#[test]
fn a_missing_triangle_opens_its_edges() {
    let (p, mut t, mut pairs) = parts(&voxel_faces([1, 1, 1], &[1], 0));
    t.remove(3);
    pairs.remove(3);
    let d = found(&mesh(p, t, pairs));
    assert_eq!(kinds(&d), [("boundary edges", 3), ("open edges of a shell", 3)]);
    assert!(!d.shells[0].closed && !d.shells[0].manifold);
    assert_eq!(d.open_edges.first[0].material, Some(MaterialId(1)));
}

#[test]
fn a_missing_triangle_between_solids_opens_both_shells() {
    let (p, mut t, mut pairs) = parts(&two_cubes());
    let i = pairs.iter().position(|&q| q == pair(1, 2)).unwrap();
    t.remove(i);
    pairs.remove(i);
    let d = found(&mesh(p, t, pairs));
    // Two of its edges lie on the junction curve, where the other two interfaces are left and do
    // not match; the third is a plain boundary.
    assert_eq!(
        kinds(&d),
        [
            ("boundary edges", 1),
            ("edges with materials that do not match up", 2),
            ("open edges of a shell", 6)
        ]
    );
}

#[test]
fn a_flipped_triangle_is_wound_wrongly() {
    let (p, mut t, pairs) = parts(&voxel_faces([1, 1, 1], &[1], 0));
    t[5].swap(0, 1);
    let d = found(&mesh(p, t, pairs));
    assert_eq!(
        kinds(&d),
        [("edges with materials that do not match up", 3), ("edges with inconsistent winding", 3)]
    );
    assert!(d.winding.first.iter().all(|e| e.triangles.contains(&5)));
}

#[test]
fn cubes_that_touch_along_an_edge_share_a_non_manifold_edge() {
    let d = found(&voxel_faces([2, 2, 1], &[1, 0, 0, 1], 0));
    assert_eq!(kinds(&d), [("non-manifold edges of a shell", 1)]);
    let edge = &d.non_manifold_edges.first[0];
    assert_eq!(edge.ends, [[1.0, 1.0, 0.0], [1.0, 1.0, 1.0]]);
    assert_eq!(edge.triangles.len(), 4);
    assert!(d.shells[0].closed && !d.shells[0].manifold);
}

#[test]
fn cubes_that_touch_in_a_corner_share_a_non_manifold_vertex() {
    let d = found(&voxel_faces([2, 2, 2], &[1, 0, 0, 0, 0, 0, 0, 1], 0));
    assert_eq!(kinds(&d), [("non-manifold vertices of a shell", 1)]);
    let v = &d.non_manifold_vertices.first[0];
    assert_eq!((v.position, v.pieces, v.material), ([1.0; 3], 2, Some(MaterialId(1))));
    // Different materials may touch there: each shell is sound.
    assert!(found(&voxel_faces([2, 2, 2], &[1, 0, 0, 0, 0, 0, 0, 2], 0)).is_empty());
}

#[test]
fn wrong_labels_do_not_match_up() {
    let (p, t, mut pairs) = parts(&two_cubes());
    let i = pairs.iter().position(|&q| q == pair(1, 0)).unwrap();
    pairs[i] = pair(3, 0);
    let d = found(&mesh(p, t, pairs));
    let k = kinds(&d);
    assert!(k.contains(&("edges with materials that do not match up", 3)), "{k:?}");
    assert!(k.contains(&("open edges of a shell", 6)), "{k:?}");
}

#[test]
fn order_round_a_junction_edge_matters_not_only_the_labels() {
    // Four half planes round the z axis. The shells are balanced either way, but with the two
    // tips swapped the sectors overlap: 1|0, 2|1, 0|2 and so on no longer follow each other.
    let build = |angles: [f64; 3]| {
        let mut p = vec![DVec3::ZERO, DVec3::Z];
        p.extend(angles.map(|a| DVec3::new(a.cos(), a.sin(), 0.5)));
        // Passing 1 -> 2 -> 0 -> 1 counter-clockwise: backs and fronts by id order.
        let t = vec![[1, 0, 2], [0, 1, 3], [0, 1, 4]];
        mesh(p, t, vec![pair(2, 1), pair(2, 0), pair(1, 0)])
    };
    let turn = |a: f64| a * std::f64::consts::TAU;
    let count = |m: &InterfaceMesh| {
        let (window, table) = (Window::whole(m), EdgeTable::new(5, m.triangles()));
        let (mut d, mut counts) = (Defects::default(), ShellCounts::new());
        edges::check(&window, &table, 100, &mut d, &mut counts, &Execution::default()).unwrap();
        d.alternation.count
    };
    // Triangle 2: passed forward, from 1 to 0; triangle 0: backward, from 1 to 2; triangle 1: 2 to 0.
    let alternation = |angles| count(&build(angles));
    // 1 -> 2 -> 0, then 0 must go on to 1, but triangle 2 is passed from 1 to 0.
    assert_eq!(alternation([turn(0.1), turn(0.4), turn(0.7)]), 1);
    let good = |angles: [f64; 3]| {
        let m = build(angles);
        let (p, mut t, pairs) = parts(&m);
        t[2].swap(0, 1);
        count(&mesh(p, t, pairs))
    };
    assert_eq!(good([turn(0.1), turn(0.4), turn(0.7)]), 0);
    assert_eq!(good([turn(0.7), turn(0.1), turn(0.4)]), 0);
    assert_eq!(good([turn(0.4), turn(0.1), turn(0.7)]), 1);
    assert_eq!(good([turn(0.0), turn(0.25), turn(0.5)]), 0, "flat angles");
    assert_eq!(good([turn(0.25), turn(0.0), turn(0.5)]), 1, "flat angles");
}

#[test]
fn degenerate_and_duplicate_triangles() {
    let (mut p, mut t, mut pairs) = parts(&voxel_faces([1, 1, 1], &[1], 0));
    let far = p.len() as u32;
    p.extend([DVec3::splat(10.0), DVec3::splat(11.0), DVec3::splat(13.0), DVec3::new(0.1, 0.2, 0.3)]);
    t.push([far, far + 1, far + 2]);
    t.push([far, far, far + 1]);
    t.push(t[4]);
    pairs.extend([pair(1, 0); 3]);
    let n = t.len() as u32;
    let d = found(&mesh(p, t, pairs));
    assert_eq!(d.degenerate_triangles.count, 2);
    assert_eq!(d.degenerate_triangles.first[0].triangle, n - 3);
    assert_eq!(d.degenerate_triangles.first[1].vertices, [far, far, far + 1]);
    assert_eq!(d.duplicate_triangles.count, 1);
    assert_eq!(d.duplicate_triangles.first[0].triangles, [4, n - 1]);
    assert_eq!(d.unreferenced_vertices.count, 1);
    assert_eq!(d.unreferenced_vertices.first[0].vertex, far + 3);
}

#[test]
fn self_intersections_are_pairs_that_meet_away_from_what_they_share() {
    let (mut p, mut t, mut pairs) = parts(&voxel_faces([1, 1, 1], &[1], 0));
    let (n, m) = (p.len() as u32, t.len() as u32);
    // A second cube, its corner just inside the first one's.
    let (p2, t2, pairs2) = parts(&voxel_faces([1, 1, 1], &[1], 0));
    p.extend(p2.iter().map(|v| *v + DVec3::new(0.75, 0.8, 0.85)));
    t.extend(t2.iter().map(|t| t.map(|v| v + n)));
    pairs.extend(pairs2);
    let d = found(&mesh(p.clone(), t.clone(), pairs.clone()));
    assert!(d.self_intersections.count >= 6);
    assert_eq!(kinds(&d).len(), 1, "{d:?}");
    assert!(d.self_intersections.first.iter().all(|x| x.triangles[0] < m && x.triangles[1] >= m));
    // Just outside it: nothing. In touch: something.
    let shifted = |by: f64| {
        let mut q = p.clone();
        for v in &mut q[n as usize..] {
            *v += DVec3::new(by, 0.0, 0.0);
        }
        found(&mesh(q, t.clone(), pairs.clone())).self_intersections.count
    };
    assert_eq!(shifted(0.25 + 1e-12), 0);
    assert!(shifted(0.25) > 0);
}

#[test]
fn examples_are_limited_but_all_are_counted_and_threads_do_not_matter() {
    let m = voxel_faces([3, 3, 3], &std::array::from_fn::<u8, 27, _>(|i| [1, 0, 2, 0, 1, 3][i * 7 % 6]), 0);
    let options = CheckOptions { examples: 2, ..CheckOptions::default() };
    let run = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| check(&m, &options, &Execution::default()).unwrap())
    };
    let d = run(1);
    assert!(d.non_manifold_edges.count > 2);
    assert_eq!(d.non_manifold_edges.first.len(), 2);
    assert_eq!(d, run(3));
}

#[test]
fn a_cancelled_check_stops() {
    let execution = Execution::default();
    execution.cancel_flag().store(true, std::sync::atomic::Ordering::Relaxed);
    assert_eq!(check(&two_cubes(), &CheckOptions::default(), &execution), Err(Cancelled));
}
