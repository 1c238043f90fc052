//! `evpr member`: the ensemble of a running instance.

use crate::args::{InstanceArgs, MemberCommand, SetArgs, Setting};
use crate::failure::Failure;
use crate::output::say;
use evpr_runtime::{ControlRequest, MemberState, RunFolder};
use std::process::ExitCode;

/// `evpr member …`.
pub(crate) fn member(command: MemberCommand) -> Result<ExitCode, Failure> {
    let set = |members, enabled, weight, unload| ControlRequest::Set {
        members,
        enabled,
        weight,
        unload,
    };
    let (instance, request) = match command {
        MemberCommand::List(instance) => (instance, ControlRequest::List),
        MemberCommand::Enable(args) => (args.instance, set(args.members, Some(true), None, false)),
        MemberCommand::Disable(args) => (
            args.set.instance,
            set(args.set.members, Some(false), None, args.unload),
        ),
        MemberCommand::Weight(args) => (args.instance, set(args.members, None, Some(args.weight), false)),
    };
    ask(&instance, &request)
}

/// `evpr set`.
pub(crate) fn set(args: SetArgs) -> Result<ExitCode, Failure> {
    let (mut length, mut rule, mut deadline_ns, mut min_confidence) = (None, None, None, None);
    match args.setting {
        Setting::Length { ticks } => length = Some(ticks),
        Setting::Rule { rule: name } => rule = Some(name),
        Setting::Deadline { deadline } => deadline_ns = Some(deadline),
        Setting::MinConfidence { least } => min_confidence = Some(least),
    }
    let request = ControlRequest::Configure {
        length,
        rule,
        deadline_ns,
        min_confidence,
    };
    ask(&args.instance, &request)
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
                say!("{:<width$}  {:<8}  {}", m.name, state(m), m.weight);
            }
        }
        (_, Some(tick)) => say!("in force from tick {tick} on"),
        (ControlRequest::Status, _) => {}
        (_, None) => {
            say!("accepted, but no tick has opened since; it takes effect with the next one that does")
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// A member's state in a word.
pub(crate) fn state(member: &MemberState) -> &'static str {
    match (member.enabled, member.shed) {
        (true, _) => "enabled",
        (false, true) => "shed",
        (false, false) => "disabled",
    }
}
