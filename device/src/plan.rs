//! The kernels of a step in their order, bound to their buffers.

use crate::Gpu;
use crate::kernel::{Bound, Kernel};
use crate::memory::{self, Memory};
use heliosplat::train::TrainError;
use std::collections::HashMap;

/// Side of a tile, pixels.
pub(crate) const TILE: usize = 16;
/// Invocations of a workgroup in kernels over Gaussians, numbers, entries and pixels.
const GROUP: usize = 256;
/// Keys that a workgroup sorts, values of a digit, and bits of one.
const BLOCK: usize = 1024;
const DIGITS: usize = 16;
const BITS: u32 = 4;
/// Bits of a depth.
const DEPTH_BITS: u32 = 32;
/// Workgroups along one axis, at most.
const MOST_GROUPS: usize = 65_535;

/// Sizes that the buffers are made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Room {
    /// Gaussians, and numbers of each.
    pub(crate) gaussians: usize,
    pub(crate) width: usize,
    /// Pairs of a splat and a tile.
    pub(crate) entries: usize,
    /// Pixels and tiles of a view, and its bands.
    pub(crate) pixels: usize,
    pub(crate) tiles: usize,
    pub(crate) bands: usize,
}

impl Room {
    /// Numbers in the counts of a radix sort.
    pub(crate) fn digit_counts(&self) -> usize {
        DIGITS * self.gaussians.max(self.entries).div_ceil(BLOCK)
    }
}

/// Sizes of one step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extent {
    pub(crate) gaussians: usize,
    pub(crate) numbers: usize,
    pub(crate) size: (usize, usize),
    pub(crate) bands: usize,
}

/// Number of workgroups of a kernel.
#[derive(Debug, Clone, Copy)]
enum Over {
    Gaussians,
    Numbers,
    Entries,
    /// Blocks of keys, as many as the sorts have room for.
    Blocks(usize),
    Tiles,
    TilesOfBands,
    Pixels,
    One,
}

/// The kernels of a step.
pub(crate) struct Plan {
    kernels: Vec<(Bound, Over)>,
    room: Room,
}

/// Makes a plan.
struct Planner<'a> {
    gpu: &'a Gpu,
    kernels: &'a HashMap<&'static str, Kernel>,
    memory: &'a Memory,
    plan: Plan,
}

impl Planner<'_> {
    fn add(&mut self, name: &str, over: Over, others: &[(&str, &wgpu::Buffer)]) {
        let named = |binding: &str| {
            let other = others.iter().find(|(name, _)| *name == binding);
            other.map_or_else(|| self.memory.get(binding), |(_, buffer)| *buffer)
        };
        let bound = self.kernels[name].bind(self.gpu, named);
        self.plan.kernels.push((bound, over));
    }

    /// A buffer of the constants of one kernel.
    fn constants(&self, values: [u32; 2]) -> Result<wgpu::Buffer, TrainError> {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let buffer = memory::new(self.gpu, "constants", 16, usage)?;
        self.gpu.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(&values));
        Ok(buffer)
    }

    fn scan(&mut self, numbers: &str, length: usize, of_entries: bool) -> Result<(), TrainError> {
        let constants = self.constants([length as u32, u32::from(of_entries)])?;
        let others = [("scan_pass", &constants), ("numbers", self.memory.get(numbers))];
        self.add("scan", Over::One, &others);
        Ok(())
    }

    /// Sorts `keys` and `values` by the lowest `bits` of the keys. The number of passes is even: what is sorted is
    /// where it was.
    fn sort(&mut self, [keys, values]: [&str; 2], bits: u32, of_entries: bool) -> Result<(), TrainError> {
        let count = if of_entries {
            self.plan.room.entries
        } else {
            self.plan.room.gaussians
        };
        let blocks = count.div_ceil(BLOCK);
        let mut from = [self.memory.get(keys), self.memory.get(values)];
        let mut to = [self.memory.get("spare_keys"), self.memory.get("spare_values")];
        for pass in 0..bits.div_ceil(2 * BITS) * 2 {
            let constants = self.constants([BITS * pass, u32::from(of_entries)])?;
            let others = [
                ("sort_pass", &constants),
                ("keys_in", from[0]),
                ("values_in", from[1]),
                ("keys_out", to[0]),
                ("values_out", to[1]),
            ];
            self.add("sort_count", Over::Blocks(blocks), &others);
            self.scan("digit_counts", DIGITS * blocks, false)?;
            self.add("sort_move", Over::Blocks(blocks), &others);
            std::mem::swap(&mut from, &mut to);
        }
        Ok(())
    }
}

impl Plan {
    /// The plan of steps in buffers made for `room`.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device fails.
    pub(crate) fn new(
        gpu: &Gpu,
        kernels: &HashMap<&'static str, Kernel>,
        memory: &Memory,
        room: Room,
    ) -> Result<Self, TrainError> {
        let plan = Self {
            kernels: Vec::new(),
            room,
        };
        let mut planner = Planner {
            gpu,
            kernels,
            memory,
            plan,
        };
        planner.add("project", Over::Gaussians, &[]);
        planner.add("features", Over::Gaussians, &[]);
        planner.sort(["depth_keys", "order"], DEPTH_BITS, false)?;
        planner.add("count", Over::Gaussians, &[]);
        planner.scan("tile_counts", 0, true)?;
        planner.add("emit", Over::Gaussians, &[]);
        planner.sort(["tile_keys", "entries"], usize::BITS - room.tiles.leading_zeros(), true)?;
        for (name, over) in [
            ("ranges", Over::Entries),
            ("rasterise", Over::Tiles),
            ("compose", Over::Pixels),
            ("ssim", Over::TilesOfBands),
            ("ssim_backward", Over::TilesOfBands),
            ("losses", Over::One),
            ("compose_backward", Over::Pixels),
            ("rasterise_backward", Over::Tiles),
            ("gather", Over::Gaussians),
            ("features_backward", Over::Gaussians),
            ("project_backward", Over::Gaussians),
            ("update", Over::Numbers),
            ("statistics", Over::Gaussians),
        ] {
            planner.add(name, over, &[]);
        }
        gpu.check()?;
        Ok(planner.plan)
    }

    /// Runs the kernels, one after another.
    pub(crate) fn run(&self, encoder: &mut wgpu::CommandEncoder, extent: &Extent) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        for (kernel, over) in &self.kernels {
            kernel.run(&mut pass, self.groups(*over, extent));
        }
    }

    fn groups(&self, over: Over, extent: &Extent) -> [u32; 3] {
        let (width, height) = extent.size;
        let tiles = [width.div_ceil(TILE) as u32, height.div_ceil(TILE) as u32];
        let of = |count: usize| {
            let groups = count.div_ceil(GROUP).max(1);
            [groups.min(MOST_GROUPS) as u32, groups.div_ceil(MOST_GROUPS) as u32, 1]
        };
        match over {
            Over::Gaussians => of(extent.gaussians),
            Over::Numbers => of(extent.numbers),
            Over::Entries => of(self.room.entries),
            Over::Pixels => of(width * height),
            Over::Blocks(blocks) => [blocks as u32, 1, 1],
            Over::Tiles => [tiles[0], tiles[1], 1],
            Over::TilesOfBands => [tiles[0], tiles[1], extent.bands as u32],
            Over::One => [1; 3],
        }
    }
}
