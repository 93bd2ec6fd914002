//! Which connections are open, and which newcomer gets a place. Time is an argument.

use std::{
    cmp::Reverse,
    collections::{BTreeMap, HashMap},
    net::IpAddr,
    time::Instant,
};

use super::rates::Rates;
use crate::{
    limits::{
        MAX_HANDSHAKES, MAX_HANDSHAKES_PER_ADDRESS, MAX_WITHOUT_SESSION, MAX_WITHOUT_SESSION_PER_ADDRESS,
        SITE_ADDRESSES,
    },
    net::network::Network,
};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stage {
    /// From the first packet to admission.
    Handshake,
    /// It has a session.
    Admitted,
    /// Its end has begun, but the transport still keeps it.
    Closing,
}

impl Stage {
    /// Metric labels, in order.
    pub(crate) const LABELS: [&str; 3] = ["handshake", "admitted", "closing"];
}

/// Why a newcomer gets no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Turned {
    /// Its network opens connections too fast.
    TooFast,
    /// Too many connections without a session are open, or too many of its network.
    TooMany,
}

#[derive(Debug, Clone, Copy, Default)]
struct Load {
    handshakes: usize,
    closing: usize,
}

/// `E` is told to an evicted connection's owner.
#[derive(Debug)]
pub(super) struct Table<E> {
    next: u64,
    /// In order of arrival.
    handshakes: BTreeMap<u64, (IpAddr, E)>,
    others: HashMap<u64, (IpAddr, Stage)>,
    /// Connections without a session, of networks that have some.
    loads: HashMap<Network, Load>,
    counts: [usize; Stage::LABELS.len()],
    rates: Rates,
}

impl<E> Default for Table<E> {
    fn default() -> Self {
        Self {
            next: 0,
            handshakes: BTreeMap::new(),
            others: HashMap::new(),
            loads: HashMap::new(),
            counts: [0; Stage::LABELS.len()],
            rates: Rates::default(),
        }
    }
}

impl<E> Table<E> {
    pub(super) const fn counts(&self) -> [usize; Stage::LABELS.len()] {
        self.counts
    }

    /// Gives a newcomer a place. Returns its number, and the owner of the handshake that has to make room for it, if
    /// any: the oldest of the network that fills the largest share of its limit, so that a flood evicts itself.
    pub(super) fn arrive(&mut self, peer: IpAddr, owner: E, now: Instant) -> Result<(u64, Option<E>), Turned> {
        let without_session = self.count(Stage::Handshake) + self.count(Stage::Closing);
        let crowded = |network: Network| {
            let Load { handshakes, closing } = self.load(network);
            handshakes + closing >= MAX_WITHOUT_SESSION_PER_ADDRESS * network.times()
        };
        if without_session >= MAX_WITHOUT_SESSION || Network::all_of(peer).any(crowded) {
            return Err(Turned::TooMany);
        }
        if !self.rates.take(Network::all_of(peer), now) {
            return Err(Turned::TooFast);
        }
        let full = |network: &Network| self.load(*network).handshakes >= MAX_HANDSHAKES_PER_ADDRESS * network.times();
        let evicted = match Network::all_of(peer).find(full) {
            Some(network) => self.oldest_of(network),
            None if self.handshakes.len() >= MAX_HANDSHAKES => self.oldest_of_the_fullest(),
            None => None,
        };
        let evicted = evicted.and_then(|number| self.evict(number));
        let number = self.next;
        self.next += 1;
        self.handshakes.insert(number, (peer, owner));
        self.add(peer, Stage::Handshake);
        Ok((number, evicted))
    }

    /// Does nothing if the transport has forgotten the connection already.
    pub(super) fn set(&mut self, number: u64, stage: Stage) {
        let known = self.handshakes.remove(&number).map(|(peer, _)| (peer, Stage::Handshake));
        let Some((peer, before)) = known.or_else(|| self.others.remove(&number)) else { return };
        self.remove(peer, before);
        self.others.insert(number, (peer, stage));
        self.add(peer, stage);
    }

    /// Forgets a connection.
    pub(super) fn leave(&mut self, number: u64) {
        let known = self.handshakes.remove(&number).map(|(peer, _)| (peer, Stage::Handshake));
        if let Some((peer, stage)) = known.or_else(|| self.others.remove(&number)) {
            self.remove(peer, stage);
        }
    }

    fn evict(&mut self, number: u64) -> Option<E> {
        let (peer, owner) = self.handshakes.remove(&number)?;
        self.remove(peer, Stage::Handshake);
        self.others.insert(number, (peer, Stage::Closing));
        self.add(peer, Stage::Closing);
        Some(owner)
    }

    /// The oldest handshake of the networks whose handshakes are the largest share of their limit.
    fn oldest_of_the_fullest(&self) -> Option<u64> {
        let share = |peer| {
            let of = |network: Network| self.load(network).handshakes * SITE_ADDRESSES / network.times();
            Network::all_of(peer).map(of).max()
        };
        let shares = self.handshakes.iter().map(|(number, (peer, _))| (share(*peer), *number));
        shares.max_by_key(|(share, number)| (*share, Reverse(*number))).map(|(_, number)| number)
    }

    fn oldest_of(&self, network: Network) -> Option<u64> {
        let inside = |peer: IpAddr| Network::all_of(peer).any(|its| its == network);
        self.handshakes.iter().find(|(_, (peer, _))| inside(*peer)).map(|(number, _)| *number)
    }

    const fn count(&self, stage: Stage) -> usize {
        self.counts[stage as usize]
    }

    fn load(&self, network: Network) -> Load {
        self.loads.get(&network).copied().unwrap_or_default()
    }

    fn add(&mut self, peer: IpAddr, stage: Stage) {
        self.counts[stage as usize] += 1;
        for network in Network::all_of(peer) {
            match stage {
                Stage::Handshake => self.loads.entry(network).or_default().handshakes += 1,
                Stage::Closing => self.loads.entry(network).or_default().closing += 1,
                Stage::Admitted => {}
            }
        }
    }

    fn remove(&mut self, peer: IpAddr, stage: Stage) {
        self.counts[stage as usize] -= 1;
        for network in Network::all_of(peer) {
            let Some(load) = self.loads.get_mut(&network) else { continue };
            match stage {
                Stage::Handshake => load.handshakes -= 1,
                Stage::Closing => load.closing -= 1,
                Stage::Admitted => continue,
            }
            if load.handshakes + load.closing == 0 {
                self.loads.remove(&network);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn ip(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    /// A table whose rates don't matter: each newcomer comes a second after the last.
    struct Crowd(Table<&'static str>, Instant);

    impl Crowd {
        fn new() -> Self {
            Self(Table::default(), Instant::now())
        }

        fn arrive(&mut self, peer: IpAddr, name: &'static str) -> Result<(u64, Option<&'static str>), Turned> {
            self.1 += std::time::Duration::from_secs(1);
            self.0.arrive(peer, name, self.1)
        }
    }

    fn v4(number: usize) -> IpAddr {
        std::net::Ipv4Addr::from(0x0a00_0000 + u32::try_from(number).unwrap()).into()
    }

    #[test]
    fn an_address_at_its_limit_evicts_its_own_oldest() {
        let mut crowd = Crowd::new();
        crowd.arrive(ip("192.0.2.2"), "other").unwrap();
        crowd.arrive(ip("192.0.2.1"), "first").unwrap();
        for _ in 1..MAX_HANDSHAKES_PER_ADDRESS {
            assert_eq!(crowd.arrive(ip("192.0.2.1"), "later").unwrap().1, None);
        }
        assert_eq!(crowd.arrive(ip("192.0.2.1"), "last").unwrap().1, Some("first"));
        assert_eq!(crowd.0.counts(), [1 + MAX_HANDSHAKES_PER_ADDRESS, 0, 1]);
    }

    #[test]
    fn a_flood_from_many_addresses_evicts_itself() {
        let mut crowd = Crowd::new();
        crowd.arrive(ip("192.0.2.1"), "good").unwrap();
        for number in 0..2 * MAX_HANDSHAKES {
            // Eight addresses take all places, then evict each other.
            let evicted = crowd.arrive(v4(number % 8), "flood").unwrap().1;
            assert_ne!(evicted, Some("good"), "{number}");
            if let Some((number, _)) = crowd.0.others.iter().next().map(|(number, other)| (*number, *other)) {
                crowd.0.leave(number);
            }
        }
        assert_eq!(crowd.arrive(ip("192.0.2.3"), "new").unwrap().1, Some("flood"));
    }

    #[test]
    fn a_site_with_many_subnets_is_fuller_than_many_addresses() {
        let mut crowd = Crowd::new();
        crowd.arrive(ip("2001:db8:1::1"), "good").unwrap();
        let site = MAX_HANDSHAKES_PER_ADDRESS * SITE_ADDRESSES;
        for subnet in 0..site - 1 {
            assert_eq!(crowd.arrive(ip(&format!("2001:db8:2:{subnet:x}::1")), "site").unwrap().1, None);
        }
        for number in 0..MAX_HANDSHAKES - site {
            assert_eq!(crowd.arrive(v4(number), "crowd").unwrap().1, None);
        }
        assert_eq!(crowd.arrive(v4(99_999), "new").unwrap().1, Some("site"));
        // Below the places of all, a site is bounded by its own.
        for subnet in 0..2 {
            let evicted = crowd.arrive(ip(&format!("2001:db8:2:f00{subnet}::1")), "site").unwrap().1;
            assert_eq!(evicted, Some("site"));
        }
    }

    #[test]
    fn closing_connections_count_until_they_are_forgotten() {
        let mut crowd = Crowd::new();
        let mut numbers = Vec::new();
        for _ in 0..MAX_WITHOUT_SESSION_PER_ADDRESS {
            let (number, _) = crowd.arrive(ip("192.0.2.1"), "").unwrap();
            crowd.0.set(number, Stage::Closing);
            numbers.push(number);
        }
        assert_eq!(crowd.arrive(ip("192.0.2.1"), ""), Err(Turned::TooMany));
        crowd.arrive(ip("192.0.2.2"), "").unwrap();
        crowd.0.leave(numbers[0]);
        crowd.0.set(numbers[0], Stage::Closing);
        let (number, _) = crowd.arrive(ip("192.0.2.1"), "").unwrap();
        // A session does not count here: it has limits of its own.
        crowd.0.set(number, Stage::Admitted);
        crowd.arrive(ip("192.0.2.1"), "").unwrap();
        assert_eq!(crowd.0.counts(), [2, 1, MAX_WITHOUT_SESSION_PER_ADDRESS - 1]);
    }

    #[test]
    fn all_addresses_together_are_bounded() {
        let mut crowd = Crowd::new();
        for number in 0..MAX_WITHOUT_SESSION {
            let (number, _) = crowd.arrive(v4(number), "").unwrap();
            crowd.0.set(number, Stage::Closing);
        }
        assert_eq!(crowd.arrive(ip("192.0.2.1"), ""), Err(Turned::TooMany));
    }

    #[test]
    fn a_network_that_is_too_fast_is_turned_away() {
        let (mut table, now) = (Table::default(), Instant::now());
        let arrivals: Vec<_> = (0..1000)
            .map(|_| {
                let arrived = table.arrive(ip("192.0.2.1"), (), now);
                if let Ok((number, _)) = arrived {
                    table.leave(number);
                }
                arrived.map(|(_, evicted)| evicted)
            })
            .collect();
        let burst = crate::limits::CONNECTION_BURST as usize;
        assert!(arrivals[..burst].iter().all(Result::is_ok));
        assert!(arrivals[burst..].iter().all(|arrived| *arrived == Err(Turned::TooFast)));
    }

    proptest! {
        /// However peers come and go, counts are those of the entries, and nothing is kept of who has left.
        #[test]
        fn counts_are_never_wrong(steps in proptest::collection::vec((0_u8..4, 0_u8..40, 0_usize..64), 1..400)) {
            let mut crowd = Crowd::new();
            let mut open = Vec::new();
            for (what, who, which) in steps {
                let peer = if who < 20 { v4(who.into()) } else { ip(&format!("2001:db8:1:{who:x}::1")) };
                match what {
                    0 | 1 => if let Ok((number, _)) = crowd.arrive(peer, "") { open.push(number) },
                    2 if !open.is_empty() => {
                        let stage = [Stage::Admitted, Stage::Closing][which % 2];
                        crowd.0.set(open[which % open.len()], stage);
                    }
                    _ if !open.is_empty() => crowd.0.leave(open.swap_remove(which % open.len())),
                    _ => {}
                }
                prop_assert_eq!(crowd.0.counts().iter().sum::<usize>(), open.len());
                prop_assert!(crowd.0.handshakes.len() <= MAX_HANDSHAKES);
            }
            for number in open {
                crowd.0.leave(number);
            }
            prop_assert!(crowd.0.loads.is_empty() && crowd.0.others.is_empty() && crowd.0.handshakes.is_empty());
            prop_assert_eq!(crowd.0.counts(), [0; 3]);
        }
    }
}
