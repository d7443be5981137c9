//! STL reader: binary and ascii.
//!
//! A file whose length fits the count in a binary header *is* binary, whatever its header says:
//! many binary files start with `solid`. That is also why the crate `stl_io` is not used to read:
//! it takes those for text; and it refuses normals that are not numbers, which nobody needs.
//! Text may have LF, CRLF or CR line ends, any case, and words after the end of a loop or facet.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use glam::DVec3;

use super::ExportError;
use super::read::{Raw, bounded};
use super::stl::{HEADER, TRIANGLE};

const PREFIX: usize = HEADER + 4;
/// Longest line of text: far beyond any in use, small against any memory.
const LINE: usize = 1 << 16;

/// The length of a binary file with this head, by its own count.
fn binary_length(head: &[u8]) -> Option<u64> {
    let count: [u8; 4] = head.get(HEADER..PREFIX)?.try_into().ok()?;
    Some(PREFIX as u64 + TRIANGLE as u64 * u64::from(u32::from_le_bytes(count)))
}

fn is_text(head: &[u8]) -> bool {
    let start = head.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(head.len());
    head[start..].get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
}

/// Whether a file with this head and length looks like an STL.
pub(super) fn looks_right(head: &[u8], length: u64) -> bool {
    is_text(head) || binary_length(head) == Some(length)
}

/// Reads the STL that `file` was opened from, from its start.
pub(super) fn read(path: &Path, file: File, length: u64) -> Result<Raw, ExportError> {
    let bad = |what: String| ExportError::malformed(path, "STL", what);
    let mut input = BufReader::with_capacity(1 << 18, file);
    let head = input.fill_buf().map_err(|source| ExportError::Read { path: path.to_owned(), source })?;
    let mut weld = Weld::default();
    match binary_length(head) {
        Some(fits) if fits == length => binary(input, &mut weld),
        _ if is_text(head) => text(input, &mut weld),
        Some(promised) => Err(format!(
            "it is not text, and as a binary file it promises {} triangles, which take {promised} bytes, but has {length}",
            (promised - PREFIX as u64) / TRIANGLE as u64
        )),
        None => Err(format!("{length} bytes are too few even for a header")),
    }
    .map_err(bad)?;
    Ok(weld.raw)
}

fn binary(mut input: impl Read, weld: &mut Weld) -> Result<(), String> {
    let mut bytes = [0; PREFIX];
    input.read_exact(&mut bytes).map_err(|e| e.to_string())?;
    let count = u32::from_le_bytes([bytes[80], bytes[81], bytes[82], bytes[83]]);
    let mut bytes = [0; TRIANGLE];
    for t in 0..count {
        input.read_exact(&mut bytes).map_err(|e| format!("triangle {t}: {e}"))?;
        let number =
            |i: usize| f64::from(f32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]));
        let corner = |i: usize| DVec3::new(number(i), number(i + 4), number(i + 8));
        weld.add([corner(12), corner(24), corner(36)]).map_err(|e| format!("triangle {t}: {e}"))?;
    }
    Ok(())
}

/// Where in the text a line may come.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    BeforeSolid,
    InSolid,
    InFacet,
    InLoop,
    AfterLoop,
}

fn text(mut input: impl BufRead, weld: &mut Weld) -> Result<(), String> {
    let mut parser = TextParser { place: Place::BeforeSolid, corners: Vec::new() };
    let (mut line, mut number, mut after_cr) = (Vec::new(), 1, false);
    let mut end_line = |line: &mut Vec<u8>, number: usize| {
        let done = parser.line(line, weld).map_err(|e| format!("line {number}: {e}"));
        line.clear();
        done
    };
    loop {
        let buffer = input.fill_buf().map_err(|e| e.to_string())?;
        if buffer.is_empty() {
            break;
        }
        for &byte in buffer {
            match byte {
                b'\n' if after_cr => {} // the second half of a CRLF
                b'\n' | b'\r' => {
                    end_line(&mut line, number)?;
                    number += 1;
                }
                _ if line.len() < LINE => line.push(byte),
                _ => return Err(format!("line {number} is longer than {LINE} bytes")),
            }
            after_cr = byte == b'\r';
        }
        let used = buffer.len();
        input.consume(used);
    }
    end_line(&mut line, number)?;
    if parser.place == Place::BeforeSolid {
        Ok(())
    } else {
        Err("the text ends before 'endsolid'".to_owned())
    }
}

struct TextParser {
    place: Place,
    corners: Vec<DVec3>,
}

impl TextParser {
    fn line(&mut self, line: &[u8], weld: &mut Weld) -> Result<(), String> {
        let text = String::from_utf8_lossy(line);
        let mut words = text.split_whitespace();
        let Some(first) = words.next() else { return Ok(()) };
        let first = first.to_ascii_lowercase();
        self.place = match (self.place, first.as_str()) {
            (Place::BeforeSolid, "solid") => Place::InSolid,
            (Place::InSolid, "endsolid") => Place::BeforeSolid,
            // The normal is worked out from the corners by whoever needs it.
            (Place::InSolid, "facet") => Place::InFacet,
            (Place::InFacet, "outer") => Place::InLoop,
            (Place::InLoop, "vertex") => {
                let numbers: Vec<f64> = words
                    .map(|w| w.parse().map_err(|_| format!("'{}' is not a number", bounded(w))))
                    .collect::<Result<_, _>>()?;
                let &[x, y, z] = numbers.as_slice() else {
                    return Err(format!("a vertex with {} numbers", numbers.len()));
                };
                self.corners.push(DVec3::new(x, y, z));
                Place::InLoop
            }
            (Place::InLoop, "endloop") => {
                let &[a, b, c] = self.corners.as_slice() else {
                    return Err(format!("a facet with {} vertices", self.corners.len()));
                };
                weld.add([a, b, c])?;
                self.corners.clear();
                Place::AfterLoop
            }
            (Place::AfterLoop, "endfacet") => Place::InSolid,
            _ => return Err(format!("'{}' where it does not belong", bounded(&text))),
        };
        Ok(())
    }
}

/// Makes one vertex of corners that are equal bit for bit (both zeros are one).
#[derive(Default)]
struct Weld {
    ids: HashMap<[u64; 3], u32>,
    raw: Raw,
}

impl Weld {
    fn add(&mut self, corners: [DVec3; 3]) -> Result<(), String> {
        let mut triangle = [0; 3];
        for (id, corner) in triangle.iter_mut().zip(corners) {
            if !corner.is_finite() {
                return Err(format!("a corner at ({}, {}, {})", corner.x, corner.y, corner.z));
            }
            let corner = corner + 0.0; // makes -0 into 0
            let next = u32::try_from(self.raw.positions.len()).map_err(|_| "too many vertices")?;
            *id = *self.ids.entry(corner.to_array().map(f64::to_bits)).or_insert(next);
            if *id == next {
                self.raw.positions.push(corner);
            }
        }
        self.raw.triangles.push(triangle);
        Ok(())
    }
}
