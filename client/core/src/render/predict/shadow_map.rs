//! The client's own shadow maps, drawn once, with the first picture that needs them; anew when something has moved.
//!
//! Received visibility lacks surfaces that its view did not see. There the client looks into a map of its own: coarser
//! than the server's rays, but never late. All maps share one square: six cube faces for a point light, one map for a
//! spot, and one of four times the texels for a directional light, which covers the whole scene (`shadow_views.rs`).
//!
//! Where something moves or is edited, the maps of what rests are kept beside them. For another state, texels that what
//! moves had covered are put back, and what moves is drawn where it is now, if its shadow may be seen: work in
//! proportion to what moves, not to the maps. Only squares of lights that are not where the file has them are drawn
//! anew as a whole.

use std::{iter::repeat_n, sync::Arc};

use glam::{Mat4, Vec3};
use gnomon_scene::{Aabb, Light, LightKind, Scene, camera::Space};
use gnomon_shaders::{gpu::Gpu, shading::ShadowView};
use wgpu::util::DeviceExt as _;

use super::{
    depth_pass::{self, DepthPass, Faces, Part},
    eraser::Eraser,
    seen::Seen,
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

/// A lookup is made up to a texel off its point, and reads the four around; their centres are as far again.
const LOOKUP_TEXELS: f32 = 4.0;

#[derive(Debug)]
pub(crate) struct ShadowMap {
    pub(crate) texture: wgpu::TextureView,
    pub(crate) views: wgpu::Buffer,
    /// Every light's views, one light after the other.
    lights_views: Vec<ShadowView>,
    /// The matrix of each view, as it is drawn with.
    groups: Vec<(Variable<Mat4>, wgpu::BindGroup)>,
    /// The lights of the state that is drawn next.
    lights: Vec<Light>,
    drawn_for: DrawnFor,
    /// What all views cover, and the distance of their near planes in metres.
    space: (Aabb, f64),
    of_file: Arc<OfFile>,
    /// `None` if everything rests, and nothing was edited.
    moving: Option<Moving>,
    work: Work,
}

/// For whom the maps are drawn, as they are in this state.
#[derive(Debug, Clone, Copy, PartialEq)]
enum DrawnFor {
    Nobody,
    /// Of what moves, only what may shade this is there.
    These(Seen),
    All,
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
        let of_file = Arc::new(OfFile { views, lights });
        let mut map = Self::allocate(gpu, (side, space), of_file, scene.lights.clone());
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
        let mut other = Self::allocate(gpu, (side, self.space), of_file, self.lights.clone());
        other.moving = Some(Moving { eraser, resting, drawn: Vec::new() });
        Some(other)
    }

    fn allocate(gpu: &Gpu, (side, space): (u32, (Aabb, f64)), of_file: Arc<OfFile>, lights: Vec<Light>) -> Self {
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
        let (groups, drawn_for, moving, work) = (Vec::new(), DrawnFor::Nobody, None, Work::default());
        Self { texture, views, lights_views, groups, lights, drawn_for, space, of_file, moving, work }
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
        self.drawn_for = DrawnFor::Nobody;
        self.lights.clear();
        self.lights.extend_from_slice(lights);
        let (bounds, near_m) = &self.space;
        let (_, views) = layout(lights, (bounds, *near_m), gpu.device.limits().max_texture_dimension_2d);
        if views == self.lights_views {
            return;
        }
        gpu.queue.write_buffer(&self.views, 0, bytemuck::cast_slice(&views));
        self.lights_views = views;
    }

    /// Ensures that the maps are drawn before what `encoder` does next, of what `upload` shows then: all that may shade
    /// what is seen. If the same state is seen from elsewhere, all of it is drawn, once.
    pub(crate) fn need(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (pass, upload): (&DepthPass, &SceneUpload),
        seen: &Seen,
    ) {
        if self.serves(seen) || self.lights_views.is_empty() {
            return;
        }
        let again = self.drawn_for != DrawnFor::Nobody;
        self.drawn_for = match self.drawn_for {
            DrawnFor::Nobody if self.moving.is_some() => DrawnFor::These(seen.and_around(self.lookup_m())),
            _ => DrawnFor::All,
        };
        self.need_resting(gpu, encoder, (pass, upload));
        self.bind_views(gpu, pass);
        if let Some(mut moving) = self.moving.take() {
            let leaves_out = self.draw_moving(encoder, (pass, upload), &mut moving, again);
            if !leaves_out {
                self.drawn_for = DrawnFor::All;
            }
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

    /// Whether the maps are drawn for what is seen.
    pub(super) fn serves(&self, seen: &Seen) -> bool {
        match &self.drawn_for {
            DrawnFor::Nobody => false,
            DrawnFor::These(these) => these.covers(&seen.and_around(self.lookup_m())),
            DrawnFor::All => true,
        }
    }

    /// How far from a point its lookups may look, in metres, in any view.
    fn lookup_m(&self) -> f32 {
        let Aabb { min, max } = self.space.0;
        let farthest_m = |from: Vec3| (min - from).abs().max((max - from).abs()).length();
        let lights = self.of_file.lights.iter().filter_map(|light| self.lights.get(*light as usize));
        let texels = lights.zip(&self.lights_views).map(|(light, view)| match light.kind {
            LightKind::Directional => view.texel_m,
            LightKind::Point | LightKind::Spot { .. } => view.texel_m * farthest_m(light.position),
        });
        LOOKUP_TEXELS * texels.fold(0.0, f32::max)
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
    /// as a whole, but not `again` for the same state. Returns whether something is left out.
    fn draw_moving(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        (pass, upload): (&DepthPass, &SceneUpload),
        moving: &mut Moving,
        again: bool,
    ) -> bool {
        let Moving { eraser, resting: Some((_, resting)), drawn } = moving else { return false };
        if drawn.is_empty() {
            // Nothing is drawn yet.
            drawn.extend(self.lights_views.iter().map(|view| vec![Texels::of(view)]));
        }
        let rests: Vec<bool> =
            self.lights_views.iter().zip(&self.of_file.views).map(|(one, other)| one == other).collect();
        let mut render = depth_pass::begin_with(encoder, "shadow map", &self.texture, wgpu::LoadOp::Load);
        self.work.passes += 1;
        let moved = self.lights_views.iter().zip(&rests).filter(|(_, rests)| !**rests && !again);
        let old = drawn.iter().zip(&rests).filter(|(_, rests)| **rests).flat_map(|(drawn, _)| drawn);
        self.work.texels += eraser.clear(&mut render, moved.map(|(view, _)| Texels::of(view)));
        self.work.texels += eraser.put_back(&mut render, resting, old.copied());
        let boxes = upload.movers().map(Movers::boxes).unwrap_or_default();
        let shades = |light: &Light, corners: &[Vec3; 8]| match &self.drawn_for {
            DrawnFor::These(seen) => seen.may_be_shaded(light, corners),
            DrawnFor::Nobody | DrawnFor::All => true,
        };
        // The boxes of what each light may shade with.
        let casters = |light: &Light| -> Vec<Option<&[Vec3; 8]>> {
            boxes.iter().map(|corners| corners.as_ref().filter(|corners| shades(light, corners))).collect()
        };
        let casters: Vec<Vec<Option<&[Vec3; 8]>>> = self.lights.iter().map(casters).collect();
        let shown = boxes.iter().flatten().count();
        let leaves_out = casters.iter().any(|of_light| of_light.iter().flatten().count() < shown);
        let views = self.lights_views.iter().zip(&self.groups).zip(rests).zip(&self.of_file.lights);
        for ((((view, (_, group)), rests), light), drawn) in views.zip(drawn) {
            drawn.clear();
            if !rests {
                drawn.push(Texels::of(view));
                if !again {
                    look(&mut render, view);
                    add(&mut self.work, pass.draw(&mut render, group, upload, (Part::All, Faces::Both)));
                }
                continue;
            }
            let casters = casters.get(*light as usize).into_iter().flatten();
            let covered: Vec<Option<Texels>> =
                casters.map(|corners| corners.and_then(|corners| covered(view, corners))).collect();
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
        leaves_out
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
