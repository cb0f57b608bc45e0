#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| saint_live_fuzz::cloud_file(data));
