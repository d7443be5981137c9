//! `interfacet info`: what a volume holds.

use std::io::Write;
use std::process::ExitCode;

use anyhow::Result;
use serde::Serialize;

use super::input::InputArgs;
use crate::execution::Execution;
use crate::grid::Geometry;
use crate::material::{Blur, EdgeProfile, Found, GreyCounts, Noise, ScanQuality, Survey};
use crate::volume::{Sample, SampleType, SampleWindow, VolumeSource};
use crate::with_sample_type;

const EXAMPLES: &str = "\
Examples:
  interfacet info part.mha
  interfacet info slices/ --spacing 0.092 --roi 100:300,100:300,:
  interfacet info part.raw --size 512,512,300 --type u16 --json
";

/// Arguments of `interfacet info`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(flatten)]
    input: InputArgs,

    /// Print JSON, for programs.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args, execution: &Execution) -> Result<ExitCode> {
    let source = args.input.open()?;
    let stage = execution.stage("looking at grey values", 0);
    let (grey, materials) =
        with_sample_type!(source.sample_type(), S => look::<S>(source.as_ref(), execution))?;
    drop(stage);
    execution.check()?;
    let info = Info::new(args.input.input.display().to_string(), source.as_ref(), grey, materials);
    let mut out = Vec::new();
    if args.json {
        serde_json::to_writer_pretty(&mut out, &info)?;
        writeln!(out)?;
    } else {
        print(&mut out, &info, columns_of_terminal())?;
        info.materials.print(&mut out)?;
    }
    match std::io::stdout().lock().write_all(&out) {
        // Whoever reads has seen enough: `interfacet info ... | head`.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => {}
        result => result?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Looks at a volume slab by slab, in a few passes.
fn look<S: Sample>(source: &dyn VolumeSource, execution: &Execution) -> Result<(Grey, Materials)> {
    /// Bytes of a slab: small beside what a survey keeps. Less than four of them are held at once, so that
    /// a stream need not be decompressed again.
    const SLAB: usize = 1 << 24;
    let geometry = source.geometry();
    let [width, height, depth] = geometry.size();
    let slice = width * height * size_of::<S>();
    let thickness = if slice <= 4 * SLAB / depth { depth } else { SLAB / slice };
    let mut window = SampleWindow::<S>::new(source, execution)?;
    let survey = Survey::read(&mut window, None, thickness)?;
    let grey = Grey::new(survey.counts());
    let materials = match survey.find_materials(None) {
        Ok(materials) => {
            drop(survey);
            let quality = ScanQuality::read(&mut window, geometry, &materials.table, thickness)?;
            Materials::Found {
                materials: Box::new(materials),
                blur: Box::new(quality.blur),
                edge_profile: quality.profile.map(Box::new),
                local_noise: quality.noise,
            }
        }
        Err(error) => Materials::NotFound { reason: error.to_string() },
    };
    Ok((grey, materials))
}

/// The materials that an extraction would find, or why it would find none.
#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
enum Materials {
    Found {
        materials: Box<Found>,
        blur: Box<Blur>,
        edge_profile: Option<Box<EdgeProfile>>,
        local_noise: Vec<Option<Noise>>,
    },
    NotFound {
        reason: String,
    },
}

impl Materials {
    fn print(&self, out: &mut impl Write) -> std::io::Result<()> {
        let (found, blur, profile, local_noise) = match self {
            Self::NotFound { reason } => return writeln!(out, "\nno materials: {reason}"),
            Self::Found { materials, blur, edge_profile, local_noise } => {
                (materials, blur, edge_profile, local_noise)
            }
        };
        writeln!(
            out,
            "\nmaterials that `interfacet extract` would use (it lowers R where thin parts would be lost):"
        )?;
        writeln!(out, "  id  name              mean grey      noise")?;
        for m in found.table.materials() {
            let noise = m.sigma.map_or_else(|| "-".into(), |s| format!("{s:.4}"));
            writeln!(out, "  {:>2}  {:<16} {:>10.4} {noise:>10}", m.id.0, m.name, m.mean)?;
        }
        for (m, noise) in found.table.materials().iter().zip(local_noise) {
            let Some(Noise { sigma, correlation: [x, y, z], effective, .. }) = noise else { continue };
            writeln!(
                out,
                "  noise of {} without drift: {sigma:.4}, correlated over {x:.2} x {y:.2} x {z:.2} voxels (times {effective:.1} in a mean)",
                m.name
            )?;
        }
        for mode in &found.rejected {
            let share = 100.0 * mode.inside_share;
            writeln!(out, "  not taken: grey {:.4}, {} ({share:.1} %)", mode.grey, mode.reason)?;
        }
        let [x, y, z] = blur.radius;
        match blur.sigma_mm {
            Some(s) => {
                writeln!(out, "blur: sigma {s:.4} mm, radius R {x:.2} x {y:.2} x {z:.2} voxels")?;
                let [x, y, z] = blur.sigma_axes_mm.unwrap_or([s; 3]);
                write!(out, "      sigma {x:.4} x {y:.4} x {z:.4} mm along the axes")?;
                let axes: String =
                    ["x", "y", "z"].into_iter().zip(blur.isotropic).filter(|a| a.1).map(|a| a.0).collect();
                if !axes.is_empty() {
                    write!(out, " (along {axes} not measured: too few interfaces face it)")?;
                }
                match profile {
                    Some(p) => writeln!(
                        out,
                        "; an error function fits to {:.2} % of the contrast",
                        100.0 * p.residual
                    ),
                    None => writeln!(out),
                }
            }
            None => writeln!(
                out,
                "blur: too few clean interfaces to measure, radius R {x:.2} x {y:.2} x {z:.2} voxels taken"
            ),
        }
    }
}

/// Everything that is shown.
#[derive(Debug, Serialize)]
struct Info {
    input: String,
    size: [usize; 3],
    voxels: usize,
    bytes: usize,
    sample_type: SampleType,
    spacing_mm: [f64; 3],
    origin_mm: [f64; 3],
    /// World directions of the x, y and z axes.
    direction: [[f64; 3]; 3],
    /// From border to border of the outermost voxels, along the index axes.
    extent_mm: [f64; 3],
    notes: Vec<String>,
    grey: Grey,
    materials: Materials,
}

impl Info {
    fn new(input: String, source: &dyn VolumeSource, grey: Grey, materials: Materials) -> Self {
        let geometry: &Geometry = source.geometry();
        let (size, spacing) = (geometry.size(), geometry.spacing());
        Self {
            input,
            size,
            voxels: geometry.voxels(),
            bytes: geometry.voxels() * source.sample_type().bytes(),
            sample_type: source.sample_type(),
            spacing_mm: spacing,
            origin_mm: geometry.origin(),
            direction: geometry.direction(),
            extent_mm: std::array::from_fn(|a| size[a] as f64 * spacing[a]),
            notes: source.notes(),
            grey,
            materials,
        }
    }
}

/// Statistics of the grey values.
#[derive(Debug, Serialize)]
struct Grey {
    min: f64,
    max: f64,
    mean: f64,
    standard_deviation: f64,
    percentile_1: f64,
    percentile_50: f64,
    percentile_99: f64,
    /// Voxels in each of equally wide bins from `min` to `max`.
    histogram: Vec<u64>,
}

impl Grey {
    /// Bins of the histogram that is kept.
    const BINS: usize = 256;

    /// Exact for integers; percentiles are good to 1/65536 of the range for others.
    fn new(counts: &GreyCounts) -> Self {
        let total = counts.total();
        let percentile = |percent: f64| {
            // The smallest value that at least this share of the voxels does not exceed.
            let rank = ((percent / 100.0 * total as f64).ceil() as u64).max(1);
            let mut below = 0;
            let at = counts.iter().find(|(_, count)| {
                below += count;
                below >= rank
            });
            at.map_or(f64::from(counts.high), |(value, _)| value)
        };
        let values = counts.iter().count();
        let mut histogram = vec![0; Self::BINS.min(values)];
        let bins = histogram.len();
        for (i, (_, count)) in counts.iter().enumerate() {
            histogram[i * bins / values] += count;
        }
        let (mean, standard_deviation) = counts.mean_and_deviation();
        Self {
            min: counts.low.into(),
            max: counts.high.into(),
            mean,
            standard_deviation,
            percentile_1: percentile(1.0),
            percentile_50: percentile(50.0),
            percentile_99: percentile(99.0),
            histogram,
        }
    }
}

fn columns_of_terminal() -> usize {
    terminal_size::terminal_size().map_or(80, |(width, _)| usize::from(width.0))
}

fn print(out: &mut impl Write, info: &Info, columns: usize) -> std::io::Result<()> {
    let by = |v: [f64; 3]| format!("{} x {} x {}", short(v[0]), short(v[1]), short(v[2]));
    let vector = |v: [f64; 3]| format!("({}, {}, {})", short(v[0]), short(v[1]), short(v[2]));
    let [x, y, z] = info.size;
    writeln!(out, "{}", info.input)?;
    writeln!(out, "  size       {x} x {y} x {z} = {} voxels", grouped(info.voxels))?;
    writeln!(out, "  samples    {}, {}", info.sample_type, bytes(info.bytes))?;
    writeln!(out, "  spacing    {} mm", by(info.spacing_mm))?;
    writeln!(out, "  extent     {} mm", by(info.extent_mm))?;
    writeln!(out, "  origin     {} mm", vector(info.origin_mm))?;
    let [dx, dy, dz] = info.direction.map(vector);
    writeln!(out, "  direction  x {dx}  y {dy}  z {dz}")?;
    let grey = &info.grey;
    writeln!(out, "  grey       {} to {}", short(grey.min), short(grey.max))?;
    writeln!(
        out,
        "             mean {}, standard deviation {}",
        short(grey.mean),
        short(grey.standard_deviation)
    )?;
    writeln!(
        out,
        "             percentiles 1 %: {}, 50 %: {}, 99 %: {}",
        short(grey.percentile_1),
        short(grey.percentile_50),
        short(grey.percentile_99)
    )?;
    for note in &info.notes {
        writeln!(out, "  note       {note}")?;
    }
    writeln!(out)?;
    draw_histogram(out, grey, columns)
}

/// Bars with a logarithmic scale: materials of a thousandth of the volume stay visible.
fn draw_histogram(out: &mut impl Write, grey: &Grey, columns: usize) -> std::io::Result<()> {
    const ROWS: usize = 14;
    const PARTS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    const LABEL: usize = 10;
    let width = columns.saturating_sub(LABEL + 2).clamp(20, 76).min(grey.histogram.len().max(20));
    let bins = grey.histogram.len();
    // The height of a bar is that of the highest bin under it, so that no peak is diluted.
    let bar = |x: usize| {
        let range = x * bins / width..((x + 1) * bins / width).max(x * bins / width + 1);
        grey.histogram[range.start..range.end.min(bins)].iter().copied().max().unwrap_or(0)
    };
    let bars: Vec<u64> = (0..width).map(bar).collect();
    let top = bars.iter().copied().max().unwrap_or(1).max(1);
    let decades = ((top as f64).log10()).max(1.0);
    // One voxel is an eighth of a row high, so that it can be told from none.
    let eighths = |count: u64| match count {
        0 => 0,
        _ => 1 + ((count as f64).log10() / decades * (ROWS * 8 - 1) as f64).round() as usize,
    };
    writeln!(out, "  voxels per grey value bin (logarithmic)")?;
    for row in (0..ROWS).rev() {
        // A label where a power of ten begins within the row.
        let level = |r: usize| r as f64 * 8.0 / (ROWS * 8 - 1) as f64 * decades;
        let power = level(row).ceil();
        let label = if power < level(row + 1) { count_label(power as i32) } else { String::new() };
        let line: String = bars.iter().map(|&c| PARTS[eighths(c).saturating_sub(row * 8).min(8)]).collect();
        writeln!(out, "{label:>LABEL$} │{}", line.trim_end())?;
    }
    writeln!(out, "{:>LABEL$} └{}", "", "─".repeat(width))?;
    let (left, middle, right) = (short(grey.min), short(0.5 * (grey.min + grey.max)), short(grey.max));
    let gap = width.saturating_sub(left.chars().count() + right.chars().count());
    writeln!(out, "{:>LABEL$}  {left}{middle:^gap$}{right}", "")
}

fn count_label(power: i32) -> String {
    match power {
        0..=5 => 10_u64.pow(power as u32).to_string(),
        _ => format!("1e{power}"),
    }
}

/// A number to six significant digits, without needless zeros.
fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let magnitude = value.abs().log10().floor();
    if !(-5.0..9.0).contains(&magnitude) {
        return format!("{value:.5e}");
    }
    let decimals = (5.0 - magnitude).max(0.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// A whole number with blanks between the thousands.
fn grouped(value: usize) -> String {
    let digits = value.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

fn bytes(value: usize) -> String {
    match value as f64 {
        v if v >= 1e9 => format!("{:.2} GB", v / 1e9),
        v if v >= 1e6 => format!("{:.1} MB", v / 1e6),
        v if v >= 1e3 => format!("{:.1} kB", v / 1e3),
        v => format!("{v} bytes"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Samples, Slab};

    fn measure(samples: Samples) -> Grey {
        let size = [samples.len(), 1, 1];
        crate::with_samples!(&samples, values => {
            Grey::new(Survey::of(Slab::whole(values, size), None).unwrap().counts())
        })
    }

    #[test]
    fn statistics_of_integers_are_exact() {
        let grey = measure(Samples::I16(vec![-100, 0, 0, 300]));
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        close(grey.min, -100.0);
        close(grey.max, 300.0);
        close(grey.mean, 50.0);
        close(grey.standard_deviation, 22500.0_f64.sqrt());
        close(grey.percentile_50, 0.0);
        close(grey.percentile_99, 300.0);
        assert_eq!(grey.histogram.len(), 256);
        assert_eq!(grey.histogram.iter().sum::<u64>(), 4);
    }

    #[test]
    fn statistics_of_floats_survive_a_far_offset_and_a_constant_volume() {
        let far = measure(Samples::F32((0..1000).map(|i| 1e6 + i as f32).collect()));
        assert!((far.mean - 1_000_499.5).abs() < 1e-6);
        assert!((far.standard_deviation - (999_999.0_f64 / 12.0).sqrt()).abs() < 1e-6);
        assert!((far.percentile_50 - 1_000_499.0).abs() < 0.02);
        let constant = measure(Samples::F32(vec![7.5; 10]));
        assert!((constant.mean - 7.5).abs() < 1e-9 && constant.standard_deviation < 1e-9);
        assert!((constant.percentile_99 - 7.5).abs() < 1e-9);
    }

    #[test]
    fn the_histogram_fits_the_terminal_and_shows_rare_values() {
        let mut values = vec![10_u8; 30_000];
        values.extend([200, 255]);
        let grey = measure(Samples::U8(values));
        for columns in [10, 40, 80, 500] {
            let mut out = Vec::new();
            draw_histogram(&mut out, &grey, columns).unwrap();
            let text = String::from_utf8(out).unwrap();
            assert!(text.lines().all(|line| line.chars().count() <= columns.clamp(45, 90)), "{text}");
            let bottom = text.lines().rev().nth(2).unwrap();
            assert_eq!(bottom.matches(['▁', '█']).count(), 3, "{text}");
        }
    }

    #[test]
    fn numbers_are_short_and_right() {
        for (value, text) in
            [(0.0, "0"), (0.092, "0.092"), (-12.5, "-12.5"), (123_456.78, "123457"), (1e-7, "1.00000e-7")]
        {
            assert_eq!(short(value), text);
        }
        assert_eq!(grouped(1_234_567), "1 234 567");
    }
}
