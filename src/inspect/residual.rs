//! The residual between a mesh's blurred model and a scan: options, errors, the pass over the volume.
//!
//! 1. The mesh is checked against the volume, and its triangles are filed by slice.
//! 2. With local levels a first pass, with one grey value per material, finds voxels well inside of each material
//!    (no interface within reach, a model that is one material's grey value) and fits [`Levels`] to them.
//! 3. A pass compares: slices of the fine grid are made, blurred and reduced while they are needed only.
//!
//! Modelled grey values are clipped to the range of the scan's own, so that a saturated voxel counts only as
//! far as its model falls short of the saturation.

use std::ops::Range;
use std::sync::Mutex;

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::by_slice::BySlice;
use super::coverage::FineMesh;
use super::grey::{FineGrid, fine_slice};
use super::near::{Near, Nearest};
use super::statistics::{DeepResidual, PairResidual, PairSums};
use crate::execution::{Cancelled, Execution};
use crate::grid::{MaterialId, Pair, VoxelBox};
use crate::material::{LevelSums, Levels, MaterialTable, MaterialTableError};
use crate::mesh::{InterfaceMesh, junctions};
use crate::volume::kernel::{Kernel, Window, reduce};
use crate::volume::{Samples, VolumeError, VolumeSource};

/// Slices of the volume per round.
const ROUND: usize = 16;
/// A voxel whose model is this near to a material's grey value, as a share of the smallest contrast, and that has no
/// interface within reach is well inside of the material.
const INSIDE: f64 = 0.005;
/// How far the mesh may reach beyond the volume, voxels: the border lies half a voxel outside of centres.
const BEYOND: f64 = 1.0;

/// Where the materials' grey values come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LevelChoice {
    /// Fitted to the voxels well inside of each material, so that they may differ in places.
    Local,
    /// The mesh's one mean per material.
    Table,
}

/// How the residual is made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ResidualOptions {
    /// Standard deviation of the scan's blur per axis, mm, averaging over a voxel included (`sigma_axes_mm` of a
    /// run's report).
    pub sigma_mm: [f64; 3],
    /// Voxels (of mean edge length) within this distance of an interface are compared. Default 3.
    pub reach: f64,
    /// Voxels within this distance of a junction curve are near it. Default 3.
    pub near: f64,
    /// Cells of the fine grid along a voxel, 2 to 8. Default 3.
    pub fine: usize,
    /// The materials' grey values. Default: local.
    pub levels: LevelChoice,
}

impl ResidualOptions {
    /// The defaults for a blur.
    #[must_use]
    pub fn new(sigma_mm: [f64; 3]) -> Self {
        Self { sigma_mm, reach: 3.0, near: 3.0, fine: 3, levels: LevelChoice::Local }
    }
}

/// Why there is no residual.
#[derive(Debug, Error)]
pub enum ResidualError {
    /// An option out of range.
    #[error("{name} is {value}, but it must be {needed}")]
    Option {
        /// Which.
        name: &'static str,
        /// As given.
        value: f64,
        /// What is right.
        needed: &'static str,
    },
    /// A mesh that is not of this volume.
    #[error(
        "the mesh reaches from voxel {low:.1?} to {high:.1?}, but the volume has {size:?} voxels: it was made from another volume, or the spacing differs (give the volume as it was given to extract, --spacing and --roi too)"
    )]
    Elsewhere {
        /// Lowest corner of the mesh, voxels.
        low: [f64; 3],
        /// Highest corner.
        high: [f64; 3],
        /// Voxels per axis.
        size: [usize; 3],
    },
    /// A mesh with holes.
    #[error(
        "the shell of material {material} is not closed near voxel row y = {y}, z = {z}: shares of materials cannot be told (extract with --border closed; `interfacet check` lists holes)"
    )]
    Open {
        /// Its id.
        material: u8,
        /// Row of voxels.
        y: usize,
        /// Slice.
        z: usize,
    },
    /// No mesh.
    #[error("the mesh has no triangles, so there is no interface to look at")]
    Empty,
    /// Materials without a usable grey value.
    #[error(
        "the mesh's materials cannot be modelled (a PLY file of `interfacet extract` names their grey values): {0}"
    )]
    Materials(#[from] MaterialTableError),
    /// The volume cannot be read.
    #[error(transparent)]
    Volume(#[from] VolumeError),
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// The residual between a mesh's blurred model and a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// How it was made.
    pub options: ResidualOptions,
    /// Names of the materials, by id.
    pub materials: Vec<String>,
    /// Each interface.
    pub pairs: Vec<PairResidual>,
    /// Each material well inside: noise, mostly.
    pub deep: Vec<DeepResidual>,
    /// Voxels at the volume's border that were left out, as blur brings in what is beyond.
    pub border: [usize; 3],
}

/// Compares `source` with the mesh that was made of it, blurred as the scan is.
///
/// # Errors
/// [`ResidualError`] says what is wrong with the options, the mesh or the volume.
pub fn residual(
    mesh: &InterfaceMesh,
    source: &dyn VolumeSource,
    options: &ResidualOptions,
    execution: &Execution,
) -> Result<Residual, ResidualError> {
    check(options)?;
    let table = MaterialTable::new(mesh.materials().iter().map(|m| (m.name.clone(), m.mean)))?;
    let model = Model::new(mesh, source, options, &table, execution)?;
    let constant = Levels::constant(&table);
    let passes = if options.levels == LevelChoice::Local { 2 } else { 1 };
    let stage = execution.stage("comparing", (passes * model.grid.size[2]) as u64);
    let levels = match options.levels {
        LevelChoice::Table => constant,
        LevelChoice::Local => {
            let mut sums = LevelSums::new(model.grid.size, table.count());
            model.sweep(source, &constant, execution, &mut |round| {
                model.add_levels(&mut sums, round, &table);
                stage.advance(round.slices.len() as u64);
            })?;
            Levels::new(&sums, &table)
        }
    };
    let mut found = Found::new(&table);
    model.sweep(source, &levels, execution, &mut |round| {
        model.add(&mut found, round, &levels, &table);
        stage.advance(round.slices.len() as u64);
    })?;
    Ok(Residual {
        options: *options,
        materials: table.materials().iter().map(|m| m.name.clone()).collect(),
        pairs: found.pairs.iter().map(PairSums::finish).filter(|p| p.all.is_some()).collect(),
        deep: found.deep(),
        border: model.border,
    })
}

fn check(options: &ResidualOptions) -> Result<(), ResidualError> {
    let limit = |name, value: f64, ok: bool, needed| {
        if ok { Ok(()) } else { Err(ResidualError::Option { name, value, needed }) }
    };
    for sigma in options.sigma_mm {
        let needed = "a positive number of mm; without one in the report give --sigma";
        limit("the blur's sigma", sigma, sigma.is_finite() && sigma > 0.0, needed)?;
    }
    for (name, value) in [("reach", options.reach), ("near", options.near)] {
        limit(name, value, (0.5..=20.0).contains(&value), "0.5 to 20 voxels")?;
    }
    limit("fine", options.fine as f64, (2..=8).contains(&options.fine), "2 to 8 cells along a voxel")
}

/// The mesh, ready to be compared.
struct Model<'a> {
    mesh: &'a InterfaceMesh,
    /// Vertices in cells of the fine grid, and in mm along the lattice's axes.
    cells: Vec<DVec3>,
    places: Vec<DVec3>,
    junctions: Vec<[DVec3; 2]>,
    grid: FineGrid,
    kernels: [Kernel; 3],
    spacing: DVec3,
    sign: f64,
    reach: [f64; 2],
    /// Which triangles a slice of the fine grid, which triangles and junction edges a slice of the volume meets.
    fine: BySlice,
    near: [BySlice; 2],
    /// Voxels at the border that are left out.
    border: [usize; 3],
    /// Mean of the background.
    base: f64,
    /// Grey values are one material's to within this.
    inside: f64,
    /// Smallest and largest grey value of the scan.
    range: [f64; 2],
}

/// Some slices, measured and modelled.
struct Round<'a> {
    slices: Range<usize>,
    samples: &'a Samples,
    /// Grey values less the base.
    model: &'a [Vec<f32>],
    near: &'a [Vec<Nearest>],
}

impl<'a> Model<'a> {
    fn new(
        mesh: &'a InterfaceMesh,
        source: &dyn VolumeSource,
        options: &ResidualOptions,
        table: &MaterialTable,
        execution: &Execution,
    ) -> Result<Self, ResidualError> {
        if mesh.triangles().is_empty() {
            return Err(ResidualError::Empty);
        }
        let geometry = source.geometry();
        let (size, spacing) = (geometry.size(), DVec3::from(geometry.spacing()));
        let lattice: Vec<DVec3> = mesh.positions().par_iter().map(|&p| geometry.index(p)).collect();
        let used = || mesh.triangles().iter().flatten().map(|&v| lattice[v as usize]);
        let low = used().fold(DVec3::INFINITY, DVec3::min);
        let high = used().fold(DVec3::NEG_INFINITY, DVec3::max);
        let most = DVec3::from(size.map(|n| n as f64 - 1.0 + BEYOND));
        if low.min_element() < -BEYOND || (most - high).min_element() < 0.0 {
            return Err(ResidualError::Elsewhere { low: low.to_array(), high: high.to_array(), size });
        }
        // The sigma stated includes the average over a voxel, whose variance is a twelfth of its square.
        let sigma = [0, 1, 2].map(|a| {
            let voxels = options.sigma_mm[a] / spacing[a];
            (voxels * voxels - 1.0 / 12.0).max(0.0).sqrt() * options.fine as f64
        });
        let kernels = sigma.map(|s| Kernel::new(s, options.fine));
        // At least a voxel, so that the mesh's border lies within the grid.
        let before = [0, 1, 2].map(|a| kernels[a].reach);
        let border = before.map(|n| n.div_ceil(options.fine) + 1);
        let grid = FineGrid { factor: options.fine, before, size };
        let cells = lattice.par_iter().map(|p| DVec3::from([0, 1, 2].map(|a| grid.cells(a, p[a])))).collect();
        let places: Vec<DVec3> = lattice.par_iter().map(|&p| p * spacing).collect();
        let junctions = junction_edges(mesh, &places);
        let edge = geometry.voxel_edge();
        let reach = [options.reach * edge, options.near * edge];
        let mut model = Self {
            mesh,
            cells,
            places,
            junctions,
            grid,
            kernels,
            spacing,
            sign: if geometry.is_mirrored() { -1.0 } else { 1.0 },
            reach,
            fine: BySlice::new(0, 0.0, std::iter::empty()),
            near: [0, 1].map(|_| BySlice::new(0, 0.0, std::iter::empty())),
            border,
            base: table.materials()[0].mean,
            range: range_of(source, execution)?,
            inside: INSIDE
                * table.materials().windows(2).map(|w| w[1].mean - w[0].mean).fold(f64::INFINITY, f64::min),
        };
        let range = |points: &[DVec3]| {
            let z = points.iter().map(|p| p.z);
            [z.clone().fold(f64::INFINITY, f64::min), z.fold(f64::NEG_INFINITY, f64::max)]
        };
        let triangles = mesh.triangles();
        let in_cells = triangles.iter().map(|t| range(&t.map(|v| model.cells[v as usize])).map(|z| z - 0.5));
        let fine_slices = model.kernels[2].needed(size[2]);
        let fine = BySlice::new(fine_slices, 0.0, in_cells);
        let in_voxels = |z: [f64; 2]| z.map(|z| z / spacing.z);
        let surfaces = triangles.iter().map(|t| in_voxels(range(&t.map(|v| model.places[v as usize]))));
        let curves = model.junctions.iter().map(|ends| in_voxels(range(ends)));
        let near = [
            BySlice::new(size[2], reach[0] / spacing.z, surfaces),
            BySlice::new(size[2], reach[1] / spacing.z, curves),
        ];
        (model.fine, model.near) = (fine, near);
        Ok(model)
    }

    /// One pass: the volume's slices in rounds, each measured and modelled.
    fn sweep(
        &self,
        source: &dyn VolumeSource,
        levels: &Levels,
        execution: &Execution,
        take: &mut dyn FnMut(&Round<'_>),
    ) -> Result<(), ResidualError> {
        let [width, height, depth] = self.grid.size;
        let needed = [0, 1].map(|a| self.kernels[a].needed(self.grid.size[a]));
        let triangles = self.mesh.triangles();
        let fine = FineMesh {
            positions: &self.cells,
            triangles,
            pairs: self.mesh.pairs(),
            sign: self.sign,
            by_slice: &self.fine,
            size: needed,
            materials: self.mesh.materials().len(),
        };
        let near = Near {
            positions: &self.places,
            triangles,
            pairs: self.mesh.pairs(),
            junctions: &self.junctions,
            by_slice: &self.near,
            spacing: self.spacing,
            size: [width, height],
            reach: self.reach,
        };
        let mut reader = source.slices(&VoxelBox::whole(self.grid.size))?;
        let kind = source.sample_type();
        let mut window = Window::default();
        let open: Mutex<Option<(usize, usize, MaterialId)>> = Mutex::new(None);
        for z in (0..depth).step_by(ROUND) {
            execution.check()?;
            let slices = z..(z + ROUND).min(depth);
            let mut samples = Samples::none(kind);
            reader.read(slices.clone(), &mut samples, execution)?;
            window.fill(slices.end, &self.kernels[2], |k| {
                let made = fine_slice(&fine, &self.grid, levels, self.base, k).unwrap_or_else(|(row, id)| {
                    if let Ok(mut open) = open.lock() {
                        // The first one, whichever thread came first.
                        *open = Some(open.map_or((k, row, id), |other| other.min((k, row, id))));
                    }
                    vec![0.0; needed[0] * needed[1]]
                });
                reduce(&made, [width, height], &self.kernels)
            });
            if let Ok(Some((k, row, id))) = open.lock().map(|open| *open) {
                let (y, z) = (self.grid.voxel(1, row), self.grid.voxel(2, k));
                return Err(ResidualError::Open { material: id.0, y, z });
            }
            let (model, near): (Vec<_>, Vec<_>) = slices
                .clone()
                .into_par_iter()
                .map(|z| (window.slice(z, &self.kernels[2], width * height), near.slice(z)))
                .unzip();
            take(&Round { slices: slices.clone(), samples: &samples, model: &model, near: &near });
            window.drop_before(slices.end, &self.kernels[2]);
        }
        Ok(())
    }

    /// Whether a voxel's whole blur lies within the volume.
    fn is_clear(&self, voxel: [usize; 3]) -> bool {
        (0..3).all(|a| voxel[a] >= self.border[a] && voxel[a] + self.border[a] < self.grid.size[a])
    }

    /// The material that a voxel is well inside of, by its modelled grey value less the base and with `mean` of
    /// materials there.
    fn inside_of(
        &self,
        near: &Nearest,
        grey: f64,
        materials: usize,
        mean: impl Fn(usize) -> f64,
    ) -> Option<usize> {
        if near.pair.is_some() {
            return None;
        }
        (0..materials).find(|&k| (grey + self.base - mean(k)).abs() < self.inside)
    }

    /// Adds the voxels well inside of materials to sums over cells.
    fn add_levels(&self, sums: &mut LevelSums, round: &Round<'_>, table: &MaterialTable) {
        let ([width, height, _], side, first) = (self.grid.size, sums.side(), round.slices.start);
        let materials = table.count();
        sums.add_rows(round.slices.clone(), |y, z, sums| {
            let (model, near) = (&round.model[z - first], &round.near[z - first]);
            let inside = |x: usize| {
                let voxel = y * width + x;
                let mean = |k: usize| table.materials()[k].mean;
                self.inside_of(&near[voxel], f64::from(model[voxel]), materials, mean)
                    .filter(|_| self.is_clear([x, y, z]))
            };
            let owners: Vec<Option<usize>> = (0..width).map(inside).collect();
            for (cell, owners) in owners.chunks(side).enumerate() {
                for k in 0..materials {
                    let own = owners.iter().enumerate().filter(|(_, owner)| **owner == Some(k));
                    let grey =
                        |x: usize| round.samples.get(((z - first) * height + y) * width + cell * side + x);
                    let own = own.map(|(x, _)| (x, grey(x))).collect::<Vec<_>>();
                    if !own.is_empty() {
                        sums[cell * materials + k].add_row(y % side, z % side, own.into_iter());
                    }
                }
            }
        });
    }

    /// Adds the residuals of a round.
    fn add(&self, found: &mut Found, round: &Round<'_>, levels: &Levels, table: &MaterialTable) {
        let [width, height, _] = self.grid.size;
        let parts: Vec<Found> = (0..round.slices.len())
            .into_par_iter()
            .map(|k| {
                let (mut part, z) = (Found::new(table), round.slices.start + k);
                for voxel in 0..width * height {
                    let at = [voxel % width, voxel / width, z];
                    if !self.is_clear(at) {
                        continue;
                    }
                    let (near, model) = (&round.near[k][voxel], f64::from(round.model[k][voxel]));
                    let measured = f64::from(round.samples.get(k * width * height + voxel));
                    let residual = measured - (model + self.base).clamp(self.range[0], self.range[1]);
                    match near.pair {
                        Some(pair) => part.add(pair, near.junction, residual, table),
                        None => {
                            let mean =
                                |k: usize| f64::from(levels.mean(MaterialId(k as u8), at.map(|c| c as f32)));
                            if let Some(k) = self.inside_of(near, model, table.count(), mean) {
                                part.deep[k].0 += 1;
                                part.deep[k].1 += residual * residual;
                            }
                        }
                    }
                }
                part
            })
            .collect();
        parts.iter().for_each(|part| found.join(part));
    }
}

/// Smallest and largest grey value of a volume.
fn range_of(source: &dyn VolumeSource, execution: &Execution) -> Result<[f64; 2], ResidualError> {
    let size = source.geometry().size();
    let mut reader = source.slices(&VoxelBox::whole(size))?;
    let mut range = [f64::INFINITY, f64::NEG_INFINITY];
    for z in (0..size[2]).step_by(ROUND) {
        execution.check()?;
        let mut samples = Samples::none(source.sample_type());
        reader.read(z..(z + ROUND).min(size[2]), &mut samples, execution)?;
        for v in (0..samples.len()).map(|i| f64::from(samples.get(i))) {
            range = [range[0].min(v), range[1].max(v)];
        }
    }
    Ok(range)
}

/// Ends of the edges where three materials or more meet inside of the volume.
fn junction_edges(mesh: &InterfaceMesh, places: &[DVec3]) -> Vec<[DVec3; 2]> {
    let found = junctions(mesh);
    let inside = found.curves.iter().filter(|c| !c.materials.contains(&MaterialId::OUTSIDE));
    let edges = inside.flat_map(|c| {
        let closing = c.closed.then(|| [c.vertices.last(), c.vertices.first()]);
        let closing = closing.and_then(|[a, b]| Some([*a?, *b?]));
        c.vertices.windows(2).map(|two| [two[0], two[1]]).chain(closing).collect::<Vec<_>>()
    });
    edges.map(|ends| ends.map(|v| places[v as usize])).collect()
}

/// Sums over the voxels compared so far.
struct Found {
    /// By pair, ascending.
    pairs: Vec<PairSums>,
    /// By material: voxels, sum of squares.
    deep: Vec<(u64, f64)>,
}

impl Found {
    fn new(table: &MaterialTable) -> Self {
        Self { pairs: Vec::new(), deep: vec![(0, 0.0); table.count()] }
    }

    fn of(&mut self, pair: Pair, contrast: f64) -> &mut PairSums {
        let key = |p: Pair| (p.back(), p.front());
        let at = match self.pairs.binary_search_by_key(&key(pair), |sums| key(sums.pair)) {
            Ok(at) => at,
            Err(at) => {
                self.pairs.insert(at, PairSums::new(pair, contrast));
                at
            }
        };
        &mut self.pairs[at]
    }

    fn add(&mut self, pair: Pair, junction: bool, residual: f64, table: &MaterialTable) {
        // Triangles at the volume's border have no second material.
        if let (Some(back), Some(front)) = (table.get(pair.back()), table.get(pair.front())) {
            self.of(pair, (back.mean - front.mean).abs()).sums[usize::from(junction)].add(residual);
        }
    }

    fn join(&mut self, more: &Self) {
        for part in &more.pairs {
            let own = self.of(part.pair, part.contrast);
            own.sums.iter_mut().zip(&part.sums).for_each(|(sums, more)| sums.join(more));
        }
        for (own, more) in self.deep.iter_mut().zip(&more.deep) {
            own.0 += more.0;
            own.1 += more.1;
        }
    }

    fn deep(&self) -> Vec<DeepResidual> {
        let of = |(k, &(voxels, squares)): (usize, &(u64, f64))| {
            let rms = if voxels > 0 { (squares / voxels as f64).sqrt() } else { 0.0 };
            DeepResidual { material: MaterialId(k as u8), voxels, rms }
        };
        self.deep.iter().enumerate().map(of).collect()
    }
}
