#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    heliosplat_tests::readers::patch_ties(bytes);
});
