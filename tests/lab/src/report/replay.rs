//! `lab replay`: draws a client's recording again, without a network, and says what the network did.

use std::{fs, io::BufWriter, path::PathBuf};

use anyhow::{Context, Result, ensure};
use gnomon_client::record::{
    Record, Start,
    replay::{Records, Replayed, replay},
};
use gnomon_protocol::ids::SceneDigest;
use gnomon_scene::{LoadOptions, Scene};
use gnomon_shaders::gpu::{Gpu, GpuOptions};
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};

/// What to draw again.
#[derive(Debug, Clone, clap::Args)]
pub struct ReplayOptions {
    /// The recording, as `gnomon-client --record` has written it.
    pub recording: PathBuf,
    /// The scene that was looked at, `.gltf` or `.glb`.
    #[arg(long)]
    pub scene: PathBuf,
    /// JSON file with lights, for a scene that has none.
    #[arg(long)]
    pub lights_from: Option<PathBuf>,
    /// Keeps the first lights only.
    #[arg(long)]
    pub lights: Option<u32>,
    /// Folder for a PNG a frame.
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Part of the graphics adapter's name.
    #[arg(long)]
    pub adapter: Option<String>,
}

/// What was drawn.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Replay {
    /// Pictures.
    pub frames: u64,
    /// Masks that had come.
    pub masks: u64,
    /// Network events.
    pub events: u64,
}

/// Draws all of it, and tells `say` about the network.
///
/// # Errors
/// When the recording cannot be read, the scene is another one, or a picture cannot be drawn or written.
pub fn run(options: &ReplayOptions, mut say: impl FnMut(&str)) -> Result<Replay> {
    let (start, mut records) =
        Records::open(&options.recording).with_context(|| format!("opening {}", options.recording.display()))?;
    let load = LoadOptions { lights_from: options.lights_from.clone(), max_lights: options.lights };
    let loaded = Scene::load(&options.scene, &load).with_context(|| format!("loading {}", options.scene.display()))?;
    let scene = recorded_scene(loaded, &start)?;
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

/// The scene that a recording was made of, if it is this one.
///
/// # Errors
/// When it is another one.
pub(super) fn recorded_scene(loaded: Scene, start: &Start) -> Result<Scene> {
    // A server's scene comes packed.
    let Some(wanted) = &start.scene_digest else { return Ok(loaded) };
    let packed = loaded.pack()?;
    let found = SceneDigest(*blake3::hash(&packed).as_bytes()).to_string();
    ensure!(found == *wanted, "the recording is of the scene {wanted}, and this is {found}");
    Ok(Scene::unpack(&packed)?)
}
