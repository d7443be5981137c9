//! Where a mesh goes piece by piece.

use crate::grid::Geometry;
use crate::mesh::{InterfaceMesh, MeshError, MeshMaterial, MeshMerger, MeshPiece};

/// Why a sink could not take a piece.
pub type SinkError = Box<dyn std::error::Error + Send + Sync>;

/// Takes a mesh that comes in pieces, in order.
pub trait MeshSink: Send {
    /// Called once, before the first piece.
    ///
    /// # Errors
    /// Whatever went wrong; it ends the run.
    fn begin(&mut self, geometry: &Geometry, materials: &[MeshMaterial]) -> Result<(), SinkError>;

    /// The next piece.
    ///
    /// # Errors
    /// Whatever went wrong; it ends the run.
    fn add(&mut self, piece: MeshPiece) -> Result<(), SinkError>;

    /// Bytes that the sink holds at its peak, apart from a piece.
    fn memory(&self) -> u64 {
        0
    }

    /// Stages of work that the sink has after the last piece, with their shares of time; the pipeline's
    /// own come to about 10.
    fn stages(&self) -> &[(&'static str, f64)] {
        &[]
    }

    /// How many triangles a piece should have at most, if the sink would rather have other pieces than
    /// those that the memory plan makes.
    fn piece(&self) -> Option<usize> {
        None
    }
}

/// Puts the pieces together in memory.
#[derive(Debug, Default)]
pub(super) struct WholeMesh {
    merger: MeshMerger,
    materials: Vec<MeshMaterial>,
}

impl WholeMesh {
    pub(super) fn finish(self) -> Result<InterfaceMesh, MeshError> {
        self.merger.finish(self.materials)
    }
}

impl MeshSink for WholeMesh {
    fn begin(&mut self, _: &Geometry, materials: &[MeshMaterial]) -> Result<(), SinkError> {
        self.materials = materials.to_vec();
        Ok(())
    }

    fn add(&mut self, piece: MeshPiece) -> Result<(), SinkError> {
        Ok(self.merger.add(piece)?)
    }

    fn piece(&self) -> Option<usize> {
        // One piece, which needs no putting together.
        Some(usize::MAX)
    }
}
