//! Shares of a round Gaussian in the half-spaces of three planes: normal orthant probabilities.
//!
//! A plane at signed distance `h` from the Gaussian's centre (sigma one, positive towards the side that counts)
//! leaves `Phi(h)` of it on that side; two planes with unit normals m, n leave `Phi2(h, k; m . n)` on both, three
//! `Phi3`. Plackett's identity says how these change with a correlation, so they are integrals over an angle:
//!
//! - `Phi2(h, k; r) = Phi(h) Phi(k) + 1/(2 pi) int_0^asin(r) exp(-(h^2 + k^2 - 2 h k sin a)/(2 cos^2 a)) da`
//!   (Drezner and Wesolowsky 1990); for `|r| > 0.925` Genz's expansion about `|r| = 1`.
//! - `Phi3`: two correlations grow from 0, `r12 = sin(t asin r12)`, `r13` alike, the largest, `r23`, stays
//!   (Genz, Statistics and Computing 14, 2004): `Phi(h1) Phi2(h2, h3; r23)` and two such integrals,
//!   each integrand times `Phi` of the third plane's distance given the first two.
//!
//! Derivatives are closed: `dPhi3/dh1 = phi(h1) Phi2(h2|1, h3|1; r23|1)`,
//! `dPhi3/dr12 = phi2(h1, h2; r12) Phi(h3|12)`.
//!
//! Gauss-Legendre nodes depend on the correlations alone and are made once for many voxels ([`Pair`], [`Planes`]).
//! Largest errors (tests): 2e-9 for two planes with any correlation; for three 3e-8 if the determinant of their
//! normals is 0.1 and more, 3e-7 down to 0.05. A voxel takes 0.04 (square) to 0.5 us, its derivatives 0.1 to 0.25.

use std::f64::consts::{FRAC_1_SQRT_2, LN_2, LOG2_E, PI, TAU};
use std::sync::LazyLock;

use super::gauss::{TABLES, Tables};

/// Nodes of the quadrature at most.
const MOST: usize = 40;
/// Beyond this correlation the expansion about one is better than the integral from zero.
const STRONG: f64 = 0.925;
/// Less than this of a density changes nothing.
const NOTHING: f64 = 1e-9;

/// The orders of Gauss-Legendre rules in use.
const ORDERS: [usize; 8] = [3, 4, 6, 8, 12, 16, 24, MOST];

/// Nodes and weights on 0 to 1, one rule for each of the orders.
static RULES: LazyLock<[Vec<(f64, f64)>; 8]> = LazyLock::new(|| ORDERS.map(legendre));

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

/// `exp(x)` for -700 < x < 700 to 1e-10 of its value, without branches, so that loops over it can be vectorised.
#[inline]
fn quick_exp(x: f64) -> f64 {
    // Adding this leaves the nearest integer in the lowest bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let shifted = x * LOG2_E + ROUND;
    let f = x - (shifted - ROUND) * LN_2;
    let p = 1.0 / 40320.0;
    let p = 1.0 / 5040.0 + f * p;
    let p = 1.0 / 720.0 + f * p;
    let p = 1.0 / 120.0 + f * p;
    let p = 1.0 / 24.0 + f * p;
    let p = 1.0 / 6.0 + f * p;
    let p = 0.5 + f * p;
    let p = 1.0 + f * (1.0 + f * p);
    p * f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52)
}

/// An exponent, held where [`quick_exp`] works; what is cut off is nothing.
#[inline]
fn clip(exponent: f64) -> f64 {
    exponent.max(-600.0)
}

/// A node of the integral for two planes: exponent `-(square (h^2 + k^2) - cross h k)`.
#[derive(Debug, Clone, Copy, Default)]
struct Node {
    square: f64,
    cross: f64,
    weight: f64,
}

impl Node {
    /// At the angle `a` with a weight.
    fn new(a: f64, weight: f64) -> Self {
        let (s, c) = (libm::sin(a), libm::cos(a));
        Self { square: 0.5 / (c * c), cross: s / (c * c), weight: weight / TAU }
    }

    #[inline]
    fn term(&self, squares: f64, product: f64) -> f64 {
        self.weight * quick_exp(clip(self.cross * product - self.square * squares))
    }
}

/// Two planes with a fixed correlation.
#[derive(Debug, Clone)]
pub(super) struct Pair {
    rho: f64,
    nodes: [Node; 16],
    used: usize,
}

impl Pair {
    /// For a correlation, -1 to 1.
    #[must_use]
    pub(super) fn new(rho: f64) -> Self {
        let rho = rho.clamp(-1.0, 1.0);
        let mut nodes = [Node::default(); 16];
        let mut used = 0;
        if rho.abs() > 1e-12 && rho.abs() <= STRONG {
            let order = match rho.abs() {
                r if r < 0.05 => 3,
                r if r < 0.2 => 4,
                r if r < 0.6 => 6,
                r if r < 0.8 => 8,
                r if r < 0.89 => 12,
                _ => 16,
            };
            let end = libm::asin(rho);
            for (node, &(t, w)) in nodes.iter_mut().zip(rule(order)) {
                *node = Node::new(t * end, w * end);
                used += 1;
            }
        }
        Self { rho, nodes, used }
    }

    /// The share on the positive side of both planes, at distances `h` and `k`; `product` is `Phi(h) Phi(k)`.
    #[inline]
    #[must_use]
    pub(super) fn share(&self, h: f64, k: f64, product: f64) -> f64 {
        if self.rho.abs() > STRONG {
            return strong(-h, -k, self.rho);
        }
        let (squares, cross) = (h * h + k * k, h * k);
        // Along the way the exponent is never above this.
        if -0.5 * (h * h).max(k * k) < -21.0 {
            return product;
        }
        product + self.nodes[..self.used].iter().map(|n| n.term(squares, cross)).sum::<f64>()
    }
}

/// Share of a bivariate normal above both `h` and `k` for a correlation near one: Genz 2004, equation 6 and after.
fn strong(h: f64, k: f64, rho: f64) -> f64 {
    let below = |x: f64| 0.5 * libm::erfc(-x * FRAC_1_SQRT_2);
    let (k, hk) = if rho < 0.0 { (-k, -h * k) } else { (k, h * k) };
    let mut part = 0.0;
    if rho.abs() < 1.0 {
        let room = (1.0 - rho) * (1.0 + rho);
        let a = room.sqrt();
        let apart = (h - k) * (h - k);
        let exponent = -0.5 * (apart / room + hk);
        let (c, d) = ((4.0 - hk) / 8.0, (12.0 - hk) / 80.0);
        if exponent > -100.0 {
            part = a
                * libm::exp(exponent)
                * (1.0 - c * (apart - room) * (1.0 - d * apart) / 3.0 + c * d * room * room);
        }
        if hk > -100.0 {
            let b = apart.sqrt();
            part -= libm::exp(-0.5 * hk)
                * TAU.sqrt()
                * below(-b / a)
                * b
                * (1.0 - c * apart * (1.0 - d * apart) / 3.0);
        }
        for &(t, w) in rule(16) {
            let x = a * t;
            let xs = x * x;
            let exponent = -0.5 * (apart / xs + hk);
            if exponent > -100.0 {
                let series = 1.0 + c * xs * (1.0 + 5.0 * d * xs);
                let root = (1.0 - xs).sqrt();
                let exact = libm::exp(-0.5 * hk * xs / (1.0 + root).powi(2)) / root;
                part += a * w * libm::exp(exponent) * (exact - series);
            }
        }
        part /= -TAU;
    }
    if rho > 0.0 {
        return part + below(-h.max(k));
    }
    if h >= k {
        return -part;
    }
    let between = if h < 0.0 { below(k) - below(h) } else { below(-h) - below(-k) };
    between - part
}

/// The bivariate normal distribution function.
#[cfg(test)]
pub(super) fn bivariate(h: f64, k: f64, rho: f64) -> f64 {
    Pair::new(rho).share(h, k, TABLES.distribution(h) * TABLES.distribution(k))
}

/// A node of the integrals for three planes: a [`Node`] for two of them, and the distance of the third given these.
#[derive(Debug, Clone, Copy, Default)]
struct Triple {
    node: Node,
    given: [f64; 3],
}

/// Three planes with fixed unit normals, their subsets counted by bits: subset 0b011 are planes 0 and 1.
///
/// What belongs to two planes stands at the place of the third.
#[derive(Debug, Clone)]
pub(super) struct Planes {
    /// Correlations.
    rho: [f64; 3],
    /// `1 / sqrt(1 - rho^2)`.
    root: [f64; 3],
    pairs: [Pair; 3],
    /// The other two planes seen on plane i.
    on: [Pair; 3],
    /// Distance of plane i given the other two, per distance of each.
    given: [[f64; 3]; 3],
    /// The plane whose correlations with the others grow from nothing.
    lead: usize,
    /// Integrals over the correlation of the lead with the next plane, and with the one after it.
    grow: [[Triple; MOST]; 2],
    used: [usize; 2],
    wanted: [bool; 8],
}

/// The two planes after plane `i`.
#[inline]
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

impl Planes {
    /// For correlations `rho` (of planes 1 and 2, 2 and 0, 0 and 1); shares of subsets that are not `wanted` are
    /// left out and read zero.
    #[must_use]
    pub(super) fn new(rho: [f64; 3], wanted: [bool; 8]) -> Self {
        let root = rho.map(|r| 1.0 / (1.0 - r * r).max(1e-12).sqrt());
        let det = determinant(rho);
        let given = std::array::from_fn(|i| conditional(rho, det, i));
        let on = std::array::from_fn(|i| {
            let [j, k] = others(i);
            Pair::new((rho[i] - rho[j] * rho[k]) * root[j] * root[k])
        });
        let lead = (1..3).fold(0, |m, i| if rho[i].abs() > rho[m].abs() { i } else { m });
        let mut out = Self {
            rho,
            root,
            pairs: rho.map(Pair::new),
            on,
            given,
            lead,
            grow: [[Triple::default(); MOST]; 2],
            used: [0; 2],
            wanted,
        };
        if wanted[7] {
            out.plan(det);
        }
        out
    }

    /// Makes the nodes for three planes.
    fn plan(&mut self, det: f64) {
        let lead = self.lead;
        let next = others(lead);
        // Angles of the two growing correlations: next[0] is opposite next[1].
        let ends = [libm::asin(self.rho[next[1]]), libm::asin(self.rho[next[0]])];
        let widest = ends[0].abs().max(ends[1].abs());
        // The nearer the end is to where the planes depend on each other, the more nodes.
        let order = match (det, widest) {
            (d, w) if d > 0.2 && w < 0.1 => 3,
            (d, w) if d > 0.4 && w < 0.3 => 4,
            (d, w) if d > 0.4 && w < 0.6 => 6,
            (d, _) if d > 0.2 => 8,
            (d, _) if d > 0.05 => 12,
            (d, _) if d > 0.02 => 16,
            (d, _) if d > 0.005 => 24,
            _ => MOST,
        };
        for (side, &end) in ends.iter().enumerate() {
            if end.abs() < 1e-12 {
                continue;
            }
            for (slot, &(t, w)) in self.grow[side].iter_mut().zip(rule(order)) {
                let mut rho = self.rho;
                rho[next[1]] = libm::sin(t * ends[0]);
                rho[next[0]] = libm::sin(t * ends[1]);
                let given = conditional(rho, determinant(rho), next[1 - side]);
                *slot = Triple { node: Node::new(t * end, w * end), given };
                self.used[side] += 1;
            }
        }
    }

    /// Distances of planes j, k within plane i from the point of it nearest to the centre, in standard deviations.
    #[inline]
    fn within(&self, h: [f64; 3], i: usize) -> [f64; 2] {
        let [j, k] = others(i);
        [(h[j] - self.rho[k] * h[i]) * self.root[k], (h[k] - self.rho[j] * h[i]) * self.root[j]]
    }

    /// The share on the positive side of all planes of each subset, at signed distances `h`.
    #[must_use]
    pub(super) fn shares(&self, h: [f64; 3]) -> [f64; 8] {
        let tables = &*TABLES;
        let one = h.map(|h| tables.distribution(h));
        let mut out = [1.0, one[0], one[1], 0.0, one[2], 0.0, 0.0, 0.0];
        for i in 0..3 {
            let subset = 7 ^ (1 << i);
            if self.wanted[subset] || (self.wanted[7] && i == self.lead) {
                let [j, k] = others(i);
                out[subset] = self.pairs[i].share(h[j], h[k], one[j] * one[k]);
            }
        }
        if self.wanted[7] {
            let base = one[self.lead] * out[7 ^ (1 << self.lead)];
            out[7] = base + self.growth(tables, h);
        }
        out
    }

    /// What the lead's correlations add to the share of all three.
    #[inline]
    fn growth(&self, tables: &Tables, h: [f64; 3]) -> f64 {
        let mut sum = 0.0;
        let a = h[self.lead];
        for (side, &plane) in others(self.lead).iter().enumerate() {
            let b = h[plane];
            let (squares, cross) = (a * a + b * b, a * b);
            if -0.5 * (a * a).max(b * b) < -21.0 {
                continue;
            }
            for t in &self.grow[side][..self.used[side]] {
                let u = t.given[0] * h[0] + t.given[1] * h[1] + t.given[2] * h[2];
                sum += t.node.term(squares, cross) * tables.distribution(u);
            }
        }
        sum
    }

    /// Derivatives of `sum over subsets of weight * share` by the distances and by the correlations (of the two
    /// other planes, each).
    #[must_use]
    pub(super) fn slopes(&self, h: [f64; 3], weight: &[f64; 8]) -> ([f64; 3], [f64; 3]) {
        let tables = &*TABLES;
        let (mut by_h, mut by_rho) = ([0.0; 3], [0.0; 3]);
        let all = weight[7];
        for i in 0..3 {
            let [j, k] = others(i);
            let near = tables.density(h[i]);
            if near < NOTHING {
                continue;
            }
            let [x, y] = self.within(h, i);
            let (below_x, below_y) = (tables.distribution(x), tables.distribution(y));
            let (with_j, with_k) = (weight[1 << i | 1 << j], weight[1 << i | 1 << k]);
            let mut sum = weight[1 << i] + with_j * below_x + with_k * below_y;
            if all.abs() > 0.0 {
                sum += all * self.on[i].share(x, y, below_x * below_y);
            }
            by_h[i] = near * sum;
            // The correlation of planes i and j.
            let here = near * tables.density(x) * self.root[k];
            if here > NOTHING && (all.abs() > 0.0 || with_j.abs() > 0.0) {
                let g = &self.given[k];
                let u = g[0] * h[0] + g[1] * h[1] + g[2] * h[2];
                by_rho[k] = here * (with_j + all * tables.distribution(u));
            }
        }
        (by_h, by_rho)
    }
}

#[cfg(test)]
#[path = "orthant_tests.rs"]
pub(super) mod tests;
