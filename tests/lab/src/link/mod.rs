//! A network emulator: datagrams between a real client and a real server, on loopback, with the delays and losses of
//! other networks.
//!
//! [`impairment`] decides what becomes of a datagram: a state machine without a clock or a socket. [`udp`] puts one in
//! either direction of UDP flows; [`lab_udp`] does the same for `lab-udp`, whose data port is agreed over TCP.
//! [`profiles`] has the networks by name.

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
