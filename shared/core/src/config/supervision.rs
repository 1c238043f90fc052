//! `[supervision]`: when a process is killed, started again, and given up.

use super::reader::Table;
use super::schema::key;
use crate::plan::Supervision;

/// Processes speak up once per second: below this, a busy machine looks like one that hangs.
const SHORTEST_NS: u64 = 2_000_000_000;

/// `[supervision]`.
pub(super) fn supervision(table: Table<'_>) -> Option<Supervision> {
    let planned = Supervision::default();
    let long = |name, default, planned, doc| {
        table.read(key(name, "duration", Some(default), doc), planned, |v| {
            match v.duration_ns()? {
                ns if ns < SHORTEST_NS => {
                    v.refuse("is too short: processes speak up once per second; write at least \"2s\"")
                }
                ns => Some(ns),
            }
        })
    };
    let hang_ns = long(
        "hang",
        "\"10s\"",
        planned.hang_ns,
        "A process that says nothing for so long, or is busy with one message for so long, is killed and started again.",
    );
    let network_ns = long(
        "network",
        "\"60s\"",
        planned.network_ns,
        "The same for being busy where a network is computed: longer than the slowest inference.",
    );
    let loading_ns = long(
        "loading",
        "\"120s\"",
        planned.loading_ns,
        "How long a process may take from its start until it is ready, its network loaded.",
    );
    let deaths = table.read(
        key(
            "deaths",
            "whole number from 1 to 60",
            Some("10"),
            "With more deaths than this within a minute a process is given up.",
        ),
        i64::from(planned.deaths_per_minute),
        |v| v.integer(1..=60),
    );
    table.close();
    Some(Supervision {
        hang_ns: hang_ns?,
        network_ns: network_ns?,
        loading_ns: loading_ns?,
        deaths_per_minute: deaths? as u32,
    })
}
