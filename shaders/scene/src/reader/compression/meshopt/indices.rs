//! The codecs TRIANGLES and INDICES.

use super::input::{Input, unzigzag, version};

const TRIANGLES_HEADER: u8 = 0xe0;
const SEQUENCE_HEADER: u8 = 0xd0;
const NEWEST: u8 = 1;
/// The table at the end of triangles, and the zeros at the end of a sequence.
const TRIANGLES_TAIL: usize = 16;
const SEQUENCE_TAIL: usize = 4;

/// The last sixteen values.
struct Recent<T> {
    values: [T; 16],
    next: usize,
}

impl<T: Copy> Recent<T> {
    fn new(value: T) -> Self {
        Self { values: [value; 16], next: 0 }
    }

    fn push(&mut self, value: T) {
        self.values[self.next % 16] = value;
        self.next = (self.next + 1) % 16;
    }

    /// Writes a value over the oldest one, and takes it for new only if `keep`. Encoders do the same.
    fn push_if(&mut self, keep: bool, value: T) {
        self.values[self.next % 16] = value;
        self.next = (self.next + usize::from(keep)) % 16;
    }

    /// The value pushed `back` pushes ago; 1 is the last.
    fn ago(&self, back: u8) -> T {
        self.values[(self.next + 16 - usize::from(back)) % 16]
    }
}

/// Decodes triangles of `count` corners.
/// Errors if the data are too short or too long, or of another codec or a later version.
pub(super) fn triangles(data: &[u8], count: usize) -> Result<Vec<u32>, &'static str> {
    let version = version(data, TRIANGLES_HEADER, NEWEST)?;
    let codes_end = 1 + count / 3;
    let Some(end) = data.len().checked_sub(TRIANGLES_TAIL).filter(|end| *end >= codes_end) else {
        return Err("it has fewer bytes than triangles");
    };
    let (codes, table) = (data.get(1..codes_end).unwrap_or_default(), data.get(end..).unwrap_or_default());
    let mut state = Triangles {
        input: Input { data, at: codes_end },
        edges: Recent::new([u32::MAX; 2]),
        vertices: Recent::new(u32::MAX),
        next: 0,
        last: 0,
    };
    let most_recent = if version == 0 { 15 } else { 13 };
    let mut out = Vec::with_capacity(codes.len() * 3);
    for code in codes {
        out.extend(match *code {
            0..0xf0 => state.at_edge(*code, most_recent, end)?,
            0xf0..0xfe => state.at_new_corner(table.get(usize::from(code & 15)).copied().unwrap_or_default()),
            0xfe.. => state.written_out(*code == 0xff, end)?,
        });
    }
    if state.input.at == end { Ok(out) } else { Err("its length does not fit its count") }
}

struct Triangles<'a> {
    input: Input<'a>,
    edges: Recent<[u32; 2]>,
    vertices: Recent<u32>,
    /// The lowest index that has not appeared.
    next: u32,
    /// The last index that was written out.
    last: u32,
}

impl Triangles<'_> {
    /// A triangle at a recent edge; its third corner is new, recent or written out.
    fn at_edge(&mut self, code: u8, most_recent: u8, end: usize) -> Result<[u32; 3], &'static str> {
        let [a, b] = self.edges.ago((code >> 4) + 1);
        let corner = code & 15;
        let c = if corner < most_recent {
            let c = if corner == 0 { self.next() } else { self.vertices.ago(corner + 1) };
            self.vertices.push_if(corner == 0, c);
            c
        } else {
            if self.input.at > end {
                return Err("it is cut");
            }
            self.last = match corner {
                13 => self.last.wrapping_sub(1),
                14 => self.last.wrapping_add(1),
                _ => self.input.index(self.last)?,
            };
            self.vertices.push(self.last);
            self.last
        };
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        Ok([a, b, c])
    }

    /// A triangle whose first corner is new and whose others are new or recent.
    fn at_new_corner(&mut self, code: u8) -> [u32; 3] {
        let (second, third) = (code >> 4, code & 15);
        let a = self.next();
        let b = if second == 0 { self.next() } else { self.vertices.ago(second) };
        let c = if third == 0 { self.next() } else { self.vertices.ago(third) };
        self.vertices.push(a);
        self.vertices.push_if(second == 0, b);
        self.vertices.push_if(third == 0, c);
        self.push_edges([a, b, c])
    }

    /// A triangle with a code of its own; any corner may be written out.
    fn written_out(&mut self, first_too: bool, end: usize) -> Result<[u32; 3], &'static str> {
        if self.input.at > end {
            return Err("it is cut");
        }
        let code = self.input.byte()?;
        if code == 0 {
            self.next = 0;
        }
        let (second, third) = (code >> 4, code & 15);
        let mut a = if first_too { 0 } else { self.next() };
        let mut b = if second == 0 { self.next() } else { self.vertices.ago(second) };
        let mut c = if third == 0 { self.next() } else { self.vertices.ago(third) };
        for (corner, written) in [(&mut a, first_too), (&mut b, second == 15), (&mut c, third == 15)] {
            if written {
                self.last = self.input.index(self.last)?;
                *corner = self.last;
            }
        }
        self.vertices.push(a);
        self.vertices.push_if(matches!(second, 0 | 15), b);
        self.vertices.push_if(matches!(third, 0 | 15), c);
        Ok(self.push_edges([a, b, c]))
    }

    fn next(&mut self) -> u32 {
        let next = self.next;
        self.next = next.wrapping_add(1);
        next
    }

    fn push_edges(&mut self, [a, b, c]: [u32; 3]) -> [u32; 3] {
        self.edges.push([b, a]);
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        [a, b, c]
    }
}

/// Decodes `count` indices in any order.
/// Errors if the data are too short or too long, or of another codec or a later version.
pub(super) fn sequence(data: &[u8], count: usize) -> Result<Vec<u32>, &'static str> {
    version(data, SEQUENCE_HEADER, NEWEST)?;
    let Some(end) = data.len().checked_sub(SEQUENCE_TAIL).filter(|end| *end > count) else {
        return Err("it has fewer bytes than indices");
    };
    let mut input = Input { data, at: 1 };
    // Two values that differences start from; the lowest bit chooses.
    let mut last = [0_u32; 2];
    let mut out = Vec::with_capacity(count);
    for _ in 0..count {
        if input.at >= end {
            return Err("it is cut");
        }
        let value = input.varint()?;
        let last = &mut last[(value & 1) as usize];
        *last = last.wrapping_add(unzigzag(value >> 1));
        out.push(*last);
    }
    if input.at == end { Ok(out) } else { Err("its length does not fit its count") }
}
