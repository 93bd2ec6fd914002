//! Counters: a ledger per session, and their sum for Prometheus.

pub(crate) mod causes;
pub(crate) mod ledger;
pub(crate) mod page;
pub(crate) mod process;
pub(crate) mod registry;
pub(crate) mod reloads;
pub(crate) mod times;
