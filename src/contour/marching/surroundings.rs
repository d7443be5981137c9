//! The part of the surface around vertices that are wished elsewhere, with names that hold for the whole volume.
//!
//! Only cells for which the rule speaks are looked at. What is kept follows the curves, not the surface: the wishes, and the
//! triangles of the cells around such a vertex and of all cells beside those. No other triangle can meet one that moves: a
//! vertex moves by less than one along each axis, so its triangles stay within one cell of theirs, and do not reach that one's
//! far side. Others that move are around a vertex of their own.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use foldhash::fast::FixedState;
use rayon::prelude::*;

use super::cell::{Cell, pair_of};
use super::fill::place;
use super::kinks::{KINK, TIP, kink_of};
use super::{runs, walk};
use crate::classify::{BitPlanes, LabelVolume, WORD, set_bits};
use crate::contour::crossing::{CrossingRule, Node};
use crate::contour::error::ContourError;
use crate::contour::moves::{Wish, Wishes};
use crate::contour::patch::Border;
use crate::contour::pattern::{Apex, PatternTable};
use crate::contour::piece::SeamKey;
use crate::execution::Execution;
use crate::grid::MaterialId;
use crate::grid::cube::{CORNERS, EDGES, FACES, edge_axis, edge_corners, face_ring};

/// Cells on each side of one that has a vertex.
const BESIDE: usize = 1;
/// Wishes for less than this (lattice units) are not worth a move.
const LEAST: f32 = 0.02;

/// See the module's header.
#[derive(Debug, Default)]
pub struct Surroundings {
    /// The wishes, by key.
    pub wishes: Vec<Wish>,
    /// Vertices of the triangles, where they lie by construction, lattice units; some more than once.
    pub vertices: Vec<(SeamKey, [f32; 3])>,
    /// Triangles.
    pub triangles: Vec<Facet>,
}

/// A triangle around vertices that are wished elsewhere.
#[derive(Debug, Clone, Copy)]
pub struct Facet {
    /// Its vertices; it faces from the material behind it to the one ahead.
    pub vertices: [SeamKey; 3],
    /// Where the interface that it is of faces where its vertices should lie, lattice units and of any length; not a number where that
    /// is not known.
    pub facing: [f32; 3],
}

impl Surroundings {
    /// Layers beyond its own that [`surroundings`] looks at on each side.
    pub const BEYOND: usize = BESIDE + 1;

    /// Adds those of the next layers.
    pub fn append(&mut self, mut next: Self) {
        self.wishes.append(&mut next.wishes);
        self.vertices.append(&mut next.vertices);
        self.triangles.append(&mut next.triangles);
    }
}

/// Those of some layers; `labels` and the rule must know [`Surroundings::BEYOND`] more on each side.
///
/// # Errors
/// [`ContourError::Cancelled`] if asked to stop.
pub fn surroundings<W: Wishes>(
    labels: &LabelVolume,
    rule: &W,
    border: Border,
    layers: Range<usize>,
    execution: &Execution,
) -> Result<Surroundings, ContourError> {
    let all = labels.codes().padded()[2] - 1;
    let seen =
        layers.start.saturating_sub(Surroundings::BEYOND)..(layers.end + Surroundings::BEYOND).min(all);
    let stage = execution.stage("looking around curves", seen.len() as u64);
    let gatherer = Gatherer { labels, rule, border, table: PatternTable::get() };
    let found = runs(seen).into_par_iter().map(|run| {
        let mut asked = Asked::default();
        walk(labels, rule, border, run, execution, &stage, |layer| {
            layer.visit(labels, rule, gatherer.table, |[x, y], _, entry| {
                let low = [x, y, layer.z()];
                let kinked = layer.kinks(x, y);
                let two = gatherer.table.packed().entry(entry).two_materials;
                if (kinked != 0 || !two) && rule.speaks(low) {
                    gatherer.wish(&mut asked, low, entry, kinked);
                }
            });
        })?;
        Ok(asked)
    });
    let found: Vec<Asked> = found.collect::<Result<_, ContourError>>()?;
    let wishes = || found.iter().flat_map(|asked| asked.values().flatten());
    let wished: Wished = wishes().filter(|wish| wish.is_near()).map(|wish| (wish.key, wish.most())).collect();
    let near = cells_near(labels, wishes().filter(|wish| wish.is_near()), layers.clone());
    let parts: Vec<Surroundings> = near
        .par_chunks(1 << 10)
        .map(|cells| {
            let remembered = Remembered::new(rule);
            let around = Gatherer { labels, rule: &remembered, border, table: gatherer.table };
            let facing = |labels, at| rule.facing(labels, at);
            let mut out = Surroundings::default();
            cells.iter().for_each(|&low| around.gather(&mut out, low, &wished, facing));
            out
        })
        .collect();
    let mut out = Surroundings::default();
    parts.into_iter().for_each(|part| out.append(part));
    out.wishes = wishes().filter(|wish| layers.contains(&wish.key.low()[2])).copied().collect();
    out.wishes.sort_unstable_by_key(|wish| wish.key);
    out.wishes.dedup_by_key(|wish| wish.key);
    Ok(out)
}

/// The cells of `layers` around the vertices of these wishes and [`BESIDE`] those, in the order of z, y, x.
fn cells_near<'a>(
    labels: &LabelVolume,
    wishes: impl Iterator<Item = &'a Wish>,
    layers: Range<usize>,
) -> Vec<[usize; 3]> {
    // A cell by its lowest corner: the last points of rows have none.
    let ends = labels.codes().padded().map(|n| n - 1);
    let mut marked = BitPlanes::window(labels.size(), 1, layers.clone());
    for wish in wishes {
        let (low, below) = (wish.key.low(), wish.key.below());
        let range = |a: usize| low[a].saturating_sub(below[a] + BESIDE)..(low[a] + BESIDE + 1).min(ends[a]);
        for z in range(2).filter(|z| layers.contains(z)) {
            for y in range(1) {
                let row = marked.row_mut(0, y, z);
                range(0).for_each(|x| row[x / WORD] |= 1 << (x % WORD));
            }
        }
    }
    let row = |[y, z]: [usize; 2]| {
        let words = marked.row(0, y, z).iter().enumerate();
        words.flat_map(move |(w, word)| set_bits(*word).map(move |bit| [w * WORD + bit, y, z]))
    };
    layers.into_par_iter().flat_map_iter(|z| (0..ends[1]).map(move |y| [y, z]).flat_map(row)).collect()
}

/// What was asked for in a look at cells, and the wishes.
type Asked = HashMap<SeamKey, Option<Wish>, FixedState>;

/// Where vertices should lie, as near as they may.
type Wished = HashMap<SeamKey, [f32; 3], FixedState>;

struct Gatherer<'a, W> {
    labels: &'a LabelVolume,
    rule: &'a W,
    border: Border,
    table: &'static PatternTable,
}

/// A rule whose crossings and kinks are asked for once, though four cells share an edge and two a face.
struct Remembered<'a, W> {
    rule: &'a W,
    // One thread uses it; a rule has to be `Sync`.
    crossings: Mutex<ByPlace<f32>>,
    kinks: Mutex<ByPlace<Option<Node>>>,
}

/// By lowest point and axis.
type ByPlace<T> = HashMap<([usize; 3], usize), T, FixedState>;

impl<'a, W: CrossingRule> Remembered<'a, W> {
    fn new(rule: &'a W) -> Self {
        Self { rule, crossings: Mutex::default(), kinks: Mutex::default() }
    }
}

/// What is kept for a place, or found now.
fn recalled<T: Copy>(kept: &Mutex<ByPlace<T>>, place: ([usize; 3], usize), find: impl FnOnce() -> T) -> T {
    let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
    *kept.entry(place).or_insert_with(find)
}

impl<W: CrossingRule> CrossingRule for Remembered<'_, W> {
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        recalled(&self.crossings, (from, axis), || self.rule.position(from, axis, labels))
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        self.rule.joins_first(ring, labels)
    }

    fn node(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        self.rule.node(low, axis)
    }

    fn apex(&self, low: [usize; 3]) -> Option<Node> {
        self.rule.apex(low)
    }

    fn has_kinks(&self) -> bool {
        self.rule.has_kinks()
    }

    fn kink(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        recalled(&self.kinks, (low, axis), || self.rule.kink(low, axis))
    }
}

impl<W: Wishes> Gatherer<'_, W> {
    /// Asks what is wished for a cell's vertices.
    fn wish(&self, asked: &mut Asked, low: [usize; 3], entry: usize, kinked: u8) {
        let cell = Cell::at(self.labels, low);
        if cell.labels.contains(&MaterialId::OUTSIDE) {
            return;
        }
        let summary = self.table.packed().entry(entry);
        let mut ask =
            |key: SeamKey, safe: &dyn Fn() -> [f32; 3], wished: &dyn Fn([f32; 3]) -> Option<Node>| {
                let wish = *asked.entry(key).or_insert_with(|| {
                    let safe = safe();
                    let node = wished(safe)?;
                    let off = |a: usize| (node.at[a] - safe[a]).abs();
                    let farthest = (0..3).map(off).fold(0.0, f32::max);
                    (farthest > LEAST).then_some(Wish { key, safe, at: node.at, sigma: node.sigma })
                });
                wish.filter(Wish::is_near).map(|wish| wish.most())
            };
        if !summary.two_materials {
            for e in (0..EDGES).filter(|e| summary.crossings >> e & 1 == 1) {
                let [p, q] = edge_corners(e);
                let (from, axis) = (cell.corner(p), edge_axis(e));
                let labels = [cell.labels[p], cell.labels[q]];
                ask(
                    SeamKey::new(SeamKey::EDGES[axis], from),
                    &|| place(low, cell.crossing(self.rule, e)),
                    &|_| self.rule.crossing(from, axis, labels),
                );
            }
        }
        let mut nodes = [[0.0; 3]; FACES];
        for (f, node) in nodes.iter_mut().enumerate() {
            let (axis, mut from) = (f / 2, low);
            from[axis] += f % 2;
            if summary.star_faces >> f & 1 == 1 {
                let key = SeamKey::new(SeamKey::NODES[axis], from);
                let safe = self.node(from, axis);
                let wish = |safe| Wishes::node(self.rule, from, axis, safe);
                *node = ask(key, &|| safe, &wish).unwrap_or(safe);
            } else if kinked >> f & 1 == 1 {
                let safe =
                    || kink_of(self.rule, from, axis).map_or([f32::NAN; 3], |kink| place(from, kink.at));
                let key = SeamKey::new(SeamKey::KINKS[axis], from);
                ask(key, &safe, &|safe| Wishes::kink(self.rule, from, axis, safe));
            }
        }
        let surface = self.table.surface(entry);
        if surface.apexes.iter().any(|apex| matches!(apex, Apex::Sheet { face_nodes: 1.., .. })) {
            let safe = cell.apexes(self.rule, surface);
            let mut at: Vec<[f32; 3]> = safe.iter().map(|apex| place(low, apex.at)).collect();
            for (i, apex) in surface.apexes.iter().enumerate() {
                let key = SeamKey::new(SeamKey::APEX + i as u64, low);
                let own = at[i];
                let wished = match *apex {
                    Apex::Sheet { face_nodes: faces @ 1.., .. } => {
                        let count = faces.count_ones() as f32;
                        let own = (0..FACES).filter(|f| faces >> f & 1 == 1);
                        let sum = own.fold([0.0; 3], |s, f| [0, 1, 2].map(|a| s[a] + nodes[f][a]));
                        ask(key, &|| place(low, safe[i].at), &|_| {
                            Wishes::apex(self.rule, low, sum.map(|s| s / count))
                        })
                    }
                    Apex::Sheet { .. } => None,
                    Apex::Cap { main, .. } => {
                        // It follows its main apex by half.
                        let main = usize::from(main);
                        let (from, to) = (place(low, safe[main].at), at[main]);
                        let by = [0, 1, 2].map(|a| 0.5 * (to[a] - from[a]));
                        let node = Node { at: [0, 1, 2].map(|a| own[a] + by[a]), sigma: safe[i].sigma };
                        ask(key, &|| own, &|_| Some(node))
                    }
                };
                at[i] = wished.unwrap_or(own);
            }
        }
    }
}

impl<C: CrossingRule> Gatherer<'_, C> {
    /// Where the node of a face lies by construction.
    fn node(&self, low: [usize; 3], axis: usize) -> [f32; 3] {
        place(low, Cell::of_face(self.labels, low, axis).face_node(self.rule, 2 * axis).at)
    }

    /// Adds the triangles of a cell.
    fn gather(
        &self,
        out: &mut Surroundings,
        low: [usize; 3],
        wished: &Wished,
        facing: impl Fn([MaterialId; 2], [f32; 3]) -> Option<[f32; 3]>,
    ) {
        let cell = Cell::at(self.labels, low);
        if cell.labels == [cell.labels[0]; CORNERS] {
            return;
        }
        let entry = cell.entry(self.table, self.rule, self.table.partitions().index(&cell.labels));
        let (summary, surface) = (self.table.packed().entry(entry), self.table.surface(entry));
        let has_kink = |f: &usize| {
            let (axis, mut from) = (f / 2, low);
            from[axis] += f % 2;
            self.rule.has_kinks() && cell.is_plain(*f) && kink_of(self.rule, from, axis).is_some()
        };
        let kinked = (0..FACES).filter(has_kink).fold(0, |set, f| set | 1 << f);
        let apexes = cell.apexes(self.rule, surface);
        let (triangles, tips) =
            cell.bent(self.rule, self.table.packed().triangles(&summary), summary.crossings, kinked);
        let vertex = |v: u8| {
            let v = usize::from(v);
            let on_face = |f: usize| {
                let mut from = low;
                from[f / 2] += f % 2;
                (from, f / 2)
            };
            match v {
                0..EDGES => {
                    let from = cell.corner(edge_corners(v)[0]);
                    let key = SeamKey::new(SeamKey::EDGES[edge_axis(v)], from);
                    (key, place(low, cell.crossing(self.rule, v)))
                }
                EDGES..KINK if v < EDGES + FACES => {
                    let (from, axis) = on_face(v - EDGES);
                    (SeamKey::new(SeamKey::NODES[axis], from), self.node(from, axis))
                }
                EDGES..KINK => {
                    let i = v - EDGES - FACES;
                    (SeamKey::new(SeamKey::APEX + i as u64, low), place(low, apexes[i].at))
                }
                KINK..TIP => {
                    let (from, axis) = on_face(v - KINK);
                    let at = kink_of(self.rule, from, axis).map_or([0.0; 3], |kink| kink.at);
                    (SeamKey::new(SeamKey::KINKS[axis], from), place(from, at))
                }
                _ => (SeamKey::new(SeamKey::TIP + (v - TIP) as u64, low), place(low, tips[v - TIP].at)),
            }
        };
        let mut used = [false; 32];
        for t in triangles.iter().filter(|t| pair_of(cell.sides(t), self.border).is_some()) {
            let corners = t.vertices.map(|v| {
                let (key, at) = vertex(v);
                if !std::mem::replace(&mut used[usize::from(v)], true) {
                    out.vertices.push((key, at));
                }
                (key, wished.get(&key), at)
            });
            let moves = corners.iter().any(|corner| corner.1.is_some());
            let at = corners.map(|(_, wished, at)| wished.copied().unwrap_or(at));
            let middle = [0, 1, 2].map(|a| at.iter().map(|p| p[a]).sum::<f32>() / 3.0);
            let facing = if moves { facing(cell.sides(t), middle) } else { None };
            out.triangles.push(Facet {
                vertices: corners.map(|corner| corner.0),
                facing: facing.unwrap_or([f32::NAN; 3]),
            });
        }
    }
}

impl Cell {
    /// Whether face `f` may have a kink: two materials, neither of them `OUTSIDE`, and two crossings.
    fn is_plain(&self, f: usize) -> bool {
        let ring = face_ring(f).map(|c| self.labels[c]);
        let crossings = (0..4).filter(|&k| ring[k] != ring[(k + 1) % 4]).count();
        // Two crossings part the ring in two arcs.
        crossings == 2 && !ring.contains(&MaterialId::OUTSIDE)
    }
}
