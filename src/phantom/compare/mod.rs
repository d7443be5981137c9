//! A mesh against the exact geometry of a phantom.
