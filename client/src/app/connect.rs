//! From options to a scene: a local file, or what a server sends, and the session behind it.

use std::sync::Arc;

use gnomon_protocol::{mask::MaskShape, message::Welcome};
use gnomon_scene::{LoadOptions, Scene};
use tokio::runtime::Runtime;

use crate::{
    app::servers::{KnownServers, fingerprint},
    error::ClientError,
    link::scene_cache::SceneCache,
    link::{
        certificate::fetch_certificate,
        receive_options::Reception,
        reconnect::admit_patiently,
        server_link::ServerLink,
        session::{Admitted, Introduction, rate_hz},
        url::{ServerUrl, Transport},
    },
    options::{HeadlessOptions, Source},
};

/// Threads for the network: one can decode while another one sends.
const NETWORK_THREADS: usize = 3;

/// What the server agreed to, and the runtime that its tasks run on.
pub(crate) struct Connected {
    url: ServerUrl,
    runtime: Runtime,
    admitted: Admitted,
}

/// How far getting a scene has come.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Step<'a> {
    /// The server has let the client in.
    Admitted(&'a Welcome),
    /// So many of the scene's bytes have come.
    Fetching { have: u64, length: u64 },
    /// All bytes are there, and are checked.
    Unpacking,
}

/// Gets the scene, and the server's consent to masks of at most `largest_mask` pixels. Blocks.
pub(crate) fn get_scene(
    options: &HeadlessOptions,
    largest_mask: (u32, u32),
    mut progress: impl FnMut(Step<'_>),
) -> Result<(Scene, Option<Connected>), ClientError> {
    match &options.source {
        Source::Offline { scene, lights_from, lights } => {
            let load = LoadOptions { lights_from: lights_from.clone(), max_lights: *lights };
            progress(Step::Unpacking);
            Ok((Scene::load(scene, &load)?, None))
        }
        Source::Server(url) => {
            let runtime = tokio::runtime::Builder::new_multi_thread()
                .worker_threads(NETWORK_THREADS)
                .thread_name("network")
                .enable_all()
                .build()?;
            let (width, height) = largest_mask;
            let introduction = Introduction {
                token: options.token.clone(),
                width,
                height,
                codec: options.codec,
                rate_hz: rate_hz(options.fps),
                wrong_ppm: options.wrong_ppm(),
                resume: None,
                connect_timeout: options.connect_timeout,
            };
            let mut known = KnownServers::load();
            let cache = SceneCache::new(options.cache_dir.clone());
            let (url, admitted, packed) = runtime.block_on(async {
                let pinned = known.certificate_of(url);
                let first_use = url.transport == Transport::Quic && url.certificate.is_none() && url.ca.is_none();
                let url = match pinned {
                    None if first_use => {
                        let digest = fetch_certificate(url, options.connect_timeout).await?;
                        tracing::warn!(server = %url, certificate = fingerprint(&digest), "first visit: pinned");
                        ServerUrl { certificate: Some(digest), ..url.clone() }
                    }
                    Some(digest) if first_use => ServerUrl { certificate: Some(digest), ..url.clone() },
                    _ => url.clone(),
                };
                let admitted = admit_patiently(&url, &introduction).await;
                let mut admitted = admitted.map_err(|error| match error {
                    ClientError::Certificate(url) if first_use => ClientError::CertificateChanged(url),
                    error => error,
                })?;
                if first_use || options.remember {
                    known.remember(&url);
                }
                progress(Step::Admitted(&admitted.welcome));
                let packed = admitted.scene(&cache, |have, length| progress(Step::Fetching { have, length })).await?;
                Ok::<_, ClientError>((url, admitted, packed))
            })?;
            progress(Step::Unpacking);
            let scene = Scene::unpack(&packed)?;
            let (lights, said) = (scene.lights.len(), admitted.welcome.lights);
            if lights != said as usize {
                let reason = format!("it says {said} lights, and its scene has {lights}");
                return Err(ClientError::Protocol { url: Box::new(url), reason });
            }
            Ok((scene, Some(Connected { url, runtime, admitted })))
        }
    }
}

impl Connected {
    /// Where the server is, with the certificate that it has to show.
    pub(crate) fn url(&self) -> &ServerUrl {
        &self.url
    }

    /// What the server said of itself and the scene.
    pub(crate) fn welcome(&self) -> &Welcome {
        &self.admitted.welcome
    }

    /// Lets frames begin, with masks of at most `shape`.
    pub(crate) fn start(self, shape: MaskShape, reception: Reception) -> Result<ServerLink, ClientError> {
        let Self { runtime, admitted, .. } = self;
        let (session, masks) = runtime.block_on(admitted.start(shape, reception))?;
        Ok(ServerLink::new(Arc::new(runtime), session, masks))
    }
}
