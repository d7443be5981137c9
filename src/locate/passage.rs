//! Where an interface passes a place.

use glam::DVec3;

/// Where an interface passes near a place, as a model knows it; in blur units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passage {
    /// Distance of the place from the interface, positive on the side of the second material.
    pub distance: f64,
    /// Unit normal of the interface there, from the first material to the second.
    pub normal: DVec3,
}

impl Passage {
    /// With the two materials changed about.
    #[must_use]
    pub fn reversed(self) -> Self {
        Self { distance: -self.distance, normal: -self.normal }
    }
}
