//! A network emulator: gives datagrams between a real client and server on loopback the delays and losses of other
//! networks.
//!
//! [`impairment`] decides each datagram's fate; it has no clock or socket. [`udp`] applies one to each direction of UDP
//! flows, and [`lab_udp`] to `lab-udp`, whose data port is agreed over TCP. [`profiles`] has the networks by name.

mod counters;
mod flow;
mod handle;
pub mod impairment;
pub mod lab_udp;
pub mod profiles;
pub mod server;
pub mod settings;
pub mod trace;
pub mod udp;

pub use self::{
    counters::LinkCounts,
    handle::Relay,
    impairment::Counts,
    settings::{LinkSettings, Settings},
};
