#![no_main]

use std::{path::PathBuf, sync::LazyLock};

static FILE: LazyLock<PathBuf> =
    LazyLock::new(|| std::env::temp_dir().join(format!("gnomon-fuzz-{}.gltf", std::process::id())));

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| gnomon_scene::fuzzing::gltf(bytes, &FILE));
