//! Limits wrong tokens by address, and logs them as counts.
//!
//! An address with too many of them is refused without a look at its token until its window ends. So a short token
//! cannot be guessed, and a flood costs a table look-up each. Clients behind the same address wait as well, unless they
//! resume a session, which proves a secret. Loopback is exempt: behind a local proxy every client has that address, and
//! one of them could lock out all others.

use std::{
    collections::HashMap,
    net::IpAddr,
    time::{Duration, Instant},
};

use parking_lot::Mutex;

use super::tokens::store::TokenRejection;
use crate::{
    limits::{FAILED_TOKENS_LOGGED_EVERY, FAILED_TOKENS_WINDOW, MAX_FAILED_ADDRESSES, MAX_FAILED_TOKENS},
    net::network::Network,
};

/// What a blocked client and the log are told.
pub(crate) const BLOCKED: &str = "too many wrong tokens from its address";

#[derive(Debug, Default)]
pub(crate) struct FailedTokens {
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    addresses: HashMap<Network, Failures>,
    unlogged: u64,
    logged_at: Option<Instant>,
}

#[derive(Debug)]
struct Failures {
    count: u32,
    since: Instant,
}

impl Failures {
    /// Time until they are forgotten.
    fn left(&self, now: Instant) -> Option<Duration> {
        FAILED_TOKENS_WINDOW.checked_sub(now.saturating_duration_since(self.since)).filter(|left| !left.is_zero())
    }
}

impl FailedTokens {
    /// Returns how long this address must wait, if it has sent too many wrong tokens.
    pub(crate) fn blocked(&self, address: IpAddr, now: Instant) -> Option<Duration> {
        let state = self.state.lock();
        let failures =
            state.addresses.get(&Network::of(address)).filter(|failures| failures.count >= MAX_FAILED_TOKENS)?;
        failures.left(now)
    }

    /// Counts a wrong token, and logs it unless another was logged just before.
    pub(crate) fn count(&self, address: IpAddr, problem: TokenRejection, now: Instant) {
        let mut state = self.state.lock();
        // A client with a token that was good once does not guess.
        let guessed = matches!(problem, TokenRejection::Missing | TokenRejection::Unknown);
        if guessed && !address.to_canonical().is_loopback() {
            state.add(Network::of(address), now);
        }
        let unlogged = state.count_to_log(now);
        drop(state);
        if let Some(count) = unlogged {
            tracing::info!(%problem, count, "token refused");
        }
    }

    /// Counts a refusal of a blocked address, for the log.
    pub(crate) fn count_blocked(&self, now: Instant) {
        let unlogged = self.state.lock().count_to_log(now);
        if let Some(count) = unlogged {
            tracing::info!(problem = BLOCKED, count, "token refused");
        }
    }
}

impl State {
    fn add(&mut self, owner: Network, now: Instant) {
        if !self.addresses.contains_key(&owner) && self.addresses.len() >= MAX_FAILED_ADDRESSES {
            self.addresses.retain(|_, failures| failures.left(now).is_some());
            if self.addresses.len() >= MAX_FAILED_ADDRESSES
                && let Some(oldest) =
                    self.addresses.iter().min_by_key(|(_, failures)| failures.since).map(|(at, _)| *at)
            {
                self.addresses.remove(&oldest);
            }
        }
        let failures = self.addresses.entry(owner).or_insert(Failures { count: 0, since: now });
        if failures.left(now).is_none() {
            *failures = Failures { count: 0, since: now };
        }
        failures.count += 1;
    }

    /// Returns the number of refusals since the last line, if it is time for one.
    fn count_to_log(&mut self, now: Instant) -> Option<u64> {
        self.unlogged += 1;
        if self.logged_at.is_some_and(|at| now.saturating_duration_since(at) < FAILED_TOKENS_LOGGED_EVERY) {
            return None;
        }
        self.logged_at = Some(now);
        Some(std::mem::take(&mut self.unlogged))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(address: &str) -> Network {
        Network::of(address.parse().unwrap())
    }

    fn fail(failed: &FailedTokens, address: &str, now: Instant) {
        failed.count(address.parse().unwrap(), TokenRejection::Unknown, now);
    }

    #[test]
    fn an_address_with_too_many_wrong_tokens_waits_and_others_do_not() {
        let (failed, start) = (FailedTokens::default(), Instant::now());
        let blocked = |address: &str, now| failed.blocked(address.parse().unwrap(), now);
        for _ in 1..MAX_FAILED_TOKENS {
            fail(&failed, "192.0.2.1", start);
            fail(&failed, "2001:db8::1", start);
        }
        assert_eq!(blocked("192.0.2.1", start), None);
        fail(&failed, "::ffff:192.0.2.1", start);
        fail(&failed, "2001:db8::2", start);
        assert_eq!(blocked("192.0.2.1", start), Some(FAILED_TOKENS_WINDOW));
        assert!(blocked("2001:db8::3", start).is_some(), "one owner has all of a /64");
        assert!(blocked("192.0.2.2", start).is_none() && blocked("2001:db8:0:1::1", start).is_none());
        let later = start + FAILED_TOKENS_WINDOW;
        assert_eq!(blocked("192.0.2.1", later), None);
        fail(&failed, "192.0.2.1", later);
        assert_eq!(blocked("192.0.2.1", later), None, "a new window begins");
        for _ in 0..2 * MAX_FAILED_TOKENS {
            fail(&failed, "127.0.0.1", start);
        }
        assert_eq!(blocked("127.0.0.1", start), None, "loopback may be a proxy");
        for problem in [TokenRejection::Expired, TokenRejection::Scope, TokenRejection::Spent] {
            for _ in 0..MAX_FAILED_TOKENS {
                failed.count("192.0.2.3".parse().unwrap(), problem, start);
            }
        }
        assert_eq!(blocked("192.0.2.3", start), None, "these are no guesses");
    }

    #[test]
    fn a_flood_is_a_bounded_table_and_a_line_now_and_then() {
        let (failed, start) = (FailedTokens::default(), Instant::now());
        let most = u32::try_from(MAX_FAILED_ADDRESSES).unwrap();
        for number in 0..most + 100 {
            let address = IpAddr::from((0x0a00_0000 + number).to_be_bytes());
            let at = start + Duration::from_micros(number.into());
            failed.count(address, TokenRejection::Unknown, at);
        }
        let mut state = failed.state.lock();
        assert_eq!(state.addresses.len(), MAX_FAILED_ADDRESSES);
        assert_eq!(state.unlogged, u64::from(most) + 99, "all but the first wait for a line");
        assert!(!state.addresses.contains_key(&network("10.0.0.0")), "the oldest is forgotten first");
        let later = start + FAILED_TOKENS_LOGGED_EVERY * 2;
        assert_eq!(state.count_to_log(later), Some(u64::from(most) + 100));
        assert_eq!(state.count_to_log(later), None);
        // Those whose time is over make room at once.
        state.add(network("192.0.2.1"), start + FAILED_TOKENS_WINDOW * 2);
        assert_eq!(state.addresses.len(), 1);
    }
}
