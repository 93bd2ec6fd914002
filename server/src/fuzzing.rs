//! Properties of the parsers of operators' files. Each function panics if its property fails. Only the fuzz targets
//! (`tests/fuzz`) and the test below call them.

use std::path::Path;

use crate::{admission::tokens::file, config::ServerConfig, operate::otlp::collector::Collector};

/// Accepts any configuration, or refuses it in one line.
pub fn config(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    match text.parse::<ServerConfig>() {
        Ok(config) => drop(config.validate()),
        Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
    }
    if let Ok(collector) = text.parse::<Collector>() {
        assert_eq!(collector.to_string().parse(), Ok(collector));
    }
}

/// Accepts any token file, or refuses it in one line without quoting it.
pub fn tokens(bytes: &[u8]) {
    if let Err(error) = file::parse(Path::new("FILE"), bytes.to_vec()) {
        let message = error.to_string();
        assert!(!message.contains('\n') && message.len() < 300, "{message:?}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::admission::tokens::{Scope, make};

    /// Tries valid files and damaged ones. `GNOMON_FUZZ_SEEDS=FOLDER` writes the valid ones there, as seeds.
    fn drive(target: &str, seeds: &[String], entry: fn(&[u8])) {
        for (index, seed) in seeds.iter().enumerate() {
            if let Some(folder) = std::env::var_os("GNOMON_FUZZ_SEEDS") {
                let folder = Path::new(&folder).join(target);
                std::fs::create_dir_all(&folder).unwrap();
                std::fs::write(folder.join(index.to_string()), seed).unwrap();
            }
            entry(seed.as_bytes());
            let mut state = 7_u32;
            let mut below = |most: usize| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as usize % most.max(1)
            };
            for _ in 0..3_000 {
                let mut bytes = seed.clone().into_bytes();
                for _ in 0..=below(3) {
                    let place = below(bytes.len());
                    match below(3) {
                        0 => bytes.truncate(place + 1),
                        1 => bytes.insert(place, below(256).to_le_bytes()[0]),
                        _ => bytes[place] ^= 1 << below(8),
                    }
                }
                entry(&bytes);
            }
        }
    }

    #[test]
    fn a_damaged_configuration_is_refused_on_one_line() {
        let alternative = format!("gnomon://b:1/?cert={}", "ab".repeat(32));
        let all = format!(
            "scene = \"a.glb\"\nlisten = \"[::]:4433\"\nadmin = \"9100\"\nbackend = \"cpu\"\nmax_sessions = 4\n\
             threads = 2\notlp = \"http://collector:4318\"\nallow_software = true\nweb = \"8080\"\n\
             origins = \"https://a.example,https://b.example:8443\"\nalternative = \"{alternative}\"\n"
        );
        assert!(all.parse::<ServerConfig>().is_ok_and(|config| config.validate().is_ok()));
        drive("config", &[all, "http://collector".to_owned()], config);
    }

    #[test]
    fn a_damaged_token_file_is_refused_without_quoting_it() {
        let entry = |once| make("alice", Some(3), &[Scope::Session, Scope::Admin], once).unwrap().1;
        let both = [entry(false), entry(true)].concat();
        assert!(file::parse(Path::new("FILE"), both.clone().into_bytes()).is_ok());
        drive("tokens", &[both], tokens);
    }
}
