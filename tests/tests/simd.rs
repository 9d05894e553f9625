//! The same bytes for any instruction set: a whole training under each cap.

use heliosplat::simd::VARIABLE;
use heliosplat_tests::program::{heliosplat, json};

#[test]
fn a_training_gives_the_same_bytes_with_every_instruction_set() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("an UTF-8 path").to_owned();
    let scene = path("scene");
    json(&["synth", "satellite", "--site", "tiny", "--seed", "3", "--out", &scene]);
    // A cap above the processor's level changes nothing.
    let models = ["sse2", "avx2", "avx512"].map(|level| {
        let run = path(level);
        let train = [
            "train",
            &scene,
            "--out",
            &run,
            "--preset",
            "fast",
            "--set",
            "train.iterations=30",
            "--json",
        ];
        heliosplat(&train).env(VARIABLE, level).assert().success();
        std::fs::read(folder.path().join(level).join("model.ply")).expect("the run has a model")
    });
    assert!(models[0].len() > 10_000);
    assert!(models[0] == models[1], "SSE2 and AVX2 differ");
    assert!(models[1] == models[2], "AVX2 and the best of this processor differ");
}
