//! The tests V, F and E of `docs/dual.md` where they are plain: each of the block's eight children has one part
//! at most, all parts have the same two materials, and no half edge carries two crossings. Then a part is a
//! set of half edges, and each test counts bits. This is nearly always so; [`topology`](super::topology) has the
//! tests for all other blocks, and a test that both agree.

use super::leaves::NONE;
use super::topology::{Outline, PLACE, PLACES, Refusal, WITHIN, Within};
use crate::grid::MaterialId;
use crate::grid::cube::{CORNERS, EDGES, FACES, edge_faces};

/// The half edges of a block by what they are in it, as sets of places.
struct Places {
    inner: u64,
    edges: [u64; EDGES],
    /// On each face, but not on its rim.
    faces: [u64; FACES],
    /// On each face of each child.
    children: [[u64; FACES]; CORNERS],
}

static PLACES_OF: std::sync::LazyLock<Places> = std::sync::LazyLock::new(|| {
    let mut out = Places { inner: 0, edges: [0; EDGES], faces: [0; FACES], children: [[0; FACES]; CORNERS] };
    for (place, within) in WITHIN.iter().enumerate() {
        *(match within {
            Within::Inner => &mut out.inner,
            Within::Face(f) => &mut out.faces[*f],
            Within::Edge(e) => &mut out.edges[*e],
        }) |= 1 << place;
    }
    for (child, places) in PLACE.iter().enumerate() {
        for (e, place) in places.iter().enumerate() {
            edge_faces(e).into_iter().for_each(|f| out.children[child][f] |= 1 << place);
        }
    }
    out
});

/// The parts of a plain block.
#[derive(Debug, Clone)]
pub(super) struct Plain {
    /// The half edges on which each child's part has a crossing.
    masks: [u64; CORNERS],
    /// The crossing on each half edge.
    crossings: [u32; PLACES],
    /// The children of each cluster, at its lowest child.
    clusters: [u8; CORNERS],
    /// The child of each part.
    child_of: [u8; CORNERS],
}

impl Plain {
    /// `None` if the block is not plain. Parts are numbered in the order of `outlines`, which is that of children.
    pub(super) fn new(outlines: &[Outline]) -> Option<Self> {
        let pair = outlines.first()?.pair;
        if outlines.len() > CORNERS || pair == [MaterialId::OUTSIDE; 2] {
            return None;
        }
        let mut out = Self {
            masks: [0; CORNERS],
            crossings: [NONE; PLACES],
            clusters: [0; CORNERS],
            child_of: [0; CORNERS],
        };
        for (p, outline) in outlines.iter().enumerate() {
            let child = usize::from(outline.child);
            if outline.pair != pair || out.masks[child] != 0 {
                return None;
            }
            out.child_of[p] = outline.child;
            for (e, &crossing) in outline.crossings.iter().enumerate().filter(|(_, c)| **c != NONE) {
                let place = usize::from(PLACE[child][e]);
                if out.crossings[place] != NONE && out.crossings[place] != crossing {
                    return None;
                }
                out.crossings[place] = crossing;
                out.masks[child] |= 1 << place;
            }
        }
        for child in 0..CORNERS {
            if out.masks[child] == 0 {
                continue;
            }
            // Joins all clusters that it has a crossing in common with.
            let (mut joined, mut lowest) = (1u8 << child, child);
            for other in 0..child {
                let members = out.clusters[other];
                if members != 0 && out.all(members) & out.masks[child] != 0 {
                    joined |= members;
                    lowest = lowest.min(other);
                    out.clusters[other] = 0;
                }
            }
            out.clusters[lowest] = joined;
        }
        Some(out)
    }

    /// The half edges of some children's parts.
    fn all(&self, children: u8) -> u64 {
        (0..CORNERS).filter(|c| children >> c & 1 == 1).fold(0, |all, c| all | self.masks[c])
    }

    /// The lowest part of a part's cluster.
    pub(super) fn cluster(&self, part: usize) -> usize {
        let child = self.child_of[part];
        let lowest = self.clusters.iter().position(|members| members >> child & 1 == 1);
        self.child_of.iter().position(|&c| lowest == Some(usize::from(c))).unwrap_or(part)
    }

    /// As [`Clusters::test`](super::topology::Clusters::test).
    pub(super) fn test(&self, cluster: usize) -> Result<[u32; EDGES], Refusal> {
        let places = &*PLACES_OF;
        let members = self.clusters[usize::from(self.child_of[cluster])];
        let all = self.all(members);
        let children = || (0..CORNERS).filter(|c| members >> c & 1 == 1);
        let mut edges = [NONE; EDGES];
        for (edge, place) in edges.iter_mut().zip(places.edges) {
            let here = all & place;
            match here.count_ones() {
                0 => {}
                1 => *edge = self.crossings[here.trailing_zeros() as usize],
                _ => return Err(Refusal::Edge),
            }
        }
        // Parts, inner quarter faces and inner half edges.
        let mut euler = (members.count_ones() + (all & places.inner).count_ones()) as i32;
        for child in children() {
            for axis in 0..3 {
                let other = child ^ 1 << axis;
                let face = 2 * axis + usize::from(child < other);
                let rim = self.masks[child] & places.children[child][face];
                if rim == 0 {
                    continue;
                }
                if rim & self.masks[other] == 0 {
                    return Err(Refusal::Neighbour);
                }
                euler -= i32::from(child < other);
            }
        }
        if euler != 1 {
            return Err(Refusal::Disc);
        }
        for face in 0..FACES {
            let on = |c: &usize| {
                c >> (face / 2) & 1 == face % 2 && self.masks[*c] & places.children[*c][face] != 0
            };
            let count = children().filter(on).count() as u32;
            // With one joint less than quarter faces, at most one of each child, they are a path.
            if count > 0 && (all & places.faces[face]).count_ones() + 1 != count {
                return Err(Refusal::Face);
            }
        }
        Ok(edges)
    }
}
