//! The corners of what moves: swapped where a piece is inside out, empty where it is hidden.

use gnomon_scene::{Animation, Moment, Placement, Scene};
use wgpu::util::DeviceExt as _;

#[derive(Debug)]
pub(super) struct CornerWriter {
    runs: Vec<Run>,
    /// How the corners are in the buffer, once all that was encoded has run: one for each piece.
    written: Vec<Corners>,
}

/// Triangles of one piece that follow each other.
#[derive(Debug)]
struct Run {
    first: u32,
    piece: usize,
    corners: Vec<[u32; 3]>,
}

/// How the corners of a piece's triangles are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Corners {
    AsInFile,
    Turned,
    /// Nothing is drawn.
    Hidden,
}

impl Corners {
    fn of(placement: Option<&Placement>) -> Self {
        match placement {
            None => Self::Hidden,
            Some(placement) if placement.turned => Self::Turned,
            Some(_) => Self::AsInFile,
        }
    }

    fn arrange(self, [a, b, c]: [u32; 3]) -> [u32; 3] {
        match self {
            Self::AsInFile => [a, b, c],
            Self::Turned => [a, c, b],
            Self::Hidden => [a; 3],
        }
    }
}

impl CornerWriter {
    pub(super) fn new(scene: &Scene, animation: &Animation) -> Self {
        let mut runs: Vec<Run> = Vec::new();
        for (number, corners) in (0..).zip(&scene.triangles) {
            let Some(piece) = animation.piece_of(corners[0]) else { continue };
            match runs.last_mut() {
                Some(last) if last.piece == piece && last.first as usize + last.corners.len() == number as usize => {
                    last.corners.push(*corners);
                }
                _ => runs.push(Run { first: number, piece, corners: vec![*corners] }),
            }
        }
        Self { runs, written: vec![Corners::AsInFile; animation.pieces.len()] }
    }

    /// Writes what the buffer of indices lacks of a moment, before what `encoder` does next. Returns the bytes that
    /// takes.
    pub(super) fn write(
        &mut self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        indices: &wgpu::Buffer,
        moment: &Moment,
    ) -> u64 {
        let wanted: Vec<Corners> = moment.pieces.iter().map(|placement| Corners::of(placement.as_ref())).collect();
        let mut bytes = 0;
        for run in self.runs.iter().filter(|_| wanted != self.written) {
            let (before, after) = (self.written.get(run.piece), wanted.get(run.piece));
            let Some(corners) = after.filter(|_| before != after) else { continue };
            let triangles: Vec<[u32; 3]> = run.corners.iter().map(|of_run| corners.arrange(*of_run)).collect();
            let staged = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("corners of what moves"),
                contents: bytemuck::cast_slice(&triangles),
                usage: wgpu::BufferUsages::COPY_SRC,
            });
            let offset = u64::from(run.first) * size_of::<[u32; 3]>() as u64;
            encoder.copy_buffer_to_buffer(&staged, 0, indices, offset, staged.size());
            bytes += staged.size();
        }
        self.written = wanted;
        bytes
    }
}
