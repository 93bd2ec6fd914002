//! Promise: the emulated link treats datagrams as its settings say, within statistical bounds. Equal seeds give equal
//! results.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::time::Duration;

use bytes::Bytes;
use gnomon_lab::link::{
    Counts, Settings,
    impairment::{Delivery, Direction, Impairment},
    settings::Rate,
};
use proptest::prelude::*;

const DATAGRAMS: u64 = 200_000;
/// Most standard deviations between a figure and its expected mean.
const SIGMAS: f64 = 5.0;

/// Sends `count` datagrams of `bytes` bytes, one every `every`.
fn run(
    settings: &Settings,
    seed: u64,
    count: u64,
    every: Duration,
    bytes: usize,
) -> (Vec<[Option<Delivery>; 2]>, Counts) {
    let mut link = Impairment::new(settings.clone(), seed, Direction::Down);
    let mut counts = Counts::default();
    let datagram = Bytes::from(vec![0xA5; bytes]);
    let times = (0..count).map(|number| every * u32::try_from(number).unwrap());
    let fates = times.map(|now| link.push(now, datagram.clone(), &mut counts)).collect();
    (fates, counts)
}

fn settings(text: &str) -> Settings {
    text.parse().unwrap()
}

const MS: Duration = Duration::from_millis(1);

#[track_caller]
fn assert_binomial(found: u64, of: u64, probability: f64) {
    let (found, of) = (found as f64, of as f64);
    let sigma = (of * probability * (1.0 - probability)).sqrt();
    assert!((found - of * probability).abs() < SIGMAS * sigma, "{found} of {of}, not {probability}");
}

#[test]
fn probabilities_match_the_settings() {
    for percent in [0.1, 1.0, 10.0, 60.0] {
        for key in ["loss", "reorder", "duplicate", "corrupt"] {
            let (_, counts) = run(&settings(&format!("{key}={percent}%")), 7, DATAGRAMS, MS, 10);
            let found = match key {
                "loss" => counts.lost,
                "reorder" => counts.reordered,
                "duplicate" => counts.duplicated,
                _ => counts.corrupted,
            };
            assert_binomial(found, DATAGRAMS, percent / 100.0);
            assert_eq!(counts.arrived, counts.delivered + counts.lost, "{key}");
        }
    }
}

#[test]
fn bursts_have_their_share_and_their_mean_length() {
    for (share, length) in [(0.02, 8.0), (0.2, 3.0), (0.5, 20.0)] {
        let text = format!("burst={}%x{length}", share * 100.0);
        let (fates, counts) = run(&settings(&text), 3, DATAGRAMS, MS, 10);
        let lost: Vec<bool> = fates.iter().map(|fate| fate[1].is_none()).collect();
        let bursts: Vec<f64> = lost.chunk_by(|a, b| a == b).filter(|run| run[0]).map(|run| run.len() as f64).collect();
        // Lengths are geometric, with variance length × (length − 1).
        let mean = bursts.iter().sum::<f64>() / bursts.len() as f64;
        let sigma = (length * (length - 1.0) / bursts.len() as f64).sqrt();
        assert!((mean - length).abs() < SIGMAS * sigma, "{text}: {mean}");
        // The share's deviation follows from those of bursts and gaps, which are geometric too.
        let gap = length * (1.0 - share) / share;
        let cycles = DATAGRAMS as f64 / (length + gap);
        let variance = (1.0 - share).powi(2) * length * (length - 1.0) + share * share * gap * (gap - 1.0).max(0.0);
        let sigma = variance.sqrt() / (length + gap) / cycles.sqrt();
        let found = counts.burst_lost as f64 / DATAGRAMS as f64;
        assert!((found - share).abs() < SIGMAS * sigma, "{text}: {found} ± {sigma}");
        assert_eq!(counts.lost, 0);
    }
    // A bad state that loses half loses half of its share; the good state has its own loss.
    let (_, counts) = run(&settings("loss=10% burst=20%x5 burst-loss=50%"), 3, DATAGRAMS, MS, 10);
    assert!((counts.burst_lost as f64 / DATAGRAMS as f64 - 0.1).abs() < 0.006, "{counts:?}");
    assert!((counts.lost as f64 / DATAGRAMS as f64 - 0.08).abs() < 0.006, "{counts:?}");
}

#[test]
fn a_bursty_channel_forgets_its_state_during_silence() {
    let (fates, counts) = run(&settings("burst=20%x50"), 3, 20_000, 101 * MS, 10);
    assert_binomial(counts.burst_lost, 20_000, 0.2);
    // Independent losses come in runs of 1 / (1 − 0.2), with a variance of 0.2 / 0.8².
    let lost: Vec<bool> = fates.iter().map(|fate| fate[1].is_none()).collect();
    let runs: Vec<usize> = lost.chunk_by(|a, b| a == b).filter(|run| run[0]).map(<[bool]>::len).collect();
    let mean = runs.iter().sum::<usize>() as f64 / runs.len() as f64;
    assert!((mean - 1.25).abs() < SIGMAS * (0.2_f64 / 0.64 / runs.len() as f64).sqrt(), "{mean}");
}

#[test]
fn jitter_keeps_the_order_and_fills_its_bounds() {
    let (fates, _) = run(&settings("delay=20ms jitter=15ms"), 11, 20_000, MS, 10);
    let dues: Vec<Duration> = fates.iter().map(|fate| fate[1].as_ref().unwrap().due).collect();
    assert!(dues.is_sorted());
    let delays: Vec<Duration> = (0..).zip(&dues).map(|(number, due)| *due - number * MS).collect();
    let (least, most) = (*delays.iter().min().unwrap(), *delays.iter().max().unwrap());
    assert!(least >= 5 * MS && least < 7 * MS && most <= 35 * MS && most > 33 * MS, "{least:?} {most:?}");
    // Jitter is slow against a frame's datagrams: they do not bunch up behind the latest.
    let largest_step = delays.windows(2).map(|pair| pair[1].abs_diff(pair[0])).max().unwrap();
    assert!(largest_step < 4 * MS, "{largest_step:?}");
}

#[test]
fn only_reordered_datagrams_are_overtaken() {
    let (fates, counts) = run(&settings("delay=5ms reorder=10% reorder-by=3ms"), 5, 10_000, MS, 10);
    for (number, fate) in (0..).zip(&fates) {
        let delay = fate[1].as_ref().unwrap().due - number * MS;
        assert!(delay == 5 * MS || delay == 8 * MS);
    }
    let held = (0..).zip(&fates).filter(|&(number, fate)| fate[1].as_ref().unwrap().due - number * MS == 8 * MS);
    assert_eq!(held.count() as u64, counts.reordered);
}

#[test]
fn rate_and_queue_stay_within_their_limits() {
    let text = settings("delay=10ms rate=8Mbit queue=20KB");
    let Rate { bits_per_s, queue_bytes } = text.rate.unwrap();
    // 1000 bytes a millisecond pass; 1300 come.
    let (fates, counts) = run(&text, 1, 5_000, MS, 1300);
    let dues: Vec<Duration> = fates.iter().filter_map(|fate| fate[1].as_ref()).map(|delivery| delivery.due).collect();
    for (first, &from) in dues.iter().enumerate() {
        for (more, &until) in dues[first..].iter().enumerate().skip(1).take(200) {
            let sent_bits = (more * 1300 * 8) as f64;
            assert!(sent_bits <= (until - from).as_secs_f64() * bits_per_s as f64 + 1e-3);
        }
    }
    let longest = Duration::from_secs_f64(queue_bytes as f64 * 8.0 / bits_per_s as f64) + 10 * MS;
    for (number, fate) in (0..).zip(&fates) {
        assert!(fate[1].as_ref().is_none_or(|delivery| delivery.due - number * MS <= longest));
    }
    // Those that fit pass: 1000 of 1300, plus one queue.
    let passed_bytes = counts.delivered * 1300;
    assert!((5_000_000..=5_000_000 + queue_bytes).contains(&passed_bytes), "{counts:?}");
    assert_eq!(counts.arrived, counts.delivered + counts.queue_dropped);
    // A single datagram takes its own time on the wire: 1300 bytes at 1000 a millisecond.
    assert_eq!(dues[0], 10 * MS + Duration::from_micros(1300));
}

#[test]
fn corruption_flips_one_bit_and_duplicates_are_equal() {
    let (fates, counts) = run(&settings("corrupt=50% duplicate=50%"), 9, 2000, MS, 33);
    let mut places = [0_u32; 33];
    let mut flipped = 0;
    for [copy, original] in &fates {
        let original = original.as_ref().unwrap();
        assert!(copy.as_ref().is_none_or(|copy| copy == original));
        let differing: Vec<_> = original.bytes.iter().map(|byte| (byte ^ 0xA5).count_ones()).collect();
        flipped += u64::from(differing.iter().sum::<u32>());
        assert!(differing.iter().sum::<u32>() <= 1);
        places.iter_mut().zip(differing).for_each(|(place, differs)| *place += differs);
    }
    assert_eq!(flipped, counts.corrupted);
    assert!(places.iter().all(|&place| place > 0), "some byte is never hit: {places:?}");
}

#[test]
fn outages_let_nothing_pass_and_end() {
    let (fates, counts) = run(&settings("outage=100ms+50ms outage=300ms+1ms"), 1, 400, MS, 10);
    for (number, fate) in fates.iter().enumerate() {
        assert_eq!(fate[1].is_none(), (100..150).contains(&number) || number == 300, "{number}");
    }
    assert_eq!((counts.outage, counts.delivered), (51, 349));
}

#[test]
fn a_trace_is_replayed() {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), "0 10 0\n0.1 30 0\n0.2 10 100\n0.3 5 0\n").unwrap();
    let (fates, counts) = run(&settings(&format!("delay=99ms trace={}", file.path().display())), 1, 400, MS, 10);
    let delay = |number: u32| fates[number as usize][1].as_ref().map(|delivery| delivery.due - number * MS);
    assert_eq!([0, 99, 100, 199].map(delay), [Some(10 * MS), Some(10 * MS), Some(30 * MS), Some(30 * MS)]);
    assert_eq!([200, 299, 300, 399].map(delay), [None, None, Some(5 * MS), Some(5 * MS)]);
    assert_eq!(counts.lost, 100);
}

fn any_settings() -> impl Strategy<Value = Settings> {
    let share = || prop_oneof![Just(0.0), 0.0..60.0_f64];
    (share(), share(), 1.0..20.0_f64, share(), share(), share(), 0..30_u64, prop::option::of(1..50_u64)).prop_map(
        |(loss, burst, length, reorder, duplicate, corrupt, delay, rate)| {
            let rate = rate.map_or(String::new(), |rate| format!("rate={}kbit queue=3000B", rate * 100));
            settings(&format!(
                "delay={delay}ms jitter={delay}ms loss={loss:.3}% burst={burst:.3}%x{length:.2} reorder={reorder:.3}% \
                 duplicate={duplicate:.3}% corrupt={corrupt:.3}% outage=20ms+7ms {rate}"
            ))
        },
    )
}

proptest! {
    #[test]
    fn every_datagram_has_one_fate(settings in any_settings(), seed: u64) {
        let (fates, counts) = run(&settings, seed, 300, MS, 200);
        let lost = counts.lost + counts.burst_lost + counts.queue_dropped + counts.outage;
        prop_assert_eq!(counts.arrived, counts.delivered + lost);
        let sent = fates.iter().flatten().flatten().count() as u64;
        prop_assert_eq!(sent, counts.delivered + counts.duplicated);
        // Nothing arrives before it was sent.
        for (number, fate) in (0..).zip(&fates) {
            prop_assert!(fate.iter().flatten().all(|delivery| delivery.due >= number * MS));
        }
    }

    #[test]
    fn fates_depend_on_the_seed_and_not_on_timing(settings in any_settings(), seed: u64) {
        // Queues and outages depend on time.
        let settings = Settings { rate: None, outages: Vec::new(), ..settings };
        let fates = |every, seed| {
            let (fates, counts) = run(&settings, seed, 300, every, 200);
            let bytes = fates.into_iter().map(|fate| fate.map(|delivery| delivery.map(|delivery| delivery.bytes)));
            (bytes.collect::<Vec<_>>(), counts)
        };
        prop_assert_eq!(fates(MS, seed), fates(7 * MS, seed));
        prop_assert_eq!(run(&settings, seed, 300, MS, 200).0, run(&settings, seed, 300, MS, 200).0);
    }
}

#[test]
fn seeds_and_directions_are_independent() {
    let fates = |seed, direction| {
        let mut link = Impairment::new(settings("loss=50%"), seed, direction);
        let mut counts = Counts::default();
        (0..256).map(|_| link.push(MS, Bytes::new(), &mut counts)[1].is_some()).collect::<Vec<_>>()
    };
    let all = [(1, Direction::Up), (1, Direction::Down), (2, Direction::Up), (2, Direction::Down)];
    let all = all.map(|(seed, direction)| fates(seed, direction));
    for (a, first) in all.iter().enumerate() {
        for second in &all[a + 1..] {
            // Half of 256 agree by chance, with a deviation of 8; shifted copies would too.
            for shift in 0..8 {
                let agree = first[shift..].iter().zip(second).filter(|(a, b)| a == b).count();
                assert!((80..=176).contains(&agree), "{agree} agree");
            }
        }
    }
}
