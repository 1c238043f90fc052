//! Positions: fills in where the camera was when a tick opens, on the way to the port.

use evpr_core::message::{ChunkHeader, Event, LiveStats, TickHeader, TickKind};
use evpr_core::stage::{IngestPort, OpenedTick, Settings, StageError};
use evpr_events::Trajectory;

/// A port behind which the openings of ticks carry a position.
///
/// The position is that of the tick's start, which in count mode is its first event. It is asked for at the start as
/// the header has it, so truncated to whole µs.
pub(crate) struct Placed<'a> {
    pub(crate) port: &'a mut dyn IngestPort,
    pub(crate) trajectory: Option<Box<dyn Trajectory>>,
}

impl IngestPort for Placed<'_> {
    fn now_ns(&self) -> u64 {
        self.port.now_ns()
    }

    fn chunk(
        &mut self,
        header: ChunkHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [Event]),
    ) -> Result<(), StageError> {
        self.port.chunk(header, len, fill)
    }

    fn tick(&mut self, mut header: TickHeader, weights: &[f64]) -> Result<(), StageError> {
        if let Some(trajectory) = &mut self.trajectory
            && header.kind == TickKind::Open as u32
            && let Some(position) = trajectory.position(header.start_us.saturating_mul(1_000))
        {
            [header.east_m, header.north_m] = position;
        }
        self.port.tick(header, weights)
    }

    fn control(&mut self, tick: u64) -> Option<Settings> {
        self.port.control(tick)
    }

    fn wait_until(&mut self, ns: u64) -> Result<(), StageError> {
        self.port.wait_until(ns)
    }

    fn rests(&mut self) {
        self.port.rests();
    }

    fn progress(&mut self, permille: u64, next_tick: u64, events: u64, skipped: u64) {
        self.port.progress(permille, next_tick, events, skipped);
    }

    fn live(&mut self, stats: LiveStats) {
        self.port.live(stats);
    }

    fn opened_before(&self) -> Option<OpenedTick> {
        self.port.opened_before()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::KeptPort;
    use evpr_core::plan::{Sensor, SliceMode, Source, Street};

    /// 1 m per µs to the east, known up to 5 µs.
    struct Line;

    impl Trajectory for Line {
        fn position(&mut self, t_ns: u64) -> Option<[f64; 2]> {
            (t_ns <= 5_000).then_some([t_ns as f64 / 1e3, -2.0])
        }
    }

    fn positions(trajectory: Option<Box<dyn Trajectory>>) -> Vec<Option<[f64; 2]>> {
        let mut port = KeptPort::default();
        let mut placed = Placed {
            port: &mut port,
            trajectory,
        };
        for (kind, start_us) in [
            (TickKind::Open, 3),
            (TickKind::Close, 3),
            (TickKind::Open, 6),
            (TickKind::End, 4),
        ] {
            let header = TickHeader {
                start_us,
                kind: kind as u32,
                ..TickHeader::default()
            };
            placed.tick(header, &[]).unwrap();
        }
        port.ticks().map(|(_, header)| header.position()).collect()
    }

    #[test]
    fn openings_carry_the_position_where_it_is_known() {
        assert_eq!(
            positions(Some(Box::new(Line))),
            [Some([3.0, -2.0]), None, None, None]
        );
        assert_eq!(positions(None), [None; 4]);
    }

    /// The street knows where its camera is, however ticks are measured.
    #[test]
    fn counted_ticks_of_the_street_carry_positions() {
        let mut plan = evpr_core::plan::test_plan();
        plan.sensor = Sensor {
            height: 30,
            width: 40,
        };
        plan.source = Source::street(Street {
            length_m: 20.0,
            sensor: plan.sensor,
            ..Street::default()
        });
        plan.slicing.mode = SliceMode::Count;
        (plan.slicing.tick, plan.slicing.windows) = (1_000, vec![250, 1_000]);
        let mut port = KeptPort::default();
        let (_keep, stop) = crossbeam::channel::bounded(0);
        let summary = crate::Ingest::new(&plan, 0, 1, stop)
            .unwrap()
            .run(&mut port)
            .unwrap();
        let mut truth = crate::open(&plan.source).unwrap().trajectory().unwrap();
        let opened: Vec<_> = port.ticks().filter(|(kind, _)| *kind == TickKind::Open).collect();
        assert!(opened.len() as u64 >= summary.end_tick && summary.end_tick > 5);
        let mut before_m = -1.0;
        for (_, header) in &opened {
            let position = header.position();
            assert_eq!(position, truth.position(header.start_us * 1_000));
            let [east_m, _] = position.unwrap();
            assert!(east_m > before_m && east_m <= 20.5, "{east_m} after {before_m}");
            before_m = east_m;
        }
        assert!(before_m > 10.0, "{before_m}");
    }
}
