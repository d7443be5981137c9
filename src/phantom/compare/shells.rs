//! Volume and topology of each material's shell against what they should be.

use serde::{Deserialize, Serialize};

use super::connected::lowest_connected;
use crate::grid::MaterialId;
use crate::mesh::{InterfaceMesh, measure};
use crate::phantom::{Phantom, Topology};

/// A material's shell against what it should be. Triangles on the volume's border are left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MaterialComparison {
    /// Its id.
    pub id: u8,
    /// Its name.
    pub name: String,
    /// Volume the mesh encloses, mm³; `None` for the background.
    pub volume: Option<f64>,
    /// Exact volume, mm³; `None` for the background.
    pub exact_volume: Option<f64>,
    /// How much too large the mesh's volume is, percent.
    pub volume_error_percent: Option<f64>,
    /// The shell's topology in the mesh.
    pub topology: Topology,
    /// What it should be.
    pub expected: Topology,
}

pub(super) fn compare(mesh: &InterfaceMesh, phantom: &Phantom) -> Vec<MaterialComparison> {
    let truth = phantom.truth();
    let shells = measure(mesh).shells;
    phantom
        .materials()
        .materials()
        .iter()
        .zip(truth.topology())
        .map(|(material, expected)| {
            let exact = truth.volume(material.id);
            let shell = shells.iter().find(|s| s.material == material.id);
            let volume = exact.and(shell).and_then(|s| s.volume);
            MaterialComparison {
                id: material.id.0,
                name: material.name.clone(),
                volume,
                exact_volume: exact,
                volume_error_percent: volume.zip(exact).map(|(v, e)| 100.0 * (v / e - 1.0)),
                topology: topology(mesh, material.id),
                expected: *expected,
            }
        })
        .collect()
}

/// Components (connected through vertices) and Euler characteristic of the shell of a material, air
/// among them, without its triangles towards `OUTSIDE`: [`measure`] has neither.
fn topology(mesh: &InterfaceMesh, material: MaterialId) -> Topology {
    let shell: Vec<[u32; 3]> = mesh
        .triangles()
        .iter()
        .zip(mesh.pairs())
        .filter(|(_, pair)| pair.contains(material) && !pair.contains(MaterialId::OUTSIDE))
        .map(|(t, _)| *t)
        .collect();
    let lowest = lowest_connected(mesh.positions().len(), &shell);
    let mut edges = Vec::with_capacity(3 * shell.len());
    let mut used = Vec::with_capacity(3 * shell.len());
    for [a, b, c] in &shell {
        for (p, q) in [(*a, *b), (*b, *c), (*c, *a)] {
            edges.push((p.min(q), p.max(q)));
            used.push(p);
        }
    }
    edges.sort_unstable();
    edges.dedup();
    used.sort_unstable();
    used.dedup();
    let components = used.iter().filter(|&&v| lowest[v as usize] == v).count();
    Topology { components, euler: used.len() as i64 - edges.len() as i64 + shell.len() as i64 }
}
