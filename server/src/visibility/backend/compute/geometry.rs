//! The scene as the kernels read it: obvhs' CWBVH, and the triangles in the order of its leaves.

use glam::{Vec2, Vec3, Vec3A};
use gnomon_shaders::{
    host::{AlphaMaterial, TRAVERSAL_STACK, TRIANGLE_SINGLE_SIDED, TracedTriangle, wraps},
    scene::{AlphaMode, Material, Scene},
};
use obvhs::{
    BvhBuildParams,
    cwbvh::{CwBvh, builder::build_cwbvh_from_tris, node::CwBvhNode},
    triangle::Triangle,
};

use crate::visibility::backend::BackendError;

/// Everything that the kernels read, except the lights.
#[derive(Debug, Default)]
pub(super) struct Geometry {
    /// Nodes of the hierarchy, the root first; none when nothing stops a ray.
    pub(super) nodes: Vec<CwBvhNode>,
    /// Triangles; a leaf's follow each other.
    pub(super) triangles: Vec<TracedTriangle>,
    /// Shading normals of each triangle's corners.
    pub(super) normals: Vec<[Vec3; 3]>,
    /// Texture coordinates of the triangles with holes, three each.
    pub(super) alpha_uvs: Vec<Vec2>,
    /// Materials with holes.
    pub(super) alpha_materials: Vec<AlphaMaterial>,
    /// Their alpha pictures, one after the other.
    pub(super) alpha_texels: Vec<u8>,
}

/// What a ray finds of a material's triangles.
#[derive(Clone, Copy, PartialEq)]
enum Presence {
    Everywhere,
    Nowhere,
    /// Index into [`Geometry::alpha_materials`].
    Holes(u32),
}

impl Geometry {
    /// Builds the hierarchy over the triangles that stop rays.
    ///
    /// # Errors
    /// When the hierarchy is deeper than the kernels can follow, or there is more than 32-bit indices can name.
    pub(super) fn build(scene: &Scene) -> Result<Self, BackendError> {
        let mut geometry = Self::default();
        let presences = geometry.add_alpha(scene)?;
        let tracing = scene.tracing_triangles();
        let mut stopping = Vec::with_capacity(tracing.len());
        for draw in &scene.draws {
            let first = draw.first_triangle as usize;
            // BLEND draws lie behind the end of `tracing`.
            let triangles = tracing.get(first..first + draw.triangles as usize).unwrap_or_default();
            if presences[draw.material as usize] != Presence::Nowhere {
                stopping.extend(triangles.iter().map(|&corners| (corners, draw.material)));
            }
        }
        if stopping.is_empty() {
            return Ok(geometry);
        }
        let corner = |index: u32| Vec3A::from(scene.positions[index as usize]);
        let shapes: Vec<Triangle> =
            stopping.iter().map(|&([a, b, c], _)| Triangle { v0: corner(a), v1: corner(b), v2: corner(c) }).collect();
        let hierarchy = build_hierarchy(&shapes)?;
        for &primitive in &hierarchy.primitive_indices {
            let (corners, material) = stopping[primitive as usize];
            geometry.add_triangle(scene, corners, &scene.materials[material as usize], presences[material as usize])?;
        }
        geometry.nodes = hierarchy.nodes;
        Ok(geometry)
    }

    /// Takes up the alpha pictures of MASK materials, and says what rays find of every material.
    fn add_alpha(&mut self, scene: &Scene) -> Result<Vec<Presence>, BackendError> {
        let mut presences = Vec::with_capacity(scene.materials.len());
        for material in &scene.materials {
            presences.push(match (material.alpha, material.base_color_texture) {
                (AlphaMode::Opaque, _) => Presence::Everywhere,
                (AlphaMode::Blend, _) => Presence::Nowhere,
                (AlphaMode::Mask { cutoff }, None) if material.base_color.w >= cutoff => Presence::Everywhere,
                (AlphaMode::Mask { .. }, None) => Presence::Nowhere,
                (AlphaMode::Mask { cutoff }, Some(texture)) => {
                    let image = &scene.images[texture.image as usize];
                    let index = index_of_next("alpha materials", &self.alpha_materials)?;
                    self.alpha_materials.push(AlphaMaterial::new(
                        index_of_next("alpha texels", &self.alpha_texels)?,
                        (image.width, image.height),
                        wraps(texture.wrap_u, texture.wrap_v),
                        cutoff,
                        material.base_color.w,
                    ));
                    self.alpha_texels.extend(image.rgba.iter().skip(3).step_by(4));
                    Presence::Holes(index)
                }
            });
        }
        Ok(presences)
    }

    fn add_triangle(
        &mut self,
        scene: &Scene,
        corners: [u32; 3],
        material: &Material,
        presence: Presence,
    ) -> Result<(), BackendError> {
        let [a, b, c] = corners.map(|index| scene.positions[index as usize].to_array());
        let first_uv = index_of_next("texture coordinates", &self.alpha_uvs)?;
        let mut kind = if material.double_sided { 0 } else { TRIANGLE_SINGLE_SIDED };
        if let Presence::Holes(index) = presence {
            kind |= index + 1;
            self.alpha_uvs.extend(corners.map(|index| scene.uvs[index as usize]));
        }
        self.triangles.push(TracedTriangle { a, kind, b, first_uv, c, unused: 0 });
        self.normals.push(corners.map(|index| scene.normals[index as usize]));
        Ok(())
    }
}

fn index_of_next<T>(what: &str, list: &[T]) -> Result<u32, BackendError> {
    u32::try_from(list.len())
        .map_err(|_| BackendError::Setup(format!("the scene has {} {what}, more than 2^32", list.len())))
}

/// The hierarchy over these triangles, as the kernels follow it.
pub(super) fn build_hierarchy(shapes: &[Triangle]) -> Result<CwBvh, BackendError> {
    // Three triangles are the most that a leaf of this format can name.
    let parameters = BvhBuildParams { max_prims_per_leaf: 3, ..BvhBuildParams::medium_build() };
    let hierarchy = build_cwbvh_from_tris(shapes, parameters, &mut std::time::Duration::default());
    let depth = depth(&hierarchy.nodes);
    if depth > TRAVERSAL_STACK {
        return Err(BackendError::TooDeep { depth, limit: TRAVERSAL_STACK });
    }
    Ok(hierarchy)
}

/// Levels of nodes, which is as many entries as a traversal's stack can come to hold.
fn depth(nodes: &[CwBvhNode]) -> u32 {
    let mut deepest = 0;
    let mut waiting = vec![(0_usize, 1_u32)];
    while let Some((index, level)) = waiting.pop() {
        let Some(node) = nodes.get(index) else { continue };
        deepest = deepest.max(level);
        let first = node.child_base_idx as usize;
        let children = node.imask.count_ones() as usize;
        waiting.extend((first..first + children).map(|child| (child, level + 1)));
    }
    deepest
}
