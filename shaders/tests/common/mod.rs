//! Where the test scenes are.

#![expect(clippy::panic, reason = "helpers of tests may fail as tests do")]

use std::path::PathBuf;

/// The folder that `GNOMON_SCENES` names.
pub(crate) fn scenes() -> PathBuf {
    match std::env::var_os("GNOMON_SCENES") {
        Some(folder) => folder.into(),
        None => panic!("set GNOMON_SCENES to the folder with the unpacked test scenes"),
    }
}
