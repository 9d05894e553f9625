//! `--device`: the processor, or a GPU of this machine.

use crate::outcome::CliError;
use clap::ValueEnum;
use heliosplat_fitting::request::TrainDevice;

/// Device of a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum DeviceChoice {
    /// The processor.
    #[default]
    Cpu,
    /// The GPU, in a build with the feature gpu; it knows the model radiance.
    Gpu,
    /// The GPU where there is one that knows the model, else the processor.
    Auto,
}

#[cfg(feature = "gpu")]
impl DeviceChoice {
    /// The device of this machine.
    ///
    /// # Errors
    /// When it must be a GPU, and there is none.
    pub(crate) fn find(self) -> Result<TrainDevice, CliError> {
        use heliosplat_device::Adapter;
        let all = || Adapter::all().into_iter();
        let found = match self {
            Self::Cpu => return Ok(TrainDevice::Cpu),
            Self::Gpu => all().next(),
            Self::Auto => all().find(|adapter| !adapter.is_software()),
        };
        match found {
            Some(adapter) => Ok(TrainDevice::Other {
                source: std::sync::Arc::new(adapter),
                or_cpu: self == Self::Auto,
            }),
            None if self == Self::Auto => {
                tracing::info!("no GPU here: training on the CPU");
                Ok(TrainDevice::Cpu)
            }
            None => Err(CliError::Failed(
                "--device gpu: no device of Vulkan, Metal or Direct3D 12 is here; --device cpu trains without it"
                    .into(),
            )),
        }
    }
}

#[cfg(not(feature = "gpu"))]
impl DeviceChoice {
    /// The device of this machine.
    ///
    /// # Errors
    /// When it must be a GPU, which this build does not know.
    pub(crate) fn find(self) -> Result<TrainDevice, CliError> {
        match self {
            Self::Cpu => Ok(TrainDevice::Cpu),
            Self::Auto => {
                tracing::info!("this build knows no GPU: training on the CPU");
                Ok(TrainDevice::Cpu)
            }
            Self::Gpu => Err(CliError::Input(
                "--device gpu: this build knows no GPU; `cargo build --release --features gpu` makes one that does, --device cpu trains without it".into(),
            )),
        }
    }
}
