// Pipelines are compiled on the browser's own threads, several at once, while the page goes on. wgpu asks for each at
// once, which would keep the browser's process for graphics, and so all of its pages, busy with one after the other.

/** Pipelines that are being compiled. */
const underWay = new Set();

/** A frame that needs a pipeline had better wait for it. */
export const areCompiled = () => underWay.size === 0;

/** Stands for a pipeline. What is set before it is there is compiled at once. */
class Pipeline {
  constructor(made, make) {
    this.make = make;
    const done = made
      .then((pipeline) => {
        this.made ??= pipeline;
      })
      // The error is found again, where it is reported, when the pipeline is used.
      .catch(() => {})
      .finally(() => underWay.delete(done));
    underWay.add(done);
  }

  get() {
    return (this.made ??= this.make());
  }
}

function compileAside(kind, Pass) {
  const device = GPUDevice.prototype;
  const atOnce = device[`create${kind}Pipeline`];
  device[`create${kind}Pipeline`] = function (descriptor) {
    return new Pipeline(this[`create${kind}PipelineAsync`](descriptor), () => atOnce.call(this, descriptor));
  };
  const { setPipeline } = Pass.prototype;
  Pass.prototype.setPipeline = function (pipeline) {
    setPipeline.call(this, pipeline.get());
  };
}

if (globalThis.GPUDevice) {
  compileAside("Render", GPURenderPassEncoder);
  compileAside("Compute", GPUComputePassEncoder);
}
