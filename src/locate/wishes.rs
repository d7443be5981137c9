//! Where vertices near curves should lie, wherever they are safe: what contouring tries to grant.
//!
//! Nodes and apexes belong on their curve, kinks on their edge, and the crossing of an edge that meets two sheets on
//! its own.

use glam::DVec3;

use super::rule::{BESIDE, FAR, Located, face_corners};
use super::sites::{CurveKind, FARTHER};
use crate::contour::{CrossingRule, Node, Wishes};
use crate::grid::MaterialId;
use crate::grid::cube::{CORNERS, corner_at};

/// A crossing keeps this distance from the curve at which its sheet ends, blur units: triangles between the two need a height.
const OFF_CURVE: f64 = 0.2;

impl Located<'_> {
    /// The point of a curve between the materials of some voxels (padded) nearest to a place (voxels).
    fn on_curve(
        &self,
        kind: CurveKind,
        place: DVec3,
        voxels: impl Iterator<Item = [usize; 3]>,
    ) -> Option<Node> {
        let mut materials: Vec<MaterialId> = voxels.map(|voxel| self.labels.at(voxel)).collect();
        materials.sort_unstable();
        materials.dedup();
        let (at, sigma) = self.sites.nearest(kind, place, FAR, &materials)?;
        Some(Node { at: at.as_vec3().to_array(), sigma: self.voxels(sigma) as f32 })
    }
}

impl Wishes for Located<'_> {
    fn speaks(&self, low: [usize; 3]) -> bool {
        (0..8).any(|c| self.zone.bit(0, low[0] + (c & 1), low[1] + (c >> 1 & 1), low[2] + (c >> 2)))
    }

    fn crossing(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<Node> {
        let middle = DVec3::from(from.map(|c| c as f64 - 1.0)) + 0.5 * DVec3::AXES[axis];
        let answer = self.sites.at(middle).or_else(|| self.sites.within(middle, FARTHER))?;
        if answer.kind != CurveKind::Junction {
            return None;
        }
        let step = DVec3::AXES[axis] * self.units.per_voxel[axis];
        let start = answer.at - step * 0.5;
        // Where the edge has left its first material, and where it comes to its second.
        let t = f64::from(self.position(from, axis, labels));
        let safe = start + step * t;
        let beside = [-BESIDE, BESIDE].map(|by| answer.site.material(safe + step * by));
        if beside == labels {
            return None;
        }
        let (on, sigma) = answer.site.on_sheet(labels, safe, OFF_CURVE)?;
        let at = middle + self.units.voxel(on - answer.at);
        Some(Node { at: at.as_vec3().to_array(), sigma: self.voxels(sigma) as f32 })
    }

    fn node(&self, low: [usize; 3], axis: usize, safe: [f32; 3]) -> Option<Node> {
        self.on_curve(CurveKind::Junction, DVec3::from(safe.map(f64::from)), face_corners(low, axis))
    }

    fn kink(&self, low: [usize; 3], axis: usize, safe: [f32; 3]) -> Option<Node> {
        // Not where the edge passes the face's plane: that may be behind a neighbour's kink.
        self.on_curve(CurveKind::Edge, DVec3::from(safe.map(f64::from)), face_corners(low, axis))
    }

    fn facing(&self, labels: [MaterialId; 2], at: [f32; 3]) -> Option<[f32; 3]> {
        let place = DVec3::from(at.map(f64::from));
        let answer = self.sites.at(place).or_else(|| self.sites.within(place, FARTHER))?;
        let passage = answer.site.passage(labels, answer.at)?;
        Some((passage.normal * self.units.per_voxel).as_vec3().to_array())
    }

    fn apex(&self, low: [usize; 3], at: [f32; 3]) -> Option<Node> {
        if let Some((at, sigma)) = self.sites.corner(DVec3::from(low.map(|c| c as f64 - 1.0))) {
            return Some(Node { at: at.as_vec3().to_array(), sigma: self.voxels(sigma) as f32 });
        }
        let corners = (0..CORNERS).map(|c| corner_at(low, c));
        self.on_curve(CurveKind::Junction, DVec3::from(at.map(f64::from)), corners)
    }
}
