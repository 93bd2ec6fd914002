//! Recorded networks: a text file of times, delays and losses.
//!
//! ```text
//! # seconds since the start, one-way delay in milliseconds, share lost in per cent
//! 0     12.5  0
//! 0.5   40    2.5
//! ```
//!
//! A line holds until the time of the next, the last one forever. Columns are separated by blanks or commas; `#` begins
//! a comment.

use std::{fs::File, io::Read as _, path::Path, time::Duration};

use thiserror::Error;

const MAX_BYTES: u64 = 16 << 20;
const MAX_DELAY_MS: f64 = 60_000.0;

#[derive(Debug, Error)]
pub enum TraceError {
    #[error("trace {file}: {source}")]
    Read { file: String, source: std::io::Error },
    #[error("trace {file}, line {line}: {reason}")]
    Line {
        file: String,
        /// Counted from 1.
        line: usize,
        reason: String,
    },
    #[error("trace {0}: no line has a time, a delay and a loss")]
    Empty(String),
}

/// Valid from `time` on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    pub time: Duration,
    /// One way.
    pub delay: Duration,
    pub loss: f64,
}

/// A recorded network: at least one moment, in order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace(Vec<Moment>);

impl Trace {
    /// Reads a trace of at most 16 MiB.
    pub fn load(file: &Path) -> Result<Self, TraceError> {
        let name = file.display().to_string();
        let read = |source| TraceError::Read { file: name.clone(), source };
        let mut text = String::new();
        let length = File::open(file).map_err(read)?.take(MAX_BYTES + 1).read_to_string(&mut text).map_err(read)?;
        if length as u64 > MAX_BYTES {
            return Err(read(std::io::Error::other(format!("more than {MAX_BYTES} bytes"))));
        }
        Self::parse(&name, &text)
    }

    /// Parses a trace; `name` is for errors, which give the number of the first wrong line.
    pub fn parse(name: &str, text: &str) -> Result<Self, TraceError> {
        let mut moments: Vec<Moment> = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let data = line.split('#').next().unwrap_or_default().trim();
            if data.is_empty() {
                continue;
            }
            let wrong = |reason| TraceError::Line { file: name.to_owned(), line: index + 1, reason };
            let moment = moment(data).map_err(wrong)?;
            if let Some(last) = moments.last().filter(|last| last.time >= moment.time) {
                return Err(wrong(format!("{:?} does not come after {:?}", moment.time, last.time)));
            }
            moments.push(moment);
        }
        if moments.is_empty() { Err(TraceError::Empty(name.to_owned())) } else { Ok(Self(moments)) }
    }

    /// Returns the conditions at a time since the start. The first line also holds before its time.
    pub fn at(&self, time: Duration) -> Moment {
        let after = self.0.partition_point(|moment| moment.time <= time);
        self.0[after.saturating_sub(1)]
    }
}

fn moment(data: &str) -> Result<Moment, String> {
    let words: Vec<&str> = data.split([' ', '\t', ',']).filter(|word| !word.is_empty()).collect();
    let [time, delay, loss] = words[..] else {
        return Err(format!("{} columns: seconds, milliseconds of delay and per cent lost are expected", words.len()));
    };
    let number = |what: &str, text: &str, most: f64| {
        let number = text.parse::<f64>().ok().filter(|number| (0.0..=most).contains(number));
        number.ok_or_else(|| format!("{what} {text:?}: a number from 0 to {most} is expected"))
    };
    Ok(Moment {
        time: Duration::from_secs_f64(number("time", time, 1e9)?),
        delay: Duration::from_secs_f64(number("delay", delay, MAX_DELAY_MS)? / 1e3),
        loss: number("loss", loss, 100.0)? / 100.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_holds_until_the_next() {
        let trace = Trace::parse("t", "# head\n0.5 12.5 0\n\n1,40,2.5 # tunnel\n2\t10\t100\n").unwrap();
        let at = |seconds: f64| {
            let moment = trace.at(Duration::from_secs_f64(seconds));
            (moment.delay.as_secs_f64() * 1e3, moment.loss)
        };
        assert_eq!([0.0, 0.5, 0.999].map(at), [(12.5, 0.0); 3]);
        assert_eq!([1.0, 1.9, 2.0, 1e6].map(at), [(40.0, 0.025), (40.0, 0.025), (10.0, 1.0), (10.0, 1.0)]);
    }

    #[test]
    fn a_bad_line_is_named() {
        for (text, expected) in [
            ("0 1 0\n1 2\n", "trace t, line 2: 2 columns"),
            ("0 1 0\n# x\n1 2 3 4", "line 3: 4 columns"),
            ("0 x 0", "line 1: delay \"x\": a number from 0 to 60000"),
            ("0 1 101", "loss \"101\""),
            ("-1 1 0", "time \"-1\""),
            ("inf 1 0", "time \"inf\""),
            ("0 NaN 0", "delay \"NaN\""),
            ("1 1 0\n1 1 0", "line 2: 1s does not come after 1s"),
            ("# nothing\n", "no line has"),
        ] {
            let error = Trace::parse("t", text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "0 1").unwrap();
        assert!(Trace::load(file.path()).unwrap_err().to_string().contains("line 1"));
    }
}
