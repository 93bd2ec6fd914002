//! The client's own shadow maps, drawn once, with the first picture that needs them; anew when something has moved.
//!
//! Received visibility lacks surfaces that its view did not see. There the client looks into a map of its own: coarser
//! than the server's rays, but never late. All maps share one square: six cube faces for a point light, one map for a
//! spot, and one of four times the texels for a directional light, which covers the whole scene (`shadow_views.rs`).
//!
//! Where something moves or is edited, the maps of what rests are kept beside them. For another state, texels that what
//! moves had covered are put back, and what moves is drawn where it is now: work in proportion to what moves, not to
//! the maps. Only squares of lights that are not where the file has them are drawn anew as a whole.

use std::{iter::repeat_n, sync::Arc};

use glam::Mat4;
use gnomon_scene::{Aabb, Light, Scene, camera::Space};
use gnomon_shaders::{gpu::Gpu, shading::ShadowView};
use wgpu::util::DeviceExt as _;

use super::{
    depth_pass::{self, DepthPass, Faces, Part},
    eraser::Eraser,
    shadow_views::{layout, views_of},
    swept::swept_bounds,
    texels::{Texels, covered},
};
use crate::render::{
    error::RenderError,
    movers::Movers,
    pipeline::{Variable, constant},
    scene_upload::SceneUpload,
    targets::{DEPTH, texture},
    work::Work,
};

#[derive(Debug)]
pub(crate) struct ShadowMap {
    pub(crate) texture: wgpu::TextureView,
    pub(crate) views: wgpu::Buffer,
    /// Every light's views, one light after the other.
    lights_views: Vec<ShadowView>,
    /// The matrix of each view, as it is drawn with.
    groups: Vec<(Variable<Mat4>, wgpu::BindGroup)>,
    is_drawn: bool,
    /// What all views cover, and the distance of their near planes in metres.
    space: (Aabb, f64),
    of_file: Arc<OfFile>,
    /// `None` if everything rests, and nothing was edited.
    moving: Option<Moving>,
    work: Work,
}

/// Views that lights have in the pose of the file.
#[derive(Debug)]
struct OfFile {
    views: Vec<ShadowView>,
    /// The number of each view's light.
    lights: Vec<u32>,
}

/// What maps have beside something that moves.
#[derive(Debug)]
struct Moving {
    eraser: Eraser,
    /// The maps of what rests, in the views of the file, once they are drawn.
    resting: Option<(wgpu::TextureView, wgpu::BindGroup)>,
    /// For each view, where the map may differ from that. Empty until the map is first drawn.
    drawn: Vec<Vec<Texels>>,
}

impl ShadowMap {
    /// Allocates the maps of all lights of `scene`.
    pub(crate) fn new(gpu: &Gpu, scene: &Scene, upload: &SceneUpload) -> Result<Self, RenderError> {
        let space = (swept_bounds(scene), Space::of(scene).near_m);
        let limit = gpu.device.limits().max_texture_dimension_2d;
        let (side, views) = layout(&scene.lights, (&space.0, space.1), limit);
        let numbers = |(number, light): (u32, &Light)| repeat_n(number, views_of(light.kind) as usize);
        let lights = (0..).zip(&scene.lights).flat_map(numbers).collect();
        let mut map = Self::allocate(gpu, (side, space), Arc::new(OfFile { views, lights }));
        if upload.movers().is_some() {
            map.follow_edits(gpu)?;
        }
        Ok(map)
    }

    /// Keeps maps of what rests from now on.
    ///
    /// # Errors
    /// If the adapter failed.
    pub(crate) fn follow_edits(&mut self, gpu: &Gpu) -> Result<(), RenderError> {
        self.moving = Some(Moving { eraser: Eraser::new(gpu)?, resting: None, drawn: Vec::new() });
        Ok(())
    }

    /// Maps of the same lights for another state of the scene. `None` if everything rests.
    pub(crate) fn another(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        pass: &DepthPass,
        upload: &SceneUpload,
    ) -> Option<Self> {
        self.need_resting(gpu, encoder, (pass, upload));
        let Moving { eraser, resting, .. } = self.moving.as_ref()?;
        let (eraser, resting) = (eraser.clone(), resting.clone());
        let (side, of_file) = (self.texture.texture().width(), Arc::clone(&self.of_file));
        let mut other = Self::allocate(gpu, (side, self.space), of_file);
        other.moving = Some(Moving { eraser, resting, drawn: Vec::new() });
        Some(other)
    }

    fn allocate(gpu: &Gpu, (side, space): (u32, (Aabb, f64)), of_file: Arc<OfFile>) -> Self {
        let device = &gpu.device;
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        let texture = texture(device, "shadow map", (side, side), DEPTH, usage)
            .create_view(&wgpu::TextureViewDescriptor::default());
        let lights_views = of_file.views.clone();
        // A binding cannot be empty.
        let contents = [&lights_views[..], &[bytemuck::Zeroable::zeroed()]].concat();
        let views = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("lights' views"),
            contents: bytemuck::cast_slice(&contents),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        });
        let (groups, is_drawn, moving, work) = (Vec::new(), false, None, Work::default());
        Self { texture, views, lights_views, groups, is_drawn, space, of_file, moving, work }
    }

    pub(crate) fn work(&self) -> Work {
        self.work
    }

    /// Bits of all lights.
    pub(super) fn lights(&self) -> u32 {
        bits(self.of_file.lights.iter())
    }

    /// Bits of lights in whose maps something may differ from what rests.
    pub(super) fn touched(&self) -> u32 {
        let drawn = self.moving.iter().flat_map(|moving| &moving.drawn);
        let lights = self.of_file.lights.iter().zip(drawn);
        bits(lights.filter(|(_, drawn)| !drawn.is_empty()).map(|(light, _)| light))
    }

    /// Bits of lights that have other views there.
    pub(super) fn moved(&self, other: &Self) -> u32 {
        let views = self.of_file.lights.iter().zip(self.lights_views.iter().zip(&other.lights_views));
        bits(views.filter(|(_, (one, other))| one != other).map(|(light, _)| light))
    }

    /// Where something moving is drawn, or lights have moved.
    pub(super) fn drawn(&self) -> impl Iterator<Item = &Texels> {
        self.moving.iter().flat_map(|moving| moving.drawn.iter().flatten())
    }

    /// Takes the lights of another state, in which the maps are to be drawn anew.
    pub(crate) fn set_lights(&mut self, gpu: &Gpu, lights: &[Light]) {
        self.is_drawn = false;
        let (bounds, near_m) = &self.space;
        let (_, views) = layout(lights, (bounds, *near_m), gpu.device.limits().max_texture_dimension_2d);
        if views == self.lights_views {
            return;
        }
        gpu.queue.write_buffer(&self.views, 0, bytemuck::cast_slice(&views));
        self.lights_views = views;
    }

    /// Ensures that the maps are drawn before what `encoder` does next, of what `upload` shows then.
    pub(crate) fn need(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        pass: &DepthPass,
        upload: &SceneUpload,
    ) {
        if std::mem::replace(&mut self.is_drawn, true) || self.lights_views.is_empty() {
            return;
        }
        self.need_resting(gpu, encoder, (pass, upload));
        self.bind_views(gpu, pass);
        if let Some(mut moving) = self.moving.take() {
            self.draw_moving(encoder, (pass, upload), &mut moving);
            self.moving = Some(moving);
            return;
        }
        let mut render = depth_pass::begin(encoder, "shadow map", &self.texture);
        self.work.passes += 1;
        for (view, (_, group)) in self.lights_views.iter().zip(&self.groups) {
            look(&mut render, view);
            add(&mut self.work, pass.draw(&mut render, group, upload, (Part::All, Faces::Both)));
        }
    }

    /// Ensures that there are maps of what rests, beside something that moves.
    fn need_resting(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (pass, upload): (&DepthPass, &SceneUpload),
    ) {
        let Some(moving) = self.moving.as_mut().filter(|moving| moving.resting.is_none()) else { return };
        let (side, device) = (self.texture.texture().width(), &gpu.device);
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        let resting = texture(device, "shadow map of what rests", (side, side), DEPTH, usage)
            .create_view(&wgpu::TextureViewDescriptor::default());
        let mut render = depth_pass::begin(encoder, "shadow map of what rests", &resting);
        self.work.passes += 1;
        for view in &self.of_file.views {
            let matrix = constant(gpu, "light's view of the file", &view.clip_from_local);
            let group = pass.group(device, matrix.as_entire_binding());
            look(&mut render, view);
            add(&mut self.work, pass.draw(&mut render, &group, upload, (Part::Resting, Faces::Both)));
        }
        drop(render);
        let group = moving.eraser.group(device, &resting);
        moving.resting = Some((resting, group));
    }

    /// Takes out of the maps what moved, and draws it where it is now. The square of a light that has moved is drawn
    /// as a whole.
    fn draw_moving(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        (pass, upload): (&DepthPass, &SceneUpload),
        moving: &mut Moving,
    ) {
        let Moving { eraser, resting: Some((_, resting)), drawn } = moving else { return };
        if drawn.is_empty() {
            // Nothing is drawn yet.
            drawn.extend(self.lights_views.iter().map(|view| vec![Texels::of(view)]));
        }
        let rests: Vec<bool> =
            self.lights_views.iter().zip(&self.of_file.views).map(|(one, other)| one == other).collect();
        let mut render = depth_pass::begin_with(encoder, "shadow map", &self.texture, wgpu::LoadOp::Load);
        self.work.passes += 1;
        let moved = self.lights_views.iter().zip(&rests).filter(|(_, rests)| !**rests);
        let old = drawn.iter().zip(&rests).filter(|(_, rests)| **rests).flat_map(|(drawn, _)| drawn);
        self.work.texels += eraser.clear(&mut render, moved.map(|(view, _)| Texels::of(view)));
        self.work.texels += eraser.put_back(&mut render, resting, old.copied());
        let bounds = upload.movers().map(Movers::bounds).unwrap_or_default();
        let views = self.lights_views.iter().zip(&self.groups).zip(rests);
        for (((view, (_, group)), rests), drawn) in views.zip(drawn) {
            drawn.clear();
            if !rests {
                look(&mut render, view);
                add(&mut self.work, pass.draw(&mut render, group, upload, (Part::All, Faces::Both)));
                drawn.push(Texels::of(view));
                continue;
            }
            let covered: Vec<Option<Texels>> =
                bounds.iter().map(|bounds| bounds.as_ref().and_then(|bounds| covered(view, bounds))).collect();
            drawn.extend(covered.iter().flatten());
            if drawn.is_empty() {
                continue;
            }
            look(&mut render, view);
            let seen = |piece: usize| covered.get(piece).is_some_and(Option::is_some);
            add(&mut self.work, pass.draw_pieces(&mut render, group, upload, seen));
            // Where many things cover each other, the whole square is fewer texels.
            let square = Texels::of(view);
            if drawn.iter().map(|texels| texels.count()).sum::<u64>() > square.count() {
                drawn.clear();
                drawn.push(square);
            }
        }
    }

    /// Binds the views' matrices.
    fn bind_views(&mut self, gpu: &Gpu, pass: &DepthPass) {
        while self.groups.len() < self.lights_views.len() {
            let matrix = Variable::new(gpu, "light's view");
            let group = pass.group(&gpu.device, matrix.buffer().as_entire_binding());
            self.groups.push((matrix, group));
        }
        for (view, (matrix, _)) in self.lights_views.iter().zip(&mut self.groups) {
            matrix.set(&gpu.queue, view.clip_from_local);
        }
    }
}

/// A bit for each of these lights.
fn bits<'a>(lights: impl Iterator<Item = &'a u32>) -> u32 {
    lights.fold(0, |bits, light| bits | 1_u32.checked_shl(*light).unwrap_or(0))
}

/// Counts draws and their triangles.
fn add(work: &mut Work, (draws, triangles): (u64, u64)) {
    work.draws += draws;
    work.triangles += triangles;
}

/// Draws into a view's square from now on.
fn look(render: &mut wgpu::RenderPass<'_>, view: &ShadowView) {
    render.set_viewport(view.left, view.top, view.side, view.side, 0.0, 1.0);
    let square = Texels::of(view);
    render.set_scissor_rect(square.left, square.top, square.width, square.height);
}
