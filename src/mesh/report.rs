//! Everything there is to say about a finished mesh, in one value.

use serde::{Deserialize, Serialize};

use super::check::{CheckOptions, Checker, Defects};
use super::curve_edges::CurveEdges;
use super::in_chunks::InChunks;
use super::junctions::Junctions;
use super::measure::{Measurer, Measures};
use super::quality::{Quality, Shapes};
use super::tables::Tables;
use super::window::{Carry, Window};
use super::{InterfaceMesh, MeshMaterial, MeshPiece};
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
    /// Checks and measures `mesh`. The search for self-intersections shows its progress as a stage.
    ///
    /// # Errors
    /// [`Cancelled`] if the execution was asked to stop.
    pub fn new(
        mesh: &InterfaceMesh,
        options: &CheckOptions,
        execution: &Execution,
    ) -> Result<Self, Cancelled> {
        let mut all = All::new(options);
        all.checker.progress = true;
        all.add(&Window::whole(mesh), execution)?;
        Ok(all.finish(mesh.materials().to_vec()))
    }
}

/// Makes the [`MeshReport`] of a mesh that comes in pieces, holding one piece and the last layer of the
/// one before.
///
/// Guarantee: exactly the report of the whole mesh, however it is cut and for any number of threads.
/// Memory beside that follows the curves and the number of examples.
pub struct MeshReportBuilder {
    materials: Vec<MeshMaterial>,
    carry: Carry,
    all: All,
}

impl MeshReportBuilder {
    /// For a mesh of these materials.
    #[must_use]
    pub fn new(materials: Vec<MeshMaterial>, options: &CheckOptions) -> Self {
        Self { materials, carry: Carry::default(), all: All::new(options) }
    }

    /// Adds the next piece; the first one begins with vertex 0 and triangle 0. If pieces are left out or
    /// do not fit together, the report means nothing.
    ///
    /// # Errors
    /// [`Cancelled`] if the execution was asked to stop; then the builder is of no more use.
    pub fn add(&mut self, piece: &MeshPiece, execution: &Execution) -> Result<(), Cancelled> {
        let Self { carry, all, .. } = self;
        carry.step(piece, |window| all.add(window, execution))
    }

    /// The report of all pieces.
    #[must_use]
    pub fn finish(self) -> MeshReport {
        self.all.finish(self.materials)
    }
}

/// All that is found out about a mesh window by window.
struct All {
    checker: Checker,
    measurer: Measurer,
    curves: CurveEdges,
    shapes: InChunks<Shapes>,
}

impl All {
    fn new(options: &CheckOptions) -> Self {
        Self {
            checker: Checker::new(options.clone()),
            measurer: Measurer::default(),
            curves: CurveEdges::default(),
            shapes: InChunks::default(),
        }
    }

    fn add(&mut self, window: &Window<'_>, execution: &Execution) -> Result<(), Cancelled> {
        execution.check()?;
        let tables = Tables::new(window);
        execution.check()?;
        self.measurer.add(window, &tables);
        execution.check()?;
        self.curves.add(window, &tables);
        self.shapes.add(window, &());
        self.checker.add(window, tables, execution)
    }

    fn finish(self, materials: Vec<MeshMaterial>) -> MeshReport {
        MeshReport {
            materials,
            defects: self.checker.finish(),
            measures: self.measurer.finish(),
            junctions: self.curves.finish(),
            quality: self.shapes.finish().into(),
        }
    }
}
