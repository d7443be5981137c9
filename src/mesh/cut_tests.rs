//! What is found out from pieces is what is found out from the whole.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::cut::random_layers;
use super::{CheckOptions, MeshPiece, MeshReport, MeshReportBuilder, ShellPiece, ShellSplitter, split};
use crate::execution::Execution;
use crate::grid::MaterialId;

fn from_pieces(pieces: &[MeshPiece], options: &CheckOptions) -> MeshReport {
    let mut builder = MeshReportBuilder::new(pieces[0].mesh.materials().to_vec(), options);
    for piece in pieces {
        builder.add(piece, &Execution::default()).unwrap();
    }
    builder.finish()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn the_report_does_not_depend_on_cuts(seed: u64, broken in 0usize..12, threads in 1usize..4) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let layered = random_layers(&mut rng, broken);
        let options = CheckOptions { examples: rng.random_range(0..20), self_intersections: true };
        let whole = MeshReport::new(&layered.mesh, &options, &Execution::default()).unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        for probability in [1.0, 0.5] {
            let pieces = layered.cut(&mut rng, probability);
            let report = pool.install(|| from_pieces(&pieces, &options));
            prop_assert_eq!(&report, &whole);
        }
        prop_assert_eq!(&from_pieces(&[MeshPiece::whole(layered.mesh)], &options), &whole);
    }

    #[test]
    fn shells_do_not_depend_on_cuts(seed: u64, broken in 0usize..12) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let layered = random_layers(&mut rng, broken);
        let pieces = layered.cut(&mut rng, 0.7);
        for id in (0..4).map(MaterialId) {
            let whole = split(&layered.mesh, id);
            let mut splitter = ShellSplitter::new(id);
            let mut all = ShellPiece::default();
            for piece in &pieces {
                let ShellPiece { positions, kinds, sigmas, triangles } = splitter.add(piece);
                all.positions.extend(positions);
                all.kinds.extend(kinds);
                all.sigmas.extend(sigmas);
                all.triangles.extend(triangles);
                prop_assert!(all.triangles.iter().flatten().all(|&v| (v as usize) < all.positions.len()));
            }
            prop_assert_eq!(splitter.vertices(), whole.positions.len() as u64);
            prop_assert_eq!(splitter.triangles(), whole.triangles.len() as u64);
            let kinds: Vec<_> = whole.vertices.iter().map(|&v| layered.mesh.kinds()[v as usize]).collect();
            let all_sigmas = layered.mesh.sigmas();
            let sigmas = whole.vertices.iter().filter_map(|&v| Some(all_sigmas?[v as usize])).collect();
            let whole = ShellPiece { positions: whole.positions, kinds, sigmas, triangles: whole.triangles };
            prop_assert_eq!(&all, &whole);
        }
    }
}
