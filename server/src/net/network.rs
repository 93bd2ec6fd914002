//! Whose an address is: what one owner can fill with addresses counts as one.

use std::net::{IpAddr, Ipv6Addr};

/// A range of addresses that one peer may own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Network {
    /// An IPv4 address, or an IPv6 /64, which one owner has all of.
    Address(IpAddr),
    /// An IPv6 /48, which one site has all of: 65,536 times a /64.
    Site(Ipv6Addr),
}

impl Network {
    /// The smallest network of an address.
    pub(crate) fn of(address: IpAddr) -> Self {
        Self::Address(match address.to_canonical() {
            IpAddr::V4(address) => address.into(),
            IpAddr::V6(address) => first(address, 64).into(),
        })
    }

    /// All networks of an address.
    pub(crate) fn all_of(address: IpAddr) -> impl Iterator<Item = Self> + Clone {
        let site = match address.to_canonical() {
            IpAddr::V4(_) => None,
            IpAddr::V6(address) => Some(Self::Site(first(address, 48))),
        };
        std::iter::once(Self::of(address)).chain(site)
    }

    /// Its share of a limit that holds for one address.
    pub(crate) const fn times(self) -> usize {
        match self {
            Self::Address(_) => 1,
            Self::Site(_) => crate::limits::SITE_ADDRESSES,
        }
    }
}

/// The first address of the network of `bits` bits.
fn first(address: Ipv6Addr, bits: u32) -> Ipv6Addr {
    (u128::from(address) & (u128::MAX << (128 - bits))).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_owner_counts_once_for_all_its_addresses() {
        let all = |text: &str| Network::all_of(text.parse().unwrap()).collect::<Vec<_>>();
        assert_eq!(all("192.0.2.1"), all("::ffff:192.0.2.1"));
        assert_ne!(all("192.0.2.1"), all("192.0.2.2"));
        let [one, same, neighbour, other] =
            ["2001:db8:1:2::1", "2001:db8:1:2:ffff::9", "2001:db8:1:3::1", "2001:db8:2:2::1"].map(all);
        assert_eq!(one, same);
        assert!(one[0] != neighbour[0] && one[1] == neighbour[1]);
        assert!(one[0] != other[0] && one[1] != other[1]);
    }
}
