//! Networks by name.
//!
//! `lan` is a switch in the same building; its delay is below a tick of the link's timers. `wifi`: the delays of WiFi
//! hops have a long tail, with 20 ms as the 90th percentile (Sui et al., *Characterizing and Improving WiFi Latency in
//! Large-Scale Operational Networks*, MobiSys 2016); ours stays below that tail, which `outage` and `bad` model.
//! `5g`: rates of mid-band networks (Narayanan et al., *A First Look at Commercial 5G Performance on Smartphones*, WWW
//! 2020, 100 to 200 Mbit/s). `lte`: medians of 13 Mbit/s down and 6 Mbit/s up (Huang et al., *A Close Examination of
//! Performance and Power Characteristics of 4G LTE Networks*, MobiSys 2012). Delays and losses of `5g` and `lte`, and
//! all of `bad`, are our own choice: a good cell, a middling cell, and a link too poor for a call.

use thiserror::Error;

use super::settings::{LinkSettings, Settings};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Profile {
    pub name: &'static str,
    /// From client to server, as [`Settings::set`] parses it.
    pub up: &'static str,
    pub down: &'static str,
    pub both: &'static str,
}

const WIFI_UP: &str =
    "delay=3ms jitter=2ms loss=0.1% burst=0.2%x5 reorder=0.05% reorder-by=2ms rate=80Mbit queue=256KB";
const WIFI_DOWN: &str =
    "delay=3ms jitter=2ms loss=0.1% burst=0.2%x5 reorder=0.05% reorder-by=2ms rate=150Mbit queue=512KB";

const fn profile(name: &'static str, up: &'static str, down: &'static str, both: &'static str) -> Profile {
    Profile { name, up, down, both }
}

pub const PROFILES: [Profile; 6] = [
    profile("lan", "delay=0.2ms rate=1Gbit queue=512KB", "delay=0.2ms rate=1Gbit queue=512KB", ""),
    profile("wifi", WIFI_UP, WIFI_DOWN, ""),
    profile(
        "5g",
        "delay=10ms jitter=4ms loss=0.1% burst=0.1%x10 rate=30Mbit queue=256KB",
        "delay=10ms jitter=4ms loss=0.1% burst=0.1%x10 rate=120Mbit queue=1MB",
        "",
    ),
    profile(
        "lte",
        "delay=35ms jitter=10ms loss=0.2% burst=0.3%x10 rate=6Mbit queue=128KB",
        "delay=35ms jitter=10ms loss=0.2% burst=0.3%x10 rate=13Mbit queue=256KB",
        "",
    ),
    profile(
        "bad",
        "delay=80ms jitter=40ms loss=2% burst=2%x8 reorder=1% reorder-by=10ms duplicate=0.5% \
             corrupt=0.1% rate=2Mbit queue=64KB",
        "delay=80ms jitter=40ms loss=2% burst=2%x8 reorder=1% reorder-by=10ms duplicate=0.5% \
             corrupt=0.1% rate=8Mbit queue=128KB",
        "",
    ),
    profile("outage", WIFI_UP, WIFI_DOWN, "outage=5s+5s"),
];

#[derive(Debug, Error)]
#[error("{name:?} is no profile; there are {}", PROFILES.map(|profile| profile.name).join(", "))]
pub struct UnknownProfile {
    name: String,
}

impl Profile {
    pub fn named(name: &str) -> Result<Self, UnknownProfile> {
        PROFILES
            .into_iter()
            .find(|profile| profile.name == name)
            .ok_or_else(|| UnknownProfile { name: name.to_owned() })
    }

    pub fn settings(&self, seed: u64) -> Result<LinkSettings, super::settings::SettingsError> {
        let one = |text: &str| {
            let mut settings: Settings = text.parse()?;
            settings.set(self.both)?;
            Ok::<_, super::settings::SettingsError>(settings)
        };
        Ok(LinkSettings { up: one(self.up)?, down: one(self.down)?, seed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_profile_round_trips_through_text() {
        for profile in PROFILES {
            let settings = Profile::named(profile.name).unwrap().settings(1).unwrap();
            for one in [&settings.up, &settings.down] {
                assert_eq!(&one.to_string().parse::<Settings>().unwrap(), one);
            }
            assert_eq!(settings.down.outages.len(), usize::from(profile.name == "outage"));
        }
        assert!(Profile::named("moon").unwrap_err().to_string().contains("lan, wifi, 5g"));
    }
}
