//! Impairments of a link in each direction, and their text form: `delay=20ms jitter=5ms loss=1%`.

use std::{fmt, path::PathBuf, str::FromStr, sync::Arc, time::Duration};

use thiserror::Error;

use super::trace::{Trace, TraceError};

/// Longest delay, jitter or queue.
const MAX_DELAY: Duration = Duration::from_secs(60);
/// Latest start and greatest length of an outage.
const MAX_OUTAGE: Duration = Duration::from_secs(86_400);
const MAX_OUTAGES: usize = 1000;

/// One direction of a link. The default changes nothing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Settings {
    pub delay: Duration,
    /// Greatest deviation from `delay`. It changes smoothly and reorders nothing.
    pub jitter: Duration,
    /// Probability that a datagram is lost, independently.
    pub loss: f64,
    pub burst: Option<Burst>,
    /// Probability that a datagram is held back, so that others overtake it.
    pub reorder: f64,
    pub reorder_by: Duration,
    pub duplicate: f64,
    /// Probability that a datagram arrives with one bit flipped.
    pub corrupt: f64,
    pub rate: Option<Rate>,
    /// Largest IPv4 packet in bytes, 28 of them headers; a datagram that does not fit is dropped.
    pub mtu: Option<u64>,
    /// Outages: start since the link's first datagram, and length.
    pub outages: Vec<(Duration, Duration)>,
    /// Recorded delays and losses, which replace `delay` and `loss`, and their file (no blanks or commas in its path).
    pub trace: Option<(PathBuf, Arc<Trace>)>,
}

/// The Gilbert-Elliott channel: a good state with [`Settings::loss`], and a bad state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Burst {
    /// Share of datagrams in the bad state, 0 to below 1.
    pub share: f64,
    /// Mean length of a bad state in datagrams, at least 1.
    pub length: f64,
    /// Probability that a datagram is lost in the bad state.
    pub loss: f64,
}

impl Burst {
    /// Probability per datagram that a bad state ends.
    pub fn leave(&self) -> f64 {
        1.0 / self.length
    }

    /// Probability per datagram that a good state ends, at most 1, so that bad states have their share.
    pub fn enter(&self) -> f64 {
        (self.share * self.leave() / (1.0 - self.share)).min(1.0)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rate {
    pub bits_per_s: u64,
    /// Queue capacity in bytes, including the datagram on the wire; a datagram that does not fit is dropped.
    pub queue_bytes: u64,
}

#[derive(Debug, Clone, PartialEq, Default)]
pub struct LinkSettings {
    pub up: Settings,
    pub down: Settings,
    pub seed: u64,
}

#[derive(Debug, Error)]
pub enum SettingsError {
    #[error("{0:?} is no setting: write KEY=VALUE, delay=20ms for instance")]
    NoPair(String),
    #[error(
        "{0:?} is no setting; there are delay, jitter, loss, burst, burst-loss, reorder, reorder-by, duplicate, \
         corrupt, rate, queue, mtu, outage and trace"
    )]
    Key(String),
    #[error("{key}={value}: {expected} is expected")]
    Value { key: String, value: String, expected: &'static str },
    #[error("{0}")]
    Together(&'static str),
    #[error(transparent)]
    Trace(#[from] TraceError),
}

impl Settings {
    /// Sets the space- or comma-separated `key=value` pairs in `text`. An error names the first wrong pair and changes
    /// nothing.
    pub fn set(&mut self, text: &str) -> Result<(), SettingsError> {
        let mut changed = self.clone();
        // A queue may be given as time, which only means something at a rate.
        let mut queue = None;
        for pair in text.split([' ', ',']).filter(|pair| !pair.is_empty()) {
            let (key, value) = pair.split_once('=').ok_or_else(|| SettingsError::NoPair(pair.to_owned()))?;
            if key == "queue" {
                queue = Some(value);
            } else {
                changed.set_one(key, value)?;
            }
        }
        if let Some(value) = queue {
            let rate = changed.rate.as_mut().ok_or(SettingsError::Together("queue= needs rate="))?;
            let found = bytes(value).or_else(|| duration(value, MAX_DELAY).map(|wait| rate.bytes_in(wait)));
            rate.queue_bytes = found.ok_or_else(|| wrong("queue", value, "bytes or time, 64KB or 50ms"))?;
        }
        if changed.jitter > changed.delay && changed.trace.is_none() {
            return Err(SettingsError::Together("jitter exceeds delay: nothing arrives before it is sent"));
        }
        *self = changed;
        Ok(())
    }

    fn set_one(&mut self, key: &str, value: &str) -> Result<(), SettingsError> {
        let wrong = |expected| wrong(key, value, expected);
        let time = || duration(value, MAX_DELAY).ok_or_else(|| wrong("a time up to 60s, 20ms for instance"));
        let chance = || probability(value).ok_or_else(|| wrong("a share from 0% to 100%"));
        match key {
            "delay" => self.delay = time()?,
            "jitter" => self.jitter = time()?,
            "loss" => self.loss = chance()?,
            "reorder" => {
                self.reorder = chance()?;
                if self.reorder_by.is_zero() {
                    self.reorder_by = DEFAULT_REORDER_BY;
                }
            }
            "reorder-by" => self.reorder_by = time()?,
            "duplicate" => self.duplicate = chance()?,
            "corrupt" => self.corrupt = chance()?,
            "burst" => {
                let parsed = value.split_once('x').and_then(|(share, length)| {
                    let share = probability(share).filter(|&share| share < 1.0)?;
                    let length = length.parse().ok().filter(|length| (1.0..=1e6).contains(length))?;
                    Some(Burst { share, length, loss: self.burst.map_or(1.0, |burst| burst.loss) })
                });
                let burst = parsed.ok_or_else(|| wrong("SHARExLENGTH, 0.5%x8 for instance"))?;
                self.burst = (burst.share > 0.0).then_some(burst);
            }
            "burst-loss" => {
                let chance = chance()?;
                self.burst.as_mut().ok_or(SettingsError::Together("burst-loss= needs burst= before it"))?.loss = chance;
            }
            "rate" if value == "none" => self.rate = None,
            "rate" => {
                let bits_per_s = rate(value).ok_or_else(|| wrong("1kbit to 1000Gbit, 50Mbit for instance"))?;
                let rate = Rate { bits_per_s, queue_bytes: 0 };
                self.rate = Some(Rate { queue_bytes: rate.bytes_in(DEFAULT_QUEUE), ..rate });
            }
            "mtu" if value == "none" => self.mtu = None,
            "mtu" => {
                let bytes = number(value, &[("B", 1.0)]).and_then(whole).filter(|bytes| MTUS.contains(bytes));
                self.mtu = Some(bytes.ok_or_else(|| wrong("68B to 65535B"))?);
            }
            "outage" if value == "none" => self.outages.clear(),
            "outage" => {
                let parsed = value
                    .split_once('+')
                    .and_then(|(start, length)| Some((duration(start, MAX_OUTAGE)?, duration(length, MAX_OUTAGE)?)));
                let outage = parsed.ok_or_else(|| wrong("START+LENGTH, 5s+2s for instance"))?;
                if self.outages.len() >= MAX_OUTAGES {
                    return Err(SettingsError::Together("more than 1000 outages"));
                }
                self.outages.push(outage);
            }
            "trace" if value == "none" => self.trace = None,
            "trace" => self.trace = Some((value.into(), Arc::new(Trace::load(value.as_ref())?))),
            _ => return Err(SettingsError::Key(key.to_owned())),
        }
        Ok(())
    }
}

/// Delay of reordered datagrams if only `reorder=` is given.
const DEFAULT_REORDER_BY: Duration = Duration::from_millis(5);
/// Queue length if only `rate=` is given.
const DEFAULT_QUEUE: Duration = Duration::from_millis(100);

impl Rate {
    /// Bytes that pass in a time; at least one full datagram, since a smaller queue would drop everything.
    fn bytes_in(self, wait: Duration) -> u64 {
        let bytes = u128::from(self.bits_per_s) * wait.as_nanos() / 8_000_000_000;
        u64::try_from(bytes).unwrap_or(u64::MAX).max(MIN_QUEUE_BYTES)
    }
}

const MIN_QUEUE_BYTES: u64 = 1500;

/// Sizes of an IPv4 packet that a path may bear (RFC 791).
const MTUS: std::ops::RangeInclusive<u64> = 68..=65_535;

impl FromStr for Settings {
    type Err = SettingsError;

    fn from_str(text: &str) -> Result<Self, SettingsError> {
        let mut settings = Self::default();
        settings.set(text).map(|()| settings)
    }
}

impl fmt::Display for Settings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut words = Vec::new();
        let mut time = |key: &str, time: Duration| {
            if !time.is_zero() {
                words.push(format!("{key}={}", Time(time)));
            }
        };
        time("delay", self.delay);
        time("jitter", self.jitter);
        let chance = |key: &str, share: f64| (share > 0.0).then(|| format!("{key}={}", Percent(share)));
        words.extend(chance("loss", self.loss));
        if let Some(Burst { share, length, loss }) = self.burst {
            words.push(format!("burst={}x{length}", Percent(share)));
            if loss < 1.0 {
                words.push(format!("burst-loss={}", Percent(loss)));
            }
        }
        if self.reorder > 0.0 {
            words.extend(chance("reorder", self.reorder));
            words.push(format!("reorder-by={}", Time(self.reorder_by)));
        }
        words.extend(chance("duplicate", self.duplicate));
        words.extend(chance("corrupt", self.corrupt));
        if let Some(Rate { bits_per_s, queue_bytes }) = self.rate {
            words.push(format!("rate={}kbit queue={queue_bytes}B", bits_per_s / 1000));
        }
        words.extend(self.mtu.map(|bytes| format!("mtu={bytes}B")));
        words.extend(self.outages.iter().map(|&(start, length)| format!("outage={}+{}", Time(start), Time(length))));
        words.extend(self.trace.as_ref().map(|(file, _)| format!("trace={}", file.display())));
        f.write_str(if words.is_empty() { "delay=0ms" } else { "" })?;
        f.write_str(&words.join(" "))
    }
}

/// A time as milliseconds, in whole microseconds.
struct Time(Duration);

impl fmt::Display for Time {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let micros = self.0.as_micros();
        write!(f, "{}", micros / 1000)?;
        match micros % 1000 {
            0 => f.write_str("ms"),
            rest => write!(f, "{}ms", format!(".{rest:03}").trim_end_matches('0')),
        }
    }
}

/// A probability in per cent, with ten decimals.
struct Percent(f64);

impl fmt::Display for Percent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = format!("{:.10}", self.0 * 100.0);
        write!(f, "{}%", text.trim_end_matches('0').trim_end_matches('.'))
    }
}

fn wrong(key: &str, value: &str, expected: &'static str) -> SettingsError {
    SettingsError::Value { key: key.to_owned(), value: value.to_owned(), expected }
}

/// Parses a number with a unit; returns it times the unit's factor.
fn number(text: &str, units: &[(&str, f64)]) -> Option<f64> {
    units.iter().find_map(|&(unit, factor)| {
        let number = text.strip_suffix(unit)?;
        // Signs, infinities and exponents are not accepted.
        let plain = number.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
        number.parse::<f64>().ok().filter(|_| plain).map(|number| number * factor)
    })
}

fn duration(text: &str, most: Duration) -> Option<Duration> {
    let micros = number(text, &[("us", 1.0), ("ms", 1e3), ("s", 1e6)])?.round();
    let time = Duration::try_from_secs_f64(micros / 1e6).ok()?;
    (time <= most).then_some(time)
}

fn probability(text: &str) -> Option<f64> {
    number(text, &[("%", 0.01)]).filter(|share| (0.0..=1.0).contains(share))
}

fn bytes(text: &str) -> Option<u64> {
    whole(number(text, &[("MB", 1e6), ("KB", 1e3), ("B", 1.0)])?)
        .filter(|bytes| (MIN_QUEUE_BYTES..=1 << 30).contains(bytes))
}

fn rate(text: &str) -> Option<u64> {
    whole(number(text, &[("Gbit", 1e9), ("Mbit", 1e6), ("kbit", 1e3)])?)
        .filter(|bits| (1000..=1_000_000_000_000).contains(bits))
        .map(|bits| bits - bits % 1000)
}

fn whole(value: f64) -> Option<u64> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to lie within")]
    (0.0..1e15).contains(&value).then(|| value.round() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_round_trip_through_text() {
        let text = "delay=20.5ms,jitter=5ms loss=1% burst=0.5%x8 burst-loss=80% reorder=2% reorder-by=3ms \
                    duplicate=0.1% \
                    corrupt=0.01% rate=50Mbit queue=50ms mtu=1228B outage=5s+2s outage=20s+500us";
        let settings: Settings = text.parse().unwrap();
        assert_eq!((settings.delay, settings.jitter), (Duration::from_micros(20_500), Duration::from_millis(5)));
        assert_eq!(settings.burst, Some(Burst { share: 0.005, length: 8.0, loss: 0.8 }));
        assert_eq!(settings.rate, Some(Rate { bits_per_s: 50_000_000, queue_bytes: 312_500 }));
        assert_eq!(settings.outages[1], (Duration::from_secs(20), Duration::from_micros(500)));
        let again: Settings = settings.to_string().parse().unwrap();
        assert_eq!(again, settings, "{settings}");
        assert_eq!(Settings::default().to_string().parse::<Settings>().unwrap(), Settings::default());
    }

    #[test]
    fn unnamed_settings_stay_and_errors_change_nothing() {
        let mut settings: Settings = "delay=20ms jitter=5ms outage=1s+1s".parse().unwrap();
        settings.set("loss=3% outage=none").unwrap();
        assert_eq!((settings.delay, settings.loss, settings.outages.len()), (Duration::from_millis(20), 0.03, 0));
        let before = settings.clone();
        for (text, expected) in [
            ("delay", "KEY=VALUE"),
            ("speed=5", "is no setting"),
            ("delay=5", "delay=5: a time"),
            ("delay=-5ms", "a time"),
            ("delay=1e9s", "a time"),
            ("delay=61s", "a time"),
            ("loss=101%", "0% to 100%"),
            ("loss=0.5", "0% to 100%"),
            ("loss=nan%", "0% to 100%"),
            ("burst=5%", "SHARExLENGTH"),
            ("burst=100%x2", "SHARExLENGTH"),
            ("burst=5%x0.5", "SHARExLENGTH"),
            ("burst-loss=5%", "needs burst"),
            ("rate=5", "50Mbit"),
            ("rate=0kbit", "50Mbit"),
            ("queue=5KB", "needs rate"),
            ("rate=5Mbit queue=5", "bytes or time"),
            ("rate=5Mbit queue=10B", "bytes or time"),
            ("mtu=67B", "68B to 65535B"),
            ("mtu=1228", "68B to 65535B"),
            ("outage=5s", "START+LENGTH"),
            ("loss=1% jitter=30ms", "jitter exceeds delay"),
            ("trace=/no/such/file", "/no/such/file"),
        ] {
            let error = settings.set(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
            assert_eq!(settings, before, "{text}");
        }
    }
}
