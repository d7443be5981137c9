//! Several pictures side by side, each with a line of text below it.

use super::colour::INK;
use super::draw::text_width;
use super::font;
use super::{Background, Picture, PictureError};

/// Pictures of equal size in rows of `columns`, each with its caption below it, on white. What a picture has of
/// transparency stays.
///
/// # Errors
/// [`PictureError::Size`] if there is no picture or they differ in size (with the size of the first that is
/// different), or if the sheet would be larger than [`Picture::MAX_SIDE`].
pub fn sheet(tiles: &[(Picture, String)], columns: usize) -> Result<Picture, PictureError> {
    let size = |p: &Picture| (p.width(), p.height());
    let first = tiles.first().map_or((0, 0), |tile| size(&tile.0));
    if let Some((width, height)) = tiles.iter().map(|t| size(&t.0)).find(|s| *s != first) {
        return Err(PictureError::Size { width, height, limit: Picture::MAX_SIDE });
    }
    let columns = columns.clamp(1, tiles.len().max(1));
    let scale = (first.1 / 200).clamp(1, 6);
    // The caption, and twice its height of white around it.
    let pitch = first.1 + 3 * font::HEIGHT * scale;
    let (width, height) = (columns * first.0, tiles.len().div_ceil(columns) * pitch);
    let mut out = Picture::new(width, height, Background::White)?;
    for (k, (tile, caption)) in tiles.iter().enumerate() {
        let (left, top) = (k % columns * first.0, k / columns * pitch);
        let rows = tile.rgba().chunks_exact(4 * first.0);
        for (y, row) in rows.enumerate() {
            let start = 4 * ((top + y) * width + left);
            out.rgba_mut()[start..start + row.len()].copy_from_slice(row);
        }
        let middle = left as i64 + (first.0 as i64 - text_width(caption, scale)) / 2;
        out.text([middle, (top + first.1 + font::HEIGHT * scale) as i64], scale, caption, INK);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Rgb;

    #[test]
    fn tiles_stand_in_rows_above_their_captions_and_unequal_ones_are_refused() {
        let tile = |tone: u8| {
            let mut picture = Picture::new(40, 30, Background::White).unwrap();
            picture.rgba_mut().fill(tone);
            picture
        };
        let tiles: Vec<(Picture, String)> = [10, 20, 30].map(|t| (tile(t), "LLL".to_owned())).into();
        let sheet_of_three = sheet(&tiles, 2).unwrap();
        assert_eq!((sheet_of_three.width(), sheet_of_three.height()), (80, 2 * 51));
        let tone = |x, y| sheet_of_three.pixel(x, y).map(|p| p.0);
        assert_eq!(tone(39, 29), Some(Rgb(10, 10, 10)));
        assert_eq!(tone(40, 0), Some(Rgb(20, 20, 20)));
        assert_eq!(tone(0, 51), Some(Rgb(30, 30, 30)));
        assert_eq!(tone(40, 51), Some(Rgb(255, 255, 255)));
        // The first upright of the first letter of the first caption.
        assert_eq!(tone(11, 37), Some(INK));
        let unequal = [tiles[0].clone(), (Picture::new(3, 3, Background::White).unwrap(), String::new())];
        assert!(matches!(sheet(&unequal, 2), Err(PictureError::Size { width: 3, .. })));
        assert!(sheet(&[], 2).is_err());
    }
}
