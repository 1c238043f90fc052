//! The reader: a thread that decodes and screens ahead of the slicer, through two bounded channels: batches go
//! one way, and come back to be filled again.

use crate::{Noise, NoiseTally, RawEvent, Screen, ScreenTally, SourceError};
use crossbeam::channel::{Receiver, Sender, bounded};
use evpr_events::{BATCH_EVENTS, Recording};
use std::thread::JoinHandle;

/// Batches that may wait for the slicer.
const AHEAD: usize = 4;

/// Screened events without the noise, with where the recording stands after them.
#[derive(Debug)]
pub(crate) struct Batch {
    pub(crate) events: Vec<RawEvent>,
    /// Time of the first event, and the last event, noise or not.
    pub(crate) first_ns: Option<u64>,
    pub(crate) last: Option<RawEvent>,
    pub(crate) progress_permille: u64,
    pub(crate) screened: ScreenTally,
    pub(crate) noise: NoiseTally,
}

/// The receiving end. The recording has ended when its channel is disconnected; a failure comes last.
pub(crate) struct Reader {
    pub(crate) batches: Receiver<Result<Batch, SourceError>>,
    empties: Sender<Vec<RawEvent>>,
    thread: JoinHandle<()>,
}

impl Reader {
    /// Starts the thread. `first` is a batch that was read and screened before.
    pub(crate) fn spawn(
        recording: Box<dyn Recording>,
        screen: Screen,
        noise: Noise,
        first: Option<Vec<RawEvent>>,
    ) -> Result<Self, SourceError> {
        let (filled, batches) = bounded(AHEAD);
        // One more buffer is with the slicer and one is being filled.
        let (empties, recycled) = bounded(AHEAD + 2);
        let thread = std::thread::Builder::new()
            .name("decode".to_owned())
            .spawn(move || decode(recording, screen, noise, first, &filled, &recycled))
            .map_err(|e| SourceError::Setup(format!("cannot start the decoding thread: {e}")))?;
        Ok(Self {
            batches,
            empties,
            thread,
        })
    }

    /// Gives a buffer back to be filled again.
    pub(crate) fn recycle(&self, events: Vec<RawEvent>) {
        // A full channel only means that there are buffers enough.
        let _ = self.empties.try_send(events);
    }

    /// Ends the thread. False when it had panicked.
    pub(crate) fn join(self) -> bool {
        let Self {
            batches,
            empties,
            thread,
        } = self;
        drop((batches, empties));
        thread.join().is_ok()
    }
}

/// Decodes until the recording ends or fails, or nobody listens any more.
fn decode(
    mut recording: Box<dyn Recording>,
    mut screen: Screen,
    mut noise: Noise,
    first: Option<Vec<RawEvent>>,
    filled: &Sender<Result<Batch, SourceError>>,
    recycled: &Receiver<Vec<RawEvent>>,
) {
    let mut send = |mut events: Vec<RawEvent>, recording: &dyn Recording, screen: &Screen| {
        let (first_ns, last) = (events.first().map(|e| e.t_ns), events.last().copied());
        noise.apply(&mut events);
        filled
            .send(Ok(Batch {
                events,
                first_ns,
                last,
                progress_permille: recording.progress_permille(),
                screened: screen.tally(),
                noise: noise.tally(),
            }))
            .is_ok()
    };
    if let Some(events) = first
        && !send(events, recording.as_ref(), &screen)
    {
        return;
    }
    loop {
        let mut events = recycled
            .try_recv()
            .unwrap_or_else(|_| Vec::with_capacity(BATCH_EVENTS));
        let outcome = next_screened(recording.as_mut(), &mut screen, &mut events);
        if !send(events, recording.as_ref(), &screen) {
            return;
        }
        match outcome {
            Ok(true) => {}
            Ok(false) => return,
            Err(e) => {
                // A slicer that has gone does not want to know.
                let _ = filled.send(Err(e));
                return;
            }
        }
    }
}

/// Reads and screens one batch; `events` holds the good ones even when it fails.
pub(crate) fn next_screened(
    recording: &mut dyn Recording,
    screen: &mut Screen,
    events: &mut Vec<RawEvent>,
) -> Result<bool, SourceError> {
    let outcome = recording.next_batch(events);
    // An event that the screen refuses comes before the place where decoding failed.
    screen.apply(events)?;
    let over = screen.span().apply(events)?;
    match outcome {
        // What comes then is not used, be it an error.
        _ if over => Ok(false),
        Ok(false) => screen.span().end().map(|()| false),
        other => other,
    }
}
