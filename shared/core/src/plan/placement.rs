//! Where on the machine processes run.

use super::{Plan, Service};
use serde::{Deserialize, Serialize};

/// Where a process, or every process of a kind, runs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Placement {
    /// The process's name (`extract/mixvpr`), or a kind of processes (`extract`).
    pub process: String,
    /// The processors (as the system numbers them) that it may use; empty: all.
    pub cpus: Vec<usize>,
    /// What starts the process, with its arguments; empty: nothing but the supervisor.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub launcher: Vec<String>,
}

impl std::fmt::Display for Placement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let cpus: Vec<String> = self.cpus.iter().map(usize::to_string).collect();
        let cpus = (!cpus.is_empty()).then(|| format!("cpus {}", cpus.join(" ")));
        let launcher = (!self.launcher.is_empty()).then(|| format!("started by {}", self.launcher.join(" ")));
        let said: Vec<String> = cpus.into_iter().chain(launcher).collect();
        write!(f, "{}: {}", self.process, said.join(", "))
    }
}

impl Plan {
    /// Where this process runs, if the plan says: what is said of it goes before what is said of its kind.
    pub fn placement_of(&self, service: &Service) -> Option<&Placement> {
        let of = |name: &str| self.placements.iter().find(|p| p.process == name);
        of(&service.name).or_else(|| of(service.kind.name()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::test_plan;

    #[test]
    fn a_process_goes_before_its_kind() {
        let mut plan = test_plan();
        let placement = |process: &str, cpu| Placement {
            process: process.to_owned(),
            cpus: vec![cpu],
            launcher: Vec::new(),
        };
        plan.placements = vec![placement("reconstruct", 1), placement("reconstruct/b", 2)];
        let services = plan.services();
        let cpu = |name: &str| {
            let service = services.iter().find(|s| s.name == name).unwrap();
            plan.placement_of(service).map(|p| p.cpus[0])
        };
        assert_eq!(cpu("reconstruct/a"), Some(1));
        assert_eq!(cpu("reconstruct/b"), Some(2));
        assert_eq!(cpu("ingest"), None);
    }

    #[test]
    fn services_are_as_many_as_are_counted() {
        let mut plan = test_plan();
        for dashboard in [false, true] {
            plan.dashboard = dashboard;
            assert_eq!(plan.services().len(), plan.service_count());
        }
    }
}
