//! Buffers of a device by the names that the kernels have for them.

use crate::Gpu;
use heliosplat::train::TrainError;
use std::collections::HashMap;
use std::ops::Range;

/// Buffers by name.
#[derive(Default)]
pub(crate) struct Memory {
    buffers: HashMap<&'static str, wgpu::Buffer>,
}

impl Memory {
    /// Makes buffers of these names and bytes, in place of those they had.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device has no room for one.
    pub(crate) fn make(&mut self, gpu: &Gpu, wanted: &[(&'static str, u64)]) -> Result<(), TrainError> {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
        for &(name, bytes) in wanted {
            self.buffers.remove(name);
            self.buffers.insert(name, new(gpu, name, bytes, usage)?);
        }
        gpu.check()
    }

    /// Makes the buffer of a kernel's constants.
    pub(crate) fn make_uniform(&mut self, gpu: &Gpu, name: &'static str, bytes: u64) -> Result<(), TrainError> {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        self.buffers.insert(name, new(gpu, name, bytes, usage)?);
        Ok(())
    }

    /// The buffer of a name.
    ///
    /// # Panics
    /// When there is none: the kernels and the tables of this crate disagree.
    pub(crate) fn get(&self, name: &str) -> &wgpu::Buffer {
        let Some(buffer) = self.buffers.get(name) else {
            unreachable!("no buffer is named {name}");
        };
        buffer
    }

    /// Writes numbers into a buffer, from its number `from` on, four bytes each.
    pub(crate) fn write<T: bytemuck::Pod>(&self, gpu: &Gpu, name: &str, from: usize, values: &[T]) {
        gpu.queue
            .write_buffer(self.get(name), 4 * from as u64, bytemuck::cast_slice(values));
    }

    /// Reads numbers of a buffer, four bytes each.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device fails.
    pub(crate) fn read<T: bytemuck::Pod>(
        &self,
        gpu: &Gpu,
        name: &str,
        numbers: Range<usize>,
    ) -> Result<Vec<T>, TrainError> {
        let bytes = 4 * numbers.len() as u64;
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let landing = new(gpu, "landing", bytes, usage)?;
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(self.get(name), 4 * numbers.start as u64, &landing, 0, bytes);
        gpu.queue.submit([encoder.finish()]);
        landing.map_async(wgpu::MapMode::Read, .., |_| {});
        let waited = gpu.device.poll(wgpu::PollType::wait_indefinitely());
        waited.map_err(|error| gpu.error(&format!("does not answer ({error})")))?;
        gpu.check()?;
        let mapped = landing.get_mapped_range(..);
        let mapped = mapped.map_err(|error| gpu.error(&format!("does not answer ({error})")))?;
        // The bytes need not be aligned for numbers.
        Ok(bytemuck::pod_collect_to_vec(&mapped))
    }
}

/// A buffer; its contents are zero.
pub(crate) fn new(gpu: &Gpu, name: &str, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer, TrainError> {
    let limits = gpu.device.limits();
    let most = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size);
    if bytes > most {
        let mib = |bytes: u64| bytes.div_ceil(1 << 20);
        return Err(gpu.error(&format!(
            "has too little memory: {name} takes {} MiB, a buffer holds {}",
            mib(bytes),
            mib(most)
        )));
    }
    Ok(gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(name),
        size: bytes.next_multiple_of(16).max(16),
        usage,
        mapped_at_creation: false,
    }))
}
