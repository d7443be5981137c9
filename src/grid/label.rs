//! Material ids and ordered pairs of them.

use serde::{Deserialize, Serialize};

/// A material: a dense id `0..n` in ascending order of mean grey value. 0 is the background (air),
/// 255 is reserved for [`MaterialId::OUTSIDE`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MaterialId(pub u8);

impl MaterialId {
    /// The background material, air.
    pub const BACKGROUND: Self = Self(0);
    /// The world beyond the volume's border.
    pub const OUTSIDE: Self = Self(255);
    /// How many materials there can be at most (ids `0..=253`; 254 is kept for internal marks).
    pub const MAX_COUNT: usize = 254;
}

/// Two different materials that meet at an interface. `back > front` by id, except that
/// [`MaterialId::OUTSIDE`] is always in front. An interface's normal points from back to front.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Pair {
    back: MaterialId,
    front: MaterialId,
}

impl Pair {
    /// The ordered pair of two materials; `None` if they are the same.
    #[must_use]
    #[inline]
    pub fn new(a: MaterialId, b: MaterialId) -> Option<Self> {
        if a == b {
            return None;
        }
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        // OUTSIDE has the highest id, so putting it in front means not swapping.
        Some(if high == MaterialId::OUTSIDE {
            Self { back: low, front: high }
        } else {
            Self { back: high, front: low }
        })
    }

    /// The material behind a triangle of this pair.
    #[must_use]
    pub fn back(self) -> MaterialId {
        self.back
    }

    /// The material in front of a triangle of this pair: where its normal points.
    #[must_use]
    pub fn front(self) -> MaterialId {
        self.front
    }

    /// Whether `id` is one of the two.
    #[must_use]
    pub fn contains(self, id: MaterialId) -> bool {
        self.back == id || self.front == id
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_denser_material_is_behind_and_outside_is_in_front() {
        let pair = |a, b| Pair::new(MaterialId(a), MaterialId(b)).map(|p| (p.back().0, p.front().0));
        assert_eq!(pair(0, 2), Some((2, 0)));
        assert_eq!(pair(2, 0), Some((2, 0)));
        assert_eq!(pair(255, 2), Some((2, 255)));
        assert_eq!(pair(0, 255), Some((0, 255)));
        assert_eq!(pair(1, 1), None);
    }
}
