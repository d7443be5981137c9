//! What a mesh vertex is.

use serde::{Deserialize, Serialize};

/// What a vertex lies on. The code is the one DREAM3D users know: the number of materials that
/// meet there (4: four or more), plus 10 on the volume's border.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum VertexKind {
    /// Two materials meet: inside an interface.
    Interface = 2,
    /// Three materials meet: on a junction curve.
    JunctionCurve = 3,
    /// Four or more materials meet: a junction point.
    JunctionPoint = 4,
    /// As [`VertexKind::Interface`], on the volume's border.
    BorderInterface = 12,
    /// As [`VertexKind::JunctionCurve`], on the volume's border.
    BorderJunctionCurve = 13,
    /// As [`VertexKind::JunctionPoint`], on the volume's border.
    BorderJunctionPoint = 14,
}

impl VertexKind {
    /// The kind of a vertex where `materials` different materials meet (`OUTSIDE` counts as one).
    #[must_use]
    #[inline]
    pub fn new(materials: usize, border: bool) -> Self {
        match (materials, border) {
            (0..=2, false) => Self::Interface,
            (3, false) => Self::JunctionCurve,
            (_, false) => Self::JunctionPoint,
            (0..=2, true) => Self::BorderInterface,
            (3, true) => Self::BorderJunctionCurve,
            (_, true) => Self::BorderJunctionPoint,
        }
    }

    /// The code written to files.
    #[must_use]
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The kind with this code, if there is one.
    #[must_use]
    pub fn from_code(code: u8) -> Option<Self> {
        [
            Self::Interface,
            Self::JunctionCurve,
            Self::JunctionPoint,
            Self::BorderInterface,
            Self::BorderJunctionCurve,
            Self::BorderJunctionPoint,
        ]
        .into_iter()
        .find(|kind| kind.code() == code)
    }

    /// Whether the vertex lies on the volume's border.
    #[must_use]
    pub fn is_border(self) -> bool {
        self.code() > 10
    }
}
