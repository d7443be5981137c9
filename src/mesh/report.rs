//! Everything there is to say about a finished mesh, in one value.

use serde::{Deserialize, Serialize};

use super::check::{CheckOptions, Defects, check_with};
use super::edge_table::EdgeTable;
use super::junctions::{Junctions, junctions_with};
use super::measure::{Measures, measure_with};
use super::quality::{Quality, quality};
use super::{InterfaceMesh, MeshMaterial};
use crate::execution::{Cancelled, Execution};

/// Defects, measures, junctions and triangle shapes of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeshReport {
    /// The materials, as the mesh lists them.
    pub materials: Vec<MeshMaterial>,
    /// What is wrong, with places.
    pub defects: Defects,
    /// Areas, volumes, pieces.
    pub measures: Measures,
    /// Junction curves and boundaries.
    pub junctions: Junctions,
    /// Shapes of the triangles.
    pub quality: Quality,
}

impl MeshReport {
    /// Checks and measures `mesh`; its edges are gathered once for all.
    ///
    /// # Errors
    /// [`Cancelled`] if the execution was asked to stop.
    pub fn new(
        mesh: &InterfaceMesh,
        options: &CheckOptions,
        execution: &Execution,
    ) -> Result<Self, Cancelled> {
        let table = EdgeTable::new(mesh.positions().len(), mesh.triangles());
        let defects = check_with(mesh, &table, options, execution)?;
        execution.check()?;
        let measures = measure_with(mesh, &table);
        execution.check()?;
        let junctions = junctions_with(mesh, &table);
        execution.check()?;
        Ok(Self {
            materials: mesh.materials().to_vec(),
            defects,
            measures,
            junctions,
            quality: quality(mesh),
        })
    }
}
