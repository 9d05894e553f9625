//! The 50 golden RPCs: values from 40-digit arithmetic, bars of 1e-9 px for projection and 1e-8 px for localisation.

mod common;

use common::{distance_px, golden_camera, golden_rpcs, localisation_table, projection_table, shared};
use heliosplat_rpc::RpcError;

const PROJECTION_BAR_PX: f64 = 1e-9;
const LOCALISATION_BAR_PX: f64 = 1e-8;
/// The model that no tool localises (stated in its golden file).
const NOT_LOCALISABLE: &str = "erosb";

#[test]
fn every_golden_rpc_projects_and_localises_within_the_bars() {
    let Some(shared) = shared() else { return };
    let files = golden_rpcs(&shared);
    assert_eq!(files.len(), 50);
    println!("{:<28} {:>14} {:>20}", "camera", "projection px", "localisation px");
    let mut localised = 0;
    for (name, golden) in &files {
        let rpc = golden_camera(golden);
        let table = projection_table(golden);
        assert_eq!(table.len(), 125, "{name}");
        let projection_px = table
            .iter()
            .map(|(ground, image)| distance_px(rpc.project(*ground), *image))
            .fold(0.0, f64::max);
        assert!(
            projection_px < PROJECTION_BAR_PX,
            "{name}: projection off by {projection_px} px"
        );
        if name == NOT_LOCALISABLE {
            println!("{name:<28} {projection_px:>14.2e} {:>20}", "clear error");
            continue;
        }
        let mut localisation_px = 0.0_f64;
        for (image, truth) in localisation_table(golden) {
            let ground = rpc
                .localise(image, truth.height_m)
                .unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(ground.height_m, truth.height_m);
            localisation_px = localisation_px.max(distance_px(rpc.project(ground), image));
            // The same solution, not another branch of the model: 1e-9 degree is 0.1 mm.
            assert!(
                (ground.lon_deg - truth.lon_deg).abs() < 1e-9,
                "{name}: {ground:?} against {truth:?}"
            );
            assert!(
                (ground.lat_deg - truth.lat_deg).abs() < 1e-9,
                "{name}: {ground:?} against {truth:?}"
            );
        }
        println!("{name:<28} {projection_px:>14.2e} {localisation_px:>20.2e}");
        assert!(
            localisation_px < LOCALISATION_BAR_PX,
            "{name}: localisation off by {localisation_px} px"
        );
        localised += 1;
    }
    assert_eq!(localised, 49);
}

#[test]
fn a_model_that_contradicts_its_own_scales_is_a_clear_error_when_localised() {
    let Some(shared) = shared() else { return };
    let golden = common::golden(&shared, NOT_LOCALISABLE);
    let rpc = golden_camera(&golden);
    for (image, truth) in localisation_table(&golden) {
        match rpc.localise(image, truth.height_m) {
            Err(error @ RpcError::Inconsistent { span }) => {
                assert!(span > 3.0);
                assert!(error.to_string().contains("refitted RPC"), "{error}");
            }
            other => panic!("expected the inconsistency to be named, got {other:?}"),
        }
    }
}
