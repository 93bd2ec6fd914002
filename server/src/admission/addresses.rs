//! Limits of sessions per client address, so that one peer cannot take all of them.

use std::{collections::HashMap, net::IpAddr, sync::Arc};

use parking_lot::Mutex;

use crate::net::network::Network;

/// Counts permits per address. An IPv6 /64 counts as one address, since one owner has all of it.
#[derive(Debug)]
pub(crate) struct AddressLimit {
    max: usize,
    /// True to limit loopback, too. Behind a local proxy every client has that address.
    loopback: bool,
    /// Only addresses with permits, so the permits bound its size.
    counts: Mutex<HashMap<Network, usize>>,
}

/// Released on drop. The default is for loopback, which is not counted.
#[derive(Debug, Default)]
pub(crate) struct AddressPermit {
    counted: Option<(Arc<AddressLimit>, Network)>,
}

impl AddressLimit {
    pub(crate) fn new(max: usize, loopback: bool) -> Arc<Self> {
        Arc::new(Self { max, loopback, counts: Mutex::default() })
    }

    /// Returns `None` when the address is at its limit.
    pub(crate) fn acquire(self: &Arc<Self>, address: IpAddr) -> Option<AddressPermit> {
        if !self.loopback && address.to_canonical().is_loopback() {
            return Some(AddressPermit::default());
        }
        let owner = Network::of(address);
        let mut counts = self.counts.lock();
        let count = counts.entry(owner).or_default();
        if *count >= self.max {
            return None;
        }
        *count += 1;
        Some(AddressPermit { counted: Some((Arc::clone(self), owner)) })
    }
}

impl AddressPermit {
    /// Returns whether a peer at `address` needs no other permit.
    pub(crate) fn covers(&self, address: IpAddr) -> bool {
        match &self.counted {
            Some((_, counted)) => *counted == Network::of(address),
            None => address.to_canonical().is_loopback(),
        }
    }
}

impl Drop for AddressPermit {
    fn drop(&mut self) {
        let Some((limit, owner)) = self.counted.take() else { return };
        let mut counts = limit.counts.lock();
        if let Some(count) = counts.get_mut(&owner) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&owner);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_address_is_limited() {
        let addresses = AddressLimit::new(2, false);
        let take = |text: &str| addresses.acquire(text.parse().unwrap());
        let (first, second) = (take("192.0.2.1").unwrap(), take("::ffff:192.0.2.1").unwrap());
        assert!(take("192.0.2.1").is_none());
        let _other = take("192.0.2.2").unwrap();
        drop(first);
        let _third = take("192.0.2.1").unwrap();
        let covers = |address: &str| second.covers(address.parse().unwrap());
        assert!(covers("192.0.2.1") && !covers("192.0.2.2") && !covers("127.0.0.1"));
        let _network = [take("2001:db8::1").unwrap(), take("2001:db8::2").unwrap()];
        assert!(take("2001:db8::3").is_none() && take("2001:db8:0:1::3").is_some());
        let many: Vec<_> = (0..9).filter_map(|_| take("127.0.0.1")).collect();
        assert_eq!(many.len(), 9, "loopback is exempt");
        assert!(many[0].covers("::1".parse().unwrap()) && !many[0].covers("192.0.2.1".parse().unwrap()));
        assert!(AddressLimit::new(0, true).acquire("127.0.0.1".parse().unwrap()).is_none());
    }

    #[test]
    fn addresses_without_permits_are_forgotten() {
        let addresses = AddressLimit::new(1, true);
        drop(addresses.acquire("192.0.2.1".parse().unwrap()));
        assert!(addresses.counts.lock().is_empty());
    }
}
