//! All numbers of a demonstration: as `results.json`, and as a table for people.

use super::latency::Latency;
use super::recall::{EnsembleRecall, KindRecall, kind_title};
use crate::output::say;
use evpr_core::Plan;
use evpr_core::plan::StreetPass;
use evpr_evaluate::SubsetKind;
use serde::Serialize;

/// Version of the layout of `results.json`.
const VERSION: u32 = 1;

/// One drive.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct PassResult {
    pub(crate) pass: StreetPass,
    /// Ticks that were recorded or answered.
    pub(crate) ticks: usize,
    pub(crate) events: u64,
    /// What the graph took for it, simulation included, seconds.
    pub(crate) took_s: f64,
    /// Ticks that the running graph answered with the same place as the evaluation did from the recorded rows; none of
    /// the drive that is mapped.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) equal_answers: Option<usize>,
}

/// What was run.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Scene {
    pub(crate) seed: u32,
    pub(crate) quick: bool,
    pub(crate) length_m: f64,
    pub(crate) speed_m_s: f64,
    pub(crate) sensor: evpr_core::plan::Sensor,
    pub(crate) tick: String,
    pub(crate) windows: Vec<String>,
    pub(crate) reconstructions: Vec<String>,
    pub(crate) extractors: Vec<String>,
    pub(crate) members: usize,
    /// Sequence length L, ticks.
    pub(crate) sequence_length: usize,
    /// How far from the query a right answer may lie, metres.
    pub(crate) tolerance_m: f64,
    /// What the largest of its plans may need.
    pub(crate) shared_memory_bytes: u64,
}

impl Scene {
    /// Of the plan of a drive that is matched and recorded.
    pub(crate) fn of(plan: &Plan, seed: u32, quick: bool) -> Result<Self, evpr_runtime::RuntimeError> {
        let street = plan.source.street.clone().unwrap_or_default();
        Ok(Self {
            seed,
            quick,
            length_m: street.length_m,
            speed_m_s: street.speed_m_s,
            sensor: plan.sensor,
            tick: plan.slicing.tick_id(),
            windows: (0..plan.slicing.windows.len())
                .map(|w| plan.slicing.window_id(w))
                .collect(),
            reconstructions: plan.reconstructions.iter().map(|r| r.id.clone()).collect(),
            extractors: plan.extractors.iter().map(|e| e.id.clone()).collect(),
            members: plan.members.len(),
            sequence_length: plan.fuse.length,
            tolerance_m: super::recall::TOLERANCE_M,
            shared_memory_bytes: evpr_runtime::room(plan)?.needed,
        })
    }
}

/// Everything that was measured.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Results {
    format: &'static str,
    version: u32,
    evpr: &'static str,
    pub(crate) scene: Scene,
    pub(crate) passes: Vec<PassResult>,
    pub(crate) recall: Vec<KindRecall>,
    pub(crate) latency: Latency,
    /// All of it, the pictures included, seconds.
    pub(crate) took_s: f64,
}

impl Results {
    pub(crate) fn new(
        scene: Scene,
        passes: Vec<PassResult>,
        recall: Vec<KindRecall>,
        latency: Latency,
    ) -> Self {
        Self {
            format: "evpr demo",
            version: VERSION,
            evpr: env!("CARGO_PKG_VERSION"),
            scene,
            passes,
            recall,
            latency,
            took_s: 0.0,
        }
    }

    /// The lengths of sequences that were measured, longest first.
    pub(crate) fn lengths(&self) -> Vec<usize> {
        let mut lengths: Vec<usize> = self.recall.iter().map(|r| r.length).collect();
        lengths.sort_unstable_by(|a, b| b.cmp(a));
        lengths.dedup();
        lengths
    }

    /// Recall of a kind of ensembles on a drive.
    pub(crate) fn recall_of(&self, kind: SubsetKind, pass: StreetPass, length: usize) -> Option<&KindRecall> {
        let mut recall = self.recall.iter();
        recall.find(|r| r.kind == kind && r.pass == pass && r.length == length)
    }

    /// How the ensemble of a kind that is best by day does by night: what one gets who chooses by day. Of equals the
    /// first of the plan.
    pub(crate) fn chosen_by_day(&self, kind: SubsetKind, length: usize) -> Option<&EnsembleRecall> {
        let chosen = self.recall_of(kind, StreetPass::Day2, length)?.best()?;
        let by_night = self.recall_of(kind, StreetPass::Night, length)?;
        by_night.ensembles.iter().find(|e| e.name == chosen.name)
    }

    /// Prints the numbers for a person.
    pub(crate) fn show(&self) {
        for length in self.lengths() {
            self.show_recall(length);
        }
        self.show_latency();
    }

    fn show_recall(&self, length: usize) {
        let (tolerance_m, ticks) = (self.scene.tolerance_m, |pass| {
            let recall = self.recall_of(SubsetKind::Combined, pass, length);
            recall.map_or(0, |r| r.ticks)
        });
        let sequences = match length {
            1 => "each tick alone".to_owned(),
            n => format!("sequences of {n} ticks"),
        };
        say!("Recall@1 within {tolerance_m} m, {sequences}");
        let day = format!("day ({} ticks)", ticks(StreetPass::Day2));
        let night = format!("night ({} ticks)", ticks(StreetPass::Night));
        say!("  {:<24}{day:>18}{night:>32}", "");
        say!(
            "  {:<24}{:>10}{:>8}{:>12}{:>8}{:>12}",
            "ensembles",
            "best",
            "mean",
            "best",
            "mean",
            "day's best"
        );
        for kind in SubsetKind::PAPER {
            let of = |pass| self.recall_of(kind, pass, length);
            let (Some(day), Some(night)) = (of(StreetPass::Day2), of(StreetPass::Night)) else {
                continue;
            };
            let share = |recall: Option<&EnsembleRecall>| recall.map_or(0.0, |e| e.recall_at_1);
            say!(
                "  {:<24}{:>10.3}{:>8.3}{:>12.3}{:>8.3}{:>12.3}",
                format!("{} ({})", kind_title(kind), day.ensembles.len()),
                share(day.best()),
                day.mean,
                share(night.best()),
                night.mean,
                share(self.chosen_by_day(kind, length))
            );
        }
        say!();
    }

    fn show_latency(&self) {
        let latency = &self.latency;
        let load = latency
            .load_1min
            .map_or_else(String::new, |l| format!(", load {l:.2}"));
        say!(
            "Latency after the end of a tick, ms ({} ticks in real time, {} members, {:.0} k events/s, {} cores{load})",
            latency.ticks,
            latency.members,
            latency.events_per_s / 1e3,
            latency.cores
        );
        say!("  {:<24}{:>10}{:>10}", "stage", "median", "slowest");
        for stage in &latency.stages {
            let (median, slowest) = (stage.median_us / 1e3, stage.slowest_us / 1e3);
            say!("  {:<24}{median:>10.3}{slowest:>10.3}", stage.stage);
        }
    }
}
