//! Tests of [`render`] on blocks of cubes.

use super::super::Rgb;
use super::*;
use crate::grid::{Pair, VertexKind};
use crate::mesh::MeshMaterial;
use crate::report::colour::{JUNCTION, OPEN, WHITE};

/// The interfaces of a block of unit cubes of materials, `label(x, y, z)` for x, y, z in
/// `0..size`, air around it.
pub(in crate::report) fn blocks(size: usize, label: impl Fn(usize, usize, usize) -> u8) -> InterfaceMesh {
    let at = |c: [i64; 3]| {
        let inside = c.iter().all(|&v| v >= 0 && v < size as i64);
        if inside { label(c[0] as usize, c[1] as usize, c[2] as usize) } else { 0 }
    };
    let n = size as u32 + 1;
    let (mut triangles, mut pairs) = (Vec::new(), Vec::new());
    for z in 0..size as i64 + 1 {
        for y in 0..size as i64 + 1 {
            for x in 0..size as i64 + 1 {
                for axis in 0..3 {
                    let here = [x, y, z];
                    let mut below = here;
                    below[axis] -= 1;
                    let (low, high) = (MaterialId(at(below)), MaterialId(at(here)));
                    let Some(pair) = Pair::new(low, high) else { continue };
                    // The face's corners, counter-clockwise seen from the higher side of the axis.
                    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                    let mut ring = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[du, dv]| {
                        let mut c = here.map(|v| v as u32);
                        c[u] += du;
                        c[v] += dv;
                        c[0] + n * (c[1] + n * c[2])
                    });
                    if pair.front() == low {
                        ring.reverse();
                    }
                    triangles.extend([[ring[0], ring[1], ring[2]], [ring[0], ring[2], ring[3]]]);
                    pairs.extend([pair; 2]);
                }
            }
        }
    }
    let positions: Vec<DVec3> = (0..n * n * n)
        .map(|i| DVec3::new(f64::from(i % n), f64::from(i / n % n), f64::from(i / n / n)))
        .collect();
    let kinds = vec![VertexKind::Interface; positions.len()];
    let materials = ["air", "aluminium", "bronze"]
        .iter()
        .enumerate()
        .map(|(i, name)| MeshMaterial { id: MaterialId(i as u8), name: (*name).into(), mean: i as f64 })
        .collect();
    InterfaceMesh::new(positions, kinds, triangles, pairs, materials).unwrap()
}

/// Two cubes side by side: aluminium at low x, bronze at high x (the block is 2 x 2 x 2).
fn two() -> InterfaceMesh {
    blocks(2, |x, _, _| 1 + x as u8)
}

fn front(only: &[u8]) -> RenderOptions {
    RenderOptions {
        width: 100,
        height: 100,
        azimuth: 0.0,
        elevation: 0.0,
        legend: false,
        only: only.iter().map(|&id| MaterialId(id)).collect(),
        ..RenderOptions::default()
    }
}

fn colour(picture: &Picture, x: usize, y: usize) -> Rgb {
    picture.pixel(x, y).unwrap().0
}

/// Same hue, whatever the light: channels in the same order and about the same ratio.
fn is_shade_of(seen: Rgb, colour: Rgb) -> bool {
    let ratios = [(seen.0, colour.0), (seen.1, colour.1), (seen.2, colour.2)]
        .map(|(a, b)| f64::from(a) / f64::from(b));
    ratios.iter().all(|r| (r / ratios[0] - 1.0).abs() < 0.25) && ratios[0] > 0.25 && ratios[0] < 1.4
}

#[test]
fn two_materials_have_their_colours_and_the_junction_between_them_is_red() {
    let picture = render(&two(), &front(&[])).unwrap();
    let palette = Palette::default();
    assert!(is_shade_of(colour(&picture, 25, 50), palette.body(MaterialId(1))));
    assert!(is_shade_of(colour(&picture, 75, 50), palette.body(MaterialId(2))));
    assert_eq!(colour(&picture, 50, 50), JUNCTION);
    assert_eq!(colour(&picture, 2, 50), WHITE);
    let plain = render(&two(), &RenderOptions { junctions: false, ..front(&[]) }).unwrap();
    assert_eq!(colour(&plain, 49, 50), colour(&plain, 25, 50));
    assert_eq!(colour(&plain, 50, 50), colour(&plain, 75, 50));
}

#[test]
fn what_lies_behind_is_hidden_with_its_junction_curves() {
    // From +x only bronze is seen, in one colour: no aluminium, no red.
    let picture = render(&two(), &RenderOptions { azimuth: 90.0, ..front(&[]) }).unwrap();
    let face = colour(&picture, 50, 50);
    assert!(is_shade_of(face, Palette::default().body(MaterialId(2))));
    for y in 12..88 {
        for x in 12..88 {
            assert_eq!(colour(&picture, x, y), face, "{x} {y}");
        }
    }
    // Without bronze the contact is seen from there, and its rim is the junction curve.
    let picture = render(&two(), &RenderOptions { azimuth: 90.0, ..front(&[1]) }).unwrap();
    let contact = Palette::default().surface(Pair::new(MaterialId(1), MaterialId(2)).unwrap());
    assert!(is_shade_of(colour(&picture, 50, 50), contact));
}

#[test]
fn a_cut_opens_the_block_and_caps_show_its_materials() {
    // Bronze core in aluminium; cut across y through the core, seen from -y.
    let mesh = blocks(3, |x, y, z| if (x, y, z) == (1, 1, 1) { 2 } else { 1 });
    let palette = Palette::default();
    let cut = Some(Cut { axis: 1, position: 1.5 });
    let options = RenderOptions { cut, junctions: false, ..front(&[]) };
    let whole = render(&mesh, &RenderOptions { cut: None, ..options.clone() }).unwrap();
    let open = render(&mesh, &options).unwrap();
    let capped = render(&mesh, &RenderOptions { caps: true, ..options }).unwrap();
    assert!(is_shade_of(colour(&whole, 50, 50), palette.body(MaterialId(1))));
    let contact = palette.surface(Pair::new(MaterialId(1), MaterialId(2)).unwrap());
    assert!(is_shade_of(colour(&open, 50, 50), contact));
    assert!(is_shade_of(colour(&open, 20, 20), palette.body(MaterialId(1))));
    assert!(is_shade_of(colour(&capped, 50, 50), palette.cut_face(MaterialId(2))));
    assert!(is_shade_of(colour(&capped, 20, 20), palette.cut_face(MaterialId(1))));
    assert_ne!(colour(&open, 20, 20), colour(&whole, 20, 20), "the far wall is seen from inside");
}

#[test]
fn the_border_is_lighter_and_air_at_the_border_is_left_out() {
    // The two front faces of the pair of cubes belong to the volume's border.
    let mesh = two();
    let border = |t: &[u32; 3]| t.iter().all(|&v| mesh.positions()[v as usize].y < 0.5);
    let pairs = mesh.triangles().iter().zip(mesh.pairs()).map(|(t, &pair)| {
        if border(t) { Pair::new(pair.back(), MaterialId::OUTSIDE).unwrap() } else { pair }
    });
    let mut pairs: Vec<Pair> = pairs.collect();
    let remake = |triangles: &[[u32; 3]], pairs: &[Pair]| {
        let (p, k) = (mesh.positions().to_vec(), mesh.kinds().to_vec());
        InterfaceMesh::new(p, k, triangles.to_vec(), pairs.to_vec(), mesh.materials().to_vec()).unwrap()
    };
    let options = RenderOptions { junctions: false, ..front(&[]) };
    let plain = render(&mesh, &options).unwrap();
    let cut = render(&remake(mesh.triangles(), &pairs), &options).unwrap();
    let sum = |p: &Picture| p.rgba().iter().map(|v| u64::from(*v)).sum::<u64>();
    assert!(sum(&cut) > sum(&plain));
    // A sheet of air against the border, in front of all: not drawn unless asked for.
    let mut triangles = mesh.triangles().to_vec();
    triangles.push([0, 2, 26]);
    pairs.push(Pair::new(MaterialId::BACKGROUND, MaterialId::OUTSIDE).unwrap());
    let with_sheet = remake(&triangles, &pairs);
    let options = RenderOptions { open_edges: false, ..options };
    assert_eq!(render(&with_sheet, &options).unwrap(), cut);
    assert_ne!(render(&with_sheet, &RenderOptions { only: vec![MaterialId(0)], ..options }).unwrap(), cut);
}

#[test]
fn open_edges_are_blue_and_a_clear_background_is_clear() {
    let mesh = two();
    let (kinds, materials) = (mesh.kinds().to_vec(), mesh.materials().to_vec());
    let one = mesh.triangles()[..1].to_vec();
    let sheet =
        InterfaceMesh::new(mesh.positions().to_vec(), kinds, one, mesh.pairs()[..1].to_vec(), materials)
            .unwrap();
    let options = RenderOptions { background: Background::Transparent, ..front(&[]) };
    let options = RenderOptions { azimuth: 20.0, elevation: 40.0, ..options };
    let picture = render(&sheet, &options).unwrap();
    let blue =
        (0..100).flat_map(|y| (0..100).map(move |x| (x, y))).filter(|&(x, y)| colour(&picture, x, y) == OPEN);
    assert!(blue.count() > 50);
    assert_eq!(picture.pixel(0, 0).map(|p| p.1), Some(0));
}

#[test]
fn one_thread_and_four_give_the_same_bytes() {
    let mesh = blocks(12, |x, y, z| ((x * 7 + y * 5 + z * 3) % 5 % 3) as u8);
    let options = RenderOptions {
        width: 231,
        height: 170,
        wireframe: true,
        cut: Some(Cut { axis: 0, position: 7.3 }),
        caps: true,
        ..RenderOptions::default()
    };
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render(&mesh, &options)).unwrap().to_png().unwrap()
    };
    assert!(with(1) == with(4));
}

#[test]
fn options_out_of_range_and_empty_choices_are_refused() {
    let error = |options: RenderOptions| render(&two(), &options).unwrap_err();
    assert!(matches!(error(front(&[77])), PictureError::Nothing { triangles: 56 }));
    let bad = RenderOptions { azimuth: f64::NAN, ..front(&[]) };
    assert!(matches!(error(bad), PictureError::Option { .. }));
    let bad = RenderOptions { supersampling: 0, ..front(&[]) };
    assert!(matches!(error(bad), PictureError::Option { .. }));
    let bad = RenderOptions { cut: Some(Cut { axis: 3, position: 0.0 }), ..front(&[]) };
    assert!(matches!(error(bad), PictureError::Option { .. }));
    assert!(matches!(error(RenderOptions { width: 0, ..front(&[]) }), PictureError::Size { .. }));
}

#[test]
fn a_mesh_in_pieces_gives_the_same_picture_as_the_whole_one() {
    use crate::export::{Coordinates, PlyOptions, pieces, write_ply};
    use crate::mesh::fixtures::voxel_faces;
    use crate::mesh::kinds_from_labels;

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.ply");
    let labels: Vec<u8> =
        (0..6 * 5 * 7u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8 % 4).collect();
    let closed = voxel_faces([6, 5, 7], &labels, 255);
    let kinds = kinds_from_labels(closed.positions().len(), closed.triangles(), closed.pairs());
    let remade = |keep: &dyn Fn(Pair) -> bool| {
        let kept: Vec<usize> = (0..closed.pairs().len()).filter(|&t| keep(closed.pairs()[t])).collect();
        InterfaceMesh::new(
            closed.positions().to_vec(),
            kinds.clone(),
            kept.iter().map(|&t| closed.triangles()[t]).collect(),
            kept.iter().map(|&t| closed.pairs()[t]).collect(),
            closed.materials().to_vec(),
        )
        .unwrap()
    };
    // Closed at the border; and open there, with open edges.
    for mesh in [remade(&|_| true), remade(&|pair| pair.front() != MaterialId::OUTSIDE)] {
        let all = RenderOptions { width: 211, height: 170, ..RenderOptions::default() };
        let cut = Some(Cut { axis: 0, position: 2.3 });
        let some = RenderOptions { wireframe: true, cut, caps: true, ..all.clone() };
        let one = RenderOptions { only: vec![MaterialId(2)], supersampling: 3, ..all.clone() };
        write_ply(&path, &mesh, PlyOptions { coordinates: Coordinates::Double, ..PlyOptions::default() })
            .unwrap();
        for options in [all, some, one] {
            let whole = render(&mesh, &options).unwrap();
            for cuts in [&[][..], &[100], &[0, 40, 41, 200, 300, 301, 302, 555]] {
                let pieces = pieces(&mesh, cuts);
                let replay = |take: &mut dyn FnMut(&MeshPiece) -> Result<(), PictureError>| {
                    pieces.iter().try_for_each(&mut *take)
                };
                assert!(render_pieces(mesh.materials(), replay, &options).unwrap() == whole);
            }
            let pieces = PlyPieces::open(&path, &crate::export::ReadOptions::default()).unwrap();
            assert!(render_ply(&pieces, &options, &Execution::default()).unwrap() == whole);
        }
    }
}
