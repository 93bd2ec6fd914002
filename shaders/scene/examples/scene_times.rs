//! Prints a scene's counts, and the time that loading, checking, packing and unpacking takes.
//!
//! `cargo run --release -p gnomon-scene --example scene_times -- SCENE.gltf [LIGHTS.json]`

use std::{error::Error, path::PathBuf, time::Instant};

use gnomon_scene::{LoadOptions, Scene};

fn timed<T>(what: &str, work: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let result = work();
    println!("{what:<11} {:.1} ms", started.elapsed().as_secs_f64() * 1e3);
    result
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let path = arguments.next().ok_or("usage: scene_times SCENE.gltf [LIGHTS.json]")?;
    let options = LoadOptions { lights_from: arguments.next(), ..LoadOptions::default() };
    let (scene, report) = timed("load", || Scene::load_with_report(&path, &options))?;
    println!("{}\n{report}", scene.summary());
    timed("check", || scene.check())?;
    let packed = timed("pack", || scene.pack())?;
    let unpacked = timed("unpack", || Scene::unpack(&packed))?;
    println!("packed      {} bytes, digest {}", packed.len(), blake3::hash(&packed));
    if unpacked == scene { Ok(()) } else { Err("the scene did not survive packing".into()) }
}
