//! Which segments are held whole, and in which slot of the method.

use evpr_core::Reason;
use evpr_core::plan::{SegmentPlan, WindowSpan};

/// The segments that windows can still be put together from.
///
/// In general each segment has a slot of the method to itself, and a window is rendered from its segments' slots. Where
/// all windows begin with their tick, one slot is enough: it holds the tick's segments so far, which is the very window
/// that closes with the latest of them. That saves clearing and summing whole planes.
#[derive(Debug)]
pub(crate) struct Held {
    /// Entry g mod length is for segment g, counted from the start of the recording.
    segments: Vec<Segment>,
    /// Segments per tick, where they share one slot.
    shared: Option<u64>,
    under_way: Option<UnderWay>,
    /// Where segments share a slot: it holds what its tick has up to and with this segment, and nothing else.
    shared_up_to: Option<u64>,
}

/// What is known of a segment.
#[derive(Debug, Clone, Copy, Default)]
struct Segment {
    /// The segment that was seen whole, counted from the start of the recording.
    whole: Option<u64>,
    /// The segment of which events are known to be missing, and why.
    lost: Option<(u64, Reason)>,
    /// Events entered.
    events: u64,
}

/// The segment under way, whole so far.
#[derive(Debug, Clone, Copy)]
struct UnderWay {
    segment: u64,
    next_seq: u64,
}

impl Held {
    /// For these windows of the plan.
    pub(crate) fn new(plan: &SegmentPlan, windows: &[WindowSpan]) -> Self {
        let longest = windows.iter().map(|w| w.len).max().unwrap_or(0);
        let with_the_tick = windows.iter().all(|w| w.len == w.last + 1);
        Self {
            segments: vec![Segment::default(); longest],
            shared: with_the_tick.then_some(plan.per_tick() as u64),
            under_way: None,
            shared_up_to: None,
        }
    }

    /// How many slots the method needs.
    pub(crate) fn slots(&self) -> usize {
        match self.shared {
            Some(_) => self.segments.len().min(1),
            None => self.segments.len(),
        }
    }

    /// Holds nothing any more.
    pub(crate) fn forget(&mut self) {
        self.segments.fill(Segment::default());
        self.under_way = None;
        self.shared_up_to = None;
    }

    /// The segment under way will not be whole.
    pub(crate) fn break_off(&mut self) {
        self.under_way = None;
    }

    /// Holds a segment no longer, and none that is under way.
    pub(crate) fn drop_segment(&mut self, segment: u64) {
        self.under_way = None;
        for held in &mut self.segments {
            if held.whole == Some(segment) {
                *held = Segment::default();
            }
        }
        if self.shared_up_to == Some(segment) {
            self.shared_up_to = None;
        }
    }

    /// Events of this segment are missing: nothing that covers it is whole.
    pub(crate) fn lose(&mut self, segment: u64, reason: Reason) {
        self.break_off();
        self.shared_up_to = None;
        let entry = self.entry(segment);
        if let Some(held) = self.segments.get_mut(entry) {
            *held = Segment {
                lost: Some((segment, reason)),
                ..Segment::default()
            };
        }
    }

    /// Entry of a segment; only asked where there is one.
    fn entry(&self, segment: u64) -> usize {
        (segment % self.segments.len().max(1) as u64) as usize
    }

    fn slot(&self, segment: u64) -> usize {
        if self.shared.is_some() {
            0
        } else {
            self.entry(segment)
        }
    }

    /// Begins a segment with the chunk of this number. Gives the slot to be cleared for it, if any.
    pub(crate) fn open(&mut self, segment: u64, seq: u64) -> Option<usize> {
        self.under_way = None;
        let entry = self.entry(segment);
        self.segments[entry] = Segment::default();
        let begins = self
            .shared
            .is_none_or(|per_tick| segment.is_multiple_of(per_tick));
        let continues = segment
            .checked_sub(1)
            .is_some_and(|before| self.shared_up_to == Some(before));
        self.shared_up_to = None;
        if begins || continues {
            let next_seq = seq;
            self.under_way = Some(UnderWay { segment, next_seq });
        }
        begins.then(|| self.slot(segment))
    }

    /// The slot for the events of this chunk, as long as its segment is whole so far.
    pub(crate) fn slot_for(&mut self, segment: u64, seq: u64) -> Option<usize> {
        let whole = |u: &UnderWay| u.segment == segment && u.next_seq == seq;
        self.under_way = self.under_way.filter(whole);
        let under_way = self.under_way.as_mut()?;
        under_way.next_seq = seq.wrapping_add(1);
        Some(self.slot(segment))
    }

    /// So many events were entered into the segment under way.
    pub(crate) fn add(&mut self, segment: u64, events: u64) {
        let entry = self.entry(segment);
        self.segments[entry].events += events;
    }

    /// The segment under way is whole.
    pub(crate) fn close(&mut self, segment: u64) {
        let entry = self.entry(segment);
        self.segments[entry].whole = Some(segment);
        self.under_way = None;
        self.shared_up_to = Some(segment);
    }

    /// Puts a window of `len` segments together that ends with segment `last`: its slots, in stream order, into `slots`.
    /// Gives the number of events.
    ///
    /// # Errors
    /// Why there is no image.
    pub(crate) fn window(&self, last: u64, len: usize, slots: &mut Vec<usize>) -> Result<u64, Reason> {
        slots.clear();
        let first = last
            .saturating_add(1)
            .checked_sub(len as u64)
            .ok_or(Reason::BeforeStart)?;
        let mut events = 0;
        for segment in first..=last {
            let held = self.segments[self.entry(segment)];
            if let Some((_, reason)) = held.lost.filter(|(lost, _)| *lost == segment) {
                return Err(reason);
            }
            if held.whole != Some(segment) {
                return Err(Reason::IncompleteWindow);
            }
            slots.push(self.slot(segment));
            events += held.events;
        }
        if self.shared.is_some() {
            slots.truncate(1);
            if self.shared_up_to != Some(last) {
                return Err(Reason::IncompleteWindow);
            }
        }
        if events == 0 {
            return Err(Reason::EmptyWindow);
        }
        Ok(events)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::{Align, Slicing, test_plan};

    /// Windows of 1, 2 and 4 in ticks of 4.
    fn held(align: Align) -> Held {
        let slicing = Slicing {
            tick: 4,
            windows: vec![1, 2, 4],
            align,
            ..test_plan().slicing
        };
        let plan = slicing.segments();
        Held::new(&plan, &plan.windows)
    }

    /// A whole segment of one event.
    fn pass(held: &mut Held, segment: u64) -> Option<usize> {
        let cleared = held.open(segment, 7);
        if held.slot_for(segment, 7).is_some() {
            held.add(segment, 1);
            held.close(segment);
        }
        cleared
    }

    fn window(held: &Held, last: u64, len: usize) -> Result<(u64, Vec<usize>), Reason> {
        let mut slots = Vec::new();
        let events = held.window(last, len, &mut slots)?;
        Ok((events, slots))
    }

    #[test]
    fn windows_that_begin_with_their_tick_share_a_slot() {
        let mut held = held(Align::Start);
        assert_eq!(held.slots(), 1);
        assert_eq!(pass(&mut held, 3), Some(0));
        assert_eq!(window(&held, 3, 1), Ok((1, vec![0])));
        assert_eq!(pass(&mut held, 4), None);
        assert_eq!(window(&held, 4, 2), Ok((2, vec![0])));
        assert_eq!(
            window(&held, 3, 1),
            Err(Reason::IncompleteWindow),
            "the slot has more by now"
        );
        assert_eq!(pass(&mut held, 5), None);
        assert_eq!(window(&held, 5, 3), Ok((3, vec![0])));
        assert_eq!(pass(&mut held, 6), Some(0));
    }

    #[test]
    fn a_shared_slot_holds_nothing_twice_and_nothing_out_of_order() {
        let mut held = held(Align::Start);
        pass(&mut held, 0);
        pass(&mut held, 1);
        assert_eq!(pass(&mut held, 1), None, "sent again");
        assert_eq!(window(&held, 1, 2), Err(Reason::IncompleteWindow));
        pass(&mut held, 2);
        assert_eq!(window(&held, 2, 3), Err(Reason::IncompleteWindow));
        pass(&mut held, 4);
        assert_eq!(window(&held, 4, 2), Err(Reason::IncompleteWindow), "3 is missing");
        pass(&mut held, 6);
        held.drop_segment(6);
        pass(&mut held, 7);
        assert_eq!(window(&held, 7, 2), Err(Reason::IncompleteWindow));
    }

    #[test]
    fn windows_over_a_lost_segment_say_why_it_is_lost() {
        for align in [Align::Start, Align::End] {
            let mut held = held(align);
            pass(&mut held, 4);
            pass(&mut held, 5);
            held.open(6, 7);
            held.lose(6, Reason::Disconnected);
            pass(&mut held, 7);
            assert_eq!(window(&held, 6, 1), Err(Reason::Disconnected));
            assert_eq!(window(&held, 7, 2), Err(Reason::Disconnected));
            pass(&mut held, 9);
            assert_eq!(window(&held, 9, 1).map(|(events, _)| events), Ok(1), "{align:?}");
        }
    }

    #[test]
    fn other_windows_have_a_slot_per_segment() {
        let mut held = held(Align::End);
        assert_eq!(held.slots(), 3);
        for segment in 0..3 {
            assert_eq!(pass(&mut held, segment), Some(segment as usize));
        }
        assert_eq!(window(&held, 2, 1), Ok((1, vec![2])));
        assert_eq!(window(&held, 2, 3), Ok((3, vec![0, 1, 2])));
        assert_eq!(window(&held, 1, 3), Err(Reason::BeforeStart));
        pass(&mut held, 1);
        assert_eq!(window(&held, 2, 3), Ok((3, vec![0, 1, 2])), "sent again");
        held.forget();
        assert_eq!(window(&held, 2, 1), Err(Reason::IncompleteWindow));
    }
}
