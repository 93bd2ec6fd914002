//! The tone pass: maps exposed light to displayed values, and smooths the edges of surfaces. Pixels that an edge
//! crosses are put off to a second dispatch (`put_off.wgsl`).

use std::{fmt, str::FromStr};

use gnomon_shaders::{
    gpu::Gpu,
    shading::{Tone, View},
};
use serde::{Deserialize, Serialize};

use super::{
    error::RenderError,
    pipeline::{
        bind_group, bind_group_layout, cleared, compute_pipeline, constant, picture, shader, storage, uniform,
        written_picture,
    },
    predict::depth_history::DepthHistory,
    present::PresentPass,
    put_off::PutOff,
    quality::Quality,
    targets::{PICTURE_FORMAT, Targets, texture},
};

/// How exposed light becomes what a screen can show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ToneCurve {
    /// Khronos PBR Neutral: paints look as their colours say, highlights roll off.
    #[default]
    Neutral,
    /// Hill's fit of ACES, as three.js has it.
    Aces,
    /// Lottes' curve on the brightest channel.
    Gnomon,
    /// No curve: light above 1 is cut off.
    None,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown tone curve {0:?}: use neutral, aces, gnomon or none")]
pub struct UnknownTone(pub String);

impl ToneCurve {
    pub const ALL: [Self; 4] = [Self::Neutral, Self::Aces, Self::Gnomon, Self::None];

    const fn name(self) -> &'static str {
        match self {
            Self::Neutral => "neutral",
            Self::Aces => "aces",
            Self::Gnomon => "gnomon",
            Self::None => "none",
        }
    }

    /// `curve_kind` in `tone.wgsl`.
    fn kind(self) -> f64 {
        match self {
            Self::Neutral => 0.0,
            Self::Aces => 1.0,
            Self::Gnomon => 2.0,
            Self::None => 3.0,
        }
    }
}

impl fmt::Display for ToneCurve {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for ToneCurve {
    type Err = UnknownTone;

    fn from_str(text: &str) -> Result<Self, UnknownTone> {
        let found = Self::ALL.into_iter().find(|curve| curve.name() == text);
        found.ok_or_else(|| UnknownTone(text.to_owned()))
    }
}

impl TryFrom<String> for ToneCurve {
    type Error = UnknownTone;

    fn try_from(text: String) -> Result<Self, UnknownTone> {
        text.parse()
    }
}

impl From<ToneCurve> for String {
    fn from(curve: ToneCurve) -> Self {
        curve.to_string()
    }
}

/// The points of [`ToneCurve::Gnomon`].
#[must_use]
pub fn gnomon() -> Tone {
    Tone::new(1.25, 0.97, 9.0, 0.18, 0.19)
}

#[derive(Debug)]
pub(crate) struct TonePass {
    layout: wgpu::BindGroupLayout,
    target_layout: wgpu::BindGroupLayout,
    tone: wgpu::Buffer,
    view: wgpu::Buffer,
    edge_shares: wgpu::Buffer,
    /// By the slot of the picture's depth in the history.
    groups: Vec<wgpu::BindGroup>,
    module: wgpu::ShaderModule,
    curve: ToneCurve,
    quality: Quality,
    /// `None` until the next picture.
    pipelines: Option<Pipelines>,
    format: wgpu::TextureFormat,
    /// Where the target cannot be written by the pass: a picture that can, and what draws it into the target.
    between: Option<(wgpu::TextureView, PresentPass)>,
}

#[derive(Debug, Clone)]
pub(crate) struct Pipelines {
    /// Does every pixel, or those put off.
    every: wgpu::ComputePipeline,
    /// Puts off those that an edge crosses. `None` if edges are not smooth.
    first: Option<wgpu::ComputePipeline>,
}

impl TonePass {
    pub(crate) fn new(
        gpu: &Gpu,
        (view, edge_shares): (&wgpu::Buffer, &wgpu::Buffer),
        targets: &Targets,
        history: &DepthHistory,
        format: wgpu::TextureFormat,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let bindings = [
            uniform::<Tone>(gpu),
            uniform::<View>(gpu),
            picture(wgpu::TextureSampleType::Float { filterable: false }),
            picture(wgpu::TextureSampleType::Depth),
            picture(wgpu::TextureSampleType::Uint),
            storage(true),
            PutOff::layout(),
        ];
        let stages = wgpu::ShaderStages::COMPUTE;
        let mut pass = Self {
            layout: bind_group_layout(device, "tone", stages, &bindings),
            target_layout: bind_group_layout(device, "shown picture", stages, &[written_picture(PICTURE_FORMAT)]),
            tone: constant(gpu, "tone", &gnomon()),
            view: view.clone(),
            edge_shares: edge_shares.clone(),
            groups: Vec::new(),
            module: shader(gpu, "shading/tone.wgsl")?,
            curve: ToneCurve::Gnomon,
            quality: Quality::Low,
            pipelines: None,
            format,
            between: None,
        };
        pass.resize(device, targets, history);
        Ok(pass)
    }

    /// The curve is compiled into the pass, so that no pixel chooses.
    pub(crate) fn set_curve(&mut self, curve: ToneCurve) {
        if self.curve != curve {
            (self.curve, self.pipelines) = (curve, None);
        }
    }

    pub(crate) fn curve(&self) -> ToneCurve {
        self.curve
    }

    pub(crate) fn set_quality(&mut self, quality: Quality) {
        if self.quality != quality {
            (self.quality, self.pipelines) = (quality, None);
        }
    }

    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets, history: &DepthHistory) {
        let view = wgpu::BindingResource::TextureView;
        let group = |depth| {
            let resources = [
                self.tone.as_entire_binding(),
                self.view.as_entire_binding(),
                view(&targets.light),
                view(depth),
                view(&targets.normal_material),
                self.edge_shares.as_entire_binding(),
                targets.put_off.binding(),
            ];
            bind_group(device, "tone", &self.layout, &resources)
        };
        self.groups = history.views().map(group).collect();
        self.between = None;
    }

    /// Compiles what pictures of the chosen curve and quality take.
    pub(crate) fn compile(&mut self, device: &wgpu::Device) -> &Pipelines {
        self.pipelines.get_or_insert_with(|| {
            let on = |on| f64::from(u8::from(on));
            let smooth = self.quality == Quality::High;
            let make = |puts_off: bool| {
                let constants =
                    [("curve_kind", self.curve.kind()), ("smooth_edges", on(smooth)), ("puts_off", on(puts_off))];
                compute_pipeline(device, &self.module, &[&self.layout, &self.target_layout], ("show", &constants))
            };
            Pipelines { every: make(false), first: smooth.then(|| make(true)) }
        })
    }

    /// Errors if a shader does not compile.
    pub(crate) fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (targets, history): (&Targets, &DepthHistory),
        target: &wgpu::TextureView,
    ) -> Result<(), RenderError> {
        let written = (target.texture().usage(), target.texture().format());
        if written.0.contains(wgpu::TextureUsages::STORAGE_BINDING) && written.1 == PICTURE_FORMAT {
            self.compute(gpu, encoder, (targets, history), target);
            return Ok(());
        }
        let size = (targets.width, targets.height);
        let (picture, mut present) = match self.between.take() {
            Some(between) => between,
            None => (between(&gpu.device, size), PresentPass::new(gpu, self.format)?),
        };
        self.compute(gpu, encoder, (targets, history), &picture);
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("show"),
                color_attachments: &[cleared(target)],
                ..wgpu::RenderPassDescriptor::default()
            });
            present.draw((&gpu.device, &gpu.queue), &mut pass, &picture, size);
        }
        self.between = Some((picture, present));
        Ok(())
    }

    fn compute(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (targets, history): (&Targets, &DepthHistory),
        target: &wgpu::TextureView,
    ) {
        let device = &gpu.device;
        let target = [wgpu::BindingResource::TextureView(target)];
        let target = bind_group(device, "shown picture", &self.target_layout, &target);
        let Pipelines { every, first } = self.compile(device).clone();
        let groups = [&self.groups[history.current()], &target];
        targets.put_off.run(encoder, "tone", (first.as_ref(), &every), &groups);
    }
}

/// A picture that the pass can write and [`PresentPass`] can read.
fn between(device: &wgpu::Device, size: (u32, u32)) -> wgpu::TextureView {
    let usage = wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::TEXTURE_BINDING;
    texture(device, "shown picture", size, PICTURE_FORMAT, usage).create_view(&wgpu::TextureViewDescriptor::default())
}
