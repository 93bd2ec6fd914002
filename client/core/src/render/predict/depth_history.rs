//! The depth of the latest pictures. It tells whether a point was visible in the view that a mask was traced for.
//!
//! The G-buffer pass draws each picture's depth into the next texture of a ring, so keeping it costs no time and 4
//! bytes a pixel and picture. [`BUDGET_BYTES`] limits the ring. If a mask is older than the ring, or its view was never
//! drawn (a guard band, a pose predicted by the server), its depth is drawn again ([`super::depth_pass`]).

use crate::{
    camera::Viewpoint,
    render::targets::{DEPTH, texture},
};

/// 64 pictures of 640×360, 16 of 1920×1080.
const BUDGET_BYTES: u64 = 133 << 20;

/// Minimum, whatever the memory: the current picture, and three with masks under way.
const LEAST_PICTURES: u64 = 4;

const MOST_PICTURES: u64 = 64;

#[derive(Debug)]
pub(crate) struct DepthHistory {
    slots: Vec<Slot>,
    current: usize,
}

#[derive(Debug)]
struct Slot {
    view: wgpu::TextureView,
    /// What the depth that the texture holds is of.
    seen: Option<Viewpoint>,
}

impl DepthHistory {
    pub(crate) fn new(device: &wgpu::Device, width: u32, height: u32) -> Self {
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        let slot = |_| Slot {
            view: texture(device, "depth", (width, height), DEPTH, usage | wgpu::TextureUsages::COPY_SRC)
                .create_view(&wgpu::TextureViewDescriptor::default()),
            seen: None,
        };
        Self { slots: (0..pictures(width, height)).map(slot).collect(), current: 0 }
    }

    /// The textures in ring order.
    pub(crate) fn views(&self) -> impl Iterator<Item = &wgpu::TextureView> {
        self.slots.iter().map(|slot| &slot.view)
    }

    /// The newest picture's depth.
    pub(crate) fn view(&self) -> &wgpu::TextureView {
        &self.slots[self.current].view
    }

    pub(crate) fn view_at(&self, place: usize) -> &wgpu::TextureView {
        &self.slots[place].view
    }

    /// Index of the newest picture in the ring.
    pub(crate) fn current(&self) -> usize {
        self.current
    }

    /// Advances to the texture for a new picture.
    pub(crate) fn begin(&mut self, seen: &Viewpoint) {
        self.current = (self.current + 1) % self.slots.len();
        self.slots[self.current].seen = Some(seen.clone());
    }

    /// Returns the index of the picture drawn for exactly this camera and time, if it is still in the ring.
    pub(crate) fn find(&self, seen: &Viewpoint) -> Option<usize> {
        self.slots.iter().position(|slot| slot.seen.as_ref() == Some(seen))
    }
}

fn pictures(width: u32, height: u32) -> u64 {
    (BUDGET_BYTES / (u64::from(width) * u64::from(height) * 4)).clamp(LEAST_PICTURES, MOST_PICTURES)
}

#[cfg(test)]
mod tests {
    use gnomon_scene::camera::Camera;

    use super::*;
    use crate::render::testing::{camera, gpu};

    #[test]
    fn the_budget_limits_the_ring() {
        assert_eq!(pictures(640, 360), 64);
        assert_eq!(pictures(1920, 1080), 16);
        assert_eq!(pictures(3840, 2160), 4);
        assert_eq!(pictures(1, 1), 64);
    }

    #[test]
    fn pictures_are_found_until_they_are_overwritten() {
        let gpu = gpu();
        let mut history = DepthHistory::new(&gpu.device, 3840, 2160);
        let at = |frame: u32| {
            let camera = Camera { yfov_rad: 1.0 + f64::from(frame / 2) * 0.01, ..camera(3840, 2160) };
            // Every second one differs in its time alone.
            Viewpoint { camera, scene: f64::from(frame).into() }
        };
        for frame in 0..20 {
            history.begin(&at(frame));
            assert_eq!(history.find(&at(frame)), Some(history.current()));
        }
        for (frame, there) in [(19, true), (16, true), (15, false), (3, false)] {
            assert_eq!(history.find(&at(frame)).is_some(), there, "{frame}");
        }
    }
}
