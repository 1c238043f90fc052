//! `evpr member`: the ensemble of a running instance.

use crate::args::{InstanceArgs, MemberCommand};
use crate::failure::Failure;
use crate::output::say;
use evpr_runtime::{ControlRequest, RunFolder};
use std::process::ExitCode;

/// `evpr member …`.
pub(crate) fn member(command: MemberCommand) -> Result<ExitCode, Failure> {
    let set = |members, enabled, weight| ControlRequest::Set {
        members,
        enabled,
        weight,
    };
    let (instance, request) = match command {
        MemberCommand::List(instance) => (instance, ControlRequest::List),
        MemberCommand::Enable(args) => (args.instance, set(args.members, Some(true), None)),
        MemberCommand::Disable(args) => (args.instance, set(args.members, Some(false), None)),
        MemberCommand::Weight(args) => (args.instance, set(args.members, None, Some(args.weight))),
    };
    ask(&instance, &request)
}

fn ask(instance: &InstanceArgs, request: &ControlRequest) -> Result<ExitCode, Failure> {
    let reply = evpr_runtime::request(&RunFolder::of_instance(&instance.name), request)?;
    if let Some(error) = reply.error {
        return Err(Failure::new(error));
    }
    if instance.json {
        say!("{}", serde_json::to_string(&reply)?);
        return Ok(ExitCode::SUCCESS);
    }
    match (request, reply.from_tick) {
        (ControlRequest::List, _) => {
            let width = reply.members.iter().map(|m| m.name.len()).max().unwrap_or(6);
            say!("{:<width$}  {:<8}  weight", "member", "state");
            for m in &reply.members {
                say!(
                    "{:<width$}  {:<8}  {}",
                    m.name,
                    if m.enabled { "enabled" } else { "disabled" },
                    m.weight
                );
            }
        }
        (ControlRequest::Set { .. }, Some(tick)) => say!("in force from tick {tick} on"),
        (ControlRequest::Status, _) => {}
        (ControlRequest::Set { .. }, None) => {
            say!("accepted, but no tick has opened since; it takes effect with the next one that does")
        }
    }
    Ok(ExitCode::SUCCESS)
}
