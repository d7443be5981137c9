//! What a corner that was fitted and accepted says nearby.

use glam::{DMat3, DVec3};

use super::cone::{Cone, ConeFit};
use super::corner::{Corner, CornerFit, LineKind, MATERIALS};
use super::passage::Passage;
use super::sites::CurveKind;
use crate::grid::MaterialId;

/// What was fitted.
#[derive(Debug, Clone)]
pub(super) enum Shape {
    /// Three planes.
    Planes(Box<CornerFit>),
    /// Four cones.
    Cones(Box<ConeFit>),
}

/// A corner and its materials.
#[derive(Debug, Clone)]
pub struct CornerSite {
    shape: Shape,
    /// By the numbers that the shape counts materials by.
    materials: [MaterialId; MATERIALS],
    lines: Vec<Line>,
    /// How far along them its sheets are known, blur units.
    reach: f64,
}

/// A curve that leaves a corner.
#[derive(Debug, Clone, Copy)]
struct Line {
    kind: CurveKind,
    /// Unit vector away from the apex.
    direction: DVec3,
    /// Two of the sheets that meet in it: planes, or the materials beside.
    sheets: [[usize; 2]; 2],
    /// The materials around it, some more than once.
    around: [MaterialId; 4],
}

/// A curve that leaves a corner, seen from a place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near {
    /// Distance of the place from it, blur units.
    pub(super) distance: f64,
    /// What it is.
    pub(super) kind: CurveKind,
}

/// Sheets that are known to this are followed so far along the curves at least, and at most; blur units.
const KNOWN: f64 = 0.08;
const FOLLOWED: [f64; 2] = [6.0, 9.0];

/// The curves of a shape. An end of two edges that touch counts as an edge.
fn lines_of(shape: &Shape, materials: &[MaterialId; MATERIALS]) -> Vec<Line> {
    match shape {
        Shape::Planes(fit) => fit
            .corner
            .lines()
            .iter()
            .filter_map(|line| {
                let kind = match line.kind {
                    LineKind::None => return None,
                    LineKind::Edge | LineKind::Crossing => CurveKind::Edge,
                    LineKind::Junction => CurveKind::Junction,
                };
                let around = line.around.map(|m| materials[usize::from(m)]);
                Some(Line { kind, direction: line.direction, sheets: line.planes.map(|i| [i; 2]), around })
            })
            .collect(),
        Shape::Cones(fit) => (0..4)
            .filter_map(|ray| {
                let [a, b, c] = [1, 2, 3].map(|k| (ray + k) % 4);
                let [x, y, z] = [a, b, c].map(|m| materials[m]);
                let kind = match (x == y, y == z, z == x) {
                    (true, true, _) => return None,
                    (false, false, false) => CurveKind::Junction,
                    _ => CurveKind::Edge,
                };
                // Sheets between equal materials are not seen.
                let mut seen =
                    [[a, b], [b, c], [c, a]].into_iter().filter(|s| materials[s[0]] != materials[s[1]]);
                let sheets = [seen.next()?, seen.next()?];
                Some(Line { kind, direction: fit.cone.rays[ray], sheets, around: [x, y, z, z] })
            })
            .collect(),
    }
}

impl CornerSite {
    /// Of a fit that counts materials like `materials`.
    #[must_use]
    pub(super) fn new(shape: Shape, materials: [MaterialId; MATERIALS]) -> Self {
        let lines = lines_of(&shape, &materials);
        let mut out = Self { shape, materials, lines, reach: FOLLOWED[0] };
        let is_known = |reach: f64| {
            out.lines.iter().all(|line| {
                let at = out.apex() + line.direction * reach;
                line.sheets.iter().all(|&sheet| out.sheet_sigma(sheet, at) < KNOWN)
            })
        };
        let mut reach = FOLLOWED[0];
        while reach < FOLLOWED[1] && is_known(reach + 0.5) {
            reach += 0.5;
        }
        out.reach = reach;
        out
    }

    fn apex(&self) -> DVec3 {
        match &self.shape {
            Shape::Planes(fit) => fit.corner.apex,
            Shape::Cones(fit) => fit.cone.apex,
        }
    }

    /// Standard deviation of the apex in its worst direction, blur units, for white noise.
    #[must_use]
    pub fn apex_sigma(&self) -> f64 {
        match &self.shape {
            Shape::Planes(fit) => fit.apex_sigmas()[2],
            Shape::Cones(fit) => fit.apex_sigmas()[2],
        }
    }

    /// Misfit per sample.
    #[must_use]
    pub(super) fn reduced(&self) -> f64 {
        match &self.shape {
            Shape::Planes(fit) => fit.reduced(),
            Shape::Cones(fit) => fit.reduced(),
        }
    }

    fn sheet_sigma(&self, sheet: [usize; 2], at: DVec3) -> f64 {
        match &self.shape {
            Shape::Planes(fit) => fit.plane_sigma(sheet[0], at),
            Shape::Cones(fit) => fit.sheet_sigma(sheet[0], sheet[1], at),
        }
    }

    /// How far along its curves it may speak, blur units.
    #[must_use]
    pub(super) fn reach(&self) -> f64 {
        self.reach
    }

    /// The material at a place.
    #[must_use]
    pub fn material(&self, at: DVec3) -> MaterialId {
        self.materials[match &self.shape {
            Shape::Planes(fit) => usize::from(fit.corner.material(at)),
            Shape::Cones(fit) => fit.cone.material(at),
        }]
    }

    /// How many materials meet in it.
    #[must_use]
    pub(super) fn count(&self) -> usize {
        let mut all = match &self.shape {
            Shape::Planes(fit) => fit.corner.materials.map(|m| self.materials[usize::from(m)]).to_vec(),
            Shape::Cones(_) => self.materials.to_vec(),
        };
        all.sort_unstable();
        all.dedup();
        all.len()
    }

    /// How far a place is from the apex, blur units.
    #[must_use]
    pub(super) fn radius(&self, at: DVec3) -> f64 {
        at.distance(self.apex())
    }

    /// The curve nearest to a place, of a kind or of any.
    #[must_use]
    pub(super) fn nearest(&self, at: DVec3, asked: Option<CurveKind>) -> Option<Near> {
        let r = at - self.apex();
        let own = self.lines.iter().filter(|line| asked.is_none_or(|asked| asked == line.kind));
        let seen = own.map(|line| Near { distance: self.beside(line, r, at), kind: line.kind });
        seen.min_by(|a, b| a.distance.total_cmp(&b.distance))
    }

    /// Distance of a place, `r` from the apex, from a curve.
    fn beside(&self, line: &Line, r: DVec3, at: DVec3) -> f64 {
        let along = line.direction.dot(r);
        if along <= 0.0 {
            return r.length();
        }
        match &self.shape {
            Shape::Planes(fit) => {
                let [i, j] = line.sheets.map(|s| s[0]);
                let (d, e) = (fit.corner.distance(i, at), fit.corner.distance(j, at));
                let c = fit.corner.normals[i].dot(fit.corner.normals[j]);
                let square = (d * d + e * e - 2.0 * c * d * e) / (1.0 - c * c).max(1e-6);
                square.max(0.0).sqrt()
            }
            Shape::Cones(_) => (r - line.direction * along).length(),
        }
    }

    /// The interface between two of its materials near a place; `None` if they do not meet here.
    #[must_use]
    pub fn passage(&self, pair: [MaterialId; 2], at: DVec3) -> Option<Passage> {
        let (sheet, along) = self.nearest_sheet(pair, at)?;
        let passage = match &self.shape {
            Shape::Planes(fit) => {
                let (corner, i) = (&fit.corner, sheet[0]);
                let normal = (corner.normals[i] - corner.forms[i] * (at - corner.apex)).normalize();
                Passage { distance: corner.distance(i, at), normal }
            }
            Shape::Cones(fit) => {
                let [m, n] = sheet;
                Passage { distance: fit.cone.distance(m, n, at), normal: fit.cone.normal(m, n) }
            }
        };
        Some(if along { passage } else { passage.reversed() })
    }

    /// Standard deviation of the place of that interface along its normal, for white noise.
    #[must_use]
    pub fn sigma(&self, pair: [MaterialId; 2], at: DVec3) -> Option<f64> {
        self.nearest_sheet(pair, at).map(|(sheet, _)| self.sheet_sigma(sheet, at))
    }

    /// A number for the sheet between two of its materials near a place.
    #[must_use]
    pub(super) fn sheet(&self, pair: [MaterialId; 2], at: DVec3) -> Option<usize> {
        self.nearest_sheet(pair, at).map(|([m, n], _)| m * MATERIALS + n)
    }

    /// The sheet between two of its materials near a place (a plane, or the materials beside), and whether it goes from the first
    /// to the second.
    fn nearest_sheet(&self, pair: [MaterialId; 2], at: DVec3) -> Option<([usize; 2], bool)> {
        match &self.shape {
            Shape::Planes(fit) => self.nearest_quarter(fit, pair, at).map(|q| ([q.plane; 2], q.along)),
            Shape::Cones(fit) => self.nearest_of_cones(fit, pair, at).map(|sheet| (sheet, true)),
        }
    }

    fn nearest_quarter(&self, fit: &CornerFit, pair: [MaterialId; 2], at: DVec3) -> Option<Quarter> {
        let corner = &fit.corner;
        let d: [f64; 3] = std::array::from_fn(|i| corner.distance(i, at));
        let mut best: Option<(f64, Quarter)> = None;
        for plane in 0..3 {
            let others = [(plane + 1) % 3, (plane + 2) % 3];
            for sides in 0..4usize {
                let positive = [sides & 1 == 1, sides & 2 == 2];
                let octant: usize = (0..2).map(|k| usize::from(positive[k]) << others[k]).sum();
                let found =
                    [octant, octant | 1 << plane].map(|o| self.materials[usize::from(corner.materials[o])]);
                let along = found == pair;
                if !along && [found[1], found[0]] != pair {
                    continue;
                }
                // How far the place lies beyond the other planes.
                let beyond = |k: usize| if positive[k] { -d[others[k]] } else { d[others[k]] };
                let away = (0..2).map(|k| beyond(k).max(0.0).powi(2)).sum::<f64>() + d[plane] * d[plane];
                if best.as_ref().is_none_or(|(least, _)| away < *least) {
                    best = Some((away, Quarter { plane, others, positive, along }));
                }
            }
        }
        best.map(|b| b.1)
    }

    fn nearest_of_cones(&self, fit: &ConeFit, pair: [MaterialId; 2], at: DVec3) -> Option<[usize; 2]> {
        let mut best: Option<(f64, [usize; 2])> = None;
        for m in 0..4 {
            for n in (0..4).filter(|&n| n != m && [self.materials[m], self.materials[n]] == pair) {
                let away = fit.cone.off_sheet(m, n, at);
                if best.is_none_or(|(least, _)| away < least) {
                    best = Some((away, [m, n]));
                }
            }
        }
        best.map(|b| b.1)
    }

    /// The point of the interface between two of its materials nearest to a place, at least `margin` away from the curves at which its
    /// sheet ends, and the standard deviation there; all in blur units.
    #[must_use]
    pub(super) fn on_sheet(&self, pair: [MaterialId; 2], at: DVec3, margin: f64) -> Option<(DVec3, f64)> {
        let (on, sheet) = match &self.shape {
            Shape::Planes(fit) => {
                let quarter = self.nearest_quarter(fit, pair, at)?;
                (quarter.nearest(&fit.corner, at, margin), [quarter.plane; 2])
            }
            Shape::Cones(fit) => {
                let [m, n] = self.nearest_of_cones(fit, pair, at)?;
                (fit.cone.on_sheet(m, n, at, margin)?, [m, n])
            }
        };
        Some((on, self.sheet_sigma(sheet, on)))
    }

    /// Where a curve of the asked kind passes the plane `target` of an axis, nearest to `near`, no farther than
    /// it reaches, and the standard deviation there; all in blur units.
    #[must_use]
    pub(super) fn pierces(
        &self,
        kind: CurveKind,
        axis: usize,
        target: f64,
        near: DVec3,
    ) -> Option<(DVec3, f64)> {
        let own = self.lines.iter().filter(|line| line.kind == kind);
        let found = own.filter_map(|line| Some((line, self.meets(line, DVec3::AXES[axis], target)?)));
        let (line, at) =
            found.min_by(|a, b| a.1.distance_squared(near).total_cmp(&b.1.distance_squared(near)))?;
        Some((at, self.line_sigma(line, at)))
    }

    /// Whether a curve of a kind has just these materials around it, no one twice.
    #[must_use]
    pub(super) fn is_between(&self, kind: CurveKind, materials: &[MaterialId]) -> bool {
        self.lines.iter().any(|line| line.kind == kind && are_same(materials, &line.around))
    }

    /// The point of a curve of the asked kind that is nearest to a place, and the standard deviation there; all in blur units. Of curves
    /// with just `materials` around them, if there is one.
    #[must_use]
    pub(super) fn nearest_point(
        &self,
        kind: CurveKind,
        near: DVec3,
        materials: &[MaterialId],
    ) -> Option<(DVec3, f64)> {
        let are_told = self.is_between(kind, materials);
        let is_own = |line: &&Line| line.kind == kind && (!are_told || are_same(materials, &line.around));
        let own = self.lines.iter().filter(is_own);
        let r = near - self.apex();
        let line = own.min_by(|a, b| self.beside(a, r, near).total_cmp(&self.beside(b, r, near)))?;
        if line.direction.dot(r) <= 0.0 {
            return Some((self.apex(), self.apex_sigma()));
        }
        let at = self.meets(line, line.direction, line.direction.dot(near))?;
        Some((at, self.line_sigma(line, at)))
    }

    /// Standard deviation of a curve in its worst direction.
    fn line_sigma(&self, line: &Line, at: DVec3) -> f64 {
        let normal = |[a, b]: [usize; 2]| match &self.shape {
            Shape::Planes(fit) => fit.corner.normals[a],
            Shape::Cones(fit) => fit.cone.normal(a, b),
        };
        let c = normal(line.sheets[0]).dot(normal(line.sheets[1]));
        let sigma = line.sheets.iter().map(|&sheet| self.sheet_sigma(sheet, at)).fold(0.0, f64::max);
        sigma / (1.0 - c.abs()).max(0.1).sqrt()
    }

    /// Where a half-line passes the plane of the points at `target` along a direction.
    fn meets(&self, line: &Line, across: DVec3, target: f64) -> Option<DVec3> {
        let apex = self.apex();
        let slope = line.direction.dot(across);
        if slope.abs() < 0.05 {
            return None;
        }
        let mut at = apex + line.direction * ((target - apex.dot(across)) / slope);
        if at.distance(apex) > 2.0 * self.reach {
            return None;
        }
        if let Shape::Planes(fit) = &self.shape {
            let corner = &fit.corner;
            let [i, j] = line.sheets.map(|s| s[0]);
            for _ in 0..4 {
                let normal = |k: usize| corner.normals[k] - corner.forms[k] * (at - apex);
                let rows = DMat3::from_cols(normal(i), normal(j), across).transpose();
                if rows.determinant().abs() < 0.02 {
                    return None;
                }
                let off = DVec3::new(corner.distance(i, at), corner.distance(j, at), at.dot(across) - target);
                at -= rows.inverse() * off;
            }
            if corner.distance(i, at).hypot(corner.distance(j, at)) > 1e-3 {
                return None;
            }
        }
        (0.0..=self.reach).contains(&(at - apex).dot(line.direction)).then_some(at)
    }
}

/// Whether `all` are just `materials`, of which none comes twice.
pub(super) fn are_same(materials: &[MaterialId], all: &[MaterialId]) -> bool {
    all.iter().all(|m| materials.contains(m)) && materials.iter().all(|m| all.contains(m))
}

/// A quarter of a plane: the part on one side of each of the other two.
struct Quarter {
    plane: usize,
    others: [usize; 2],
    /// Whether it lies on the positive side of each.
    positive: [bool; 2],
    /// Whether it goes from the first of the two materials that were asked for to the second.
    along: bool,
}

impl Quarter {
    /// The point of the quarter nearest to a place, and at least `margin` inside of it.
    fn nearest(&self, corner: &Corner, at: DVec3, margin: f64) -> DVec3 {
        let mut on = at;
        // The foot on a bent plane, and the way back from two sides of which each pushes across the other.
        for _ in 0..8 {
            let foot = on;
            let normal = |k: usize| (corner.normals[k] - corner.forms[k] * (foot - corner.apex)).normalize();
            let own = normal(self.plane);
            on -= own * corner.distance(self.plane, on);
            for (k, positive) in self.others.into_iter().zip(self.positive) {
                let side = normal(k) * if positive { 1.0 } else { -1.0 };
                let inward = side - own * own.dot(side);
                let length = inward.length();
                let inside = corner.distance(k, on) * if positive { 1.0 } else { -1.0 } / length.max(1e-3);
                if inside < margin {
                    on += inward / length.max(1e-3) * (margin - inside);
                }
            }
        }
        on
    }
}

impl Cone {
    /// The point of the sheet between materials `m` and `n` nearest to a place, at least `margin` away from the rays at
    /// which it ends. `None` where these have nearly one direction.
    fn on_sheet(&self, m: usize, n: usize, at: DVec3, margin: f64) -> Option<DVec3> {
        let rays = Self::sheet(m, n).map(|i| self.rays[i]);
        let r = at - self.apex;
        let (c, [x, y]) = (rays[0].dot(rays[1]), rays.map(|ray| ray.dot(r)));
        let square = 1.0 - c * c;
        if square < 1e-3 {
            return None;
        }
        // The foot in terms of the rays; the part along the one is how far it lies from the other.
        let parts = [x - c * y, y - c * x].map(|part| (part / square).max(margin / square.sqrt()));
        Some(self.apex + rays[0] * parts[0] + rays[1] * parts[1])
    }

    /// Distance of a point from the sheet between materials `m` and `n`, which ends at its rays.
    fn off_sheet(&self, m: usize, n: usize, at: DVec3) -> f64 {
        let r = at - self.apex;
        let rays = Self::sheet(m, n).map(|i| self.rays[i]);
        let (ab, ar, br) = (rays[0].dot(rays[1]), rays[0].dot(r), rays[1].dot(r));
        if ar - ab * br > 0.0 && br - ab * ar > 0.0 {
            return self.distance(m, n, at).abs();
        }
        let beside = rays.map(|ray| (r - ray * ray.dot(r).max(0.0)).length());
        beside[0].min(beside[1])
    }
}

#[cfg(test)]
#[path = "corner_site_tests.rs"]
mod tests;
