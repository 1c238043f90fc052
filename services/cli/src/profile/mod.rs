//! Looking into a running instance: traces, metrics, the live view.

pub(crate) mod metrics;
pub(crate) mod top;
pub(crate) mod trace;
