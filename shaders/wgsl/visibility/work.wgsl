// What the kernels count. Places in `work`, which the kernels declare: twins in the back end's ring.

// Shadow rays that pixels want.
const WORK_WANTED: u32 = 0u;
// Nodes that rays visit: counted on demand, since counting costs time.
const WORK_NODES: u32 = 1u;
// Shadow rays traced, where not every pixel that wants one has its own.
const WORK_RAYS: u32 = 2u;

override COUNT_NODES: bool = false;

var<private> node_visits: u32;
