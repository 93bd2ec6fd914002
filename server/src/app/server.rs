//! The daemon: everything is made once at the start, peers become sessions, and the end is orderly.

use std::{
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
    num::NonZeroUsize,
    path::Path,
    sync::{Arc, OnceLock},
    time::Duration,
};

use bytes::Bytes;
use gnomon_protocol::ids::SceneDigest;
use gnomon_scene::{LoadOptions, LoadReport, Scene};
use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore, watch},
    task::{JoinHandle, JoinSet},
    time::timeout,
};
use tracing::Instrument as _;

use super::error::StartError;
use crate::{
    admission::{
        addresses::{Addresses, Held},
        capacity::Plan,
        handshake::{self, HandshakeError},
        permit::Admission,
        time_limit,
        tokens::store::TokenStore,
    },
    config::{ServerConfig, Transport},
    limits,
    metrics::registry::{Metrics, RefusalCause},
    net::{
        certificate::Certificates,
        endpoint::{self, Arrival, Endpoint},
    },
    operate::{
        admin::{answer::Sources, listener::Admin},
        readiness::{self, Readiness, Stage},
    },
    session::{
        brightness,
        run::{self, Phase, SceneAsset, Services},
    },
    visibility::engine::{EngineOptions, Fleet},
};

/// Starts servers.
#[derive(Debug)]
pub struct Server;

/// A server that listens. Dropping it ends it at once; [`Self::shutdown`] lets sessions finish.
pub struct RunningServer {
    local_addr: SocketAddr,
    url: String,
    certificates: Option<Arc<Certificates>>,
    services: Arc<Services>,
    phase: watch::Sender<Phase>,
    endpoint: Arc<Endpoint>,
    accepting: Task,
    readiness: Readiness,
    admin: Admin,
    #[cfg(feature = "agones")]
    agones: Option<Task>,
}

/// A task that ends with its owner.
struct Task(JoinHandle<()>);

impl Drop for Task {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Server {
    /// Binds the address, loads and packs the scene, starts the tracing engine, and listens.
    ///
    /// # Errors
    /// Names the first thing that is missing, wrong or taken.
    pub async fn start(config: ServerConfig) -> Result<RunningServer, StartError> {
        config.validate()?;
        // What is quick to check comes before what takes seconds.
        let scene_path = config.scene.clone().ok_or(StartError::NoScene)?;
        let tokens = config.token_file.as_deref().map(TokenStore::read).transpose()?.map(Arc::new);
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let certificates = match config.transport {
            Transport::Quic => Some(Arc::new(Certificates::open(&config, Arc::clone(&provider))?)),
            Transport::LabUdp | Transport::LabTcp => None,
        };
        let bound = endpoint::bind(&config)?;
        let local_addr = bound.local_addr().map_err(|reason| StartError::Broken(reason.to_string()))?;
        let (metrics, readiness) = (Arc::new(Metrics::default()), Readiness::default());
        let sources = Arc::new(Sources {
            metrics: Arc::clone(&metrics),
            readiness: readiness.clone(),
            backend: OnceLock::new(),
            capacity: config.max_sessions,
            socket: (config.transport == Transport::Quic).then_some(local_addr),
            tokens: tokens.clone(),
        });
        let admin = Admin::start(&config, &sources).await?;

        let options = load_options(&config);
        let (scene, asset) = blocking(move || load(&scene_path, &options)).await??;
        let engine_options = engine_options(&config);
        let engine = blocking(move || Fleet::start(&scene, &engine_options))
            .await?
            .map_err(|error| StartError::Engine(Box::new(error)))?;
        for device in engine.engines() {
            readiness::warm_up(device, asset.lights).await.map_err(StartError::Broken)?;
        }
        // Nobody else writes it.
        let _ = sources.backend.set(engine.description().to_owned());

        let url = url(&config, local_addr, certificates.as_deref());
        let endpoint = Arc::new(bound.open(&config, certificates.clone(), &provider, &metrics)?);
        let (phase, phase_seen) = watch::channel(Phase::Running);
        let cores = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        tracing::info!(
            %local_addr,
            transport = %config.transport,
            backend = engine.description(),
            scene_digest = %asset.digest,
            scene_bytes = asset.packed.len(),
            lights = asset.lights,
            max_sessions = config.max_sessions,
            tokens = tokens.is_some(),
            browser_certificate_sha256 = certificates.as_ref().map(|certificates| certificates.browser_sha256()),
            "listening"
        );
        let services = Arc::new(Services {
            scene: asset,
            engine,
            tokens,
            addresses: Addresses::new(config.max_sessions_per_address, false),
            metrics,
            admission: Admission::new(config.max_sessions),
            plan: Plan::new(&config, cores),
            phase: phase_seen,
            encoders: Arc::new(Semaphore::new(cores)),
            handshake_timeout: config.handshake_timeout(),
            drain_ms: config.drain_ms,
            alternative: config.alternative.clone(),
        });
        let accepting = Task(tokio::spawn(accept(Arc::clone(&endpoint), Arc::clone(&services))));
        readiness.set(Stage::Ready);
        #[cfg(feature = "agones")]
        let agones = config
            .agones
            .then(|| Task(tokio::spawn(crate::operate::agones::run(readiness.clone(), Arc::clone(&services.metrics)))));
        Ok(RunningServer {
            local_addr,
            url,
            certificates,
            services,
            phase,
            endpoint,
            accepting,
            readiness,
            admin,
            #[cfg(feature = "agones")]
            agones,
        })
    }

    /// Loads and packs the configured scene, and says what it found, a line each.
    ///
    /// # Errors
    /// As [`Self::start`] where the configuration, tokens or scene are wrong.
    pub fn check(config: &ServerConfig) -> Result<String, StartError> {
        config.validate()?;
        let path = config.scene.as_deref().ok_or(StartError::NoScene)?;
        let tokens = config.token_file.as_deref().map(TokenStore::read).transpose()?;
        let (scene, asset) = load(path, &load_options(config))?;
        let tokens = if tokens.is_some() { "required" } else { "none: everybody is admitted" };
        Ok(format!(
            "scene       {}\n{}\npacked      {} bytes, digest {}\ntokens      {tokens}",
            path.display(),
            scene.summary(),
            asset.packed.len(),
            asset.digest
        ))
    }
}

impl RunningServer {
    /// The address that it listens on, with the port that was free.
    #[must_use]
    pub const fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }

    /// What a client needs to connect: `gnomon://HOST:PORT/?cert=SHA256`, with the lab schemes `gnomon+lab-udp://HOST:PORT/`.
    #[must_use]
    pub fn url(&self) -> String {
        self.url.clone()
    }

    /// SHA-256 of the certificate that browsers see, in hexadecimal; `None` on the lab transports. It changes every few
    /// days, because browsers pin no certificate that lives for longer than 14.
    #[must_use]
    pub fn browser_certificate_sha256(&self) -> Option<String> {
        self.certificates.as_ref().map(|certificates| certificates.browser_sha256())
    }

    /// What traces.
    #[must_use]
    pub fn backend(&self) -> String {
        self.services.engine.description().to_owned()
    }

    /// Sessions that are being served.
    #[must_use]
    pub fn sessions(&self) -> usize {
        self.services.admission.taken()
    }

    /// Lights of the scene.
    #[must_use]
    pub fn lights(&self) -> u32 {
        self.services.scene.lights
    }

    /// The engines, one a device.
    #[must_use]
    pub fn engines(&self) -> &[crate::visibility::engine::Engine] {
        self.services.engine.engines()
    }

    /// Where its admin address is, if it has one.
    #[must_use]
    pub fn admin_addr(&self) -> Option<SocketAddr> {
        self.admin.local_addr()
    }

    /// Reads the token file and the certificate again. Sessions that are open stay; a file that cannot be used changes nothing, which
    /// the log says.
    pub fn reload(&self) {
        if let Some(tokens) = &self.services.tokens {
            match tokens.reload() {
                Ok(listed) => tracing::info!(listed, "tokens read again"),
                Err(error) => tracing::error!(%error, "the tokens stay as they were"),
            }
        }
        if let Some(certificates) = &self.certificates {
            match certificates.reload() {
                Ok(sha256) => tracing::info!(sha256, "certificate read again"),
                Err(error) => tracing::error!(%error, "the certificate stays as it was"),
            }
        }
    }

    /// Waits until the server can trace no more, and says why: its device is lost, for example. It still listens then, but
    /// refuses everybody, so whoever started it should end it.
    pub async fn failed(&self) -> String {
        let reason = self.services.engine.ended().await;
        self.readiness.set(Stage::Failed(reason.clone()));
        reason
    }

    /// Stops admitting, tells the clients, gives them `drain_ms` to leave while they are still served, finishes the
    /// frames on their way, and ends.
    pub async fn shutdown(self) {
        let Self {
            services,
            phase,
            endpoint,
            mut accepting,
            readiness,
            admin,
            #[cfg(feature = "agones")]
            agones,
            ..
        } = self;
        readiness.set(Stage::Draining);
        services.admission.close();
        tracing::info!(sessions = services.admission.taken(), drain_ms = services.drain_ms, "draining");
        phase.send_replace(Phase::Draining);
        let empty = async {
            while services.admission.taken() > 0 {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        let _ = timeout(Duration::from_millis(services.drain_ms.into()), empty).await;
        phase.send_replace(Phase::Stopping);
        let patience = limits::FINISH_TIMEOUT + 3 * limits::LINGER;
        if timeout(patience, &mut accepting.0).await.is_err() {
            tracing::warn!("sessions did not end in {patience:?}");
            accepting.0.abort();
            let _ = (&mut accepting.0).await;
        }
        endpoint.close().await;
        drop(endpoint);
        // It waits for a thread, so it may not run on a worker.
        if let Err(error) = tokio::task::spawn_blocking(move || services.engine.shutdown()).await {
            tracing::error!(%error, "the engine broke off");
        }
        #[cfg(feature = "agones")]
        if agones.is_some() {
            crate::operate::agones::shutdown().await;
        }
        drop(admin);
        tracing::info!("stopped");
    }
}

/// Turns peers into sessions, until the server stops; then waits for the sessions, and sends away at once whoever comes.
async fn accept(endpoint: Arc<Endpoint>, services: Arc<Services>) {
    let handshakes = Arc::new(Semaphore::new(limits::MAX_HANDSHAKES));
    let addresses = Addresses::new(limits::MAX_HANDSHAKES_PER_ADDRESS, true);
    let mut phase = services.phase.clone();
    let mut sessions = JoinSet::new();
    loop {
        tokio::select! {
            arrival = endpoint.accept() => {
                let Some(arrival) = arrival else { break };
                let permit = Arc::clone(&handshakes).try_acquire_owned().ok();
                match permit.zip(addresses.take(arrival.peer().ip())) {
                    Some(handshake) => {
                        let span = tracing::info_span!("peer", address = %arrival.peer());
                        sessions.spawn(serve(arrival, handshake, Arc::clone(&services)).instrument(span));
                    }
                    None => {
                        services.metrics.refused(RefusalCause::Handshakes);
                        arrival.refuse();
                    }
                }
            }
            Some(ended) = sessions.join_next() => log_panic(ended),
            () = run::stopping(&mut phase) => break,
        }
    }
    while !sessions.is_empty() {
        tokio::select! {
            Some(ended) = sessions.join_next() => log_panic(ended),
            Some(arrival) = endpoint.accept() => arrival.refuse(),
        }
    }
}

fn log_panic(ended: Result<(), tokio::task::JoinError>) {
    if let Err(error) = ended {
        tracing::error!(%error, "a session broke off");
    }
}

/// One peer, from its first packet to its end.
async fn serve(arrival: Arrival, handshake: (OwnedSemaphorePermit, Held), services: Arc<Services>) {
    let greeting = async {
        let mut link = arrival.into_link().await.map_err(|error| HandshakeError::Arrival(error.to_string()))?;
        let admitted = handshake::greet(&mut link, &services).await?;
        Ok::<_, HandshakeError>((link, admitted))
    };
    let mut phase = services.phase.clone();
    let greeted = tokio::select! {
        greeted = time_limit::within(services.handshake_timeout, &handshake.0, greeting) => greeted,
        // Whoever has not said Hello by now does not hold up the end.
        () = run::stopping(&mut phase) => return tracing::info!(reason = "the server stops", "not admitted"),
    };
    let (link, admitted) = match greeted {
        Some(Ok(greeted)) => greeted,
        Some(Err(error)) => {
            // A refusal has been counted, with its cause, where it was made.
            if !matches!(error, HandshakeError::Refused(_)) {
                services.metrics.refused(RefusalCause::Broken);
            }
            return tracing::info!(reason = %error, "not admitted");
        }
        None => {
            services.metrics.refused(RefusalCause::Silent);
            return tracing::info!(reason = "no Hello in time", "not admitted");
        }
    };
    drop(handshake);
    let span = tracing::info_span!("session", id = admitted.slot.id.0, carrier = link.carrier);
    run::run(link, admitted, services).instrument(span).await;
}

fn load_options(config: &ServerConfig) -> LoadOptions {
    LoadOptions { lights_from: config.lights_from.clone(), max_lights: config.lights }
}

fn engine_options(config: &ServerConfig) -> EngineOptions {
    EngineOptions {
        backend: config.backend,
        adapter: config.adapter.clone(),
        allow_software: config.allow_software,
        threads: config.threads,
        // A session's seat in the engine comes free a moment after its slot: the slots are what counts.
        max_sessions: config.max_sessions + limits::SPARE_SEATS,
        budget_ms: f64::from(config.device_budget_ms),
        devices: config.devices,
    }
}

/// The scene, and the bytes that every client gets: packed once, named by their digest.
fn load(path: &Path, options: &LoadOptions) -> Result<(Arc<Scene>, SceneAsset), StartError> {
    let (scene, report) = Scene::load_with_report(path, options)
        .map_err(|reason| StartError::Scene { path: path.to_owned(), reason: Box::new(reason) })?;
    if report != LoadReport::default() {
        tracing::warn!(scene = %path.display(), "the scene is not all there: {report}");
    }
    let pack_error = |reason: String| StartError::Pack { path: path.to_owned(), reason };
    let packed = scene.pack().map_err(|error| pack_error(error.to_string()))?;
    if packed.len() as u64 > gnomon_protocol::limits::MAX_SCENE_BYTES {
        let limit = gnomon_protocol::limits::MAX_SCENE_BYTES;
        return Err(pack_error(format!("{} bytes; clients accept at most {limit}", packed.len())));
    }
    let lights = u32::try_from(scene.lights.len()).map_err(|error| pack_error(error.to_string()))?;
    let digest = SceneDigest(*blake3::hash(&packed).as_bytes());
    let weights = brightness::weights(&scene);
    Ok((Arc::new(scene), SceneAsset { packed: Bytes::from(packed), digest, lights, weights }))
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, StartError> {
    tokio::task::spawn_blocking(work).await.map_err(|error| StartError::Broken(error.to_string()))
}

fn url(config: &ServerConfig, local_addr: SocketAddr, certificates: Option<&Certificates>) -> String {
    let authority = match &config.advertise {
        Some(host) => authority(host, local_addr.port()),
        None => reachable(local_addr).to_string(),
    };
    let query = certificates.map(|kept| format!("?cert={}", kept.kept_sha256())).unwrap_or_default();
    format!("{}://{authority}/{query}", config.transport.scheme())
}

/// `HOST[:PORT]` with a port, and brackets around a bare IPv6 address.
fn authority(host: &str, port: u16) -> String {
    match host.rsplit_once(':') {
        _ if host.parse::<Ipv6Addr>().is_ok() => format!("[{host}]:{port}"),
        Some((before, after)) if !before.is_empty() && after.parse::<u16>().is_ok() => host.to_owned(),
        _ => format!("{host}:{port}"),
    }
}

/// An address to print for one that means "any": the one that this machine would reach others by, so that the URL
/// works from here and from there. Connecting a UDP socket sends nothing.
fn reachable(address: SocketAddr) -> SocketAddr {
    if !address.ip().is_unspecified() {
        return address;
    }
    let (from, to): (SocketAddr, SocketAddr) = (
        (Ipv4Addr::UNSPECIFIED, 0).into(),
        // TEST-NET-1 (RFC 5737): it is routed like any far address, and nobody has it.
        (Ipv4Addr::new(192, 0, 2, 1), 9).into(),
    );
    let outward = UdpSocket::bind(from).and_then(|socket| socket.connect(to).and_then(|()| socket.local_addr()));
    let ip = outward.map_or(Ipv4Addr::LOCALHOST.into(), |outward| outward.ip());
    SocketAddr::new(ip, address.port())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Backend;

    #[tokio::test(flavor = "multi_thread")]
    async fn whoever_runs_a_server_hears_that_it_can_trace_no_more() {
        let folder = tempfile::tempdir().unwrap();
        let config = ServerConfig {
            scene: Some(gnomon_scene::testing::write_scene(folder.path()).unwrap()),
            listen: (Ipv4Addr::LOCALHOST, 0).into(),
            backend: Backend::Cpu,
            cert_dir: Some(folder.path().join("cert")),
            drain_ms: 0,
            ..ServerConfig::default()
        };
        let server = Server::start(config).await.unwrap();
        let services = Arc::clone(&server.services);
        let ending = tokio::task::spawn_blocking(move || services.engine.shutdown());
        assert_eq!(timeout(Duration::from_secs(60), server.failed()).await.unwrap(), "it was shut down");
        ending.await.unwrap();
        server.shutdown().await;
    }

    #[test]
    fn urls_can_be_used_as_they_are() {
        for (host, expected) in [
            ("edge.example", "edge.example:7"),
            ("edge.example:99", "edge.example:99"),
            ("192.0.2.7", "192.0.2.7:7"),
            ("2001:db8::1", "[2001:db8::1]:7"),
            ("[2001:db8::1]", "[2001:db8::1]:7"),
            ("[2001:db8::1]:99", "[2001:db8::1]:99"),
        ] {
            assert_eq!(authority(host, 7), expected);
        }
        let config = ServerConfig { transport: Transport::LabUdp, ..ServerConfig::default() };
        assert_eq!(url(&config, "127.0.0.1:7".parse().unwrap(), None), "gnomon+lab-udp://127.0.0.1:7/");
        assert_eq!(url(&config, "[::1]:7".parse().unwrap(), None), "gnomon+lab-udp://[::1]:7/");
    }

    #[test]
    fn any_address_is_printed_as_one_that_can_be_reached() {
        for any in ["0.0.0.0:7", "[::]:7"] {
            let printed = reachable(any.parse().unwrap());
            assert!(!printed.ip().is_unspecified() && printed.port() == 7, "{printed}");
        }
    }
}
