//! Files in and out: one file per format, every write staged aside and put in place by a rename.

pub mod metaimage;
