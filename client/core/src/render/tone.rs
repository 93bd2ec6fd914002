//! The tone pass: maps exposed light to displayed values.

use std::{fmt, str::FromStr};

use gnomon_shaders::{gpu::Gpu, shading::Tone};
use serde::{Deserialize, Serialize};

use super::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, cleared, constant, covering_pipeline_with, picture, shader, uniform},
    targets::Targets,
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
    tone: wgpu::Buffer,
    group: wgpu::BindGroup,
    module: wgpu::ShaderModule,
    format: wgpu::TextureFormat,
    curve: ToneCurve,
    pipeline: wgpu::RenderPipeline,
}

impl TonePass {
    pub(crate) fn new(
        gpu: &Gpu,
        targets: &Targets,
        format: wgpu::TextureFormat,
        curve: ToneCurve,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let bindings = [uniform::<Tone>(gpu), picture(wgpu::TextureSampleType::Float { filterable: false })];
        let layout = bind_group_layout(device, "tone", wgpu::ShaderStages::FRAGMENT, &bindings);
        let tone = constant(gpu, "tone", &gnomon());
        let group = group(device, &layout, &tone, targets);
        let module = shader(gpu, "shading/tone.wgsl")?;
        let pipeline = pipeline(device, &module, &layout, curve, format);
        Ok(Self { layout, tone, group, module, format, curve, pipeline })
    }

    /// The curve is compiled into the pass, so that no pixel chooses.
    pub(crate) fn set_curve(&mut self, device: &wgpu::Device, curve: ToneCurve) {
        if self.curve != curve {
            self.curve = curve;
            self.pipeline = pipeline(device, &self.module, &self.layout, curve, self.format);
        }
    }

    pub(crate) fn curve(&self) -> ToneCurve {
        self.curve
    }

    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets) {
        self.group = group(device, &self.layout, &self.tone, targets);
    }

    pub(crate) fn encode(&self, encoder: &mut wgpu::CommandEncoder, target: &wgpu::TextureView) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("tone"),
            color_attachments: &[cleared(target)],
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.draw(0..3, 0..1);
    }
}

fn pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layout: &wgpu::BindGroupLayout,
    curve: ToneCurve,
    format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    covering_pipeline_with(device, module, &[layout], ("show", &[("curve_kind", curve.kind())]), format.into())
}

fn group(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    tone: &wgpu::Buffer,
    targets: &Targets,
) -> wgpu::BindGroup {
    let resources = [tone.as_entire_binding(), wgpu::BindingResource::TextureView(&targets.light)];
    bind_group(device, "tone", layout, &resources)
}
