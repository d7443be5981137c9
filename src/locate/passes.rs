//! The passes over the volume, each a function from slices with a halo to what belongs to the slices without.
//!
//! 1. [`find_junctions`]: junction curves, from labels and grey values.
//! 2. [`find_sheets`]: patches of single interfaces, away from those curves; and where they are no smooth sheets.
//! 3. [`find_curves`]: junction curves again, with patches on their flanks; sharp edges; corners.
//! 4. [`models`]: labels that agree with all curves, patches away from all of them, labels that agree with those.
//!
//! What the first three find is kept for the whole volume (it follows the curves); each pass reads
//! [`halo`] slices beyond its own.

use std::ops::Range;

use glam::DVec3;

use super::cone_sites::cone_sites;
use super::corner_sites::{corner_sites, junctions_about};
use super::edge_sites::edge_sites;
use super::flanks::FlatIndex;
use super::flat_starts;
use super::frame::BlurUnits;
use super::junction_sites::{blocks_of, junction_sites, more_junctions, refine};
use super::patches::{BLOCK, Flat, Patches, Rough};
use super::site::Site;
use super::sites::Sites;
use super::specks::{self, remove_specks};
use super::view::View;
use crate::classify::{BitPlanes, LabelVolume};

/// Slices that the passes read on each side of their own.
#[must_use]
pub fn halo(units: BlurUnits) -> usize {
    // A window's middle is moved, then a ball is taken about it; and labels are looked at around.
    let unit = 1.0 / units.per_voxel.z;
    // From patches it starts farther off, but labels are not looked at there.
    // Islands are judged by what is within `specks::FAR` of them.
    // And blocks beside those of the slices are fitted.
    (10.0 * unit + 8.0 + (specks::FAR + BLOCK) as f64).max((flat_starts::FARTHEST + 9.2) * unit).ceil()
        as usize
}

/// [`halo`] at most: for a blur of sigma 2.6 voxels along z. Models are not used for a wider one.
pub const MOST_HALO: usize = 48;

/// Patches of single interfaces, and where crossings are no smooth sheet.
#[derive(Debug, Default)]
pub struct Sheets {
    /// Patches.
    pub flats: Vec<Flat>,
    /// Blocks without.
    pub rough: Vec<Rough>,
}

impl Sheets {
    /// Adds those of the next slices.
    pub fn append(&mut self, mut next: Self) {
        self.flats.append(&mut next.flats);
        self.rough.append(&mut next.rough);
    }
}

/// The sheets of the whole volume, patches to be found by place.
#[derive(Debug)]
pub struct SheetIndex {
    flats: FlatIndex,
    rough: Vec<Rough>,
}

impl From<Sheets> for SheetIndex {
    fn from(sheets: Sheets) -> Self {
        Self { flats: FlatIndex::new(sheets.flats), rough: sheets.rough }
    }
}

/// Pass 1, of the slices `core`.
#[must_use]
pub fn find_junctions(view: &View<'_>, core: Range<usize>) -> Vec<Site> {
    junction_sites(view, core)
}

/// Pass 2, of the slices `core`; `junctions` are those of the whole volume.
#[must_use]
pub fn find_sheets(view: &View<'_>, junctions: &Sites, core: Range<usize>) -> Sheets {
    let relabelled = Relabelled::new(view, junctions);
    let Patches { flats, rough, .. } = Patches::fit(&relabelled.view(view), blocks_of(&core, BLOCK));
    let places = rough.iter().map(|r| r.at).chain(junctions.all().iter().map(|site| site.at));
    let asked = Neighbourhood::new(places, view.units.voxel(DVec3::splat(ASKED)).max_element());
    let near_ends = |z: f64| z < core.start as f64 + asked.reach || z > core.end as f64 - asked.reach;
    let flats = flats.into_iter().filter(|flat| near_ends(flat.at.z) || asked.contains(flat.at)).collect();
    Sheets { flats, rough }
}

/// Patches are asked about within this distance of junctions and rough blocks, blur units: a wedge lies within 5 of its
/// seed, its flanks within 7.5 of it, within 12 where the scan does not show more (`steadied`). Others need not be kept: they follow the whole surface.
const ASKED: f64 = 18.0;

/// What is near to some places.
struct Neighbourhood {
    reach: f64,
    /// Boxes of edge `reach` with a place, sorted.
    boxes: Vec<[i32; 3]>,
}

impl Neighbourhood {
    fn new(places: impl Iterator<Item = DVec3>, reach: f64) -> Self {
        let mut boxes: Vec<[i32; 3]> = places.map(|at| Self::box_of(at, reach)).collect();
        boxes.sort_unstable();
        boxes.dedup();
        Self { reach, boxes }
    }

    fn box_of(at: DVec3, reach: f64) -> [i32; 3] {
        at.to_array().map(|c| (c / reach).floor() as i32)
    }

    /// Whether a place is within reach of one of them, or a little farther.
    fn contains(&self, at: DVec3) -> bool {
        let [x, y, z] = Self::box_of(at, self.reach);
        (0..27).any(|i| {
            let near = [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1];
            self.boxes.binary_search(&near).is_ok()
        })
    }
}

/// Pass 3, of the slices `core`; `junctions` and `sheets` are those of the whole volume.
#[must_use]
pub fn find_curves(view: &View<'_>, junctions: &Sites, sheets: &SheetIndex, core: Range<usize>) -> Vec<Site> {
    let flats = &sheets.flats;
    let mut found = refine(view, flats, junctions.all(), &core);
    found.extend(more_junctions(view, flats, junctions.all(), &core));
    let relabelled = Relabelled::new(view, junctions);
    let relabelled = relabelled.view(view);
    let places = junctions_about(&relabelled, &core);
    found.extend(corner_sites(&relabelled, flats, &places, &sheets.rough, &core));
    found.extend(cone_sites(&relabelled, flats, &places, junctions.all(), &core));
    found.extend(edge_sites(&relabelled, flats, &sheets.rough, core));
    found
}

/// Labels that agree with the curves, patches away from them.
#[derive(Debug)]
pub struct Models {
    /// Labels of the slices that were seen; those of the core and its neighbours are right.
    pub labels: LabelVolume,
    /// Voxels that curves speak for.
    pub zone: BitPlanes,
    /// Sheets.
    pub patches: Patches,
}

/// Pass 4, of the slices `core` and `beyond` more on each side; `curves` are those of the whole volume.
#[must_use]
pub fn models(view: &View<'_>, curves: &Sites, core: Range<usize>, beyond: usize) -> Models {
    let relabelled = Relabelled::new(view, curves);
    let depth = view.slab.size()[2];
    // The cells of the core reach one slice beyond it, and their edges' upper ends one more; what is a speck is told by what is
    // around it.
    let beyond = beyond + specks::MOST - 1;
    let slices = core.start.saturating_sub(2 + beyond)..(core.end + 3 + beyond).min(depth);
    // And the blocks beside those.
    let blocks =
        (slices.start / BLOCK).saturating_sub(1)..(slices.end.div_ceil(BLOCK) + 1).min(depth.div_ceil(BLOCK));
    let patches = Patches::fit(&relabelled.view(view), blocks);
    let Relabelled { mut labels, zone, .. } = relabelled;
    patches.relabel(&view.units, &mut labels, &zone, slices);
    Models { labels, zone, patches }
}

/// What curves make of a view.
struct Relabelled {
    labels: LabelVolume,
    /// Voxels that curves speak for.
    zone: BitPlanes,
    /// Voxels near curves, and those that were uncertain before and for which no curve speaks.
    uncertain: BitPlanes,
}

impl Relabelled {
    fn new(before: &View<'_>, sites: &Sites) -> Self {
        let mut labels = before.labels.clone();
        let planes = || BitPlanes::window(before.slab.size(), 1, labels.codes().slices());
        let (mut zone, mut uncertain) = (planes(), planes());
        sites.relabel(&mut labels, &mut zone, &mut uncertain);
        remove_specks(&mut labels, before.labels, &zone);
        let rows = uncertain.padded()[1];
        uncertain.fill_slices(|z, mut slice| {
            for y in 0..rows {
                let (was, spoken) = (before.uncertain.row(0, y, z), zone.row(0, y, z));
                for (word, (was, spoken)) in slice.row(0, y).iter_mut().zip(was.iter().zip(spoken)) {
                    *word |= was & !spoken;
                }
            }
        });
        Self { labels, zone, uncertain }
    }

    /// The view of the same slices with these labels.
    fn view<'a>(&'a self, before: &View<'a>) -> View<'a> {
        View { labels: &self.labels, uncertain: &self.uncertain, ..*before }
    }
}
