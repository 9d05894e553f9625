//! Kernels: their source, their pipelines, and the buffers that they are bound to.

use crate::Gpu;
use heliosplat::optim::adam::{BETA2, EPSILON};
use heliosplat::splat::project::ALPHA_MIN;
use heliosplat::train::{GRADIENT_MAX, LAMBDA_SSIM, PHOTOMETRIC_WEIGHT};

/// The files of a kernel: those that it shares, then its own.
macro_rules! source {
    ($($file:literal)*) => { [include_str!("wgsl/step.wgsl"), $(include_str!(concat!("wgsl/", $file, ".wgsl"))),*].concat() };
}

/// Source of every kernel, by name.
pub(crate) fn sources() -> Vec<(&'static str, String)> {
    vec![
        ("project", source!("gaussian" "whitened" "project")),
        ("features", source!("gaussian" "harmonics" "features")),
        ("sort_count", source!("sort" "sort_count")),
        ("sort_move", source!("sort" "sort_move")),
        ("scan", source!("scan")),
        ("count", source!("splat" "count")),
        ("emit", source!("splat" "emit")),
        ("ranges", source!("ranges")),
        ("rasterise", source!("splat" "rasterise")),
        ("compose", source!("compose")),
        ("ssim", source!("window" "truth" "ssim")),
        ("ssim_backward", source!("window" "truth" "ssim_backward")),
        ("losses", source!("losses")),
        ("compose_backward", source!("compose_backward")),
        ("rasterise_backward", source!("splat" "rasterise_backward")),
        ("gather", source!("gather")),
        ("features_backward", source!("gaussian" "harmonics" "features_backward")),
        ("project_backward", source!("gaussian" "whitened" "project_backward")),
        ("update", source!("update")),
        ("statistics", source!("statistics")),
    ]
}

/// The engine's constants, as declarations of WGSL.
fn constants() -> String {
    let all = [
        ("ALPHA_MIN", ALPHA_MIN),
        ("BETA2", BETA2),
        ("EPSILON", EPSILON),
        ("GRADIENT_MAX", GRADIENT_MAX),
        ("LAMBDA", LAMBDA_SSIM),
        ("PHOTOMETRIC_WEIGHT", PHOTOMETRIC_WEIGHT),
    ];
    all.map(|(name, value)| format!("const {name}: f32 = {value:e};\n"))
        .concat()
}

/// A compiled kernel.
pub(crate) struct Kernel {
    pipeline: wgpu::ComputePipeline,
    /// Number and name of each binding.
    bindings: Vec<(u32, String)>,
}

impl Kernel {
    /// Compiles a kernel.
    pub(crate) fn new(gpu: &Gpu, name: &str, source: &str) -> Self {
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(name),
            source: wgpu::ShaderSource::Wgsl((constants() + source).into()),
        });
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        Self {
            pipeline,
            bindings: bindings(source),
        }
    }

    /// Binds the buffers that `named` finds by the names in the source.
    pub(crate) fn bind<'b>(&self, gpu: &Gpu, named: impl Fn(&str) -> &'b wgpu::Buffer) -> Bound {
        let entries: Vec<wgpu::BindGroupEntry> = self
            .bindings
            .iter()
            .map(|(binding, name)| wgpu::BindGroupEntry {
                binding: *binding,
                resource: named(name).as_entire_binding(),
            })
            .collect();
        Bound {
            pipeline: self.pipeline.clone(),
            group: gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &self.pipeline.get_bind_group_layout(0),
                entries: &entries,
            }),
        }
    }
}

/// A kernel with its buffers.
pub(crate) struct Bound {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
}

impl Bound {
    /// Runs the kernel on `groups` workgroups.
    pub(crate) fn run(&self, pass: &mut wgpu::ComputePass, [x, y, z]: [u32; 3]) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.dispatch_workgroups(x, y, z);
    }
}

/// The bindings that a source declares, each on a line: `@group(0) @binding(N) var<…> name: …`.
fn bindings(source: &str) -> Vec<(u32, String)> {
    let declared = source.lines().filter_map(|line| {
        let rest = line.strip_prefix("@group(0) @binding(")?;
        let (number, rest) = rest.split_once(')')?;
        let (name, _) = rest.split_once('>')?.1.split_once(':')?;
        Some((number.parse().ok()?, name.trim().to_owned()))
    });
    declared.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bindings_are_numbered_in_their_order() {
        for (name, source) in sources() {
            let found = bindings(&source);
            assert!(found.iter().map(|(n, _)| *n).eq(0..found.len() as u32), "{name}");
            assert_eq!(found.len(), source.matches("@binding").count(), "{name}");
        }
    }
}
