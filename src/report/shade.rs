//! How what is seen is coloured: light, hatching, wires, lines.

use glam::DVec3;

use super::Rgb;
use super::camera::Camera;
use super::colour::{BORDER, JUNCTION, OPEN, WHITE};
use super::edges::EdgeMark;
use crate::grid::MaterialId;

/// Width of a wire in pixels, in a picture of 800: thinner than any marked edge, so that these stand out.
const WIRE_WIDTH: f32 = 0.8;

/// Colour of a line.
pub(super) fn line_colour(mark: EdgeMark) -> Rgb {
    match mark {
        EdgeMark::Border => BORDER,
        EdgeMark::Junction => JUNCTION,
        EdgeMark::Open => OPEN,
    }
}

/// A triangle's colour in the light, which is fixed to the camera: a key light from the upper left, a weak
/// one from the right, and ambient light from above. A surface seen from its back is darker.
pub(super) fn lit(colour: Rgb, [a, b, c]: [DVec3; 3], camera: &Camera) -> Rgb {
    let normal = camera.turn((b - a).cross(c - a).normalize_or_zero());
    let (normal, inside) = if normal.z < 0.0 { (-normal, 0.78) } else { (normal, 1.0) };
    let key = DVec3::new(-0.42, 0.42, 0.80).normalize();
    let fill = DVec3::new(0.80, 0.10, 0.55).normalize();
    let ambient = 0.45 + 0.06 * normal.y;
    let light = ambient + 0.60 * normal.dot(key).max(0.0) + 0.19 * normal.dot(fill).max(0.0);
    let half = (key + DVec3::Z).normalize();
    let gloss = 0.14 * normal.dot(half).max(0.0).powi(28);
    let shaded = colour.lit((light * inside) as f32, (gloss * inside) as f32);
    // A hint of haze keeps the darkest sides apart from the ink of lines.
    shaded.mix(WHITE, 0.03)
}

/// Diagonal lines over a cut face: rising for materials of even id, falling for odd ones, and
/// wider apart for higher ones, so that neighbours in a section differ. `at` is the sample, of which
/// there are `per_pixel` along a pixel's side; `unit` grows with the picture.
pub(super) fn hatched(tone: Rgb, id: MaterialId, at: [usize; 2], per_pixel: usize, unit: f64) -> Rgb {
    let wider = 1.0 + 0.5 * f64::from(id.0 / 2 % 3);
    let pitch = (8.0 * wider * unit).round() as usize * per_pixel;
    let [x, y] = at;
    let along = if id.0.is_multiple_of(2) { x + y } else { x + pitch * y - y };
    if along % pitch < per_pixel { tone.lit(0.82, 0.0) } else { tone }
}

/// How much ink (0 to 1) the wires of a triangle with these corners (in samples) leave at a sample.
pub(super) fn wire(corners: [[f32; 2]; 3], at: [usize; 2], per_pixel: usize, unit: f64) -> f32 {
    let p = at.map(|v| v as f32 + 0.5);
    let (mut nearest, mut longest) = (f32::INFINITY, 0.0f32);
    for k in 0..3 {
        let (a, b) = (corners[k], corners[(k + 1) % 3]);
        let d = [b[0] - a[0], b[1] - a[1]];
        let length = (d[0] * d[0] + d[1] * d[1]).sqrt().max(1e-6);
        nearest = nearest.min(((p[0] - a[0]) * d[1] - (p[1] - a[1]) * d[0]).abs() / length);
        longest = longest.max(length);
    }
    // Wires of triangles of a few pixels would merge into one dark blot: fade them out.
    let strength = 0.8 * ((longest / per_pixel as f32 - 1.0) / 7.0).clamp(0.0, 1.0);
    // A sample's share of the line, of which each of the two triangles at an edge draws its half.
    let half = (0.5 * WIRE_WIDTH * unit as f32).max(0.5) * per_pixel as f32;
    strength * (half + 0.5 - nearest).clamp(0.0, 1.0)
}
