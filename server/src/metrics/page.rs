//! The metrics page in Prometheus' text format. `deploy/prometheus`, `deploy/grafana` and the runbook use these names.

use std::fmt;

use prometheus_client::{
    collector::Collector,
    encoding::{DescriptorEncoder, EncodeLabelSet, MetricEncoder, NoLabelSet, prometheus_text},
    metrics::MetricType,
    registry::Registry,
};

use super::ledger::{StageCounts, as_f64};
use super::{
    causes::{EndCause, RefusalCause},
    process::ProcessFacts,
    registry::Snapshot,
    reloads::Reload,
};
use crate::{net::connections::Stage, visibility::RayShares};

#[derive(Debug, Clone, Default)]
pub(crate) struct Page {
    pub(crate) ready: bool,
    pub(crate) draining: bool,
    pub(crate) open: bool,
    pub(crate) version: &'static str,
    pub(crate) backend: String,
    pub(crate) capacity: usize,
    pub(crate) retries: u64,
    pub(crate) log_lines_lost: u64,
    pub(crate) log_lines_suppressed: u64,
    pub(crate) reloads: Vec<Reload>,
    pub(crate) process: ProcessFacts,
    pub(crate) counts: Snapshot,
}

pub(crate) const CONTENT_TYPE: &str = prometheus_text::CONTENT_TYPE;

impl Page {
    /// Does not fail: writing to a string cannot.
    pub(crate) fn text(self) -> Result<String, fmt::Error> {
        let mut registry = Registry::with_prefix("gnomon");
        registry.register_collector(Box::new(self));
        let mut text = String::new();
        prometheus_text::encode(&mut text, &registry)?;
        Ok(text)
    }
}

type Label = [(&'static str, &'static str); 1];

struct Writer<'a>(DescriptorEncoder<'a>);

impl Writer<'_> {
    fn counter(&mut self, name: &str, help: &str, value: u64) -> fmt::Result {
        let mut metric = self.0.encode_descriptor(name, help, None, MetricType::Counter)?;
        metric.encode_counter::<NoLabelSet, _, u64>(&value, None)
    }

    fn gauge(&mut self, name: &str, help: &str, value: u64) -> fmt::Result {
        let mut metric = self.0.encode_descriptor(name, help, None, MetricType::Gauge)?;
        metric.encode_gauge(&i64::try_from(value).unwrap_or(i64::MAX))
    }

    fn gauges(
        &mut self,
        name: &str,
        help: &str,
        label: &'static str,
        values: impl IntoIterator<Item = (&'static str, i64)>,
    ) -> fmt::Result {
        let mut metric = self.0.encode_descriptor(name, help, None, MetricType::Gauge)?;
        for (label_value, value) in values {
            let labels: Label = [(label, label_value)];
            metric.encode_family(&labels)?.encode_gauge(&value)?;
        }
        Ok(())
    }

    fn family(
        &mut self,
        name: &str,
        help: &str,
        label: &'static str,
        values: impl IntoIterator<Item = (&'static str, u64)>,
    ) -> fmt::Result {
        let mut metric = self.0.encode_descriptor(name, help, None, MetricType::Counter)?;
        for (label_value, value) in values {
            let labels: Label = [(label, label_value)];
            metric.encode_family(&labels)?.encode_counter::<NoLabelSet, _, u64>(&value, None)?;
        }
        Ok(())
    }

    fn seconds(&mut self, name: &str, help: &str, us: u64) -> fmt::Result {
        let mut metric = self.0.encode_descriptor(name, help, None, MetricType::Counter)?;
        metric.encode_counter::<NoLabelSet, _, u64>(&(as_f64(us) * 1e-6), None)
    }

    fn stages(&mut self, stages: &StageCounts) -> fmt::Result {
        let help = "Time of a frame by stage; pose_to_sent is the total";
        let mut metric = self.0.encode_descriptor("stage_seconds", help, None, MetricType::Histogram)?;
        for (name, counts) in StageCounts::NAMES.into_iter().zip(&stages.0) {
            let labels: Label = [("stage", name)];
            let sum_s = as_f64(counts.sum_us) * 1e-6;
            metric.encode_family(&labels)?.encode_histogram::<NoLabelSet>(
                sum_s,
                counts.count(),
                &counts.histogram(),
                None,
            )?;
        }
        Ok(())
    }
}

fn info(metric: &mut MetricEncoder<'_>, labels: &impl EncodeLabelSet) -> fmt::Result {
    metric.encode_family(labels)?.encode_gauge(&1_i64)
}

impl Collector for Page {
    fn encode(&self, encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let mut page = Writer(encoder);
        let (counts, totals) = (&self.counts, &self.counts.sum.totals);
        {
            let help = "Version and tracing back end";
            let mut metric = page.0.encode_descriptor("build_info", help, None, MetricType::Gauge)?;
            info(&mut metric, &[("version", self.version), ("backend", self.backend.as_str())])?;
        }
        page.gauge("ready", "1 while new clients are admitted", self.ready.into())?;
        page.gauge("draining", "1 while the server asks its clients to leave", self.draining.into())?;
        page.gauge("open", "1 while everybody who reaches the server is admitted", self.open.into())?;
        page.gauge("sessions", "Open sessions", counts.open as u64)?;
        let open =
            Stage::LABELS.into_iter().zip(counts.connections.map(|count| i64::try_from(count).unwrap_or(i64::MAX)));
        page.gauges("connections", "Open connections, by stage", "stage", open)?;
        page.gauge("sessions_capacity", "Sessions that may be open at once", self.capacity as u64)?;
        page.counter("sessions_opened", "Sessions admitted", counts.opened)?;
        let ended = EndCause::LABELS.iter().copied().zip(counts.closed);
        page.family("sessions_closed", "Sessions ended, by cause", "cause", ended)?;
        let refused = RefusalCause::LABELS.iter().copied().zip(counts.refusals);
        page.family("refusals", "Peers refused, by cause", "cause", refused)?;
        page.counter("retries", "Peers that were sent a Retry to prove their address", self.retries)?;
        page.family(
            "edits",
            "Messages that change the scene, by outcome",
            "outcome",
            [("taken", totals.edits.saturating_sub(totals.edits_refused)), ("refused", totals.edits_refused)],
        )?;
        page.family(
            "datagrams_received",
            "Datagrams received by sessions, by outcome",
            "outcome",
            [
                ("taken", totals.poses),
                ("acknowledgement", totals.acknowledgements),
                ("stale", totals.poses_stale),
                ("bad", totals.poses_bad),
                ("over_rate", totals.poses_over_rate),
                ("unread", totals.poses_unread),
            ],
        )?;
        page.family(
            "datagrams_sent",
            "Datagrams of frames, by outcome",
            "outcome",
            [("sent", totals.packets.saturating_sub(totals.packets_unsent)), ("unsent", totals.packets_unsent)],
        )?;
        let help = "UDP datagrams received, by owner: a session, or none";
        let received = [("session", totals.udp_received), ("none", counts.unowned_received)];
        page.family("udp_received", help, "owner", received)?;
        let help = "UDP datagrams sent, by owner: a session, or none";
        page.family("udp_sent", help, "owner", [("session", totals.udp_sent), ("none", counts.unowned_sent)])?;
        if let Some(drops) = self.process.kernel_drops {
            page.counter("udp_kernel_drops", "UDP datagrams dropped because the socket's buffer was full", drops)?;
        }
        page.counter("quic_lost", "QUIC packets declared lost", totals.quic_lost)?;
        page.counter("frames_traced", "Masks traced", totals.frames_traced)?;
        let primary = [("listed", totals.primary_listed), ("traced", totals.primary_traced)];
        page.family("primary_rays", "Primary rays of the masks traced, by how they were answered", "found", primary)?;
        let rays = [totals.rays_proven_lit, totals.rays_proven_dark, totals.rays_listed, totals.rays_traced];
        let help = "Shadow rays of the masks traced, by how their bits were found";
        page.family("shadow_rays", help, "found", RayShares::NAMES.into_iter().zip(rays))?;
        page.family(
            "frames",
            "Traced masks, by outcome",
            "outcome",
            [
                ("sent", totals.frames_sent),
                ("superseded", totals.frames_superseded),
                ("gated", totals.frames_gated),
                ("unsendable", totals.frames_unsendable),
                ("abandoned", totals.frames_abandoned),
            ],
        )?;
        let help = "Frames sent in part, because the network carried no more";
        page.counter("frames_cut", help, totals.frames_cut)?;
        page.counter("frame_bytes", "Bytes of frames sent, including headers", totals.bytes)?;
        page.counter("messages", "Control messages received", totals.messages)?;
        page.seconds("gpu_seconds", "Tracing time of the device or processor", totals.gpu_us)?;
        page.stages(&counts.sum.stages)?;
        page.counter("log_lines_lost", "Log lines dropped", self.log_lines_lost)?;
        let help = "Log lines left out, because their place in the code logged too many";
        page.counter("log_lines_suppressed", help, self.log_lines_suppressed)?;
        let failed = self.reloads.iter().map(|reload| (reload.what, reload.failed.into()));
        page.gauges("reload_failed", "1 since a reload failed, until one succeeds", "what", failed)?;
        let help = "When what is in use was loaded, in seconds since 1970";
        let loaded = self.reloads.iter().map(|reload| (reload.what, reload.succeeded_at_unix_s));
        page.gauges("reload_success_timestamp_seconds", help, "what", loaded)?;
        if let Some(bytes) = self.process.resident_bytes {
            page.gauge("resident_memory_bytes", "Memory of the process", bytes)?;
        }
        if let Some(files) = self.process.open_files {
            page.gauge("open_files", "File descriptors of the process", files)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_valid_prometheus_text() {
        let mut page = Page { ready: true, version: "1", backend: "a \"b\"\n".to_owned(), ..Page::default() };
        page.counts.closed = [1, 2, 3, 4, 5, 6, 7];
        page.counts.connections = [1, 2, 3];
        page.counts.sum.totals.poses = 9;
        page.counts.sum.totals.gpu_us = 1_500_000;
        page.process.kernel_drops = Some(6);
        page.reloads = vec![
            Reload { what: "tokens", failed: true, succeeded_at_unix_s: 1_800_000_000 },
            Reload { what: "log", failed: false, succeeded_at_unix_s: 1_800_000_007 },
        ];
        let text = page.text().unwrap();
        for line in [
            "gnomon_build_info{version=\"1\",backend=\"a \\\"b\\\"\\n\"} 1",
            "gnomon_ready 1",
            "gnomon_connections{stage=\"closing\"} 3",
            "gnomon_sessions_closed_total{cause=\"stopping\"} 5",
            "gnomon_datagrams_received_total{outcome=\"taken\"} 9",
            "gnomon_udp_kernel_drops_total 6",
            "gnomon_gpu_seconds_total 1.5",
            "gnomon_reload_failed{what=\"tokens\"} 1",
            "gnomon_reload_failed{what=\"log\"} 0",
            "gnomon_reload_success_timestamp_seconds{what=\"log\"} 1800000007",
            "gnomon_stage_seconds_bucket{stage=\"encode\",le=\"+Inf\"} 0",
            "gnomon_stage_seconds_count{stage=\"send\"} 0",
        ] {
            assert!(text.lines().any(|found| found == line), "no {line} in\n{text}");
        }
        // Prometheus rejects two lines of one name with equal labels.
        let mut names: Vec<_> =
            text.lines().filter(|line| !line.starts_with('#')).map(|line| line.rsplit_once(' ').unwrap().0).collect();
        let all = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), all);
    }
}
