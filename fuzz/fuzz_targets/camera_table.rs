#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    heliosplat_tests::readers::camera_table(bytes);
});
