//! The control conversation, from Hello to Bye: bytes in, events and bytes out. The page owns the stream.

use std::{collections::VecDeque, time::Duration};

use gnomon_client_core::mask::world::News;
use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::CodecId,
    ids::{BearerToken, ResumeToken},
    limits::MAX_MESSAGE_BYTES,
    message::{self, ClientMessage, Hello, MessageError, Refusal, ServerMessage, Welcome},
    text::PeerText,
};
use thiserror::Error;

use crate::scene_fetch::{FetchError, SceneFetch};

const PREFIX_BYTES: usize = 4;

/// What a page asks of a server.
#[derive(Debug, Clone)]
pub struct Wishes {
    pub token: Option<BearerToken>,
    /// Of the largest mask, in pixels.
    pub width: u32,
    pub height: u32,
    pub codec: CodecId,
    /// Most masks a second; 0 for as many as there are.
    pub rate_hz: u16,
    /// Of the session to take over.
    pub resume: Option<ResumeToken>,
}

/// What the server has said.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    Welcome(Welcome),
    Refused(Refusal),
    /// Bytes of the scene so far.
    Fetching {
        have: u64,
        length: u64,
    },
    /// The packed scene, with the digest that Welcome named.
    Scene(Vec<u8>),
    Pong(u64),
    Draining {
        reason: PeerText,
        deadline: Duration,
        alternative: Option<PeerText>,
    },
    World(News),
    Closing {
        reason: PeerText,
        /// Whether the page may come back by itself.
        may_return: bool,
    },
}

/// How the server broke the rules.
#[derive(Debug, Error)]
pub enum ConversationError {
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error(transparent)]
    Fetch(#[from] FetchError),
    #[error("the server sent {0} out of turn")]
    OutOfTurn(&'static str),
}

#[derive(Debug)]
pub struct Conversation {
    /// Bytes that are no whole message yet.
    received: Vec<u8>,
    outgoing: Vec<u8>,
    events: VecDeque<Event>,
    welcome: Option<Welcome>,
    fetch: Option<SceneFetch>,
}

impl Conversation {
    /// Begins with Hello.
    ///
    /// # Errors
    /// If the token is too long.
    pub fn begin(wishes: Wishes) -> Result<Self, ConversationError> {
        let Wishes { token, width, height, codec, rate_hz, resume } = wishes;
        let hello = Hello {
            version: PROTOCOL_VERSION,
            token,
            client: concat!("gnomon-web ", env!("CARGO_PKG_VERSION")).into(),
            width,
            height,
            codec,
            rate_hz,
            wrong_ppm: 0,
            resume,
        };
        let mut conversation =
            Self { received: Vec::new(), outgoing: Vec::new(), events: VecDeque::new(), welcome: None, fetch: None };
        conversation.say(&ClientMessage::Hello(hello))?;
        Ok(conversation)
    }

    /// Returns the server's Welcome, once it has come.
    #[must_use]
    pub fn welcome(&self) -> Option<&Welcome> {
        self.welcome.as_ref()
    }

    /// Takes bytes of the server's stream.
    ///
    /// # Errors
    /// If the server breaks the rules: the page then closes the connection.
    pub fn receive(&mut self, bytes: &[u8]) -> Result<(), ConversationError> {
        self.received.extend_from_slice(bytes);
        let mut used = 0;
        while let Some(prefix) = self.received[used..].first_chunk::<PREFIX_BYTES>() {
            let length = message::decode_length(*prefix)?;
            let begin = used + PREFIX_BYTES;
            let Some(content) = self.received.get(begin..begin + length) else { break };
            let message = message::decode(content)?;
            used = begin + length;
            self.take(message)?;
        }
        self.received.drain(..used);
        debug_assert!(self.received.len() <= PREFIX_BYTES + MAX_MESSAGE_BYTES + bytes.len());
        Ok(())
    }

    fn take(&mut self, message: ServerMessage) -> Result<(), ConversationError> {
        let event = match (message, &self.welcome) {
            (ServerMessage::Welcome(welcome), None) => {
                self.welcome = Some(welcome.clone());
                Event::Welcome(welcome)
            }
            (ServerMessage::Refused(refusal), None) => Event::Refused(refusal),
            (ServerMessage::SceneChunk { offset, bytes }, Some(_)) => {
                let fetch = self.fetch.as_mut().ok_or(ConversationError::OutOfTurn("a part of the scene"))?;
                fetch.append(offset, &bytes)?;
                let (have, length) = fetch.progress();
                self.push(Event::Fetching { have, length });
                if have < length {
                    return Ok(());
                }
                match self.fetch.take() {
                    Some(fetch) => Event::Scene(fetch.finish()?),
                    None => return Ok(()),
                }
            }
            (ServerMessage::Pong(number), Some(_)) => Event::Pong(number),
            (ServerMessage::Draining { reason, deadline_ms, alternative }, _) => {
                Event::Draining { reason, deadline: Duration::from_millis(deadline_ms.into()), alternative }
            }
            (
                message @ (ServerMessage::Edited(_) | ServerMessage::EditRefused { .. } | ServerMessage::Clock(_)),
                Some(_),
            ) => match News::try_from(message) {
                Ok(news) => Event::World(news),
                Err(_) => return Ok(()),
            },
            (ServerMessage::Closing { reason, may_return }, _) => Event::Closing { reason, may_return },
            (ServerMessage::Welcome(_), Some(_)) => return Err(ConversationError::OutOfTurn("another Welcome")),
            (ServerMessage::Refused(_), Some(_)) => return Err(ConversationError::OutOfTurn("a refusal")),
            (_, None) => return Err(ConversationError::OutOfTurn("a message before Welcome")),
        };
        self.push(event);
        Ok(())
    }

    /// Adds an event. Progress replaces progress, so that a page that does not ask holds a few events only.
    fn push(&mut self, event: Event) {
        if matches!(event, Event::Fetching { .. } | Event::Pong(_)) {
            let same = |other: &Event| std::mem::discriminant(other) == std::mem::discriminant(&event);
            self.events.retain(|other| !same(other));
        }
        self.events.push_back(event);
    }

    /// Returns the oldest event that was not taken yet.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Returns the bytes to write to the server's stream.
    pub fn take_outgoing(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.outgoing)
    }

    /// Asks for the scene.
    ///
    /// # Errors
    /// If there is no Welcome, or its scene is too large.
    pub fn fetch(&mut self) -> Result<(), ConversationError> {
        let welcome = self.welcome.as_ref().ok_or(ConversationError::OutOfTurn("no Welcome"))?;
        self.fetch = Some(SceneFetch::begin(welcome.scene_digest, welcome.scene_bytes)?);
        self.say(&ClientMessage::FetchScene { offset: 0 })
    }

    /// # Errors
    /// Never with these messages.
    pub fn start(&mut self) -> Result<(), ConversationError> {
        self.say(&ClientMessage::Start)
    }

    /// # Errors
    /// As [`Self::start`].
    pub fn ping(&mut self, number: u64) -> Result<(), ConversationError> {
        self.say(&ClientMessage::Ping(number))
    }

    /// # Errors
    /// As [`Self::start`].
    pub fn leave(&mut self) -> Result<(), ConversationError> {
        self.say(&ClientMessage::Bye)
    }

    fn say(&mut self, message: &ClientMessage) -> Result<(), ConversationError> {
        self.outgoing.extend(message::encode(message)?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use gnomon_protocol::ids::{SceneDigest, SessionId};

    use super::*;

    fn wishes() -> Wishes {
        Wishes {
            token: Some("key".into()),
            width: 640,
            height: 360,
            codec: CodecId::TilesFast,
            rate_hz: 60,
            resume: None,
        }
    }

    fn welcome(scene: &[u8]) -> ServerMessage {
        ServerMessage::Welcome(Welcome {
            session: SessionId(1),
            scene_digest: SceneDigest(*blake3::hash(scene).as_bytes()),
            scene_bytes: scene.len() as u64,
            lights: 1,
            backend: "cpu".into(),
            data_port: None,
            resume: ResumeToken([7; 16]),
            may_edit: true,
            shared_world: false,
            revision: 0,
        })
    }

    fn chunk(offset: u64, bytes: &[u8]) -> ServerMessage {
        ServerMessage::SceneChunk { offset, bytes: bytes.to_vec() }
    }

    /// What the client has said since the last call.
    fn said(conversation: &mut Conversation) -> Vec<ClientMessage> {
        let bytes = conversation.take_outgoing();
        let mut rest = bytes.as_slice();
        let mut messages = Vec::new();
        while let Some((prefix, after)) = rest.split_first_chunk::<4>() {
            let (content, next) = after.split_at(message::decode_length(*prefix).unwrap());
            messages.push(message::decode(content).unwrap());
            rest = next;
        }
        messages
    }

    fn hear(conversation: &mut Conversation, message: &ServerMessage) -> Result<(), ConversationError> {
        conversation.receive(&message::encode(message).unwrap())
    }

    #[test]
    fn a_scene_is_fetched_and_the_session_starts() {
        let scene = b"a packed scene";
        let mut conversation = Conversation::begin(wishes()).unwrap();
        let hello = said(&mut conversation).remove(0);
        assert!(
            matches!(hello, ClientMessage::Hello(Hello { version: PROTOCOL_VERSION, width: 640, .. })),
            "{hello:?}"
        );
        let heard: Vec<u8> = [welcome(scene), chunk(0, &scene[..5]), chunk(5, &scene[5..])]
            .iter()
            .map(|message| message::encode(message).unwrap())
            .collect::<Vec<_>>()
            .concat();
        let first = message::encode(&welcome(scene)).unwrap().len();
        // Byte by byte, as a stream may bring them.
        heard[..first].iter().for_each(|byte| conversation.receive(&[*byte]).unwrap());
        assert!(matches!(conversation.poll_event(), Some(Event::Welcome(_))));
        conversation.fetch().unwrap();
        assert_eq!(said(&mut conversation), [ClientMessage::FetchScene { offset: 0 }]);
        heard[first..].iter().for_each(|byte| conversation.receive(&[*byte]).unwrap());
        assert_eq!(conversation.poll_event(), Some(Event::Fetching { have: 14, length: 14 }));
        assert_eq!(conversation.poll_event(), Some(Event::Scene(scene.to_vec())));
        conversation.start().unwrap();
        conversation.ping(3).unwrap();
        conversation.leave().unwrap();
        let expected = [ClientMessage::Start, ClientMessage::Ping(3), ClientMessage::Bye];
        assert_eq!(said(&mut conversation), expected);
        hear(&mut conversation, &ServerMessage::Pong(3)).unwrap();
        assert_eq!(conversation.poll_event(), Some(Event::Pong(3)));
        assert_eq!(conversation.poll_event(), None);
    }

    #[test]
    fn a_refusal_is_an_event() {
        let refusal = Refusal::Version { server: 5, client: 6 };
        let mut conversation = Conversation::begin(wishes()).unwrap();
        hear(&mut conversation, &ServerMessage::Refused(refusal.clone())).unwrap();
        assert_eq!(conversation.poll_event(), Some(Event::Refused(refusal)));
    }

    #[test]
    fn a_server_that_breaks_the_rules_is_left() {
        let scene = b"scene";
        let begun = || {
            let mut conversation = Conversation::begin(wishes()).unwrap();
            hear(&mut conversation, &welcome(scene)).unwrap();
            conversation
        };
        let fetching = || {
            let mut conversation = begun();
            conversation.fetch().unwrap();
            conversation
        };
        for (mut conversation, message, part) in [
            (begun(), chunk(0, scene), "out of turn"),
            (begun(), welcome(scene), "another Welcome"),
            (Conversation::begin(wishes()).unwrap(), ServerMessage::Pong(1), "before Welcome"),
            (fetching(), chunk(1, scene), "starts at byte 1"),
            (fetching(), chunk(0, b"scenes"), "more than"),
            (fetching(), chunk(0, b"other"), "announced"),
        ] {
            let error = hear(&mut conversation, &message).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
        let mut conversation = begun();
        assert!(conversation.receive(&[0xff; 8]).is_err(), "a length beyond the limit");
        assert!(begun().receive(&[1, 0, 0, 0, 0x77]).is_err(), "no message");
    }

    #[test]
    fn events_do_not_pile_up() {
        let mut conversation = Conversation::begin(wishes()).unwrap();
        hear(&mut conversation, &welcome(b"scene")).unwrap();
        (0..1000).for_each(|number| hear(&mut conversation, &ServerMessage::Pong(number)).unwrap());
        assert_eq!(conversation.events.len(), 2);
    }
}
