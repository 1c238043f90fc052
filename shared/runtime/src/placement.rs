//! A process takes the processors that the plan gives it.

use crate::RuntimeError;
use evpr_core::Plan;
use evpr_core::plan::Service;
use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::unistd::Pid;

/// Keeps this process to the processors that the plan gives it. Its first thread does so before it starts others, which
/// inherit it.
///
/// # Errors
/// One line: the machine has not these processors, or does not lend them.
pub fn use_processors(plan: &Plan, service: &Service) -> Result<(), RuntimeError> {
    let Some(placement) = plan.placement_of(service).filter(|p| !p.cpus.is_empty()) else {
        return Ok(());
    };
    let name = &service.name;
    let failed = |error: nix::Error| RuntimeError::Process(format!("the processors of {name}: {error}"));
    let this = Pid::from_raw(0);
    let lent = sched_getaffinity(this).map_err(failed)?;
    let has = |cpu: &usize| lent.is_set(*cpu).unwrap_or(false);
    if let Some(missing) = placement.cpus.iter().find(|cpu| !has(cpu)) {
        let there: Vec<String> = (0..CpuSet::count()).filter(has).map(|c| c.to_string()).collect();
        return Err(RuntimeError::Process(format!(
            "{name} cannot use processor {missing} of [[placement]]: here are {}; correct cpus",
            there.join(", ")
        )));
    }
    let mut wanted = CpuSet::new();
    for cpu in &placement.cpus {
        wanted.set(*cpu).map_err(failed)?;
    }
    sched_setaffinity(this, &wanted).map_err(failed)
}
