//! Grading 2:1: vertices whose cells share a crossing differ by one level at most.
//!
//! In rounds: every vertex that is two levels or more above another one in a ring is split. Splitting only ever
//! lowers levels, and what must be split stays so whatever is split beside it, so the result does not depend on
//! the order. How far it reaches: a vertex of level l is split only for one of level l - 2 or lower in a ring
//! with it; a chain of these, from a leaf, passes blocks of 2, 4, 8 and 16 cells: less than a root's side in
//! all. So what happens in a root depends on the roots that touch it, and no others.

use rayon::prelude::*;

use super::forest::{Forest, Owner};

/// Splits nodes until the surface is graded; returns how many.
pub(super) fn grade(forest: &mut Forest) -> u64 {
    let mut total = 0;
    let mut levels: Vec<u8> = vec![0; forest.leaves.places.len()];
    let all: Vec<usize> = (0..forest.leaves.roots.len()).collect();
    let mut changed = all;
    while !changed.is_empty() {
        set_levels(forest, &changed, &mut levels);
        // A ring belongs to one of the roots that it reaches, so all rings are looked at.
        let mut steep: Vec<u32> = forest
            .roots()
            .flat_map_iter(|(_, root)| {
                let crossings =
                    &forest.leaves.crossings[root.crossings.start as usize..root.crossings.end as usize];
                crossings.iter().flat_map(|c| steep(forest, &levels, c.ring))
            })
            .collect();
        steep.par_sort_unstable();
        steep.dedup();
        total += steep.len() as u64;
        changed = steep.iter().map(|&node| forest.root_of_node(node)).collect();
        changed.dedup();
        steep.iter().for_each(|&node| forest.split(node));
    }
    total
}

/// Levels of the leaves of some roots, given by ascending index.
fn set_levels(forest: &Forest, roots: &[usize], levels: &mut [u8]) {
    let mut rest = levels;
    let mut taken = 0;
    let mut tasks = Vec::with_capacity(roots.len());
    for &root in roots {
        let own = &forest.leaves.roots[root].leaves;
        rest = &mut rest[own.start as usize - taken..];
        let (mine, behind) = rest.split_at_mut(own.len());
        tasks.push((own.clone(), mine));
        rest = behind;
        taken = own.end as usize;
    }
    tasks.into_par_iter().for_each(|(own, levels)| {
        own.zip(levels).for_each(|(leaf, level)| *level = forest.level(leaf));
    });
}

/// The nodes that are too high for a ring.
fn steep(forest: &Forest, levels: &[u8], ring: [u32; 4]) -> impl Iterator<Item = u32> {
    let of = ring.map(|leaf| levels[leaf as usize]);
    let least = of.into_iter().min().unwrap_or(0);
    let steep = of.map(|level| level > least + 1);
    (0..4).filter(move |&i| steep[i]).filter_map(move |i| match forest.owner(ring[i]) {
        Owner::Node(node) => Some(node),
        Owner::Leaf(_) => None,
    })
}
