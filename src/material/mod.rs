//! Which grey value is which material.

mod table;

pub use table::{Material, MaterialTable, MaterialTableError};
