//! The part of a recording that its positions cover.

use crate::{RawEvent, SourceError};
use evpr_core::plan::{Crop, Plan};
use evpr_events::positions::Track;
use evpr_events::seconds;
use std::ops::Range;
use std::path::PathBuf;

/// Sensor times of a recording's positions, and whether what lies outside of them is left out. Without positions there
/// is nothing to leave out.
#[derive(Debug, Clone, Default)]
pub(crate) struct Span {
    known_ns: Option<Range<u64>>,
    cropped: bool,
    /// Whether the recording has begun; later it may also go on behind these times, as after a restart.
    begun: bool,
    /// Whether the recording has come to these times.
    met: bool,
    path: PathBuf,
}

impl Span {
    pub(crate) fn new(plan: &Plan, track: Option<&Track>) -> Self {
        let sensor_time = |ns: i64| u64::try_from(ns).unwrap_or(0);
        let span = track.and_then(Track::span_ns);
        let positions = plan.source.positions.as_ref();
        Self {
            // The last position is one of them.
            known_ns: span.map(|(first, last)| sensor_time(first)..sensor_time(last).saturating_add(1)),
            cropped: positions.is_some_and(|p| p.crop != Crop::None),
            begun: false,
            met: false,
            path: plan.source.path.clone(),
        }
    }

    /// Leaves out what is to be left out of events whose times do not go back. True when no more can come.
    ///
    /// # Errors
    /// When the recording begins after the last position.
    pub(crate) fn apply(&mut self, events: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        let Some(known) = &self.known_ns else {
            return Ok(false);
        };
        let (Some(first), Some(last)) = (events.first(), events.last()) else {
            return Ok(false);
        };
        if !self.begun && first.t_ns >= known.end {
            let (end, first) = (seconds(known.end - 1), seconds(first.t_ns));
            return Err(self.apart(format!(
                "its positions end at {end}, before its events at {first}"
            )));
        }
        self.begun = true;
        self.met |= last.t_ns >= known.start;
        if !self.cropped {
            return Ok(false);
        }
        let over = last.t_ns >= known.end;
        events.truncate(events.partition_point(|e| e.t_ns < known.end));
        events.drain(..events.partition_point(|e| e.t_ns < known.start));
        Ok(over)
    }

    /// Says whether the recording may end.
    ///
    /// # Errors
    /// When it has not come to its positions.
    pub(crate) fn end(&self) -> Result<(), SourceError> {
        match &self.known_ns {
            Some(known) if !self.met => {
                let begin = seconds(known.start);
                Err(self.apart(format!("its events end before its positions begin at {begin}")))
            }
            _ => Ok(()),
        }
    }

    fn apart(&self, what: String) -> SourceError {
        let what = format!("{what}; correct positions.offset or positions.first_at");
        SourceError::malformed(&self.path, what)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn span() -> Span {
        Span {
            known_ns: Some(10..20),
            ..Span::default()
        }
    }

    fn at(t_ns: u64) -> Vec<RawEvent> {
        vec![RawEvent {
            t_ns,
            ..RawEvent::default()
        }]
    }

    #[test]
    fn only_the_recordings_beginning_may_not_lie_behind_its_positions() {
        assert!(span().apply(&mut at(20)).is_err());
        // Taken up again behind them, after a look at the beginning.
        let mut taken_up = span();
        assert!(!taken_up.apply(&mut at(1)).unwrap());
        assert!(taken_up.end().is_err());
        assert!(!taken_up.apply(&mut at(25)).unwrap());
        assert!(taken_up.end().is_ok());
    }
}
