//! A scene: every point of space has exactly one material.
//!
//! A scene is a list of surfaces and an ordered list of solids. A solid is a union of parts, a part
//! is an intersection of sides of surfaces, and where solids overlap the later one wins; what is in
//! none is background. So the material of a point depends only on which sides of the surfaces it
//! is on: a bit mask. Solids that share a face share its *surface*, not an equal copy of it; that is
//! what makes flush faces exact.

use glam::{DMat3, DVec3};

use super::surface::Surface;
use crate::grid::{MaterialId, Pair};

/// The side of a surface: its index in the scene, and whether inside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Side(pub(super) usize, pub(super) bool);

/// An intersection of sides as masks: the surfaces it looks at, and which of them it is inside of.
#[derive(Debug, Clone, Copy)]
struct Part {
    care: u64,
    inside: u64,
}

#[derive(Debug, Clone)]
struct Solid {
    material: MaterialId,
    parts: Vec<Part>,
}

/// Surfaces and the solids they bound; see the module's description.
#[derive(Debug, Clone, Default)]
pub struct Scene {
    surfaces: Vec<Surface>,
    solids: Vec<Solid>,
}

impl Scene {
    /// The most surfaces a scene may have: one bit of a mask each.
    pub const MAX_SURFACES: usize = 64;

    pub(super) fn add(&mut self, surface: Surface) -> usize {
        debug_assert!(self.surfaces.len() < Self::MAX_SURFACES);
        self.surfaces.push(surface);
        self.surfaces.len() - 1
    }

    /// The plane through `normal * offset`, inside against `normal`.
    pub(super) fn plane(&mut self, normal: DVec3, offset: f64) -> usize {
        self.add(Surface::Plane { normal, offset })
    }

    /// The six planes of an axis-aligned box as sides, in the order low x, high x, low y, ...
    pub(super) fn cuboid(&mut self, low: DVec3, high: DVec3) -> [Side; 6] {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        std::array::from_fn(|k| {
            let (a, upper) = (k / 2, k % 2 == 1);
            let surface = if upper { self.plane(axes[a], high[a]) } else { self.plane(-axes[a], -low[a]) };
            Side(surface, true)
        })
    }

    /// Adds a solid of `material`: the union of `parts`. It wins over the solids before it.
    pub(super) fn solid(&mut self, material: u8, parts: &[&[Side]]) {
        let parts = parts
            .iter()
            .map(|sides| {
                sides.iter().fold(Part { care: 0, inside: 0 }, |part, side| Part {
                    care: part.care | 1 << side.0,
                    inside: part.inside | u64::from(side.1) << side.0,
                })
            })
            .collect();
        self.solids.push(Solid { material: MaterialId(material), parts });
    }

    /// The scene rotated, then scaled, then shifted.
    #[must_use]
    pub(super) fn placed(&self, rotation: &DMat3, scale: f64, shift: DVec3) -> Self {
        let surfaces = self.surfaces.iter().map(|s| s.placed(rotation, scale, shift)).collect();
        Self { surfaces, solids: self.solids.clone() }
    }

    /// The surfaces, without their trimming.
    #[must_use]
    pub fn surfaces(&self) -> &[Surface] {
        &self.surfaces
    }

    /// Which surfaces `p` is inside of: bit i for surface i.
    pub(super) fn mask(&self, p: DVec3) -> u64 {
        self.surfaces
            .iter()
            .enumerate()
            .fold(0, |mask, (i, s)| mask | u64::from(s.signed_distance(p) < 0.0) << i)
    }

    /// The material of the points inside of exactly the surfaces in `mask`.
    pub(super) fn material_of(&self, mask: u64) -> MaterialId {
        self.solids
            .iter()
            .rev()
            .find(|solid| solid.parts.iter().any(|part| mask & part.care == part.inside))
            .map_or(MaterialId::BACKGROUND, |solid| solid.material)
    }

    /// The one material of all points whose mask differs from `mask` in the bits `open` at most, if
    /// it is known to be one.
    pub(super) fn uniform(&self, mask: u64, open: u64) -> Option<MaterialId> {
        // Beyond six open surfaces the enumeration costs more than it saves.
        if open.count_ones() > 6 {
            return None;
        }
        let base = mask & !open;
        let first = self.material_of(base);
        let mut sub = open;
        while sub != 0 {
            if self.material_of(base | sub) != first {
                return None;
            }
            sub = (sub - 1) & open;
        }
        Some(first)
    }

    /// The material of a point.
    #[must_use]
    pub fn material_at(&self, p: DVec3) -> MaterialId {
        self.material_of(self.mask(p))
    }

    /// The materials just inside and just outside of `surface` at its point `p`.
    #[must_use]
    pub fn sides(&self, surface: usize, p: DVec3) -> (MaterialId, MaterialId) {
        let mask = self.mask(p);
        (self.material_of(mask | 1 << surface), self.material_of(mask & !(1 << surface)))
    }

    /// The interface on `surface` at its point `p`, if there is one there, and whether the pair's
    /// front material is on the outside.
    #[must_use]
    pub fn interface_at(&self, surface: usize, p: DVec3) -> Option<(Pair, bool)> {
        let (inside, outside) = self.sides(surface, p);
        Pair::new(inside, outside).map(|pair| (pair, pair.front() == outside))
    }
}
