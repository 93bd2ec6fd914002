//! Measures one scene at every setting.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gnomon_client::{camera_path::CameraPath, predictor::Predictor};
use gnomon_protocol::{codec::CodecId, mask::Mask};
use gnomon_scene::{LightKind, Scene, camera::Camera};

use super::{
    judge::{Stop, Verdict},
    row::{Group, Row},
    tracer::{Patience, Traced, Tracer, node_visits},
    viewer::Viewer,
};
use crate::reference::Reference;

/// A client's frame, in seconds: the unit of lag.
const FRAME_S: f64 = 1.0 / 60.0;

/// The fastest codec, since tracing is compared.
const CODEC: CodecId = CodecId::PlanesLz4;

/// Moments of the path at which scenes are judged, as shares of its duration.
const STOPS: [f64; 2] = [0.2, 0.6];

/// Wrong bits allowed in a million.
const WRONG_PPM: [u16; 3] = [500, 2000, 5000];

/// A mask, and the camera that it was traced for.
type MaskOf = (Mask, Camera);

pub(super) struct Bench<'a> {
    name: &'a str,
    scene: &'a Scene,
    path: &'a CameraPath,
    viewer: Viewer,
    stops: Vec<Stop>,
    patience: Patience,
    rows: Vec<Row>,
}

struct Knob<'a> {
    backend: &'a str,
    knob: &'a str,
    value: String,
    is_default: bool,
}

impl<'a> Bench<'a> {
    pub(super) fn new(
        name: &'a str,
        scene: &'a Scene,
        path: &'a CameraPath,
        (width, height): (u32, u32),
        (samples, seconds): (usize, f64),
    ) -> Result<Self> {
        let mut viewer = Viewer::new(scene, (width, height))?;
        let referee = Reference::new(scene);
        let stops = STOPS
            .iter()
            .map(|share| {
                let time_s = share * path.duration_s();
                Stop::new((scene, &referee), &mut viewer, (time_s, path.camera(time_s, width, height)))
            })
            .collect::<Result<_>>()?;
        let patience = Patience { samples, time: Duration::from_secs_f64(seconds) };
        Ok(Self { name, scene, path, viewer, stops, patience, rows: Vec::new() })
    }

    pub(super) fn rows(self) -> Vec<Row> {
        self.rows
    }

    /// Measures a back end with masks of full and of half size. Returns false if no adapter has what it needs.
    pub(super) fn resolutions(&mut self, backend: &str, is_automatic: bool) -> Result<bool> {
        let Some(mut tracer) = self.open(backend)? else { return Ok(false) };
        for (value, divisor) in [("full", 1), ("half-mask", 2)] {
            let camera = |stop: &Stop| Camera {
                width: stop.camera.width.div_ceil(divisor),
                height: stop.camera.height.div_ceil(divisor),
                ..stop.camera
            };
            let (traced, masks) = self.trace(&mut tracer, CODEC, camera)?;
            let nodes = node_visits(backend, self.scene, &camera(&self.stops[0]))?;
            let verdict = self.show(&masks, Predictor::Surface)?;
            let is_default = is_automatic && divisor == 1;
            self.push(Knob { backend, knob: "resolution", value: value.into(), is_default }, &traced, nodes, &verdict);
        }
        Ok(true)
    }

    /// Measures offsets of shadow rays from their surface, on `compute`.
    pub(super) fn offsets(&mut self) -> Result<()> {
        for roundings in [1, 16, 256, 4096] {
            let mut tracer = Tracer::with_offset(self.scene, roundings)?;
            let (traced, masks) = self.trace(&mut tracer, CODEC, |stop| stop.camera)?;
            let verdict = self.show(&masks, Predictor::Surface)?;
            let value = format!("{roundings} roundings");
            self.push(Knob { backend: "compute", knob: "offset", value, is_default: false }, &traced, None, &verdict);
        }
        Ok(())
    }

    /// Measures the lossless codecs.
    pub(super) fn codecs(&mut self, backend: &str) -> Result<()> {
        let mut tracer = self.open(backend)?.context("the back end is gone")?;
        for codec in CodecId::ALL.into_iter().filter(|codec| *codec != CODEC) {
            let (traced, masks) = self.trace(&mut tracer, codec, |stop| stop.camera)?;
            let verdict = self.show(&masks, Predictor::Surface)?;
            let knob = Knob { backend, knob: "codec", value: codec.to_string(), is_default: false };
            self.push(knob, &traced, None, &verdict);
        }
        Ok(())
    }

    /// Measures wrong bits against bytes. The rows of `codecs` are those without wrong bits.
    pub(super) fn lossy(&mut self, backend: &str) -> Result<()> {
        for codec in CodecId::ALL.into_iter().filter(|codec| codec.is_sliced()) {
            for wrong_ppm in WRONG_PPM {
                let tracer = self.open(backend)?.context("the back end is gone")?;
                let mut tracer = tracer.with_wrong_bits(wrong_ppm);
                let (traced, masks) = self.trace(&mut tracer, codec, |stop| stop.camera)?;
                let verdict = self.show(&masks, Predictor::Surface)?;
                let value = format!("{codec} {} %", f64::from(wrong_ppm) / 1e4);
                self.push(Knob { backend, knob: "lossy", value, is_default: false }, &traced, None, &verdict);
            }
        }
        Ok(())
    }

    /// Measures late masks with each predictor. A frame waits for tracing and encoding beyond the lag.
    pub(super) fn lags(&mut self, backend: &str) -> Result<()> {
        let mut tracer = self.open(backend)?.context("the back end is gone")?;
        let mut never_waited = false;
        for lag in [0_u32, 1, 2, 4, 8] {
            let late_s = f64::from(lag) * FRAME_S;
            let path = self.path;
            let late = |stop: &Stop| path.camera(stop.time_s - late_s, stop.camera.width, stop.camera.height);
            let (mut traced, masks) = self.trace(&mut tracer, CODEC, late)?;
            traced.iter_mut().for_each(|traced| traced.ms = (traced.ms - late_s * 1e3).max(0.0));
            let waits = traced.iter().filter(|traced| traced.ms > 0.0).count() * 2 > traced.len();
            let predictors: &[Predictor] = match lag {
                0 => &[Predictor::Surface],
                _ => &[Predictor::Surface, Predictor::ALL[1].1, Predictor::None],
            };
            for &predictor in predictors {
                // A client that does not wait shows the newest mask.
                let is_default = predictor == Predictor::Surface && !waits && !never_waited;
                let verdict = self.show(&masks, predictor)?;
                let knob = Knob { backend, knob: "lag", value: format!("{lag} {predictor}"), is_default };
                self.push(knob, &traced, None, &verdict);
            }
            never_waited |= !waits;
        }
        Ok(())
    }

    /// Measures dim lights that are traced only every few frames and predicted in between.
    pub(super) fn dim_lights(&mut self, backend: &str) -> Result<()> {
        let dim = dim_lights(self.scene);
        if dim == 0 {
            return Ok(());
        }
        let mut bright_scene = self.scene.clone();
        let mut index = 0;
        bright_scene.lights.retain(|_| {
            index += 1;
            dim >> (index - 1) & 1 == 0
        });
        let mut all = self.open(backend)?.context("the back end is gone")?;
        let mut bright = Tracer::open(backend, &bright_scene)?.context("the back end is gone")?;
        let (every, masks) = self.trace(&mut all, CODEC, |stop| stop.camera)?;
        let (between, _) = self.trace(&mut bright, CODEC, |stop| stop.camera)?;
        for period in [2_u32, 4] {
            let mut verdict = Verdict::default();
            for age in 0..period {
                let (path, late_s) = (self.path, f64::from(age) * FRAME_S);
                let late = |stop: &Stop| path.camera(stop.time_s - late_s, stop.camera.width, stop.camera.height);
                for (stop, (now, _)) in self.stops.iter().zip(&masks) {
                    let (camera, mut old) = (late(stop), all.mask_for(&stop.camera)?);
                    all.trace(&camera, &mut old, CODEC)?;
                    let predicted = self.viewer.show(&stop.camera, (&old, &camera), Predictor::Surface)?.bits;
                    let mut both = now.clone();
                    let tiles = both.shape().tiles();
                    let planes = both.words_mut().chunks_mut(tiles).zip(predicted.words().chunks(tiles));
                    for (plane, (ours, theirs)) in planes.enumerate() {
                        if dim >> plane & 1 == 1 {
                            ours.copy_from_slice(theirs);
                        }
                    }
                    stop.judge(
                        &self.viewer.show(&stop.camera, (&both, &stop.camera), Predictor::Surface)?,
                        &mut verdict,
                    );
                }
            }
            // One frame with all lights, then the rest of its period without the dim ones.
            let frames = (0..)
                .zip(every.iter().zip(between.iter().cycle()))
                .map(|(index, (all, bright))| if index % period == 0 { *all } else { *bright });
            let knob = Knob { backend, knob: "dim lights", value: format!("every {period} frames"), is_default: false };
            self.push(knob, &frames.collect::<Vec<_>>(), None, &verdict);
        }
        Ok(())
    }

    fn open(&self, backend: &str) -> Result<Option<Tracer>> {
        Tracer::open(backend, self.scene)
    }

    /// Traces each stop repeatedly, as `camera` sees it. Returns the costs and the stops' masks.
    fn trace(
        &self,
        tracer: &mut Tracer,
        codec: CodecId,
        camera: impl Fn(&Stop) -> Camera,
    ) -> Result<(Vec<Traced>, Vec<MaskOf>)> {
        let mut masks = Vec::with_capacity(self.stops.len());
        for stop in &self.stops {
            let camera = camera(stop);
            let mut mask = tracer.mask_for(&camera)?;
            // The first frame allocates buffers and is not counted.
            tracer.trace(&camera, &mut mask, codec)?;
            masks.push((mask, camera));
        }
        let samples = self.patience.repeat(|_| {
            masks.iter_mut().map(|(mask, camera)| tracer.trace(camera, mask, codec)).collect::<Result<Vec<_>>>()
        })?;
        Ok((samples.into_iter().flatten().collect(), masks))
    }

    /// Judges the pictures that the client draws with the stops' masks.
    fn show(&mut self, masks: &[MaskOf], predictor: Predictor) -> Result<Verdict> {
        let mut verdict = Verdict::default();
        for (stop, (mask, camera)) in self.stops.iter().zip(masks) {
            stop.judge(&self.viewer.show(&stop.camera, (mask, camera), predictor)?, &mut verdict);
        }
        Ok(verdict)
    }

    fn push(&mut self, knob: Knob<'_>, traced: &[Traced], node_visits: Option<u64>, verdict: &Verdict) {
        let Knob { backend, knob, value, is_default } = knob;
        let group = if knob == "lag" { Group::Prediction } else { Group::Tracing };
        self.rows.push(Row::new([self.name, backend, knob, &value], (group, is_default), traced, node_visits, verdict));
    }
}

/// The dimmer half of the lights as bits, by their unshadowed intensity at the scene's middle.
fn dim_lights(scene: &Scene) -> u32 {
    let middle = (scene.bounds.min + scene.bounds.max) * 0.5;
    let mut order: Vec<(f32, usize)> = scene
        .lights
        .iter()
        .map(|light| match light.kind {
            LightKind::Directional => light.intensity,
            LightKind::Point | LightKind::Spot { .. } => {
                light.intensity / (light.position - middle).length_squared().max(1.0)
            }
        })
        .zip(0..)
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    order[..order.len() / 2].iter().fold(0, |bits, (_, index)| bits | 1 << index)
}

/// Errors if the path does not move: then lag costs nothing and proves nothing.
pub(super) fn check(path: &CameraPath) -> Result<()> {
    ensure!(path.duration_s() > 0.0, "camera path {:?} does not move: prediction cannot be judged on it", path.name());
    Ok(())
}
