//! Translates a Prometheus text page to OTLP metrics. Reads only the syntax that this server's page uses.

use serde_json::{Value, json};

/// `AGGREGATION_TEMPORALITY_CUMULATIVE`.
const CUMULATIVE: u32 = 2;

struct Sample<'a> {
    name: &'a str,
    labels: Vec<(&'a str, String)>,
    value: &'a str,
}

/// `start` and `now` are in nanoseconds since 1970.
pub(super) fn metrics(page: &str, start: u64, now: u64) -> Vec<Value> {
    let mut metrics = Vec::new();
    let (mut help, mut head, mut samples) = ("", None, Vec::new());
    // The extra line ends the last metric.
    for line in page.lines().chain(["# TYPE"]) {
        if let Some(text) = line.strip_prefix("# HELP ") {
            help = text.split_once(' ').map_or("", |(_, help)| help);
        } else if let Some(text) = line.strip_prefix("# TYPE") {
            if let Some((name, kind, help)) = head.take() {
                let samples = std::mem::take(&mut samples);
                metrics.extend(metric(name, kind, help, &samples, (start, now)));
            }
            head = text.trim().split_once(' ').map(|(name, kind)| (name, kind, std::mem::take(&mut help)));
        } else if !line.starts_with('#') {
            samples.extend(sample(line));
        }
    }
    metrics
}

fn metric(name: &str, kind: &str, help: &str, samples: &[Sample<'_>], time: (u64, u64)) -> Option<Value> {
    let points = || samples.iter().map(|sample| point(sample, time)).collect::<Vec<_>>();
    let (what, data) = match kind {
        "counter" => {
            let sum = json!({ "dataPoints": points(), "aggregationTemporality": CUMULATIVE, "isMonotonic": true });
            ("sum", sum)
        }
        "gauge" => ("gauge", json!({ "dataPoints": points() })),
        "histogram" => {
            let points = histograms(name, samples, time);
            ("histogram", json!({ "dataPoints": points, "aggregationTemporality": CUMULATIVE }))
        }
        _ => return None,
    };
    Some(json!({ "name": name, "description": help, what: data }))
}

fn point(sample: &Sample<'_>, (start, now): (u64, u64)) -> Value {
    // The JSON mapping writes 64-bit integers as strings.
    let (kind, value) = match sample.value.parse::<i64>() {
        Ok(value) => ("asInt", json!(value.to_string())),
        Err(_) => ("asDouble", json!(number(sample.value))),
    };
    json!({
        "attributes": attributes(&sample.labels, ""),
        "startTimeUnixNano": start.to_string(),
        "timeUnixNano": now.to_string(),
        kind: value,
    })
}

/// A histogram's points: one for each set of labels, in their order.
fn histograms(name: &str, samples: &[Sample<'_>], (start, now): (u64, u64)) -> Vec<Value> {
    let mut points = Vec::new();
    let (mut bounds, mut counts, mut below, mut sum) = (Vec::new(), Vec::new(), 0, 0.0);
    for sample in samples {
        match sample.name.strip_prefix(name) {
            Some("_sum") => sum = number(sample.value),
            Some("_bucket") => {
                let edge = sample.labels.iter().find(|(key, _)| *key == "le").map_or("", |(_, edge)| edge.as_str());
                // Prometheus' buckets are cumulative, OTLP's are not.
                let all = sample.value.parse::<u64>().unwrap_or_default();
                counts.push(all.saturating_sub(below).to_string());
                below = all;
                if edge != "+Inf" {
                    bounds.push(number(edge));
                    continue;
                }
                points.push(json!({
                    "attributes": attributes(&sample.labels, "le"),
                    "startTimeUnixNano": start.to_string(),
                    "timeUnixNano": now.to_string(),
                    "count": below.to_string(),
                    "sum": sum,
                    "explicitBounds": std::mem::take(&mut bounds),
                    "bucketCounts": std::mem::take(&mut counts),
                }));
                (below, sum) = (0, 0.0);
            }
            _ => {}
        }
    }
    points
}

fn attributes(labels: &[(&str, String)], without: &str) -> Vec<Value> {
    let of = |(key, value): &(&str, String)| json!({ "key": key, "value": { "stringValue": value } });
    labels.iter().filter(|(key, _)| *key != without).map(of).collect()
}

fn number(text: &str) -> f64 {
    text.parse().unwrap_or_default()
}

/// `NAME{KEY="VALUE",…} VALUE`.
fn sample(line: &str) -> Option<Sample<'_>> {
    let (series, value) = line.rsplit_once(' ')?;
    let Some((name, rest)) = series.split_once('{') else {
        return Some(Sample { name: series, labels: Vec::new(), value });
    };
    let (mut labels, mut rest) = (Vec::new(), rest);
    while let Some((key, text)) = rest.split_once("=\"") {
        let (label, after) = quoted(text)?;
        labels.push((key, label));
        rest = after.trim_start_matches(',');
    }
    Some(Sample { name, labels, value })
}

/// Returns the text up to the closing quotation mark, unescaped, and the rest.
fn quoted(text: &str) -> Option<(String, &str)> {
    let (mut value, mut escaped) = (String::new(), false);
    for (at, character) in text.char_indices() {
        match (escaped, character) {
            (false, '"') => return Some((value, &text[at + 1..])),
            (false, '\\') => escaped = true,
            (true, 'n') => {
                value.push('\n');
                escaped = false;
            }
            (_, character) => {
                value.push(character);
                escaped = false;
            }
        }
    }
    None
}
