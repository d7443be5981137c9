//! The table of materials: names, mean grey values, thresholds.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::grid::MaterialId;

/// Why a list of materials is refused.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum MaterialTableError {
    /// Fewer than two materials: nothing meets.
    #[error("{count} material(s) given; an interface needs at least 2 (the background, usually air, counts)")]
    TooFew {
        /// How many there are.
        count: usize,
    },
    /// More materials than ids.
    #[error("{count} materials given; at most {limit} are possible, so merge some")]
    TooMany {
        /// How many there are.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
    /// A mean grey value is not a finite number.
    #[error("material '{name}' has the mean grey value {mean}; it must be a finite number")]
    NotFinite {
        /// Its name.
        name: String,
        /// Its mean as given.
        mean: f64,
    },
    /// Means that do not ascend.
    #[error(
        "material '{second}' ({second_mean}) comes after '{first}' ({first_mean}): list materials by strictly ascending mean grey value, the background first"
    )]
    NotAscending {
        /// The earlier material.
        first: String,
        /// Its mean.
        first_mean: f64,
        /// The later material.
        second: String,
        /// Its mean.
        second_mean: f64,
    },
    /// Names for another number of materials.
    #[error(
        "{names} names given for the {count} materials found, near grey values {greys:.6?}; give one name each, or the number of materials with --count"
    )]
    NameCount {
        /// Names given.
        names: usize,
        /// Materials.
        count: usize,
        /// Their mean grey values.
        greys: Vec<f64>,
    },
    /// A name used twice or not fit for a file name.
    #[error("the material name '{name}' is {problem}; use letters, digits, '-' and '_', each name once")]
    Name {
        /// The name.
        name: String,
        /// What is wrong with it.
        problem: &'static str,
    },
}

/// One material.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Its id: the position in the table.
    pub id: MaterialId,
    /// Its name, fit for a file name.
    pub name: String,
    /// Mean grey value. For a volume of labels: the label.
    pub mean: f64,
    /// Standard deviation of the grey value inside the material (noise and texture), where known.
    pub sigma: Option<f64>,
    /// Voxels certainly inside the material from which mean and sigma were taken, where known.
    pub voxels: Option<u64>,
}

/// The materials of a volume by ascending mean grey value; the background first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MaterialTable {
    materials: Vec<Material>,
}

impl MaterialTable {
    /// A table of `(name, mean grey value)`, which must ascend strictly.
    ///
    /// # Errors
    /// [`MaterialTableError`] names the entry that is not usable.
    pub fn new<N: Into<String>>(
        entries: impl IntoIterator<Item = (N, f64)>,
    ) -> Result<Self, MaterialTableError> {
        let entries: Vec<(String, f64)> = entries.into_iter().map(|(n, m)| (n.into(), m)).collect();
        let count = entries.len();
        if count < 2 {
            return Err(MaterialTableError::TooFew { count });
        }
        if count > MaterialId::MAX_COUNT {
            return Err(MaterialTableError::TooMany { count, limit: MaterialId::MAX_COUNT });
        }
        for (i, (name, mean)) in entries.iter().enumerate() {
            if !mean.is_finite() {
                return Err(MaterialTableError::NotFinite { name: name.clone(), mean: *mean });
            }
            let fit = !name.is_empty()
                && name.chars().all(|c| c.is_alphanumeric() || c == '-' || c == '_')
                && name.len() <= 100;
            if !fit {
                return Err(MaterialTableError::Name {
                    name: name.clone(),
                    problem: "not fit for a file name",
                });
            }
            if entries[..i].iter().any(|(other, _)| other == name) {
                return Err(MaterialTableError::Name { name: name.clone(), problem: "used twice" });
            }
        }
        if let Some(w) = entries.windows(2).find(|w| w[1].1 <= w[0].1) {
            return Err(MaterialTableError::NotAscending {
                first: w[0].0.clone(),
                first_mean: w[0].1,
                second: w[1].0.clone(),
                second_mean: w[1].1,
            });
        }
        let materials = entries
            .into_iter()
            .enumerate()
            .map(|(i, (name, mean))| Material {
                id: MaterialId(i as u8),
                name,
                mean,
                sigma: None,
                voxels: None,
            })
            .collect();
        Ok(Self { materials })
    }

    /// The table with other names, in order.
    ///
    /// # Errors
    /// [`MaterialTableError::NameCount`] if there are more or fewer names than materials;
    /// [`MaterialTableError::Name`] for an unusable one.
    pub fn renamed(&self, names: &[String]) -> Result<Self, MaterialTableError> {
        if names.len() != self.count() {
            let greys = self.materials.iter().map(|m| m.mean).collect();
            return Err(MaterialTableError::NameCount { names: names.len(), count: self.count(), greys });
        }
        let statistics: Vec<_> = self.materials.iter().map(|m| (m.sigma, m.voxels)).collect();
        let table = Self::new(names.iter().cloned().zip(self.materials.iter().map(|m| m.mean)))?;
        Ok(table.with_statistics(&statistics))
    }

    /// The table with measured statistics (`sigma`, `voxels`) per material, in order.
    #[must_use]
    pub fn with_statistics(mut self, statistics: &[(Option<f64>, Option<u64>)]) -> Self {
        for (material, (sigma, voxels)) in self.materials.iter_mut().zip(statistics) {
            material.sigma = *sigma;
            material.voxels = *voxels;
        }
        self
    }

    /// How many materials there are (2 to 254).
    #[must_use]
    pub fn count(&self) -> usize {
        self.materials.len()
    }

    /// The materials, by id.
    #[must_use]
    pub fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// The material with this id, if it is in the table.
    #[must_use]
    pub fn get(&self, id: MaterialId) -> Option<&Material> {
        self.materials.get(usize::from(id.0))
    }

    /// The threshold between two materials, `t_xy = (v_x + v_y) / 2` (Fujimori and Suzuki §3.1).
    ///
    /// # Panics
    /// If an id is not in the table.
    #[must_use]
    pub fn threshold(&self, x: MaterialId, y: MaterialId) -> f64 {
        let mean = |id: MaterialId| self.materials[usize::from(id.0)].mean;
        0.5 * (mean(x) + mean(y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_tables_are_refused_by_name() {
        let table = |v: &[(&str, f64)]| MaterialTable::new(v.iter().copied());
        assert!(matches!(table(&[("air", 1.0)]), Err(MaterialTableError::TooFew { count: 1 })));
        assert!(matches!(table(&[("a", 2.0), ("b", 1.0)]), Err(MaterialTableError::NotAscending { .. })));
        assert!(matches!(table(&[("a", 2.0), ("b", 2.0)]), Err(MaterialTableError::NotAscending { .. })));
        assert!(matches!(table(&[("a", 2.0), ("b", f64::NAN)]), Err(MaterialTableError::NotFinite { .. })));
        assert!(matches!(table(&[("a", 2.0), ("a", 3.0)]), Err(MaterialTableError::Name { .. })));
        assert!(matches!(table(&[("a", 2.0), ("../b", 3.0)]), Err(MaterialTableError::Name { .. })));
        let many: Vec<_> = (0..255).map(|i| (format!("m{i}"), f64::from(i))).collect();
        assert!(matches!(MaterialTable::new(many), Err(MaterialTableError::TooMany { count: 255, .. })));
        let two = table(&[("a", 2.0), ("b", 3.0)]).unwrap();
        assert_eq!(two.renamed(&["air".into(), "al".into()]).unwrap().materials()[1].name, "al");
        assert!(matches!(
            two.renamed(&["air".into()]),
            Err(MaterialTableError::NameCount { names: 1, count: 2, .. })
        ));
        let good = table(&[("air", 4000.0), ("aluminium", 11600.0), ("iron", 40000.0)]).unwrap();
        assert!((good.threshold(MaterialId(0), MaterialId(2)) - 22000.0).abs() < 1e-9);
    }
}
