//! A running session: three tasks, until either side leaves.

use std::{
    convert::Infallible,
    io,
    pin::pin,
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_client_core::mask::world::{News, Terms, World};
use gnomon_protocol::{
    ids::FrameNumber,
    message::ClientMessage,
    pose::Pose,
    receive::{FrameReceiver, ReceiverConfig},
};
use gnomon_transport::root_cause;
use tokio::{
    sync::{mpsc, oneshot, watch},
    task::JoinHandle,
    time::timeout,
};

use super::{
    connection::{OpenConnection, QuicHandle},
    control_task::{ControlTask, RoundTrip},
    health::{Health, HealthCell, watch_silence},
    mask_buffer::{MaskReader, mask_buffer},
    mask_files::{FileFailure, MaskFiles},
    receive::{Counters, ReceiveTask, Received, Requested},
    send::{OutgoingPose, send_poses},
    session_spec::SessionSpec,
};
use crate::error::ClientError;

/// Messages with edits that wait to be written, and news of the scene that wait for the frame loop.
const WAITING_EDITS: usize = 4;
const WAITING_NEWS: usize = 64;

/// How long a server may take to send the reason after its data has ended.
const CLOSING_TIMEOUT: Duration = Duration::from_millis(300);

#[derive(Debug)]
pub(crate) struct Session {
    spec: SessionSpec,
    poses: watch::Sender<OutgoingPose>,
    counters: Counters,
    requested: Requested,
    round_trip: RoundTrip,
    health: HealthCell,
    quic: QuicHandle,
    failure: FileFailure,
    terms: Terms,
    edits: mpsc::Sender<ClientMessage>,
    news: mpsc::Receiver<News>,
    leave: oneshot::Sender<()>,
    tasks: JoinHandle<()>,
}

impl Session {
    pub(super) fn start(
        (spec, terms): (SessionSpec, Terms),
        connection: OpenConnection,
        files: Option<MaskFiles>,
    ) -> (Self, MaskReader) {
        let OpenConnection { reader, writer, sender, receiver: datagrams, quic } = connection;
        let (mask_writer, mask_reader) = mask_buffer(spec.shape);
        let (poses, newest_pose) = watch::channel(None);
        let (acknowledge, acknowledgements) = watch::channel(None);
        let (report_losses, losses) = watch::channel(None);
        let (counters, requested, failure) = (Counters::default(), Requested::default(), FileFailure::default());
        let config = ReceiverConfig {
            policy: spec.reception.policy,
            largest: spec.shape,
            // Saved masks must be decodable alone.
            keeps_references: spec.reception.save_masks.is_none(),
            reports_losses: spec.reception.reports_losses,
        };
        let receive = ReceiveTask {
            datagrams,
            receiver: FrameReceiver::new(config),
            writer: mask_writer,
            requested: requested.clone(),
            counters: Arc::clone(&counters),
            acknowledge,
            report_losses,
            files,
            failure: FileFailure::clone(&failure),
        };
        let (round_trip, health) = (RoundTrip::default(), HealthCell::default());
        let (leave, left) = oneshot::channel();
        let (edits, edited) = mpsc::channel(WAITING_EDITS);
        let (heard, news) = mpsc::channel(WAITING_NEWS);
        let control = ControlTask {
            reader,
            writer,
            round_trip: Arc::clone(&round_trip),
            health: health.clone(),
            transport: spec.url.transport,
            edits: edited,
            news: heard,
        };
        let silence = watch_silence(quic.clone(), health.clone());
        let send = send_poses(sender, newest_pose, acknowledgements, losses);
        let stop = spec.options.stop.clone();
        let left = async move {
            tokio::select! {
                _ = left => {}
                // The server is told at once, even while the renderer is busy.
                _ = stop.wait() => {}
            }
        };
        let tasks = tokio::spawn(run_tasks(control, receive, send, silence, left));
        let session = Self {
            spec,
            poses,
            counters,
            requested,
            round_trip,
            health,
            quic,
            failure,
            terms,
            edits,
            news,
            leave,
            tasks,
        };
        (session, mask_reader)
    }

    /// Sends a frame's pose. It replaces an unsent one.
    pub(crate) fn send_pose(&self, frame: FrameNumber, pose: Pose) {
        self.requested.change(|requests| requests.request(frame));
        self.poses.send_replace(Some((frame, pose)));
    }

    /// Sends a frame's pose again, because its mask is missing or was `refused`.
    pub(crate) fn send_pose_again(&self, frame: FrameNumber, pose: Pose, refused: bool) {
        self.requested.change(|requests| requests.request_again(frame, refused));
        self.send_pose(frame, pose);
    }

    /// How the server keeps its scene.
    pub(crate) fn terms(&self) -> Terms {
        self.terms
    }

    /// Takes what the server has said of its scene, and sends what this client changes.
    pub(crate) fn exchange(&mut self, world: &mut World, now: Instant) {
        let round_trip = self.round_trip().unwrap_or_default();
        while let Ok(news) = self.news.try_recv() {
            world.hear(&news, round_trip, now);
        }
        if let Ok(room) = self.edits.try_reserve()
            && let Some((number, edits)) = world.next_message(now)
        {
            room.send(ClientMessage::Edit { number, edits });
        }
    }

    pub(crate) fn received(&self) -> Received {
        *self.counters.lock()
    }

    pub(crate) fn health(&self) -> Health {
        self.health.get()
    }

    pub(crate) fn spec(&self) -> &SessionSpec {
        &self.spec
    }

    /// Returns the smoothed round trip of pings, or QUIC's estimate before the first answer.
    pub(crate) fn round_trip(&self) -> Option<Duration> {
        self.round_trip.lock().or_else(|| self.quic.round_trip())
    }

    /// Returns why a file of masks could not be written, once.
    pub(crate) fn take_failure(&self) -> Option<ClientError> {
        self.failure.lock().take()
    }

    /// Ends the session and closes the connection.
    pub(crate) async fn leave(self) {
        // The tasks may have ended.
        let _ = self.leave.send(());
        let _ = self.tasks.await;
        self.quic.close().await;
    }
}

/// Runs the tasks until the client leaves or one of them ends.
async fn run_tasks(
    mut control: ControlTask,
    receive: ReceiveTask,
    send: impl Future<Output = io::Result<Infallible>> + Send + 'static,
    silence: impl Future<Output = ()> + Send,
    left: impl Future<Output = ()> + Send,
) {
    let ender = receive.writer.ender();
    // Separate tasks: decoding takes long and must not delay pings or poses.
    let mut receiving = tokio::spawn(receive.run());
    let mut sending = tokio::spawn(send);
    // Dropping the writer would end the masks without a reason, so it is kept until the reason is known.
    let (reason, _writer) = {
        let mut control = pin!(control.run());
        let data = async {
            tokio::select! {
                ended = &mut receiving => match ended {
                    Ok((reason, writer)) => (reason, Some(writer)),
                    Err(error) => (error.to_string(), None),
                },
                ended = &mut sending => match ended {
                    Ok(Ok(never)) => match never {},
                    Ok(Err(error)) => (format!("connection lost: {}", root_cause(&error)), None),
                    Err(error) => (error.to_string(), None),
                },
            }
        };
        tokio::select! {
            () = left => (None, None),
            // Never ends first.
            () = silence => (None, None),
            reason = &mut control => (Some(reason), None),
            // Data and control end together, and the control stream has the reason.
            (reason, writer) = data => (Some(timeout(CLOSING_TIMEOUT, control).await.unwrap_or(reason)), writer),
        }
    };
    match reason {
        Some(reason) => ender.end(reason),
        None => control.leave().await,
    }
    receiving.abort();
    sending.abort();
}
