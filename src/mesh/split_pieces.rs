//! One material's own shell, of a mesh that comes in pieces.

use glam::DVec3;

use super::MeshPiece;
use crate::grid::{MaterialId, VertexKind};

/// What a piece of mesh adds to a shell.
///
/// Put behind each other these are exactly what [`super::split()`] gives for the whole mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ShellPiece {
    /// Positions of the vertices it adds: world, mm.
    pub positions: Vec<DVec3>,
    /// Their kinds in the mesh.
    pub kinds: Vec<VertexKind>,
    /// Their sigmas in the mesh, mm; empty if none are known.
    pub sigmas: Vec<f32>,
    /// The triangles it adds, counter-clockwise seen from outside the material. Vertices are numbered over
    /// all pieces; every one named has come with this piece or an earlier one.
    pub triangles: Vec<[u32; 3]>,
}

/// Splits off the shell of a material piece by piece, holding one layer's triangles at most.
#[derive(Debug)]
pub struct ShellSplitter {
    material: MaterialId,
    /// How many vertices and triangles have been handed out.
    done: [u64; 2],
    /// Which vertices of the seam the shell uses.
    seam: Vec<bool>,
    /// Triangles that wait for the numbers of seam vertices, and all behind them.
    held: Vec<[Corner; 3]>,
}

/// A corner of a triangle that waits.
#[derive(Debug, Clone, Copy)]
enum Corner {
    /// With this number in the shell.
    Known(u32),
    /// The vertex at this place in the seam.
    Seam(u32),
}

impl ShellSplitter {
    /// For the shell of this material.
    #[must_use]
    pub fn new(material: MaterialId) -> Self {
        Self { material, done: [0; 2], seam: Vec::new(), held: Vec::new() }
    }

    /// The material.
    #[must_use]
    pub fn material(&self) -> MaterialId {
        self.material
    }

    /// How many vertices have been handed out so far.
    #[must_use]
    pub fn vertices(&self) -> u64 {
        self.done[0]
    }

    /// How many triangles have been handed out so far.
    #[must_use]
    pub fn triangles(&self) -> u64 {
        self.done[1]
    }

    /// What the next piece adds. Triangles on its upper seam come with the piece after it; the last
    /// piece has none.
    pub fn add(&mut self, piece: &MeshPiece) -> ShellPiece {
        let mesh = &piece.mesh;
        let owned = piece.owned.min(mesh.positions().len());
        let of_it: Vec<[u32; 3]> = mesh
            .triangles()
            .iter()
            .zip(mesh.pairs())
            .filter_map(|(&[a, b, c], pair)| {
                if pair.back() == self.material {
                    Some([a, b, c])
                } else {
                    (pair.front() == self.material).then_some([a, c, b])
                }
            })
            .collect();
        let mut used = std::mem::take(&mut self.seam);
        used.resize(mesh.positions().len(), false);
        for &v in of_it.iter().flatten() {
            used[v as usize] = true;
        }
        let mut out = ShellPiece::default();
        // The number in the shell of each own vertex; others are not asked for.
        let mut number = vec![0; owned];
        for v in (0..owned).filter(|&v| used[v]) {
            number[v] = (self.done[0] + out.positions.len() as u64) as u32;
            out.positions.push(mesh.positions()[v]);
            out.kinds.push(mesh.kinds()[v]);
            out.sigmas.extend(mesh.sigmas().map(|sigmas| sigmas[v]));
        }
        let place = |v: u32| match number.get(v as usize) {
            Some(&number) => Corner::Known(number),
            None => Corner::Seam(v - owned as u32),
        };
        let again = |corner| if let Corner::Seam(v) = corner { place(v) } else { corner };
        let held = std::mem::take(&mut self.held);
        for triangle in held.into_iter().map(|t| t.map(again)).chain(of_it.iter().map(|t| t.map(place))) {
            match triangle {
                [Corner::Known(a), Corner::Known(b), Corner::Known(c)] if self.held.is_empty() => {
                    out.triangles.push([a, b, c]);
                }
                _ => self.held.push(triangle),
            }
        }
        self.seam = used.split_off(owned);
        self.done[0] += out.positions.len() as u64;
        self.done[1] += out.triangles.len() as u64;
        out
    }
}
