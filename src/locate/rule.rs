//! Crossings by the models: what contouring asks for.

use glam::{DVec2, DVec3};

use super::blend::{Blended, blended};
use super::frame::BlurUnits;
use super::passage::Passage;
use super::patches::{OfBlock, Patches};
use super::site::Site;
use super::sites::{CurveKind, FARTHER, Sites};
use crate::classify::{BitPlanes, LabelVolume};
use crate::contour::pattern::{classes_of, is_ambiguous, sheets};
use crate::contour::{CROSSING_MARGIN, CrossingRule, Moves, Node};
use crate::grid::MaterialId;
use crate::grid::cube::{CORNERS, FACES, corner_at, edge_axis, edge_between, edge_corners, face_ring};

/// A crossing found by a model may lie this far beyond its edge (in edge lengths) and is put to the edge's end;
/// farther, the model is not of this interface.
const BEYOND: f64 = 0.5;

/// A distance that rises less than this along an edge (blur units) has no place on it.
const FLATTEST: f64 = 1e-3;
/// The interface may be so far from the place found, blur units: at the end of the search.
const LEFT: f64 = 0.2;
/// Where a blended distance rises less than this along an edge (blur units) the patch's own crossing stands; it moves by no more than the
/// second, edge lengths.
const STEEP: f64 = 0.15;
const MOST_BLENDED: f64 = 0.3;
/// So far before and behind a crossing (in edge lengths) its materials must be there.
pub(super) const BESIDE: f64 = 0.03;

/// What the models say, for a part of the volume; where they say nothing another rule does.
pub struct Located<'a> {
    /// Where nothing is known.
    pub otherwise: &'a dyn CrossingRule,
    /// Labels that agree with the models.
    pub labels: &'a LabelVolume,
    /// Voxels that sites speak for.
    pub zone: &'a BitPlanes,
    /// Curves.
    pub sites: &'a Sites,
    /// Sheets.
    pub patches: &'a Patches,
    /// The blur.
    pub units: BlurUnits,
    /// By how much standard deviations are larger than for white noise.
    pub inflation: f64,
    /// Wishes that were granted.
    pub moves: Option<&'a Moves>,
}

/// A crossing by a model.
#[derive(Debug, Clone, Copy)]
pub struct Found<'a> {
    /// Fraction of the edge, not yet kept off its ends.
    pub position: f64,
    /// Normal in blur units from the material at the lower end to the other.
    pub normal: DVec3,
    /// The model, and the place in its coordinates.
    by: By<'a>,
    at: DVec3,
}

/// The model that knows a crossing.
#[derive(Debug, Clone, Copy)]
enum By<'a> {
    Site(&'a Site, [MaterialId; 2]),
    /// And its standard deviation as a share of the patch's.
    Patch(OfBlock<'a>, f64),
}

impl By<'_> {
    /// Standard deviation along the normal, blur units, as for white noise.
    fn sigma(&self, at: DVec3) -> Option<f64> {
        match self {
            Self::Site(site, pair) => site.sigma(*pair, at),
            Self::Patch(patch, share) => patch.sigma(at).map(|sigma| share * sigma),
        }
    }
}

impl<'a> Located<'a> {
    /// The crossing on an edge, in padded coordinates.
    #[must_use]
    pub fn find(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<Found<'a>> {
        let mut to = from;
        to[axis] += 1;
        let near_curve = [from, to].iter().any(|p| self.zone.bit(0, p[0], p[1], p[2]));
        let voxel = from.map(|c| c - 1);
        if !near_curve {
            return self.by_patch(voxel, axis, labels);
        }
        let middle = DVec3::from(voxel.map(|c| c as f64)) + 0.5 * DVec3::AXES[axis];
        let Some(answer) = self.sites.at(middle).or_else(|| self.sites.within(middle, FARTHER)) else {
            return self.by_patch(voxel, axis, labels);
        };
        if answer.yields
            && let Some(found) = self.by_patch(voxel, axis, labels)
        {
            return Some(found);
        }
        let step = DVec3::AXES[axis] * self.units.per_voxel[axis];
        let start = answer.at - step * 0.5;
        let site = answer.site;
        let found = |position: f64, passage: Passage| Found {
            position,
            normal: passage.normal,
            by: By::Site(site, labels),
            at: start + step * position,
        };
        let passage = |t: f64| site.passage(labels, start + step * t);
        let solved = solve(passage).map(|(t, passage)| found(t, passage));
        // Mostly that is where the one material ends and the other begins, and no more need be asked.
        let beside = |t: f64| [-BESIDE, BESIDE].map(|by| site.material(start + step * (t + by)));
        if let Some(found) = &solved
            && (0.0..=1.0).contains(&found.position)
            && beside(found.position) == labels
        {
            return solved;
        }
        if let Some(t) = site.change(labels, start, step)
            && let Some(passage) = passage(t)
        {
            return Some(found(t, passage));
        }
        solved.or_else(|| self.by_patch(voxel, axis, labels))
    }

    /// A standard deviation in blur units, as for white noise, in voxels as it is.
    pub(super) fn voxels(&self, sigma: f64) -> f64 {
        sigma * self.units.mean_voxels * self.inflation
    }

    /// Where a crossing lies that was found or not, as contouring asks for it.
    fn position_of(
        &self,
        found: Option<&Found<'_>>,
        from: [usize; 3],
        axis: usize,
        labels: [MaterialId; 2],
    ) -> Option<f32> {
        match found {
            Some(found) => Some((found.position as f32).clamp(CROSSING_MARGIN, 1.0 - CROSSING_MARGIN)),
            None => self.otherwise.located(from, axis, labels),
        }
    }

    /// Standard deviation of a crossing along its normal, voxels.
    fn sigma_of(&self, found: &Found<'_>) -> Option<f64> {
        found.by.sigma(found.at).map(|sigma| self.voxels(sigma))
    }

    /// By the patch of the block of the edge's lower end, or of its upper end.
    fn by_patch(&self, voxel: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<Found<'a>> {
        let rising = labels[0] < labels[1];
        let pair = if rising { labels } else { [labels[1], labels[0]] };
        let mut next = voxel;
        next[axis] += 1;
        let start = DVec3::from(voxel.map(|c| c as f64));
        let by = |patch: OfBlock<'a>| {
            let place = |t: f64| start + DVec3::AXES[axis] * t;
            let turned = |passage: Passage| if rising { passage } else { passage.reversed() };
            let (position, passage) = solve(|t| patch.passage(place(t)).map(turned))?;
            // What others around say is near to that: one step along the edge.
            let own = (&patch, turned(passage));
            let Blended { passage, sigma } = blended(self.patches, self.units, pair, place(position), own);
            let Passage { distance, normal } = turned(passage);
            let slope = normal[axis] * self.units.per_voxel[axis];
            let step = if slope > STEEP { -distance / slope } else { 0.0 };
            let position = position + step.clamp(-MOST_BLENDED, MOST_BLENDED);
            Some(Found { position, normal, by: By::Patch(patch, sigma), at: place(position) })
        };
        let of_block = |voxel: [usize; 3]| self.patches.of_block(self.units, voxel, pair);
        let ends = [voxel, next].map(of_block);
        if ends.iter().any(OfBlock::passes) {
            // Mostly both ends lie in one block.
            let others = ends.into_iter().skip(1).filter(|end| !end.is_of(&ends[0]));
            return by(ends[0]).or_else(|| others.into_iter().find_map(by));
        }
        // The labels came to differ here after the patches were made: a neighbour's is of the same sheet.
        [voxel, next].into_iter().flat_map(around).map(of_block).find_map(by)
    }
}

/// The place on an edge where a distance is zero, and what is there, by the secant method. The distance rises along the edge.
fn solve(passage: impl Fn(f64) -> Option<Passage>) -> Option<(f64, Passage)> {
    let mut before = (0.0, passage(0.0)?.distance);
    let mut at = 1.0;
    let mut here = passage(at)?;
    for _ in 0..4 {
        let slope = (here.distance - before.1) / (at - before.0);
        if slope <= FLATTEST {
            return None;
        }
        let next = (at - here.distance / slope).clamp(-BEYOND, 1.0 + BEYOND);
        if (next - at).abs() < 1e-6 {
            break;
        }
        before = (at, here.distance);
        at = next;
        here = passage(at)?;
    }
    (here.distance.abs() <= LEFT).then_some((at, here))
}

/// Whether these corners of a cell are one piece by its edges, or none.
fn hangs_together(corners: u8) -> bool {
    let mut piece = corners & corners.wrapping_neg();
    for _ in 1..CORNERS {
        let along = |step: u32, low: u8| (piece & low) << step | piece >> step & low;
        piece |= corners & (along(1, 0x55) | along(2, 0x33) | along(4, 0x0F));
    }
    piece == corners
}

/// The six neighbours of a voxel.
fn around(voxel: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..6).map(move |k| {
        let mut next = voxel;
        next[k / 2] = if k % 2 == 0 { next[k / 2].wrapping_sub(1) } else { next[k / 2] + 1 };
        next
    })
}

impl Located<'_> {
    /// Where a curve of the asked kind passes the plane of the face across `axis` with lowest padded corner `low`.
    fn pierced(&self, low: [usize; 3], axis: usize, kind: CurveKind) -> Option<Pierced<'_>> {
        if !face_corners(low, axis).any(|p| self.zone.bit(0, p[0], p[1], p[2])) {
            return None;
        }
        let voxel = DVec3::from(low.map(|c| c as f64 - 1.0));
        let mut middle = voxel + 0.5;
        middle[axis] -= 0.5;
        let (at, sigma, site) = self.sites.pierces(kind, [axis, low[axis] - 1], middle, FAR)?;
        let offset = at - voxel;
        let flat = DVec2::new(offset[(axis + 1) % 3], offset[(axis + 2) % 3]);
        let outside = (flat - 0.5).abs().max_element() - 0.5;
        Some(Pierced { at, sigma: self.voxels(sigma), site, outside })
    }

    /// Where the sharp edge passes that bends the interface in a face of two materials and two crossings.
    ///
    /// The face's crossings must lie on two of its sheets. Where they do not, the edge passes beside the segment between them,
    /// within the face or not; where they do, it passes between them, if only somewhat outside of the face.
    fn bend(&self, low: [usize; 3], axis: usize) -> Option<Pierced<'_>> {
        let pierced = self.pierced(low, axis, CurveKind::Edge).filter(|p| p.outside <= MOST_ASIDE)?;
        match self.sheets_of(pierced.site, low, axis) {
            Some([a, b]) => (a != b).then_some(pierced),
            None => (pierced.outside <= ASIDE).then_some(pierced),
        }
    }

    /// The sheets of a site on which the two crossings of a face of two materials lie; `None` if one is not known or not the site's.
    fn sheets_of(&self, site: &Site, low: [usize; 3], axis: usize) -> Option<[usize; 2]> {
        let ring = face_ring(2 * axis);
        let mut found = (0..4).filter_map(|k| {
            let e = edge_between(ring[k], ring[(k + 1) % 4]);
            let along = edge_axis(e);
            let [from, to] = edge_corners(e).map(|c| corner_at(low, c));
            let labels = [self.labels.at(from), self.labels.at(to)];
            (labels[0] != labels[1]).then(|| {
                let t = self.located(from, along, labels)?;
                let place = DVec3::from(from.map(|c| c as f64 - 1.0)) + DVec3::AXES[along] * f64::from(t);
                site.sheet(labels, self.units.of(place - site.middle))
            })
        });
        let both = [found.next()??, found.next()??];
        Some(both)
    }

    /// Whether the cell with lowest padded corner `low` has several sheets.
    fn is_crowded(&self, low: [usize; 3]) -> bool {
        let corners: [[usize; 3]; CORNERS] = std::array::from_fn(|c| corner_at(low, c));
        let labels = corners.map(|at| self.labels.at(at));
        let first = (0..CORNERS).filter(|&c| labels[c] == labels[0]).fold(0u8, |set, c| set | 1 << c);
        let others = (0..CORNERS).find(|&c| labels[c] != labels[0]).map(|c| labels[c]);
        let two = labels.iter().all(|l| *l == labels[0] || Some(*l) == others);
        // Two materials, each in one piece, have one sheet between them.
        if two && hangs_together(first) && hangs_together(!first) {
            return false;
        }
        let classes = classes_of(&labels);
        let join = (0..FACES).filter(|&f| is_ambiguous(&classes, f)).fold(0, |join, f| {
            let ring = face_ring(f);
            let pair = [labels[ring[0]], labels[ring[1]]];
            join | u8::from(self.joins_first(ring.map(|c| corners[c]), pair)) << f
        });
        sheets(&classes, join).len() > 1
    }
}

/// The corners (padded) of the face across `axis` whose lowest one is `low`.
pub(super) fn face_corners(low: [usize; 3], axis: usize) -> impl Iterator<Item = [usize; 3]> {
    face_ring(2 * axis).into_iter().map(move |c| corner_at(low, c))
}

/// Where a curve passes the plane of a face.
struct Pierced<'a> {
    /// In voxels.
    at: DVec3,
    /// Its standard deviation, voxels.
    sigma: f64,
    site: &'a Site,
    /// How far outside of the face, in edges; negative inside.
    outside: f64,
}

impl Pierced<'_> {
    /// As a node of the face with lowest padded corner `low` across `axis`.
    fn node(&self, low: [usize; 3], axis: usize) -> Node {
        let mut at = (self.at - DVec3::from(low.map(|c| c as f64 - 1.0))).as_vec3().to_array();
        at[axis] = 0.0;
        Node { at, sigma: self.sigma as f32 }
    }
}

/// A curve may pass a face so far outside of it (in edges) and is put to its side: it passes a neighbour, whose
/// labels say otherwise.
const ASIDE: f64 = 0.25;
/// And a sharp edge that is known to bend the interface between the face's crossings.
const MOST_ASIDE: f64 = 0.9;
/// A curve is followed so far along from the middle of its fit, blur units.
pub(super) const FAR: f64 = 4.5;

impl CrossingRule for Located<'_> {
    #[inline]
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.located(from, axis, labels).unwrap_or(0.5)
    }

    fn located(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<f32> {
        self.position_of(self.find(from, axis, labels).as_ref(), from, axis, labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        self.otherwise.joins_first(ring, labels)
    }

    fn has_sigmas(&self) -> bool {
        true
    }

    fn sigma(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        let found = self.find(from, axis, labels).and_then(|found| self.sigma_of(&found));
        found.map_or_else(|| self.otherwise.sigma(from, axis, labels), |sigma| sigma as f32)
    }

    fn placed(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> (f32, f32) {
        let found = self.find(from, axis, labels);
        let position = self.position_of(found.as_ref(), from, axis, labels).unwrap_or(0.5);
        let sigma = found.and_then(|found| self.sigma_of(&found));
        (position, sigma.map_or_else(|| self.otherwise.sigma(from, axis, labels), |sigma| sigma as f32))
    }

    fn node(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        let pierced = self.pierced(low, axis, CurveKind::Junction).filter(|p| p.outside <= ASIDE)?;
        Some(pierced.node(low, axis))
    }

    fn apex(&self, low: [usize; 3]) -> Option<Node> {
        let voxel = DVec3::from(low.map(|c| c as f64 - 1.0));
        let (at, sigma) = self.sites.corner(voxel)?;
        Some(Node { at: (at - voxel).as_vec3().to_array(), sigma: self.voxels(sigma) as f32 })
    }

    fn has_kinks(&self) -> bool {
        true
    }

    fn moves(&self) -> Option<&Moves> {
        self.moves
    }

    fn kink(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        let node = self.bend(low, axis)?.node(low, axis);
        // Beside several sheets in a cell a kink may reach past another than its own, and they would meet.
        let mut below = low;
        below[axis] -= 1;
        (!self.is_crowded(low) && !self.is_crowded(below)).then_some(node)
    }
}

#[cfg(test)]
mod tests {
    use super::hangs_together;
    use crate::grid::cube::{CORNERS, EDGES, edge_corners};

    #[test]
    fn corners_that_hang_together_are_told_from_pieces() {
        for corners in 0..=u8::MAX {
            let own = |c: usize| corners >> c & 1 == 1;
            let mut piece: Vec<usize> = (0..CORNERS).collect();
            for _ in 0..CORNERS {
                for [p, q] in (0..EDGES).map(edge_corners).filter(|ends| ends.iter().all(|&c| own(c))) {
                    let least = piece[p].min(piece[q]);
                    (piece[p], piece[q]) = (least, least);
                }
            }
            let mut pieces: Vec<usize> = (0..CORNERS).filter(|&c| own(c)).map(|c| piece[c]).collect();
            pieces.sort_unstable();
            pieces.dedup();
            assert_eq!(hangs_together(corners), pieces.len() <= 1, "{corners:b}");
        }
    }
}
