//! One cell: its labels, its table entry, and where its vertices lie.

use crate::classify::LabelVolume;
use crate::contour::crossing::{CROSSING_MARGIN, CrossingRule, Node};
use crate::contour::pattern::{Apex, CellSurface, CellTriangle, PatternTable};
use crate::grid::cube::{
    CORNERS, EDGES, FACES, corner_at, corner_offset, edge_axis, edge_between, edge_corners, face_ring,
    other_axes,
};
use crate::grid::{MaterialId, Pair, VertexKind};

use super::corners::Corners;
use crate::contour::patch::Border;

/// A cell, by its lowest point of the padded lattice, and the material of each corner.
#[derive(Debug, Clone, Copy)]
pub(in crate::contour) struct Cell {
    pub(super) low: [usize; 3],
    pub(in crate::contour) labels: [MaterialId; CORNERS],
}

impl Cell {
    #[inline]
    pub(in crate::contour) fn new(labels: &LabelVolume, low: [usize; 3], corners: Corners) -> Self {
        let materials = std::array::from_fn(|c| labels.material_of_code(corners.code(c)));
        Self { low, labels: materials }
    }

    /// A cell of which only lower face 2 · `axis` is known; at the other corners is `OUTSIDE`.
    pub(super) fn of_face(labels: &LabelVolume, low: [usize; 3], axis: usize) -> Self {
        let mut cell = Self { low, labels: [MaterialId::OUTSIDE; CORNERS] };
        for c in face_ring(2 * axis) {
            cell.labels[c] = labels.at(cell.corner(c));
        }
        cell
    }

    /// The cell whose lowest corner is `low`.
    pub(super) fn at(labels: &LabelVolume, low: [usize; 3]) -> Self {
        let mut cell = Self { low, labels: [MaterialId::OUTSIDE; CORNERS] };
        for c in 0..CORNERS {
            cell.labels[c] = labels.at(cell.corner(c));
        }
        cell
    }

    /// Corner `c` of the cell in the padded lattice.
    pub(super) fn corner(&self, c: usize) -> [usize; 3] {
        corner_at(self.low, c)
    }

    /// The table's entry for a cell with the corner partition `partition`.
    pub(super) fn entry<C: CrossingRule + ?Sized>(
        &self,
        table: &PatternTable,
        rule: &C,
        partition: usize,
    ) -> usize {
        let faces = table.ambiguous_faces(partition);
        let mut join_first = 0;
        for f in (0..FACES).filter(|f| faces >> f & 1 == 1) {
            let ring = face_ring(f);
            let labels = [self.labels[ring[0]], self.labels[ring[1]]];
            join_first |= u8::from(rule.joins_first(ring.map(|c| self.corner(c)), labels)) << f;
        }
        table.entry(partition, join_first)
    }

    /// The materials behind and ahead of a triangle.
    #[inline]
    pub(super) fn sides(&self, triangle: &CellTriangle) -> [MaterialId; 2] {
        [triangle.behind, triangle.ahead].map(|c| self.labels[usize::from(c)])
    }

    /// Of the cell edges in `crossings`, those that triangles refer to.
    pub(super) fn needed(&self, crossings: u16, border: Border) -> u16 {
        let is_needed = |e: &usize| pair_of(edge_corners(*e).map(|c| self.labels[c]), border).is_some();
        (0..EDGES).filter(|e| crossings >> e & 1 == 1).filter(is_needed).fold(0, |set, e| set | 1 << e)
    }

    /// Position of the crossing on edge `e`, in units of the cell.
    pub(super) fn crossing<C: CrossingRule>(&self, rule: &C, e: usize) -> [f32; 3] {
        let [p, q] = edge_corners(e);
        let axis = edge_axis(e);
        let mut at = corner_offset(p).map(|o| o as f32);
        at[axis] = crossing_position(rule, self.corner(p), axis, [self.labels[p], self.labels[q]]);
        at
    }

    /// Sigma of the crossing on edge `e`.
    fn crossing_sigma<C: CrossingRule>(&self, rule: &C, e: usize) -> f32 {
        let [p, q] = edge_corners(e);
        crossing_sigma(rule, self.corner(p), edge_axis(e), [self.labels[p], self.labels[q]])
    }

    /// The least sure sigma of these cell edges' crossings, if the rule knows any; what lies at the border by
    /// definition does not count.
    fn worst_sigma<C: CrossingRule>(&self, rule: &C, edges: impl Iterator<Item = usize>) -> f32 {
        if !rule.has_sigmas() {
            return f32::NAN;
        }
        let measured = |e: &usize| edge_corners(*e).iter().all(|&c| self.labels[c] != MaterialId::OUTSIDE);
        let sigmas = edges.filter(measured).map(|e| self.crossing_sigma(rule, e));
        worst(sigmas)
    }

    /// The node of face `f`: what the rule knows, else the mean of the face's crossings.
    pub(super) fn face_node<C: CrossingRule>(&self, rule: &C, f: usize) -> Node {
        let (ring, axis) = (face_ring(f), f / 2);
        if ring.iter().all(|&c| self.labels[c] != MaterialId::OUTSIDE) {
            let mut low = self.low;
            low[axis] += f % 2;
            if let Some(mut node) = rule.node(low, axis).and_then(inside) {
                node.at[axis] = (f % 2) as f32;
                node.at = self.in_view(rule, f, node.at);
                return node;
            }
        }
        let differ = |k: &usize| self.labels[ring[*k]] != self.labels[ring[(k + 1) % 4]];
        let crossed = (0..4).filter(differ).map(|k| edge_between(ring[k], ring[(k + 1) % 4]));
        Node { at: self.middle_of_face(rule, f), sigma: self.worst_sigma(rule, crossed) }
    }

    /// Where a material has two neighbouring corners of face `f`: the point `at` of the face, or as far on the way to it
    /// from the mean of the crossings as the middle between these corners sees all of the material's part of the face. A
    /// cap over both corners would be folded otherwise. (It takes a material with far more than half a turn.)
    fn in_view<C: CrossingRule>(&self, rule: &C, f: usize, at: [f32; 3]) -> [f32; 3] {
        /// Steps on the way.
        const STEPS: u8 = 4;
        let (ring, [a, b]) = (face_ring(f), other_axes(f / 2));
        let same = |k: &usize| self.labels[ring[*k]] == self.labels[ring[(k + 1) % 4]];
        let Some(k) = (0..4).find(same) else { return at };
        let corner = |k: usize| corner_offset(ring[k % 4]).map(|o| o as f32);
        let crossing = |k: usize| self.crossing(rule, edge_between(ring[k % 4], ring[(k + 1) % 4]));
        let (p, q, mean) = (crossing(k + 1), crossing(k + 3), self.middle_of_face(rule, f));
        let (c, d) = (corner(k), corner(k + 1));
        let eye: [f32; 3] = std::array::from_fn(|i| 0.5 * (c[i] + d[i]));
        let turn =
            |u: [f32; 3], v: [f32; 3]| (u[a] - eye[a]) * (v[b] - eye[b]) - (u[b] - eye[b]) * (v[a] - eye[a]);
        // The ring's own way of turning: `p` lies that way before the corner across from it.
        let way = turn(d, corner(k + 2)).signum();
        let in_view =
            |at: &[f32; 3]| turn(p, *at) * way > CROSSING_MARGIN && turn(*at, q) * way > CROSSING_MARGIN;
        let part = |step: u8| {
            let t = f32::from(step) / f32::from(STEPS);
            std::array::from_fn(|i| mean[i] + t * (at[i] - mean[i]))
        };
        if in_view(&at) { at } else { (1..STEPS).rev().map(part).find(in_view).unwrap_or(mean) }
    }

    /// The mean of the crossings of face `f`, in units of the cell; where two materials meet `OUTSIDE`, straight
    /// beyond their crossing.
    fn middle_of_face<C: CrossingRule>(&self, rule: &C, f: usize) -> [f32; 3] {
        let ring = face_ring(f);
        let axis = f / 2;
        let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
        let (mut inner, mut inner_axis, mut inner_count) = ([0.0f32; 3], 0, 0);
        for k in 0..4 {
            let (p, q) = (ring[k], ring[(k + 1) % 4]);
            if self.labels[p] == self.labels[q] {
                continue;
            }
            let e = edge_between(p, q);
            let at = self.crossing(rule, e);
            (0..3).for_each(|a| sum[a] += at[a]);
            count += 1.0;
            if self.labels[p] != MaterialId::OUTSIDE && self.labels[q] != MaterialId::OUTSIDE {
                (inner, inner_axis) = (at, edge_axis(e));
                inner_count += 1;
            }
        }
        let outside = ring.iter().filter(|&&c| self.labels[c] == MaterialId::OUTSIDE).count();
        if outside == 2 && inner_count == 1 {
            let towards_border = 3 - axis - inner_axis;
            inner[towards_border] = 0.5;
            return inner;
        }
        sum.map(|s| s / count)
    }

    /// The cell's apexes. The rule is asked for the one of a junction that is all there is in the cell and is not at
    /// the border: that of a loop lies on no junction, a cap follows its main apex, and beside another sheet, or with a
    /// cap over several corners, only the mean of the nodes is sure to lie on the right side.
    pub(super) fn apexes<C: CrossingRule>(&self, rule: &C, surface: &CellSurface) -> Vec<Node> {
        let mut out: Vec<Node> = Vec::with_capacity(surface.apexes.len());
        let is_wide = |apex: &Apex| matches!(apex, Apex::Cap { corners, .. } if corners.count_ones() > 1);
        let is_free = !self.labels.contains(&MaterialId::OUTSIDE) && !surface.apexes.iter().any(is_wide);
        for apex in &surface.apexes {
            if let Apex::Sheet { face_nodes: 1.., crossings } = *apex
                && crossings == surface.crossings
                && is_free
                && let Some(node) = rule.apex(self.low).and_then(inside)
            {
                out.push(node);
                continue;
            }
            let mean = |points: &mut dyn Iterator<Item = [f32; 3]>| {
                let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
                for p in points {
                    (0..3).for_each(|a| sum[a] += p[a]);
                    count += 1.0;
                }
                sum.map(|s| s / count)
            };
            let at = match *apex {
                Apex::Sheet { face_nodes: 0, crossings } => {
                    mean(&mut (0..EDGES).filter(|e| crossings >> e & 1 == 1).map(|e| self.crossing(rule, e)))
                }
                Apex::Sheet { face_nodes, .. } => {
                    let mut at = mean(
                        &mut (0..FACES)
                            .filter(|f| face_nodes >> f & 1 == 1)
                            .map(|f| self.face_node(rule, f).at),
                    );
                    if let Some(axis) = self.border_axis() {
                        at[axis] = 0.5;
                    }
                    at
                }
                Apex::Cap { main, corners } => {
                    let main = out[usize::from(main)].at;
                    let corner = mean(
                        &mut (0..CORNERS)
                            .filter(|c| corners >> c & 1 == 1)
                            .map(|c| corner_offset(c).map(|o| o as f32)),
                    );
                    std::array::from_fn(|a| 0.5 * (main[a] + corner[a]))
                }
            };
            let sigma = match *apex {
                Apex::Sheet { crossings, .. } => {
                    self.worst_sigma(rule, (0..EDGES).filter(|e| crossings >> e & 1 == 1))
                }
                Apex::Cap { main, .. } => out[usize::from(main)].sigma,
            };
            out.push(Node { at, sigma });
        }
        out
    }

    /// The axis across which the cell leaves the volume, if it does so across one whole face.
    fn border_axis(&self) -> Option<usize> {
        let outside =
            (0..CORNERS).filter(|&c| self.labels[c] == MaterialId::OUTSIDE).fold(0u8, |set, c| set | 1 << c);
        [[0xAA, 0x55], [0xCC, 0x33], [0xF0, 0x0F]].iter().position(|sides| sides.contains(&outside))
    }

    /// What a vertex is where the materials of these corners meet.
    pub(super) fn kind(&self, corners: impl IntoIterator<Item = usize>, border: Border) -> VertexKind {
        let mut seen = [MaterialId::OUTSIDE; CORNERS];
        let (mut count, mut outside) = (0, false);
        for c in corners {
            let label = self.labels[c];
            if label == MaterialId::OUTSIDE {
                outside = true;
            } else if !seen[..count].contains(&label) {
                seen[count] = label;
                count += 1;
            }
        }
        VertexKind::new(count + usize::from(outside && border == Border::Closed), outside)
    }
}

/// Where the crossing lies on the edge from padded point `from` along `axis`.
#[inline]
pub(super) fn crossing_position<C: CrossingRule>(
    rule: &C,
    from: [usize; 3],
    axis: usize,
    labels: [MaterialId; 2],
) -> f32 {
    if labels.contains(&MaterialId::OUTSIDE) { 0.5 } else { rule.position(from, axis, labels) }
}

/// The sigma of that crossing; unknown at the border, which is not measured.
#[inline]
pub(super) fn crossing_sigma<C: CrossingRule>(
    rule: &C,
    from: [usize; 3],
    axis: usize,
    labels: [MaterialId; 2],
) -> f32 {
    if labels.contains(&MaterialId::OUTSIDE) { f32::NAN } else { rule.sigma(from, axis, labels) }
}

/// That crossing with its sigma, from `from` on.
pub(super) fn crossing_node<C: CrossingRule>(
    rule: &C,
    from: [usize; 3],
    axis: usize,
    labels: [MaterialId; 2],
) -> Node {
    let (position, sigma) =
        if labels.contains(&MaterialId::OUTSIDE) { (0.5, f32::NAN) } else { rule.placed(from, axis, labels) };
    let mut at = [0.0; 3];
    at[axis] = position;
    Node { at, sigma }
}

/// The least sure of some sigmas: unknown if one of them is, or if there are none.
pub(in crate::contour) fn worst(sigmas: impl Iterator<Item = f32>) -> f32 {
    sigmas.reduce(|a, b| if a >= b || a.is_nan() { a } else { b }).unwrap_or(f32::NAN)
}

/// A rule's node, kept a margin inside its face or cell so that no triangle is without area; `None` if it is no point.
pub(super) fn inside(node: Node) -> Option<Node> {
    let at = node.at.map(|c| c.clamp(CROSSING_MARGIN, 1.0 - CROSSING_MARGIN));
    at.iter().all(|c| c.is_finite()).then_some(Node { at, ..node })
}

/// The pair of a triangle with these materials behind and ahead and whether it must be turned over to
/// face its front, or `None` where no triangle is made: between air and `OUTSIDE`, and, with an open
/// border, anything and `OUTSIDE`.
#[inline]
pub(in crate::contour) fn pair_of([behind, ahead]: [MaterialId; 2], border: Border) -> Option<(Pair, bool)> {
    let pair = Pair::new(behind, ahead)?;
    let dropped = pair.front() == MaterialId::OUTSIDE
        && (border == Border::Open || pair.back() == MaterialId::BACKGROUND);
    (!dropped).then_some((pair, pair.back() != behind))
}
