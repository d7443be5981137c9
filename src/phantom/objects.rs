//! The test objects themselves: surfaces, solids, exact volumes, topology; in their own units.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::catalogue::Topology;
use super::scene::{Scene, Side};
use super::surface::{Surface, rotation};

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
    /// Degrees of the aluminium wedge.
    pub(super) angle: f64,
    /// Radius of rounded edges.
    pub(super) fillet: f64,
    /// The edge of the cube with a voxel's volume, for parts whose size is given in voxels.
    pub(super) voxel: f64,
}

/// A shell of this many components and this Euler characteristic.
const fn shell(components: usize, euler: i64) -> Topology {
    Topology { components, euler }
}
const BALL: Topology = shell(1, 2);
const TORUS: Topology = shell(1, 0);

fn cylinder(scene: &mut Scene, point: DVec3, axis: DVec3, radius: f64) -> usize {
    scene.add(Surface::Cylinder { point, axis, radius })
}

pub(super) fn press_fit_ring() -> Blueprint {
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

pub(super) fn bolt_in_plate() -> Blueprint {
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

pub(super) fn cube_in_cube() -> Blueprint {
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

pub(super) fn sphere_on_cylinder() -> Blueprint {
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

pub(super) fn four_materials() -> Blueprint {
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
pub(super) fn cube(half: DVec3) -> Blueprint {
    let mut scene = Scene::default();
    let sides = scene.cuboid(-half, half);
    scene.solid(1, &[&sides]);
    Blueprint { scene, volumes: vec![8.0 * half.element_product()], topology: vec![BALL; 2] }
}

pub(super) fn flush_cubes() -> Blueprint {
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
pub(super) fn two_blocks(thickness: f64, filled: bool) -> Blueprint {
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

pub(super) fn steps() -> Blueprint {
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

pub(super) fn sphere() -> Blueprint {
    let mut scene = Scene::default();
    let ball = scene.add(Surface::Sphere { centre: DVec3::ZERO, radius: 1.0 });
    scene.solid(1, &[&[Side(ball, true)]]);
    Blueprint { scene, volumes: vec![4.0 / 3.0 * PI], topology: vec![BALL; 2] }
}

/// An iron block with an aluminium bar on it, whose long sides are inclined by the angle.
pub(super) fn wedge(angle: f64) -> Blueprint {
    let (foot, length) = (WEDGE_FOOT, 0.8);
    let (sin, cos) = libm::sincos(angle.to_radians());
    // An acute bar would end in an edge; it is cut off below, so that its top is no part of what it shows.
    let height = if cos > 0.0 { WEDGE_HEIGHT.min(0.8 * foot * sin / cos) } else { WEDGE_HEIGHT };
    let top = foot - height * cos / sin;
    let mut scene = Scene::default();
    let block = scene.cuboid(DVec3::new(-1.0, -1.0, WEDGE_BOTTOM), DVec3::new(1.0, 1.0, WEDGE_FLOOR));
    let floor = block[5].0;
    let high = scene.plane(DVec3::Z, WEDGE_FLOOR + height);
    let ends = [DVec3::Y, DVec3::NEG_Y].map(|normal| scene.plane(normal, length));
    let slopes = [1.0, -1.0].map(|sign| {
        let normal = DVec3::new(sign * sin, 0.0, cos);
        scene.plane(normal, normal.dot(DVec3::new(sign * foot, 0.0, WEDGE_FLOOR)))
    });
    let mut bar = vec![Side(floor, false), Side(high, true)];
    bar.extend(ends.iter().chain(&slopes).map(|&surface| Side(surface, true)));
    scene.solid(1, &[&bar]);
    scene.solid(2, &[&block]);
    Blueprint {
        scene,
        volumes: vec![2.0 * length * height * (foot + top), 4.0 * (WEDGE_FLOOR - WEDGE_BOTTOM)],
        topology: vec![BALL; 3],
    }
}

/// Half the width of the bar's foot, its greatest height, and where the iron block ends.
const WEDGE_FOOT: f64 = 0.7;
const WEDGE_HEIGHT: f64 = 0.4;
const WEDGE_BOTTOM: f64 = -0.55;
const WEDGE_FLOOR: f64 = 0.15;

/// An aluminium block with the edges along z rounded.
pub(super) fn fillet(radius: f64) -> Blueprint {
    let half = FILLET_HALF;
    let mut scene = Scene::default();
    let block = scene.cuboid(-half, half);
    // Where the rounding begins.
    let [left, right, front, back] =
        [(DVec3::NEG_X, half.x), (DVec3::X, half.x), (DVec3::NEG_Y, half.y), (DVec3::Y, half.y)]
            .map(|(normal, reach)| Side(scene.plane(normal, reach - radius), true));
    let wide = [block[0], block[1], front, back, block[4], block[5]];
    let deep = [left, right, block[2], block[3], block[4], block[5]];
    let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)].map(|(x, y)| {
        let axis = DVec3::new(x * (half.x - radius), y * (half.y - radius), 0.0);
        [Side(cylinder(&mut scene, axis, DVec3::Z, radius), true), block[4], block[5]]
    });
    let [a, b, c, d] = &corners;
    scene.solid(1, &[&wide, &deep, a, b, c, d]);
    let area = 4.0 * half.x * half.y - (4.0 - PI) * radius * radius;
    Blueprint { scene, volumes: vec![2.0 * half.z * area], topology: vec![BALL; 2] }
}

/// Half the edges of the block with rounded edges.
pub(super) const FILLET_HALF: DVec3 = DVec3::new(1.0, 0.85, 0.9);

/// An aluminium block with round pores and iron balls in it.
pub(super) fn pores(voxel: f64) -> Blueprint {
    let mut scene = Scene::default();
    let block = scene.cuboid(-PORES_HALF, PORES_HALF);
    scene.solid(1, &[&block]);
    let place = |k: usize| {
        let sign = |bit: usize| if k >> bit & 1 == 1 { 1.0 } else { -1.0 };
        // Off the middle of each octant: no two lie alike to the lattice.
        0.5 * PORES_HALF * DVec3::new(sign(0), sign(1), sign(2))
            + 0.02 * DVec3::new(k as f64 - 3.0, 1.0, -0.5)
    };
    let mut iron = 0.0;
    for (k, radius) in PORE_RADII.iter().enumerate() {
        // A pore and, across the block's middle, a ball of the same radius.
        for (place, material) in [(place(k), 0), (place(7 - k), 2)] {
            let ball = scene.add(Surface::Sphere { centre: place, radius: radius * voxel });
            scene.solid(material, &[&[Side(ball, true)]]);
        }
        iron += 4.0 / 3.0 * PI * (radius * voxel).powi(3);
    }
    let count = PORE_RADII.len();
    let euler = |components: usize| shell(components, 2 * components as i64);
    Blueprint {
        scene,
        volumes: vec![8.0 * PORES_HALF.element_product() - 2.0 * iron, iron],
        topology: vec![euler(1 + count), euler(1 + 2 * count), euler(count)],
    }
}

/// Radii of the pores and of the iron balls, voxels.
const PORE_RADII: [f64; 3] = [2.0, 3.0, 4.0];
/// Half the edges of the block with pores.
pub(super) const PORES_HALF: DVec3 = DVec3::new(1.0, 0.95, 0.9);
/// The largest voxel, in units of the block, at which every pore keeps two voxels from the block's faces.
pub(super) const PORES_VOXEL: f64 = 0.41 / 6.0;
