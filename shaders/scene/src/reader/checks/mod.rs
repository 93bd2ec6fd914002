//! Checks on the JSON alone, before any geometry is read.

pub(crate) mod features;
pub(crate) mod layout;
pub(crate) mod references;
