//! Tests of [`slice_picture`] on blocks of cubes.

use super::super::render::tests::blocks;
use super::*;
use crate::grid::{Geometry, Pair};
use crate::volume::{MemorySource, Samples};

/// Voxels of 2 mm x 1 mm x 1 mm, turned by 90 degrees about z in the world, with a mesh of 2 x 2 x 2
/// unit cubes somewhere in it: aluminium below x = 1, bronze above.
fn volume() -> MemorySource {
    let direction = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    // World (x, y) = (1 - j, 2 i - 1): the block [0, 2]^2 is i in 0.5..1.5, j in -1..1.
    let geometry = Geometry::new([4, 6, 5], [2.0, 1.0, 1.0], [4.0, -1.0, -1.0], direction).unwrap();
    let samples = (0..120).map(|i| if i % 4 < 2 { 10 } else { 200 }).collect();
    MemorySource::new(geometry, Samples::U8(samples)).unwrap()
}

fn options() -> SliceOptions {
    SliceOptions { index: 2, zoom: 8, legend: false, window: [0.0, 100.0], ..SliceOptions::default() }
}

#[test]
fn grey_values_are_stretched_and_true_to_scale() {
    let picture = slice_picture(&volume(), None, &options()).unwrap();
    assert_eq!([picture.width(), picture.height()], [64, 48]);
    assert_eq!(picture.pixel(31, 10), Some((Rgb(0, 0, 0), 255)));
    assert_eq!(picture.pixel(32, 10), Some((Rgb(255, 255, 255), 255)));
    let crop = SliceOptions { crop: Some([[1, 3], [2, 3]]), ..options() };
    let picture = slice_picture(&volume(), None, &crop).unwrap();
    assert_eq!([picture.width(), picture.height()], [32, 8]);
    assert_eq!(picture.pixel(15, 0).map(|p| p.0), Some(Rgb(0, 0, 0)));
    assert_eq!(picture.pixel(16, 0).map(|p| p.0), Some(Rgb(255, 255, 255)));
}

#[test]
fn the_outline_hits_its_pixels_with_the_colours_of_its_pairs() {
    let mesh = blocks(2, |x, _, _| 1 + x as u8);
    // Slice z index 2 is world z = 1: exactly on a layer of the mesh's vertices.
    let picture =
        slice_picture(&volume(), Some(&mesh), &SliceOptions { junctions: false, ..options() }).unwrap();
    let at = |world_x: f64, world_y: f64| {
        let (i, j) = ((world_y + 1.0) / 2.0, 4.0 - world_x);
        let (x, y) = ((i + 0.5) * 16.0, (j + 0.5) * 8.0);
        // A line of 1.6 pixels on a pixel border covers the pixels on both sides of it.
        picture.pixel(x as usize, y as usize).unwrap().0
    };
    let outline = |a, b| Palette::default().outline(Pair::new(MaterialId(a), MaterialId(b)).unwrap());
    let near = |seen: Rgb, wanted: Rgb| {
        [(seen.0, wanted.0), (seen.1, wanted.1), (seen.2, wanted.2)].iter().all(|&(a, b)| a.abs_diff(b) < 90)
    };
    assert!(near(at(0.5, 0.0), outline(1, 0)));
    assert!(near(at(0.5, 2.0), outline(1, 0)));
    assert!(near(at(1.5, 2.0), outline(2, 0)));
    assert!(near(at(1.0, 1.0), outline(2, 1)));
    assert!(near(at(0.0, 1.0), outline(1, 0)));
    assert!(near(at(2.0, 0.6), outline(2, 0)));
    assert_eq!(at(3.0, 1.0).0, at(3.0, 1.0).1, "grey beyond the block");
    // Both ends of the contact are junctions.
    let picture = slice_picture(&volume(), Some(&mesh), &options()).unwrap();
    let dots = [(16, 28), (32, 28)].map(|(x, y)| picture.pixel(x, y).unwrap().0);
    assert_eq!(dots, [DOT; 2]);
}

#[test]
fn the_legend_stands_below_the_slice() {
    let mesh = blocks(2, |x, _, _| 1 + x as u8);
    let bare = slice_picture(&volume(), Some(&mesh), &options()).unwrap();
    let whole = slice_picture(&volume(), Some(&mesh), &SliceOptions { legend: true, ..options() }).unwrap();
    assert!(whole.height() > bare.height() && whole.width() >= bare.width());
    for y in 0..bare.height() {
        for x in 0..bare.width() {
            assert_eq!(whole.pixel(x, y), bare.pixel(x, y));
        }
    }
    let contact = Palette::default().outline(Pair::new(MaterialId(2), MaterialId(1)).unwrap());
    let below = &whole.rgba()[4 * whole.width() * bare.height()..];
    for colour in [contact, DOT] {
        assert!(below.chunks_exact(4).any(|p| [p[0], p[1], p[2]] == [colour.0, colour.1, colour.2]));
    }
}

#[test]
fn slices_and_crops_that_do_not_exist_are_refused() {
    let error = |options: SliceOptions| slice_picture(&volume(), None, &options).unwrap_err();
    let bad = SliceOptions { index: 5, ..options() };
    assert!(matches!(error(bad), PictureError::Slice { axis: 'z', index: 5, last: 4 }));
    let bad = SliceOptions { crop: Some([[1, 1], [0, 2]]), ..options() };
    assert!(matches!(error(bad), PictureError::Crop { .. }));
    let bad = SliceOptions { crop: Some([[0, 5], [0, 2]]), ..options() };
    assert!(matches!(error(bad), PictureError::Crop { .. }));
    let bad = SliceOptions { zoom: 0, ..options() };
    assert!(matches!(error(bad), PictureError::Option { .. }));
    let bad = SliceOptions { window: [60.0, 40.0], ..options() };
    assert!(matches!(error(bad), PictureError::Option { .. }));
}
