//! What moves, as the file has it. Where nothing has moved it, its vertices are the host's, which those of what rests
//! meet exactly.

use gnomon_scene::{Moment, OwnVertices, Piece, Placement, Scene};
use rayon::prelude::*;
use wgpu::util::DeviceExt as _;

use super::poser::Buffers;
use crate::render::vertex::{MoreOfVertex, Vertex};

/// Vertices that a thread takes at once.
const RUN: usize = 512;

#[derive(Debug)]
pub(super) struct FilePose {
    pieces: Vec<PieceAtRest>,
}

#[derive(Debug)]
struct PieceAtRest {
    placement: Option<Placement>,
    first_vertex: u32,
    vertices: Vec<Vertex>,
    /// Empty if nothing more of them turns.
    more: Vec<MoreOfVertex>,
    /// The buffers have it elsewhere, once all that was encoded has run.
    is_away: bool,
}

impl FilePose {
    /// Puts what moves where it is in the pose of the file, in all vertices of the scene.
    pub(super) fn new(scene: &Scene, vertices: &mut [Vertex], more: &mut [MoreOfVertex]) -> Self {
        let placements = scene.moment_at_rest().pieces;
        let turns = !scene.tangents.is_empty();
        let animation = scene.animation.iter();
        let own = animation.flat_map(|animation| animation.pieces.iter().zip(animation.own_vertices()));
        let at_rest = |((piece, own), placement): ((&Piece, OwnVertices<'_>), Option<Placement>)| {
            let range = piece.first_vertex as usize..(piece.first_vertex + piece.vertices) as usize;
            let of_piece = vertices.get_mut(range.clone()).unwrap_or_default();
            let more_of_piece = more.get_mut(range).filter(|_| turns).unwrap_or_default();
            if let Some(placement) = &placement {
                of_piece.par_iter_mut().with_min_len(RUN).enumerate().for_each(|(at, vertex)| {
                    let (position, normal) = placement.vertex(&own, at);
                    *vertex = vertex.moved(position, normal);
                });
                more_of_piece.par_iter_mut().with_min_len(RUN).enumerate().for_each(|(at, vertex)| {
                    *vertex = vertex.moved(placement.tangent_of(&own, at));
                });
            }
            let (vertices, more) = (of_piece.to_vec(), more_of_piece.to_vec());
            PieceAtRest { placement, first_vertex: piece.first_vertex, vertices, more, is_away: false }
        };
        Self { pieces: own.zip(placements).map(at_rest).collect() }
    }

    /// Returns whether each piece is shown, and elsewhere.
    pub(super) fn moved(&self, moment: &Moment) -> Vec<bool> {
        let pieces = self.pieces.iter().zip(&moment.pieces);
        pieces.map(|(piece, placement)| placement.is_some() && *placement != piece.placement).collect()
    }

    /// Puts back what is shown and not `moved`, before what `encoder` does next. Returns the bytes that takes.
    pub(super) fn put_back(
        &mut self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        buffers: Buffers<'_>,
        (moment, moved): (&Moment, &[bool]),
    ) -> u64 {
        let mut bytes = 0;
        let mut write = |to: &wgpu::Buffer, first: u32, stride: usize, contents: &[u8]| {
            let usage = wgpu::BufferUsages::COPY_SRC;
            let staged = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("put back"),
                contents,
                usage,
            });
            encoder.copy_buffer_to_buffer(&staged, 0, to, u64::from(first) * stride as u64, staged.size());
            bytes += staged.size();
        };
        for ((piece, placement), moved) in self.pieces.iter_mut().zip(&moment.pieces).zip(moved) {
            let is_back = placement.is_some() && !moved;
            if is_back && piece.is_away {
                let (vertices, more) = (bytemuck::cast_slice(&piece.vertices), bytemuck::cast_slice(&piece.more));
                write(buffers.vertices, piece.first_vertex, size_of::<Vertex>(), vertices);
                if !piece.more.is_empty() {
                    write(buffers.more, piece.first_vertex, size_of::<MoreOfVertex>(), more);
                }
            }
            piece.is_away = *moved || piece.is_away && !is_back;
        }
        bytes
    }
}
