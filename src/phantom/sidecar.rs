//! The truth file `NAME.phantom.json`: everything that defines a phantom, and the figures that
//! follow from it for programs that do not want to know its geometry.

use serde::{Deserialize, Serialize};

use super::catalogue::Topology;
use super::{Curve, CurvePiece, Phantom, PhantomError, PhantomOptions};

/// What a truth file holds. Only `options` define the phantom; the rest follows from them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sidecar {
    /// Always `interfacet-phantom`.
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// What the phantom is made from.
    pub options: PhantomOptions,
    /// What the object is.
    #[serde(default)]
    pub description: String,
    /// Its materials.
    #[serde(default)]
    pub materials: Vec<SidecarMaterial>,
    /// Standard deviation of the noise, grey values.
    #[serde(default)]
    pub noise_sigma: f64,
    /// Sigma of the blur per axis, mm, without the voxel's own box.
    #[serde(default)]
    pub sigma_mm: [f64; 3],
    /// Length of all junction curves together, mm.
    #[serde(default)]
    pub junction_length_mm: f64,
    /// The sharp edges: where one interface bends and no third material meets it.
    #[serde(default)]
    pub sharp_edges: Vec<SidecarEdge>,
    /// Where sharp edges end, world, mm.
    #[serde(default)]
    pub corners: Vec<[f64; 3]>,
}

/// A sharp edge in a truth file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SidecarEdge {
    /// Id of the material behind the interface that bends there.
    pub back: u8,
    /// Id of the material in front.
    pub front: u8,
    /// The ends of a straight edge; points along a curved one, at most a voxel apart. World, mm.
    pub points: Vec<[f64; 3]>,
}

/// A material in a truth file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SidecarMaterial {
    /// Its id.
    pub id: u8,
    /// Its name.
    pub name: String,
    /// Its exact grey value.
    pub grey: f64,
    /// Its exact volume, mm³; absent for the background.
    pub volume_mm3: Option<f64>,
    /// Its shell's topology.
    pub topology: Topology,
}

/// A piece of a curve as points at most `step` mm apart.
fn edge(piece: &CurvePiece, step: f64) -> Option<SidecarEdge> {
    let pair = piece.edge_pair()?;
    let count = match piece.curve {
        Curve::Line { .. } => 1.0,
        Curve::Ellipse { a, b, .. } => {
            ((piece.high - piece.low) * a.length().max(b.length()) / step).ceil().max(1.0)
        }
    };
    let at = |k: usize| piece.curve.at(piece.low + (piece.high - piece.low) * k as f64 / count).to_array();
    Some(SidecarEdge {
        back: pair.back().0,
        front: pair.front().0,
        points: (0..=count as usize).map(at).collect(),
    })
}

impl Sidecar {
    /// The version this program writes and reads.
    pub const VERSION: u32 = 1;
    const FORMAT: &'static str = "interfacet-phantom";

    /// The truth file of a phantom.
    #[must_use]
    pub fn new(phantom: &Phantom) -> Self {
        let truth = phantom.truth();
        let materials = phantom
            .materials()
            .materials()
            .iter()
            .zip(truth.topology())
            .map(|(material, topology)| SidecarMaterial {
                id: material.id.0,
                name: material.name.clone(),
                grey: material.mean,
                volume_mm3: truth.volume(material.id),
                topology: *topology,
            })
            .collect();
        Self {
            format: Self::FORMAT.to_owned(),
            version: Self::VERSION,
            options: phantom.options().clone(),
            description: phantom.options().scene.description().to_owned(),
            materials,
            noise_sigma: phantom.noise_sigma(),
            sigma_mm: phantom.sigma_mm(),
            junction_length_mm: truth.junction_length(),
            sharp_edges: truth.edges().filter_map(|e| edge(e, phantom.geometry().voxel_edge())).collect(),
            corners: truth.corners().iter().map(|c| c.to_array()).collect(),
        }
    }

    /// The file's text.
    ///
    /// # Errors
    /// [`PhantomError::Json`] if a value cannot be written (none of ours).
    pub fn to_json(&self) -> Result<String, PhantomError> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Reads a file's text.
    ///
    /// # Errors
    /// [`PhantomError::Json`] if it is not a truth file, [`PhantomError::Version`] if it is a later one.
    pub fn from_json(text: &str) -> Result<Self, PhantomError> {
        let read: Self = serde_json::from_str(text)?;
        if read.version != Self::VERSION || read.format != Self::FORMAT {
            return Err(PhantomError::Version { version: read.version, known: Self::VERSION });
        }
        Ok(read)
    }
}
