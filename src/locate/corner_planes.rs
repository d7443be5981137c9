//! The planes around a place, from patches: what corners start from.
//!
//! A patch tells where its interface would pass next to the place, curvature and all; those that agree are of one
//! plane, whatever materials they part: flush faces are one plane.

use glam::{DMat3, DVec3};

use super::flanks::FlatIndex;
use super::patches::Flat;
use super::view::View;
use crate::grid::MaterialId;

/// Patches are looked for within this distance of a place, blur units.
const AROUND: f64 = 10.5;
/// No more patches than this are looked at, the nearest ones.
const NEAR: usize = 200;
/// Fewest patches that make a plane, and how many planes are looked at.
const FEWEST: usize = 1;
const MOST: usize = 7;
/// Least cosine of the normals of a plane's patches, and how far they may be from it next to the place.
const AGREE: f64 = 0.97;
const OFF: f64 = 0.6;
/// A patch that turns farther than this on the way tells nothing.
const TURN: f64 = 0.7;
/// A patch that is worse known than the median by this factor makes no plane of its own.
const POOR: f64 = 2.0;
/// Curvatures count from so many standard deviations on.
const CURVED: f64 = 3.0;

/// A patch of a plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part<'a> {
    pub(super) flat: &'a Flat,
    /// The patch in blur units from the place.
    pub(super) at: DVec3,
    /// Whether the patch's normal points against the plane's.
    pub(super) turned: bool,
}

/// Patches that agree.
#[derive(Debug, Clone)]
pub(super) struct Plane<'a> {
    /// Unit normal.
    pub(super) normal: DVec3,
    /// Distance along the normal from the place, blur units.
    pub(super) offset: f64,
    /// The patches.
    pub(super) parts: Vec<Part<'a>>,
    /// Sums of weighted normals and offsets, and of weights.
    sums: (DVec3, f64, f64),
}

impl Plane<'_> {
    /// The plane seen from a place so far away, blur units.
    pub(super) fn from(&self, away: DVec3) -> Self {
        let mut plane = self.clone();
        plane.offset -= self.normal.dot(away);
        for part in &mut plane.parts {
            part.at -= away;
        }
        plane
    }

    /// The one of `planes` that this is.
    pub(super) fn among<'b, 'c>(&self, planes: &'b [Plane<'c>]) -> Option<&'b Plane<'c>> {
        planes.iter().find(|p| p.is_that_of(self.normal, self.offset))
    }

    /// Whether this is the plane with about this normal, either way round, and offset along it.
    fn is_that_of(&self, normal: DVec3, offset: f64) -> bool {
        let cos = self.normal.dot(normal);
        cos.abs() > AGREE && (offset * cos.signum() - self.offset).abs() < OFF
    }

    /// A point of the plane.
    pub(super) fn point(&self) -> DVec3 {
        self.normal * self.offset
    }

    /// How the plane bends, as a form on space, and the standard deviation of its entries.
    pub(super) fn bend(&self, shared: f64) -> (DMat3, f64) {
        let (mut sum, mut weight) = (DMat3::ZERO, 0.0);
        for part in &self.parts {
            let w = (shared * part.flat.form_sigma).max(1e-9).powi(-2);
            sum += part.flat.form * if part.turned { -w } else { w };
            weight += w;
        }
        let form = sum * (1.0 / weight.max(1e-300));
        let n = self.normal;
        let project = DMat3::IDENTITY - DMat3::from_cols(n * n.x, n * n.y, n * n.z);
        (project * form * project, weight.max(1e-300).powf(-0.5))
    }
}

/// From which uncertainty of their forms on patches of each pair are poor: interfaces of small contrast are all less certain than those of large
/// contrast beside them.
fn poor_of<'a>(flats: impl Iterator<Item = &'a Flat>) -> Vec<([MaterialId; 2], f64)> {
    let mut spread: Vec<([MaterialId; 2], f64)> = flats.map(|flat| (flat.pair, flat.form_sigma)).collect();
    spread.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    spread.chunk_by(|a, b| a.0 == b.0).map(|own| (own[0].0, POOR * own[own.len() / 2].1)).collect()
}

/// The planes that patches show around `centre` (voxels), those with most patches first.
pub(super) fn planes_about<'a>(view: &View<'_>, flats: &'a FlatIndex, centre: DVec3) -> Vec<Plane<'a>> {
    let reach = view.units.voxel(DVec3::splat(AROUND)).max_element();
    let mut near: Vec<(f64, DVec3, &Flat)> = flats
        .near(centre, reach)
        .map(|flat| {
            let at = view.units.of(flat.at - centre);
            (at.length(), at, flat)
        })
        .filter(|f| f.0 <= AROUND)
        .collect();
    near.sort_by(|a, b| {
        let key = |f: &(f64, DVec3, &Flat)| [f.0, f.1.z, f.1.y, f.1.x];
        key(a)
            .iter()
            .zip(key(b))
            .map(|(x, y)| x.total_cmp(&y))
            .find(|o| o.is_ne())
            .unwrap_or(a.2.pair.cmp(&b.2.pair))
    });
    near.truncate(NEAR);
    let poor = poor_of(near.iter().map(|f| f.2));
    let is_poor = |flat: &Flat| flat.form_sigma > poor.iter().find(|p| p.0 == flat.pair).map_or(0.0, |p| p.1);
    // Those that are well known first: planes form about them.
    near.sort_by_key(|f| is_poor(f.2));
    let best = poor.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let mut planes: Vec<Plane<'a>> = Vec::new();
    for (_, at, flat) in near {
        let n = flat.normal;
        let along = n * n.dot(at) - at;
        let form = if flat.curvature > CURVED * flat.form_sigma { flat.form } else { DMat3::ZERO };
        let turned = form * along;
        if turned.length() > TURN {
            continue;
        }
        let foot = at + along + n * (0.5 * along.dot(turned));
        let normal = (n - turned).normalize();
        let offset = normal.dot(foot);
        let known = (best / flat.form_sigma.max(1e-9)).min(4.0).powi(2);
        let weight = known / (1.0 + 0.1 * along.length_squared()).powi(2);
        let same = planes.iter().position(|p| p.is_that_of(normal, offset));
        if same.is_none() && is_poor(flat) {
            continue;
        }
        let i = same.unwrap_or_else(|| {
            planes.push(Plane { normal, offset, parts: Vec::new(), sums: (DVec3::ZERO, 0.0, 0.0) });
            planes.len() - 1
        });
        let plane = &mut planes[i];
        let sign = plane.normal.dot(normal).signum();
        plane.parts.push(Part { flat, at, turned: sign < 0.0 });
        plane.sums.0 += normal * (sign * weight);
        plane.sums.1 += offset * sign * weight;
        plane.sums.2 += weight;
        plane.normal = plane.sums.0.normalize();
        plane.offset = plane.sums.1 / plane.sums.2;
    }
    planes.retain(|p| p.parts.len() >= FEWEST);
    // Stable: of equals the nearer one first.
    planes.sort_by_key(|p| std::cmp::Reverse(p.parts.len()));
    planes.truncate(MOST);
    planes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_of_small_contrast_are_poor_among_their_own_only() {
        let flat = |pair: [u8; 2], form_sigma: f64| Flat {
            pair: pair.map(MaterialId),
            at: DVec3::ZERO,
            normal: DVec3::Z,
            sigma: 0.01,
            curvature: 0.0,
            form: DMat3::ZERO,
            form_sigma,
        };
        // Iron in air is known five times as well as aluminium in air.
        let mut flats = vec![flat([0, 2], 0.001); 9];
        flats.extend([0.004, 0.005, 0.006, 0.02].map(|sigma| flat([0, 1], sigma)));
        let poor = poor_of(flats.iter());
        assert_eq!(poor, [([0, 1].map(MaterialId), POOR * 0.006), ([0, 2].map(MaterialId), POOR * 0.001)]);
    }
}
