//! Sites, found by place: which one speaks for a voxel or an edge of the lattice.
//!
//! A site speaks for what lies within reach of its curve and not far along it; of several the one to whose curve
//! a place is nearest, in units of its reach. All is decided by place alone, so any part of the volume gives the
//! same answer.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::frame::BlurUnits;
use super::site::{Model, Site};
use crate::classify::{BitPlanes, LabelVolume, WORD};
use crate::grid::MaterialId;

/// How far from a junction curve, and from a sharp edge, its site speaks, blur units.
const REACH: [f64; 2] = [5.0, 3.2];
/// How far along the curve, blur units.
const ALONG: f64 = 3.2;
/// Within this distance of a curve no grey value is explained by one interface, blur units.
const TAINTED: [f64; 2] = [3.7, 2.8];
/// Beyond this distance a patch that knows an interface knows it better.
const PATCHES: [f64; 2] = [3.9, 2.7];

/// Where labels have been set by a site whose neighbour is missing, it is asked about places so much farther away.
pub(super) const FARTHER: f64 = 1.5;

/// Edge of a box of the index, voxels.
const SIDE: usize = 4;

/// See the module's header.
#[derive(Debug)]
pub struct Sites {
    units: BlurUnits,
    sites: Vec<Site>,
    /// Sites by the boxes that they may speak in: box, site; sorted.
    boxes: Vec<([u16; 3], u32)>,
}

/// A site asked about a place.
#[derive(Debug, Clone, Copy)]
pub struct Answer<'a> {
    /// The site.
    pub site: &'a Site,
    /// The place in its blur units.
    pub at: DVec3,
    /// Distance from its curve, blur units.
    pub distance: f64,
    /// Whether a patch is to be preferred, if there is one.
    pub yields: bool,
}

/// What a site says of a voxel.
#[derive(Debug, Clone, Copy)]
struct Claim {
    voxel: [u16; 3],
    material: MaterialId,
    /// Whether the curve is so near that no single interface explains the grey value.
    tainted: bool,
}

/// What a site's curve is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CurveKind {
    /// Three materials meet.
    Junction,
    /// One interface bends.
    Edge,
}

fn kind_of(site: &Site) -> CurveKind {
    match site.model {
        Model::Junction(_) => CurveKind::Junction,
        Model::Edge(_) => CurveKind::Edge,
    }
}

fn kind(site: &Site) -> usize {
    kind_of(site) as usize
}

impl Sites {
    /// Of these sites.
    #[must_use]
    pub fn new(units: BlurUnits, sites: Vec<Site>) -> Self {
        let mut boxes: Vec<([u16; 3], u32)> = Vec::new();
        for (i, site) in sites.iter().enumerate() {
            let reach = units.voxel(DVec3::splat(FARTHER * REACH[kind(site)].hypot(ALONG)));
            let low = ((site.at - reach).max(DVec3::ZERO) / SIDE as f64).as_usizevec3();
            let high = ((site.at + reach).max(DVec3::ZERO) / SIDE as f64).as_usizevec3();
            for z in low.z..=high.z {
                for y in low.y..=high.y {
                    boxes.extend((low.x..=high.x).map(|x| ([z, y, x].map(|c| c as u16), i as u32)));
                }
            }
        }
        boxes.par_sort_unstable();
        Self { units, sites, boxes }
    }

    /// The sites.
    #[must_use]
    pub fn all(&self) -> &[Site] {
        &self.sites
    }

    fn in_box(&self, key: [u16; 3]) -> impl Iterator<Item = &Site> {
        let first = self.boxes.partition_point(|b| b.0 < key);
        self.boxes[first..].iter().take_while(move |b| b.0 == key).map(|b| &self.sites[b.1 as usize])
    }

    /// The site that speaks for a place (voxels).
    #[must_use]
    pub fn at(&self, place: DVec3) -> Option<Answer<'_>> {
        self.within(place, 1.0)
    }

    /// The same with sites that reach farther by this factor, up to 1.5.
    #[must_use]
    pub fn within(&self, place: DVec3, factor: f64) -> Option<Answer<'_>> {
        let key = [place.z, place.y, place.x].map(|c| (c.max(0.0) / SIDE as f64) as u16);
        self.best(self.in_box(key), place, factor)
    }

    /// The site of a kind whose curve passes nearest to a place, if it speaks for it.
    #[must_use]
    pub fn nearest(&self, place: DVec3, kind: CurveKind) -> Option<Answer<'_>> {
        let key = [place.z, place.y, place.x].map(|c| (c.max(0.0) / SIDE as f64) as u16);
        self.best(self.in_box(key).filter(|site| kind_of(site) == kind), place, FARTHER)
    }

    fn best<'a>(
        &'a self,
        sites: impl Iterator<Item = &'a Site>,
        place: DVec3,
        factor: f64,
    ) -> Option<Answer<'a>> {
        let mut best: Option<(f64, Answer<'a>)> = None;
        for site in sites {
            let k = kind(site);
            let at = self.units.of(place - site.middle);
            let [distance, z] = site.around(at);
            if distance > factor * REACH[k] || z.abs() > factor * ALONG {
                continue;
            }
            let score = distance / REACH[k] + 0.5 * z.abs() / ALONG;
            if best.as_ref().is_none_or(|(s, _)| score < *s) {
                let yields = distance > PATCHES[k];
                best = Some((score, Answer { site, at, distance, yields }));
            }
        }
        best.map(|b| b.1)
    }

    /// The voxels of some slices that sites speak for, by box.
    fn claims(&self, size: [usize; 3], slices: Range<usize>) -> Vec<Claim> {
        let boxes: Vec<&[([u16; 3], u32)]> = self.boxes.chunk_by(|a, b| a.0 == b.0).collect();
        boxes
            .par_iter()
            .flat_map_iter(|group| {
                let low = group[0].0.map(|c| usize::from(c) * SIDE);
                let range = move |a: usize, n: usize| low[a]..(low[a] + SIDE).min(n);
                let z = low[0].max(slices.start)..(low[0] + SIDE).min(slices.end).min(size[2]);
                let voxels = z
                    .flat_map(move |z| range(1, size[1]).map(move |y| [z, y]))
                    .flat_map(move |[z, y]| range(2, size[0]).map(move |x| [x, y, z]));
                voxels.filter_map(move |voxel| {
                    let sites = group.iter().map(|b| &self.sites[b.1 as usize]);
                    let answer = self.best(sites, DVec3::from(voxel.map(|c| c as f64)), 1.0)?;
                    Some(Claim {
                        voxel: voxel.map(|c| c as u16),
                        material: answer.site.material(answer.at),
                        tainted: answer.distance <= TAINTED[kind(answer.site)],
                    })
                })
            })
            .collect()
    }

    /// Gives the voxels that sites speak for the sites' materials, and marks them: in `zone` all of them, in `tainted` those
    /// near the curves.
    pub fn relabel(&self, labels: &mut LabelVolume, zone: &mut BitPlanes, tainted: &mut BitPlanes) -> u64 {
        let slices = labels.codes().voxel_slices();
        let mut changed = 0;
        for claim in self.claims(labels.size(), slices.start - 1..slices.end - 1) {
            let [x, y, z] = claim.voxel.map(|c| usize::from(c) + 1);
            let set = |planes: &mut BitPlanes| planes.row_mut(0, y, z)[x / WORD] |= 1 << (x % WORD);
            set(zone);
            if claim.tainted {
                set(tainted);
            }
            if labels.at([x, y, z]) != claim.material {
                labels.set([x, y, z], claim.material);
                changed += 1;
            }
        }
        changed
    }
}

#[cfg(test)]
mod tests {
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
        assert!(sites.nearest(place, CurveKind::Edge).is_some());
        assert!(sites.nearest(place, CurveKind::Junction).is_none());
        assert!(!sites.at(place).unwrap().yields);
        assert!(sites.at(DVec3::new(10.0, 13.4, 10.0)).unwrap().yields);
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
}
