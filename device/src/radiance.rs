//! The device of the radiance model: its tables, the views, and a step.

use crate::Gpu;
use crate::kernel::{Kernel, sources};
use crate::memory::{self, Memory};
use crate::plan::{Extent, Plan, Room, TILE};
use heliosplat::gaussians::Table;
use heliosplat::model::{SceneModel, View};
use heliosplat::optim::adam::BETA2;
use heliosplat::timeline::stage;
use heliosplat::train::device::{Descent, Device, Step, Tables};
use heliosplat::train::{Fault, TrainError, TrainOptions};
use std::collections::HashMap;

/// Bytes of views that stay on the device; others are sent when their turn comes.
const VIEW_BYTES: u64 = 2 << 30;
/// Numbers of the report of a step, and places in it, see `step.wgsl`.
const REPORT: usize = 8;
const PAIRS: usize = 2;
const ENTRIES: usize = 1;
const LOSSES: usize = 4;
/// Bits of the report's faults: the loss, then the groups of parameters; the last: too little room for entries.
const FAULT_LOSS: u32 = 1;
const FAULT_GROUP: u32 = 2;
const FAULT_ROOM: u32 = 1 << 31;
/// Margin of the room for entries beyond the need of a step; at first there is room for one of each Gaussian.
const MARGIN: f64 = 1.25;

/// True if the device trains this model with these options.
pub fn knows(model: &dyn SceneModel, options: &TrainOptions) -> bool {
    let nothing_else = options.consistency_weight <= 0.0 && options.smoothness_weight <= 0.0;
    let all_pixels = options.patience == 0 || options.holdout <= 0.0;
    model.name() == "radiance" && nothing_else && all_pixels
}

/// Numbers of the constants of a step, see `step.wgsl`.
const CONSTANTS: usize = 60;

/// A view on its way to the device or there.
struct Sent {
    /// `[band][pixel]`, then the weights; `None` where it has to be sent again.
    buffer: Option<wgpu::Buffer>,
    /// By band: one over the sum of weights and the number of bands.
    inverse_norm: [f32; 4],
    /// Number of known values of all bands.
    known: usize,
}

/// Trains the radiance model on a device.
pub struct RadianceDevice {
    gpu: Gpu,
    kernels: HashMap<&'static str, Kernel>,
    memory: Memory,
    room: Room,
    plan: Option<Plan>,
    /// By index, and true for those at full size.
    views: HashMap<(usize, bool), Sent>,
    view_bytes: u64,
    gaussians: usize,
    width: usize,
    /// Steps of Adam.
    steps: u32,
}

impl RadianceDevice {
    /// The device, with its kernels compiled.
    ///
    /// # Errors
    /// [`TrainError::Device`] when it refuses a kernel.
    pub(crate) fn new(gpu: Gpu) -> Result<Self, TrainError> {
        let compiled = sources();
        let kernels = compiled
            .into_iter()
            .map(|(name, text)| (name, Kernel::new(&gpu, name, &text)));
        let kernels = kernels.collect();
        let mut memory = Memory::default();
        memory.make_uniform(&gpu, "step", 4 * CONSTANTS as u64)?;
        memory.make(&gpu, &[("report", 4 * REPORT as u64)])?;
        Ok(Self {
            gpu,
            kernels,
            memory,
            room: Room::default(),
            plan: None,
            views: HashMap::new(),
            view_bytes: 0,
            gaussians: 0,
            width: 0,
            steps: 0,
        })
    }

    /// Makes larger what `wanted` asks more of.
    fn make_room(&mut self, wanted: Room) -> Result<(), TrainError> {
        let had = self.room;
        let bytes = |numbers: usize| 4 * numbers as u64;
        if (wanted.gaussians, wanted.width) != (had.gaussians, had.width) {
            let n = wanted.gaussians;
            let numbers = bytes(n * wanted.width);
            self.memory.make(
                &self.gpu,
                &[
                    ("parameters", numbers),
                    ("gradients", numbers),
                    ("first_moments", numbers),
                    ("second_moments", numbers),
                    ("gradient_lengths", bytes(n)),
                    ("views_seen", bytes(n)),
                    ("splats", bytes(12 * n)),
                    ("colours", bytes(4 * n)),
                    ("colour_gradients", bytes(4 * n)),
                    ("splat_gradients", bytes(8 * n)),
                    ("depth_keys", bytes(n)),
                    ("order", bytes(n)),
                    ("tile_counts", bytes(n)),
                    ("places", bytes(2 * n)),
                ],
            )?;
        }
        if (wanted.gaussians, wanted.entries) != (had.gaussians, had.entries) {
            let (m, longest) = (wanted.entries, wanted.entries.max(wanted.gaussians));
            self.memory.make(
                &self.gpu,
                &[
                    ("tile_keys", bytes(m)),
                    ("entries", bytes(m)),
                    ("owners", bytes(m)),
                    ("records", bytes(9 * m)),
                    ("spare_keys", bytes(longest)),
                    ("spare_values", bytes(longest)),
                    ("digit_counts", bytes(wanted.digit_counts())),
                ],
            )?;
        }
        if (wanted.pixels, wanted.tiles, wanted.bands) != (had.pixels, had.tiles, had.bands) {
            let (pixels, bands, tiles) = (wanted.pixels, wanted.bands, wanted.tiles);
            self.memory.make(
                &self.gpu,
                &[
                    ("maps", bytes(4 * pixels)),
                    ("map_gradients", bytes(4 * pixels)),
                    ("image", bytes(bands * pixels)),
                    ("image_gradient", bytes(bands * pixels)),
                    ("truth", bytes((bands + 1) * pixels)),
                    ("slopes", bytes(3 * bands * pixels)),
                    ("ssim_sums", bytes(bands * tiles)),
                    ("difference_sums", bytes(2 * bands * tiles)),
                    ("ranges", bytes(2 * tiles)),
                ],
            )?;
        }
        if wanted != had {
            self.plan = None;
            self.room = wanted;
        }
        Ok(())
    }

    /// The room that a view needs, with what there is.
    fn room_of(&self, view: &View) -> Room {
        let (width, height) = (view.camera.width, view.camera.height);
        Room {
            pixels: self.room.pixels.max(width * height),
            tiles: self.room.tiles.max(width.div_ceil(TILE) * height.div_ceil(TILE)),
            bands: self.room.bands.max(view.image.bands),
            entries: self.room.entries.max(self.gaussians),
            ..self.room
        }
    }

    /// Puts a view where the kernels look for it.
    fn show(&mut self, step: &Step, encoder: &mut wgpu::CommandEncoder) -> Result<([f32; 4], usize), TrainError> {
        // Views of half size are not needed any more.
        if step.full_size && self.views.keys().any(|key| !key.1) {
            self.views.clear();
            self.view_bytes = 0;
        }
        let (key, view) = ((step.index, step.full_size), step.view);
        let bytes = 4 * (view.image.values.len() + view.weight.len()) as u64;
        if !self.views.contains_key(&key) {
            let buffer = if self.view_bytes + bytes <= VIEW_BYTES {
                let usage = wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
                let buffer = memory::new(&self.gpu, &view.name, bytes, usage)?;
                send(&self.gpu, &buffer, view);
                self.view_bytes += bytes;
                Some(buffer)
            } else {
                None
            };
            self.views.insert(key, sent(view, buffer));
        }
        let sent = &self.views[&key];
        match &sent.buffer {
            Some(buffer) => encoder.copy_buffer_to_buffer(buffer, 0, self.memory.get("truth"), 0, bytes),
            None => send(&self.gpu, self.memory.get("truth"), view),
        }
        Ok((sent.inverse_norm, sent.known))
    }

    /// Constants of a step for all kernels, in the order of `step.wgsl`.
    fn constants(&self, step: &Step, inverse_norm: [f32; 4]) -> [u32; CONSTANTS] {
        let camera = &step.view.camera;
        let (width, height) = (camera.width, camera.height);
        let (background, _) = step.model.background();
        let mut ceiling = [f32::MAX; 4];
        for (slot, &value) in ceiling.iter_mut().zip(&step.view.ceiling) {
            *slot = if value.is_finite() { value } else { f32::MAX };
        }
        let eye = camera.eye().map_or([0.0; 4], |eye| eye.extend(1.0).to_array());
        let (rates, beta1, next) = (step.rates, step.rates.beta1, self.steps as i32 + 1);
        let correction2 = (1.0 - BETA2.powi(next)).sqrt();
        let places = [
            camera.u.extend(camera.u0).to_array(),
            camera.v.extend(camera.v0).to_array(),
            camera.w.extend(0.0).to_array(),
            camera.depth_axis.extend(0.0).to_array(),
            eye,
            [background[0], background[1], background[2], 0.0],
            ceiling,
            inverse_norm,
        ];
        let degree = step.model.feature_parameters().len().saturating_sub(1);
        let counts = [
            [width, height, width.div_ceil(TILE), height.div_ceil(TILE)],
            [self.gaussians, self.room.entries, step.view.image.bands, degree],
        ];
        let update = [
            [beta1, 1.0 - beta1.powi(next), correction2, (width * height) as f32],
            [rates.log_scale.0, rates.log_scale.1, rates.opacity.0, rates.opacity.1],
            [rates.prior.0, rates.prior.1, 0.0, 0.0],
        ];
        let numbers = places.as_flattened().iter().map(|x| x.to_bits());
        let numbers = numbers.chain(counts.as_flattened().iter().map(|&n| n as u32));
        let update = update.as_flattened().iter().chain(&rates.gaussians);
        let mut all = [0; CONSTANTS];
        let values = numbers.chain(update.map(|x| x.to_bits()));
        all.iter_mut().zip(values).for_each(|(slot, value)| *slot = value);
        all
    }

    /// Runs the kernels on a view once; the report of the step, and the number of known values of the view.
    fn attempt(&mut self, step: &Step) -> Result<([u32; REPORT], usize), TrainError> {
        if self.plan.is_none() {
            self.plan = Some(Plan::new(&self.gpu, &self.kernels, &self.memory, self.room)?);
        }
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let (inverse_norm, known) = self.show(step, &mut encoder)?;
        let constants = self.constants(step, inverse_norm);
        self.memory.write(&self.gpu, "step", 0, &constants);
        encoder.clear_buffer(self.memory.get("report"), 0, None);
        encoder.clear_buffer(self.memory.get("ranges"), 0, None);
        if let Some(plan) = &self.plan {
            let extent = Extent {
                gaussians: self.gaussians,
                numbers: self.gaussians * self.width,
                size: (step.view.camera.width, step.view.camera.height),
                bands: step.view.image.bands,
            };
            plan.run(&mut encoder, &extent);
        }
        self.gpu.queue.submit([encoder.finish()]);
        let report: Vec<u32> = self.memory.read(&self.gpu, "report", 0..REPORT)?;
        let mut numbers = [0; REPORT];
        numbers.copy_from_slice(&report);
        Ok((numbers, known))
    }

    /// Numbers of a buffer, for tests.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device fails.
    #[doc(hidden)]
    pub fn numbers(&self, name: &str, count: usize) -> Result<Vec<f32>, TrainError> {
        self.memory.read(&self.gpu, name, 0..count)
    }

    /// Loses the device, for tests.
    #[doc(hidden)]
    pub fn lose(&self) {
        self.gpu.device.destroy();
    }

    fn put_table(&self, name: &str, table: &Table) {
        let mut from = 0;
        for group in &table.groups {
            self.memory.write(&self.gpu, name, from, &group.values);
            from += group.values.len();
        }
    }

    fn fetch_table(&self, name: &str, table: &mut Table) -> Result<(), TrainError> {
        let all: Vec<f32> = self.memory.read(&self.gpu, name, 0..self.gaussians * self.width)?;
        let mut rest = all.as_slice();
        for group in &mut table.groups {
            let (own, behind) = rest.split_at(group.values.len().min(rest.len()));
            group.values.copy_from_slice(own);
            rest = behind;
        }
        Ok(())
    }
}

impl Device for RadianceDevice {
    fn name(&self) -> &str {
        &self.gpu.name
    }

    fn put(&mut self, tables: &Tables) -> Result<(), TrainError> {
        let gaussians = &tables.parameters.gaussians;
        self.gaussians = gaussians.count;
        self.width = gaussians.groups.iter().map(|group| group.spec.width).sum();
        self.make_room(Room {
            gaussians: self.gaussians,
            width: self.width,
            ..self.room
        })?;
        self.put_table("parameters", gaussians);
        self.put_table("first_moments", &tables.gaussians_adam.first);
        self.put_table("second_moments", &tables.gaussians_adam.second);
        self.memory
            .write(&self.gpu, "gradient_lengths", 0, &tables.statistics.gradient);
        self.memory.write(&self.gpu, "views_seen", 0, &tables.statistics.seen);
        self.steps = tables.gaussians_adam.steps;
        Ok(())
    }

    fn step(&mut self, step: &Step, tables: &mut Tables) -> Result<Descent, TrainError> {
        let _part = stage("device");
        self.make_room(self.room_of(step.view))?;
        let (mut report, mut known) = self.attempt(step)?;
        while report[0] & FAULT_ROOM != 0 {
            let entries = (f64::from(report[ENTRIES]) * MARGIN) as usize;
            self.make_room(Room { entries, ..self.room })?;
            (report, known) = self.attempt(step)?;
        }
        let group = |bit: usize| report[0] & (FAULT_GROUP << bit) != 0;
        let named = tables.parameters.gaussians.groups.iter().enumerate();
        let bad_group = named
            .filter(|(bit, _)| group(*bit))
            .map(|(_, group)| group.spec.name.clone())
            .next();
        let rejected = match report[0] & FAULT_LOSS {
            0 => bad_group.map(Fault::Gradient),
            _ => Some(Fault::Loss("photometric")),
        };
        if rejected.is_none() {
            self.steps += 1;
        }
        let loss = |at: usize| f64::from(f32::from_bits(report[LOSSES + at]));
        Ok(Descent {
            losses: vec![("photometric", loss(0))],
            l1: loss(1) / known.max(1) as f64,
            held_out: None,
            pairs: u64::from(report[PAIRS]),
            turn: None,
            rejected,
        })
    }

    fn fetch(&mut self, tables: &mut Tables) -> Result<(), TrainError> {
        let _part = stage("device, fetch");
        self.fetch_table("parameters", &mut tables.parameters.gaussians)?;
        self.fetch_table("first_moments", &mut tables.gaussians_adam.first)?;
        self.fetch_table("second_moments", &mut tables.gaussians_adam.second)?;
        let all = 0..self.gaussians;
        tables.statistics.gradient = self.memory.read(&self.gpu, "gradient_lengths", all.clone())?;
        tables.statistics.seen = self.memory.read(&self.gpu, "views_seen", all)?;
        tables.gaussians_adam.steps = self.steps;
        tables.globals_adam.steps = self.steps;
        Ok(())
    }
}

/// Sends the values and weights of a view.
fn send(gpu: &Gpu, to: &wgpu::Buffer, view: &View) {
    let values: &[u8] = bytemuck::cast_slice(&view.image.values);
    gpu.queue.write_buffer(to, 0, values);
    gpu.queue
        .write_buffer(to, values.len() as u64, bytemuck::cast_slice(&view.weight));
}

/// The sums over a view that its losses are divided by.
fn sent(view: &View, buffer: Option<wgpu::Buffer>) -> Sent {
    let (bands, mut inverse_norm) = (view.image.bands, [0.0; 4]);
    let mut known = 0;
    for (band, inverse) in inverse_norm.iter_mut().enumerate().take(bands) {
        let pairs = view.image.plane(band).iter().zip(&view.weight);
        let weights = pairs.filter(|(value, _)| value.is_finite()).map(|(_, &weight)| weight);
        let norm = weights.clone().map(f64::from).sum::<f64>() * bands as f64;
        known += weights.count();
        if norm > 0.0 {
            *inverse = (1.0 / norm) as f32;
        }
    }
    Sent {
        buffer,
        inverse_norm,
        known,
    }
}
