//! `lab replay`: redraws a client's recording without a network, and prints the network's events.

use std::{fs, io::BufWriter, path::PathBuf};

use anyhow::{Context, Result, ensure};
use gnomon_client::record::{
    Record, Start,
    replay::{Records, Replayed, replay},
};
use gnomon_protocol::ids::SceneDigest;
use gnomon_scene::Scene;
use gnomon_shaders::gpu::{Gpu, GpuOptions};
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};

use super::scene_args::SceneFile;

#[derive(Debug, Clone, clap::Args)]
pub struct ReplayOptions {
    /// Recording of `gnomon-client --record`.
    pub recording: PathBuf,
    #[command(flatten)]
    pub scene: SceneFile,
    /// Folder for one PNG per frame.
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Part of the graphics adapter's name.
    #[arg(long)]
    pub adapter: Option<String>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Replay {
    pub frames: u64,
    pub masks: u64,
    pub events: u64,
}

/// Draws all pictures and reports network events to `say`.
pub fn run(options: &ReplayOptions, mut say: impl FnMut(&str)) -> Result<Replay> {
    let (start, mut records) =
        Records::open(&options.recording).with_context(|| format!("opening {}", options.recording.display()))?;
    let scene = recorded_scene(options.scene.load()?, &start)?;
    let gpu = pollster::block_on(Gpu::open(&GpuOptions {
        adapter: options.adapter.clone(),
        allow_software: true,
        ..GpuOptions::default()
    }))?;
    if gpu.info.name != start.adapter {
        say(&format!("recorded on {}, drawn on {}: the last bits may differ", start.adapter, gpu.info.name));
    }
    if let Some(folder) = &options.out {
        fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    }
    let mut done = Replay::default();
    replay::<anyhow::Error>(
        &gpu,
        &scene,
        &start,
        &mut records,
        |_| true,
        |replayed| {
            match replayed {
                Replayed::Picture { picture, .. } => {
                    done.frames += 1;
                    if let Some(folder) = &options.out {
                        let file = folder.join(format!("frame_{:06}.png", picture.frame));
                        let rgb: Vec<u8> =
                            picture.rgba.as_chunks::<4>().0.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect();
                        let written = BufWriter::new(fs::File::create(&file)?);
                        PngEncoder::new(written)
                            .write_image(&rgb, picture.width, picture.height, ExtendedColorType::Rgb8)
                            .with_context(|| format!("writing {}", file.display()))?;
                    }
                }
                Replayed::Record(Record::Mask { .. }) => done.masks += 1,
                Replayed::Record(Record::Event { frame, text }) => {
                    done.events += 1;
                    say(&format!("frame {frame}: {text}"));
                }
                Replayed::Record(_) => {}
            }
            Ok(())
        },
    )?;
    Ok(done)
}

/// Returns the recorded scene. Errors if `loaded` is another one.
pub(super) fn recorded_scene(loaded: Scene, start: &Start) -> Result<Scene> {
    // Servers send scenes packed.
    let Some(wanted) = &start.scene_digest else { return Ok(loaded) };
    let packed = loaded.pack()?;
    let found = SceneDigest(*blake3::hash(&packed).as_bytes()).to_string();
    ensure!(found == *wanted, "the recording is of the scene {wanted}, and this is {found}");
    Ok(Scene::unpack(&packed)?)
}
