//! Shares of a round Gaussian in the half-spaces of three planes: normal orthant probabilities, for a batch of voxels.
//!
//! A plane at signed distance `h` from the Gaussian's centre (sigma one, positive towards the side that counts)
//! leaves `Phi(h)` of it on that side; two planes with unit normals m, n leave `Phi2(h, k; m . n)` on both, three
//! `Phi3`. Plackett's identity says how these change with a correlation, so they are integrals over an angle:
//!
//! - `Phi2(h, k; r) = Phi(h) Phi(k) + 1/(2 pi) int_0^asin(r) exp(-(h^2 + k^2 - 2 h k sin a)/(2 cos^2 a)) da`
//!   (Drezner and Wesolowsky 1990); for `|r| > 0.8` the sector between the planes, by two of `normal`'s wedges.
//! - `Phi3`: two correlations grow from 0, `r12 = sin(t asin r12)`, `r13` alike, the largest, `r23`, stays
//!   (Genz, Statistics and Computing 14, 2004): `Phi(h1) Phi2(h2, h3; r23)` and two such integrals,
//!   each integrand times `Phi` of the third plane's distance given the first two.
//!
//! Derivatives are closed: `dPhi3/dh1 = phi(h1) Phi2(h2|1, h3|1; r23|1)`,
//! `dPhi3/dr12 = phi2(h1, h2; r12) Phi(h3|12)`.
//!
//! Gauss-Legendre nodes depend on the correlations alone and are made once for many voxels ([`Pair`], [`Planes`]).
//! Largest errors (tests): 5e-6 for two planes with any correlation; for three 1e-5 if the determinant of their
//! normals is 0.2 and more, 5e-5 down to 0.05. That is a hundredth of the noise of the best of images.

use std::f64::consts::{PI, TAU};
use std::sync::LazyLock;

use super::batch::{BATCH, Row};
use super::normal::{bell, density, distribution, exp, wedge};

/// Nodes of the quadrature at most.
const MOST: usize = 16;
/// Nodes for two planes at most, and the correlation beyond which the sector is better than the integral from zero.
const PAIR: usize = 4;
const STRONG: f64 = 0.8;
/// Less than this of a correlation or a weight is nothing.
const NOTHING: f64 = 1e-7;
/// No voxel.
pub(super) const ZERO: Row = [0.0; BATCH];

/// The orders of Gauss-Legendre rules in use.
const ORDERS: [usize; 7] = [1, 2, 3, PAIR, 6, 12, MOST];

/// Nodes and weights on 0 to 1, one rule for each of the orders.
static RULES: LazyLock<[Vec<(f64, f64)>; 7]> = LazyLock::new(|| ORDERS.map(legendre));

/// The Gauss-Legendre rule of order `n` on 0 to 1, by Newton's method.
fn legendre(n: usize) -> Vec<(f64, f64)> {
    (0..n)
        .map(|i| {
            let mut x = libm::cos(PI * (i as f64 + 0.75) / (n as f64 + 0.5));
            let mut slope = 1.0;
            for _ in 0..20 {
                let (mut p, mut before) = (1.0, 0.0);
                for k in 0..n {
                    let k = k as f64;
                    (p, before) = (((2.0 * k + 1.0) * x * p - k * before) / (k + 1.0), p);
                }
                slope = n as f64 * (x * p - before) / (x * x - 1.0);
                x -= p / slope;
            }
            (0.5 * (1.0 + x), 1.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

/// The rule with at least `n` nodes, or the largest.
fn rule(n: usize) -> &'static [(f64, f64)] {
    let rules = &*RULES;
    let i = ORDERS.iter().position(|&o| o >= n).unwrap_or(ORDERS.len() - 1);
    &rules[i]
}

/// A node of the integral for two planes: exponent `-(square (h^2 + k^2) - cross h k)`.
#[derive(Debug, Clone, Copy, Default)]
struct Node {
    square: f32,
    cross: f32,
    weight: f32,
}

impl Node {
    /// At the angle `a` with a weight.
    fn new(a: f64, weight: f64) -> Self {
        let (s, c) = (libm::sin(a), libm::cos(a));
        let (square, cross, weight) = (0.5 / (c * c), s / (c * c), weight / TAU);
        Self { square: square as f32, cross: cross as f32, weight: weight as f32 }
    }

    #[inline(always)]
    fn term(&self, squares: f32, product: f32) -> f32 {
        self.weight * exp((self.cross * product - self.square * squares).min(0.0))
    }
}

/// Two planes with a fixed correlation.
#[derive(Debug, Clone)]
struct Pair {
    rho: f32,
    /// `1 / sqrt(1 - rho^2)`.
    root: f32,
    nodes: [Node; PAIR],
    used: usize,
}

impl Pair {
    /// For a correlation, -1 to 1.
    fn new(rho: f64) -> Self {
        let rho = rho.clamp(-1.0, 1.0);
        let mut nodes = [Node::default(); PAIR];
        let mut used = 0;
        if rho.abs() > NOTHING && rho.abs() <= STRONG {
            let order = match rho.abs() {
                r if r < 0.05 => 1,
                r if r < 0.35 => 2,
                r if r < 0.6 => 3,
                _ => PAIR,
            };
            let end = libm::asin(rho);
            for (node, &(t, w)) in nodes.iter_mut().zip(rule(order)) {
                *node = Node::new(t * end, w * end);
                used += 1;
            }
        }
        let root = 1.0 / ((1.0 - rho) * (1.0 + rho)).max(1e-10).sqrt();
        Self { rho: rho as f32, root: root as f32, nodes, used }
    }

    /// The share on the positive side of both planes, at distances `h` and `k`; `one` and `two` are `Phi` of these.
    #[inline(always)]
    fn share(&self, h: &Row, k: &Row, one: &Row, two: &Row) -> Row {
        let mut out = ZERO;
        if f64::from(self.rho.abs()) > STRONG {
            for i in 0..BATCH {
                // On the planes' line itself there is no direction to measure angles from.
                let (h, k) = (if h[i].abs() < 2e-6 { 2e-6 } else { h[i] }, k[i]);
                // Distances from that line along each plane.
                let (x, y) = ((k - self.rho * h) * self.root, (h - self.rho * k) * self.root);
                let around = (h < 0.0) & (k <= 0.0);
                out[i] = wedge(y, -k).share - wedge(x, h).share + if around { 1.0 } else { 0.0 };
            }
            return out;
        }
        for i in 0..BATCH {
            out[i] = one[i] * two[i];
        }
        for node in &self.nodes[..self.used] {
            for i in 0..BATCH {
                out[i] += node.term(h[i] * h[i] + k[i] * k[i], h[i] * k[i]);
            }
        }
        out
    }
}

/// A node of the integrals for three planes: a [`Node`] for two of them, and the distance of the third given these.
#[derive(Debug, Clone, Copy, Default)]
struct Triple {
    node: Node,
    given: [f32; 3],
}

/// Three planes with fixed unit normals, their subsets counted by bits: subset 0b011 are planes 0 and 1.
///
/// What belongs to two planes stands at the place of the third.
#[derive(Debug, Clone)]
pub(super) struct Planes {
    pairs: [Pair; 3],
    /// The other two planes seen on plane i.
    on: [Pair; 3],
    /// Distance of plane i given the other two, per distance of each.
    given: [[f32; 3]; 3],
    /// The plane whose correlations with the others grow from nothing.
    lead: usize,
    /// Integrals over the correlation of the lead with the next plane, and with the one after it.
    grow: [[Triple; MOST]; 2],
    used: [usize; 2],
    wanted: [bool; 8],
}

/// Signed distances of a batch from three planes, and the normal distribution there.
pub(super) struct Distances {
    /// Distances.
    pub h: [Row; 3],
    /// Density and distribution function.
    near: [Row; 3],
    one: [Row; 3],
}

impl Distances {
    #[inline(always)]
    pub(super) fn new(h: [Row; 3]) -> Self {
        let (mut near, mut one) = ([ZERO; 3], [ZERO; 3]);
        for a in 0..3 {
            for i in 0..BATCH {
                let bell = bell(h[a][i]);
                near[a][i] = density(bell);
                one[a][i] = distribution(h[a][i], bell);
            }
        }
        Self { h, near, one }
    }
}

/// The two planes after plane `i`.
#[inline(always)]
fn others(i: usize) -> [usize; 2] {
    [(i + 1) % 3, (i + 2) % 3]
}

/// Determinant of the matrix of correlations.
fn determinant([a, b, c]: [f64; 3]) -> f64 {
    1.0 - a * a - b * b - c * c + 2.0 * a * b * c
}

/// Coefficients of the distances in that of plane `i` given the others, divided by its standard deviation.
fn conditional(rho: [f64; 3], det: f64, i: usize) -> [f64; 3] {
    let [j, k] = others(i);
    let free = (1.0 - rho[i] * rho[i]).max(1e-12);
    let scale = 1.0 / (free * det.max(1e-12)).sqrt();
    let mut out = [0.0; 3];
    out[i] = free * scale;
    out[j] = -(rho[k] - rho[i] * rho[j]) * scale;
    out[k] = -(rho[j] - rho[i] * rho[k]) * scale;
    out
}

/// The distance that such coefficients make.
#[inline(always)]
fn combined(given: &[f32; 3], h: &[Row; 3], i: usize) -> f32 {
    given[0] * h[0][i] + given[1] * h[1][i] + given[2] * h[2][i]
}

impl Planes {
    /// For correlations `rho` (of planes 1 and 2, 2 and 0, 0 and 1); shares of subsets that are not `wanted` are
    /// left out and read zero.
    #[must_use]
    pub(super) fn new(rho: [f64; 3], wanted: [bool; 8]) -> Self {
        let root = rho.map(|r| 1.0 / (1.0 - r * r).max(1e-12).sqrt());
        let det = determinant(rho);
        let given = std::array::from_fn(|i| conditional(rho, det, i).map(|g| g as f32));
        let on = std::array::from_fn(|i| {
            let [j, k] = others(i);
            Pair::new((rho[i] - rho[j] * rho[k]) * root[j] * root[k])
        });
        let lead = (1..3).fold(0, |m, i| if rho[i].abs() > rho[m].abs() { i } else { m });
        let mut out = Self {
            pairs: rho.map(Pair::new),
            on,
            given,
            lead,
            grow: [[Triple::default(); MOST]; 2],
            used: [0; 2],
            wanted,
        };
        if wanted[7] {
            out.plan(rho, det);
        }
        out
    }

    /// Makes the nodes for three planes.
    fn plan(&mut self, rho: [f64; 3], det: f64) {
        let lead = self.lead;
        let next = others(lead);
        // Angles of the two growing correlations: next[0] is opposite next[1].
        let ends = [libm::asin(rho[next[1]]), libm::asin(rho[next[0]])];
        let widest = ends[0].abs().max(ends[1].abs());
        // The nearer the end is to where the planes depend on each other, the more nodes.
        let order = match (det, widest) {
            (d, w) if d > 0.4 && w < 0.05 => 1,
            (d, w) if d > 0.4 && w < 0.3 => 2,
            (d, w) if d > 0.2 && w < 0.6 => 3,
            (d, _) if d > 0.2 => 4,
            (d, _) if d > 0.05 => 6,
            (d, _) if d > 0.01 => 12,
            _ => MOST,
        };
        for (side, &end) in ends.iter().enumerate() {
            if end.abs() < NOTHING {
                continue;
            }
            for (slot, &(t, w)) in self.grow[side].iter_mut().zip(rule(order)) {
                let mut rho = rho;
                rho[next[1]] = libm::sin(t * ends[0]);
                rho[next[0]] = libm::sin(t * ends[1]);
                let given = conditional(rho, determinant(rho), next[1 - side]).map(|g| g as f32);
                *slot = Triple { node: Node::new(t * end, w * end), given };
                self.used[side] += 1;
            }
        }
    }

    /// The shares on the positive side of all planes of each subset.
    #[inline(always)]
    #[must_use]
    pub(super) fn shares(&self, at: &Distances) -> [Row; 8] {
        let (h, one) = (&at.h, &at.one);
        let mut out = [[1.0; BATCH], one[0], one[1], ZERO, one[2], ZERO, ZERO, ZERO];
        for i in 0..3 {
            let subset = 7 ^ (1 << i);
            if self.wanted[subset] || (self.wanted[7] && i == self.lead) {
                let [j, k] = others(i);
                out[subset] = self.pairs[i].share(&h[j], &h[k], &one[j], &one[k]);
            }
        }
        if self.wanted[7] {
            let lead = self.lead;
            let pair = out[7 ^ (1 << lead)];
            for i in 0..BATCH {
                out[7][i] = one[lead][i] * pair[i];
            }
            self.grow(h, &mut out[7]);
        }
        out
    }

    /// Adds what the lead's correlations do to the share of all three.
    #[inline(always)]
    fn grow(&self, h: &[Row; 3], sum: &mut Row) {
        let a = &h[self.lead];
        for (side, plane) in others(self.lead).into_iter().enumerate() {
            let b = &h[plane];
            for t in &self.grow[side][..self.used[side]] {
                for i in 0..BATCH {
                    let u = combined(&t.given, h, i);
                    sum[i] += t.node.term(a[i] * a[i] + b[i] * b[i], a[i] * b[i]) * distribution(u, bell(u));
                }
            }
        }
    }

    /// Derivatives of `sum over subsets of weight * share` by the distances and by the correlations (of the two
    /// other planes, each).
    #[inline(always)]
    #[must_use]
    pub(super) fn slopes(&self, at: &Distances, weight: &[f32; 8]) -> [[Row; 3]; 2] {
        let h = &at.h;
        let (mut by_h, mut by_rho) = ([ZERO; 3], [ZERO; 3]);
        let all = weight[7];
        for p in 0..3 {
            let [j, k] = others(p);
            let (single, with_j, with_k) = (weight[1 << p], weight[1 << p | 1 << j], weight[1 << p | 1 << k]);
            if [single, with_j, with_k, all].iter().all(|w| w.abs() <= 0.0) {
                continue;
            }
            // Distances of planes j, k within plane p from the point of it nearest to the centre, in standard deviations.
            let (to_j, to_k) = (&self.pairs[k], &self.pairs[j]);
            let (mut x, mut y, mut across) = (ZERO, ZERO, ZERO);
            let (mut below_x, mut below_y) = (ZERO, ZERO);
            for i in 0..BATCH {
                x[i] = (h[j][i] - to_j.rho * h[p][i]) * to_j.root;
                y[i] = (h[k][i] - to_k.rho * h[p][i]) * to_k.root;
                let bells = [bell(x[i]), bell(y[i])];
                across[i] = density(bells[0]);
                below_x[i] = distribution(x[i], bells[0]);
                below_y[i] = distribution(y[i], bells[1]);
            }
            for i in 0..BATCH {
                by_h[p][i] = single + with_j * below_x[i] + with_k * below_y[i];
            }
            if all.abs() > 0.0 {
                let both = self.on[p].share(&x, &y, &below_x, &below_y);
                for i in 0..BATCH {
                    by_h[p][i] += all * both[i];
                }
            }
            for i in 0..BATCH {
                by_h[p][i] *= at.near[p][i];
            }
            // The correlation of planes p and j.
            if all.abs() > 0.0 {
                for i in 0..BATCH {
                    let u = combined(&self.given[k], h, i);
                    let here = at.near[p][i] * across[i] * to_j.root;
                    by_rho[k][i] = here * (with_j + all * distribution(u, bell(u)));
                }
            } else if with_j.abs() > 0.0 {
                for i in 0..BATCH {
                    by_rho[k][i] = at.near[p][i] * across[i] * to_j.root * with_j;
                }
            }
        }
        [by_h, by_rho]
    }
}

#[cfg(test)]
#[path = "orthant_tests.rs"]
pub(super) mod tests;
