//! Who is enabled in the tick under way, and with which weight.

use evpr_core::MemberSet;
use evpr_core::plan::Plan;
use evpr_core::stage::IngestPort;

/// The members' settings, which change only where a tick opens.
#[derive(Debug)]
pub(crate) struct Enabled {
    pub(crate) members: MemberSet,
    pub(crate) weights: Vec<f64>,
    /// Of the control message in force.
    pub(crate) version: u64,
}

impl Enabled {
    /// As the plan starts.
    pub(crate) fn new(plan: &Plan) -> Self {
        Self {
            members: plan.enabled_members(),
            weights: plan.members.iter().map(|m| m.weight).collect(),
            version: 0,
        }
    }

    /// Takes the settings that hold from this tick on, which is about to open.
    pub(crate) fn follow(&mut self, tick: u64, port: &mut dyn IngestPort) {
        if let Some((version, settings)) = port.control(tick) {
            self.version = version;
            for (member, setting) in settings.iter().enumerate().take(self.weights.len()) {
                self.members.set(member, setting.enabled != 0);
                self.weights[member] = setting.weight;
            }
        }
    }
}
