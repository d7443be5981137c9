//! Tests of which site speaks, how far, and what labels become.

use nalgebra::SMatrix;

use super::*;
use crate::locate::least_squares::Fit;
use crate::locate::wedge::{EDGE, Wedge, WedgeFit};

const SIZE: [usize; 3] = [40, 24, 30];

fn units() -> BlurUnits {
    BlurUnits::new([1.2, 1.2, 1.0])
}

/// A right-angled edge along `direction` through `at`; material 1 is in the corner between `rays`.
fn edge(at: DVec3, direction: DVec3, rays: [DVec3; 2]) -> Site {
    let wedge = Wedge::<2, EDGE>::new(DVec3::ZERO, direction, rays, [100.0, 0.0]);
    let covariance = SMatrix::identity() * 1e-4;
    let fit = Fit { x: wedge.x, chi2: 0.0, strain: 0.0, covariance, converged: true };
    let fit = WedgeFit { wedge, fit, samples: 300 };
    let materials = [1, 0, 0].map(MaterialId);
    Site { middle: at, at, materials, model: Model::Edge(Box::new(fit)) }
}

/// Edges along a line that bends, so that neighbours disagree a little.
fn chain() -> Vec<Site> {
    (0..7)
        .map(|i| {
            let (t, at) = (f64::from(i), DVec3::new(6.3, 9.2, 4.4));
            let direction = DVec3::new(1.0, 0.3 + 0.02 * t, 0.6).normalize();
            let across = direction.any_orthonormal_vector();
            let rays = [across, direction.cross(across)];
            edge(at + DVec3::new(4.1, 1.3 + 0.1 * t, 2.4) * t, direction, rays)
        })
        .collect()
}

fn relabelled(sites: &Sites, labels: &mut LabelVolume) -> (u64, BitPlanes, BitPlanes) {
    let planes = || BitPlanes::window(SIZE, 1, labels.codes().slices());
    let (mut zone, mut tainted) = (planes(), planes());
    let changed = sites.relabel(labels, &mut zone, &mut tainted);
    (changed, zone, tainted)
}

/// Two materials that have nothing to do with the sites.
fn stripes() -> LabelVolume {
    let labels: Vec<u8> = (0..SIZE.iter().product::<usize>()).map(|i| (i / 3 % 2) as u8).collect();
    LabelVolume::from_labels(&labels, SIZE).unwrap().0
}

fn voxels() -> impl Iterator<Item = [usize; 3]> {
    let [nx, ny, nz] = SIZE;
    (0..nx * ny * nz).map(move |i| [i % nx, i / nx % ny, i / (nx * ny)])
}

#[test]
fn the_nearest_site_speaks_within_its_reach() {
    let rays = [DVec3::X, DVec3::Y];
    let sites = Sites::new(
        units(),
        vec![
            edge(DVec3::new(10.0, 10.0, 10.0), DVec3::Z, rays),
            edge(DVec3::new(15.0, 10.0, 10.0), DVec3::Z, rays),
        ],
    );
    let speaks = |x: f64, y: f64, z: f64| sites.at(DVec3::new(x, y, z)).map(|a| a.site.at.x);
    assert_eq!(speaks(11.0, 10.0, 10.0), Some(10.0));
    assert_eq!(speaks(14.0, 11.0, 12.0), Some(15.0));
    // A reach is 3.2 blur units of 1.2 voxels: 3.84; along the curve 3.2 of one.
    assert_eq!(speaks(10.0, 13.8, 10.0), Some(10.0));
    assert_eq!(speaks(10.0, 13.9, 10.0), None);
    assert_eq!(speaks(10.0, 10.0, 13.1), Some(10.0));
    assert_eq!(speaks(10.0, 10.0, 13.3), None);
    let farther = |y: f64| sites.within(DVec3::new(10.0, y, 10.0), FARTHER).is_some();
    assert!(farther(15.7) && !farther(15.8));
    let place = DVec3::new(10.0, 10.5, 10.0);
    assert!(sites.pierces(CurveKind::Edge, [2, 10], place, 3.0).is_some());
    assert!(sites.pierces(CurveKind::Junction, [2, 10], place, 3.0).is_none());
    assert!(!sites.at(place).unwrap().yields);
    assert!(sites.at(DVec3::new(10.0, 13.4, 10.0)).unwrap().yields);
}

#[test]
fn a_gap_between_fits_of_one_curve_is_bridged_and_ends_are_not() {
    let rays = [DVec3::X, DVec3::Y];
    let at = |x: f64, z: f64| edge(DVec3::new(x, 10.0, z), DVec3::Z, rays);
    let speaks =
        |sites: &[Site], z: f64| Sites::new(units(), sites.to_vec()).at(DVec3::new(10.0, 10.0, z)).is_some();
    // One of 8.4: each speaks for 4.2 of it, and no farther on its other side.
    let both = [at(10.0, 10.0), at(10.0, 18.4)];
    assert!([13.5, 14.1, 14.3, 14.9].iter().all(|&z| speaks(&both, z)));
    assert!(!speaks(&both, 6.7) && !speaks(&both, 21.7));
    // One that is too long, and one to a fit of another edge beside.
    assert!(!speaks(&[at(10.0, 10.0), at(10.0, 19.6)], 14.3));
    assert!(!speaks(&[at(10.0, 10.0), at(11.0, 18.4)], 13.5));
    // And one to an edge of other materials.
    let mut other = at(10.0, 18.4);
    other.materials[1] = MaterialId(2);
    assert!(!speaks(&[at(10.0, 10.0), other], 13.5));
}

#[test]
fn the_order_of_sites_does_not_matter() {
    let (forward, mut turned) = (chain(), chain());
    turned.reverse();
    let [a, b] = [forward, turned].map(|sites| Sites::new(units(), sites));
    let mut spoken = 0;
    for voxel in voxels() {
        let place = DVec3::from(voxel.map(|c| c as f64));
        let [a, b] = [&a, &b].map(|s| s.at(place).map(|a| (a.site.at, a.distance.to_bits())));
        assert_eq!(a, b, "{voxel:?}");
        spoken += usize::from(a.is_some());
    }
    assert!(spoken > 500, "{spoken}");
}

#[test]
fn labels_are_what_the_speaking_site_says_and_stay_so() {
    let sites = Sites::new(units(), chain());
    let mut labels = stripes();
    let before = labels.clone();
    let (changed, zone, tainted) = relabelled(&sites, &mut labels);
    assert!(changed > 100, "{changed}");
    for voxel in voxels() {
        let [x, y, z] = voxel.map(|c| c + 1);
        let answer = sites.at(DVec3::from(voxel.map(|c| c as f64)));
        let expected = answer.map_or(before.at([x, y, z]), |a| a.site.material(a.at));
        assert_eq!(labels.at([x, y, z]), expected, "{voxel:?}");
        assert_eq!(zone.bit(0, x, y, z), answer.is_some(), "{voxel:?}");
        let near = answer.is_some_and(|a| a.distance <= TAINTED[CurveKind::Edge as usize]);
        assert_eq!(tainted.bit(0, x, y, z), near, "{voxel:?}");
    }
    let once = labels.clone();
    let (again, zone_again, _) = relabelled(&sites, &mut labels);
    assert!(again == 0 && labels == once && zone_again == zone);
}

#[test]
fn parts_are_relabelled_like_the_whole() {
    let sites = Sites::new(units(), chain());
    let mut whole = stripes();
    let mut part = whole.window(9..19);
    relabelled(&sites, &mut whole);
    let (_, zone, _) = relabelled(&sites, &mut part);
    assert!(part == whole.window(9..19));
    assert!(zone.counts()[0] > 0);
}
