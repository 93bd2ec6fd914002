// Counts of a whole frame. Twin: `host::TracedCounts`.

@group(1) @binding(2) var<storage, read_write> counts: array<atomic<u32>, 10>;

// Shadow rays. Where blocks share lists, the next three count what was found of them; the rest is traced one by one.
const COUNT_RAYS: u32 = 0u;
// No triangle may stop them.
const COUNT_PROVEN_LIT: u32 = 1u;
// One triangle was expected to stop them all.
const COUNT_PROVEN_DARK: u32 = 2u;
// Tested against a list.
const COUNT_LISTED: u32 = 3u;
// Not a count: where the next list begins. Kernels that are done with lists set it back to 0.
const LISTS_END: u32 = 4u;
// Primary rays tested against a list. The others are traced one by one.
const COUNT_PRIMARY_LISTED: u32 = 5u;
// Not counts: blocks in the queue (visibility/lists.wgsl), of primary rays and of shadow rays. The other rays' kernels
// that test lists set them back to 0.
const PRIMARY_QUEUE: u32 = 6u;
const SHADOW_QUEUE: u32 = 8u;
