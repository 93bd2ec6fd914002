//! Starts the server.

use std::{
    num::NonZeroUsize,
    sync::{Arc, OnceLock, atomic::AtomicBool},
    time::Instant,
};

use tokio::sync::{mpsc, watch};

use super::{
    accept::accept,
    error::StartError,
    running::RunningServer,
    scene::{load, load_options, load_with_report},
    url,
    warm_up::warm_up,
};
use crate::{
    admission::{
        addresses::AddressLimit, capacity::HostCapacity, encoders::Encoders, failed_tokens::FailedTokens,
        permit::SessionPermits, services::Services, tokens::store::TokenStore,
    },
    config::{AdminAddress, ServerConfig, Transport},
    limits,
    metrics::{registry::Metrics, reloads::Reloads},
    net::{certificate::Certificates, endpoint},
    operate::{
        admin::Admin,
        otlp::report,
        readiness::{Readiness, Stage},
        status::Status,
    },
    phase::Phase,
    task::Task,
    visibility::engine::{EngineOptions, Fleet},
    web,
    world::World,
};

#[derive(Debug)]
pub struct Server;

impl Server {
    /// Binds the address, loads and packs the scene, starts the tracing engine, and listens.
    ///
    /// # Errors
    /// Names the first thing that is missing, wrong or taken.
    pub async fn start(config: ServerConfig) -> Result<RunningServer, StartError> {
        config.validate()?;
        // Quick checks first: loading takes seconds.
        let scene_path = config.scene.clone().ok_or(StartError::NoScene)?;
        let scene_name = scene_path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let tokens = config.token_file.as_deref().map(TokenStore::read).transpose()?.map(Arc::new);
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let certificates = match config.transport {
            Transport::Quic => Some(Arc::new(Certificates::open(&config, Arc::clone(&provider))?)),
            Transport::LabUdp | Transport::LabTcp => None,
        };
        let bound = endpoint::bind(&config)?;
        let local_addr = bound.local_addr().map_err(|reason| StartError::Broken(reason.to_string()))?;
        let (metrics, readiness) = (Arc::new(Metrics::default()), Readiness::default());
        let status = Arc::new(Status {
            metrics: Arc::clone(&metrics),
            readiness: readiness.clone(),
            backend: OnceLock::new(),
            services: OnceLock::new(),
            capacity: config.max_sessions,
            socket: (config.transport == Transport::Quic).then_some(local_addr),
            tokens: tokens.clone(),
            had_admin_token: AtomicBool::new(false),
            open: config.is_open(),
            hosts: config.admin_hosts.clone().unwrap_or_default(),
            reloads: Reloads::default(),
        });
        status.loaded(certificates.is_some());
        let admin = match config.admin.and_then(AdminAddress::address) {
            Some(address) => Some(Admin::start(address, &status).await?),
            None => None,
        };
        let web = match config.web.and_then(AdminAddress::address) {
            Some(address) => Some(web::Bound::listen(address).await?),
            None => None,
        };
        let files = match &config.web_root {
            Some(folder) => Some(web::Files::read(folder).map_err(web::WebError::from)?),
            None => web::Files::built_in(),
        };
        let otlp = config.otlp.clone().map(|collector| Task::spawn(report::run(collector, Arc::clone(&status))));

        let options = load_options(&config);
        let (scene, asset) = blocking(move || load(&scene_path, &options)).await??;
        let engine_options = engine_options(&config);
        let engine = blocking(move || Fleet::start(&scene, &engine_options))
            .await?
            .map_err(|error| StartError::Engine(Box::new(error)))?;
        for device in engine.engines() {
            warm_up(device, asset.lights).await.map_err(StartError::Broken)?;
        }
        let _ = status.backend.set(engine.description().to_owned());

        let url_base = url::base(&config, local_addr);
        let browsers = certificates.as_ref().filter(|_| config.browsers);
        let browser_hashes = browsers.and_then(|certificates| certificates.browser_hashes());
        let renewing = certificates.clone().map(|certificates| Task::spawn(certificates.keep_fresh()));
        let endpoint = Arc::new(bound.open(&config, certificates.clone(), &provider, &metrics.socket)?);
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
            browser_certificate_sha256 = browser_hashes.as_ref().map(|hashes| &*hashes.current),
            next_browser_certificate_sha256 = browser_hashes.as_ref().map(|hashes| &*hashes.next),
            "listening"
        );
        if status.open {
            tracing::warn!(
                listen = %config.listen,
                "everybody who reaches this address is admitted: pass --token-file, or listen on 127.0.0.1"
            );
        }
        let capacity = HostCapacity::new(&config, cores, asset.packed.len() as u64, engine.devices());
        let services = Arc::new(Services {
            shared_world: config.shared_world.then(|| Arc::new(World::new(Instant::now()))),
            scene: asset,
            engine,
            tokens,
            failed_tokens: FailedTokens::default(),
            addresses: AddressLimit::new(config.max_sessions_per_address, false),
            metrics,
            permits: SessionPermits::new(config.max_sessions),
            capacity,
            phase: phase_seen,
            encoders: Encoders::new(cores),
            handshake_timeout: config.handshake_timeout(),
            origins: config.origins.clone(),
            drain_ms: config.drain_ms,
            alternative: config.alternative.clone(),
        });
        let _ = status.services.set(Arc::downgrade(&services));
        let (arrivals, sockets) = mpsc::channel(limits::MAX_WAITING_SOCKETS);
        let accepting = Task::spawn(accept(Arc::clone(&endpoint), sockets, Arc::clone(&services)));
        let web =
            match (web, &certificates) {
                (Some(web), Some(certificates)) => {
                    let port = url::port(&url_base, local_addr);
                    let (certificates, origins) = (Arc::clone(certificates), config.origins);
                    Some(web.serve(
                        web::Page { port, scene: scene_name, certificates, origins, files, arrivals },
                        &provider,
                    )?)
                }
                _ => None,
            };
        readiness.set(Stage::Ready);
        #[cfg(feature = "agones")]
        let agones = config.agones.then(|| {
            let (metrics, services) = (Arc::clone(&services.metrics), Arc::clone(&services));
            Task::spawn(crate::operate::agones::run(readiness.clone(), metrics, move || services.engine.answers()))
        });
        Ok(RunningServer {
            local_addr,
            url_base,
            certificates,
            renewing,
            web,
            services,
            phase,
            endpoint,
            accepting,
            readiness,
            status,
            admin,
            otlp,
            #[cfg(feature = "agones")]
            agones,
        })
    }

    /// Loads and packs the configured scene, and returns a description of several lines.
    ///
    /// # Errors
    /// As [`Self::start`], for configuration, tokens and scene.
    pub fn check(config: &ServerConfig) -> Result<String, StartError> {
        config.validate()?;
        let path = config.scene.as_deref().ok_or(StartError::NoScene)?;
        let tokens = config.token_file.as_deref().map(TokenStore::read).transpose()?;
        let (scene, asset, report) = load_with_report(path, &load_options(config))?;
        let report: String = report.all().iter().map(|warning| format!("\n{warning}")).collect();
        let tokens = if tokens.is_some() { "required" } else { "none: everybody is admitted" };
        Ok(format!(
            "scene       {}\n{}\npacked      {} bytes, digest {}\ntokens      {tokens}{report}",
            path.display(),
            scene.summary(),
            asset.packed.len(),
            asset.digest
        ))
    }
}

fn engine_options(config: &ServerConfig) -> EngineOptions {
    EngineOptions {
        backend: config.backend,
        adapter: config.adapter.clone(),
        allow_software: config.allow_software,
        threads: config.threads,
        // The engine releases a session shortly after its permit, so it needs spare room.
        max_sessions: config.max_sessions + limits::SPARE_ENGINE_SESSIONS,
        budget_ms: f64::from(config.device_budget_ms),
        devices: config.devices,
    }
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, StartError> {
    tokio::task::spawn_blocking(work).await.map_err(|error| StartError::Broken(error.to_string()))
}

#[cfg(test)]
mod tests {
    use std::{net::Ipv4Addr, time::Duration};

    use tokio::time::timeout;

    use super::*;
    use crate::config::Backend;

    #[tokio::test(flavor = "multi_thread")]
    async fn a_failed_engine_is_reported_to_the_caller() {
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
}
