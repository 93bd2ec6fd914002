//! Places for connections to the admin address. There is always one more, so that probes are answered: when all are
//! taken, the oldest connection that has asked nothing makes room.

use std::{
    collections::VecDeque,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use crate::{
    limits::{ADMIN_GRACE, MAX_ADMIN_CONNECTIONS},
    task::Task,
};

/// Set once a connection has sent a whole request.
pub(super) type Asked = Arc<AtomicBool>;

struct Seat {
    task: Task,
    asked: Asked,
    since: Instant,
}

#[derive(Default)]
pub(super) struct Seats(VecDeque<Seat>);

impl Seats {
    /// Runs `serve` in its own task. Waits while every connection is too new to have had its chance.
    pub(super) async fn seat<F>(&mut self, serve: impl FnOnce(Asked) -> F)
    where
        F: Future<Output = ()> + Send + 'static,
    {
        self.make_room().await;
        let asked = Asked::default();
        let task = Task::spawn(serve(Arc::clone(&asked)));
        self.0.push_back(Seat { task, asked, since: Instant::now() });
    }

    async fn make_room(&mut self) {
        self.0.retain(|seat| !seat.task.0.is_finished());
        if self.0.len() < MAX_ADMIN_CONNECTIONS {
            return;
        }
        let idle = self.0.iter().position(|seat| !seat.asked.load(Ordering::Relaxed)).unwrap_or(0);
        if let Some(seat) = self.0.get(idle) {
            tokio::time::sleep(ADMIN_GRACE.saturating_sub(seat.since.elapsed())).await;
        }
        self.0.remove(idle);
    }
}
