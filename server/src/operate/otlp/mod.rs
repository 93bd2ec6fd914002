//! `--otlp URL`: reports what `/metrics` shows to an OpenTelemetry collector.

pub mod collector;
pub(crate) mod report;
mod translate;
