#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| evpr_fuzz::config::models(data));
