//! The test objects: geometry, exact volumes, and the topology a right mesh of them has.
//!
//! Objects are described in their own units: about one unit from the centre to the sides. The
//! [`Phantom`](super::Phantom) scales, turns and shifts them into the volume.

use std::f64::consts::{PI, TAU};
use std::str::FromStr;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::PhantomError;
use super::scene::{Scene, Side};
use super::surface::{Surface, rotation};

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

/// An object in its own units.
pub(super) struct Blueprint {
    pub(super) scene: Scene,
    /// Exact volume of the materials 1, 2, ... in cubic units.
    pub(super) volumes: Vec<f64>,
    /// The shells of the materials 0, 1, 2, ...
    pub(super) topology: Vec<Topology>,
}

/// What options decide of an object's form, in its own units.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    /// Of a thin part or gap.
    pub(super) thickness: f64,
    /// Half the edges of a box.
    pub(super) half: DVec3,
}

/// How far an object reaches from its centre.
pub(super) enum Bounds {
    Box(DVec3),
    Ball(f64),
}

/// A shell of this many components and this Euler characteristic.
const fn shell(components: usize, euler: i64) -> Topology {
    Topology { components, euler }
}
const BALL: Topology = shell(1, 2);
const TORUS: Topology = shell(1, 0);

impl SceneName {
    /// All of them, in the order of the list.
    pub const ALL: [Self; 12] = [
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
        // Thickness and extent do not change it.
        self.blueprint(Shape { thickness: 0.1, half: DVec3::ONE }).topology
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
                "A tilted iron cube inside an aluminium cube, cut off flush with its top face. Air, aluminium and iron meet in a quadrilateral with four corners, at angles from 66 to 114 degrees."
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
            Self::Cube | Self::ThinGap | Self::Steps | Self::Sphere => &[AIR, ALUMINIUM],
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
        }
    }

    /// The largest thickness that leaves the object what it is, in its own units.
    pub(super) fn max_thickness(self) -> f64 {
        if self.uses_thickness() { 0.8 } else { f64::INFINITY }
    }

    /// The object in this form.
    pub(super) fn blueprint(self, Shape { thickness, half }: Shape) -> Blueprint {
        match self {
            Self::PressFitRing => press_fit_ring(),
            Self::BoltInPlate => bolt_in_plate(),
            Self::CubeInCube => cube_in_cube(),
            Self::Cube => cube(half),
            Self::FlushCubes => flush_cubes(),
            Self::SphereOnCylinder => sphere_on_cylinder(),
            Self::FourMaterials => four_materials(),
            Self::ThinPlate => cube(DVec3::new(1.0, 1.0, 0.5 * thickness)),
            Self::ThinGap => two_blocks(thickness, false),
            Self::ThinLayer => two_blocks(thickness, true),
            Self::Steps => steps(),
            Self::Sphere => sphere(),
        }
    }
}

fn cylinder(scene: &mut Scene, point: DVec3, axis: DVec3, radius: f64) -> usize {
    scene.add(Surface::Cylinder { point, axis, radius })
}

fn press_fit_ring() -> Blueprint {
    let (bottom, top, ring_top) = (-0.675, 0.425, 0.675);
    let (outer, inner) = (0.72, 0.42);
    let mut scene = Scene::default();
    let block = scene.cuboid(DVec3::new(-1.0, -1.0, bottom), DVec3::new(1.0, 1.0, top));
    let bore = cylinder(&mut scene, DVec3::ZERO, DVec3::Z, outer);
    let hole = cylinder(&mut scene, DVec3::ZERO, DVec3::Z, inner);
    let ring_end = scene.plane(DVec3::Z, ring_top);
    let mut bored = block.to_vec();
    bored.push(Side(bore, false));
    scene.solid(1, &[&bored]);
    // The ring ends in the block's own bottom plane: flush.
    scene.solid(2, &[&[Side(bore, true), Side(hole, false), block[4], Side(ring_end, true)]]);
    Blueprint {
        scene,
        volumes: vec![
            (4.0 - PI * outer * outer) * (top - bottom),
            PI * (outer * outer - inner * inner) * (ring_top - bottom),
        ],
        topology: vec![TORUS, TORUS, TORUS],
    }
}

fn bolt_in_plate() -> Blueprint {
    let (half, shank, head) = (0.3, 0.4, 0.68);
    // Along the bolt's axis, from its end: shank to the underside of the head, then the head.
    let (end, under, top) = (-0.66, 0.16, 0.66);
    let axis = rotation([8.0, 0.0, 25.0]) * DVec3::Z;
    let mut scene = Scene::default();
    let plate = scene.cuboid(DVec3::new(-1.0, -1.0, -half), DVec3::new(1.0, 1.0, half));
    let wall = cylinder(&mut scene, DVec3::ZERO, axis, shank);
    let rim = cylinder(&mut scene, DVec3::ZERO, axis, head);
    let [end_plane, under_plane, top_plane] = [end, under, top].map(|s| scene.plane(axis, s));
    scene.solid(1, &[&plate]);
    scene.solid(
        2,
        &[
            &[Side(wall, true), Side(end_plane, false), Side(under_plane, true)],
            &[Side(rim, true), Side(under_plane, false), Side(top_plane, true)],
        ],
    );
    // A cylinder cut obliquely holds what one cut straight across at the same point of its axis does.
    let reach = half / axis.z;
    let (shank_area, head_area) = (PI * shank * shank, PI * head * head);
    let in_plate = shank_area * (under + reach) + head_area * (reach - under);
    Blueprint {
        scene,
        volumes: vec![4.0 * 2.0 * half - in_plate, shank_area * (under - end) + head_area * (top - under)],
        topology: vec![BALL, TORUS, BALL],
    }
}

fn cube_in_cube() -> Blueprint {
    let (half, centre) = (0.55, DVec3::new(0.02, -0.03, 0.82));
    let turn = rotation([20.0, 12.0, 15.0]);
    let mut scene = Scene::default();
    let outer = scene.cuboid(DVec3::NEG_ONE, DVec3::ONE);
    let mut inner = Vec::new();
    for axis in [turn.x_axis, turn.y_axis, turn.z_axis] {
        for normal in [axis, -axis] {
            // The inner cube's own top lies wholly above the face and bounds nothing.
            if normal != turn.z_axis {
                inner.push(Side(scene.plane(normal, normal.dot(centre) + half), true));
            }
        }
    }
    inner.push(outer[5]);
    scene.solid(1, &[&outer]);
    scene.solid(2, &[&inner]);
    // Only the four side edges are cut: a prism, as long as its middle line.
    let iron = 4.0 * half * half * (half + (1.0 - centre.z) / turn.z_axis.z);
    Blueprint { scene, volumes: vec![8.0 - iron, iron], topology: vec![BALL, BALL, BALL] }
}

fn sphere_on_cylinder() -> Blueprint {
    let (wide, bottom, top) = (0.95, -0.9, 0.1);
    let (centre, radius) = (DVec3::new(0.08, 0.05, 0.25), 0.65);
    let mut scene = Scene::default();
    let wall = cylinder(&mut scene, DVec3::ZERO, DVec3::Z, wide);
    let low = scene.plane(DVec3::NEG_Z, -bottom);
    let high = scene.plane(DVec3::Z, top);
    let ball = scene.add(Surface::Sphere { centre, radius });
    scene.solid(1, &[&[Side(wall, true), Side(low, true), Side(high, true)]]);
    scene.solid(2, &[&[Side(ball, true)]]);
    let sunk = radius - (centre.z - top);
    let cap = PI * sunk * sunk * (3.0 * radius - sunk) / 3.0;
    Blueprint {
        scene,
        volumes: vec![PI * wide * wide * (top - bottom) - cap, 4.0 / 3.0 * PI * radius.powi(3)],
        topology: vec![BALL, BALL, BALL],
    }
}

fn four_materials() -> Blueprint {
    let (bottom, middle, top) = (-0.8, -0.05, 0.8);
    let mut scene = Scene::default();
    let wall = cylinder(&mut scene, DVec3::ZERO, DVec3::Z, 1.0);
    let low = scene.plane(DVec3::NEG_Z, -bottom);
    let floor = scene.plane(DVec3::Z, middle);
    let high = scene.plane(DVec3::Z, top);
    // Half-planes at 17, 137 and 257 degrees; a plane's inside is counter-clockwise of its half-plane.
    let [p, q, r] = [17.0, 137.0, 257.0].map(|degrees: f64| {
        let (sin, cos) = libm::sincos(degrees / 360.0 * TAU);
        scene.plane(DVec3::new(sin, -cos, 0.0), 0.0)
    });
    let sector = |from, to| {
        [Side(wall, true), Side(floor, false), Side(high, true), Side(from, true), Side(to, false)]
    };
    scene.solid(1, &[&sector(p, q)]);
    scene.solid(2, &[&sector(q, r)]);
    scene.solid(3, &[&[Side(wall, true), Side(low, true), Side(floor, true)]]);
    let third = PI / 3.0 * (top - middle);
    Blueprint { scene, volumes: vec![third, third, PI * (middle - bottom)], topology: vec![BALL; 4] }
}

/// A box of material 1.
fn cube(half: DVec3) -> Blueprint {
    let mut scene = Scene::default();
    let sides = scene.cuboid(-half, half);
    scene.solid(1, &[&sides]);
    Blueprint { scene, volumes: vec![8.0 * half.element_product()], topology: vec![BALL; 2] }
}

fn flush_cubes() -> Blueprint {
    let low = -0.1;
    let mut scene = Scene::default();
    let outer = scene.cuboid(DVec3::NEG_ONE, DVec3::ONE);
    // The three high faces are the outer cube's own: flush.
    let inner = [0, 1, 2].map(|a| Side(scene.plane(-DVec3::AXES[a], -low), true));
    scene.solid(1, &[&outer]);
    scene.solid(2, &[&[inner[0], outer[1], inner[1], outer[3], inner[2], outer[5]]]);
    let iron = (1.0 - low).powi(3);
    Blueprint { scene, volumes: vec![8.0 - iron, iron], topology: vec![BALL; 3] }
}

/// Two aluminium blocks, between them air or a layer of iron.
fn two_blocks(thickness: f64, filled: bool) -> Blueprint {
    let (half, height) = (0.5 * thickness, 0.8);
    let mut scene = Scene::default();
    let all = scene.cuboid(DVec3::new(-1.0, -1.0, -height), DVec3::new(1.0, 1.0, height));
    let low = scene.plane(DVec3::NEG_Z, half);
    let high = scene.plane(DVec3::Z, half);
    let sides = &all[..4];
    scene.solid(1, &[&[sides, &[all[4], Side(low, false)]].concat()]);
    scene.solid(1, &[&[sides, &[all[5], Side(high, false)]].concat()]);
    let blocks = 4.0 * (2.0 * height - thickness);
    if filled {
        scene.solid(2, &[&[sides, &[Side(low, true), Side(high, true)]].concat()]);
        let topology = vec![BALL, shell(2, 4), BALL];
        return Blueprint { scene, volumes: vec![blocks, 4.0 * thickness], topology };
    }
    Blueprint { scene, volumes: vec![blocks], topology: vec![shell(2, 4); 2] }
}

fn steps() -> Blueprint {
    let mut scene = Scene::default();
    let all = scene.cuboid(DVec3::new(-1.0, -1.0, -0.8), DVec3::new(1.0, 1.0, 0.8));
    // Step k reaches from its edge to the high end, so that steps overlap and share no inner face.
    let mut volume = 0.0;
    for k in 0..4_u8 {
        let step = f64::from(k);
        let (edge, height) = (-1.0 + 0.5 * step, -0.5 + step * 1.3 / 3.0);
        let mut sides = all.to_vec();
        if k > 0 {
            sides[0] = Side(scene.plane(DVec3::NEG_X, -edge), true);
        }
        if k < 3 {
            sides[5] = Side(scene.plane(DVec3::Z, height), true);
        }
        scene.solid(1, &[&sides]);
        volume += 0.5 * 2.0 * (height + 0.8);
    }
    Blueprint { scene, volumes: vec![volume], topology: vec![BALL; 2] }
}

fn sphere() -> Blueprint {
    let mut scene = Scene::default();
    let ball = scene.add(Surface::Sphere { centre: DVec3::ZERO, radius: 1.0 });
    scene.solid(1, &[&[Side(ball, true)]]);
    Blueprint { scene, volumes: vec![4.0 / 3.0 * PI], topology: vec![BALL; 2] }
}
