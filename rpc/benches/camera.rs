//! A rational camera, point by point, on one thread.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};

const POINTS: usize = 10_000;

/// A mildly curved cubic camera.
fn camera() -> Rpc {
    let numerator = |l: f64, p: f64, h: f64| {
        let mut c = [1.3e-6; 20];
        c[..7].copy_from_slice(&[2.1e-3, l, p, h, 4.0e-4, -2.5e-4, 1.1e-4]);
        c
    };
    let mut denominator = [4.0e-7; 20];
    denominator[..4].copy_from_slice(&[1.0, 6.0e-4, -4.0e-4, 3.0e-4]);
    Rpc {
        line_offset: 8_000.0,
        sample_offset: 8_000.0,
        latitude_offset_deg: 37.58,
        longitude_offset_deg: 36.91,
        height_offset_m: 700.0,
        line_scale: 8_000.0,
        sample_scale: 8_000.0,
        latitude_scale_deg: 0.036,
        longitude_scale_deg: 0.045,
        height_scale_m: 500.0,
        line_numerator: numerator(0.02, -1.0, 0.03),
        line_denominator: denominator,
        sample_numerator: numerator(1.0, 0.02, -0.04),
        sample_denominator: denominator,
        error_bias_m: None,
        error_random_m: None,
    }
}

fn points(criterion: &mut Criterion) {
    let rpc = camera();
    let fraction = |i: usize, step: f64| (i as f64 * step).fract();
    let ground: Vec<GeoPoint> = (0..POINTS)
        .map(|i| GeoPoint {
            lon_deg: 36.88 + 0.06 * fraction(i, 0.618_033_988_7),
            lat_deg: 37.56 + 0.04 * fraction(i, 0.754_877_666_2),
            height_m: 700.0,
        })
        .collect();
    let image: Vec<ImagePoint> = ground.iter().map(|&point| rpc.project(point)).collect();
    let mut group = criterion.benchmark_group("rpc");
    group.throughput(Throughput::Elements(POINTS as u64));
    group.bench_function("project", |b| {
        b.iter(|| ground.iter().map(|&point| rpc.project(point).col).sum::<f64>());
    });
    group.bench_function("localise", |b| {
        b.iter(|| {
            image
                .iter()
                .filter(|&&point| rpc.localise(point, 700.0).is_ok())
                .count()
        });
    });
    group.finish();
}

criterion_group!(benches, points);
criterion_main!(benches);
