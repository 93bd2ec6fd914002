//! What the page's worker sees: one object, called from one thread. Nothing here waits.
//!
//! Texts between the two are JSON; `page/worker.js` is the other side.

use gnomon_client_core::{
    camera::path::CameraPath,
    frame::mode::Mode,
    input::{Controls, Sticks},
    mask::world::Terms,
    predictor::Predictor,
    render::readback::Picture,
};
use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::CodecId,
    ids::{BearerToken, ResumeToken},
    message::Refusal,
};
use gnomon_scene::Scene;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use wasm_bindgen::prelude::*;
use web_sys::OffscreenCanvas;
use web_time::Instant;

use crate::{
    conversation::{Conversation, Event, Wishes},
    figures::Figures,
    keys::move_key,
    options::{Options, Settings, Walk, view_named},
    pace::Pace,
    play::Play,
    preparing::Preparing,
    renderer::new_renderer,
    scene_fetch::digest_of,
    screen::Screen,
};

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = console)]
    fn error(text: &str);
}

/// What a page asks of a server.
#[derive(Deserialize)]
struct PageWishes {
    token: Option<String>,
    width: u32,
    height: u32,
    rate_hz: u16,
    codec: Option<String>,
}

/// What a page may choose before the scene is there.
#[derive(Default, Deserialize)]
#[serde(default)]
struct PageOptions {
    exposure: Option<f32>,
    view: Option<String>,
    walk: Option<PageWalk>,
}

#[derive(Deserialize)]
struct PageWalk {
    /// A file of camera paths.
    path: String,
    name: Option<String>,
    frames: u32,
    /// Frames whose pictures the page wants.
    #[serde(default)]
    pictures: Vec<u32>,
}

#[wasm_bindgen]
pub struct Client {
    screen: Screen,
    conversation: Option<Conversation>,
    resume: Option<ResumeToken>,
    /// Of the largest mask of this session, in pixels.
    largest: (u32, u32),
    packed: Option<Vec<u8>>,
    preparing: Option<Preparing>,
    play: Option<Play>,
    options: Options,
    settings: Settings,
    controls: Controls,
    figures: Figures,
    pace: Pace,
    began: Instant,
    last: Option<Instant>,
    /// Frames of a walk whose pictures the page wants.
    pictures: Vec<u32>,
    /// For the page, after the next frame.
    news: Map<String, Value>,
    /// True from the first frame on, from the first one with a mask, and once the adapter has drawn that.
    drawn: bool,
    shadowed: bool,
    shown: bool,
}

fn failed(error: impl std::fmt::Display) -> JsError {
    JsError::new(&error.to_string())
}

#[wasm_bindgen]
impl Client {
    /// Opens the adapter. `options` is a [`PageOptions`].
    pub async fn open(canvas: OffscreenCanvas, options: String) -> Result<Client, JsError> {
        std::panic::set_hook(Box::new(|panic| error(&panic.to_string())));
        let PageOptions { exposure, view, walk } = serde_json::from_str(&options)?;
        let pictures = walk.as_ref().map(|walk| walk.pictures.clone()).unwrap_or_default();
        let walk = walk
            .map(|PageWalk { path, name, frames, .. }| {
                CameraPath::parse(&path, name.as_deref()).map(|path| Walk { path, frames })
            })
            .transpose()?;
        let screen = Screen::open(canvas).await?;
        Ok(Self {
            screen,
            conversation: None,
            resume: None,
            largest: (0, 0),
            packed: None,
            preparing: None,
            play: None,
            options: Options { exposure, view, walk },
            settings: Settings::default(),
            controls: Controls::default(),
            figures: Figures::default(),
            pace: Pace::default(),
            began: Instant::now(),
            last: None,
            pictures,
            news: Map::new(),
            drawn: false,
            shadowed: false,
            shown: false,
        })
    }

    /// The version that a server must speak.
    pub fn protocol_version() -> u16 {
        PROTOCOL_VERSION
    }

    /// Whether the adapter is emulated on the processor.
    pub fn is_software(&self) -> bool {
        self.screen.gpu.is_software()
    }

    /// Begins a conversation. `wishes` is a [`PageWishes`].
    pub fn connect(&mut self, wishes: &str) -> Result<(), JsError> {
        let PageWishes { token, width, height, rate_hz, codec } = serde_json::from_str(wishes)?;
        let codec = codec.as_deref().map_or(Ok(CodecId::TilesFast), |name| name.parse().map_err(|_| failed(name)))?;
        self.largest = (width, height);
        let token = token.map(BearerToken::from);
        let wishes = Wishes { token, width, height, codec, rate_hz, resume: self.resume };
        self.conversation = Some(Conversation::begin(wishes)?);
        Ok(())
    }

    /// Takes bytes of the control stream.
    pub fn control(&mut self, bytes: &[u8]) -> Result<(), JsError> {
        self.conversation.as_mut().map_or(Ok(()), |conversation| conversation.receive(bytes)).map_err(failed)
    }

    /// Bytes for the control stream.
    pub fn outgoing_control(&mut self) -> Vec<u8> {
        self.conversation.as_mut().map(Conversation::take_outgoing).unwrap_or_default()
    }

    /// What the server has said, as JSON; nothing if it has said no more.
    pub fn event(&mut self) -> Option<String> {
        let event = self.conversation.as_mut()?.poll_event()?;
        let value = match event {
            Event::Welcome(welcome) => {
                self.resume = Some(welcome.resume);
                let digest = welcome.scene_digest;
                json!({
                    "is": "welcome",
                    "digest": digest.to_string(),
                    "scene_bytes": welcome.scene_bytes,
                    "lights": welcome.lights,
                    "backend": welcome.backend.to_string(),
                    "has_scene": self.play.as_ref().is_some_and(|play| play.digest() == digest),
                })
            }
            Event::Refused(refusal) => json!({
                "is": "refused",
                "why": match &refusal {
                    Refusal::Version { .. } => "version",
                    Refusal::Token => "token",
                    Refusal::Full { .. } => "full",
                    Refusal::Unsupported(_) => "unsupported",
                    Refusal::Draining => "draining",
                    Refusal::Busy { .. } => "busy",
                },
                "text": refusal.to_string(),
                "retry_after_ms": refusal.retry_after().map(|pause| pause.as_millis() as u64),
            }),
            Event::Fetching { have, length } => json!({ "is": "fetching", "have": have, "length": length }),
            Event::Scene(packed) => {
                self.packed = Some(packed);
                json!({ "is": "scene" })
            }
            Event::Pong(number) => json!({ "is": "pong", "number": number }),
            Event::Draining { reason, deadline, alternative } => json!({
                "is": "draining",
                "reason": reason.to_string(),
                "deadline_ms": deadline.as_millis() as u64,
                // Its certificates are not those that it shows to browsers, so that a page cannot follow.
                "elsewhere": alternative.map(|url| url.to_string()),
            }),
            Event::World(news) => {
                self.play.iter_mut().for_each(|play| play.hear(&news, Instant::now()));
                json!({ "is": "world" })
            }
            Event::Closing { reason, may_return } => {
                json!({ "is": "closing", "reason": reason.to_string(), "may_return": may_return })
            }
        };
        Some(value.to_string())
    }

    /// Asks for the scene.
    pub fn fetch(&mut self) -> Result<(), JsError> {
        self.conversation.as_mut().map_or(Ok(()), Conversation::fetch).map_err(failed)
    }

    /// The fetched scene, to be kept.
    pub fn packed(&self) -> Option<Vec<u8>> {
        self.packed.clone()
    }

    /// Offers a scene that was kept. Returns whether it is the one that the server named.
    pub fn offer(&mut self, packed: Vec<u8>) -> bool {
        let wanted = self.conversation.as_ref().and_then(Conversation::welcome).map(|welcome| welcome.scene_digest);
        let fits = wanted == Some(digest_of(&packed));
        if fits {
            self.packed = Some(packed);
        }
        fits
    }

    /// Takes a step in preparing to draw the scene that was fetched or offered. Returns whether there are more. The
    /// adapter compiles while the later ones compute, if the page lets others run between them.
    pub fn prepare(&mut self) -> Result<bool, JsError> {
        let welcome = self.conversation.as_ref().and_then(Conversation::welcome);
        let Some(welcome) = welcome else { return Ok(false) };
        if let Some(packed) = self.packed.take() {
            let scene = Scene::unpack(&packed)?;
            let (lights, announced) = (scene.lights.len(), welcome.lights);
            if lights != announced as usize {
                return Err(failed(format!("the server announced {announced} lights, and its scene has {lights}")));
            }
            self.preparing = Some(Preparing::Unpacked(Box::new(scene)));
            return Ok(true);
        }
        let (gpu, size, now) = (&self.screen.gpu, self.screen.size(), Instant::now());
        match self.preparing.take() {
            None => return Ok(false),
            Some(Preparing::Unpacked(scene)) => {
                let renderer = new_renderer(gpu, &scene, size, &self.options)?;
                self.preparing = Some(Preparing::Uploaded(Box::new((*scene, renderer))));
                return Ok(true);
            }
            Some(Preparing::Uploaded(uploaded)) => {
                let (scene, renderer) = *uploaded;
                let named = (&scene, welcome.scene_digest);
                match &mut self.play {
                    Some(play) => play.change_scene(renderer, named, now)?,
                    None => {
                        let mut play = Play::new(gpu, renderer, named, size, &self.options, now)?;
                        play.apply(&self.settings)?;
                        self.play = Some(play);
                    }
                }
                self.preparing = Some(Preparing::Dark(Box::new(scene)));
                return Ok(true);
            }
            Some(Preparing::Dark(scene)) => {
                if let Some(play) = &mut self.play {
                    play.light(&scene, now);
                }
            }
        }
        Ok(false)
    }

    /// Says Start: poses go out from now on. The server traces the first while the scene is lit.
    pub fn start(&mut self) -> Result<(), JsError> {
        let (Some(conversation), Some(play)) = (&mut self.conversation, &mut self.play) else {
            return Err(JsError::new("there is no session"));
        };
        conversation.start()?;
        let terms = conversation.welcome().map(Terms::from).unwrap_or_default();
        Ok(play.connected(self.largest, terms, Instant::now())?)
    }

    pub fn ping(&mut self, number: u32) -> Result<(), JsError> {
        self.conversation.as_mut().map_or(Ok(()), |conversation| conversation.ping(number.into())).map_err(failed)
    }

    /// Says Bye.
    pub fn leave(&mut self) -> Result<(), JsError> {
        self.conversation.as_mut().map_or(Ok(()), Conversation::leave).map_err(failed)
    }

    /// The connection is gone. Pictures go on; a scene that is not there yet is asked for again.
    pub fn lost(&mut self) {
        self.conversation = None;
        let preparing = self.preparing.take();
        if let Some(play) = &mut self.play {
            play.lost();
            if let Some(Preparing::Dark(scene)) = preparing {
                play.light(&scene, Instant::now());
            }
        }
    }

    pub fn datagram(&mut self, bytes: &[u8]) {
        if let Some(play) = &mut self.play {
            play.datagram(bytes, Instant::now());
        }
    }

    pub fn outgoing_datagram(&mut self) -> Option<Vec<u8>> {
        self.play.as_mut()?.take_outgoing()
    }

    /// Follows the canvas, in pixels of which the pace takes a share.
    pub fn resize(&mut self, width: u32, height: u32) -> Result<(), JsError> {
        let side = |whole: u32| ((f64::from(whole) * self.pace.share()).round() as u32).max(1);
        let size = (side(width), side(height));
        self.screen.resize(size);
        match &mut self.play {
            Some(play) if play.size() != self.screen.size() => play.resize(self.screen.size()).map_err(failed),
            _ => Ok(()),
        }
    }

    /// Draws the next frame, if the adapter is done with earlier ones. Returns JSON if the page has to know something:
    /// the first frame, the first shadows, a new share of the pixels, a step of a walk.
    pub fn frame(&mut self) -> Result<Option<String>, JsError> {
        let Some(play) = &mut self.play else { return Ok(None) };
        if !self.screen.is_ready() || matches!(self.preparing, Some(Preparing::Dark(_))) {
            return Ok(None);
        }
        if self.shadowed && self.screen.is_idle() && !std::mem::replace(&mut self.shown, true) {
            self.news.insert("shown".to_owned(), true.into());
        }
        // The rest is not to be compiled before the first picture, but beside nothing.
        if play.is_draft() && (!self.screen.is_idle() || play.end_draft()) {
            return Ok(self.take_news());
        }
        if let Some(next) = play.next_of_walk() {
            if self.screen.is_saving() {
                return Ok(None);
            }
            if self.pictures.contains(&next) && play.has_mask_of(next) {
                self.screen.save_picture(next);
            }
        }
        let now = Instant::now();
        let step_s = self.last.replace(now).map_or(0.0, |last| now.saturating_duration_since(last).as_secs_f64());
        let motion = self.controls.take(step_s, f64::from(self.screen.size().1));
        let screen = &mut self.screen;
        let drawn = play.frame(&motion, step_s, now, |renderer, camera, share| screen.show(renderer, camera, share))?;
        let Some(drawn) = drawn else { return Ok(None) };
        self.figures.push(&drawn.stats);
        if !std::mem::replace(&mut self.drawn, true) {
            self.news.insert("drawn".to_owned(), true.into());
        }
        if drawn.stats.mask_frame.is_some() && !std::mem::replace(&mut self.shadowed, true) {
            self.news.insert("shadowed".to_owned(), true.into());
        }
        if let Some((frame, digest)) = drawn.walked {
            let walked = json!({ "frame": frame, "digest": digest, "arrived": drawn.arrived });
            self.news.insert("walked".to_owned(), walked);
        } else if let Some(share) = self.pace.frame(step_s) {
            self.news.insert("share".to_owned(), share.into());
        }
        Ok(self.take_news())
    }

    fn take_news(&mut self) -> Option<String> {
        let news = std::mem::take(&mut self.news);
        (!news.is_empty()).then(|| Value::Object(news).to_string())
    }

    /// After a walk, the person goes on.
    pub fn end_walk(&mut self) {
        if let Some(play) = &mut self.play {
            play.end_walk();
        }
    }

    /// Figures since the last call, as JSON.
    pub fn figures(&mut self) -> Option<String> {
        let play = self.play.as_ref()?;
        let now_s = self.began.elapsed().as_secs_f64();
        let shown = self.figures.take(now_s, play.received(), play.size())?;
        serde_json::to_string(&shown).ok()
    }

    /// Keeps the next picture for [`Self::take_picture`].
    pub fn save_picture(&mut self) {
        self.screen.save_picture(0);
    }

    /// Number, width and height in the first twelve bytes, then RGBA.
    pub fn take_picture(&mut self) -> Option<Vec<u8>> {
        let (number, Picture { width, height, rgba, .. }) = self.screen.take_picture()?;
        let head = [number, width, height].map(u32::to_le_bytes);
        Some([head.as_flattened(), &rgba].concat())
    }

    /// Records a key by its place on the keyboard. Returns whether it moves the camera.
    pub fn key(&mut self, code: &str, down: bool) -> bool {
        let Some(key) = move_key(code) else { return false };
        self.controls.held.set(key, down);
        true
    }

    pub fn drag(&mut self, pressed: bool) {
        self.controls.drag(pressed);
    }

    pub fn pointer(&mut self, x: f64, y: f64) {
        self.controls.pointer_at(x, y);
    }

    pub fn wheel(&mut self, notches: f64) {
        self.controls.wheel(notches);
    }

    pub fn touch_begin(&mut self, id: u32, x: f64, y: f64) {
        self.controls.touches.begin(id.into(), x, y);
    }

    pub fn touch_go(&mut self, id: u32, x: f64, y: f64) {
        self.controls.touches.go(id.into(), x, y);
    }

    pub fn touch_end(&mut self, id: u32) {
        self.controls.touches.end(id.into());
    }

    pub fn sticks(&mut self, walk_x: f64, walk_y: f64, look_x: f64, look_y: f64, climb: f64) {
        self.controls.sticks = Sticks { walk: (walk_x, walk_y), look: (look_x, look_y), climb };
    }

    pub fn let_go(&mut self) {
        self.controls.let_go();
    }

    /// Sets a choice of the page. Errors if there is no such one.
    pub fn choose(&mut self, name: &str, value: &str) -> Result<(), JsError> {
        match name {
            "predictor" => self.settings.predictor = value.parse::<Predictor>()?,
            "mode" => self.settings.mode = value.parse::<Mode>().map_err(failed)?,
            "quality" => self.settings.quality = value.parse()?,
            "split" => self.settings.split = value == "on",
            "view" => self.settings.view = view_named(value).ok_or_else(|| failed(format!("no view {value:?}")))?,
            _ => return Err(failed(format!("no choice {name:?}"))),
        }
        self.play.as_mut().map_or(Ok(()), |play| play.apply(&self.settings)).map_err(failed)
    }

    pub fn toggle_path(&mut self) {
        if let Some(play) = &mut self.play {
            play.toggle_path(Instant::now());
        }
    }

    pub fn next_camera(&mut self) {
        if let Some(play) = &mut self.play {
            play.next_camera(Instant::now());
        }
    }

    /// Where the camera is, for a link.
    pub fn view(&self) -> Option<String> {
        self.play.as_ref().map(|play| play.view(Instant::now()))
    }

    /// Goes where a link says. Returns whether it is a view.
    pub fn go(&mut self, view: &str) -> bool {
        self.play.as_mut().is_some_and(|play| play.go(view))
    }
}
