#![no_main]
// An image and what it is decoded into may be 64 MiB each.
libfuzzer_sys::fuzz_target!(init: evpr_fuzz::allow_mib(200), |data: &[u8]| evpr_fuzz::frames::image(data));
