//! PLY reader: ascii and binary of both endians, our own files and other tools'.
//!
//! The header's promises are checked against the file's length before anything is made room for,
//! and elements are read one by one, so that a lying file costs no more memory than its own size
//! justifies. Line ends may be LF, CRLF or CR. Polygons become fans. Labels and kinds go by
//! configurable names; a file without labels is read as one material, 1, in air.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use glam::DVec3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    Addable, BeginList, ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult,
    PropertyDef, PropertyType, ScalarType,
};

use super::ExportError;
use super::ply_decode::{self, Layout};
use super::ply_layout::read_sigma;
use super::read::{Labels, Raw, ReadOptions, bounded};
use crate::grid::VertexKind;

/// Longest header and longest ascii line: far beyond any in use, small against any memory.
const MAX_HEADER: usize = 1 << 20;

/// The vertex property with the standard deviation of its position.
const SIGMA: &str = "sigma";

/// Reads the PLY file that `file` was opened from, from its start.
pub(super) fn read(path: &Path, file: File, length: u64, options: &ReadOptions) -> Result<Raw, ExportError> {
    let bad = |what: String| ExportError::malformed(path, "PLY", what);
    let mut input = BufReader::with_capacity(1 << 18, file);
    let Start { header, line_end, used } = start(&mut input, length).map_err(&bad)?;
    let materials = material_comments(&header);
    if let Some(layout) = Layout::recognise(&header, used, length, options) {
        if let Some(raw) = ply_decode::read(input.get_ref(), &layout, &materials) {
            return Ok(raw);
        }
        let back = input.seek(SeekFrom::Start(used));
        back.map_err(|source| ExportError::Read { path: path.to_owned(), source })?;
    }
    let mut raw = Raw { materials, ..Raw::default() };
    let (mut seen_vertex, mut seen_face) = (false, false);
    let mut payload = Payload { input, encoding: header.encoding, line_end, line: Vec::new() };
    for (_, element) in &header.elements {
        match element.name.as_str() {
            "vertex" => {
                seen_vertex = true;
                let (def, has_kind) = vertex_properties(element, options).map_err(&bad)?;
                let has_sigma = has_scalar(element, SIGMA, false).map_err(&bad)?;
                payload.each(&def, |v: Vertex| {
                    raw.positions.push(DVec3::from_array(v.position));
                    if has_kind {
                        raw.kinds.push(VertexKind::from_code(v.kind));
                    }
                    if has_sigma {
                        raw.sigmas.push(read_sigma(v.sigma as f32));
                    }
                    Ok(())
                })
            }
            "face" => {
                seen_face = true;
                let (def, labelled) = face_properties(element, options).map_err(&bad)?;
                raw.labels = if labelled { Labels::Given(Vec::new()) } else { Labels::None };
                payload.each(&def, |f: Face| raw.add_polygon(&f.indices()?, f.back, f.front))
            }
            _ => payload.each(element, |_: Skipped| Ok(())),
        }
        .map_err(|e| bad(format!("{} {e}", element.name)))?;
    }
    if !seen_vertex || !seen_face {
        return Err(bad(format!(
            "it has no element '{}'; a mesh needs vertices and faces",
            if seen_vertex { "face" } else { "vertex" }
        )));
    }
    Ok(raw)
}

/// What a file begins with.
pub(super) struct Start {
    pub(super) header: Header,
    line_end: u8,
    /// Bytes that the header takes.
    pub(super) used: u64,
}

/// Reads the header of a file of `length` bytes and checks what it promises.
pub(super) fn start(input: &mut BufReader<File>, length: u64) -> Result<Start, String> {
    let (text, line_end, used) = header_text(input)?;
    let mut cursor = Reader::new(Cursor::new(&text));
    let header = Parser::<Skipped>::new().read_header(&mut cursor).map_err(|e| bounded(&e.to_string()))?;
    check_names(&text, &header)?;
    check_counts(&header, length.saturating_sub(used))?;
    Ok(Start { header, line_end, used })
}

/// The header with plain line feeds, the file's line end, and how many bytes the header takes.
fn header_text(input: &mut BufReader<File>) -> Result<(String, u8, u64), String> {
    let start = input.fill_buf().map_err(|e| e.to_string())?;
    // Only a bare CR after the first word makes CR the line end: then a payload that happens to
    // start with a line feed keeps it.
    let line_end = if start.starts_with(b"ply\r") && start.get(4) != Some(&b'\n') { b'\r' } else { b'\n' };
    let (mut text, mut used, mut line) = (String::new(), 0, Vec::new());
    loop {
        line.clear();
        let room = (MAX_HEADER - used) as u64;
        used += input.by_ref().take(room).read_until(line_end, &mut line).map_err(|e| e.to_string())?;
        if line.last() != Some(&line_end) && String::from_utf8_lossy(&line).trim() != "end_header" {
            return Err(if used >= MAX_HEADER {
                format!("no end_header within {MAX_HEADER} bytes")
            } else {
                "the file ends inside its header".to_owned()
            });
        }
        let words = String::from_utf8_lossy(&line);
        let words = words.trim();
        if !words.is_empty() {
            text.push_str(words);
            text.push('\n');
        }
        if words == "end_header" {
            return Ok((text, line_end, used as u64));
        }
    }
}

fn bytes(scalar: &ScalarType) -> u64 {
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}

/// Refuses a header in which a name comes twice: the parser would keep one of the two only, and then
/// read everything behind it from the wrong place.
fn check_names(text: &str, header: &Header) -> Result<(), String> {
    let lines = |word: &str| text.lines().filter(|l| l.split_whitespace().next() == Some(word)).count();
    let properties: usize = header.elements.iter().map(|(_, e)| e.properties.iter().count()).sum();
    if lines("element") != header.elements.iter().count() || lines("property") != properties {
        return Err("two elements, or two properties of one, have the same name".to_owned());
    }
    Ok(())
}

/// Refuses counts that the rest of the file cannot hold, at the least every entry may take.
fn check_counts(header: &Header, available: u64) -> Result<(), String> {
    let mut needed: u64 = 0;
    for (name, element) in &header.elements {
        let least: u64 = element
            .properties
            .iter()
            .map(|(_, p)| match (&p.data_type, header.encoding) {
                (_, Encoding::Ascii) => 2, // a digit and a space or line end
                (PropertyType::Scalar(s) | PropertyType::List(s, _), _) => bytes(s),
            })
            .sum();
        let count = element.count as u64;
        if least == 0 && count > 0 {
            return Err(format!("{count} entries of element '{name}', which has no properties"));
        }
        needed = needed.saturating_add(count.saturating_mul(least));
        // The last line of an ascii file may lack its end.
        if needed > available.saturating_add(1) {
            return Err(format!(
                "the header promises {count} entries of '{name}', at least {needed} bytes so far, but only {available} bytes follow"
            ));
        }
    }
    Ok(())
}

/// Id, name and mean of the materials that comments list.
pub(super) fn material_comments(header: &Header) -> Vec<(u8, String, f64)> {
    let material = |comment: &String| {
        let rest = comment.trim().strip_prefix("material ")?;
        let (id, rest) = rest.trim().split_once(' ')?;
        let (name, mean) = rest.trim().rsplit_once(' ')?;
        Some((id.parse().ok()?, name.trim().to_owned(), mean.parse().ok()?))
    };
    header.comments.iter().filter_map(material).collect()
}

/// The element with the properties that matter under fixed names and all others under others.
fn renamed(element: &ElementDef, name: impl Fn(&PropertyDef) -> Option<&'static str>) -> ElementDef {
    let mut def = ElementDef::new(element.name.clone());
    def.count = element.count;
    for (i, (_, property)) in element.properties.iter().enumerate() {
        let name = name(property).map_or_else(|| format!("-{i}"), str::to_owned);
        def.properties.add(PropertyDef::new(name, property.data_type.clone()));
    }
    def
}

fn listed(element: &ElementDef) -> String {
    let names: Vec<_> = element.properties.iter().map(|(_, p)| p.name.as_str()).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

fn is_scalar(property: &PropertyDef) -> bool {
    matches!(property.data_type, PropertyType::Scalar(_))
}

/// Whether the element has a single number of this name; an error if it is missing though asked for.
fn has_scalar(element: &ElementDef, name: &str, required: bool) -> Result<bool, String> {
    let found = element.properties.iter().any(|(_, p)| p.name == name && is_scalar(p));
    if required && !found {
        return Err(format!(
            "element '{}' has no property '{name}' with one number; it has: {}",
            element.name,
            listed(element)
        ));
    }
    Ok(found)
}

fn vertex_properties(element: &ElementDef, options: &ReadOptions) -> Result<(ElementDef, bool), String> {
    for axis in ["x", "y", "z"] {
        has_scalar(element, axis, true)?;
    }
    let asked = options.kind != ReadOptions::default().kind;
    let has_kind = has_scalar(element, &options.kind, asked)?;
    let def = renamed(element, |p| match p.name.as_str() {
        _ if !is_scalar(p) => None,
        "x" => Some("x"),
        "y" => Some("y"),
        "z" => Some("z"),
        SIGMA => Some(SIGMA),
        name if name == options.kind => Some("kind"),
        _ => None,
    });
    Ok((def, has_kind))
}

fn face_properties(element: &ElementDef, options: &ReadOptions) -> Result<(ElementDef, bool), String> {
    let is_indices = |p: &PropertyDef| !is_scalar(p) && options.vertex_indices.contains(&p.name);
    if !element.properties.iter().any(|(_, p)| is_indices(p)) {
        return Err(format!(
            "element 'face' has no list {}; it has: {}",
            options.vertex_indices.join(" or "),
            listed(element)
        ));
    }
    let default = ReadOptions::default();
    let asked = options.back != default.back || options.front != default.front;
    let back = has_scalar(element, &options.back, asked)?;
    let front = has_scalar(element, &options.front, asked || back)?;
    if front && !back {
        has_scalar(element, &options.back, true)?;
    }
    let def = renamed(element, |p| {
        if is_indices(p) {
            Some("indices")
        } else if is_scalar(p) && p.name == options.back {
            Some("back")
        } else if is_scalar(p) && p.name == options.front {
            Some("front")
        } else {
            None
        }
    });
    Ok((def, back))
}

/// What follows the header.
struct Payload {
    input: BufReader<File>,
    encoding: Encoding,
    line_end: u8,
    line: Vec<u8>,
}

impl Payload {
    /// Reads all entries of an element and hands them on one by one.
    fn each<E: PropertyAccess>(
        &mut self,
        def: &ElementDef,
        mut take: impl FnMut(E) -> Result<(), String>,
    ) -> Result<(), String> {
        let parser = Parser::<E>::new();
        for i in 0..def.count {
            let element = match self.encoding {
                Encoding::Ascii => self.next_line().and_then(|line| {
                    parser.read_ascii_element(&line, def).map_err(|e| bounded(&e.to_string()))
                }),
                Encoding::BinaryLittleEndian => parser
                    .read_little_endian_element(&mut self.input, def)
                    .map_err(|e| bounded(&e.to_string())),
                Encoding::BinaryBigEndian => {
                    parser.read_big_endian_element(&mut self.input, def).map_err(|e| bounded(&e.to_string()))
                }
            };
            element.and_then(&mut take).map_err(|e| format!("{i} of {}: {e}", def.count))?;
        }
        Ok(())
    }

    /// The next line that is not blank.
    fn next_line(&mut self) -> Result<String, String> {
        loop {
            self.line.clear();
            let limit = MAX_HEADER as u64;
            let n = self
                .input
                .by_ref()
                .take(limit)
                .read_until(self.line_end, &mut self.line)
                .map_err(|e| e.to_string())?;
            if n == 0 {
                return Err("the file ends too early".to_owned());
            }
            if n as u64 == limit {
                return Err(format!("a line is longer than {limit} bytes"));
            }
            let text = str::from_utf8(&self.line).map_err(|_| "a line is not text".to_owned())?.trim();
            if !text.is_empty() {
                return Ok(text.to_owned());
            }
        }
    }
}

/// One number of any type, as f64.
fn number(property: &Property) -> Option<f64> {
    Some(match property {
        Property::Char(v) => f64::from(*v),
        Property::UChar(v) => f64::from(*v),
        Property::Short(v) => f64::from(*v),
        Property::UShort(v) => f64::from(*v),
        Property::Int(v) => f64::from(*v),
        Property::UInt(v) => f64::from(*v),
        Property::Float(v) => f64::from(*v),
        Property::Double(v) => *v,
        _ => return None,
    })
}

/// An element that nothing is taken from.
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

struct Vertex {
    position: [f64; 3],
    kind: u8,
    sigma: f64,
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self { position: [f64::NAN; 3], kind: 0, sigma: f64::NAN }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let Some(value) = number(&property) else { return PropertyAccessResult::Ignored };
        match name {
            "x" => self.position[0] = value,
            "y" => self.position[1] = value,
            "z" => self.position[2] = value,
            "kind" => self.kind = value as u8,
            SIGMA => self.sigma = value,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

struct Face {
    int: Vec<i32>,
    uint: Vec<u32>,
    back: f64,
    front: f64,
}

impl Face {
    fn indices(&self) -> Result<Vec<u32>, String> {
        let signed = self.int.iter().map(|&i| u32::try_from(i).map_err(|_| format!("vertex index {i}")));
        signed.chain(self.uint.iter().map(|&i| Ok(i))).collect()
    }
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self { int: Vec::new(), uint: Vec::new(), back: f64::NAN, front: f64::NAN }
    }

    fn begin_list_int(&mut self, name: &str, _len: usize) -> BeginList<'_, i32> {
        if name == "indices" { BeginList::Fill(&mut self.int) } else { BeginList::UseSetter }
    }

    fn begin_list_uint(&mut self, name: &str, _len: usize) -> BeginList<'_, u32> {
        if name == "indices" { BeginList::Fill(&mut self.uint) } else { BeginList::UseSetter }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        match (name, &property) {
            ("indices", Property::ListChar(v)) => self.int = v.iter().map(|&i| i.into()).collect(),
            ("indices", Property::ListUChar(v)) => self.uint = v.iter().map(|&i| i.into()).collect(),
            ("indices", Property::ListShort(v)) => self.int = v.iter().map(|&i| i.into()).collect(),
            ("indices", Property::ListUShort(v)) => self.uint = v.iter().map(|&i| i.into()).collect(),
            ("indices", _) => return PropertyAccessResult::UnsupportedType,
            ("back", _) => self.back = number(&property).unwrap_or(f64::NAN),
            ("front", _) => self.front = number(&property).unwrap_or(f64::NAN),
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}
