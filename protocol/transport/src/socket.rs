//! UDP sockets.

use std::{
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
};

use socket2::{Domain, Protocol, Socket, Type};

/// Binds a non-blocking UDP socket, and asks the kernel for `buffer_bytes` in each direction.
///
/// The kernel clamps the buffers to its limit. Smaller ones lose datagrams under load, which counts as path loss.
///
/// # Errors
/// Errors if the address is taken or cannot be bound.
pub fn bind_udp(address: SocketAddr, buffer_bytes: usize) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::for_address(address), Type::DGRAM, Some(Protocol::UDP))?;
    if address.is_ipv6() {
        // `[::]` serves IPv4 as well, on every system.
        socket.set_only_v6(false)?;
    }
    let _ = socket.set_recv_buffer_size(buffer_bytes);
    let _ = socket.set_send_buffer_size(buffer_bytes);
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    Ok(socket.into())
}

/// Returns the wildcard address, with any free port, of the same family as `peer`.
#[must_use]
pub fn any_address_for(peer: SocketAddr) -> SocketAddr {
    if peer.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() }
}
