//! Flat drawing on a picture: lines, dots, boxes, text. Everything is clipped to the picture.

use super::font;
use super::{Picture, Rgb};

impl Picture {
    /// Covers the share `alpha` (0 to 1) of a pixel with a colour; pixels beyond the picture are
    /// skipped.
    pub(super) fn blend(&mut self, x: i64, y: i64, colour: Rgb, alpha: f32) {
        if x < 0 || y < 0 || x >= self.width() as i64 || y >= self.height() as i64 || alpha <= 0.0 {
            return;
        }
        let i = 4 * (y as usize * self.width() + x as usize);
        let pixel = &mut self.rgba_mut()[i..i + 4];
        let below = f32::from(pixel[3]) / 255.0;
        let alpha = alpha.min(1.0);
        let total = alpha + below * (1.0 - alpha);
        let mixed = Rgb(pixel[0], pixel[1], pixel[2]).mix(colour, alpha / total);
        pixel.copy_from_slice(&[mixed.0, mixed.1, mixed.2, (255.0 * total + 0.5) as u8]);
    }

    /// Lines with round ends, anti-aliased, as one stroke: where they touch or overlap nothing is
    /// covered twice. Pixel (i, j) has its centre at (i + 0.5, j + 0.5).
    pub(super) fn stroke(&mut self, lines: &[[[f64; 2]; 2]], width: f64, colour: Rgb) {
        let columns = self.width();
        let mut cover = vec![0.0f32; columns * self.height()];
        for &ends in lines {
            each_covered([columns, self.height()], ends, width, |x, y, alpha| {
                let c = &mut cover[y * columns + x];
                *c = c.max(alpha);
            });
        }
        for (i, alpha) in cover.into_iter().enumerate().filter(|(_, alpha)| *alpha > 0.0) {
            self.blend((i % columns) as i64, (i / columns) as i64, colour, alpha);
        }
    }

    /// A filled disc, anti-aliased.
    pub(super) fn disc(&mut self, centre: [f64; 2], radius: f64, colour: Rgb) {
        let size = [self.width(), self.height()];
        each_covered(size, [centre; 2], 2.0 * radius, |x, y, alpha| {
            self.blend(x as i64, y as i64, colour, alpha);
        });
    }

    /// A filled box of `size` pixels whose upper left pixel is `at`.
    pub(super) fn fill(&mut self, at: [i64; 2], size: [i64; 2], colour: Rgb, alpha: f32) {
        for y in at[1]..at[1] + size[1] {
            for x in at[0]..at[0] + size[0] {
                self.blend(x, y, colour, alpha);
            }
        }
    }

    /// A line of text whose upper left pixel is `at`; a dot of the font is `scale` pixels wide.
    pub(super) fn text(&mut self, at: [i64; 2], scale: usize, text: &str, colour: Rgb) {
        let scale = scale as i64;
        for (k, c) in text.chars().enumerate() {
            let left = at[0] + (k * font::ADVANCE) as i64 * scale;
            for (row, bits) in font::glyph(c).into_iter().enumerate() {
                for column in (0..font::WIDTH).filter(|c| bits >> (font::WIDTH - 1 - c) & 1 == 1) {
                    let dot = [left + column as i64 * scale, at[1] + row as i64 * scale];
                    self.fill(dot, [scale, scale], colour, 1.0);
                }
            }
        }
    }
}

/// Calls `cover` with every pixel of a picture of `size` that a line with round ends covers, and how
/// much of it (0 to 1).
fn each_covered(
    size: [usize; 2],
    [a, b]: [[f64; 2]; 2],
    width: f64,
    mut cover: impl FnMut(usize, usize, f32),
) {
    let reach = 0.5 * width + 0.5;
    let range = |k: usize| {
        let low = (a[k].min(b[k]) - reach).floor().max(0.0) as usize;
        let high = (a[k].max(b[k]) + reach).ceil().clamp(0.0, size[k] as f64) as usize;
        low..high
    };
    let d = [b[0] - a[0], b[1] - a[1]];
    let length2 = d[0] * d[0] + d[1] * d[1];
    for y in range(1) {
        for x in range(0) {
            let p = [x as f64 + 0.5 - a[0], y as f64 + 0.5 - a[1]];
            let along = if length2 > 0.0 { (p[0] * d[0] + p[1] * d[1]) / length2 } else { 0.0 };
            let t = along.clamp(0.0, 1.0);
            let off = [p[0] - t * d[0], p[1] - t * d[1]];
            let alpha = (reach - (off[0] * off[0] + off[1] * off[1]).sqrt()).clamp(0.0, 1.0);
            if alpha > 0.0 {
                cover(x, y, alpha as f32);
            }
        }
    }
}

/// Pixels a line of text is wide.
pub(super) fn text_width(text: &str, scale: usize) -> i64 {
    (text.chars().count() * font::ADVANCE * scale) as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Background;

    #[test]
    fn a_line_covers_its_pixels_and_is_clipped() {
        let mut picture = Picture::new(10, 10, Background::White).unwrap();
        picture.stroke(&[[[-50.0, 4.5], [50.0, 4.5]]], 1.0, Rgb(0, 0, 0));
        for x in 0..10 {
            assert_eq!(picture.pixel(x, 4), Some((Rgb(0, 0, 0), 255)));
            assert_eq!(picture.pixel(x, 6), Some((Rgb(255, 255, 255), 255)));
        }
    }

    #[test]
    fn drawing_on_nothing_keeps_the_colour_and_raises_alpha() {
        let mut picture = Picture::new(2, 1, Background::Transparent).unwrap();
        picture.blend(0, 0, Rgb(10, 20, 30), 0.5);
        assert_eq!(picture.pixel(0, 0), Some((Rgb(10, 20, 30), 128)));
        assert_eq!(picture.pixel(1, 0).map(|p| p.1), Some(0));
    }

    #[test]
    fn text_is_made_of_dots() {
        let mut picture = Picture::new(12, 7, Background::White).unwrap();
        picture.text([0, 0], 1, "L-", Rgb(0, 0, 0));
        assert_eq!(picture.pixel(0, 0).map(|p| p.0), Some(Rgb(0, 0, 0)));
        assert_eq!(picture.pixel(1, 0).map(|p| p.0), Some(Rgb(255, 255, 255)));
        assert_eq!(picture.pixel(4, 6).map(|p| p.0), Some(Rgb(0, 0, 0)));
        assert_eq!(picture.pixel(8, 3).map(|p| p.0), Some(Rgb(0, 0, 0)));
        assert_eq!(text_width("L-", 2), 24);
    }
}
