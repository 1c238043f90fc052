//! Who is enabled in the tick under way, and with which weight.

use evpr_core::MemberSet;
use evpr_core::message::FuseSettings;
use evpr_core::plan::Plan;
use evpr_core::stage::IngestPort;

/// Per segment of the tick: the members whose windows cover it.
fn covering(plan: &Plan) -> Vec<MemberSet> {
    let segments = plan.slicing.segments();
    let per_tick = segments.per_tick();
    let mut covering = vec![MemberSet::default(); per_tick];
    for (index, member) in plan.members.iter().enumerate() {
        let Some(window) = segments.windows.get(member.window) else {
            continue;
        };
        for back in 0..window.len.min(per_tick) {
            covering[(window.last + per_tick - back) % per_tick].set(index, true);
        }
    }
    covering
}

/// The members' settings, which change only where a tick opens.
#[derive(Debug)]
pub(crate) struct Enabled {
    pub(crate) members: MemberSet,
    pub(crate) weights: Vec<f64>,
    /// The fuser's settings.
    pub(crate) fuse: FuseSettings,
    /// Of the control message in force.
    pub(crate) version: u64,
    /// Per segment of the tick: the members whose windows cover it, in this tick or reaching back from a later one.
    covering: Vec<MemberSet>,
}

impl Enabled {
    /// As the plan starts.
    pub(crate) fn new(plan: &Plan) -> Self {
        Self {
            members: plan.enabled_members(),
            weights: plan.members.iter().map(|m| m.weight).collect(),
            fuse: FuseSettings::default(),
            version: 0,
            covering: covering(plan),
        }
    }

    /// False when members would want the events of this segment, and all of them are off.
    pub(crate) fn want(&self, segment: usize) -> bool {
        let covering = self.covering.get(segment);
        covering.is_none_or(|c| c.is_empty() || c.iter().any(|m| self.members.contains(m)))
    }

    /// Takes the settings that hold from this tick on, which is about to open.
    pub(crate) fn follow(&mut self, tick: u64, port: &mut dyn IngestPort) {
        if let Some(settings) = port.control(tick) {
            self.version = settings.version;
            self.fuse = settings.fuse;
            for (member, setting) in settings.members.iter().enumerate().take(self.weights.len()) {
                self.members.set(member, setting.enabled != 0);
                self.weights[member] = setting.weight;
            }
        }
    }
}
