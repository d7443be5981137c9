//! Neighbouring patches support each other: where an interface lies is told by all patches around, so that it has no steps where blocks
//! meet.
//!
//! A partition of unity (Ohtake et al. 2003, Multi-level Partition of Unity Implicits): the patch of a block counts fully at
//! the block's middle and not at all at the middles of those beside, linearly along each axis. It is a mean of signed distances, so where patches are
//! those of one smooth sheet the mean is, too. A neighbour's that says otherwise is of another sheet and does not count, so
//! that nothing is rounded which patches tell apart; near edges there are none.

use glam::DVec3;

use super::frame::BlurUnits;
use super::passage::Passage;
use super::patches::{BLOCK, OfBlock, Patches};
use crate::grid::MaterialId;

/// Patches of one sheet differ by less than this, blur units, and the cosine of their normals is more.
const AGREE: f64 = 0.3;
const ALIKE: f64 = 0.9;
/// Below this weight a patch is not asked.
const LEAST: f64 = 0.02;
/// Correlation of what noise does to neighbouring patches: they share grey values.
const SHARED: f64 = 0.4;

/// What patches around say of a place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Blended {
    /// Signed distance and normal there.
    pub passage: Passage,
    /// Its standard deviation, as a share of that of a single patch.
    pub sigma: f64,
}

/// The interface of a pair (ascending) at a place (voxels) of which the patch `own` says `passage`.
pub(super) fn blended(
    patches: &Patches,
    units: BlurUnits,
    pair: [MaterialId; 2],
    place: DVec3,
    (own, passage): (&OfBlock<'_>, Passage),
) -> Blended {
    let side = BLOCK as f64;
    let at = place / side - 0.5;
    let low = at.floor();
    let share = at - low;
    let (mut distance, mut normal, mut all, mut squares) = (0.0, DVec3::ZERO, 0.0, 0.0);
    for corner in 0..8 {
        let bit = DVec3::from([0, 1, 2].map(|a| f64::from(corner >> a & 1)));
        let weight = (bit * share + (1.0 - bit) * (1.0 - share)).element_product();
        let block = low + bit;
        if weight < LEAST || block.min_element() < 0.0 {
            continue;
        }
        let of = patches.of_block(units, block.to_array().map(|b| b as usize * BLOCK), pair);
        let said = if of.is_of(own) { Some(passage) } else { of.passage(place) };
        let Some(said) = said else { continue };
        let differs =
            (said.distance - passage.distance).abs() > AGREE || said.normal.dot(passage.normal) < ALIKE;
        if differs {
            continue;
        }
        distance += weight * said.distance;
        normal += weight * said.normal;
        all += weight;
        squares += weight * weight;
    }
    let Some(normal) = normal.try_normalize() else {
        return Blended { passage, sigma: 1.0 };
    };
    let alone = squares / (all * all);
    Blended {
        passage: Passage { distance: distance / all, normal },
        sigma: (alone + (1.0 - alone) * SHARED).sqrt(),
    }
}
