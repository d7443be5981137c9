//! Interfaces: from labelled voxels to labelled triangles.

pub mod pattern;
