//! The scene in the kernels' format: obvhs' CWBVH, and the triangles in the order of its leaves.

use std::{collections::HashMap, ops::Range};

use glam::{Vec2, Vec3, Vec3A};
use gnomon_scene::{AlphaMode, Animation, Material, Scene, triangle_normal};
use gnomon_shaders::host::{AlphaMaterial, TRAVERSAL_STACK, TRIANGLE_SINGLE_SIDED, TracedTriangle, wraps};
use obvhs::{
    Boundable,
    bvh2::Bvh2,
    cwbvh::{CwBvh, bvh2_to_cwbvh::bvh2_to_cwbvh, node::CwBvhNode},
    triangle::Triangle,
};

use super::{kernels::Traversal, refit::most_levels};
use crate::visibility::{
    backend::BackendError,
    hierarchy::{balance::bound_depth, binary},
};

#[derive(Debug, Default)]
pub(super) struct Geometry {
    /// Nodes of the hierarchy, the root first. Empty if nothing stops rays or the adapter has its own hierarchy.
    pub(super) nodes: Vec<CwBvhNode>,
    /// The triangles of each leaf are contiguous.
    pub(super) triangles: Vec<TracedTriangle>,
    /// Shading normals of each triangle's corners, then the unit normal of its plane (zero without an area).
    pub(super) normals: Vec<[Vec3; 4]>,
    /// Texture coordinates of the triangles with holes, three each; where the alpha of vertices counts, that follows.
    pub(super) alpha_uvs: Vec<Vec2>,
    pub(super) alpha_materials: Vec<AlphaMaterial>,
    /// Alpha pictures, concatenated.
    pub(super) alpha_texels: Vec<u8>,
    /// The pieces that move, which are in none of the first three lists.
    pub(super) pieces: Vec<PieceGeometry>,
}

/// A piece in its own space. Its indices count from its own first node, triangle and vertex.
#[derive(Debug, Default)]
pub(super) struct PieceGeometry {
    /// Nodes of its hierarchy, the root first. Empty as [`Geometry::nodes`].
    pub(super) nodes: Vec<CwBvhNode>,
    /// In the order of the hierarchy's leaves.
    pub(super) triangles: Vec<PieceTriangle>,
    /// Its vertices among the animation's.
    pub(super) vertices: Range<usize>,
}

/// What of a triangle does not move.
#[derive(Debug, Clone, Copy)]
pub(super) struct PieceTriangle {
    pub(super) corners: [u32; 3],
    /// See [`TracedTriangle::kind`].
    pub(super) kind: u32,
    /// See [`TracedTriangle::first_uv`]: as in the file's pose, and with the second and third corner exchanged.
    pub(super) first_uvs: [u32; 2],
}

/// Where a material's triangles stop rays.
#[derive(Clone, Copy, PartialEq)]
enum Opacity {
    Everywhere,
    Nowhere,
    /// Where the alpha test passes: index into [`Geometry::alpha_materials`].
    ByAlpha(u32),
}

impl Geometry {
    /// Collects the triangles that stop rays, and builds the hierarchy. Errors if indices exceed 32 bits.
    pub(super) fn build(scene: &Scene, traversal: Traversal) -> Result<Self, BackendError> {
        let mut geometry = Self::default();
        let opacities = geometry.add_alpha(scene)?;
        let tracing = scene.tracing_triangles();
        let mut stopping = Vec::with_capacity(tracing.len());
        let pieces = scene.animation.as_ref().map_or(0, |animation| animation.pieces.len());
        let mut moving: Vec<Stopping> = vec![Stopping::new(); pieces];
        let piece_of = |corner: u32| scene.animation.as_ref().and_then(|animation| animation.piece_of(corner));
        for draw in &scene.draws {
            let first = draw.first_triangle as usize;
            // BLEND draws lie behind the end of `tracing`.
            let triangles = tracing.get(first..first + draw.triangles as usize).unwrap_or_default();
            if opacities[draw.material as usize] != Opacity::Nowhere {
                for &corners in triangles {
                    let list = piece_of(corners[0]).map_or(&mut stopping, |piece| &mut moving[piece]);
                    list.push((corners, draw.material));
                }
            }
        }
        let most_depth = if moving.iter().all(Vec::is_empty) { TRAVERSAL_STACK } else { TRAVERSAL_STACK - 1 };
        geometry.add_resting(scene, &stopping, &opacities, traversal, most_depth)?;
        if let Some(animation) = &scene.animation {
            let most_depth = TRAVERSAL_STACK.saturating_sub(most_levels(moving.len()));
            for ((piece, first), stopping) in animation.pieces.iter().zip(animation.first_positions()).zip(&moving) {
                let vertices = first..first + piece.vertices as usize;
                let own = Own { animation, first_vertex: piece.first_vertex, vertices };
                let piece = geometry.piece(scene, own, stopping, &opacities, traversal, most_depth)?;
                geometry.pieces.push(piece);
            }
        }
        Ok(geometry)
    }

    /// Adds the triangles that rest, and builds their hierarchy.
    fn add_resting(
        &mut self,
        scene: &Scene,
        stopping: &Stopping,
        opacities: &[Opacity],
        traversal: Traversal,
        most_depth: u32,
    ) -> Result<(), BackendError> {
        if stopping.is_empty() {
            return Ok(());
        }
        if traversal == Traversal::RayQuery {
            for &(corners, material) in stopping {
                let (surface, opacity) = (&scene.materials[material as usize], opacities[material as usize]);
                self.add_triangle(scene, corners, surface, opacity)?;
            }
            return Ok(());
        }
        let hierarchy =
            build_hierarchy(&shapes(&scene.positions, stopping.iter().map(|(corners, _)| *corners)), most_depth);
        for &primitive in &hierarchy.primitive_indices {
            let (corners, material) = stopping[primitive as usize];
            self.add_triangle(scene, corners, &scene.materials[material as usize], opacities[material as usize])?;
        }
        self.nodes = hierarchy.nodes;
        Ok(())
    }

    /// Adds what a piece needs for alpha, and builds its hierarchy in its own space.
    fn piece(
        &mut self,
        scene: &Scene,
        own: Own<'_>,
        stopping: &Stopping,
        opacities: &[Opacity],
        traversal: Traversal,
        most_depth: u32,
    ) -> Result<PieceGeometry, BackendError> {
        let Own { animation, first_vertex, vertices } = own;
        let within = |corners: [u32; 3]| corners.map(|corner| corner - first_vertex);
        let (order, nodes) = match traversal {
            Traversal::Hierarchy if !stopping.is_empty() => {
                let positions = animation.positions.get(vertices.clone()).unwrap_or_default();
                let shapes = shapes(positions, stopping.iter().map(|(corners, _)| within(*corners)));
                let hierarchy = build_hierarchy(&shapes, most_depth);
                (hierarchy.primitive_indices, hierarchy.nodes)
            }
            _ => ((0..).take(stopping.len()).collect(), Vec::new()),
        };
        let mut triangles = Vec::with_capacity(stopping.len());
        for at in order {
            let (corners, material) = stopping[at as usize];
            let (surface, opacity) = (&scene.materials[material as usize], opacities[material as usize]);
            let (kind, first_uv) = self.add_alpha_of(scene, corners, surface, opacity)?;
            let [a, b, c] = corners;
            let turned_uv = match opacity {
                Opacity::ByAlpha(_) => self.add_alpha_of(scene, [a, c, b], surface, opacity)?.1,
                Opacity::Everywhere | Opacity::Nowhere => first_uv,
            };
            triangles.push(PieceTriangle { corners: within(corners), kind, first_uvs: [first_uv, turned_uv] });
        }
        Ok(PieceGeometry { nodes, triangles, vertices })
    }

    /// Memory that only triangles with holes need.
    pub(super) fn alpha_bytes(&self) -> u64 {
        let bytes = size_of_val(&*self.alpha_materials) + self.alpha_texels.len() + size_of_val(&*self.alpha_uvs);
        bytes as u64
    }

    /// Adds the alpha pictures of MASK materials. Returns the opacity of every material.
    fn add_alpha(&mut self, scene: &Scene) -> Result<Vec<Opacity>, BackendError> {
        let mut opacities = Vec::with_capacity(scene.materials.len());
        // Materials share pictures, so each image's texels are stored once.
        let mut first_texels = HashMap::new();
        let vertex_alpha = scene.vertex_alpha_materials();
        for (place, material) in scene.materials.iter().enumerate() {
            let vertex_alpha = vertex_alpha.get(place).is_some_and(|counts| *counts);
            opacities.push(match (material.alpha, material.base_color_texture) {
                (AlphaMode::Opaque, _) => Opacity::Everywhere,
                (AlphaMode::Blend, _) => Opacity::Nowhere,
                (AlphaMode::Mask { cutoff }, None) if vertex_alpha => {
                    let index = index_of_next("alpha materials", &self.alpha_materials)?;
                    self.alpha_materials.push(AlphaMaterial::new(cutoff, material.base_color.w, true));
                    Opacity::ByAlpha(index)
                }
                (AlphaMode::Mask { cutoff }, None) if material.base_color.w >= cutoff => Opacity::Everywhere,
                (AlphaMode::Mask { .. }, None) => Opacity::Nowhere,
                (AlphaMode::Mask { cutoff }, Some(texture)) => {
                    let image = &scene.images[texture.image as usize];
                    if image.rgba.len() as u64 != 4 * u64::from(image.width) * u64::from(image.height) {
                        return Err(BackendError::Alpha { material: index_of_next("materials", &opacities)? });
                    }
                    let index = index_of_next("alpha materials", &self.alpha_materials)?;
                    let first_texel = match first_texels.get(&texture.image) {
                        Some(first) => *first,
                        None => {
                            let first = index_of_next("alpha texels", &self.alpha_texels)?;
                            self.alpha_texels.extend(image.rgba.iter().skip(3).step_by(4));
                            *first_texels.entry(texture.image).or_insert(first)
                        }
                    };
                    let (size, wraps) = ((image.width, image.height), wraps(texture.wrap_u, texture.wrap_v));
                    let without = AlphaMaterial::new(cutoff, material.base_color.w, vertex_alpha);
                    self.alpha_materials.push(without.with_picture(first_texel, size, wraps));
                    Opacity::ByAlpha(index)
                }
            });
        }
        Ok(opacities)
    }

    fn add_triangle(
        &mut self,
        scene: &Scene,
        corners: [u32; 3],
        material: &Material,
        opacity: Opacity,
    ) -> Result<(), BackendError> {
        let (kind, first_uv) = self.add_alpha_of(scene, corners, material, opacity)?;
        let [a, b, c] = corners.map(|index| scene.positions[index as usize].to_array());
        self.triangles.push(TracedTriangle { a, kind, b, first_uv, c, unused: 0 });
        let [na, nb, nc] = corners.map(|index| scene.normals[index as usize]);
        self.normals.push([na, nb, nc, plane_normal([a, b, c].map(Vec3::from_array))]);
        Ok(())
    }

    /// Adds what the alpha test of a triangle needs. Returns its [`TracedTriangle::kind`] and `first_uv`.
    fn add_alpha_of(
        &mut self,
        scene: &Scene,
        corners: [u32; 3],
        material: &Material,
        opacity: Opacity,
    ) -> Result<(u32, u32), BackendError> {
        let first_uv = index_of_next("texture coordinates", &self.alpha_uvs)?;
        let mut kind = if material.double_sided { 0 } else { TRIANGLE_SINGLE_SIDED };
        if let Opacity::ByAlpha(index) = opacity {
            kind |= index + 1;
            self.alpha_uvs.extend(corners.map(|index| scene.uvs[index as usize]));
            if self.alpha_materials.get(index as usize).is_some_and(|material| material.vertex_alpha != 0) {
                let [a, b, c] = corners.map(|index| scene.vertex_alpha(index));
                self.alpha_uvs.extend([Vec2::new(a, b), Vec2::new(c, 0.0)]);
            }
        }
        Ok((kind, first_uv))
    }
}

/// Triangles that stop rays, by their corners, each with its material.
type Stopping = Vec<([u32; 3], u32)>;

/// Where a piece's vertices are.
struct Own<'a> {
    animation: &'a Animation,
    /// Its first vertex among the scene's.
    first_vertex: u32,
    /// Its vertices among the animation's.
    vertices: Range<usize>,
}

/// The unit normal of a triangle's plane, zero for one without an area.
pub(super) fn plane_normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    triangle_normal(a, b, c).unwrap_or_default().as_vec3()
}

fn shapes(positions: &[Vec3], triangles: impl Iterator<Item = [u32; 3]>) -> Vec<Triangle> {
    let corner = |index: u32| Vec3A::from(positions[index as usize]);
    triangles.map(|[a, b, c]| Triangle { v0: corner(a), v1: corner(b), v2: corner(c) }).collect()
}

fn index_of_next<T>(what: &str, list: &[T]) -> Result<u32, BackendError> {
    u32::try_from(list.len())
        .map_err(|_| BackendError::Setup(format!("the scene has {} {what}, more than 2^32", list.len())))
}

/// Builds the hierarchy over these triangles in the kernels' format, of at most so many levels.
pub(super) fn build_hierarchy(shapes: &[Triangle], most_depth: u32) -> CwBvh {
    let mut binary = binary::build(&shapes.iter().map(Boundable::aabb).collect::<Vec<_>>());
    // A leaf of this format holds at most three triangles.
    let compress = |binary: &Bvh2| bvh2_to_cwbvh(binary, 3, true, false);
    let hierarchy = compress(&binary);
    if depth(&hierarchy.nodes) <= most_depth {
        return hierarchy;
    }
    // Every level of wide nodes can push one entry on the stack, and spans at least one level of binary nodes.
    bound_depth(&mut binary, most_depth);
    compress(&binary)
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::test_scenes::{DOUBLE_SIDED, LEAF, TestScene, room};

    #[test]
    fn no_hierarchy_is_deeper_than_the_stack() {
        // Each triangle is as far from the last as the last is large, so the builder makes a chain.
        let chain: Vec<Triangle> = (0..120)
            .flat_map(|i| {
                let v0 = Vec3A::new(1.0, 0.4, -0.7) * 2.0_f32.powi(i - 60);
                let side = v0.length() * 0.1;
                [Vec3A::Y, Vec3A::Z].map(|up| Triangle { v0, v1: v0 + Vec3A::X * side, v2: v0 + up * side })
            })
            .collect();
        let hierarchy = build_hierarchy(&chain, TRAVERSAL_STACK);
        assert!(depth(&hierarchy.nodes) <= TRAVERSAL_STACK);
        let mut named = hierarchy.primitive_indices;
        named.sort_unstable();
        assert_eq!(named, (0..240).collect::<Vec<_>>());
    }

    #[test]
    fn every_triangle_that_stops_rays_is_listed_once_with_its_own_corners() {
        let scene = room();
        let geometry = Geometry::build(&scene, Traversal::Hierarchy).unwrap();
        let key = |corners: [[f32; 3]; 3]| corners.map(|corner| corner.map(f32::to_bits));
        let mut built: Vec<_> = geometry.triangles.iter().map(|t| key([t.a, t.b, t.c])).collect();
        let mut expected: Vec<_> = scene
            .tracing_triangles()
            .iter()
            .map(|corners| key(corners.map(|index| scene.positions[index as usize].to_array())))
            .collect();
        built.sort_unstable();
        expected.sort_unstable();
        assert_eq!(built, expected);
        assert_eq!(geometry.normals.len(), built.len());
        // In this scene each leaf has two triangles, and only they have holes.
        let with_holes = geometry.triangles.iter().filter(|t| t.kind & !TRIANGLE_SINGLE_SIDED != 0).count();
        assert_eq!((with_holes, geometry.alpha_uvs.len(), geometry.alpha_texels.len()), (2, 6, 16 * 12));
    }

    #[test]
    fn materials_share_the_texels_of_their_picture() {
        let mut scene = room();
        let mut other = scene.materials[LEAF as usize].clone();
        other.alpha = AlphaMode::Mask { cutoff: 0.25 };
        scene.materials.push(other);
        let geometry = Geometry::build(&scene, Traversal::Hierarchy).unwrap();
        let [first, second] = geometry.alpha_materials[..] else { panic!("{:?}", geometry.alpha_materials) };
        assert_eq!((first.first_texel, second.first_texel), (0, 0));
        assert_ne!(first.cutoff.to_bits(), second.cutoff.to_bits());
        assert_eq!(geometry.alpha_texels.len(), 16 * 12);
    }

    #[test]
    fn mask_materials_without_a_picture_stop_all_rays_or_none() {
        let mut scene = TestScene::default()
            .quad(DOUBLE_SIDED, Vec3::ZERO, Vec3::X, Vec3::Y)
            .quad(LEAF, Vec3::Z, Vec3::X, Vec3::Y)
            .point(Vec3::ONE)
            .build();
        scene.materials[LEAF as usize].base_color_texture = None;
        for (factor, triangles) in [(0.5, 4), (0.49, 2)] {
            scene.materials[LEAF as usize].base_color.w = factor;
            let geometry = Geometry::build(&scene, Traversal::Hierarchy).unwrap();
            assert_eq!((geometry.triangles.len(), geometry.alpha_materials.len()), (triangles, 0));
        }
    }
}
