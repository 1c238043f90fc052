//! Tests of recording, closing and opening together.

mod crash;
mod fail_points;
mod refusals;
mod round_trip;
