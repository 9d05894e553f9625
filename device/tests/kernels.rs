//! Each kernel against the engine's own: values to 1e-4, gradients to 1e-3, as the engine against its f64 reference.

mod common;

use common::{adapter, apart, model, parameters, views};
use heliosplat::gaussians::{FEATURES, Table};
use heliosplat::loss::photometric::photometric;
use heliosplat::model::{Context, Parameters, SceneModel, View};
use heliosplat::optim::DensityStatistics;
use heliosplat::render::{Lit, Pass, PassGradients, PassOptions};
use heliosplat::splat::{Maps, Projected};
use heliosplat::train::device::{Device, Rates, Step, Tables};
use heliosplat::train::{LAMBDA_SSIM, PHOTOMETRIC_WEIGHT, TrainOptions, update};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_device::radiance::RadianceDevice;

const COUNT: usize = 700;

/// A step of the engine, stage by stage.
struct Expected {
    projected: Projected,
    maps: Maps,
    image: Raster,
    loss: f64,
    gradients: Parameters,
    behind: PassGradients,
}

/// The photometric loss of an image of a view, and its gradient.
fn photometric_of(image: &Raster, view: &View) -> (f64, Raster) {
    let (loss, mut d_image) = photometric(image, &view.truth(image), &view.weight, LAMBDA_SSIM);
    d_image.values.iter_mut().for_each(|d| *d *= PHOTOMETRIC_WEIGHT);
    (loss, d_image)
}

fn expected(parameters: &Parameters, view: &View) -> Expected {
    let model = model();
    let context = Context {
        parameters,
        camera: &view.camera,
        light: None,
        appearance: None,
    };
    let pass = Pass::new(&model, context, Lit::Everywhere, PassOptions::default());
    let image = pass.image();
    let (loss, d_image) = photometric_of(&image, view);
    let (mut d_maps, mut gradients) = (pass.zero_gradients(), parameters.zeros_like());
    model.compose_backward(&context, &pass.maps, &d_image, &mut d_maps, &mut gradients);
    let (projected, maps) = (pass.projected.clone(), pass.maps.clone());
    let behind = pass.backward(d_maps, &mut gradients);
    Expected {
        projected,
        maps,
        image,
        loss,
        gradients,
        behind,
    }
}

fn rates() -> Rates {
    Rates {
        gaussians: vec![1e-3, 5e-3, 2e-3, 0.05, 5e-3, 2e-4, 0.0, 0.0],
        globals: Vec::new(),
        beta1: 0.9,
        prior: (0.02, 0.01),
        log_scale: (-3.0, -2.0),
        opacity: (-12.0, 3.0),
    }
}

/// A device after one step on a view of other images than the parameters make.
struct Stepped {
    device: RadianceDevice,
    tables: Tables,
    view: View,
    loss: f64,
    pairs: u64,
}

fn stepped(rates: &Rates) -> Option<Stepped> {
    let mut device = adapter()?.radiance().expect("opened");
    let view = views(&parameters(COUNT, 1), 1).remove(0);
    let mut tables = Tables::new(parameters(COUNT, 2), 1);
    let step = Step {
        model: &model(),
        options: &TrainOptions::default(),
        done: 0,
        index: 0,
        view: &view,
        full_size: true,
        camera: &view.camera,
        nadir: None,
        turns: false,
        held: &[],
        rates,
    };
    device.put(&tables).expect("taken over");
    let descent = device.step(&step, &mut tables).expect("computed");
    assert_eq!(descent.rejected, None);
    Some(Stepped {
        loss: descent.losses[0].1,
        pairs: descent.pairs,
        device,
        tables,
        view,
    })
}

impl Stepped {
    fn numbers(&self, name: &str, count: usize) -> Vec<f32> {
        self.device.numbers(name, count).expect("read")
    }
}

/// Numbers of the device's splats, by Gaussian: twelve each.
fn splats_like(projected: &Projected, found: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let (mut own, mut theirs) = (Vec::new(), Vec::new());
    for (splat, &g) in projected.splats.iter().zip(&projected.gaussian) {
        let s = &found[12 * g as usize..12 * g as usize + 12];
        own.extend([s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9]]);
        theirs.extend([splat.col, splat.row, splat.half[0], splat.half[1]]);
        theirs.extend(splat.conic);
        theirs.extend([splat.reach, splat.opacity, splat.depth]);
    }
    (own, theirs)
}

#[test]
fn splats_and_colours_are_those_of_the_engine() {
    let Some(stepped) = stepped(&rates()) else { return };
    let expected = expected(&stepped.tables.parameters, &stepped.view);
    let found = stepped.numbers("splats", 12 * COUNT);
    let visible: Vec<u32> = (0..COUNT as u32)
        .filter(|&i| found[12 * i as usize + 10] > 0.0)
        .collect();
    assert_eq!(visible, expected.projected.gaussian);
    let (own, theirs) = splats_like(&expected.projected, &found);
    for k in 0..10 {
        let column = |all: &[f32]| -> Vec<f32> { all.iter().skip(k).step_by(10).copied().collect() };
        let apart = apart(&column(&own), &column(&theirs));
        assert!(apart < 1e-5, "number {k} of the splats: {apart}");
    }
}

#[test]
fn every_tile_lists_its_splats_front_to_back() {
    let Some(stepped) = stepped(&rates()) else { return };
    let expected = expected(&stepped.tables.parameters, &stepped.view);
    let ProjectiveCamera { width, height, .. } = stepped.view.camera;
    let (columns, rows) = (width.div_ceil(16), height.div_ceil(16));
    let whole = |name: &str, count: usize| -> Vec<usize> {
        let numbers = stepped.numbers(name, count);
        numbers.iter().map(|x| x.to_bits() as usize).collect()
    };
    let ranges = whole("ranges", 2 * columns * rows);
    let total = ranges.iter().copied().max().unwrap_or(0);
    let (entries, owners) = (whole("entries", total), whole("owners", total));
    let mut listed = 0;
    for tile in 0..columns * rows {
        let (col, row) = ((tile % columns * 16) as f32, (tile / columns * 16) as f32);
        let touches =
            |at: f32, half: f32, first: f32| (at - half).ceil() < first + 16.0 && (at + half).floor() >= first;
        let seen = expected.projected.splats.iter().zip(&expected.projected.gaussian);
        let mut own: Vec<(f32, usize)> = seen
            .filter(|(s, _)| touches(s.col, s.half[0], col) && touches(s.row, s.half[1], row))
            .map(|(s, &g)| (s.depth, g as usize))
            .collect();
        own.sort_by(|a, b| a.0.total_cmp(&b.0));
        let found = entries[ranges[2 * tile]..ranges[2 * tile + 1]]
            .iter()
            .map(|&e| owners[e]);
        assert!(found.eq(own.iter().map(|(_, g)| *g)), "tile {tile}");
        listed += own.len();
    }
    assert!(listed == total && total > COUNT, "{listed} of {total}");
}

#[test]
fn maps_image_and_loss_are_those_of_the_engine() {
    let Some(stepped) = stepped(&rates()) else { return };
    let expected = expected(&stepped.tables.parameters, &stepped.view);
    let plane = expected.image.plane_len();
    let maps = stepped.numbers("maps", 4 * plane);
    for k in 0..4 {
        let own: Vec<f32> = maps.iter().skip(k).step_by(4).copied().collect();
        let theirs = expected
            .maps
            .channels
            .get(k)
            .filter(|_| k < 3)
            .unwrap_or(&expected.maps.alpha);
        let apart = apart(&own, theirs);
        assert!(apart < 1e-4, "channel {k}: {apart}");
    }
    let mut image = expected.image.clone();
    image.values = stepped.numbers("image", 4 * plane);
    let apart_image = apart(&image.values, &expected.image.values);
    assert!(apart_image < 1e-4, "{apart_image}");
    // The derivative of an absolute difference jumps: from one image, as the two may lie on both sides of the truth.
    let (loss, d_image) = photometric_of(&image, &stepped.view);
    assert!((stepped.loss / loss - 1.0).abs() < 1e-5, "{} {loss}", stepped.loss);
    assert!(
        (stepped.loss / expected.loss - 1.0).abs() < 1e-4,
        "{} {}",
        stepped.loss,
        expected.loss
    );
    let apart_gradient = apart(&stepped.numbers("image_gradient", 4 * plane), &d_image.values);
    assert!(apart_gradient < 1e-3, "{apart_gradient}");
    // Both count pixels inside the ellipses, until a pixel or a tile is opaque.
    assert!(
        stepped.pairs > 0 && stepped.pairs <= expected.maps.pairs,
        "{}",
        stepped.pairs
    );
}

#[test]
fn gradients_are_those_of_the_engine() {
    let Some(stepped) = stepped(&rates()) else { return };
    let expected = expected(&stepped.tables.parameters, &stepped.view);
    let groups = &expected.gradients.gaussians.groups;
    let all = stepped.numbers("gradients", groups.iter().map(|group| group.values.len()).sum());
    let mut rest = all.as_slice();
    for group in groups {
        let (own, behind) = rest.split_at(group.values.len());
        let apart = apart(own, &group.values);
        assert!(apart < 1e-3, "{}: {apart}", group.spec.name);
        rest = behind;
    }
    let found = stepped.numbers("splat_gradients", 8 * COUNT);
    let (mut own, mut theirs) = (Vec::new(), Vec::new());
    for (d, &g) in expected.behind.splats.iter().zip(&expected.behind.projected.gaussian) {
        let s = &found[8 * g as usize..];
        own.extend([s[0], s[1], s[2]]);
        theirs.extend([d.col, d.row, d.opacity]);
    }
    let apart = apart(&own, &theirs);
    assert!(apart < 1e-3, "{apart}");
}

/// Groups of numbers that lie one after another, as a table like another.
fn table_of(numbers: &[f32], like: &Table) -> Table {
    let mut table = like.zeros_like();
    let mut rest = numbers;
    for group in &mut table.groups {
        let (own, behind) = rest.split_at(group.values.len());
        group.values.copy_from_slice(own);
        rest = behind;
    }
    table
}

#[test]
fn updates_and_statistics_are_those_of_the_engine() {
    let rates = rates();
    let Some(mut stepped) = stepped(&rates) else { return };
    let mut on_cpu = Tables::new(stepped.tables.parameters.clone(), 1);
    let gaussians = &on_cpu.parameters.gaussians;
    let count = gaussians.groups.iter().map(|group| group.values.len()).sum();
    let mut gradients = Parameters {
        gaussians: table_of(&stepped.numbers("gradients", count), gaussians),
        globals: on_cpu.parameters.globals.clone(),
    };
    let expected = expected(&stepped.tables.parameters, &stepped.view);
    update(&mut on_cpu, &mut gradients, &rates);
    stepped.device.fetch(&mut stepped.tables).expect("fetched");
    let found = &stepped.tables.parameters.gaussians;
    for (own, theirs) in found.groups.iter().zip(&on_cpu.parameters.gaussians.groups) {
        let apart = apart(&own.values, &theirs.values);
        assert!(apart < 1e-6, "{}: {apart}", own.spec.name);
    }
    let moments = &stepped.tables.gaussians_adam;
    assert_eq!(moments.steps, 1);
    assert!(moments.second.group(FEATURES + 2).iter().all(|&v| v == 0.0), "frozen");
    assert!(apart(moments.second.group(0), on_cpu.gaussians_adam.second.group(0)) < 1e-6);
    let mut statistics = DensityStatistics::new(COUNT);
    let (projected, pixels) = (&expected.behind.projected, stepped.view.weight.len());
    statistics.add(projected, &expected.behind.splats, pixels);
    assert_eq!(stepped.tables.statistics.seen, statistics.seen);
    assert!(apart(&stepped.tables.statistics.gradient, &statistics.gradient) < 1e-3);
}
