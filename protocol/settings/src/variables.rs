//! Environment variables with our prefix, listed without it. Our programs often share an environment, so each ignores
//! the others' variables and refuses unknown ones. Each program's test compares its settings with its list.

/// Settings of gnomon-server.
pub const SERVER: &str = "\
    ADAPTER ADMIN ADMIN_HOSTS ADVERTISE AGONES ALLOW_SOFTWARE ALTERNATIVE ANIMATION BACKEND BROWSERS CERT_DIR \
    CERT_FILE CONFIG CORES_BUDGET_MS DEFAULT_LIGHT DEVICES DEVICE_BUDGET_MS DRAIN_MS EDITABLE HANDSHAKE_TIMEOUT_MS \
    IDLE_TIMEOUT_MS INITIAL_WINDOW_BYTES KEY_FILE LIGHTS LIGHTS_FROM LISTEN LOG LOG_FILE MAX_SESSIONS \
    MAX_SESSIONS_PER_ADDRESS MEMORY_BUDGET_MB NETWORK_BUDGET_MBIT NEXT_CERT_FILE ORIGINS OTLP SCENE SCENE_NAME \
    SHARED_WORLD THREADS TOKEN_FILE TRANSPORT VARIANT WEB WEB_ROOT";

/// Settings of gnomon-client.
pub const CLIENT: &str = "\
    ADAPTER ALLOW_SOFTWARE CACHE_DIR CACHE_LIMIT CALM_FRAMES CLIENT_CONFIG CLIENT_TOKEN_FILE CODEC CONNECT_TIMEOUT \
    EDITS ENVIRONMENT EXPOSURE FADE FPS FRAMES FULL_SCREEN GUARD LOSSY MASK_LOG MODE OUT PACKETS PATH PREDICT \
    PREDICTION_LAG PREDICT_POSE QUALITY SAVE_MASKS SEQUENTIAL_LAG SIZE START_TIME STATS SUMMARY TOKEN TONE \
    TRUST_FIRST_USE URL VSYNC WAIT";

/// Variables of tests and tools.
pub const TOOLS: &str = "FFMPEG FUZZ_SEEDS RAY_QUERY_CHILD RAY_QUERY_DRIVER SCENES TEST_PANIC";

/// Returns whether another source may have set the variable: one of our programs, or Kubernetes.
pub(crate) fn is_known(name: &str, value: &str) -> bool {
    let listed = [SERVER, CLIENT, TOOLS].iter().flat_map(|list| list.split_whitespace());
    of_kubernetes(name, value)
        || listed.into_iter().any(|known| name.strip_prefix(crate::declare::PREFIX) == Some(known))
}

/// Kubernetes describes a service called `gnomon` or `gnomon-x` to every pod, as `GNOMON_SERVICE_HOST`,
/// `GNOMON_SERVICE_PORT_NAME`, `GNOMON_PORT=udp://…`, `GNOMON_PORT_4433_UDP_ADDR` and the like.
fn of_kubernetes(name: &str, value: &str) -> bool {
    let of_port = |rest: &str| {
        let rest = rest.trim_start_matches(|c: char| c.is_ascii_digit());
        ["_TCP", "_UDP", "_SCTP"].iter().any(|protocol| {
            let part = rest.strip_prefix(protocol);
            part.is_some_and(|part| ["", "_PROTO", "_PORT", "_ADDR"].contains(&part))
        })
    };
    name.ends_with("_SERVICE_HOST")
        || name.ends_with("_SERVICE_PORT")
        || name.contains("_SERVICE_PORT_")
        || name.ends_with("_PORT") && value.contains("://")
        || name.match_indices("_PORT_").any(|(at, port)| of_port(&name[at + port.len()..]))
}
