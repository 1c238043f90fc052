//! Looking into a running instance: traces, metrics, the live view.

pub(crate) mod metrics;
pub(crate) mod trace;
