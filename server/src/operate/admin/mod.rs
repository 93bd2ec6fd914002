//! The admin address: `GET /live`, `/ready`, `/metrics` (Prometheus text) and `/sessions` (JSON).

pub(crate) mod answer;
pub(crate) mod listener;
