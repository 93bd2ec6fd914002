//! The page that `make web` built, within the program.

macro_rules! built {
    ($name:expr) => {
        ($name, include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/../target/web/page/", $name)))
    };
}

macro_rules! files {
    ($($name:literal)*) => {
        &[$(built!($name), built!(concat!($name, ".gz")),)*]
    };
}

pub(super) const FILES: &[(&str, &[u8])] =
    files!["index.html" "page.css" "page.js" "worker.js" "link.js" "pipelines.js" "gnomon_web.js" "gnomon_web_bg.wasm"];
