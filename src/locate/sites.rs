//! Sites, found by place: which one speaks for a voxel or an edge of the lattice.
//!
//! A site speaks for what lies within reach of its curve and not far along it; of several the one to whose curve
//! a place is nearest, in units of its reach. A corner speaks for all around it, before any curve, and farther
//! along its curves where no fit of theirs does. All is decided by place alone, so any part of the volume gives the
//! same answer.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::by_box::ByBox;
use super::corner_site::are_same;
use super::frame::BlurUnits;
use super::site::{Model, Site};
use crate::classify::{BitPlanes, LabelVolume, WORD};
use crate::grid::MaterialId;

/// How far from a junction curve, and from a sharp edge, its site speaks, blur units.
const REACH: [f64; 2] = [5.0, 3.2];
/// How far along the curve, blur units; towards a fit of the same curve to halfway there, but no farther than the second.
const ALONG: f64 = 3.2;
const BRIDGED: f64 = 4.5;
/// Of the same curve: each passes the other's point within this distance, blur units.
const SAME_CURVE: f64 = 0.5;
/// Within this distance of a curve no grey value is explained by one interface, blur units.
const TAINTED: [f64; 2] = [3.7, 2.8];
/// Beyond this distance a patch that knows an interface knows it better.
const PATCHES: [f64; 2] = [3.9, 2.7];

/// A junction speaks farther where its narrowest sector is too narrow for labels to be told, so far beside that sector, blur units.
const BESIDE_NARROW: f64 = 2.0;

/// A corner speaks for all that lies within this distance of it, blur units; farther for what is near its curves.
const CORNER: f64 = 4.3;
/// Fits of curves that are centred so near to a corner have seen it, and do not count.
const SPOILT: f64 = 3.5;
/// Fits of curves centred so near to a corner may have seen it: those that leave so many times what others of their kind leave, by the median, do not
/// count either, if the corner is known to this (blur units), as it tells its curves that far.
const SEEN: f64 = 6.5;
const MORE: f64 = 2.5;
const SURE: f64 = 0.06;
/// Fits of a corner nearer to each other than this are of the same one, blur units.
const SAME: f64 = 1.5;

/// A point where curves meet may lie so far outside of the cell in which labels show all its materials, voxels.
const BESIDE: f64 = 0.9;

/// Where labels have been set by a site whose neighbour is missing, it is asked about places so much farther away.
pub(super) const FARTHER: f64 = 1.5;

/// How far a curve may bend away within its reach, blur units.
const BENT: f64 = 1.0;

/// Edge of a box of the index, voxels.
const SIDE: usize = 4;

/// See the module's header.
#[derive(Debug)]
pub struct Sites {
    units: BlurUnits,
    sites: Vec<Site>,
    /// How far each may speak along its curve, back and on, and how far around its `at`, blur units.
    alongs: Vec<[f64; 2]>,
    reaches: Vec<f64>,
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
    /// Distance from its nearest curve, blur units.
    pub distance: f64,
    /// What that curve is.
    pub kind: CurveKind,
    /// Whether a patch is to be preferred, if there is one.
    pub yields: bool,
    /// Whether no interface can be seen alone there, far from the curve as it may be: a sector is narrow.
    pub blind: bool,
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

/// What a site makes of a place.
#[derive(Debug, Clone, Copy)]
struct Claimed {
    /// Of several sites that with the least speaks.
    score: f64,
    /// Distance from the nearest curve, and what that is.
    distance: f64,
    kind: CurveKind,
    /// Whether the place lies in or beside a sector that is too narrow there for its sheets to be seen apart.
    blind: bool,
}

impl Site {
    /// What kind of curve was fitted, and the misfit per voxel that was left; of single curves.
    fn left(&self) -> Option<(CurveKind, f64)> {
        match &self.model {
            Model::Junction(fit) => Some((CurveKind::Junction, fit.reduced())),
            Model::Edge(fit) => Some((CurveKind::Edge, fit.reduced())),
            Model::Knee(_) | Model::Corner(_) => None,
        }
    }

    /// How far around `at` the site may speak, blur units, if it does so far along its curve.
    fn farthest(&self, along: [f64; 2]) -> f64 {
        let along = along[0].max(along[1]);
        match &self.model {
            Model::Junction(fit) => fit.wedge.blind().max(REACH[CurveKind::Junction as usize]).hypot(along),
            Model::Edge(_) => REACH[CurveKind::Edge as usize].hypot(along),
            Model::Knee(fit) => {
                let bend = fit.knee.length(0.0) + 1.0 + REACH[CurveKind::Edge as usize];
                bend.max(REACH[CurveKind::Junction as usize]).hypot(along)
            }
            Model::Corner(corner) => corner.reach(),
        }
    }

    /// What the site makes of a place (blur units from its middle), within `factor` times its reach, `along` its curve; of curves of
    /// a kind, or of any.
    fn claims(&self, at: DVec3, along: [f64; 2], factor: f64, asked: Option<CurveKind>) -> Option<Claimed> {
        let ([distance, z], kind) = match &self.model {
            Model::Junction(_) => (self.around(at), CurveKind::Junction),
            Model::Edge(_) => (self.around(at), CurveKind::Edge),
            Model::Knee(fit) => {
                let (distances, z) = fit.knee.around(at);
                let kind = asked.unwrap_or({
                    let [junction, edge] = [0, 1].map(|k| distances[k] / REACH[k]);
                    if edge < junction { CurveKind::Edge } else { CurveKind::Junction }
                });
                ([distances[kind as usize], z], kind)
            }
            Model::Corner(corner) => {
                let near = corner.nearest(at, asked)?;
                let radius = corner.radius(at);
                let reach = REACH[near.kind as usize];
                let within = radius <= CORNER;
                if !within && (radius > corner.reach() || near.distance > factor * reach) {
                    return None;
                }
                // Before any curve, or after.
                let score = radius / CORNER + if within { -10.0 } else { 10.0 };
                return Some(Claimed { score, distance: near.distance, kind: near.kind, blind: false });
            }
        };
        let blind = match &self.model {
            Model::Junction(fit)
                if distance > TAINTED[CurveKind::Junction as usize]
                    && distance <= factor * fit.wedge.blind()
                    && fit.wedge.is_narrow_at(at, BESIDE_NARROW) =>
            {
                fit.wedge.blind()
            }
            _ => 0.0,
        };
        let reach = REACH[kind as usize].max(blind);
        let speaks = distance <= factor * reach
            && z.abs() <= (factor * ALONG).max(along[usize::from(z > 0.0)])
            && asked.is_none_or(|asked| asked == kind);
        let score = distance / reach + 0.5 * z.abs() / ALONG;
        speaks.then_some(Claimed { score, distance, kind, blind: blind > 0.0 })
    }
}

/// What fits of curves of a kind leave per voxel, the median.
fn usual(sites: &[Site], kind: CurveKind) -> f64 {
    let mut left: Vec<f64> =
        sites.iter().filter_map(Site::left).filter(|left| left.0 == kind).map(|left| left.1).collect();
    left.sort_by(f64::total_cmp);
    left.get(left.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// Of several fits of a corner one that is sure and explains the grey values, and no fits of curves beside corners.
fn settled(units: BlurUnits, sites: Vec<Site>) -> Vec<Site> {
    let (corners, mut out): (Vec<Site>, Vec<Site>) =
        sites.into_iter().partition(|site| matches!(site.model, Model::Corner(_)));
    // What explains more counts for more: the wrong one of two may be the surer.
    let mut corners: Vec<(f64, Site)> = corners
        .into_iter()
        .map(|site| {
            let Model::Corner(corner) = &site.model else { return (f64::INFINITY, site) };
            (corner.apex_sigma() * corner.reduced().powi(2), site)
        })
        .collect();
    corners.sort_by(|a, b| {
        let key = |(rank, site): &(f64, Site)| [*rank, site.at.z, site.at.y, site.at.x];
        let order = key(a).into_iter().zip(key(b)).map(|(x, y)| x.total_cmp(&y)).find(|o| o.is_ne());
        order.unwrap_or(std::cmp::Ordering::Equal)
    });
    // By boxes that are wider than what is looked for around.
    let boxes = || ByBox::new(units.voxel(DVec3::splat(SEEN)).max_element());
    let (mut places, mut sure) = (boxes(), boxes());
    let near = |places: &ByBox<(), DVec3>, at: DVec3, reach: f64| {
        places.near((), at).any(|other| units.of(other - at).length() < reach)
    };
    let mut kept = Vec::new();
    let is_sure = |site: &Site| matches!(&site.model, Model::Corner(corner) if corner.apex_sigma() < SURE);
    for (_, site) in corners {
        if !near(&places, site.at, SAME) {
            places.insert((), site.at, site.at);
            if is_sure(&site) {
                sure.insert((), site.at, site.at);
            }
            kept.push(site);
        }
    }
    let most = [CurveKind::Junction, CurveKind::Edge].map(|kind| MORE * usual(&out, kind));
    let is_poor = |site: &Site| site.left().is_some_and(|(kind, left)| left > most[kind as usize]);
    out.retain(|site| {
        let has_seen = is_poor(site) && near(&sure, site.at, SEEN);
        !has_seen && !near(&places, site.at, SPOILT)
    });
    out.append(&mut kept);
    out
}

/// How far each site speaks along its curve, back and on: where the next fit of the same curve is too far for both, halfway to it.
fn alongs(units: BlurUnits, sites: &[Site]) -> Vec<[f64; 2]> {
    let most = 2.0 * BRIDGED + SAME_CURVE;
    let mut curves = ByBox::new(units.voxel(DVec3::splat(most)).max_element());
    let kind_of = |site: &Site| site.left().map(|(kind, _)| kind as usize);
    for (i, site) in sites.iter().enumerate() {
        if let Some(kind) = kind_of(site) {
            curves.insert(kind, site.at, i);
        }
    }
    let seen = |from: &Site, other: &Site| {
        let [off, z] = from.around(units.of(other.at - from.middle));
        (off <= SAME_CURVE && z.abs() <= 2.0 * BRIDGED).then_some(z)
    };
    // Of an edge it counts which of its materials is in the corner; fits of a junction may begin at any of theirs.
    let are_alike = |kind: usize, a: &Site, b: &Site| {
        if kind == CurveKind::Edge as usize {
            a.materials == b.materials
        } else {
            are_same(&a.materials, &b.materials)
        }
    };
    let along = |site: &Site| {
        let mut along = [ALONG; 2];
        let Some(kind) = kind_of(site) else { return along };
        for other in curves.near(kind, site.at).map(|i| &sites[i]) {
            if are_alike(kind, site, other)
                && seen(other, site).is_some()
                && let Some(z) = seen(site, other)
            {
                let side = &mut along[usize::from(z > 0.0)];
                *side = side.max(0.5 * z.abs());
            }
        }
        along
    };
    sites.par_iter().map(along).collect()
}

impl Sites {
    /// Of these sites.
    #[must_use]
    pub fn new(units: BlurUnits, sites: Vec<Site>) -> Self {
        let sites = settled(units, sites);
        let alongs = alongs(units, &sites);
        let reaches: Vec<f64> =
            sites.iter().zip(&alongs).map(|(site, along)| site.farthest(*along)).collect();
        let mut boxes: Vec<([u16; 3], u32)> = Vec::new();
        for (i, (site, reach)) in sites.iter().zip(&reaches).enumerate() {
            let reach = units.voxel(DVec3::splat(FARTHER * reach));
            let low = ((site.at - reach).max(DVec3::ZERO) / SIDE as f64).as_usizevec3();
            let high = ((site.at + reach).max(DVec3::ZERO) / SIDE as f64).as_usizevec3();
            for z in low.z..=high.z {
                for y in low.y..=high.y {
                    boxes.extend((low.x..=high.x).map(|x| ([z, y, x].map(|c| c as u16), i as u32)));
                }
            }
        }
        boxes.par_sort_unstable();
        Self { units, sites, alongs, reaches, boxes }
    }

    /// The sites.
    #[must_use]
    pub fn all(&self) -> &[Site] {
        &self.sites
    }

    /// The sites that may speak in a box, by number.
    fn in_box(&self, key: [u16; 3]) -> impl Iterator<Item = u32> {
        let first = self.boxes.partition_point(|b| b.0 < key);
        self.boxes[first..].iter().take_while(move |b| b.0 == key).map(|b| b.1)
    }

    fn site(&self, number: u32) -> &Site {
        &self.sites[number as usize]
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
        self.best(self.in_box(key), place, factor, None)
    }

    /// Where a curve of a kind passes the plane `coordinate` of an axis near a place on it (voxels), its standard deviation
    /// in blur units, and whose it is. Curves are followed `reach` blur units from the middles of their fits.
    #[must_use]
    pub fn pierces(
        &self,
        kind: CurveKind,
        plane: [usize; 2],
        place: DVec3,
        reach: f64,
    ) -> Option<(DVec3, f64, &Site)> {
        self.of_curves(kind, place, |_| true).into_iter().flatten().find_map(|answer| {
            let (at, sigma) = answer.site.pierces(kind, plane, self.units.per_voxel, place, reach)?;
            Some((at, sigma, answer.site))
        })
    }

    /// The point of a curve of a kind that is nearest to a place (voxels), and its standard deviation in blur units. Curves are
    /// followed `reach` blur units from the middles of their fits. Of curves with just `materials` around them, if there is one.
    #[must_use]
    pub fn nearest(
        &self,
        kind: CurveKind,
        place: DVec3,
        reach: f64,
        materials: &[MaterialId],
    ) -> Option<(DVec3, f64)> {
        let point =
            |answer: Answer<'_>| answer.site.nearest(kind, self.units.per_voxel, place, reach, materials);
        let is_between = |site: &Site| site.is_between(kind, materials);
        let own = self.of_curves(kind, place, is_between);
        own.into_iter().flatten().find_map(point).or_else(|| {
            let any = self.of_curves(kind, place, |_| true);
            any.into_iter().flatten().find_map(point)
        })
    }

    /// Who of those that are `asked` speaks for curves of a kind near a place (voxels), the better first.
    fn of_curves(
        &self,
        kind: CurveKind,
        place: DVec3,
        asked: impl Fn(&Site) -> bool,
    ) -> [Option<Answer<'_>>; 2] {
        let key = [place.z, place.y, place.x].map(|c| (c.max(0.0) / SIDE as f64) as u16);
        let is_corner = |site: &u32| matches!(self.site(*site).model, Model::Corner(_));
        let own = || self.in_box(key).filter(|site| asked(self.site(*site)));
        let corner = self.best(own().filter(is_corner), place, FARTHER, Some(kind));
        let curve = self.best(own().filter(|site| !is_corner(site)), place, FARTHER, Some(kind));
        // Within a corner's ball its curves are all there are; beyond, those of other fits come first.
        let is_inside = |a: &Answer<'_>| self.units.of(a.site.at - place).length() <= CORNER;
        if corner.is_some_and(|a| is_inside(&a)) { [corner, curve] } else { [curve, corner] }
    }

    /// The corner for the cell whose lowest corner is `low` (voxels), and the standard deviation of its place in blur
    /// units. One of two materials is that of the cell it lies in; one where more meet is that of the nearest cell in which all
    /// of them meet by their labels: there contouring has a vertex where curves meet.
    #[must_use]
    pub fn corner(&self, low: DVec3) -> Option<(DVec3, f64)> {
        let place = low + 0.5;
        let key = [place.z, place.y, place.x].map(|c| (c.max(0.0) / SIDE as f64) as u16);
        let mut best: Option<(f64, (DVec3, f64))> = None;
        for site in self.in_box(key).map(|number| self.site(number)) {
            let Model::Corner(corner) = &site.model else { continue };
            let off = |low: DVec3| (site.at - low - 0.5).abs().max_element() - 0.5;
            let shows_all = |low: DVec3| {
                let at = |c: usize| low + DVec3::new((c & 1) as f64, (c >> 1 & 1) as f64, (c >> 2) as f64);
                let mut seen: Vec<MaterialId> =
                    (0..8).map(|c| corner.material(self.units.of(at(c) - site.middle))).collect();
                seen.sort_unstable();
                seen.dedup();
                seen.len() == corner.count()
            };
            let here = off(low);
            let order = |low: DVec3| [off(low), low.z, low.y, low.x];
            let is_nearest = || {
                let around =
                    (0..27).map(|i| DVec3::from([i % 3, i / 3 % 3, i / 9].map(|c| f64::from(c) - 1.0)));
                let own = order(low);
                around.map(|by| site.at.floor() + by).all(|other| order(other) >= own || !shows_all(other))
            };
            let is_here = match corner.count() {
                0..=2 => here <= 0.0,
                _ => here <= BESIDE && shows_all(low) && is_nearest(),
            };
            if is_here && best.is_none_or(|(least, _)| here < least) {
                best = Some((here, (site.at, corner.apex_sigma())));
            }
        }
        best.map(|b| b.1)
    }

    fn best(
        &self,
        sites: impl Iterator<Item = u32>,
        place: DVec3,
        factor: f64,
        asked: Option<CurveKind>,
    ) -> Option<Answer<'_>> {
        let mut best: Option<(f64, Answer<'_>)> = None;
        for number in sites {
            let site = self.site(number);
            // Most of those in a box are farther off; a curve may bend a little away from `at`.
            let reach = factor * self.reaches[number as usize] + BENT;
            if self.units.of(place - site.at).length_squared() > reach * reach {
                continue;
            }
            let at = self.units.of(place - site.middle);
            let Some(claimed) = site.claims(at, self.alongs[number as usize], factor, asked) else {
                continue;
            };
            if best.as_ref().is_none_or(|(s, _)| claimed.score < *s) {
                let Claimed { score, distance, kind, blind } = claimed;
                let yields = distance > PATCHES[kind as usize] && !blind;
                best = Some((score, Answer { site, at, distance, kind, yields, blind }));
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
                    let sites = group.iter().map(|b| b.1);
                    let answer = self.best(sites, DVec3::from(voxel.map(|c| c as f64)), 1.0, None)?;
                    Some(Claim {
                        voxel: voxel.map(|c| c as u16),
                        material: answer.site.material(answer.at),
                        tainted: answer.blind || answer.distance <= TAINTED[answer.kind as usize],
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
#[path = "sites_tests.rs"]
mod tests;
