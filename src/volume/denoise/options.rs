//! What a user says of a filter: which one, how far it reaches, what difference of grey it bridges.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::filter::Filter;
use crate::grid::Geometry;

/// Voxels along an axis that a filter may reach on each side: 33 slices are held for one that is made.
pub const MAX_REACH: usize = 16;

/// A length, in millimetres or in voxels of mean edge length.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Length {
    /// In voxels of mean edge length (the cube root of a voxel's volume).
    Voxels(f64),
    /// In millimetres.
    Mm(f64),
}

impl Length {
    /// The length in millimetres.
    #[must_use]
    pub fn mm(self, geometry: &Geometry) -> f64 {
        match self {
            Self::Voxels(n) => n * geometry.voxel_edge(),
            Self::Mm(mm) => mm,
        }
    }

    fn value(self) -> f64 {
        let (Self::Voxels(value) | Self::Mm(value)) = self;
        value
    }
}

/// A filter that takes noise out of a volume; lengths hold in the world, so that it reaches fewer voxels
/// along an axis of wide spacing. At the volume's border all filters make do with the voxels that exist.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "filter", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Denoise {
    /// The mean of a box. Takes out most noise for its reach, and blurs edges.
    Mean {
        /// Half the edge of the box: voxels whose centres are no farther along any axis count.
        #[serde(default = "one_voxel")]
        radius: Length,
    },
    /// A mean weighted by a Gaussian, cut off at three sigma. Blurs edges; known exactly.
    Gaussian {
        /// Its standard deviation.
        #[serde(default = "one_voxel")]
        sigma: Length,
    },
    /// The median of a ball. Keeps flat edges, takes out specks; rounds corners and loses thin parts.
    Median {
        /// The ball's radius: voxels whose centres are no farther count.
        #[serde(default = "ball_of_19")]
        radius: Length,
    },
    /// A mean weighted by distance and by difference of grey (Tomasi and Manduchi 1998). Keeps edges.
    Bilateral {
        /// Standard deviation of the Gaussian of the distance, which is cut off at 2.5 sigma.
        #[serde(default = "one_voxel")]
        sigma: Length,
        /// Standard deviation of the Gaussian of the difference, in grey values. `None`:
        /// [`BILATERAL_GREY`] times the noise found.
        #[serde(default)]
        grey: Option<f64>,
    },
    /// Non-local means (Buades, Coll and Morel 2005): a mean weighted by how alike the surroundings are.
    /// Keeps edges and texture; the slowest.
    Nlm {
        /// Radius of the ball in which like places are looked for.
        #[serde(default = "three_voxels")]
        search: Length,
        /// Half the edge of the box that is compared.
        #[serde(default = "one_voxel")]
        patch: Length,
        /// The root mean square difference of two boxes at which the weight has fallen to 1/e, in grey
        /// values. `None`: [`NLM_GREY`] times the noise found.
        #[serde(default)]
        grey: Option<f64>,
    },
}

/// Default of a bilateral filter's grey parameter, in standard deviations of the noise. (Zhang and Gunturk
/// 2008 find 2 to 3 best for a wide range of noise.)
pub const BILATERAL_GREY: f64 = 3.0;

/// Default of the grey parameter of non-local means, in standard deviations of the noise. Boxes that differ
/// by noise only are the square root of 2 apart.
pub const NLM_GREY: f64 = 1.5;

fn one_voxel() -> Length {
    Length::Voxels(1.0)
}

fn ball_of_19() -> Length {
    Length::Voxels(1.5)
}

fn three_voxels() -> Length {
    Length::Voxels(3.0)
}

/// Why the parameters of a filter are refused.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum DenoiseError {
    /// A length that is none.
    #[error(
        "the {parameter} {value} of the {filter} filter is not usable: it must be a number above 0, in voxels or, as `0.05mm`, in millimetres"
    )]
    Length {
        /// The filter.
        filter: &'static str,
        /// The parameter.
        parameter: &'static str,
        /// As given.
        value: f64,
    },
    /// A grey value that is none.
    #[error(
        "the grey {value} of the {filter} filter is not usable: it must be a number above 0, in grey values; leave it out to have it taken from the noise"
    )]
    Grey {
        /// The filter.
        filter: &'static str,
        /// As given.
        value: f64,
    },
    /// A filter that reaches too far.
    #[error(
        "the {filter} filter would reach {reach:.0} voxels along an axis (spacing {spacing:?} mm), but {MAX_REACH} is the most: give a smaller {parameter}"
    )]
    Reach {
        /// The filter.
        filter: &'static str,
        /// The parameter to lower.
        parameter: &'static str,
        /// Voxels along the axis of the smallest spacing.
        reach: f64,
        /// Spacing of the volume in mm.
        spacing: [f64; 3],
    },
    /// A filter that reaches no other voxel.
    #[error(
        "the {filter} filter would reach no other voxel (spacing {spacing:?} mm) and change nothing: give a larger {parameter}"
    )]
    Idle {
        /// The filter.
        filter: &'static str,
        /// The parameter to raise.
        parameter: &'static str,
        /// Spacing of the volume in mm.
        spacing: [f64; 3],
    },
}

impl Denoise {
    /// The filter's name.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Mean { .. } => "mean",
            Self::Gaussian { .. } => "gaussian",
            Self::Median { .. } => "median",
            Self::Bilateral { .. } => "bilateral",
            Self::Nlm { .. } => "nlm",
        }
    }

    /// Whether the filter makes sense in a volume of this geometry.
    ///
    /// # Errors
    /// [`DenoiseError`] says what is wrong with which parameter.
    pub fn check(&self, geometry: &Geometry) -> Result<(), DenoiseError> {
        Filter::new(self, geometry).map(drop)
    }

    /// The same filter with its grey parameter, if it has one that was not given, chosen for noise of
    /// standard deviation `noise` (above 0).
    #[must_use]
    pub fn with_noise(mut self, noise: f64) -> Self {
        match &mut self {
            Self::Bilateral { grey: grey @ None, .. } => *grey = Some(BILATERAL_GREY * noise),
            Self::Nlm { grey: grey @ None, .. } => *grey = Some(NLM_GREY * noise),
            _ => {}
        }
        self
    }

    /// The lengths by name, and the grey parameter.
    pub(super) fn parameters(&mut self) -> (Vec<(&'static str, &mut Length)>, Option<&mut Option<f64>>) {
        match self {
            Self::Mean { radius } | Self::Median { radius } => (vec![("radius", radius)], None),
            Self::Gaussian { sigma } => (vec![("sigma", sigma)], None),
            Self::Bilateral { sigma, grey } => (vec![("sigma", sigma)], Some(grey)),
            Self::Nlm { search, patch, grey } => (vec![("search", search), ("patch", patch)], Some(grey)),
        }
    }

    /// Refuses numbers that make no sense whatever the volume.
    pub(super) fn check_numbers(mut self) -> Result<(), DenoiseError> {
        let filter = self.name();
        let good = |value: f64| value.is_finite() && value > 0.0;
        let (lengths, grey) = self.parameters();
        for (parameter, length) in lengths {
            let value = length.value();
            if !good(value) {
                return Err(DenoiseError::Length { filter, parameter, value });
            }
        }
        match grey.and_then(|grey| *grey) {
            Some(value) if !good(value) => Err(DenoiseError::Grey { filter, value }),
            _ => Ok(()),
        }
    }
}

impl FromStr for Length {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (number, unit): (&str, fn(f64) -> Self) = match text.strip_suffix("mm") {
            Some(number) => (number, Self::Mm),
            None => (text, Self::Voxels),
        };
        let value = number.trim().parse();
        value
            .map(unit)
            .map_err(|_| format!("`{text}` is no length: a number of voxels such as 1.5, or 0.05mm"))
    }
}

impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Voxels(n) => write!(f, "{n}"),
            Self::Mm(mm) => write!(f, "{mm}mm"),
        }
    }
}

/// `FILTER` or `FILTER:NAME=VALUE,NAME=VALUE`.
impl FromStr for Denoise {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, parameters) = text.split_once(':').unwrap_or((text, ""));
        let mut out = match name.trim() {
            "mean" => Self::Mean { radius: one_voxel() },
            "gaussian" => Self::Gaussian { sigma: one_voxel() },
            "median" => Self::Median { radius: ball_of_19() },
            "bilateral" => Self::Bilateral { sigma: one_voxel(), grey: None },
            "nlm" => Self::Nlm { search: three_voxels(), patch: one_voxel(), grey: None },
            other => {
                return Err(format!(
                    "`{other}` is no filter: there are bilateral, mean, gaussian, median, nlm and none"
                ));
            }
        };
        for parameter in parameters.split(',').map(str::trim).filter(|p| !p.is_empty()) {
            out.set(parameter)?;
        }
        out.check_numbers().map_err(|error| error.to_string())?;
        Ok(out)
    }
}

impl Denoise {
    fn set(&mut self, parameter: &str) -> Result<(), String> {
        let filter = self.name();
        let (mut lengths, grey) = self.parameters();
        let names: Vec<&str> =
            lengths.iter().map(|(name, _)| *name).chain(grey.as_ref().map(|_| "grey")).collect();
        let expected = format!("the parameters of {filter} are {}, as NAME=VALUE", names.join(", "));
        let (name, value) =
            parameter.split_once('=').ok_or_else(|| format!("`{parameter}` has no `=`: {expected}"))?;
        let (name, value) = (name.trim(), value.trim());
        if let Some((_, length)) = lengths.iter_mut().find(|(known, _)| *known == name) {
            **length = value.parse()?;
        } else if let ("grey", Some(grey)) = (name, grey) {
            *grey = Some(value.parse().map_err(|_| format!("`{value}` is no difference of grey values"))?);
        } else {
            return Err(format!("`{name}` is unknown: {expected}"));
        }
        Ok(())
    }
}

/// In the form that is read.
impl fmt::Display for Denoise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut copy = *self;
        let (lengths, grey) = copy.parameters();
        let lengths = lengths.iter().map(|(name, length)| format!("{name}={length}"));
        let grey = grey.and_then(|grey| *grey).map(|grey| format!("grey={grey}"));
        write!(f, "{}:{}", self.name(), lengths.chain(grey).collect::<Vec<_>>().join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_is_its_name_and_parameters_in_units() {
        let parse = |text: &str| text.parse::<Denoise>().unwrap();
        assert_eq!(parse("bilateral"), Denoise::Bilateral { sigma: Length::Voxels(1.0), grey: None });
        let given = Denoise::Bilateral { sigma: Length::Mm(0.05), grey: Some(12.0) };
        assert_eq!(parse("bilateral:sigma=0.05mm, grey=12"), given);
        assert_eq!(parse("median:radius=2"), Denoise::Median { radius: Length::Voxels(2.0) });
        for text in ["mean", "gaussian", "median", "nlm:patch=2,search=0.3mm,grey=7", "bilateral:grey=3"] {
            assert_eq!(parse(&parse(text).to_string()), parse(text));
            let json = serde_json::to_string(&parse(text)).unwrap();
            assert_eq!(serde_json::from_str::<Denoise>(&json).unwrap(), parse(text), "{json}");
        }
        assert_eq!(serde_json::from_str::<Denoise>(r#"{"filter":"nlm"}"#).unwrap(), parse("nlm"));
    }

    #[test]
    fn nonsense_is_refused_by_name() {
        for (text, part) in [
            ("blur", "`blur` is no filter: there are bilateral"),
            ("mean:grey=3", "`grey` is unknown: the parameters of mean are radius"),
            ("bilateral:3", "`3` has no `=`"),
            ("bilateral:sigma=3cm", "`3cm` is no length"),
            ("bilateral:sigma=0", "the sigma 0 of the bilateral filter"),
            ("bilateral:grey=-1", "the grey -1 of the bilateral filter"),
            ("nlm:patch=nan", "the patch NaN of the nlm filter"),
            ("median:radius=infmm", "the radius inf of the median filter"),
            ("nlm:grey=x", "`x` is no difference"),
        ] {
            let error = text.parse::<Denoise>().unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
