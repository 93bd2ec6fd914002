//! Tells when quinn has forgotten a connection: when the task ends that quinn spawned for it. quinn's own `closed()`
//! comes earlier, before the peer has confirmed or its time for that is up.

use std::{cell::RefCell, io, net::UdpSocket, pin::Pin, sync::Arc, time::Instant};

use quinn::{AsyncTimer, AsyncUdpSocket, Runtime, TokioRuntime};

use super::place::Tenure;

thread_local! {
    /// Of the connection that this thread is accepting.
    static ACCEPTING: RefCell<Option<Tenure>> = const { RefCell::new(None) };
}

/// Runs `accept`, which makes quinn spawn a connection's task. That task then holds `tenure`.
pub(crate) fn accept_for<T>(tenure: Tenure, accept: impl FnOnce() -> T) -> T {
    ACCEPTING.set(Some(tenure));
    let accepted = accept();
    // Still there if quinn has refused the connection.
    drop(ACCEPTING.take());
    accepted
}

#[derive(Debug)]
pub(crate) struct TenureRuntime;

impl Runtime for TenureRuntime {
    fn new_timer(&self, at: Instant) -> Pin<Box<dyn AsyncTimer>> {
        TokioRuntime.new_timer(at)
    }

    fn spawn(&self, work: Pin<Box<dyn Future<Output = ()> + Send>>) {
        let tenure = ACCEPTING.take();
        TokioRuntime.spawn(Box::pin(async move {
            work.await;
            drop(tenure);
        }));
    }

    fn wrap_udp_socket(&self, socket: UdpSocket) -> io::Result<Arc<dyn AsyncUdpSocket>> {
        TokioRuntime.wrap_udp_socket(socket)
    }
}
