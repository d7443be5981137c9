//! What every surface must be, whatever method made it.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::collections::HashMap;

use interfacet::contour::{Border, Patch};
use interfacet::grid::MaterialId;

/// Asserts that every material's shell is closed, consistently oriented, and that every vertex
/// link of it is one cycle; that kinds say how many materials meet; that no vertex is unused.
pub(crate) fn assert_sound(patch: &Patch, materials: usize, border: Border, what: &dyn Fn() -> String) {
    let mut used = vec![false; patch.positions.len()];
    let mut around: Vec<Vec<u8>> = vec![Vec::new(); patch.positions.len()];
    for (t, pair) in patch.triangles.iter().zip(&patch.pairs) {
        assert!(t[0] != t[1] && t[1] != t[2] && t[2] != t[0], "{}", what());
        assert!(pair.front() == MaterialId::OUTSIDE || pair.back() > pair.front(), "{}", what());
        for &v in t {
            used[v as usize] = true;
            for id in [pair.back().0, pair.front().0] {
                if !around[v as usize].contains(&id) {
                    around[v as usize].push(id);
                }
            }
        }
    }
    assert!(used.iter().all(|&u| u), "a vertex without triangles: {}", what());
    for (kind, around) in patch.kinds.iter().zip(&around) {
        if border == Border::Closed {
            assert_eq!(usize::from(kind.code() % 10), around.len().clamp(2, 4), "{}", what());
        }
    }
    for material in 0..materials as u8 {
        // The background's shell lacks its side towards OUTSIDE; with an open border all do.
        let shell: Vec<[u32; 3]> = patch
            .triangles
            .iter()
            .zip(&patch.pairs)
            .filter_map(|(&[a, b, c], pair)| match material {
                m if pair.back().0 == m => Some([a, b, c]),
                m if pair.front().0 == m => Some([a, c, b]),
                _ => None,
            })
            .collect();
        let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
        let mut links: HashMap<u32, HashMap<u32, u32>> = HashMap::new();
        for t in &shell {
            for k in 0..3 {
                let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
                *edges.entry((a, b)).or_default() += 1;
                let repeated = links.entry(a).or_default().insert(b, c);
                assert!(repeated.is_none(), "material {material}, edge {a}-{b} used twice: {}", what());
            }
        }
        let may_be_open = material == 0 || border == Border::Open;
        for &(a, b) in edges.keys() {
            let border_edge = patch.kinds[a as usize].is_border() && patch.kinds[b as usize].is_border();
            let matched = edges.contains_key(&(b, a));
            assert!(
                matched || may_be_open && border_edge,
                "material {material}, edge {a}-{b} is open: {}",
                what()
            );
        }
        for (v, link) in &links {
            if may_be_open && patch.kinds[*v as usize].is_border() {
                continue;
            }
            let start = *link.keys().next().unwrap();
            let (mut at, mut steps) = (link[&start], 1);
            while at != start {
                at = *link.get(&at).unwrap_or_else(|| panic!("material {material}, vertex {v}: {}", what()));
                steps += 1;
            }
            assert_eq!(
                steps,
                link.len(),
                "material {material}: link of vertex {v} has several cycles: {}",
                what()
            );
        }
    }
}
