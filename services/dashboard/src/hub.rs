//! What is known of the run, and who is shown it.

use crate::Frame;
use bytes::Bytes;
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::Notify;
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// Events that wait for one browser; with more it is sent away, and comes back by itself.
const QUEUE: usize = 256;
/// Browsers that are shown the run at a time.
const MOST_VIEWERS: usize = 16;
/// Answers and scores that a browser is given when it comes.
const HISTORY: usize = 160;
/// Deaths and returns that it is given.
const PROCESSES: usize = 40;

/// What does not change while the run goes on.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Graph {
    /// Name of the instance.
    pub name: String,
    /// Version of the executable.
    pub version: String,
    /// `lossless` or `latest`.
    pub delivery: String,
    /// Ids of the reconstructions, in the order of the plan.
    pub reconstructions: Vec<String>,
    /// Ids of the windows, in the order of the plan.
    pub windows: Vec<String>,
    /// Members, in the order of the plan.
    pub members: Vec<MemberInfo>,
    /// Places of the map; 0 without a map.
    pub references: u64,
    /// Places so many references apart count as one.
    pub exclusion: u64,
    /// Where places are, as far as the map knows; thinned out where there are many.
    pub route: Vec<Place>,
    /// Rules of fusion that there are.
    pub rules: Vec<String>,
    /// Whether the sequence method has a length.
    pub has_length: bool,
    /// Whether answers have a deadline.
    pub has_deadline: bool,
    /// Whether a token may change something.
    pub control: bool,
}

/// A member of the plan.
#[derive(Debug, Clone, Serialize)]
pub struct MemberInfo {
    /// Its name.
    pub name: String,
    /// Index of its reconstruction.
    pub reconstruction: usize,
    /// Index of its window.
    pub window: usize,
}

/// A place of the map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Place {
    /// The map's tick.
    pub reference: u64,
    /// Metres east, or x.
    pub east_m: f64,
    /// Metres north, or y.
    pub north_m: f64,
}

/// What became of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Moved {
    /// It has died, and is being started again.
    Down,
    /// It is there again.
    Back,
    /// It has died and is not started again.
    GivenUp,
}

/// Shared by whoever knows something and whoever wants to see it.
#[derive(Debug)]
pub struct Hub {
    state: Mutex<State>,
    /// Somebody came, or changed something: the status is wanted at once.
    wanted: Mutex<bool>,
    nudge: Condvar,
    ended: Notify,
}

#[derive(Debug, Default)]
struct State {
    graph: String,
    answers: VecDeque<String>,
    scores: VecDeque<String>,
    processes: VecDeque<String>,
    /// By reconstruction and window.
    frames: BTreeMap<(usize, usize), Shown>,
    status: Option<(Instant, String)>,
    ended: bool,
    viewers: Vec<Sender<Bytes>>,
}

/// The newest frame of a reconstruction and window.
#[derive(Debug)]
struct Shown {
    about: String,
    frame: Option<Arc<Frame>>,
}

fn event(name: &str, data: &str) -> Bytes {
    Bytes::from(format!("event: {name}\ndata: {data}\n\n"))
}

fn remember(kept: &mut VecDeque<String>, most: usize, text: String) {
    if kept.len() == most {
        kept.pop_front();
    }
    kept.push_back(text);
}

fn list(texts: &VecDeque<String>) -> String {
    texts.iter().map(String::as_str).collect::<Vec<_>>().join(",")
}

impl State {
    /// Shows everybody an event. Whoever has not kept up is let go.
    fn tell(&mut self, name: &str, data: &str) {
        if !self.viewers.is_empty() {
            let event = event(name, data);
            self.viewers
                .retain(|viewer| viewer.try_send(event.clone()).is_ok());
        }
    }
}

impl Hub {
    /// A hub for this graph.
    ///
    /// # Errors
    /// When the graph cannot be written as JSON.
    pub fn new(graph: &Graph) -> Result<Self, serde_json::Error> {
        let state = State {
            graph: serde_json::to_string(graph)?,
            ..State::default()
        };
        Ok(Self {
            state: Mutex::new(state),
            wanted: Mutex::new(false),
            nudge: Condvar::new(),
            ended: Notify::new(),
        })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether anybody looks.
    pub fn is_watched(&self) -> bool {
        let mut state = self.state();
        state.viewers.retain(|viewer| !viewer.is_closed());
        !state.viewers.is_empty()
    }

    /// Waits until the status is wanted at once, or for `timeout`.
    pub fn wait(&self, timeout: Duration) {
        let wanted = self.wanted.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.nudge.wait_timeout_while(wanted, timeout, |wanted| !*wanted);
        *waited.unwrap_or_else(PoisonError::into_inner).0 = false;
    }

    /// Ends [`Hub::wait`].
    pub fn want_status(&self) {
        *self.wanted.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.nudge.notify_all();
    }

    /// An answer: a line of JSON as in the matches.
    pub fn answer(&self, line: String) {
        let mut state = self.state();
        state.tell("answer", &line);
        remember(&mut state.answers, HISTORY, line);
    }

    /// What the fuser made of a tick: of `columns`, even shares of the places, the highest score each, NaN for none; and
    /// for each member the place that it holds for the right one, or −1.
    pub fn scores(&self, tick: u64, columns: &[f32], places: &[f32]) {
        let known = || columns.iter().copied().filter(|score| score.is_finite());
        let (low, high) = (
            known().fold(f32::INFINITY, f32::min),
            known().fold(f32::NEG_INFINITY, f32::max),
        );
        let span = if high > low { high - low } else { 1.0 };
        let mut shades = String::with_capacity(2 * columns.len());
        for score in columns {
            // 0 is "no score"; a finite score is 1 to 255.
            let shade = if score.is_finite() {
                1 + ((score - low) / span * 254.0).round() as u8
            } else {
                0
            };
            let _ = write!(shades, "{shade:02x}");
        }
        let number = |value: f32| if value.is_finite() { value } else { 0.0 };
        let places: Vec<String> = places.iter().map(|place| (*place as i64).to_string()).collect();
        let text = format!(
            "{{\"tick\":{tick},\"low\":{},\"high\":{},\"shades\":\"{shades}\",\"places\":[{}]}}",
            number(low),
            number(high),
            places.join(",")
        );
        let mut state = self.state();
        state.tell("scores", &text);
        remember(&mut state.scores, HISTORY, text);
    }

    /// The newest frame of a reconstruction and window, or the reason why there is none.
    pub fn frame(
        &self,
        (reconstruction, window): (usize, usize),
        (tick, events): (u64, u64),
        frame: Result<Frame, &str>,
    ) {
        let reason = serde_json::Value::from(frame.as_ref().err().copied());
        let about = format!(
            "{{\"reconstruction\":{reconstruction},\"window\":{window},\"tick\":{tick},\"events\":{events},\
             \"reason\":{reason}}}"
        );
        let mut state = self.state();
        state.tell("frame", &about);
        let frame = frame.ok().map(Arc::new);
        state
            .frames
            .insert((reconstruction, window), Shown { about, frame });
    }

    /// A process has died or is back.
    pub fn process(&self, name: &str, moved: Moved) {
        let at = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let text = serde_json::json!({
            "process": name,
            "moved": moved,
            "at_unix_ms": at.map_or(0, |t| t.as_millis() as u64),
        });
        let text = text.to_string();
        let mut state = self.state();
        state.tell("process", &text);
        remember(&mut state.processes, PROCESSES, text);
    }

    /// How the run is (JSON), or why that is not known.
    pub fn status(&self, status: Result<String, String>) {
        let mut state = self.state();
        match status {
            Ok(text) => {
                state.tell("status", &text);
                state.status = Some((Instant::now(), text));
            }
            Err(why) => {
                let text = serde_json::Value::from(why).to_string();
                state.tell("lost", &text);
            }
        }
    }

    /// The run ends: everybody is told, and let go.
    pub fn end(&self) {
        let mut state = self.state();
        state.ended = true;
        state.tell("end", "{}");
        state.viewers.clear();
        drop(state);
        self.want_status();
        self.ended.notify_one();
    }

    /// Waits for the end. For one who waits.
    pub(crate) async fn ended(&self) {
        self.ended.notified().await;
    }

    /// The status, if it is no older than this.
    pub(crate) fn recent_status(&self, age: Duration) -> Option<String> {
        let state = self.state();
        let (at, text) = state.status.as_ref()?;
        (at.elapsed() <= age).then(|| text.clone())
    }

    /// The newest frame of a reconstruction and window.
    pub(crate) fn newest_frame(&self, which: (usize, usize)) -> Option<Arc<Frame>> {
        self.state().frames.get(&which)?.frame.clone()
    }

    /// Takes one more viewer: what has been, and from now on every event. None when there are too many, or the run has
    /// ended.
    pub(crate) fn view(&self) -> Option<(Bytes, Receiver<Bytes>)> {
        let (viewer, events) = channel(QUEUE);
        let mut state = self.state();
        state.viewers.retain(|viewer| !viewer.is_closed());
        if state.ended || state.viewers.len() >= MOST_VIEWERS {
            return None;
        }
        state.viewers.push(viewer);
        let frames: Vec<&str> = state.frames.values().map(|shown| shown.about.as_str()).collect();
        let status = state.status.as_ref().map_or("null", |(_, text)| text.as_str());
        let history = format!(
            "{{\"answers\":[{}],\"scores\":[{}],\"processes\":[{}],\"frames\":[{}],\"status\":{status}}}",
            list(&state.answers),
            list(&state.scores),
            list(&state.processes),
            frames.join(",")
        );
        let first = [event("graph", &state.graph), event("history", &history)].concat();
        drop(state);
        self.want_status();
        Some((Bytes::from(first), events))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hub() -> Hub {
        Hub::new(&Graph::default()).unwrap()
    }

    fn text(bytes: &Bytes) -> &str {
        std::str::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_viewer_is_told_what_has_been_and_what_comes_and_nothing_twice() {
        let hub = hub();
        assert!(!hub.is_watched());
        hub.answer("{\"tick\":1}".to_owned());
        let (first, mut events) = hub.view().unwrap();
        assert!(hub.is_watched());
        assert!(text(&first).starts_with("event: graph\ndata: {"));
        assert!(text(&first).contains("\"answers\":[{\"tick\":1}]"));
        hub.answer("{\"tick\":2}".to_owned());
        hub.process("fuse", Moved::GivenUp);
        hub.status(Err("it is \"gone\"".to_owned()));
        let mut next = || text(&events.try_recv().unwrap()).to_owned();
        assert_eq!(next(), "event: answer\ndata: {\"tick\":2}\n\n");
        assert!(next().contains("\"moved\":\"given_up\""));
        assert_eq!(next(), "event: lost\ndata: \"it is \\\"gone\\\"\"\n\n");
        hub.end();
        assert_eq!(next(), "event: end\ndata: {}\n\n");
        assert!(events.try_recv().is_err() && hub.view().is_none());
    }

    #[test]
    fn who_does_not_keep_up_is_let_go_and_history_has_an_end() {
        let hub = hub();
        let (_, mut events) = hub.view().unwrap();
        for tick in 0..=QUEUE {
            hub.answer(tick.to_string());
        }
        assert!(!hub.is_watched());
        let mut got = 0;
        while events.try_recv().is_ok() {
            got += 1;
        }
        assert_eq!(got, QUEUE);
        let (first, _events) = hub.view().unwrap();
        let oldest = QUEUE + 1 - HISTORY;
        assert!(
            text(&first).contains(&format!("\"answers\":[{oldest},")),
            "{first:?}"
        );
    }

    #[test]
    fn there_are_never_too_many() {
        let hub = hub();
        let mut all: Vec<_> = (0..MOST_VIEWERS).map(|_| hub.view().unwrap()).collect();
        assert!(hub.view().is_none());
        all.pop();
        assert!(hub.view().is_some(), "the place of one that has gone is free");
    }

    #[test]
    fn scores_are_shades_and_always_json() {
        let hub = hub();
        let (_, mut events) = hub.view().unwrap();
        hub.scores(3, &[-2.0, f32::NAN, 2.0, 0.0], &[7.0, -1.0]);
        hub.scores(4, &[f32::NAN], &[]);
        hub.scores(5, &[1.5; 2], &[f32::INFINITY]);
        let mut next = || -> serde_json::Value {
            let bytes = events.try_recv().unwrap();
            serde_json::from_str(text(&bytes).strip_prefix("event: scores\ndata: ").unwrap()).unwrap()
        };
        let first = next();
        assert_eq!(first["shades"], "0100ff80");
        assert_eq!(first["places"], serde_json::json!([7, -1]));
        assert_eq!(
            (first["low"].as_f64(), first["high"].as_f64()),
            (Some(-2.0), Some(2.0))
        );
        assert_eq!(next()["shades"], "00");
        assert_eq!(next()["shades"], "0101");
    }

    #[test]
    fn frames_are_announced_and_the_newest_is_kept() {
        let hub = hub();
        let frame = || Frame::new(1, 1, [[1, 2, 3]].into_iter()).unwrap();
        hub.frame((0, 1), (5, 100), Ok(frame()));
        assert!(hub.newest_frame((0, 1)).is_some() && hub.newest_frame((0, 0)).is_none());
        hub.frame((0, 1), (6, 0), Err("no events"));
        assert!(hub.newest_frame((0, 1)).is_none());
        let (first, _events) = hub.view().unwrap();
        assert!(text(&first).contains("\"tick\":6,\"events\":0,\"reason\":\"no events\""));
    }
}
