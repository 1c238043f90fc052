//! `evpr validate` and `evpr graph`.

use crate::args::{ConfigArgs, GraphArgs};
use crate::catalog;
use crate::failure::Failure;
use crate::output::say;
use evpr_core::Plan;
use evpr_core::config::Overrides;
use evpr_core::plan::{Network, Placement, ServiceKind};
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;

/// `evpr validate`.
pub(crate) fn validate(args: &ConfigArgs) -> Result<ExitCode, Failure> {
    let config = catalog::load(&args.config)?;
    say!(
        "{}: ok, {} members",
        args.config.display(),
        config.members().len()
    );
    Ok(ExitCode::SUCCESS)
}

#[derive(Debug, Serialize)]
struct ChannelRow {
    channel: String,
    publishers: usize,
    subscribers: usize,
    buffer: usize,
    message_bytes: usize,
    reserved_bytes: usize,
    delivery: &'static str,
}

/// A network, and what its process may use of the machine.
#[derive(Debug, Serialize)]
struct NetworkRow {
    process: String,
    model: String,
    threads: usize,
    /// The most frames computed at once; none: as the provider gains from it.
    batch: Option<usize>,
    optional: bool,
}

fn networks(plan: &Plan) -> Vec<NetworkRow> {
    let network = |process: String, network: &Option<Network>, optional: bool| {
        network.as_ref().map(|network| NetworkRow {
            process,
            model: network.model.id.clone(),
            threads: network.threads,
            batch: network.batch,
            optional,
        })
    };
    let services = plan.services().into_iter();
    let rows = services.filter_map(|service| match service.kind {
        ServiceKind::Reconstruct => {
            let r = &plan.reconstructions[service.index];
            network(service.name, &r.network, r.optional)
        }
        ServiceKind::Extract => {
            let e = &plan.extractors[service.index];
            network(service.name, &e.network, e.optional)
        }
        _ => None,
    });
    rows.collect()
}

#[derive(Debug, Serialize)]
struct GraphReport {
    sensor: evpr_core::plan::Sensor,
    tick: String,
    windows: Vec<String>,
    processes: Vec<String>,
    networks: Vec<NetworkRow>,
    placements: Vec<Placement>,
    members: Vec<String>,
    channels: Vec<ChannelRow>,
    shared_memory_bytes: u64,
    shared_memory_free_bytes: u64,
}

fn report(plan: &Plan) -> Result<GraphReport, Failure> {
    let room = evpr_runtime::room(plan)?;
    let channels = plan.channels().into_iter().map(|c| ChannelRow {
        channel: c.topic.to_string(),
        publishers: c.publishers,
        subscribers: c.max_subscribers,
        buffer: c.buffer,
        message_bytes: c.max_items * c.item_bytes + c.header_bytes,
        reserved_bytes: c.bytes(),
        delivery: if c.waits { "waits" } else { "newest wins" },
    });
    Ok(GraphReport {
        sensor: plan.sensor,
        tick: plan.slicing.tick_id(),
        windows: (0..plan.slicing.windows.len())
            .map(|w| plan.slicing.window_id(w))
            .collect(),
        processes: plan.services().into_iter().map(|s| s.name).collect(),
        networks: networks(plan),
        placements: plan.placements.clone(),
        members: plan.members.iter().map(|m| m.name.clone()).collect(),
        channels: channels.collect(),
        shared_memory_bytes: room.needed,
        shared_memory_free_bytes: room.free,
    })
}

/// `evpr graph`.
pub(crate) fn graph(args: &GraphArgs) -> Result<ExitCode, Failure> {
    // A graph with everything: a fuser and a recorder, whatever they will read and write.
    let overrides = Overrides {
        input: args.input.clone(),
        map: Some(PathBuf::from("map")),
        record: Some(PathBuf::from("record")),
        ..Overrides::default()
    };
    let plan = catalog::plan(&args.config.config, &overrides)?;
    let report = report(&plan)?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&report)?);
        return Ok(ExitCode::SUCCESS);
    }
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    say!("sensor     {}", report.sensor);
    say!("tick       {}, windows {}", report.tick, report.windows.join(" "));
    say!("processes  {}", report.processes.join("  "));
    for network in &report.networks {
        let plural = if network.threads == 1 { "" } else { "s" };
        say!(
            "network    {}: {}, {} thread{plural}{}",
            network.process,
            network.model,
            network.threads,
            if network.optional { ", optional" } else { "" }
        );
    }
    for placement in &report.placements {
        say!("placement  {placement}");
    }
    say!("members    {}", report.members.len());
    for member in &report.members {
        say!("  {member}");
    }
    say!();
    let width = report.channels.iter().map(|c| c.channel.len()).max().unwrap_or(7);
    say!(
        "{:<width$}  {:>4}  {:>4}  {:>6}  {:>13}  {:>12}  delivery",
        "channel",
        "pubs",
        "subs",
        "buffer",
        "message bytes",
        "reserved MiB"
    );
    for c in &report.channels {
        say!(
            "{:<width$}  {:>4}  {:>4}  {:>6}  {:>13}  {:>12.2}  {}",
            c.channel,
            c.publishers,
            c.subscribers,
            c.buffer,
            c.message_bytes,
            mib(c.reserved_bytes as u64),
            c.delivery
        );
    }
    say!(
        "\nshared memory: {:.1} MiB needed at most, {:.1} MiB free in /dev/shm",
        mib(report.shared_memory_bytes),
        mib(report.shared_memory_free_bytes)
    );
    Ok(ExitCode::SUCCESS)
}
