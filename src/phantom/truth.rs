//! The exact geometry of a phantom: interfaces, junction curves, volumes.
//!
//! An interface is the set of surface points whose two sides have its two materials. On each of our
//! surfaces the closest point is the only local minimum of the distance (see [`Surface`]), so
//! the point of an interface closest to a given one is either a surface's closest point, if it belongs
//! to the interface, or on a curve in which the surface meets another and the interface ends or bends.
//! All such curves are found at the start (see [`CurvePiece`]).

use std::f64::consts::TAU;

use glam::DVec3;

use super::PhantomError;
use super::catalogue::Topology;
use super::corners::{corners, kinks};
use super::pieces::{CurvePiece, OnCurve, closest_on, pieces};
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
    kinks: Vec<DVec3>,
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
            kinks: Vec::new(),
            pairs: Vec::new(),
        };
        truth.points = truth.find_points();
        let eps = 1e-5 * ball.1;
        truth.corners = corners(&truth.pieces, eps);
        truth.kinks = kinks(&truth.pieces, eps);
        truth.kinks.retain(|k| truth.points.iter().all(|p| p.distance(*k) > eps));
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

    /// The pieces of curves at which interfaces end, bend or pass over to another surface: junction curves, sharp
    /// edges and smooth seams.
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

    /// Where a junction curve ends or turns sharply with fewer than four materials around.
    #[must_use]
    pub fn junction_kinks(&self) -> &[DVec3] {
        &self.kinks
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
            let Some(OnCurve { point, distance, .. }) = closest_on(piece, surfaces, q, reach(&best)) else {
                continue;
            };
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
        self.on_junction(q).map(|on| (on.point, on.distance))
    }

    /// The closest point of any junction curve, if there are junctions.
    #[must_use]
    pub fn on_junction(&self, q: DVec3) -> Option<OnCurve<'_>> {
        self.closest_of(self.junctions(), q)
    }

    /// The sharp edges: curves at which one interface bends and no third material meets it.
    pub fn edges(&self) -> impl Iterator<Item = &CurvePiece> {
        self.pieces.iter().filter(|p| p.is_edge())
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
        self.closest_of(self.edges(), q).map(|on| (on.point, on.distance))
    }

    fn closest_of<'a>(&self, pieces: impl Iterator<Item = &'a CurvePiece>, q: DVec3) -> Option<OnCurve<'a>> {
        pieces.fold(None, |best: Option<OnCurve<'a>>, piece| {
            let limit = best.map_or(f64::INFINITY, |b| b.distance);
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
