//! Properties that hold for any bytes of the files that an operator writes. The fuzz targets (`tests/fuzz`) and the test below call
//! these; nothing else should. Each panics when its property does not hold.

use std::path::Path;

use crate::{admission::tokens::store as tokens, config::ServerConfig, operate::otlp::collector::Collector};

/// A configuration that is accepted is within its ranges, and one that is not is refused on one line.
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

/// A token file lists tokens or is refused, and the refusal quotes nothing of it.
pub fn tokens(bytes: &[u8]) {
    if let Err(error) = tokens::parse(Path::new("FILE"), bytes.to_vec()) {
        let told = error.to_string();
        assert!(!told.contains('\n') && told.len() < 300, "{told:?}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Valid files, and damaged ones. With `GNOMON_FUZZ_SEEDS=FOLDER` the valid ones are written there, as the targets' seeds.
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
        let all = "scene = \"a.glb\"\nlisten = \"[::]:4433\"\nadmin = \"9100\"\nbackend = \"cpu\"\nmax_sessions = 4\nthreads = 2\n\
                   otlp = \"http://collector:4318\"\nallow_software = true\nalternative = \"gnomon://b:1/\"\n";
        assert!(all.parse::<ServerConfig>().is_ok_and(|config| config.validate().is_ok()));
        drive("config", &[all.to_owned(), "http://collector".to_owned()], config);
    }

    #[test]
    fn a_damaged_token_file_is_refused_without_a_word_of_it() {
        let entry =
            |once| tokens::make("alice", Some(3), &[tokens::Scope::Session, tokens::Scope::Admin], once).unwrap().1;
        let both = [entry(false), entry(true)].concat();
        assert!(tokens::parse(Path::new("FILE"), both.clone().into_bytes()).is_ok());
        drive("tokens", &[both], tokens);
    }
}
