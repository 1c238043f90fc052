//! How long a process may stand still, and how often it may die.

use serde::{Deserialize, Serialize};

/// When a process is killed and started again, and when it is given up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Supervision {
    /// A process that says nothing for so long, or is busy with one message for so long, hangs, ns. Processes speak up
    /// every second.
    pub hang_ns: u64,
    /// The same for being busy, where a network may be at work, ns.
    pub network_ns: u64,
    /// How long a process may take from its start until it is ready, ns.
    pub loading_ns: u64,
    /// With more deaths than this within a minute a process is given up.
    pub deaths_per_minute: u32,
}

impl Default for Supervision {
    fn default() -> Self {
        const SECOND: u64 = 1_000_000_000;
        Self {
            hang_ns: 10 * SECOND,
            network_ns: 60 * SECOND,
            loading_ns: 120 * SECOND,
            deaths_per_minute: 10,
        }
    }
}
