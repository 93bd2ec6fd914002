//! `--otlp URL`: reports the metrics of `/metrics` to an OpenTelemetry collector.

pub mod collector;
pub(crate) mod report;
mod translate;
