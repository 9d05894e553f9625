//! A rational camera, point by point and in batches, on one thread.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};

const POINTS: usize = 10_000;

fn points(criterion: &mut Criterion) {
    let rpc = Rpc::example();
    let fraction = |i: usize, step: f64| (i as f64 * step).fract();
    let ground: Vec<GeoPoint> = (0..POINTS)
        .map(|i| {
            GeoPoint::new(
                36.88 + 0.06 * fraction(i, 0.618_033_988_7),
                37.56 + 0.04 * fraction(i, 0.754_877_666_2),
                700.0,
            )
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
    group.bench_function("project_all", |b| b.iter(|| rpc.project_all(&ground)));
    let heights = vec![700.0; POINTS];
    group.bench_function("localise_all", |b| b.iter(|| rpc.localise_all(&image, &heights)));
    group.finish();
}

criterion_group!(benches, points);
criterion_main!(benches);
