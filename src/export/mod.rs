//! Writing files: one format per file.

pub mod metaimage;
