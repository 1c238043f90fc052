//! The plan of one reconstruction of a recording.

use crate::args::{AlignArg, ReconstructArgs};
use crate::catalog::Networks;
use crate::commands::parse_sensor;
use crate::failure::Failure;
use evpr_core::Plan;
use evpr_core::config::{self, Overrides};
use evpr_core::plan::{Align, Origin, Sensor, Source};
use evpr_core::time::format_duration;
use evpr_events::agreed_sensor;
use std::fmt::Write;

/// The configuration that stands for the options, so that they are checked in one place.
fn as_config(args: &ReconstructArgs, sensor: Sensor) -> String {
    let mut text = String::new();
    let align = match args.align {
        AlignArg::Start => Align::Start,
        AlignArg::End => Align::End,
    };
    let origin = match args.origin {
        Origin::FirstEvent => "\"first_event\"".to_owned(),
        Origin::Grid(step) => format!("\"grid:{}\"", format_duration(step)),
        Origin::At(ns) => ns.to_string(),
    };
    let _ = writeln!(
        text,
        "[sensor]\nheight = {}\nwidth = {}",
        sensor.height, sensor.width
    );
    let _ = writeln!(text, "[slicing]\ntick = \"{}\"", format_duration(args.tick));
    let _ = writeln!(
        text,
        "windows = [\"{}\"]\nalign = \"{}\"",
        format_duration(args.window),
        align.name()
    );
    let _ = writeln!(text, "origin = {origin}");
    let _ = writeln!(
        text,
        "[[reconstruction]]\nid = \"frames\"\nkind = {:?}",
        args.method
    );
    let params: Vec<String> = args.param.iter().map(|p| as_toml(p)).collect();
    let _ = writeln!(text, "params = {{ {} }}", params.join(", "));
    let _ = writeln!(text, "[[extractor]]\nid = \"none\"\nkind = \"raw_pixels\"");
    text
}

/// `tau=50ms` as TOML: numbers stay numbers, everything else is a string.
fn as_toml(param: &str) -> String {
    let (name, value) = param.split_once('=').unwrap_or((param, ""));
    if value.parse::<f64>().is_ok() {
        format!("{name} = {value}")
    } else {
        format!("{name} = {value:?}")
    }
}

/// The plan of one method, window and tick.
pub(super) fn offline_plan(args: &ReconstructArgs) -> Result<Plan, Failure> {
    let given = args.sensor.as_deref().map(parse_sensor).transpose()?;
    let source = Source::file(&args.input);
    let said = evpr_ingest::probe(&source)?;
    let sensor = agreed_sensor(&args.input, said, given)?.ok_or_else(|| {
        Failure::new(format!(
            "{} does not tell the sensor's size; give it with --sensor HEIGHTxWIDTH",
            args.input.display()
        ))
    })?;
    let networks = Networks::read(&args.models)?;
    let text = as_config(args, sensor);
    let config = config::parse(&text, "command line", &networks.catalog()).map_err(Failure::usage)?;
    let overrides = Overrides {
        input: Some(args.input.clone()),
        ..Overrides::default()
    };
    let mut plan = config.resolve(sensor, &overrides).map_err(Failure::usage)?;
    let source = &mut plan.source;
    source.on_backward_time = args.bad.on_backward_time.unwrap_or(source.on_backward_time);
    source.on_outside_sensor = args.bad.on_outside_sensor.unwrap_or(source.on_outside_sensor);
    Ok(plan)
}
