//! Both estimates of the images' pointing on synthetic scenes, against the biases they were made with:
//! `cargo run --release --example compare_pointing -- SCENE...`

use heliosplat_pipelines::satellite::adjust::{AdjustInput, ground, shifts, truth::camera_error};
use heliosplat_pipelines::scene::Scene;
use heliosplat_rpc::adjust::BiasModel;
use heliosplat_stereo::align::estimate_shifts;
use std::path::PathBuf;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for scene in std::env::args_os().skip(1).map(PathBuf::from) {
        let read = Scene::open(&scene, &Default::default())?;
        let ground = ground(&read)?;
        let rasters = ground.rasters();
        let views = ground.sweep_views(&rasters, &vec![[0.0; 2]; rasters.len()]);
        let say = |method: &str, shifts_px: &[[f32; 2]], begun: Instant| {
            let seconds = begun.elapsed().as_secs_f64();
            let shifts_px: Vec<[f64; 2]> = shifts_px.iter().map(|s| s.map(f64::from)).collect();
            match camera_error(&scene, &ground.images, &read.frame, &shifts_px) {
                Some(error) => println!(
                    "{} {method}: rms {:.3} -> {:.3} px, largest {:.3}, {seconds:.1} s",
                    scene.display(),
                    error.before_rms_px,
                    error.after_rms_px,
                    error.after_max_px
                ),
                None => println!("{} {method}: no truth, {seconds:.1} s", scene.display()),
            }
        };
        let begun = Instant::now();
        let input = AdjustInput {
            ground: &ground,
            views: &views,
            cell_m: read.gsd_m,
        };
        let adjustment = input.adjust(BiasModel::Translation, &|_| {})?;
        say("ties", &shifts(&adjustment), begun);
        let begun = Instant::now();
        say("shifts", &estimate_shifts(&views, &ground.request(read.gsd_m)), begun);
    }
    Ok(())
}
