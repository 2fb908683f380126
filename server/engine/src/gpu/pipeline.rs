//! Steps compiled, each once.

use std::{
    fmt::Write as _,
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

use lumicast_shaders::{Constant, Step};

use super::{Binding, GpuError, Layout, Session, session::locked};

/// What tells pipelines apart: the step, its constants as text, its groups.
pub(super) type PipelineKey = (&'static str, String, Vec<Vec<Binding>>);

/// A compiled step.
#[derive(Debug)]
pub struct Pipeline {
    pub(super) pipeline: wgpu::ComputePipeline,
    pub(super) generation: u64,
    step: &'static str,
    invocation_count: u64,
    workgroups_max: u64,
}

impl Pipeline {
    /// The step's name.
    pub fn step(&self) -> &'static str {
        self.step
    }

    /// Workgroups along x, y, z that hold at least `invocation_count` invocations.
    ///
    /// Along x as long as one dimension holds them, then in rows of y: a step finds its index by
    /// `(workgroup_id.y * num_workgroups.x + workgroup_id.x) * workgroup_size + local_invocation_index`
    /// and leaves out what lies beyond the count.
    pub fn workgroups(&self, invocation_count: u64) -> [u32; 3] {
        let count = invocation_count.div_ceil(self.invocation_count);
        let rows = count.div_ceil(self.workgroups_max).max(1);
        // More rows than a dimension holds are the device's to refuse: 65,535² workgroups exceed every buffer.
        [count.div_ceil(rows) as u32, rows.min(u64::from(u32::MAX)) as u32, 1]
    }
}

impl Session {
    /// A step compiled with these constants for these groups, the first being group 0; compiled at the first call.
    ///
    /// Errors: [`GpuError::Shader`], [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn pipeline(
        &self,
        step: &Step,
        constants: &[(&str, Constant)],
        layouts: &[&Layout],
    ) -> Result<Arc<Pipeline>, GpuError> {
        self.check()?;
        let mut prepended = String::new();
        for (name, value) in constants {
            // Writing to a text cannot fail.
            let _ = write!(prepended, "{}", value.declaration(name));
        }
        let groups = layouts.iter().map(|layout| layout.bindings.clone()).collect();
        let key: PipelineKey = (step.name, prepended, groups);
        // Held while compiling, so that two threads do not compile the same.
        let mut pipelines = locked(&self.pipelines);
        if let Some(pipeline) = pipelines.get(&key) {
            return Ok(Arc::clone(pipeline));
        }
        for layout in layouts {
            self.own(layout.generation)?;
        }
        let started = Instant::now();
        let compiled = self.compile(step, constants, layouts);
        self.shader_nanoseconds.fetch_add(started.elapsed().as_nanos() as u64, Ordering::Relaxed);
        let pipeline = Arc::new(Pipeline {
            pipeline: compiled?,
            generation: self.generation(),
            step: step.name,
            invocation_count: step.workgroup_size.iter().map(|size| u64::from(*size)).product::<u64>().max(1),
            workgroups_max: u64::from(self.limits.max_compute_workgroups_per_dimension),
        });
        pipelines.insert(key, Arc::clone(&pipeline));
        Ok(pipeline)
    }

    /// Names of the steps that were compiled.
    #[cfg(test)]
    pub(crate) fn compiled(&self) -> Vec<&'static str> {
        locked(&self.pipelines).keys().map(|(step, ..)| *step).collect()
    }

    fn compile(
        &self,
        step: &Step,
        constants: &[(&str, Constant)],
        layouts: &[&Layout],
    ) -> Result<wgpu::ComputePipeline, GpuError> {
        let source = step.source(constants);
        self.checked(
            || {
                let (module, layout) = self.module_and_layout(step.name, source, layouts);
                self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                    label: Some(step.name),
                    layout: Some(&layout),
                    module: &module,
                    entry_point: Some(step.entry_point),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    cache: None,
                })
            },
            |error| GpuError::Shader { step: step.name.to_string(), what: error.to_string() },
        )
    }

    /// What every pipeline begins with.
    pub(super) fn module_and_layout(
        &self,
        name: &str,
        source: String,
        layouts: &[&Layout],
    ) -> (wgpu::ShaderModule, wgpu::PipelineLayout) {
        let label = Some(name);
        let source = wgpu::ShaderSource::Wgsl(source.into());
        let groups: Vec<_> = layouts.iter().map(|layout| Some(&layout.layout)).collect();
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label, source });
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: &groups,
            immediate_size: 0,
        });
        (module, layout)
    }
}
