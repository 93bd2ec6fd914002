//! Poses in and frames out, once the client has sent Start.

use std::sync::Arc;

use gnomon_protocol::{mask::MaskShape, refresh::Refresh};
use tokio::sync::watch;

use super::{
    driver::{self, DriveError, FrameSender},
    feedback::Feedback,
    poses::receive::receive_poses,
};
use crate::{
    admission::{coding::Coding, services::Services},
    metrics::ledger::Ledger,
    net::link::DataLink,
    phase::stopping,
    visibility::engine::SessionPort,
    world::World,
};

/// The stream's inputs, kept until Start.
pub(super) struct Stream {
    pub(super) data: DataLink,
    pub(super) port: SessionPort,
    pub(super) shape: MaskShape,
    pub(super) coding: Coding,
    /// It declared no rate.
    pub(super) in_background: bool,
}

impl Stream {
    /// Runs until the server stops. Errors if the link or the engine fails.
    pub(super) async fn run(
        self,
        services: Arc<Services>,
        world: Arc<World>,
        ledger: Arc<Ledger>,
    ) -> Result<(), DriveError> {
        let (receiver, sender) = self.data.open(services.handshake_timeout).await?;
        let SessionPort { requests, masks, .. } = self.port;
        let (feedback, newest_feedback) = watch::channel(Feedback::default());
        let sender = FrameSender::new(
            sender,
            self.coding,
            Refresh::new(services.scene.weights.clone()),
            services.encoders.of(self.in_background),
            newest_feedback,
        );
        let mut phase = services.phase.clone();
        let traced = (self.shape, services.scene.moves, &*world);
        let poses = async {
            tokio::select! {
                lost = receive_poses(receiver, &requests, &feedback, traced, &ledger) => {
                    lost.map(|never| match never {})
                }
                // A stopping session takes no more poses, but finishes its frames in flight.
                () = stopping(&mut phase) => std::future::pending().await,
            }
        };
        tokio::select! {
            lost = poses => lost.map_err(DriveError::from),
            ended = driver::drive(masks, &requests, sender, &ledger, services.phase.clone()) => ended,
        }
    }
}
