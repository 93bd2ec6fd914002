//! From options to a scene: a local file, or a server's scene with a session.

use std::sync::Arc;

use gnomon_client_core::camera::of_scene;
use gnomon_protocol::{ids::BearerToken, mask::MaskShape, message::Welcome};
use gnomon_scene::Scene;
use tokio::runtime::Runtime;

use crate::{
    app::{
        first_visit::FirstVisit,
        local_server::{LocalServer, temporary_folder},
        look::Look,
        servers::KnownServers,
    },
    camera_path::{CameraPath, PathError, PathSpec},
    config::Size,
    default_path::default_path,
    error::ClientError,
    link::scene_cache::SceneCache,
    link::{
        pending_session::PendingSession,
        receive_options::Reception,
        reconnect::open_with_retry,
        server_link::ServerLink,
        session_spec::{SessionOptions, rate_hz},
        url::ServerUrl,
    },
    occluders::Occluders,
    options::{HeadlessOptions, Source},
    stop::Stop,
};

/// One thread can decode while another sends.
const NETWORK_THREADS: usize = 3;

/// A session that can start, and the runtime of its tasks. Dropping it leaves the server.
pub(crate) struct Connected {
    url: ServerUrl,
    welcome: Welcome,
    cache: SceneCache,
    runtime: Arc<Runtime>,
    /// `None` once it has started.
    pending: Option<PendingSession>,
}

/// Everything that drawing needs.
pub(crate) struct Loaded {
    pub(crate) scene: Scene,
    pub(crate) connected: Option<Connected>,
    pub(crate) camera_path: CameraPath,
    pub(crate) look: Look,
    /// The server of a file that was opened. It must outlive the session.
    pub(crate) local: Option<LocalServer>,
}

/// Gets the scene, then a suitable camera path where `options` give none. Blocks.
///
/// # Errors
/// As [`get_scene`], and if the environment cannot be read.
pub(crate) fn load(
    options: &HeadlessOptions,
    largest_mask: (u32, u32),
    camera_path: Option<CameraPath>,
    stop: &Stop,
    mut progress: impl FnMut(Step<'_>),
    trusts: impl FnMut(&ServerUrl, &[u8; 32]) -> bool,
) -> Result<Loaded, ClientError> {
    let environment = options.settings.environment.open()?;
    let local = match &options.source {
        Source::File(scene) => Some(LocalServer::start(temporary_folder("file")?, scene)?),
        Source::Server(_) | Source::Offline { .. } => None,
    };
    stop.check()?;
    let served = local.as_ref().map(|server| {
        // Its URL is gone with it.
        let source = Source::Server(server.url().clone());
        HeadlessOptions { source, remember: false, ..options.clone() }
    });
    let (scene, connected) = get_scene(served.as_ref().unwrap_or(options), largest_mask, stop, &mut progress, trusts)?;
    let start_s = options.settings.start_time;
    let shown = scene.bare_at(start_s);
    let occluders = Occluders::largest_of(&shown);
    let camera_path = match (camera_path, options.settings.path.as_ref().and_then(PathSpec::scene_camera)) {
        (Some(path), _) => path,
        (None, Some(wanted)) => of_scene::path_of(&scene, wanted).map_err(PathError::Scene)?,
        (None, None) => of_scene::path_of(&scene, None).unwrap_or_else(|_| default_path(&shown, &occluders)),
    };
    let Size { width, height } = options.settings.size;
    let first = camera_path.camera(start_s, width, height);
    let look = Look::new(environment, &shown, &occluders, (first, start_s));
    drop(shown);
    stop.check()?;
    Ok(Loaded { scene, connected, camera_path, look, local })
}

#[derive(Debug, Clone, Copy)]
pub(crate) enum Step<'a> {
    #[cfg_attr(not(feature = "window"), expect(dead_code, reason = "only a window shows it"))]
    Admitted(&'a Welcome),
    /// In bytes.
    Fetching {
        have: u64,
        length: u64,
    },
    Unpacking,
}

/// Gets the scene, and a session with masks of at most `largest_mask` pixels. Blocks, also in `trusts`, which is asked
/// before a token goes to a server that is visited for the first time.
///
/// # Errors
/// Errors if the file or the server's scene cannot be loaded, the server refuses or is not trusted, or the run is to
/// end.
pub(crate) fn get_scene(
    options: &HeadlessOptions,
    largest_mask: (u32, u32),
    stop: &Stop,
    mut progress: impl FnMut(Step<'_>),
    mut trusts: impl FnMut(&ServerUrl, &[u8; 32]) -> bool,
) -> Result<(Scene, Option<Connected>), ClientError> {
    match &options.source {
        Source::Offline(local) | Source::File(local) => {
            progress(Step::Unpacking);
            Ok((Scene::load(&local.file, &local.options)?, None))
        }
        Source::Server(url) => {
            let runtime = tokio::runtime::Builder::new_multi_thread()
                .worker_threads(NETWORK_THREADS)
                .thread_name("network")
                .enable_all()
                .build()?;
            let (width, height) = largest_mask;
            let session = SessionOptions {
                token: options.settings.token.clone().map(BearerToken::from),
                width,
                height,
                codec: options.settings.codec,
                rate_hz: rate_hz(options.settings.fps),
                wrong_ppm: options.settings.wrong_ppm(),
                resume: None,
                connect_timeout: options.settings.connect_timeout(),
                stop: stop.clone(),
            };
            let mut known = KnownServers::load();
            let cache = SceneCache::new(options.settings.cache_dir.clone(), options.settings.cache_limit());
            let (url, pending, packed) = runtime.block_on(async {
                let first_use = url.is_first_use();
                let url = if first_use {
                    let visit = FirstVisit {
                        connect_timeout: session.connect_timeout,
                        sends_token: session.token.is_some(),
                        trusts: &mut |url, digest| options.settings.trust_first_use || trusts(url, digest),
                    };
                    stop.unless(visit.identify(url, &mut known)).await??
                } else {
                    url.clone()
                };
                let opened = open_with_retry(&url, &session).await;
                let mut pending = opened.map_err(|error| match error {
                    ClientError::Certificate(url) if first_use => ClientError::CertificateChanged(url),
                    error => error,
                })?;
                // A first visit is offered again by a window that has no URL.
                if first_use || options.remember {
                    known.remember(&url);
                }
                progress(Step::Admitted(&pending.welcome));
                let packed =
                    pending.fetch_scene(&cache, |have, length| progress(Step::Fetching { have, length })).await?;
                Ok::<_, ClientError>((url, pending, packed))
            })?;
            progress(Step::Unpacking);
            match pending.unpack(&packed) {
                Ok(scene) => {
                    let (welcome, runtime) = (pending.welcome.clone(), Arc::new(runtime));
                    Ok((scene, Some(Connected { url, welcome, cache, runtime, pending: Some(pending) })))
                }
                Err(error) => {
                    runtime.block_on(pending.leave());
                    Err(error)
                }
            }
        }
    }
}

impl Connected {
    /// Returns the server's URL, with its pinned certificate.
    #[cfg_attr(not(feature = "window"), expect(dead_code, reason = "only a window shows it"))]
    pub(crate) fn url(&self) -> &ServerUrl {
        &self.url
    }

    pub(crate) fn welcome(&self) -> &Welcome {
        &self.welcome
    }

    /// Starts the session, with masks of at most `shape`.
    ///
    /// # Errors
    /// Errors if the connection breaks.
    pub(crate) fn start(mut self, shape: MaskShape, reception: Reception) -> Result<ServerLink, ClientError> {
        let starts_once = || ClientError::Protocol { url: Box::new(self.url.clone()), reason: "no session".to_owned() };
        let pending = self.pending.take().ok_or_else(starts_once)?;
        let (session, masks) = self.runtime.block_on(pending.start(shape, reception))?;
        Ok(ServerLink::new(Arc::clone(&self.runtime), self.cache.clone(), session, masks))
    }
}

impl Drop for Connected {
    fn drop(&mut self) {
        if let Some(pending) = self.pending.take() {
            self.runtime.block_on(pending.leave());
        }
    }
}
