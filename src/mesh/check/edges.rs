//! Edges: boundary, uses per shell, order of materials round them, duplicate triangles.

use glam::DVec3;
use rayon::prelude::*;

use super::defects::{Defects, EdgeDefect};
use super::{ShellCounts, Wrong, has_shell, pair_defect};
use crate::execution::{Cancelled, Execution};
use crate::grid::MaterialId;
use crate::mesh::window::Window;
use crate::triangle::{EdgeTable, EdgeUse, in_turn};

/// Checks the edges that the window owns and enters what is wrong in `defects` and `counts`.
pub(super) fn check(
    window: &Window<'_>,
    table: &EdgeTable,
    keep: usize,
    defects: &mut Defects,
    counts: &mut ShellCounts,
    execution: &Execution,
) -> Result<(), Cancelled> {
    let parts = EdgeTable::chunks(window.own_vertices())
        .into_par_iter()
        .map(|lows| {
            execution.check()?;
            let mut part = Part { window, keep, found: Defects::default(), counts: None };
            for low in lows {
                for (high, uses) in table.edges_of(low) {
                    part.edge([low as u32, high], uses);
                }
            }
            Ok((part.found, part.counts))
        })
        .collect::<Result<Vec<_>, Cancelled>>()?;
    for (found, wrong) in parts {
        defects.boundary_edges.append(keep, found.boundary_edges);
        defects.alternation.append(keep, found.alternation);
        defects.open_edges.append(keep, found.open_edges);
        defects.non_manifold_edges.append(keep, found.non_manifold_edges);
        defects.winding.append(keep, found.winding);
        defects.duplicate_triangles.append(keep, found.duplicate_triangles);
        if let Some(wrong) = wrong {
            counts.merge(&wrong);
        }
    }
    Ok(())
}

/// What one task finds.
struct Part<'a> {
    window: &'a Window<'a>,
    keep: usize,
    found: Defects,
    /// Boxed and only made when something is wrong: most tasks find nothing.
    counts: Option<Box<ShellCounts>>,
}

impl Part<'_> {
    fn edge(&mut self, ends: [u32; 2], uses: &[EdgeUse]) {
        let pairs = self.window.pairs();
        if let [a, b] = uses
            && pairs[a.triangle()] == pairs[b.triangle()]
            && a.is_forward() != b.is_forward()
        {
            // Inside an interface, as most edges are. Two such triangles can still be the same three
            // vertices; that is found as for any other edge.
            self.duplicates(ends, uses);
            return;
        }
        if uses.len() == 1 {
            self.found.boundary_edges.add(self.keep, || defect(self.window, ends, uses, None));
        } else if !self.alternates(ends, uses) {
            self.found.alternation.add(self.keep, || defect(self.window, ends, uses, None));
        }
        self.shells(ends, uses);
        self.duplicates(ends, uses);
    }

    /// Per material: its shell must use the edge once each way.
    fn shells(&mut self, ends: [u32; 2], uses: &[EdgeUse]) {
        let mut ways: Vec<(MaterialId, bool)> = uses
            .iter()
            .flat_map(|u| {
                let pair = self.window.pairs()[u.triangle()];
                [(pair.back(), u.is_forward()), (pair.front(), !u.is_forward())]
            })
            .filter(|&(id, _)| has_shell(id))
            .collect();
        ways.sort_unstable();
        for ways in ways.chunk_by(|a, b| a.0 == b.0) {
            let id = ways[0].0;
            let forward = ways.iter().filter(|w| w.1).count();
            let backward = ways.len() - forward;
            let (list, wrong) = match (forward, backward) {
                (1, 1) => continue,
                (1, 0) | (0, 1) => (&mut self.found.open_edges, Wrong::Open),
                (2, 0) | (0, 2) => (&mut self.found.winding, Wrong::Winding),
                _ => (&mut self.found.non_manifold_edges, Wrong::NonManifold),
            };
            list.add(self.keep, || defect(self.window, ends, uses, Some(id)));
            let counts = self.counts.get_or_insert_with(|| Box::new(ShellCounts::new()));
            counts.add(id, wrong);
            if forward != backward {
                counts.add(id, Wrong::Unbalanced);
            }
        }
    }

    /// Triangles with the same three vertices, found at the edge of their two lowest ones.
    fn duplicates(&mut self, ends: [u32; 2], uses: &[EdgeUse]) {
        if uses.len() < 2 {
            return;
        }
        let mut thirds: Vec<(u32, u32)> = Vec::new();
        if let [a, b] = uses {
            // No list for the common case.
            let (c, d) = (self.third(ends, *a), self.third(ends, *b));
            if c != d || c < ends[1] {
                return;
            }
        }
        thirds.extend(
            uses.iter().map(|u| (self.third(ends, *u), u.triangle() as u32)).filter(|t| t.0 > ends[1]),
        );
        thirds.sort_unstable();
        for two in thirds.windows(2).filter(|two| two[0].0 == two[1].0) {
            let triangles = [two[0].1, two[1].1];
            if triangles[0] != triangles[1] {
                self.found.duplicate_triangles.add(self.keep, || pair_defect(self.window, triangles));
            }
        }
    }

    fn third(&self, ends: [u32; 2], u: EdgeUse) -> u32 {
        let t = self.window.triangles()[u.triangle()];
        t.into_iter().find(|v| !ends.contains(v)).unwrap_or(ends[0])
    }

    /// Whether the materials round the edge match up.
    fn alternates(&self, ends: [u32; 2], uses: &[EdgeUse]) -> bool {
        // Turning counter-clockwise about the edge, seen against its direction from low to high, a
        // triangle that runs forward is passed from its back to its front.
        let passed = |u: &EdgeUse| {
            let pair = self.window.pairs()[u.triangle()];
            if u.is_forward() { (pair.back(), pair.front()) } else { (pair.front(), pair.back()) }
        };
        let matches_up = |around: &[EdgeUse]| {
            (0..around.len()).all(|i| {
                let (into, from) = (passed(&around[i]).1, passed(&around[(i + 1) % around.len()]).0);
                into == from || !(has_shell(into) || has_shell(from))
            })
        };
        // With two triangles the order round the edge is always the same.
        uses.len() == 2 && matches_up(uses)
            || uses.len() > 2 && {
                let point = |v: u32| self.window.positions()[v as usize];
                let tips: Vec<(EdgeUse, DVec3)> =
                    uses.iter().map(|u| (*u, point(self.third(ends, *u)))).collect();
                in_turn(point(ends[0]), point(ends[1]), &tips).is_none_or(|around| matches_up(&around))
            }
    }
}

fn defect(window: &Window<'_>, ends: [u32; 2], uses: &[EdgeUse], material: Option<MaterialId>) -> EdgeDefect {
    let triangles = uses.iter().map(|u| window.triangle_id(u.triangle()));
    let mut triangles: Vec<u32> = triangles.take(EdgeDefect::MAX_TRIANGLES).collect();
    triangles.sort_unstable();
    EdgeDefect {
        vertices: ends.map(|v| window.vertex_id(v as usize)),
        ends: ends.map(|v| window.positions()[v as usize].to_array()),
        triangles,
        material,
    }
}
