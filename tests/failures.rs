//! Bad input and interruption, as a user of the command line meets them: the run fails with a
//! message that names value, limit and remedy, and leaves nothing behind; an earlier result stays.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // helpers of tests, like the tests themselves

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use interfacet::export::{StagedFolder, abandon_unfinished, write_atomically};
use tempfile::TempDir;
use tiff::encoder::{TiffEncoder, colortype::Gray8};

const BINARY: &str = env!("CARGO_BIN_EXE_interfacet");
const RAW: &str = "--size 24,24,24 --type u16";

/// Everything in a folder, with the contents of files.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let kind = fs::symlink_metadata(&path).unwrap().file_type();
        if kind.is_dir() {
            found.extend(contents(&path));
        }
        found.insert(path.clone(), if kind.is_file() { fs::read(&path).unwrap() } else { Vec::new() });
    }
    found
}

/// A folder with volumes to work in.
struct Work(TempDir);

impl Work {
    fn new() -> Self {
        let work = Self(tempfile::tempdir().unwrap());
        work.raw("good.raw", 24, |p| if radius(p, 24) < 8.0 { 40_000 } else { 4000 });
        work
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn write(&self, name: &str, parts: &[&[u8]]) {
        let path = self.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, parts.concat()).unwrap();
    }

    /// A cube of `n` voxels per side, u16, with a little noise.
    fn raw(&self, name: &str, n: usize, grey: impl Fn([usize; 3]) -> u16) {
        let mut bytes = Vec::with_capacity(2 * n * n * n);
        for i in 0..n * n * n {
            let noise = (i.wrapping_mul(2_654_435_761) >> 9 & 63) as u16;
            let value = grey([i % n, i / n % n, i / n / n]) + noise;
            bytes.extend(value.to_le_bytes());
        }
        self.write(name, &[&bytes]);
    }

    /// `interfacet extract`, into `out` unless the arguments say where.
    fn extract(&self, arguments: &str) -> std::process::Output {
        let mut command = assert_cmd::Command::new(BINARY);
        command.current_dir(self.path()).timeout(Duration::from_secs(120));
        command.arg("extract").args(arguments.split_whitespace());
        if !arguments.contains("--out") {
            command.args(["--out", "out"]);
        }
        command.output().unwrap()
    }

    /// Runs `extract`, which must fail with this exit code and a message that has these words, and
    /// change nothing in the folder. Returns the message.
    fn fails(&self, arguments: &str, code: i32, words: &[&str]) -> String {
        let before = contents(self.path());
        let output = self.extract(arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments}: {message}");
        assert_failure_reads_well(arguments, &message, words);
        assert!(output.stdout.is_empty(), "{arguments}");
        assert!(contents(self.path()) == before, "{arguments} left something behind or changed something");
        message
    }
}

fn radius(p: [usize; 3], n: usize) -> f64 {
    p.iter().map(|&x| (x as f64 - n as f64 / 2.0).powi(2)).sum::<f64>().sqrt()
}

fn assert_failure_reads_well(arguments: &str, message: &str, words: &[&str]) {
    assert!(message.starts_with("error: ") && !message.contains("panicked"), "{arguments}: {message}");
    for word in words {
        assert!(message.contains(word), "{arguments}: no '{word}' in: {message}");
    }
    assert!(message.matches("os error").count() < 2, "{arguments}: says it twice: {message}");
    // clap's own messages end with the usage and a pointer to --help.
    let ours = !message.contains("try '--help'");
    assert!(!ours || !message.trim_end().contains("\n\n"), "{arguments}: not one paragraph: {message}");
    assert!(!message.contains(".interfacet-"), "{arguments}: names a hidden file: {message}");
}

#[test]
fn the_volume_that_the_failures_are_made_of_is_good() {
    let work = Work::new();
    let output = work.extract(&format!("good.raw {RAW}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let names: Vec<_> = fs::read_dir(work.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names.len(), 2, "{names:?}");
}

#[test]
fn files_that_are_missing_cut_off_or_lie_are_refused() {
    let work = Work::new();
    work.fails("missing.mha", 1, &["missing.mha", "No such file", "check the path"]);
    work.fails("good.raw", 1, &["good.raw", "format is not known", "--size", "--type"]);
    let words = ["good.raw", "276480 bytes", "27648 are there", "cut off", "size or type is wrong"];
    work.fails("good.raw --size 24,24,240 --type u16", 1, &words);
    let header = |size: &str, spacing: &str| {
        format!(
            "ObjectType = Image\nNDims = 3\nDimSize = {size}\nElementSpacing = {spacing}\n\
             ElementType = MET_USHORT\nElementDataFile = good.raw\n"
        )
    };
    for (name, size, spacing) in [
        ("cut.mhd", "24 24 240", "1 1 1"),
        ("huge.mhd", "4294967296 4294967296 4294967296", "1 1 1"),
        ("zero.mhd", "24 24 24", "1 0 1"),
        ("negative.mhd", "24 24 24", "1 1 -0.5"),
        ("minute.mhd", "24 24 24", "1e-300 1 1"),
    ] {
        work.write(name, &[header(size, spacing).as_bytes()]);
    }
    work.fails("cut.mhd", 1, &["good.raw", "276480 bytes", "27648 are there", "cut off"]);
    work.fails("huge.mhd", 1, &["huge.mhd", "4294967296", "32768"]);
    work.fails("zero.mhd", 1, &["zero.mhd", "0", "positive"]);
    work.fails("negative.mhd", 1, &["negative.mhd", "-0.5", "positive"]);
    work.fails("minute.mhd", 1, &["minute.mhd", "1e-300", "1e-12", "--spacing"]);
    let nrrd = "NRRD0004\ntype: uint16\ndimension: 3\nsizes: 99999999999 99999999999 99999999999\n\
                encoding: raw\nendian: little\n\n";
    work.write("huge.nrrd", &[nrrd.as_bytes(), &[0; 64]]);
    work.fails("huge.nrrd", 1, &["huge.nrrd", "99999999999", "32768"]);
    let words = ["positive number of millimetres", "--spacing"];
    work.fails(&format!("good.raw {RAW} --spacing 0"), 2, &words);
    work.fails(&format!("good.raw {RAW} --spacing -1"), 2, &words);
    work.fails(&format!("good.raw {RAW} --spacing 1e300"), 1, &["1e300", "1e9", "--spacing"]);
}

#[test]
#[cfg(unix)]
fn a_pipe_is_refused_instead_of_waited_for() {
    let work = Work::new();
    assert!(Command::new("mkfifo").arg(work.path().join("pipe.raw")).status().unwrap().success());
    work.fails(&format!("pipe.raw {RAW}"), 1, &["pipe.raw", "no regular file", "save its content"]);
}

#[test]
fn grey_values_without_an_interface_are_refused() {
    let work = Work::new();
    for (name, bad) in [("nan", f32::NAN), ("infinity", f32::INFINITY)] {
        let mut values: Vec<f32> = (0..4096).map(|i| (i % 7) as f32).collect();
        values[16 * 16 * 3 + 16 * 2 + 5] = bad;
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        work.write(&format!("{name}.raw"), &[&bytes]);
        let words = ["1 samples are not finite", "[5, 2, 3]", "replace"];
        work.fails(&format!("{name}.raw --size 16,16,16 --type f32"), 1, &words);
    }
    work.write("constant.raw", &[&4000_u16.to_le_bytes().repeat(24 * 24 * 24)]);
    let words = ["same grey value 4000", "no interface", "check"];
    work.fails(&format!("constant.raw {RAW}"), 1, &words);
    work.fails(&format!("constant.raw {RAW} --labels"), 1, &["label 4000", "at least 2", "--labels"]);
    let words = ["'a'", "(1)", "4000", "Correct"];
    work.fails(&format!("constant.raw {RAW} --material a=1 --material b=2"), 1, &words);
    work.raw("noise.raw", 24, |_| 4000);
    work.fails(&format!("noise.raw {RAW}"), 1, &["only one material", "40", "two", "--count"]);
    // Told that there are two, we must not come back with an empty mesh.
    work.raw("speckle.raw", 24, |[x, y, z]| if (x + 7 * y + 53 * z) % 499 == 0 { 4400 } else { 4000 });
    let words = ["every voxel", "'air'", "no interface", "check"];
    work.fails(&format!("speckle.raw {RAW} --count 2"), 1, &words);
    work.raw("labels.raw", 24, |p| ((p[0] + 24 * p[1]) % 300) as u16);
    let words = ["more than 254", "merge", "--labels"];
    work.fails(&format!("labels.raw {RAW} --labels"), 1, &words);
}

#[test]
fn slices_that_make_no_volume_are_refused() {
    let work = Work::new();
    let slice = |name: &str, width: u32| {
        work.write(name, &[]);
        let file = fs::File::create(work.path().join(name)).unwrap();
        let pixels: Vec<u8> = (0..width * 8).map(|i| i as u8).collect();
        TiffEncoder::new(file).unwrap().write_image::<Gray8>(width, 8, &pixels).unwrap();
    };
    (1..=4).for_each(|i| slice(&format!("unequal/s{i:02}.tif"), if i == 3 { 9 } else { 8 }));
    work.fails("unequal", 1, &["s01.tif", "s03.tif", "8 x 8", "9 x 8", "must be alike"]);
    [7, 8, 10, 11].into_iter().for_each(|i| slice(&format!("gap/s{i:02}.tif"), 8));
    work.fails("gap", 1, &["slice number 9 is missing", "s08.tif", "s10.tif", "add it"]);
    fs::create_dir(work.path().join("empty")).unwrap();
    work.fails("empty", 1, &["empty", "no TIFF slices", "give a folder"]);
}

#[test]
fn materials_that_make_no_sense_are_refused() {
    let work = Work::new();
    for (materials, words) in [
        ("iron=40000 air=4000", &["'air' (4000)", "'iron' (40000)", "ascending"][..]),
        ("air=4000 iron=4000", &["'iron' (4000)", "'air' (4000)", "strictly ascending"]),
        ("air=4000 air=40000", &["'air'", "twice", "once"]),
        ("a/b=4000 c=40000", &["'a/b'", "file name", "letters"]),
        ("..=4000 c=40000", &["'..'", "file name", "letters"]),
        ("=4000 c=40000", &["''", "file name", "letters"]),
        ("air=nan iron=40000", &["'air'", "NaN", "finite"]),
        ("air=4000", &["1 material(s) given", "at least 2"]),
        (
            "air=4000 iron=40000 lead=90000",
            &["'lead' (90000)", "from 4000 to 40063", "leave the material out"],
        ),
        ("air=-90000 iron=40000", &["'air' (-90000)", "from 4000 to 40063", "Correct"]),
    ] {
        let options: Vec<_> = materials.split(' ').map(|m| format!("--material {m}")).collect();
        work.fails(&format!("good.raw {RAW} {}", options.join(" ")), 1, words);
    }
    let many: Vec<_> = (0..300).map(|i| format!("--material m{i}={i}")).collect();
    work.fails(&format!("good.raw {RAW} {}", many.join(" ")), 1, &["300 materials", "254", "merge"]);
    work.fails(&format!("good.raw {RAW} --material iron"), 2, &["'iron'", "NAME=GREY"]);
    work.fails(&format!("good.raw {RAW} --material iron=heavy"), 2, &["'heavy'", "not a number"]);
    work.write("key.toml", &[b"[[material]]\nname = \"air\"\ngrey = 1\ncolour = \"red\"\n"]);
    let words = ["key.toml", "line 4", "unknown field `colour`", "`name` or `grey`", "[[material]]"];
    work.fails(&format!("good.raw {RAW} --materials key.toml"), 1, &words);
    work.fails(
        &format!("good.raw {RAW} --materials no.toml"),
        1,
        &["materials file no.toml", "No such file"],
    );
}

#[test]
fn options_out_of_range_are_refused() {
    let work = Work::new();
    for (option, code, words) in [
        ("--radius 0", 1, &["[0.00, 0.00, 0.00]", "above 0", "16", "--radius"][..]),
        ("--radius -1", 1, &["[-1.00,", "above 0", "16", "--radius"]),
        ("--radius nan", 1, &["[NaN,", "above 0", "16", "--radius"]),
        ("--radius inf", 1, &["[inf,", "above 0", "16", "--radius"]),
        ("--radius 1000", 1, &["[1000.00,", "above 0", "16", "--radius"]),
        ("--radius 15", 1, &["[15.00,", "no voxel", "smaller --radius"]),
        ("--count 0", 1, &["0 material(s)", "2 to 64", "--count"]),
        ("--count 1", 1, &["1 material(s)", "2 to 64", "--count"]),
        ("--count 1000", 1, &["1000 material(s)", "2 to 64", "--material"]),
        ("--names air", 1, &["1 material(s)", "at least 2"]),
        ("--names air,iron,lead", 1, &["3 names", "2 materials found", "one name each"]),
        ("--names air,a/b", 1, &["'a/b'", "file name", "letters"]),
        ("--names air,air", 1, &["'air'", "twice", "once"]),
        ("--roi 0:25,:,:", 1, &["[25, 24, 24]", "not inside", "[24, 24, 24]"]),
        ("--roi 30:,:,:", 1, &["[30, 0, 0]", "not inside", "[24, 24, 24]"]),
        ("--roi 5:5,:,:", 2, &["`5:5`", "empty", "one past the last"]),
        ("--threads 0", 1, &["--threads 0", "between 1 and 1024", "leave it out"]),
        ("--threads 100000", 1, &["--threads 100000", "between 1 and 1024"]),
        ("--count 3 --labels", 2, &["--count", "--labels", "cannot be used"]),
        ("--iso 3 --labels", 2, &["--iso", "--labels", "cannot be used"]),
        ("--iso 3 --threshold otsu-mode", 2, &["--iso", "--threshold", "cannot be used"]),
        ("--threshold otsu-mode --count 2", 2, &["--threshold", "--count", "cannot be used"]),
        ("--threshold otsu-mode --material a=1", 2, &["--threshold", "--material", "cannot be used"]),
        ("--iso 3 --radius 2", 2, &["--iso", "--radius", "cannot be used"]),
        ("--threshold otsu", 2, &["otsu-mode"]),
        ("--iso nan", 1, &["iso value NaN", "finite", "--iso"]),
        ("--iso 4000", 1, &["iso value 4000", "from 4000 to 40063", "--iso"]),
        ("--iso 50000", 1, &["iso value 50000", "up to 40063"]),
        ("--iso 9000 --names air", 1, &["1 names", "2 materials"]),
        ("--denoise blur", 2, &["`blur` is no filter", "bilateral", "none"]),
        ("--denoise bilateral:width=3", 2, &["`width` is unknown", "sigma, grey"]),
        ("--denoise bilateral:sigma=-1", 2, &["sigma -1", "above 0"]),
        ("--denoise bilateral:grey=nan", 2, &["grey NaN", "above 0"]),
        ("--denoise median:radius=17", 1, &["17 voxels", "16 is the most", "smaller radius"]),
        ("--denoise mean:radius=0.5mm", 1, &["no other voxel", "larger radius"]),
        ("--denoise mean --labels", 1, &["labels have no noise", "--denoise"]),
        ("--method cubes", 2, &["'cubes'", "--method", "marching, dual"]),
        ("--method dual --tolerance nan", 2, &["'nan'", "not a distance", "0.02mm"]),
        ("--method dual --tolerance inf", 2, &["'inf'", "not a distance", "0.02mm"]),
        ("--method dual --tolerance 2cm", 2, &["'2cm'", "not a distance", "0.02mm"]),
        ("--method dual --tolerance mm", 2, &["'mm'", "not a distance", "0.02mm"]),
        ("--method dual --phi nan", 1, &["NaN", "finite", "--phi"]),
        ("--method dual --phi 1 --tolerance 1", 2, &["--phi", "--tolerance", "cannot be used"]),
        ("--method dual --phi 1 --target-triangles 9", 2, &["--phi", "--target-triangles", "cannot be used"]),
        ("--method dual --tolerance 1 --target-triangles 9", 2, &["--tolerance", "--target-triangles"]),
        ("--method dual --target-triangles 0", 2, &["0 is not in", "--target-triangles"]),
        ("--method dual --qef middle", 2, &["'middle'", "clamped, paper"]),
        ("--tolerance 0.1", 1, &["--tolerance", "--method dual", "add it"]),
        ("--phi 1", 1, &["--phi", "--method dual", "add it"]),
        ("--target-triangles 9", 1, &["--target-triangles", "--method dual", "add it"]),
        ("--method marching --qef paper", 1, &["--qef", "--method dual", "leave"]),
        ("--normals sided", 1, &["--normals", "--method dual", "add it"]),
    ] {
        work.fails(&format!("good.raw {RAW} {option}"), code, words);
    }
}

#[test]
fn tolerances_are_taken_in_voxels_and_millimetres() {
    let work = Work::new();
    // The spacing is 2 mm, so all are the same but the last two.
    let mut triangles = Vec::new();
    for tolerance in [" 0.1mm", " 0.05", " 0.05vx", " -1", "=-1mm"] {
        let run = format!("good.raw {RAW} --spacing 2 --method dual --tolerance{tolerance}");
        let output = work.extract(&run);
        assert!(output.status.success(), "{run}: {}", String::from_utf8_lossy(&output.stderr));
        let report = fs::read(work.path().join("out/report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        triangles.push(report["triangles"].as_u64().unwrap());
    }
    let [a, b, c, d, e] = triangles[..] else { panic!("{triangles:?}") };
    assert!(a == b && b == c && d == e && a < d, "{triangles:?}");
}

#[test]
fn a_result_that_cannot_be_written_leaves_nothing() {
    let work = Work::new();
    let good = format!("good.raw {RAW}");
    work.fails(&format!("{good} --out no/such/out"), 1, &["no/such/out", "no folder no/such", "create it"]);
    work.fails(&format!("{good} --out good.raw"), 1, &["good.raw", "not a folder", "choose another"]);
    work.fails(&format!("{good} --out good.raw/out"), 1, &["good.raw/out", "no folder good.raw"]);
    work.write("photos/cat.jpg", &[b"meow"]);
    let words = ["photos", "not an earlier result", "choose a new or an empty folder"];
    work.fails(&format!("{good} --out photos"), 1, &words);
    // A file of the same name does not make it a result of ours, which would be deleted.
    work.write("photos/report.json", &[b"{\"tool\": \"camera\"}"]);
    work.fails(&format!("{good} --out photos"), 1, &words);
    work.fails(&format!("{good} --out photos/.."), 1, &["not an earlier result"]);
    work.fails(&format!("{good} --out ."), 1, &["not an earlier result"]);
}

#[test]
#[cfg(target_os = "linux")]
fn a_folder_that_may_not_be_written_is_known_at_once() {
    use std::os::unix::fs::PermissionsExt;
    let work = Work::new();
    let good = format!("good.raw {RAW}");
    // Not even root can make anything there.
    work.fails(&format!("{good} --out /proc/out"), 1, &["/proc/out", "choose another folder"]);
    let locked = work.path().join("locked");
    fs::create_dir(&locked).unwrap();
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o555)).unwrap();
    if fs::write(locked.join("try"), "").is_ok() {
        eprintln!("SKIPPED: a parent folder without permission to write, since this runs as root");
        return;
    }
    work.fails(&format!("{good} --out locked/out"), 1, &["locked/out", "permission denied", "choose"]);
}

/// A small file system, while it lives.
#[cfg(target_os = "linux")]
struct Mounted(PathBuf);

#[cfg(target_os = "linux")]
impl Mounted {
    /// One of `size` in the folder `name` that is made for it, or `None` (said aloud).
    fn new(work: &Work, name: &str, size: &str) -> Option<Self> {
        let path = work.path().join(name);
        fs::create_dir(&path).unwrap();
        let options = format!("size={size}");
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &options, "tmpfs"]).arg(&path).output();
        if mount.is_ok_and(|m| m.status.success()) {
            return Some(Self(path));
        }
        eprintln!("SKIPPED: a full file system, since none can be mounted here");
        None
    }
}

#[cfg(target_os = "linux")]
impl Drop for Mounted {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_disk_that_fills_while_slabs_are_worked_on_leaves_nothing() {
    let work = Work::new();
    const N: usize = 64;
    work.raw("balls.raw", N, |p| if radius(p.map(|x| x % 16), 16) < 6.0 { 40_000 } else { 4000 });
    // Within the mesh of some 5 MiB, and at its beginning.
    for (name, size) in [("half", "1m"), ("tiny", "64k")] {
        if let Some(_disk) = Mounted::new(&work, name, size) {
            let file = format!("{name}/out/assembly.ply");
            for slab in [3, 31] {
                let run = format!("balls.raw --size {N},{N},{N} --type u16 --slab {slab} --out {name}/out");
                work.fails(&run, 1, &[file.as_str(), "no space is left", "another disk", "Nothing was left"]);
                assert!(fs::read_dir(work.path().join(name)).unwrap().next().is_none());
            }
        }
    }
    // The limit of a shell on the size of files: within the mesh.
    let before = contents(work.path());
    let script = "trap '' XFSZ; ulimit -f 1024; exec \"$0\" extract balls.raw --size 64,64,64 --type u16 --slab 9 --out out";
    let output = Command::new("sh").args(["-c", script, BINARY]).current_dir(work.path()).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert_failure_reads_well("ulimit", &message, &["out/assembly.ply", "too large", "Nothing was"]);
    assert!(contents(work.path()) == before);
}

#[test]
fn a_budget_of_memory_that_cannot_do_is_refused_before_anything_is_read() {
    let work = Work::new();
    for (allowed, said) in [("1MiB", "1.0 MiB"), ("70MiB", "70.0 MiB"), ("0", "0 B")] {
        let words = ["memory budget", said, "too small", "[24, 24, 24]", "at least", "MiB", "--memory"];
        work.fails(&format!("good.raw {RAW} --memory {allowed}"), 1, &words);
        work.fails(&format!("good.raw {RAW} --memory {allowed} --slab 2 --labels"), 1, &words);
    }
    work.fails(&format!("good.raw {RAW} --memory much"), 2, &["'much'", "--memory"]);
    // What is said to be needed is enough.
    let message = work.fails(&format!("good.raw {RAW} --memory 1MiB"), 1, &[]);
    let needed = message.split("at least ").nth(1).and_then(|m| m.split(" (").next()).unwrap();
    let bytes: bytesize::ByteSize = needed.parse().unwrap();
    // One digit behind the point is shown.
    let enough = bytes.as_u64() + (1 << 20) / 10;
    let output = work.extract(&format!("good.raw {RAW} --memory {enough}B"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_leaves_nothing_and_an_earlier_result() {
    let work = Work::new();
    if let Some(_tiny) = Mounted::new(&work, "tiny", "64k") {
        let words = ["tiny/out/", "no space is left", "another disk", "Nothing was left"];
        work.fails(&format!("good.raw {RAW} --out tiny/out"), 1, &words);
        assert!(fs::read_dir(work.path().join("tiny")).unwrap().next().is_none());
    }

    // The limit of a shell on the size of files (blocks of 512 or 1024 bytes) fails writes likewise.
    assert!(work.extract(&format!("good.raw {RAW}")).status.success());
    let before = contents(work.path());
    let script = format!("trap '' XFSZ; ulimit -f 16; exec \"$0\" extract good.raw {RAW} --out out");
    let output = Command::new("sh").args(["-c", &script, BINARY]).current_dir(work.path()).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert_failure_reads_well(
        "ulimit",
        &message,
        &["out/assembly.ply", "too large", "ulimit", "Nothing was"],
    );
    assert!(contents(work.path()) == before, "the earlier result did not stay as it was");
}

#[test]
fn an_earlier_result_survives_every_failure_and_is_replaced_by_a_success() {
    let work = Work::new();
    let good = format!("good.raw {RAW}");
    assert!(work.extract(&good).status.success());
    let first = contents(work.path());
    // Before and after the work began; `fails` compares the folder.
    work.fails("missing.mha", 1, &[]);
    work.fails(&format!("{good} --count 1000"), 1, &[]);
    work.fails(&format!("{good} --radius 15"), 1, &[]);
    work.write("out/note.txt", &[b"mine"]);
    assert!(work.extract(&good).status.success());
    let names = |all: &BTreeMap<PathBuf, Vec<u8>>| all.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&contents(work.path())), names(&first));
}

/// Starts `extract` in the background.
#[cfg(unix)]
fn start(work: &Work, arguments: &str) -> Child {
    let mut command = Command::new(BINARY);
    command.current_dir(work.path()).arg("extract").args(arguments.split_whitespace());
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Sends a signal; the process must end within two seconds with code 130 and say so. `false` if it
/// had ended already.
#[cfg(unix)]
fn interrupt(child: Child, signals: &[&str], limit: Duration) -> bool {
    let mut child = child;
    if let Some(status) = child.try_wait().unwrap() {
        assert!(status.success());
        return false;
    }
    let start = Instant::now();
    for signal in signals {
        let id = child.id().to_string();
        assert!(Command::new("kill").args([signal, id.as_str()]).status().unwrap().success());
        std::thread::sleep(Duration::from_millis(100));
    }
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > limit {
            child.kill().unwrap();
            panic!("still running {limit:?} after {signals:?}");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let output = child.wait_with_output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{message}");
    assert_failure_reads_well(
        "interrupt",
        &message,
        &["interrupted before it was done", "nothing unfinished"],
    );
    true
}

#[test]
#[cfg(unix)]
fn an_interrupt_ends_any_stage_within_two_seconds_and_leaves_nothing() {
    const N: usize = 320;
    let work = Work::new();
    // Balls in a lattice: much surface, so that every stage takes a while.
    work.raw("big.raw", N, |p| if radius(p.map(|x| x % 32), 32) < 12.0 { 40_000 } else { 4000 });
    let big = format!("big.raw --size {N},{N},{N} --type u16 --out out");
    // Into nothing, then over an earlier result.
    for earlier in [false, true] {
        if earlier {
            assert!(work.extract(&format!("good.raw {RAW}")).status.success());
        }
        let before = contents(&work.path().join(if earlier { "out" } else { "." }));
        let mut interrupted = 0;
        for (milliseconds, signal) in [(150, "-INT"), (700, "-TERM"), (2000, "-INT"), (5000, "-INT")] {
            let child = start(&work, &big);
            std::thread::sleep(Duration::from_millis(milliseconds));
            interrupted += u32::from(interrupt(child, &[signal], Duration::from_secs(2)));
            let after = contents(&work.path().join(if earlier { "out" } else { "." }));
            // A fast machine may be done first, with a whole result, which is no failure.
            if interrupted == 0 || after != before {
                assert!(work.path().join("out/report.json").is_file(), "{:?}", after.keys());
                eprintln!("SKIPPED: an interrupt after {milliseconds} ms and later; the run was done");
                break;
            }
            let names: Vec<_> = fs::read_dir(work.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
            assert_eq!(names.len(), 2 + usize::from(earlier), "{names:?}");
        }
        assert!(interrupted > 0, "no run was interrupted: take a larger volume");
        let _ = fs::remove_dir_all(work.path().join("out"));
    }
}

#[test]
#[cfg(unix)]
fn an_interrupt_ends_a_run_that_hangs() {
    let work = Work::new();
    // Nobody writes to the pipe: reading the materials waits for ever.
    assert!(Command::new("mkfifo").arg(work.path().join("pipe.toml")).status().unwrap().success());
    let before = contents(work.path());
    let hanging = format!("good.raw {RAW} --materials pipe.toml --out out");
    for (signals, limit) in [(&["-INT"][..], 2000), (&["-TERM"], 2000), (&["-INT", "-INT"], 1000)] {
        let child = start(&work, &hanging);
        std::thread::sleep(Duration::from_millis(500));
        assert!(interrupt(child, signals, Duration::from_millis(limit)));
        assert!(contents(work.path()) == before);
    }
}

#[test]
fn what_is_abandoned_is_gone_and_cannot_be_finished() {
    // In this file, since it is about the whole process: the other tests here write in others.
    let folder = tempfile::tempdir().unwrap();
    let staged = StagedFolder::create(&folder.path().join("out")).unwrap();
    fs::create_dir(staged.path().join("materials")).unwrap();
    fs::write(staged.path().join("materials/a.stl"), "solid").unwrap();
    let file = folder.path().join("a.ply");
    let finished = write_atomically(&file, |_| {
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
        drop(abandon_unfinished());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        Ok(())
    });
    assert!(finished.is_err() && staged.commit().is_err());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    write_atomically(&file, |_| Ok(())).unwrap();
    assert!(file.is_file());
}
