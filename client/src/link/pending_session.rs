//! A session between Hello and Start: admitted by the server, but without frames.

use std::time::Duration;

use gnomon_protocol::{
    mask::MaskShape,
    message::{ClientMessage, ServerMessage, Welcome},
};
use gnomon_transport::control::ControlError;

use super::{
    connection::ServerConnection,
    mask_buffer::MaskReader,
    mask_files::MaskFiles,
    receive_options::Reception,
    scene_cache::{CachedScene, SceneCache},
    session::Session,
    session_spec::{SessionOptions, SessionSpec},
    url::ServerUrl,
};
use crate::error::ClientError;

const ANSWER_TIMEOUT: Duration = Duration::from_secs(30);

pub(crate) struct PendingSession {
    url: ServerUrl,
    connection: ServerConnection,
    options: SessionOptions,
    pub(crate) welcome: Welcome,
}

impl PendingSession {
    /// Connects to `url` and says Hello.
    ///
    /// # Errors
    /// Errors if the server cannot be reached or refuses.
    pub(crate) async fn open(url: &ServerUrl, options: &SessionOptions) -> Result<Self, ClientError> {
        let mut connection = ServerConnection::connect(url, options.connect_timeout).await?;
        let hello = ClientMessage::Hello(options.hello());
        let answer = async {
            connection.writer.write(&hello).await?;
            connection.reader.next_within(ANSWER_TIMEOUT).await
        };
        let answer = answer.await;
        match answer.map_err(|source| conversation_error(url, &connection, source))? {
            ServerMessage::Welcome(welcome) => {
                Ok(Self { url: url.clone(), connection, options: options.clone(), welcome })
            }
            ServerMessage::Refused(refusal) => Err(ClientError::Refused(refusal)),
            message => Err(unexpected(url, message)),
        }
    }

    /// Returns the packed scene, from the cache or from the server. Reports the bytes fetched and the total.
    ///
    /// # Errors
    /// Errors if the connection breaks or the server sends another scene.
    pub(crate) async fn fetch_scene(
        &mut self,
        cache: &SceneCache,
        mut progress: impl FnMut(u64, u64),
    ) -> Result<Vec<u8>, ClientError> {
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
        let Self { url, connection, options, welcome } = self;
        let connection = connection
            .open_data(&welcome)
            .await
            .map_err(|error| ClientError::Connect { url: Box::new(url.clone()), reason: format!("data: {error}") })?;
        let options = SessionOptions { resume: Some(welcome.resume), ..options };
        let spec = SessionSpec { url, options, scene_digest: welcome.scene_digest, shape, reception };
        Ok(Session::start(spec, connection, files))
    }

    async fn write(&mut self, message: &ClientMessage) -> Result<(), ClientError> {
        let written = self.connection.writer.write(message).await;
        written.map_err(|source| conversation_error(&self.url, &self.connection, source))
    }
}

fn unexpected(url: &ServerUrl, message: ServerMessage) -> ClientError {
    let url = Box::new(url.clone());
    let name = match message {
        ServerMessage::Closing { reason } | ServerMessage::Draining { reason, .. } => {
            return ClientError::Connect { url, reason: reason.to_string() };
        }
        ServerMessage::Welcome(_) => "Welcome",
        ServerMessage::Refused(_) => "Refused",
        ServerMessage::SceneChunk { .. } => "SceneChunk",
        ServerMessage::Pong(_) => "Pong",
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
