//! Corners and kinks: where sharp edges and junction curves end or turn.

use std::f64::consts::TAU;

use glam::DVec3;

use super::{Curve, CurvePiece};

/// The ends of sharp edges that do not run straight on as the same sharp edge; `eps` in mm.
pub(super) fn corners(pieces: &[CurvePiece], eps: f64) -> Vec<DVec3> {
    let sharp: Vec<&CurvePiece> = pieces.iter().filter(|p| !p.is_smooth).collect();
    turns(&sharp, CurvePiece::is_edge, eps)
}

/// The ends of junction pieces that do not run straight on as the same junction curve, whether sharp edges end
/// there or not; `eps` in mm.
pub(super) fn kinks(pieces: &[CurvePiece], eps: f64) -> Vec<DVec3> {
    let junctions: Vec<&CurvePiece> = pieces.iter().filter(|p| p.is_junction()).collect();
    turns(&junctions, |_| true, eps)
}

/// The ends of the wanted ones of these pieces, without those at which exactly one other piece goes straight on.
fn turns(pieces: &[&CurvePiece], wanted: impl Fn(&CurvePiece) -> bool, eps: f64) -> Vec<DVec3> {
    let ends: Vec<(usize, DVec3, DVec3)> = (pieces.iter().enumerate())
        .flat_map(|(i, piece)| ends_of(piece).into_iter().flatten().map(move |(at, on)| (i, at, on)))
        .collect();
    let mut out: Vec<DVec3> = Vec::new();
    for &(i, at, on) in ends.iter().filter(|end| wanted(pieces[end.0])) {
        let others: Vec<_> =
            ends.iter().filter(|e| e.1.distance(at) < eps && (e.0, e.2) != (i, on)).collect();
        // A surface that bounds nothing here cuts a curve in two.
        let runs_on = matches!(others[..], [&(k, _, back)]
            if back.dot(on) < -1.0 + 1e-9 && pieces[k].materials == pieces[i].materials);
        if !runs_on && out.iter().all(|p| p.distance(at) > eps) {
            out.push(at);
        }
    }
    out
}

/// The ends of a piece, each with the direction in which it goes on from there; none on a whole turn.
fn ends_of(piece: &CurvePiece) -> Option<[(DVec3, DVec3); 2]> {
    let is_closed = matches!(piece.curve, Curve::Ellipse { .. }) && piece.high - piece.low > TAU - 1e-9;
    let end = |t: f64, sign: f64| (piece.curve.at(t), sign * piece.curve.tangent(t).normalize());
    (!is_closed).then(|| [end(piece.low, 1.0), end(piece.high, -1.0)])
}
