//! The exact geometry of a phantom: interfaces, junction curves, volumes.
//!
//! An interface is the set of surface points whose two sides have its two materials. On each of our
//! surfaces the closest point is the only local minimum of the distance (see [`Surface`]), so
//! the point of an interface closest to a given one is either a surface's closest point, if it belongs
//! to the interface, or on a curve in which the surface meets another and the interface ends or bends.
//! All such curves are found at the start, cut where other surfaces cross them, and each piece keeps
//! the pairs that touch it: three or more materials around it make it a junction curve, two an edge.

use std::f64::consts::TAU;

use glam::DVec3;

use super::PhantomError;
use super::catalogue::Topology;
use super::corners::corners;
use super::curve::{Curve, crossing};
use super::scene::Scene;
use super::surface::Surface;
use crate::grid::{MaterialId, Pair};

/// The closest point of an interface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closest {
    /// The point, mm.
    pub point: DVec3,
    /// Its distance, mm.
    pub distance: f64,
    /// Whether the point asked for lies in front of the interface, on the side its normal points to.
    /// Where the closest point is on a rim: in front of the surface continued beyond it.
    pub in_front: bool,
}

impl Closest {
    /// The distance, positive in front of the interface, negative behind.
    #[must_use]
    pub fn signed(&self) -> f64 {
        if self.in_front { self.distance } else { -self.distance }
    }
}

/// A piece of a curve at which interfaces end or bend.
#[derive(Debug, Clone, PartialEq)]
pub struct CurvePiece {
    /// The curve.
    pub curve: Curve,
    /// Where the piece starts.
    pub low: f64,
    /// Where it ends.
    pub high: f64,
    /// The materials around it, ascending: three or more on a junction curve.
    pub materials: Vec<MaterialId>,
    /// Surfaces it lies on.
    surfaces: Vec<usize>,
    /// Interfaces that touch it: pair, surface, whether the pair's front is outside of the surface.
    touching: Vec<(Pair, usize, bool)>,
}

impl CurvePiece {
    /// Whether three or more materials meet there.
    #[must_use]
    pub fn is_junction(&self) -> bool {
        self.materials.len() >= 3
    }

    /// The pair whose interface bends there, on a sharp edge.
    #[must_use]
    pub fn edge_pair(&self) -> Option<Pair> {
        if self.is_junction() { None } else { self.touching.first().map(|t| t.0) }
    }

    /// Whether the interface of this pair touches it.
    #[must_use]
    pub fn touches(&self, pair: Pair) -> bool {
        self.touching.iter().any(|t| t.0 == pair)
    }

    /// Its length, in mm.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.curve.length(self.low, self.high)
    }
}

/// The exact geometry of a phantom, in the world, mm.
#[derive(Debug, Clone)]
pub struct Truth {
    scene: Scene,
    ball: (DVec3, f64),
    volumes: Vec<f64>,
    topology: Vec<Topology>,
    pieces: Vec<CurvePiece>,
    points: Vec<DVec3>,
    corners: Vec<DVec3>,
    pairs: Vec<Pair>,
}

impl Truth {
    /// `ball` holds the whole object.
    pub(super) fn new(
        scene: Scene,
        ball: (DVec3, f64),
        volumes: Vec<f64>,
        topology: Vec<Topology>,
    ) -> Result<Self, PhantomError> {
        let pieces = pieces(&scene, (ball.0, ball.1 * 1.01))?;
        let mut truth = Self {
            scene,
            ball,
            volumes,
            topology,
            pieces,
            points: Vec::new(),
            corners: Vec::new(),
            pairs: Vec::new(),
        };
        truth.points = truth.find_points();
        truth.corners = corners(&truth.pieces, 1e-5 * ball.1);
        let step = 0.02 * ball.1;
        let mut pairs: Vec<Pair> = truth.all_samples(step).into_iter().map(|s| s.0).collect();
        pairs.sort_unstable();
        pairs.dedup();
        truth.pairs = pairs;
        Ok(truth)
    }

    /// The surfaces and solids.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Centre and radius of a ball that holds the whole object.
    #[must_use]
    pub fn ball(&self) -> (DVec3, f64) {
        self.ball
    }

    /// The material of a point.
    #[must_use]
    pub fn material_at(&self, p: DVec3) -> MaterialId {
        self.scene.material_at(p)
    }

    /// The pairs that meet, ascending.
    #[must_use]
    pub fn pairs(&self) -> &[Pair] {
        &self.pairs
    }

    /// Exact volume of a material in mm³; `None` for the background.
    #[must_use]
    pub fn volume(&self, material: MaterialId) -> Option<f64> {
        self.volumes.get(usize::from(material.0).checked_sub(1)?).copied()
    }

    /// Expected shell of each material, by id.
    #[must_use]
    pub fn topology(&self) -> &[Topology] {
        &self.topology
    }

    /// The pieces of curves at which interfaces end or bend: junction curves and sharp edges.
    #[must_use]
    pub fn curves(&self) -> &[CurvePiece] {
        &self.pieces
    }

    /// The junction curves.
    pub fn junctions(&self) -> impl Iterator<Item = &CurvePiece> {
        self.pieces.iter().filter(|p| p.is_junction())
    }

    /// Length of all junction curves together, mm.
    #[must_use]
    pub fn junction_length(&self) -> f64 {
        self.junctions().map(CurvePiece::length).sum()
    }

    /// The points at which four or more materials meet.
    #[must_use]
    pub fn junction_points(&self) -> &[DVec3] {
        &self.points
    }

    /// The point of a pair's interface closest to `q`; `None` if the two never meet.
    #[must_use]
    pub fn closest(&self, pair: Pair, q: DVec3) -> Option<Closest> {
        let surfaces = self.scene.surfaces();
        let mut best: Option<Closest> = None;
        let reach = |best: &Option<Closest>| best.map_or(f64::INFINITY, |b| b.distance);
        for (index, surface) in surfaces.iter().enumerate() {
            let signed = surface.signed_distance(q);
            if signed.abs() >= reach(&best) {
                continue;
            }
            let point = q - signed * surface.normal(q);
            if let Some((found, front_outside)) = self.scene.interface_at(index, point)
                && found == pair
            {
                let in_front = (signed > 0.0) == front_outside;
                best = Some(Closest { point, distance: signed.abs(), in_front });
            }
        }
        for piece in &self.pieces {
            if !piece.touches(pair) {
                continue;
            }
            let Some((point, distance)) = closest_on(piece, surfaces, q, reach(&best)) else { continue };
            // At a sharp edge the point can be behind one face continued though in front of the other: the
            // face it is farther from is right, at any angle.
            let in_front = piece
                .touching
                .iter()
                .filter(|t| t.0 == pair)
                .map(|t| (surfaces[t.1].signed_distance(q), t.2))
                .max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
                .is_some_and(|(signed, front_outside)| (signed > 0.0) == front_outside);
            best = Some(Closest { point, distance, in_front });
        }
        best
    }

    /// The closest point of any junction curve and its distance in mm, if there are junctions.
    #[must_use]
    pub fn closest_junction(&self, q: DVec3) -> Option<(DVec3, f64)> {
        self.closest_of(self.junctions(), q)
    }

    /// The sharp edges: curves at which one interface bends and no third material meets it.
    pub fn edges(&self) -> impl Iterator<Item = &CurvePiece> {
        self.pieces.iter().filter(|p| !p.is_junction())
    }

    /// The corners: where sharp edges end. Other sharp edges start there in other directions, or junction curves
    /// pass.
    #[must_use]
    pub fn corners(&self) -> &[DVec3] {
        &self.corners
    }

    /// Length of all sharp edges together, mm.
    #[must_use]
    pub fn edge_length(&self) -> f64 {
        self.edges().map(CurvePiece::length).sum()
    }

    /// The closest point of any sharp edge and its distance in mm, if there are sharp edges.
    #[must_use]
    pub fn closest_edge(&self, q: DVec3) -> Option<(DVec3, f64)> {
        self.closest_of(self.edges(), q)
    }

    fn closest_of<'a>(&self, pieces: impl Iterator<Item = &'a CurvePiece>, q: DVec3) -> Option<(DVec3, f64)> {
        pieces.fold(None, |best: Option<(DVec3, f64)>, piece| {
            let limit = best.map_or(f64::INFINITY, |b| b.1);
            closest_on(piece, self.scene.surfaces(), q, limit).or(best)
        })
    }

    /// Points on the interfaces, about `step` mm apart, in a fixed order: pair, point and the area in
    /// mm² it stands for.
    #[must_use]
    pub fn all_samples(&self, step: f64) -> Vec<(Pair, DVec3, f64)> {
        let mut out = Vec::new();
        for (index, surface) in self.scene.surfaces().iter().enumerate() {
            let mut keep = |p: DVec3, area: f64| {
                if let Some((pair, _)) = self.scene.interface_at(index, p) {
                    out.push((pair, p, area));
                }
            };
            match *surface {
                Surface::Plane { normal, .. } => {
                    let (u, v) = normal.any_orthonormal_pair();
                    let foot = surface.foot(self.ball.0);
                    let n = (self.ball.1 * 1.01 / step).ceil() as i64;
                    for (i, j) in (-n..n).flat_map(|i| (-n..n).map(move |j| (i, j))) {
                        let (x, y) = ((i as f64 + 0.5) * step, (j as f64 + 0.5) * step);
                        keep(foot + x * u + y * v, step * step);
                    }
                }
                Surface::Sphere { centre, radius } => {
                    let rings = (std::f64::consts::PI * radius / step).ceil().max(4.0);
                    for i in 0..rings as usize {
                        let (low, high) =
                            (-1.0 + 2.0 * i as f64 / rings, -1.0 + 2.0 * (i as f64 + 1.0) / rings);
                        let z: f64 = 0.5 * (low + high);
                        let r = (1.0 - z * z).sqrt();
                        let count = (TAU * r * radius / step).ceil().max(3.0);
                        // Bands of equal height have equal area on a sphere.
                        let area = 4.0 * std::f64::consts::PI * radius * radius / rings / count;
                        for k in 0..count as usize {
                            let (s, c) = libm::sincos(TAU * (k as f64 + 0.5) / count);
                            keep(centre + radius * DVec3::new(r * c, r * s, z), area);
                        }
                    }
                }
                Surface::Cylinder { point, axis, radius } => {
                    let (u, v) = axis.any_orthonormal_pair();
                    let middle = point + (self.ball.0 - point).dot(axis) * axis;
                    let count = (TAU * radius / step).ceil().max(8.0);
                    let area = TAU * radius / count * step;
                    let n = (self.ball.1 * 1.01 / step).ceil() as i64;
                    for k in 0..count as usize {
                        let (s, c) = libm::sincos(TAU * (k as f64 + 0.5) / count);
                        let base = middle + radius * (c * u + s * v);
                        for i in -n..n {
                            keep(base + (i as f64 + 0.5) * step * axis, area);
                        }
                    }
                }
            }
        }
        out
    }

    /// Ends of junction pieces around which there are four or more materials.
    fn find_points(&self) -> Vec<DVec3> {
        let eps = 1e-5 * self.ball.1;
        let mut points: Vec<DVec3> = Vec::new();
        for piece in self.junctions() {
            for p in [piece.curve.at(piece.low), piece.curve.at(piece.high)] {
                let mut around: Vec<MaterialId> = self
                    .junctions()
                    .filter(|other| {
                        (other.curve.at(other.curve.closest(p, other.low, other.high)) - p).length() < eps
                    })
                    .flat_map(|other| other.materials.iter().copied())
                    .collect();
                around.sort_unstable();
                around.dedup();
                if around.len() >= 4 && points.iter().all(|q| (*q - p).length() > eps) {
                    points.push(p);
                }
            }
        }
        points
    }
}

/// The closest point of a piece if it is nearer than `limit`.
fn closest_on(piece: &CurvePiece, surfaces: &[Surface], q: DVec3, limit: f64) -> Option<(DVec3, f64)> {
    // The piece lies on its surfaces, so it is no nearer than the farthest of them.
    if piece.surfaces.iter().any(|&s| surfaces[s].signed_distance(q).abs() >= limit) {
        return None;
    }
    let point = piece.curve.at(piece.curve.closest(q, piece.low, piece.high));
    let distance = (q - point).length();
    (distance < limit).then_some((point, distance))
}

/// Points per curve at which crossings with other surfaces are looked for.
const SCAN: usize = 1440;

/// All pieces of curves at which an interface ends or bends.
fn pieces(scene: &Scene, ball: (DVec3, f64)) -> Result<Vec<CurvePiece>, PhantomError> {
    let surfaces = scene.surfaces();
    let mut out = Vec::new();
    for first in 0..surfaces.len() {
        for second in first + 1..surfaces.len() {
            let Some(curves) = crossing(&surfaces[first], &surfaces[second]) else {
                if may_meet(&surfaces[first], &surfaces[second]) {
                    return Err(PhantomError::Crossing { first, second });
                }
                continue;
            };
            for curve in curves {
                let Some(range) = curve.range(ball) else { continue };
                let on = |s: &Surface| {
                    (0..=16).all(|k| {
                        let p = curve.at(range.0 + (range.1 - range.0) * f64::from(k) / 16.0);
                        s.signed_distance(p).abs() < 1e-9 * ball.1
                    })
                };
                let containing: Vec<usize> =
                    (0..surfaces.len()).filter(|&k| k == first || k == second || on(&surfaces[k])).collect();
                // A curve on three surfaces appears for each two of them: keep the first time.
                if containing[..2] != [first, second] {
                    continue;
                }
                for (low, high) in cut(scene, &curve, range, &containing) {
                    // Where several surfaces cross the curve in one point, rounding leaves specks.
                    if curve.length(low, high) < 1e-9 * ball.1 {
                        continue;
                    }
                    out.extend(piece(scene, curve, (low, high), &containing, ball.1));
                }
            }
        }
    }
    Ok(out)
}

/// Whether two surfaces without a closed-form crossing can meet; spheres and parallel cylinders exactly,
/// others assumed to meet.
fn may_meet(first: &Surface, second: &Surface) -> bool {
    use Surface::{Cylinder, Sphere};
    let rings = |distance: f64, r: f64, s: f64| distance < r + s && distance > (r - s).abs();
    match (*first, *second) {
        (Sphere { centre, radius }, Sphere { centre: c, radius: r }) => {
            rings((centre - c).length(), radius, r)
        }
        (Sphere { centre, radius }, Cylinder { point, axis, radius: r })
        | (Cylinder { point, axis, radius: r }, Sphere { centre, radius }) => {
            let distance = super::surface::reject(centre - point, axis).length();
            distance + radius > r && distance - radius < r
        }
        (Cylinder { point, axis, radius }, Cylinder { point: p, axis: a, radius: r }) => {
            axis.cross(a).length() > 1e-12
                || rings(super::surface::reject(p - point, axis).length(), radius, r)
        }
        _ => true,
    }
}

/// Cuts a curve where surfaces that do not contain it cross it.
fn cut(scene: &Scene, curve: &Curve, range: (f64, f64), containing: &[usize]) -> Vec<(f64, f64)> {
    let at = |k: usize| range.0 + (range.1 - range.0) * k as f64 / SCAN as f64;
    let mut breaks = Vec::new();
    for (index, surface) in scene.surfaces().iter().enumerate() {
        if containing.contains(&index) {
            continue;
        }
        let value = |t: f64| surface.signed_distance(curve.at(t));
        for k in 0..SCAN {
            let (mut low, mut high) = (at(k), at(k + 1));
            let below = value(low) < 0.0;
            if below == (value(high) < 0.0) {
                continue;
            }
            for _ in 0..100 {
                let middle = 0.5 * (low + high);
                if middle <= low || middle >= high {
                    break;
                }
                if (value(middle) < 0.0) == below { low = middle } else { high = middle }
            }
            breaks.push(0.5 * (low + high));
        }
    }
    breaks.sort_by(f64::total_cmp);
    let closed = matches!(curve, Curve::Ellipse { .. });
    match (closed, breaks.first(), breaks.last()) {
        (_, None, _) | (_, _, None) => vec![range],
        (true, Some(&first), Some(&last)) => {
            let mut out: Vec<_> = breaks.windows(2).map(|w| (w[0], w[1])).collect();
            out.push((last, first + TAU));
            out
        }
        (false, Some(&first), Some(&last)) => {
            let mut out = vec![(range.0, first)];
            out.extend(breaks.windows(2).map(|w| (w[0], w[1])));
            out.push((last, range.1));
            out
        }
    }
}

/// What meets at a piece of a curve; `None` if it is not an end or bend of any interface.
fn piece(
    scene: &Scene,
    curve: Curve,
    (low, high): (f64, f64),
    containing: &[usize],
    scale: f64,
) -> Option<CurvePiece> {
    let t = 0.5 * (low + high);
    let (middle, tangent) = (curve.at(t), curve.tangent(t).normalize());
    let eps = 1e-5 * scale;
    let mut touching = Vec::new();
    let mut materials = Vec::new();
    for &index in containing {
        let surface = &scene.surfaces()[index];
        let across = surface.normal(middle).cross(tangent);
        for step in [eps, -eps] {
            let p = surface.foot(middle + step * across);
            let (inside, outside) = scene.sides(index, p);
            materials.extend([inside, outside]);
            if let Some((pair, front_outside)) = scene.interface_at(index, p) {
                touching.push((pair, index, front_outside));
            }
        }
    }
    materials.sort_unstable();
    materials.dedup();
    // Nothing meets, or one interface runs on over the curve on the same surface.
    let runs_on = touching.len() == 2 && touching[0] == touching[1];
    (!touching.is_empty() && !runs_on).then(|| CurvePiece {
        curve,
        low,
        high,
        materials,
        surfaces: containing.to_vec(),
        touching,
    })
}
