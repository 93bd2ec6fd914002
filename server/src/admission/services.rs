//! State that all sessions of a server share.

use std::{sync::Arc, time::Duration};

use bytes::Bytes;
use gnomon_protocol::ids::SceneDigest;
use gnomon_scene::Scene;
use tokio::sync::watch;

use super::{
    addresses::AddressLimit, capacity::HostCapacity, encoders::Encoders, failed_tokens::FailedTokens,
    permit::SessionPermits, tokens::store::TokenStore,
};
use crate::{metrics::registry::Metrics, origins::Origins, phase::Phase, visibility::engine::Fleet, world::World};

/// The scene in the form that clients fetch.
#[derive(Debug)]
pub(crate) struct SceneAsset {
    pub(crate) packed: Bytes,
    /// BLAKE3 of `packed`.
    pub(crate) digest: SceneDigest,
    pub(crate) lights: u32,
    /// Weight of each light, see [`crate::session::brightness::weights`].
    pub(crate) weights: Vec<u32>,
    /// Whether something moves in it with time.
    pub(crate) moves: bool,
    /// Its nodes that may be edited, and its lights, without geometry.
    pub(crate) stage: Scene,
}

pub(crate) struct Services {
    pub(crate) scene: SceneAsset,
    pub(crate) engine: Fleet,
    /// `None` gives each session a world of its own.
    pub(crate) shared_world: Option<Arc<World>>,
    /// `None` admits every client.
    pub(crate) tokens: Option<Arc<TokenStore>>,
    pub(crate) failed_tokens: FailedTokens,
    pub(crate) addresses: Arc<AddressLimit>,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) permits: SessionPermits,
    pub(crate) capacity: HostCapacity,
    pub(crate) phase: watch::Receiver<Phase>,
    /// Limits how many sessions encode at once.
    pub(crate) encoders: Encoders,
    pub(crate) handshake_timeout: Duration,
    /// `None` lets pages of every origin connect.
    pub(crate) origins: Option<Origins>,
    pub(crate) drain_ms: u32,
    /// URL to which a draining server sends its clients.
    pub(crate) alternative: Option<String>,
}
