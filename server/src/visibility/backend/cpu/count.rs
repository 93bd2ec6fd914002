//! Counting what traversal does, at no cost when nobody asks.

/// Told what traversal does.
pub(super) trait Counter: Default + Send {
    /// A group began its way down.
    fn group(&mut self) {}
    /// A group visited a node.
    fn node(&mut self) {}
    /// A group visited a leaf with this many triangles.
    fn leaf(&mut self, _triangles: u32) {}
    /// A triangle was tested against this many packets.
    fn packets(&mut self, _packets: u32) {}
    /// A packet had rays inside a triangle's edges.
    fn candidate(&mut self) {}
    /// So many rays asked a triangle's alpha whether it is there.
    fn alpha(&mut self, _rays: u32) {}
}

/// Counts nothing.
#[derive(Debug, Default)]
pub(super) struct Silent;

impl Counter for Silent {}

/// What traversal did, summed over groups of up to 64 rays.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Groups traced.
    pub groups: u64,
    /// Nodes that groups visited; each tests eight boxes.
    pub nodes: u64,
    /// Leaves that groups visited; each prepares up to eight triangles.
    pub leaves: u64,
    /// Triangles in those leaves.
    pub triangles: u64,
    /// Triangles that some packet had to be tested against.
    pub tested_triangles: u64,
    /// Tests of a triangle against a packet of eight rays.
    pub packet_tests: u64,
    /// Those with a ray inside the triangle's edges.
    pub candidates: u64,
    /// Rays that asked a triangle's alpha.
    pub alpha_tests: u64,
}

impl Work {
    /// Adds another's counts.
    pub fn add(&mut self, other: &Self) {
        self.groups += other.groups;
        self.nodes += other.nodes;
        self.leaves += other.leaves;
        self.triangles += other.triangles;
        self.tested_triangles += other.tested_triangles;
        self.packet_tests += other.packet_tests;
        self.candidates += other.candidates;
        self.alpha_tests += other.alpha_tests;
    }
}

impl Counter for Work {
    fn group(&mut self) {
        self.groups += 1;
    }
    fn node(&mut self) {
        self.nodes += 1;
    }
    fn leaf(&mut self, triangles: u32) {
        self.leaves += 1;
        self.triangles += u64::from(triangles);
    }
    fn packets(&mut self, packets: u32) {
        self.tested_triangles += u64::from(packets > 0);
        self.packet_tests += u64::from(packets);
    }
    fn candidate(&mut self) {
        self.candidates += 1;
    }
    fn alpha(&mut self, rays: u32) {
        self.alpha_tests += u64::from(rays);
    }
}
