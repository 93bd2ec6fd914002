//! A session between Hello and Start: admitted by the server, but without frames.

use std::time::Duration;

use gnomon_client_core::mask::world::Terms;
use gnomon_protocol::{
    mask::MaskShape,
    message::{ClientMessage, ServerMessage, Welcome},
};
use gnomon_scene::Scene;
use gnomon_transport::control::ControlError;
use tokio::task::JoinSet;

use super::{
    connection::{QuicHandle, ServerConnection},
    mask_buffer::MaskReader,
    mask_files::MaskFiles,
    receive_options::Reception,
    scene_cache::{CachedScene, SceneCache},
    session::Session,
    session_spec::{SessionOptions, SessionSpec},
    url::ServerUrl,
};
use crate::{error::ClientError, stop::Stop};

const ANSWER_TIMEOUT: Duration = Duration::from_secs(30);

pub(crate) struct PendingSession {
    url: ServerUrl,
    connection: ServerConnection,
    options: SessionOptions,
    pub(crate) welcome: Welcome,
    /// Dropped with the session.
    _closing: JoinSet<()>,
}

impl PendingSession {
    /// Connects to `url` and says Hello.
    ///
    /// # Errors
    /// Errors if the server cannot be reached or refuses, or the run is to end.
    pub(crate) async fn open(url: &ServerUrl, options: &SessionOptions) -> Result<Self, ClientError> {
        let stop = &options.stop;
        let mut connection = stop.unless(ServerConnection::connect(url, options.connect_timeout)).await??;
        let hello = ClientMessage::Hello(options.hello());
        let answer = async {
            connection.writer.write(&hello).await?;
            connection.reader.next_within(ANSWER_TIMEOUT).await
        };
        let answer = match stop.unless(answer).await {
            Ok(answer) => answer,
            Err(cause) => {
                connection.quic().close_now().await;
                return Err(cause.into());
            }
        };
        match answer.map_err(|source| conversation_error(url, &connection, source))? {
            ServerMessage::Welcome(welcome) => {
                let mut closing = JoinSet::new();
                closing.spawn(close_at(stop.clone(), connection.quic()));
                Ok(Self { url: url.clone(), connection, options: options.clone(), welcome, _closing: closing })
            }
            ServerMessage::Refused(refusal) => Err(ClientError::Refused(refusal)),
            message => Err(unexpected(url, message)),
        }
    }

    /// Returns the packed scene, from the cache or from the server. Reports the bytes fetched and the total.
    ///
    /// # Errors
    /// Errors if the connection breaks, the server sends another scene, or the run is to end.
    pub(crate) async fn fetch_scene(
        &mut self,
        cache: &SceneCache,
        progress: impl FnMut(u64, u64),
    ) -> Result<Vec<u8>, ClientError> {
        let stop = self.options.stop.clone();
        match stop.unless(self.fetch(cache, progress)).await {
            Ok(fetched) => fetched,
            Err(cause) => {
                self.connection.quic().close_now().await;
                Err(cause.into())
            }
        }
    }

    async fn fetch(&mut self, cache: &SceneCache, mut progress: impl FnMut(u64, u64)) -> Result<Vec<u8>, ClientError> {
        let (digest, length) = (self.welcome.scene_digest, self.welcome.scene_bytes);
        let mut fetch = match cache.look_up(digest, length)? {
            CachedScene::Whole(bytes) => return Ok(bytes),
            CachedScene::Missing(fetch) => fetch,
        };
        loop {
            self.write(&ClientMessage::FetchScene { offset: fetch.fetched() }).await?;
            while fetch.fetched() < length {
                let message = self.connection.reader.next_within(ANSWER_TIMEOUT).await;
                match message.map_err(|source| conversation_error(&self.url, &self.connection, source))? {
                    ServerMessage::SceneChunk { offset, bytes } => {
                        fetch.append(offset, &bytes)?;
                        progress(fetch.fetched(), length);
                    }
                    ServerMessage::Pong(_) => {}
                    message => return Err(unexpected(&self.url, message)),
                }
            }
            if let Some(bytes) = fetch.finish()? {
                return Ok(bytes);
            }
        }
    }

    /// Unpacks what [`Self::fetch_scene`] returned.
    ///
    /// # Errors
    /// Errors if it is no scene, or not the one that the server announced.
    pub(crate) fn unpack(&self, packed: &[u8]) -> Result<Scene, ClientError> {
        let scene = Scene::unpack(packed)?;
        let (lights, announced) = (scene.lights.len(), self.welcome.lights);
        if lights != announced as usize {
            let reason = format!("it announced {announced} lights, and its scene has {lights}");
            return Err(ClientError::Protocol { url: Box::new(self.url.clone()), reason });
        }
        Ok(scene)
    }

    pub(crate) fn url(&self) -> &ServerUrl {
        &self.url
    }

    /// Leaves without a session.
    pub(crate) async fn leave(self) {
        self.connection.quic().close_now().await;
    }

    /// Starts the session, with masks of at most `shape`.
    ///
    /// # Errors
    /// Errors if the connection breaks or a file of `reception` cannot be opened.
    pub(crate) async fn start(
        mut self,
        shape: MaskShape,
        reception: Reception,
    ) -> Result<(Session, MaskReader), ClientError> {
        let files = MaskFiles::open(&reception)?;
        self.write(&ClientMessage::Start).await?;
        let Self { url, connection, options, welcome, .. } = self;
        let connection = connection
            .open_data(&welcome)
            .await
            .map_err(|error| ClientError::Connect { url: Box::new(url.clone()), reason: format!("data: {error}") })?;
        let options = SessionOptions { resume: Some(welcome.resume), ..options };
        let spec = SessionSpec { url, options, scene_digest: welcome.scene_digest, shape, reception };
        Ok(Session::start((spec, Terms::from(&welcome)), connection, files))
    }

    async fn write(&mut self, message: &ClientMessage) -> Result<(), ClientError> {
        let written = self.connection.writer.write(message).await;
        written.map_err(|source| conversation_error(&self.url, &self.connection, source))
    }
}

/// Gives the server's place back as soon as the run is to end, whatever the client does at that time.
async fn close_at(stop: Stop, quic: QuicHandle) {
    stop.wait().await;
    quic.close_now().await;
}

fn unexpected(url: &ServerUrl, message: ServerMessage) -> ClientError {
    let url = Box::new(url.clone());
    let name = match message {
        ServerMessage::Closing { reason, .. } | ServerMessage::Draining { reason, .. } => {
            return ClientError::Connect { url, reason: reason.to_string() };
        }
        ServerMessage::Welcome(_) => "Welcome",
        ServerMessage::Refused(_) => "Refused",
        ServerMessage::SceneChunk { .. } => "SceneChunk",
        ServerMessage::Pong(_) => "Pong",
        ServerMessage::Edited(_) => "Edited",
        ServerMessage::EditRefused { .. } => "EditRefused",
        ServerMessage::Clock(_) => "Clock",
    };
    ClientError::Protocol { url, reason: format!("unexpected {name}") }
}

fn conversation_error(url: &ServerUrl, connection: &ServerConnection, source: ControlError) -> ClientError {
    let url = Box::new(url.clone());
    match (connection.close_reason(), &source) {
        (Some(reason), ControlError::Stream(_) | ControlError::Closed | ControlError::Truncated) => {
            ClientError::Connect { url, reason }
        }
        _ => ClientError::Conversation { url, source },
    }
}
