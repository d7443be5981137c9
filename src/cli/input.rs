//! The volume a command works on: which file or folder, and what the file cannot say itself.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Result;
use clap::ValueEnum;

use crate::grid::VoxelBox;
use crate::volume::{Endian, OpenOptions, RawLayout, RegionOfInterest, SampleType, VolumeSource, open};

/// The input volume; flattened into the arguments of every command that reads one.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct InputArgs {
    /// Volume: MetaImage (.mha, .mhd), NRRD (.nrrd, .nhdr), multi-page TIFF, a folder of numbered
    /// TIFF slices, or headerless samples with --size and --type.
    #[arg(value_name = "INPUT")]
    pub(crate) input: PathBuf,

    /// Voxel spacing in mm: three numbers, or one for all axes. Replaces the spacing in the file.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_spacing, allow_negative_numbers = true, help_heading = "Input")]
    pub(crate) spacing: Option<Triple<f64>>,

    /// Read this part only, in voxels: the first and one past the last of each axis. A missing
    /// number means the volume's border, so `10:,:,0:50` is good.
    #[arg(long, value_name = "X0:X1,Y0:Y1,Z0:Z1", help_heading = "Input")]
    pub(crate) roi: Option<Region>,

    /// Headerless samples: number of voxels along x, y and z (x is fastest in the file).
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_size, requires = "sample_type", help_heading = "Headerless input")]
    pub(crate) size: Option<Triple<usize>>,

    /// Headerless samples: their number type.
    #[arg(long = "type", value_name = "TYPE", requires = "size", help_heading = "Headerless input")]
    pub(crate) sample_type: Option<TypeName>,

    /// Headerless samples: their byte order [default: little]
    #[arg(long, value_name = "ORDER", requires = "size", help_heading = "Headerless input")]
    pub(crate) endian: Option<EndianName>,

    /// Headerless samples: bytes to skip at the file's start [default: 0]
    #[arg(long, value_name = "BYTES", requires = "size", help_heading = "Headerless input")]
    pub(crate) offset: Option<u64>,
}

impl InputArgs {
    /// What the arguments say, as the library's options.
    pub(crate) fn options(&self) -> OpenOptions {
        let raw = self.size.zip(self.sample_type).map(|(size, sample_type)| RawLayout {
            size: size.0,
            sample_type: sample_type.into(),
            endian: self.endian.map_or(Endian::Little, Into::into),
            offset: self.offset.unwrap_or(0),
        });
        OpenOptions { raw, spacing: self.spacing.map(|spacing| spacing.0) }
    }

    /// Opens the volume, cut to the region of interest.
    ///
    /// # Errors
    /// Whatever is wrong with the file or the arguments.
    pub(crate) fn open(&self) -> Result<Box<dyn VolumeSource>> {
        let source = open(&self.input, &self.options())?;
        Ok(match &self.roi {
            None => source,
            Some(region) => {
                let part = region.within(source.geometry().size());
                Box::new(RegionOfInterest::new(source, part)?)
            }
        })
    }
}

/// Three values, one per axis; a type of its own since clap reads arrays as repeated arguments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Triple<T>(pub(crate) [T; 3]);

/// Number types by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum TypeName {
    /// 8-bit unsigned.
    U8,
    /// 16-bit unsigned.
    U16,
    /// 16-bit signed.
    I16,
    /// 32-bit floating point.
    F32,
}

impl From<TypeName> for SampleType {
    fn from(name: TypeName) -> Self {
        match name {
            TypeName::U8 => Self::U8,
            TypeName::U16 => Self::U16,
            TypeName::I16 => Self::I16,
            TypeName::F32 => Self::F32,
        }
    }
}

/// Byte orders by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum EndianName {
    /// Least significant byte first.
    Little,
    /// Most significant byte first.
    Big,
}

impl From<EndianName> for Endian {
    fn from(name: EndianName) -> Self {
        match name {
            EndianName::Little => Self::Little,
            EndianName::Big => Self::Big,
        }
    }
}

/// A box of voxels whose bounds may be left open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Region {
    low: [Option<u32>; 3],
    high: [Option<u32>; 3],
}

impl Region {
    /// The box in a volume of `size` voxels; it may reach beyond it.
    fn within(&self, size: [usize; 3]) -> VoxelBox {
        VoxelBox {
            low: self.low.map(|v| v.map_or(0, |v| v as usize)),
            high: std::array::from_fn(|a| self.high[a].map_or(size[a], |v| v as usize)),
        }
    }
}

impl FromStr for Region {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "three ranges FIRST:END separated by commas are needed, such as 0:100,20:80,:";
        let ranges: Vec<&str> = text.split(',').collect();
        let [x, y, z] = ranges[..] else {
            return Err(format!("{} range(s) given, but {expected}", ranges.len()));
        };
        let mut region = Self { low: [None; 3], high: [None; 3] };
        for (a, range) in [x, y, z].into_iter().enumerate() {
            let (low, high) = range.split_once(':').ok_or(format!("`{range}` is no range; {expected}"))?;
            let bound = |text: &str| match text.trim() {
                "" => Ok(None),
                text => text
                    .parse()
                    .map(Some)
                    .map_err(|_| format!("`{text}` in `{range}` is not a voxel number (0 or more)")),
            };
            region.low[a] = bound(low)?;
            region.high[a] = bound(high)?;
            if let Some(high) = region.high[a]
                && high <= region.low[a].unwrap_or(0)
            {
                return Err(format!("the range `{range}` is empty: the end is one past the last voxel"));
            }
        }
        Ok(region)
    }
}

fn parse_size(text: &str) -> Result<Triple<usize>, String> {
    let values: Vec<&str> = text.split(',').map(str::trim).collect();
    let [x, y, z] = values[..] else {
        return Err(format!("{} value(s) given, but three are needed, such as 512,512,300", values.len()));
    };
    let axis = |text: &str| match text.parse() {
        Ok(n) if n > 0 => Ok(n),
        _ => Err(format!("`{text}` is not a number of voxels (1 or more)")),
    };
    Ok(Triple([axis(x)?, axis(y)?, axis(z)?]))
}

fn parse_spacing(text: &str) -> Result<Triple<f64>, String> {
    let axis = |text: &str| match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err(format!("`{text}` is not a positive number of millimetres")),
    };
    let values: Vec<&str> = text.split(',').map(str::trim).collect();
    match values[..] {
        [all] => axis(all).map(|v| Triple([v; 3])),
        [x, y, z] => Ok(Triple([axis(x)?, axis(y)?, axis(z)?])),
        _ => Err(format!(
            "{} values given, but one or three are needed, such as 0.1 or 0.1,0.1,0.25",
            values.len()
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        input: InputArgs,
    }

    fn parse(arguments: &str) -> Result<InputArgs, String> {
        Command::try_parse_from(std::iter::once("test").chain(arguments.split(' ')))
            .map(|c| c.input)
            .map_err(|e| e.to_string())
    }

    #[test]
    fn headerless_samples_are_described_by_size_type_order_and_offset() {
        let options =
            parse("a.raw --size 4,5,6 --type i16 --endian big --offset 7 --spacing 0.5").unwrap().options();
        let raw = RawLayout { size: [4, 5, 6], sample_type: SampleType::I16, endian: Endian::Big, offset: 7 };
        assert_eq!(options, OpenOptions { raw: Some(raw), spacing: Some([0.5; 3]) });
        assert_eq!(parse("a.mha --spacing 0.1,0.2,3").unwrap().options().spacing, Some([0.1, 0.2, 3.0]));
    }

    #[test]
    fn half_a_description_is_refused() {
        assert!(parse("a.raw --size 4,5,6").unwrap_err().contains("--type"));
        assert!(parse("a.raw --type u8").unwrap_err().contains("--size"));
        assert!(parse("a.raw --endian big").unwrap_err().contains("--size"));
        assert!(parse("a.raw --offset 3").unwrap_err().contains("--size"));
    }

    #[test]
    fn open_ends_of_a_region_mean_the_border() {
        let region = parse("a.mha --roi 3:,:,2:5").unwrap().roi.unwrap();
        assert_eq!(region.within([10, 20, 30]), VoxelBox { low: [3, 0, 2], high: [10, 20, 5] });
    }

    #[test]
    fn messages_name_the_value_and_say_what_is_right() {
        for (arguments, part) in [
            ("a --roi 1:2,3:4", "2 range(s) given, but three ranges"),
            ("a --roi 1:2,3:4,5", "`5` is no range"),
            ("a --roi 1:2,3:x,5:6", "`x` in `3:x` is not a voxel number"),
            ("a --roi 1:2,4:4,5:6", "the range `4:4` is empty"),
            ("a --size 4,5 --type u8", "2 value(s) given"),
            ("a --size 4,0,6 --type u8", "`0` is not a number of voxels"),
            ("a --size 4,5,6 --type u32", "u32"),
            ("a --spacing 0", "`0` is not a positive number"),
            ("a --spacing 1,2", "2 values given"),
            ("a --spacing 1,nan,1", "`nan` is not a positive number"),
        ] {
            let message = parse(arguments).unwrap_err();
            assert!(message.contains(part), "{arguments}: {message}");
        }
    }
}
