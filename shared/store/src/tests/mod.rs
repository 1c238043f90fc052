//! Tests of recording, closing and opening together.

mod crash;
mod refusals;
mod round_trip;
