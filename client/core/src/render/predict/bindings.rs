//! Bind group layouts of `predict.wgsl`.

use gnomon_shaders::{
    gpu::Gpu,
    shading::{Lighting, Prediction, View},
};

use crate::render::{
    pipeline::{bind_group_layout, storage, uniform, written_picture},
    put_off::PutOff,
    targets::VISIBILITY,
};

/// Layouts of the pass's three groups: scene and lights, the picture's surfaces, masks.
pub(super) fn layouts(gpu: &Gpu) -> [wgpu::BindGroupLayout; 3] {
    let pictures =
        |view_dimension| {
            [wgpu::TextureSampleType::Depth, wgpu::TextureSampleType::Uint]
                .map(|sample_type| wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false })
        };
    let [depth, words] = pictures(wgpu::TextureViewDimension::D2);
    let [depths, all_words] = pictures(wgpu::TextureViewDimension::D2Array);
    let nearest = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::NonFiltering);
    let layout = |label, bindings: &[wgpu::BindingType]| {
        bind_group_layout(&gpu.device, label, wgpu::ShaderStages::COMPUTE, bindings)
    };
    [
        layout(
            "prediction: scene",
            &[
                uniform::<View>(gpu),
                uniform::<Lighting>(gpu),
                depth,
                storage(true),
                uniform::<Prediction>(gpu),
                storage(false),
                storage(true),
            ],
        ),
        layout("prediction: surfaces", &[depth, words, written_picture(VISIBILITY), PutOff::layout(), words, words]),
        layout("prediction: masks", &[all_words, all_words, depths, nearest]),
    ]
}
