//! How much one address may have at a time, so that no single peer takes what is there for all.

use std::{
    collections::HashMap,
    net::{IpAddr, Ipv6Addr},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// What each address holds. An IPv6 network of 64 bits counts as one: its owner has all of its addresses.
#[derive(Debug)]
pub(crate) struct Addresses {
    most: usize,
    /// Whether loopback is counted. Behind a proxy on this machine everybody has that address.
    loopback: bool,
    /// Only of those that hold something, so what is held bounds it.
    held: Mutex<HashMap<IpAddr, usize>>,
}

/// A share that is held; dropping it gives it back. The default is what loopback holds.
#[derive(Debug, Default)]
pub(crate) struct Held {
    of: Option<(Arc<Addresses>, IpAddr)>,
}

impl Addresses {
    /// At most `most` for each.
    pub(crate) fn new(most: usize, loopback: bool) -> Arc<Self> {
        Arc::new(Self { most, loopback, held: Mutex::default() })
    }

    /// Takes one, unless the address has its share already.
    pub(crate) fn take(self: &Arc<Self>, address: IpAddr) -> Option<Held> {
        self.take_below(address, self.most)
    }

    /// Takes one even beyond the share, for who gives another back soon: a client that moves from a lost connection to a new one.
    pub(crate) fn take_over(self: &Arc<Self>, address: IpAddr) -> Option<Held> {
        self.take_below(address, usize::MAX)
    }

    fn take_below(self: &Arc<Self>, address: IpAddr, most: usize) -> Option<Held> {
        if !self.loopback && address.to_canonical().is_loopback() {
            return Some(Held::default());
        }
        let owner = owner(address);
        let mut held = self.held();
        let count = held.entry(owner).or_default();
        if *count >= most {
            return None;
        }
        *count += 1;
        Some(Held { of: Some((Arc::clone(self), owner)) })
    }

    fn held(&self) -> MutexGuard<'_, HashMap<IpAddr, usize>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        let Some((addresses, owner)) = self.of.take() else { return };
        let mut held = addresses.held();
        if let Some(count) = held.get_mut(&owner) {
            *count -= 1;
            if *count == 0 {
                held.remove(&owner);
            }
        }
    }
}

fn owner(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(address) => address.into(),
        IpAddr::V6(address) => {
            let network = u128::from(address) & !u128::from(u64::MAX);
            Ipv6Addr::from(network).into()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_gets_its_share_and_no_more() {
        let addresses = Addresses::new(2, false);
        let take = |text: &str| addresses.take(text.parse().unwrap());
        let (first, _second) = (take("192.0.2.1").unwrap(), take("::ffff:192.0.2.1").unwrap());
        assert!(take("192.0.2.1").is_none());
        let _other = take("192.0.2.2").unwrap();
        drop(first);
        let _third = take("192.0.2.1").unwrap();
        let moved = addresses.take_over("192.0.2.1".parse().unwrap());
        assert!(moved.is_some() && take("192.0.2.1").is_none(), "it counts all the same");
        drop(moved);
        let _network = [take("2001:db8::1").unwrap(), take("2001:db8::2").unwrap()];
        assert!(take("2001:db8::3").is_none() && take("2001:db8:0:1::3").is_some());
        let many: Vec<_> = (0..9).filter_map(|_| take("127.0.0.1")).collect();
        assert_eq!(many.len(), 9, "loopback is exempt");
        assert!(Addresses::new(0, true).take("127.0.0.1".parse().unwrap()).is_none());
    }

    #[test]
    fn nothing_is_kept_of_who_holds_nothing() {
        let addresses = Addresses::new(1, true);
        drop(addresses.take("192.0.2.1".parse().unwrap()));
        assert!(addresses.held().is_empty());
    }
}
