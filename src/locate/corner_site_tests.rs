//! Tests of what corners say: places on their sheets, off their curves, and curves by their materials.

use nalgebra::{SMatrix, SVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::super::cone::CONE;
use super::super::corner::CORNER;
use super::super::frame::basis;
use super::super::least_squares::Fit;
use super::super::orthant::tests::normals;
use super::*;

/// Margin from curves, as wishes have it.
const MARGIN: f64 = 0.2;

fn fit<const N: usize>() -> Fit<N> {
    let covariance = SMatrix::identity() * 1e-4;
    Fit { x: SVector::zeros(), chi2: 0.0, strain: 0.0, covariance, converged: true }
}

const IDS: [MaterialId; MATERIALS] = [MaterialId(0), MaterialId(1), MaterialId(2), MaterialId(3)];

fn of_planes(normals: [DVec3; 3], materials: [u8; 8], forms: [DMat3; 3]) -> CornerSite {
    let corner = Corner {
        apex: DVec3::new(0.1, -0.2, 0.15),
        normals,
        materials,
        levels: [0.0; MATERIALS],
        log_sigma: 0.0,
        forms,
    };
    let frames = normals.map(basis);
    let tangents = frames.map(|[u, v, _]| [u, v]);
    CornerSite::new(
        Shape::Planes(Box::new(CornerFit { corner, fit: fit::<CORNER>(), tangents, frames, samples: 300 })),
        IDS,
    )
}

fn of_cones() -> CornerSite {
    let directions = [
        DVec3::new(1.0, 1.0, 1.1),
        DVec3::new(-1.0, -1.1, 1.0),
        DVec3::new(-1.0, 0.9, -1.0),
        DVec3::new(1.0, -1.0, -0.8),
    ];
    let cone = Cone::of_directions(DVec3::new(0.1, 0.2, -0.1), &directions, [0.0; 4]).expect("four cones");
    let tangents = cone.rays.map(basis).map(|[u, v, _]| [u, v]);
    CornerSite::new(Shape::Cones(Box::new(ConeFit { cone, fit: fit::<CONE>(), tangents, samples: 300 })), IDS)
}

/// Whether a place lies on the sheet between two materials and off its curves: near it, on both sides, there is nothing but them.
fn is_on_sheet(site: &CornerSite, pair: [MaterialId; 2], on: DVec3, at: DVec3) {
    let passage = site.passage(pair, on).expect("a sheet");
    assert!(passage.distance.abs() < 1e-3, "{pair:?} {at}: {}", passage.distance);
    let beside = [-1e-2, 1e-2].map(|by| site.material(on + passage.normal * by));
    assert_eq!(beside, pair, "{at}");
    let near = site.nearest(on, None).expect("a curve").distance;
    assert!(near > 0.8 * MARGIN, "{pair:?} {at}: {near}");
}

fn places() -> impl Iterator<Item = DVec3> {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    (0..200).map(move |_| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.0..2.0))))
}

#[test]
fn places_on_sheets_of_planes_lie_on_them_and_off_their_curves() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let bent = DMat3::from_cols(DVec3::new(0.0, 0.0, 0.0), DVec3::new(0.0, 0.03, 0.0), DVec3::ZERO);
    let mut asked = 0;
    for (materials, pairs) in [
        ([0, 0, 0, 0, 0, 0, 0, 1], &[[0, 1]][..]),
        ([2, 2, 2, 2, 0, 0, 0, 1], &[[0, 1], [0, 2], [1, 2]]),
        ([0, 1, 2, 3, 0, 1, 2, 0], &[[0, 1], [0, 2], [1, 3], [2, 3], [0, 3]]),
    ] {
        for forms in [[DMat3::ZERO; 3], [bent, DMat3::ZERO, DMat3::ZERO]] {
            // A form's kernel is its normal.
            let normals = if forms[0] == DMat3::ZERO { normals(&mut rng, 0.4) } else { DVec3::AXES };
            let site = of_planes(normals, materials, forms);
            for at in places() {
                for &[a, b] in pairs {
                    for pair in [[a, b], [b, a]] {
                        let pair = pair.map(MaterialId);
                        let (on, sigma) = site.on_sheet(pair, at, MARGIN).expect("a sheet");
                        assert!(sigma > 0.0 && sigma < 1.0);
                        is_on_sheet(&site, pair, on, at);
                        asked += 1;
                    }
                }
            }
            assert!(site.on_sheet([MaterialId(0), MaterialId(9)], DVec3::ONE, MARGIN).is_none());
        }
    }
    assert!(asked > 5_000);
}

#[test]
fn places_on_sheets_of_cones_lie_on_them_and_off_their_curves() {
    let site = of_cones();
    for at in places() {
        for a in 0..4 {
            for b in (0..4).filter(|b| *b != a) {
                let pair = [MaterialId(a), MaterialId(b)];
                let (on, _) = site.on_sheet(pair, at, MARGIN).expect("a sheet");
                is_on_sheet(&site, pair, on, at);
            }
        }
    }
}

#[test]
fn curves_are_told_by_their_materials() {
    let site = of_cones();
    for without in 0..4u8 {
        let around: Vec<MaterialId> = (0..4).filter(|m| *m != without).map(MaterialId).collect();
        assert!(site.is_between(CurveKind::Junction, &around));
        for at in places() {
            let (on, _) = site.nearest_point(CurveKind::Junction, at, &around).expect("a curve");
            let Shape::Cones(fit) = &site.shape else { panic!("cones") };
            let ray = fit.cone.rays[usize::from(without)];
            let off = (on - fit.cone.apex) - ray * (on - fit.cone.apex).dot(ray);
            assert!(off.length() < 1e-9, "{without} {at}");
        }
    }
    // Of those that are nowhere the nearest of all is taken.
    assert!(site.nearest_point(CurveKind::Junction, DVec3::X, &[MaterialId(0), MaterialId(7)]).is_some());
    let block = of_planes(DVec3::AXES, [0, 0, 0, 0, 0, 0, 0, 1], [DMat3::ZERO; 3]);
    assert!(block.is_between(CurveKind::Edge, &[MaterialId(0), MaterialId(1)]));
    assert!(!block.is_between(CurveKind::Junction, &[MaterialId(0), MaterialId(1)]));
    assert!(!block.is_between(CurveKind::Edge, &[MaterialId(0), MaterialId(2)]));
}
