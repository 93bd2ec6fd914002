//! How fast each network opens connections: a token bucket for each, in a table of bounded size.

use std::{
    collections::HashMap,
    time::{Duration, Instant},
};

use crate::{
    limits::{CONNECTION_BURST, CONNECTIONS_PER_SECOND, MAX_RATED_NETWORKS},
    net::network::Network,
};

/// A bucket is kept as the time when it will be full again (the generic cell rate algorithm), so a full one needs no
/// entry.
#[derive(Debug, Default)]
pub(super) struct Rates {
    full_at: HashMap<Network, Instant>,
}

impl Rates {
    /// Takes a token from each network's bucket, or from none if one of them is empty.
    pub(super) fn take(&mut self, networks: impl Iterator<Item = Network> + Clone, now: Instant) -> bool {
        let full_at = |rates: &Self, network| rates.full_at.get(&network).map_or(now, |at| now.max(*at));
        let cost = |network: Network| Duration::from_secs(1) / CONNECTIONS_PER_SECOND / share(network);
        let all = networks.clone().all(|network| {
            let debt = full_at(self, network) + cost(network) - now;
            debt <= cost(network) * CONNECTION_BURST * share(network)
        });
        if all {
            for network in networks {
                let at = full_at(self, network) + cost(network);
                self.full_at.insert(network, at);
            }
            if self.full_at.len() > MAX_RATED_NETWORKS {
                self.forget(now);
            }
        }
        all
    }

    /// Forgets full buckets, and, if these are few, the fuller half: forgetting these gives least away.
    fn forget(&mut self, now: Instant) {
        self.full_at.retain(|_, at| *at > now);
        if self.full_at.len() > MAX_RATED_NETWORKS / 2 {
            let mut times: Vec<Instant> = self.full_at.values().copied().collect();
            let middle = times.len() / 2;
            let (_, median, _) = times.select_nth_unstable(middle);
            let median = *median;
            self.full_at.retain(|_, at| *at > median);
        }
    }
}

fn share(network: Network) -> u32 {
    u32::try_from(network.times()).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn networks(text: &str) -> impl Iterator<Item = Network> + Clone {
        Network::all_of(text.parse().unwrap())
    }

    #[test]
    fn a_burst_passes_and_then_the_rate() {
        let (mut rates, start) = (Rates::default(), Instant::now());
        let mut taken = |text: &str, at| (0..1000).filter(|_| rates.take(networks(text), at)).count();
        assert_eq!(taken("192.0.2.1", start), CONNECTION_BURST as usize);
        assert_eq!(taken("192.0.2.2", start), CONNECTION_BURST as usize, "each address has its own");
        let later = start + Duration::from_secs(2);
        assert_eq!(taken("192.0.2.1", later), 2 * CONNECTIONS_PER_SECOND as usize);
        assert_eq!(taken("192.0.2.1", start + Duration::from_secs(60)), CONNECTION_BURST as usize);
    }

    #[test]
    fn a_site_has_several_times_the_rate_of_an_address() {
        let (mut rates, now) = (Rates::default(), Instant::now());
        let mut taken = 0;
        for subnet in 0..64 {
            let address = format!("2001:db8:1:{subnet:x}::1");
            taken += (0..1000).filter(|_| rates.take(networks(&address), now)).count();
        }
        assert_eq!(taken, crate::limits::SITE_ADDRESSES * CONNECTION_BURST as usize);
        assert!(rates.take(networks("2001:db8:2::1"), now), "another site is free");
    }

    #[test]
    fn the_table_is_bounded_and_keeps_who_owes_most() {
        let (mut rates, now) = (Rates::default(), Instant::now());
        let flood = |rates: &mut Rates| (0..1000).filter(|_| rates.take(networks("192.0.2.1"), now)).count();
        assert_eq!(flood(&mut rates), CONNECTION_BURST as usize);
        for number in 0..3 * u32::try_from(MAX_RATED_NETWORKS).unwrap() {
            rates.take(Network::all_of(std::net::Ipv4Addr::from(0x0a00_0000 + number).into()), now);
            assert!(rates.full_at.len() <= MAX_RATED_NETWORKS + 1);
        }
        assert_eq!(flood(&mut rates), 0);
    }
}
