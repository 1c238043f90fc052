//! Prophesee's formats: real recordings, every trap with its right answer, and another decoder beside ours.
#![allow(clippy::unwrap_used)] // helpers of tests are not seen as tests

mod headers;
mod real;
mod streams;
mod traps;
mod words;
mod written;
