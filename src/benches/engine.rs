//! Parts of the engine on the standard site: per pair, per splat, per ray, per step, and how they grow.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use heliosplat::bench_fixture::{Descent, Site, toward_grey};
use heliosplat::optim::Adam;
use heliosplat::splat::project::{project, project_backward};
use heliosplat::splat::{Bins, Maps, Projected, ProjectionOptions, Rasteriser, SplatGradients};
use heliosplat::trace::{OccluderGradients, Occluders, SunVisibility, transmittance};
use std::hint::black_box;

/// As in the binary.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const SPREAD: f32 = 0.6;
const CHANNELS: usize = 4;

/// A site as one camera sees it, with everything that a step makes on its way.
struct Seen {
    site: Site,
    size: usize,
    projected: Projected,
    features: Vec<f32>,
    maps: Maps,
    gradients: SplatGradients,
}

impl Seen {
    fn new(count: usize, size: usize) -> Self {
        let site = Site::new(count, size, SPREAD);
        let projected = project(&site.parameters.gaussians, &site.camera, &ProjectionOptions::default());
        let features = vec![0.5; projected.splats.len() * CHANNELS];
        let rasteriser = Rasteriser::new(&projected, size, size);
        let maps = rasteriser.forward(&features, CHANNELS);
        let gradients = rasteriser.backward(&features, CHANNELS, &maps, &toward_grey(&maps));
        Self {
            site,
            size,
            projected,
            features,
            maps,
            gradients,
        }
    }

    fn rasteriser(&self) -> Rasteriser<'_> {
        Rasteriser::new(&self.projected, self.size, self.size)
    }
}

/// Time per element is time per splat.
fn splats(criterion: &mut Criterion) {
    let seen = Seen::new(100_000, 512);
    let gaussians = &seen.site.parameters.gaussians;
    let options = ProjectionOptions::default();
    let mut group = criterion.benchmark_group("splat");
    group.throughput(Throughput::Elements(seen.projected.splats.len() as u64));
    group.bench_function("project", |b| {
        b.iter(|| project(gaussians, &seen.site.camera, &options));
    });
    group.bench_function("bin", |b| {
        b.iter(|| Bins::new(&seen.projected.splats, seen.size, seen.size));
    });
    let mut out = gaussians.zeros_like();
    group.bench_function("project_backward", |b| {
        let grads = &seen.gradients.splats;
        b.iter(|| project_backward(gaussians, &seen.site.camera, &options, &seen.projected, grads, &mut out));
    });
    let (mut adam, mut parameters) = (Adam::new(gaussians), gaussians.clone());
    let rates = vec![1e-6; gaussians.groups.len()];
    group.bench_function("adam", |b| b.iter(|| adam.step(&mut parameters, &out, &rates)));
    group.finish();
}

/// Time per element is time per (splat, pixel) pair.
fn pairs(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("pair");
    for (count, size) in [(100_000, 512), (100_000, 300), (20_000, 512)] {
        let seen = Seen::new(count, size);
        let d_maps = toward_grey(&seen.maps);
        let rasteriser = seen.rasteriser();
        group.throughput(Throughput::Elements(seen.maps.pairs));
        let name = format!("{count} on {size}");
        group.bench_function(BenchmarkId::new("forward", &name), |b| {
            b.iter(|| rasteriser.forward(&seen.features, CHANNELS));
        });
        group.bench_function(BenchmarkId::new("backward", &name), |b| {
            b.iter(|| rasteriser.backward(&seen.features, CHANNELS, &seen.maps, &d_maps));
        });
    }
    group.finish();
}

/// Time per element is time per ray; forward alone, and with the gradients of everything.
fn rays(criterion: &mut Criterion) {
    let site = Site::new(100_000, 512, SPREAD);
    let gaussians = &site.parameters.gaussians;
    let origins: Vec<u32> = (0..gaussians.count as u32).collect();
    let ones = vec![1.0; origins.len()];
    let mut out = gaussians.zeros_like();
    let mut group = criterion.benchmark_group("ray");
    group.throughput(Throughput::Elements(origins.len() as u64));
    group.sample_size(20);
    for (name, by) in [("sun_plane", SunVisibility::Plane), ("hierarchy", SunVisibility::Bvh)] {
        let mut occluders = Occluders::tracing_by(by, gaussians);
        group.bench_function(BenchmarkId::new("forward", name), |b| {
            b.iter(|| {
                occluders.renew(gaussians);
                transmittance(&occluders, &origins, &site.sun)
            });
        });
        group.bench_function(BenchmarkId::new("with_gradients", name), |b| {
            b.iter(|| {
                occluders.renew(gaussians);
                let traced = transmittance(&occluders, &origins, &site.sun);
                let all = (&occluders, OccluderGradients::All);
                traced.backward(gaussians, all, &origins, &ones, &mut out);
            });
        });
    }
    group.finish();
}

/// Whole steps, by the number of Gaussians, pixels and threads.
fn steps(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("step");
    group.sample_size(10);
    for count in [1_000, 10_000, 100_000, 1_000_000] {
        let mut descent = Descent::new(Site::new(count, 512, SPREAD));
        group.bench_function(BenchmarkId::new("gaussians", count), |b| b.iter(|| descent.step()));
    }
    for size in [64, 256, 512, 1024, 2048] {
        let mut descent = Descent::new(Site::new(100_000, size, SPREAD));
        group.bench_function(BenchmarkId::new("pixels", size * size), |b| b.iter(|| descent.step()));
    }
    let most = std::thread::available_parallelism().map_or(1, usize::from);
    for threads in (0..).map(|power| 1 << power).take_while(|&threads| threads <= most) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let mut descent = Descent::new(Site::new(100_000, 512, SPREAD));
        if let Ok(pool) = pool {
            group.bench_function(BenchmarkId::new("threads", threads), |b| {
                b.iter(|| black_box(pool.install(|| descent.step())));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, splats, pairs, rays, steps);
criterion_main!(benches);
