//! A place where sheets meet in a curve: a wedge that was fitted and accepted, and what it says nearby.

use glam::DVec3;

use super::passage::Passage;
use super::wedge::{EDGE, JUNCTION, WedgeFit};
use crate::grid::MaterialId;

/// The wedge of a site.
#[derive(Debug, Clone)]
pub enum Model {
    /// A junction curve.
    Junction(Box<WedgeFit<3, JUNCTION>>),
    /// A sharp edge.
    Edge(Box<WedgeFit<2, EDGE>>),
}

/// See the module's header.
#[derive(Debug, Clone)]
pub struct Site {
    /// The middle of the window, voxels; the model is in blur units about it.
    pub middle: DVec3,
    /// A point of the curve, voxels.
    pub at: DVec3,
    /// The material of each sector; of an edge the first two count.
    pub materials: [MaterialId; 3],
    /// The fit.
    pub model: Model,
}

macro_rules! with_fit {
    ($site:expr, $fit:ident => $body:expr) => {
        match &$site.model {
            Model::Junction($fit) => $body,
            Model::Edge($fit) => $body,
        }
    };
}

impl Site {
    /// Number of sectors.
    #[must_use]
    pub fn sectors(&self) -> usize {
        match self.model {
            Model::Junction(_) => 3,
            Model::Edge(_) => 2,
        }
    }

    /// Distance of a place (blur units from the middle) from the curve, and how far along it the place lies
    /// from where the fit is centred.
    #[must_use]
    pub fn around(&self, at: DVec3) -> [f64; 2] {
        with_fit!(self, fit => {
            let (r, z) = fit.wedge.section(at);
            [r.length(), z]
        })
    }

    /// The material at a place.
    #[must_use]
    pub fn material(&self, at: DVec3) -> MaterialId {
        self.materials[with_fit!(self, fit => fit.wedge.sector(at))]
    }

    /// The interface between two of its materials near a place; `None` if they do not meet here. Behind the
    /// curve sheets do not go on.
    #[must_use]
    pub fn passage(&self, [a, b]: [MaterialId; 2], at: DVec3) -> Option<Passage> {
        let n = self.sectors();
        let mut best: Option<(f64, Passage)> = None;
        for i in 0..n {
            let (before, after) = (self.materials[(i + n - 1) % n], self.materials[i]);
            let along = (before, after) == (a, b);
            if !along && (before, after) != (b, a) {
                continue;
            }
            let (distance, c, normal, sigma) = with_fit!(self, fit => {
                let (d, c, normal) = fit.wedge.sheet(i, at);
                (d, c, normal, fit.sheet_sigma(i, at))
            });
            let away = distance.hypot(c.min(0.0));
            if best.as_ref().is_none_or(|(least, _)| away < *least) {
                let passage = Passage { distance, normal, sigma };
                best = Some((away, if along { passage } else { passage.reversed() }));
            }
        }
        best.map(|b| b.1)
    }

    /// Where the segment from `start` along `step` goes from material `a` to `b`, as a fraction; `None` if it does
    /// not, once.
    #[must_use]
    pub fn change(&self, [a, b]: [MaterialId; 2], start: DVec3, step: DVec3) -> Option<f64> {
        if self.material(start) != a || self.material(start + step) != b {
            return None;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..16 {
            let middle = 0.5 * (low + high);
            let found = self.material(start + step * middle);
            if found == a {
                low = middle;
            } else if found == b {
                high = middle;
            } else {
                // A third material between: the edge meets two sheets, and no place is right.
                return Some(middle);
            }
        }
        Some(0.5 * (low + high))
    }

    /// Where the curve passes the plane `coordinate` (voxels) of an axis, in voxels, and its standard
    /// deviation in blur units; `None` where it runs along the plane or far from here.
    #[must_use]
    pub fn pierces(
        &self,
        axis: usize,
        coordinate: f64,
        per_voxel: DVec3,
        reach: f64,
    ) -> Option<(DVec3, f64)> {
        with_fit!(self, fit => {
            let target = (coordinate - self.middle[axis]) * per_voxel[axis];
            let mut z = 0.0;
            for _ in 0..6 {
                let slope = fit.wedge.direction(z)[axis];
                if slope.abs() < 0.05 {
                    return None;
                }
                z += ((target - fit.wedge.point(z)[axis]) / slope).clamp(-2.0, 2.0);
            }
            let at = fit.wedge.point(z);
            if z.abs() > reach || (at[axis] - target).abs() > 1e-3 {
                return None;
            }
            Some((self.middle + at / per_voxel, fit.apex_sigma(z)[1]))
        })
    }
}
