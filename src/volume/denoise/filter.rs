//! One filter with its numbers for one volume.

use super::bilateral::{self, Bilateral};
use super::gaussian::{self, gaussian};
use super::kernel::reach;
use super::mean::mean;
use super::median::Median;
use super::nlm::NonLocalMeans;
use super::options::{Denoise, DenoiseError, MAX_REACH};
use super::separable::Separable;
use crate::execution::{Cancelled, Execution};
use crate::grid::Geometry;
use crate::volume::Slab;

/// A filter made for the spacing of a volume.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Filter {
    Separable(Separable),
    Median(Median),
    Bilateral(Bilateral),
    NonLocalMeans(NonLocalMeans),
}

impl Filter {
    /// Refuses parameters that make no sense, or none in a volume of this spacing. A grey parameter that is
    /// not given is taken to be 1.
    pub(super) fn new(denoise: &Denoise, geometry: &Geometry) -> Result<Self, DenoiseError> {
        denoise.check_numbers()?;
        let spacing = geometry.spacing();
        let (parameter, lengths) = match *denoise {
            Denoise::Mean { radius } | Denoise::Median { radius } => ("radius", vec![radius.mm(geometry)]),
            Denoise::Gaussian { sigma } => ("sigma", vec![gaussian::CUT * sigma.mm(geometry)]),
            Denoise::Bilateral { sigma, .. } => ("sigma", vec![bilateral::CUT * sigma.mm(geometry)]),
            Denoise::Nlm { search, patch, .. } => ("search", vec![search.mm(geometry), patch.mm(geometry)]),
        };
        let filter = denoise.name();
        let farthest = |length: &f64| reach(*length, spacing).into_iter().fold(0.0, f64::max);
        let all: f64 = lengths.iter().map(farthest).sum();
        if all > MAX_REACH as f64 {
            return Err(DenoiseError::Reach { filter, parameter, reach: all, spacing });
        }
        if farthest(&lengths[0]) < 1.0 {
            return Err(DenoiseError::Idle { filter, parameter, spacing });
        }
        Ok(match *denoise {
            Denoise::Mean { radius } => Self::Separable(mean(radius.mm(geometry), spacing)),
            Denoise::Gaussian { sigma } => Self::Separable(gaussian(sigma.mm(geometry), spacing)),
            Denoise::Median { radius } => Self::Median(Median::new(radius.mm(geometry), spacing)),
            Denoise::Bilateral { sigma, grey } => {
                Self::Bilateral(Bilateral::new(sigma.mm(geometry), grey.unwrap_or(1.0), spacing))
            }
            Denoise::Nlm { search, patch, grey } => {
                let (search, patch) = (search.mm(geometry), patch.mm(geometry));
                Self::NonLocalMeans(NonLocalMeans::new(search, patch, grey.unwrap_or(1.0), spacing))
            }
        })
    }

    /// Voxels along each axis on which a filtered value may depend, on each side.
    pub(super) fn reach(&self) -> [usize; 3] {
        let farthest = |offsets: &mut dyn Iterator<Item = [isize; 3]>| {
            offsets.fold([0; 3], |far: [usize; 3], o| [0, 1, 2].map(|a| far[a].max(o[a].unsigned_abs())))
        };
        match self {
            Self::Separable(filter) => filter.reach(),
            Self::Median(filter) => farthest(&mut filter.offsets()),
            Self::Bilateral(filter) => farthest(&mut filter.offsets()),
            Self::NonLocalMeans(filter) => filter.reach(),
        }
    }

    /// Whole copies of what it is given that the filter makes.
    pub(super) fn copies(&self) -> u64 {
        u64::from(matches!(self, Self::NonLocalMeans(_)))
    }

    /// Filters the slices from `first` on into `out`, which is whole slices. The slab must hold those, and
    /// all slices within reach of them that exist.
    pub(super) fn apply(
        &self,
        slab: Slab<'_, f32>,
        first: usize,
        out: &mut [f32],
        execution: &Execution,
    ) -> Result<(), Cancelled> {
        match self {
            Self::Separable(filter) => filter.apply(slab, first, out, execution),
            Self::Median(filter) => filter.apply(slab, first, out, execution),
            Self::Bilateral(filter) => filter.apply(slab, first, out, execution),
            Self::NonLocalMeans(filter) => filter.apply(slab, first, out, execution),
        }
    }
}
