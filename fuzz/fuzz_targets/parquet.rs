#![no_main]
// Where the decoders of the crate `parquet` panic, that becomes an error.
libfuzzer_sys::fuzz_target!(
    init: evpr_fuzz::allow_panics_in("/parquet-"),
    |data: &[u8]| evpr_fuzz::events::parquet(data)
);
