//! Training steps on a GPU, by wgpu: Vulkan, Metal or Direct3D 12.
//!
//! [`Adapter::all`] finds the devices of the machine; an [`Adapter`] is a [`DeviceSource`] of the engine. The tables of a
//! training live on the device; a step sends a camera and brings back its losses. Kernels are in `src/wgsl`, one
//! operation in a file, with the formulas of the engine's own. Sums have a fixed order and no number is added by atomic
//! operations, so that a device repeats its own bytes.
//!
//! | module | content |
//! |---|---|
//! | `kernel` | source of the kernels, pipelines, bindings by name |
//! | `memory` | buffers by name, upload and download |
//! | `plan` | the kernels of a step in their order |
//! | [`radiance`] | the device of the radiance model: tables, views, steps |

mod kernel;
mod memory;
mod plan;
pub mod radiance;

use heliosplat::model::SceneModel;
use heliosplat::train::device::{Device, DeviceSource};
use heliosplat::train::{TrainError, TrainOptions};
use radiance::RadianceDevice;
use std::sync::{Arc, Mutex, PoisonError};

/// Memory that the invocations of a workgroup share, bytes: that of `rasterise_backward`.
const SHARED_BYTES: u32 = 24 << 10;

/// A device of the machine.
#[derive(Debug, Clone)]
pub struct Adapter {
    adapter: wgpu::Adapter,
    name: String,
}

impl Adapter {
    /// The devices of this machine that can train: those with memory of their own first, software last.
    pub fn all() -> Vec<Self> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
        let mut found = pollster::block_on(instance.enumerate_adapters(backends));
        found.retain(|adapter| adapter.limits().max_compute_workgroup_storage_size >= SHARED_BYTES);
        found.sort_by_key(|adapter| match adapter.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::IntegratedGpu => 1,
            wgpu::DeviceType::Cpu => 3,
            _ => 2,
        });
        let named = |adapter: wgpu::Adapter| {
            let info = adapter.get_info();
            Self {
                name: format!("{}, {:?}", info.name, info.backend),
                adapter,
            }
        };
        found.into_iter().map(named).collect()
    }

    /// True if the device is a program on the processor, slower than training without it.
    pub fn is_software(&self) -> bool {
        self.adapter.get_info().device_type == wgpu::DeviceType::Cpu
    }

    /// The device of the radiance model.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the driver refuses it or a kernel.
    pub fn radiance(&self) -> Result<RadianceDevice, TrainError> {
        RadianceDevice::new(self.connect()?)
    }

    /// Opens the device.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the driver refuses.
    fn connect(&self) -> Result<Gpu, TrainError> {
        let wanted = self.adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("heliosplat"),
            required_limits: self.adapter.limits(),
            ..wgpu::DeviceDescriptor::default()
        });
        let opened = pollster::block_on(wanted);
        let (device, queue) =
            opened.map_err(|error| TrainError::Device(format!("{} cannot be opened ({error})", self.name)))?;
        let fault = Arc::new(Mutex::new(None));
        let keep = |fault: &Arc<Mutex<Option<String>>>, text: String| {
            let mut fault = fault.lock().unwrap_or_else(PoisonError::into_inner);
            fault.get_or_insert(text);
        };
        let (lost, wrong) = (Arc::clone(&fault), Arc::clone(&fault));
        device.set_device_lost_callback(move |_, text| keep(&lost, format!("is lost ({text})")));
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| keep(&wrong, told(&error))));
        Ok(Gpu {
            device,
            queue,
            name: self.name.clone(),
            fault,
        })
    }
}

impl DeviceSource for Adapter {
    fn name(&self) -> &str {
        &self.name
    }

    fn open(&self, model: &dyn SceneModel, options: &TrainOptions) -> Result<Option<Box<dyn Device>>, TrainError> {
        if !radiance::knows(model, options) {
            return Ok(None);
        }
        Ok(Some(Box::new(self.radiance()?)))
    }
}

/// An error of the device in one line.
fn told(error: &wgpu::Error) -> String {
    match error {
        wgpu::Error::OutOfMemory { .. } => "has too little memory".to_owned(),
        other => {
            let text = other.to_string();
            let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
            format!("failed ({})", lines.join(" "))
        }
    }
}

/// An opened device.
pub(crate) struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    name: String,
    /// The first fault that the device reported.
    fault: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// The fault that the device reported, if any.
    fn check(&self) -> Result<(), TrainError> {
        match &*self.fault.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(fault) => Err(self.error(fault)),
            None => Ok(()),
        }
    }

    fn error(&self, fault: &str) -> TrainError {
        TrainError::Device(format!("{} {fault}", self.name))
    }
}
