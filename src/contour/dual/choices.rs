//! What relaxation and remedy decided, which vertices and triangles are made by.

use glam::DVec3;

/// Decisions about leaves and polygons; every list is ascending.
#[derive(Debug, Clone, Default)]
pub(super) struct Choices {
    /// Crossings whose quad is split along the other diagonal.
    pub(super) other_diagonal: Vec<u32>,
    /// Crossings whose polygon is a fan from the crossing.
    pub(super) stars: Vec<u32>,
    /// Strays that went back into their cells.
    pub(super) returned: Vec<u32>,
    /// Leaves at the mean of their crossings.
    pub(super) pinned: Vec<u32>,
    /// Where relaxation put leaves, in lengths about the middle of their root.
    pub(super) moved: Vec<(u32, DVec3)>,
    /// Where it puts those that may stray while none of them does.
    pub(super) inside: Vec<(u32, DVec3)>,
}

impl Choices {
    /// Where relaxation put a leaf.
    pub(super) fn place_of(&self, leaf: u32) -> Option<DVec3> {
        place_in(&self.moved, leaf)
    }

    /// Where a leaf goes that may stray no longer.
    pub(super) fn place_inside(&self, leaf: u32) -> Option<DVec3> {
        place_in(&self.inside, leaf)
    }
}

fn place_in(places: &[(u32, DVec3)], leaf: u32) -> Option<DVec3> {
    places.binary_search_by_key(&leaf, |(l, _)| *l).ok().map(|i| places[i].1)
}
