//! Environment variables with our prefix, listed without it. Our programs often share an environment, so each ignores
//! the others' variables and refuses unknown ones. Each program's test compares its settings with its list.

/// Settings of gnomon-server.
pub const SERVER: &str = "\
    ADAPTER ADMIN ADVERTISE AGONES ALLOW_SOFTWARE ALTERNATIVE BACKEND CERT_DIR CERT_FILE CONFIG CORES_BUDGET_MS \
    DEVICES DEVICE_BUDGET_MS DRAIN_MS HANDSHAKE_TIMEOUT_MS IDLE_TIMEOUT_MS INITIAL_WINDOW_BYTES KEY_FILE LIGHTS \
    LIGHTS_FROM LISTEN LOG LOG_FILE MAX_SESSIONS MAX_SESSIONS_PER_ADDRESS NETWORK_BUDGET_MBIT OTLP SCENE THREADS \
    TOKEN_FILE TRANSPORT";

/// Settings of gnomon-client.
pub const CLIENT: &str = "\
    ADAPTER ALLOW_SOFTWARE CACHE_DIR CALM_FRAMES CLIENT_CONFIG CODEC CONNECT_TIMEOUT EXPOSURE FADE FPS \
    FRAMES FULL_SCREEN GUARD LOSSY MASK_LOG MODE OUT PACKETS PATH PREDICT PREDICTION_LAG PREDICT_POSE SAVE_MASKS \
    SEQUENTIAL_LAG SIZE START_TIME STATS SUMMARY TOKEN URL VSYNC WAIT";

/// Variables of tests and tools.
pub const TOOLS: &str = "FFMPEG FUZZ_SEEDS RAY_QUERY_CHILD RAY_QUERY_DRIVER SCENES TEST_PANIC";

/// Returns whether another source may have set the variable: one of our programs, or Kubernetes, which describes a
/// service called `gnomon` to every pod as `GNOMON_SERVICE_HOST`, `GNOMON_PORT_4433_UDP` and the like.
pub(crate) fn is_known(name: &str) -> bool {
    let of_kubernetes = name.contains("_SERVICE_") || name.contains("_PORT_") || name.ends_with("_PORT");
    let listed = [SERVER, CLIENT, TOOLS].iter().flat_map(|list| list.split_whitespace());
    of_kubernetes || listed.into_iter().any(|known| name.strip_prefix(crate::declare::PREFIX) == Some(known))
}
