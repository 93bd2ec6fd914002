//! Counters of traversal. They cost nothing where they are unused.

pub(super) trait Counter: Default + Send {
    /// A group starts traversal.
    fn group(&mut self) {}
    /// A group visits a node.
    fn node(&mut self) {}
    /// A group visits a leaf with this many triangles.
    fn leaf(&mut self, _triangles: u32) {}
    /// A triangle is tested against this many packets.
    fn packets(&mut self, _packets: u32) {}
    /// A packet has rays inside a triangle's edges.
    fn candidate(&mut self) {}
    /// This many rays test a triangle's alpha.
    fn alpha(&mut self, _rays: u32) {}
}

#[derive(Debug, Default)]
pub(super) struct Silent;

impl Counter for Silent {}

/// Counts over groups of up to 64 rays.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TraversalStats {
    pub groups: u64,
    /// Nodes that groups visited; each tests eight boxes.
    pub nodes: u64,
    /// Leaves that groups visited; each holds up to eight triangles.
    pub leaves: u64,
    /// Triangles in those leaves.
    pub triangles: u64,
    /// Triangles that were tested against at least one packet.
    pub tested_triangles: u64,
    /// Tests of a triangle against a packet of eight rays.
    pub packet_tests: u64,
    /// Packet tests with a ray inside the triangle's edges.
    pub candidates: u64,
    /// Alpha tests of a ray with a triangle.
    pub alpha_tests: u64,
}

impl TraversalStats {
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

impl Counter for TraversalStats {
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
