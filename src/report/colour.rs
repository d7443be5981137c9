//! Colours: of materials, of pairs of materials, of lines.

use serde::{Deserialize, Serialize};

use crate::grid::{MaterialId, Pair};

/// A colour: 8-bit sRGB red, green, blue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Rgb(pub u8, pub u8, pub u8);

impl Rgb {
    /// This colour with the share `t` (0 to 1) of it replaced by `other`.
    #[must_use]
    pub fn mix(self, other: Self, t: f32) -> Self {
        let blend = |a: u8, b: u8| to_byte(f32::from(a) + (f32::from(b) - f32::from(a)) * t);
        Self(blend(self.0, other.0), blend(self.1, other.1), blend(self.2, other.2))
    }

    /// This colour under `light` (1: unchanged) with a white `gloss` (0 to 1) added.
    pub(super) fn lit(self, light: f32, gloss: f32) -> Self {
        let shade = |a: u8| to_byte(f32::from(a) * light + 255.0 * gloss);
        Self(shade(self.0), shade(self.1), shade(self.2))
    }
}

/// Rounds to the nearest byte; what is out of range saturates.
fn to_byte(value: f32) -> u8 {
    (value + 0.5) as u8
}

/// White.
pub(super) const WHITE: Rgb = Rgb(255, 255, 255);
/// Text, frames, swatch borders, wires.
pub(super) const INK: Rgb = Rgb(38, 42, 48);
/// Junction curves and points.
pub(super) const JUNCTION: Rgb = Rgb(150, 12, 24);
/// Where an interface meets the volume's border.
pub(super) const BORDER: Rgb = Rgb(96, 100, 106);
/// Edges with one triangle only.
pub(super) const OPEN: Rgb = Rgb(20, 70, 230);

/// Bodies: the background first, then by id; ids beyond the list start over after the background.
const BODIES: [Rgb; 10] = [
    Rgb(214, 226, 236), // background
    Rgb(168, 184, 204), // aluminium-like
    Rgb(214, 134, 58),  // bronze
    Rgb(92, 158, 110),  // green
    Rgb(150, 112, 182), // violet
    Rgb(214, 192, 84),  // brass
    Rgb(84, 160, 184),  // teal
    Rgb(202, 106, 122), // rose
    Rgb(122, 130, 84),  // olive
    Rgb(112, 118, 196), // indigo
];

/// Outlines over a grey slice, against the background: saturated, and bright in every grey.
const OUTLINES: [Rgb; 10] = [
    Rgb(120, 220, 120),
    Rgb(0, 200, 255),
    Rgb(255, 176, 0),
    Rgb(70, 230, 90),
    Rgb(190, 130, 255),
    Rgb(255, 240, 60),
    Rgb(0, 235, 200),
    Rgb(255, 130, 150),
    Rgb(190, 210, 60),
    Rgb(130, 150, 255),
];

/// Outlines between two solids, by the order of their pairs.
const CONTACTS: [Rgb; 6] = [
    Rgb(255, 60, 200),
    Rgb(255, 90, 60),
    Rgb(160, 255, 60),
    Rgb(80, 120, 255),
    Rgb(255, 140, 240),
    Rgb(60, 255, 220),
];

/// The colours of materials.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Palette {
    /// Colour of each material by id, the background first; ids beyond the list start over at
    /// its second entry. Empty: the default colours.
    pub bodies: Vec<Rgb>,
}

impl Default for Palette {
    fn default() -> Self {
        Self { bodies: BODIES.to_vec() }
    }
}

impl Palette {
    /// The colour of a material.
    #[must_use]
    pub fn body(&self, id: MaterialId) -> Rgb {
        let list = if self.bodies.is_empty() { &BODIES[..] } else { &self.bodies };
        list[cycle(id, list.len())]
    }

    /// The colour of an interface in a shaded picture: against air that of the solid, between two
    /// solids a darker mix of both, at the volume's border a lighter shade.
    #[must_use]
    pub fn surface(&self, pair: Pair) -> Rgb {
        let back = self.body(pair.back());
        match pair.front() {
            MaterialId::OUTSIDE => self.cut_face(pair.back()),
            MaterialId::BACKGROUND => back,
            front => back.mix(self.body(front), 0.5).lit(0.72, 0.0),
        }
    }

    /// The colour of a material where it is cut: by the volume's border or by a cutting plane.
    #[must_use]
    pub fn cut_face(&self, id: MaterialId) -> Rgb {
        self.body(id).mix(WHITE, 0.38)
    }

    /// The colour of an interface's outline over a grey slice.
    #[must_use]
    pub fn outline(&self, pair: Pair) -> Rgb {
        let back = usize::from(pair.back().0);
        match pair.front() {
            MaterialId::OUTSIDE => OUTLINES[cycle(pair.back(), OUTLINES.len())].mix(WHITE, 0.55),
            MaterialId::BACKGROUND => OUTLINES[cycle(pair.back(), OUTLINES.len())],
            // Pairs of solids in order: (2,1) (3,1) (3,2) (4,1) ...
            front => {
                let order = back.saturating_sub(1) * back.saturating_sub(2) / 2 + usize::from(front.0) - 1;
                CONTACTS[order % CONTACTS.len()]
            }
        }
    }
}

/// Position of `id` in a list whose first entry is kept for the background.
fn cycle(id: MaterialId, len: usize) -> usize {
    match usize::from(id.0) {
        0 => 0,
        _ if len < 2 => 0,
        n => 1 + (n - 1) % (len - 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_has_a_colour_and_the_first_ones_differ() {
        let palette = Palette::default();
        for a in 0..=255 {
            for b in 0..a {
                if let Some(pair) = Pair::new(MaterialId(a), MaterialId(b)) {
                    let _ = (palette.surface(pair), palette.outline(pair));
                }
            }
        }
        let pairs = [(1, 0), (2, 0), (2, 1), (1, 255), (2, 255)]
            .map(|(a, b)| Pair::new(MaterialId(a), MaterialId(b)).unwrap());
        for (i, &p) in pairs.iter().enumerate() {
            for &q in &pairs[..i] {
                assert_ne!(palette.surface(p), palette.surface(q));
                assert_ne!(palette.outline(p), palette.outline(q));
            }
        }
        let one = Palette { bodies: vec![Rgb(1, 2, 3)] };
        assert_eq!(one.body(MaterialId(7)), Rgb(1, 2, 3));
        assert_eq!(Palette { bodies: vec![] }.body(MaterialId(2)), BODIES[2]);
    }
}
