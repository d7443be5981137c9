//! The list of test objects: names, descriptions, materials, and which options matter for which.
//!
//! Objects are described in their own units: about one unit from the centre to the sides. The
//! [`Phantom`](super::Phantom) scales, turns and shifts them into the volume.

use std::str::FromStr;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::PhantomError;
use super::objects::{self, Blueprint, Shape};

/// Which test object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SceneName {
    /// Iron ring knocked into a bored aluminium block.
    PressFitRing,
    /// Tilted iron bolt through an aluminium plate.
    BoltInPlate,
    /// Tilted iron cube in an aluminium cube, flush with one face.
    CubeInCube,
    /// One aluminium box.
    Cube,
    /// Iron cube in a corner of an aluminium cube, flush with three of its faces.
    FlushCubes,
    /// Iron ball sunk into the end of an aluminium cylinder.
    SphereOnCylinder,
    /// Four materials that meet in a point.
    FourMaterials,
    /// Thin iron plate in air.
    ThinPlate,
    /// Two aluminium blocks with a thin air gap between them.
    ThinGap,
    /// Thin iron layer between two aluminium blocks.
    ThinLayer,
    /// Aluminium steps.
    Steps,
    /// One aluminium ball.
    Sphere,
    /// Aluminium bar on an iron block, with sides inclined by a given angle.
    Wedge,
    /// Aluminium block with four rounded edges.
    Fillet,
    /// Aluminium block with small pores and iron balls in it.
    Pores,
}

/// The shell of one material (without what lies on the volume's border): what a right mesh has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Topology {
    /// Connected components of the material's closed shell.
    pub components: usize,
    /// Euler characteristic (vertices - edges + faces) of the shell, all components together.
    pub euler: i64,
}

impl FromStr for SceneName {
    type Err = PhantomError;

    fn from_str(name: &str) -> Result<Self, PhantomError> {
        Self::from_name(name)
    }
}

/// How far an object reaches from its centre.
pub(super) enum Bounds {
    Box(DVec3),
    Ball(f64),
}

impl SceneName {
    /// All of them, in the order of the list.
    pub const ALL: [Self; 15] = [
        Self::PressFitRing,
        Self::BoltInPlate,
        Self::CubeInCube,
        Self::Cube,
        Self::FlushCubes,
        Self::SphereOnCylinder,
        Self::FourMaterials,
        Self::ThinPlate,
        Self::ThinGap,
        Self::ThinLayer,
        Self::Steps,
        Self::Sphere,
        Self::Wedge,
        Self::Fillet,
        Self::Pores,
    ];

    /// The name as it is typed and written.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::PressFitRing => "press-fit-ring",
            Self::BoltInPlate => "bolt-in-plate",
            Self::CubeInCube => "cube-in-cube",
            Self::Cube => "cube",
            Self::FlushCubes => "flush-cubes",
            Self::SphereOnCylinder => "sphere-on-cylinder",
            Self::FourMaterials => "four-materials",
            Self::ThinPlate => "thin-plate",
            Self::ThinGap => "thin-gap",
            Self::ThinLayer => "thin-layer",
            Self::Steps => "steps",
            Self::Sphere => "sphere",
            Self::Wedge => "wedge",
            Self::Fillet => "fillet",
            Self::Pores => "pores",
        }
    }

    /// The scene with this name.
    ///
    /// # Errors
    /// [`PhantomError::UnknownScene`] lists the names there are.
    pub fn from_name(name: &str) -> Result<Self, PhantomError> {
        Self::ALL.into_iter().find(|scene| scene.name() == name).ok_or_else(|| PhantomError::UnknownScene {
            name: name.to_owned(),
            known: Self::ALL.map(Self::name).join(", "),
        })
    }

    /// Expected shells of its materials, by id.
    #[must_use]
    pub fn topology(self) -> Vec<Topology> {
        // What the options decide does not change it.
        let shape = Shape { thickness: 0.1, half: DVec3::ONE, angle: 60.0, fillet: 0.1, voxel: 0.05 };
        self.blueprint(shape).topology
    }

    /// What the object is and what it shows.
    #[must_use]
    pub fn description(self) -> &'static str {
        match self {
            Self::PressFitRing => {
                "An iron ring knocked into a bored aluminium block, as in the paper of Fujimori and Suzuki. The ring is flush with the block's bottom and protrudes at its top. Air, aluminium and iron meet in two circles: a flush one (air 180 degrees, aluminium 90, iron 90) and a stepped one (air 90, aluminium 90, iron 180)."
            }
            Self::BoltInPlate => {
                "An iron bolt, shank and sunk head, tilted by 8 degrees, through an aluminium plate. Air, aluminium and iron meet in two ellipses, at angles from 82 to 98 degrees; the aluminium/iron interface has sharp inner edges."
            }
            Self::CubeInCube => {
                "A tilted iron cube inside an aluminium cube, cut off flush with its top face. Air, aluminium and iron meet in a quadrilateral with four corners, at angles from 70 to 110 degrees."
            }
            Self::Cube => {
                "One aluminium box: plane faces, convex sharp edges, corners; --extent gives its edges in voxels. Its faces lie on voxel boundaries with --rotate 0,0,0 --shift 0,0,0 where extent and size are both even or both odd."
            }
            Self::FlushCubes => {
                "An iron cube in a corner of an aluminium cube of 20/11 its edge: flush with three faces, whose edges and corner they share, 9/11 of its edge inside of the other three. Air, aluminium and iron meet in a ring of six straight pieces: at 180, 90 and 90 degrees along a face, and over three edges and round three inner corners."
            }
            Self::SphereOnCylinder => {
                "An iron ball sunk into the flat end of an aluminium cylinder, slightly off its axis. Curved interfaces; air, aluminium and iron meet in a circle at which the air is a wedge of 77 degrees."
            }
            Self::FourMaterials => {
                "An iron disc with three sectors of 120 degrees on it: aluminium, a middle material, and one left open. The four materials meet in a point in the middle, from which four junction curves start, and in one at the rim."
            }
            Self::ThinPlate => {
                "An iron plate in air, as thin as --thickness says. Parts thinner than the blur lose their grey value."
            }
            Self::ThinGap => {
                "Two aluminium blocks with an air gap between them, as wide as --thickness says. A right mesh keeps two blocks."
            }
            Self::ThinLayer => {
                "An iron layer between two aluminium blocks, as thick as --thickness says, flush at the sides, where two junction curves run close to each other."
            }
            Self::Steps => "Aluminium stairs of four steps: plane faces, convex and concave sharp edges.",
            Self::Sphere => {
                "One aluminium ball: no junctions. Shows the shrinkage of curved surfaces by the blur, s^2 / r for a ball of radius r."
            }
            Self::Wedge => {
                "An aluminium bar on the plane face of an iron block, with long sides inclined by --angle. Air, aluminium and iron meet in a rectangle: along its long sides the aluminium is a wedge of that angle, the air of 180 less it; along its short sides both are 90."
            }
            Self::Fillet => {
                "An aluminium block with its four upright edges rounded by --fillet, the others sharp. A rounded edge must not become a sharp one."
            }
            Self::Pores => {
                "An aluminium block with three spherical pores and three iron balls of radius 2, 3 and 4 voxels in it, whatever the size of the block. Small parts lose their grey value by the blur."
            }
        }
    }

    /// Names and default grey values (16 bit) of the materials, the background first.
    #[must_use]
    pub fn materials(self) -> &'static [(&'static str, f64)] {
        const AIR: (&str, f64) = ("air", 4000.0);
        const ALUMINIUM: (&str, f64) = ("aluminium", 11600.0);
        const MIDDLE: (&str, f64) = ("middle", 22000.0);
        const IRON: (&str, f64) = ("iron", 40000.0);
        match self {
            Self::FourMaterials => &[AIR, ALUMINIUM, MIDDLE, IRON],
            Self::ThinPlate => &[AIR, IRON],
            Self::Cube | Self::ThinGap | Self::Steps | Self::Sphere | Self::Fillet => &[AIR, ALUMINIUM],
            _ => &[AIR, ALUMINIUM, IRON],
        }
    }

    /// Whether `--thickness` matters.
    #[must_use]
    pub fn uses_thickness(self) -> bool {
        matches!(self, Self::ThinPlate | Self::ThinGap | Self::ThinLayer)
    }

    /// The two surfaces of the thin part or gap that `--thickness` is about; their normals point out of it.
    pub(super) fn thin_faces(self) -> Option<[usize; 2]> {
        match self {
            Self::ThinPlate => Some([4, 5]),
            Self::ThinGap | Self::ThinLayer => Some([6, 7]),
            _ => None,
        }
    }

    /// Whether `--angle` matters.
    #[must_use]
    pub fn uses_angle(self) -> bool {
        self == Self::Wedge
    }

    /// Whether `--fillet` matters.
    #[must_use]
    pub fn uses_fillet(self) -> bool {
        self == Self::Fillet
    }

    /// Whether `--extent` matters.
    #[must_use]
    pub fn uses_extent(self) -> bool {
        self == Self::Cube
    }

    pub(super) fn bounds(self, half: DVec3) -> Bounds {
        match self {
            Self::Cube => Bounds::Box(half),
            Self::PressFitRing => Bounds::Box(DVec3::new(1.0, 1.0, 0.675)),
            Self::BoltInPlate => Bounds::Box(DVec3::new(1.0, 1.0, 0.75)),
            Self::CubeInCube | Self::FlushCubes => Bounds::Box(DVec3::ONE),
            Self::SphereOnCylinder => Bounds::Box(DVec3::new(0.95, 0.95, 0.9)),
            Self::FourMaterials => Bounds::Box(DVec3::new(1.0, 1.0, 0.8)),
            Self::ThinPlate => Bounds::Box(DVec3::new(1.0, 1.0, 0.4)),
            Self::ThinGap | Self::ThinLayer | Self::Steps => Bounds::Box(DVec3::new(1.0, 1.0, 0.8)),
            Self::Sphere => Bounds::Ball(1.0),
            Self::Wedge => Bounds::Box(DVec3::new(1.1, 1.0, 0.55)),
            Self::Fillet => Bounds::Box(objects::FILLET_HALF),
            Self::Pores => Bounds::Box(objects::PORES_HALF),
        }
    }

    /// The largest thickness that leaves the object what it is, in its own units.
    pub(super) fn max_thickness(self) -> f64 {
        if self.uses_thickness() { 0.8 } else { f64::INFINITY }
    }

    /// The largest radius of rounded edges that leaves something of the faces, in the object's units.
    pub(super) fn max_fillet(self) -> f64 {
        if self == Self::Fillet { 0.4 } else { f64::INFINITY }
    }

    /// The largest voxel at which parts of a fixed number of voxels fit into the object, in the object's units.
    pub(super) fn max_voxel(self) -> f64 {
        if self == Self::Pores { objects::PORES_VOXEL } else { f64::INFINITY }
    }

    /// The object in this form.
    pub(super) fn blueprint(self, shape: Shape) -> Blueprint {
        let Shape { thickness, half, angle, fillet, voxel } = shape;
        match self {
            Self::PressFitRing => objects::press_fit_ring(),
            Self::BoltInPlate => objects::bolt_in_plate(),
            Self::CubeInCube => objects::cube_in_cube(),
            Self::Cube => objects::cube(half),
            Self::FlushCubes => objects::flush_cubes(),
            Self::SphereOnCylinder => objects::sphere_on_cylinder(),
            Self::FourMaterials => objects::four_materials(),
            Self::ThinPlate => objects::cube(DVec3::new(1.0, 1.0, 0.5 * thickness)),
            Self::ThinGap => objects::two_blocks(thickness, false),
            Self::ThinLayer => objects::two_blocks(thickness, true),
            Self::Steps => objects::steps(),
            Self::Sphere => objects::sphere(),
            Self::Wedge => objects::wedge(angle),
            Self::Fillet => objects::fillet(fillet),
            Self::Pores => objects::pores(voxel),
        }
    }
}
