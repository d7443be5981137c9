//! Whole spheres of the truth against the mesh, as a metrologist measures them: by the sphere of least squares.

use glam::DVec3;
use nalgebra::{Matrix4, Vector4};
use serde::{Deserialize, Serialize};

use super::Lengths;
use super::connected::lowest_connected;
use crate::grid::Pair;
use crate::mesh::InterfaceMesh;
use crate::phantom::{Surface, Truth};

/// A whole sphere of the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SphereComparison {
    /// Id of the material inside.
    pub inside: u8,
    /// Id of the material around it.
    pub outside: u8,
    /// Its exact centre, world, mm.
    pub exact_centre: [f64; 3],
    /// Its exact radius, mm.
    pub exact_radius: f64,
    /// Closed parts of the mesh at its place: one if all is well.
    pub parts: usize,
    /// The sphere of least squares of the largest of them; `None` if there is none or it has no sphere.
    pub fit: Option<SphereFit>,
}

/// A sphere of least squares.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SphereFit {
    /// Vertices it is fitted to, none left out.
    pub vertices: usize,
    /// Fitted less exact radius, voxels.
    pub radius_error: f64,
    /// Distance of the fitted centre from the exact one, voxels.
    pub centre_error: f64,
    /// RMS of the vertices' distances from the fitted sphere, voxels.
    pub form: f64,
    /// The fitted radius, mm.
    pub radius: f64,
}

pub(super) fn compare(mesh: &InterfaceMesh, truth: &Truth, lengths: &Lengths) -> Vec<SphereComparison> {
    let mut out = Vec::new();
    for (index, surface) in truth.scene().surfaces().iter().enumerate() {
        let Surface::Sphere { centre, radius } = *surface else { continue };
        // A sphere that a curve lies on ends there.
        if truth.curves().iter().any(|piece| piece.touching_surfaces().contains(&index)) {
            continue;
        }
        let probe = centre + radius * DVec3::X;
        let Some((pair, _)) = truth.scene().interface_at(index, probe) else { continue };
        let (inside, outside) = truth.scene().sides(index, probe);
        let parts = parts_at(mesh, pair, centre, (1.5 * radius).max(radius + 2.0 * lengths.voxel));
        let largest = parts.iter().max_by_key(|part| part.len());
        let fit = largest.and_then(|points| {
            let (fitted, found) = least_squares(points)?;
            let square: f64 = points.iter().map(|p| (p.distance(fitted) - found).powi(2)).sum();
            Some(SphereFit {
                vertices: points.len(),
                radius_error: (found - radius) / lengths.voxel,
                centre_error: fitted.distance(centre) / lengths.voxel,
                form: (square / points.len() as f64).sqrt() / lengths.voxel,
                radius: found,
            })
        });
        out.push(SphereComparison {
            inside: inside.0,
            outside: outside.0,
            exact_centre: centre.to_array(),
            exact_radius: radius,
            parts: parts.len(),
            fit,
        });
    }
    out
}

/// The vertices of each connected part of a pair's triangles that lies wholly within `reach` of `centre`.
fn parts_at(mesh: &InterfaceMesh, pair: Pair, centre: DVec3, reach: f64) -> Vec<Vec<DVec3>> {
    let all = mesh.triangles().iter().zip(mesh.pairs());
    let own: Vec<[u32; 3]> = all.filter(|(_, p)| **p == pair).map(|(t, _)| *t).collect();
    let lowest = lowest_connected(mesh.positions().len(), &own);
    let mut vertices: Vec<(u32, u32)> = own.iter().flatten().map(|&v| (lowest[v as usize], v)).collect();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
        .chunk_by(|a, b| a.0 == b.0)
        .map(|part| part.iter().map(|&(_, v)| mesh.positions()[v as usize]).collect::<Vec<_>>())
        .filter(|part| part.iter().all(|p| p.distance(centre) <= reach))
        .collect()
}

/// Centre and radius of the sphere with the least sum of squared distances from the points (Gauss and Newton's
/// method); `None` if they have no such sphere.
fn least_squares(points: &[DVec3]) -> Option<(DVec3, f64)> {
    let n = points.len() as f64;
    let mut centre = points.iter().sum::<DVec3>() / n;
    let mut radius = points.iter().map(|p| p.distance(centre)).sum::<f64>() / n;
    for _ in 0..100 {
        let (mut normal, mut right) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
        for p in points {
            let away = *p - centre;
            let distance = away.length();
            let direction = away.try_normalize()?;
            // The derivative of distance - radius by the centre and the radius.
            let row = Vector4::new(-direction.x, -direction.y, -direction.z, -1.0);
            normal += row * row.transpose();
            right -= row * (distance - radius);
        }
        let step = normal.cholesky()?.solve(&right);
        centre += DVec3::new(step[0], step[1], step[2]);
        radius += step[3];
        if step.norm() <= 1e-12 * radius.abs() {
            return (radius > 0.0).then_some((centre, radius));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cap_of_a_sphere_and_points_off_both_ways_give_back_the_sphere() {
        let (centre, radius) = (DVec3::new(3.0, -2.0, 11.0), 4.5);
        let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
        let cap: Vec<DVec3> = (0..400)
            .map(|k| {
                let (z, turn) = (1.0 - f64::from(k) / 400.0 * 1.2, golden * f64::from(k));
                let ring = (1.0 - z * z).sqrt();
                let d = DVec3::new(ring * turn.cos(), ring * turn.sin(), z);
                centre + d * radius
            })
            .collect();
        let (found, r) = least_squares(&cap).unwrap();
        assert!(found.distance(centre) < 1e-9 && (r - radius).abs() < 1e-9);
        let both: Vec<DVec3> = cap
            .iter()
            .flat_map(|p| [0.99, 1.01].map(|f| centre + f * (*p - centre)))
            .chain(cap.iter().flat_map(|p| [0.99, 1.01].map(|f| centre - f * (*p - centre))))
            .collect();
        let (found, r) = least_squares(&both).unwrap();
        assert!(found.distance(centre) < 1e-9 && (r - radius).abs() < 1e-9);
        assert!(least_squares(&cap[..3]).is_none(), "three points have no sphere");
    }
}
