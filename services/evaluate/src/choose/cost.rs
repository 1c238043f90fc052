//! What sets of members take per tick.
//!
//! The cost of a set is what its stages take one after the other: what is shared counts once.
//!
//! tick + Σ over its reconstructions (once per tick) + Σ over its (reconstruction, window) (per frame)
//! \+ Σ over its extractors (once per tick) + Σ over its members (per frame of the extractor, and per member)

use crate::error::EvaluateError;
use crate::subsets::MemberName;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const MAX_FILE_BYTES: u64 = 16 << 20;

/// Measured times of stages, ms.
///
/// From TOML:
/// ```toml
/// tick_ms = 0.5                    # every tick, whoever is a member; default 0
/// member_ms = 0.05                 # similarity and matching of each member; default 0
/// [reconstruction]
/// event_count = 3.2                # once per tick, whichever windows are used
/// "event_count@250ms" = 1.1        # and for each frame of this window
/// [extractor]
/// mixvpr = 4.0                     # per frame
/// netvlad = { batch_ms = 2.0, frame_ms = 1.0 }   # once per tick, and per frame
/// ```
/// or from the statistics of a run (JSON, `evpr run --stats`) or of `evpr demo`, where the time of a process per tick
/// counts once for a reconstruction, and per frame for an extractor.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Costs {
    #[serde(default)]
    tick_ms: f64,
    #[serde(default)]
    member_ms: f64,
    #[serde(default)]
    reconstruction: BTreeMap<String, f64>,
    #[serde(default)]
    extractor: BTreeMap<String, Extraction>,
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(untagged)]
enum Extraction {
    Frame(f64),
    Batch { batch_ms: f64, frame_ms: f64 },
}

impl Extraction {
    /// Once per tick, and per frame, ms.
    fn parts(self) -> (f64, f64) {
        match self {
            Self::Frame(frame) => (0.0, frame),
            Self::Batch { batch_ms, frame_ms } => (batch_ms, frame_ms),
        }
    }
}

/// Statistics of a run.
#[derive(Deserialize)]
struct Stats {
    ticks: u64,
    processes: Vec<Process>,
}

#[derive(Deserialize)]
struct Process {
    process: String,
    messages: u64,
    /// Mean per message, µs; the median where there is none.
    mean_us: Option<f64>,
    p50_us: f64,
}

#[derive(Deserialize)]
struct Demo {
    latency: Stats,
}

impl Costs {
    /// Reads costs: TOML, or JSON when the file's name ends so.
    ///
    /// # Errors
    /// When it cannot be read, is no such file, or has a cost that is not a number of 0 or more.
    pub fn read(path: &Path) -> Result<Self, EvaluateError> {
        use std::io::Read;
        let file = std::fs::File::open(path).map_err(EvaluateError::io("open", path))?;
        let mut text = String::new();
        file.take(MAX_FILE_BYTES)
            .read_to_string(&mut text)
            .map_err(EvaluateError::io("read", path))?;
        let bad = |reason: String| EvaluateError::bad(path, reason);
        let costs = if path.extension().is_some_and(|e| e == "json") {
            let stats = serde_json::from_str::<Stats>(&text)
                .or_else(|_| serde_json::from_str::<Demo>(&text).map(|demo| demo.latency));
            let stats = stats.map_err(|e| {
                bad(format!(
                    "these are no statistics of a run ({e}); write them with evpr run --stats"
                ))
            })?;
            Self::from_stats(&stats)
        } else {
            toml::from_str(&text).map_err(|e| bad(e.to_string().trim().replace('\n', " ")))?
        };
        let extractors = costs.extractor.iter().flat_map(|(name, e)| {
            let (batch, frame) = e.parts();
            [(name.as_str(), batch), (name.as_str(), frame)]
        });
        let named = costs.reconstruction.iter().map(|(name, ms)| (name.as_str(), *ms));
        let all = named
            .chain(extractors)
            .chain([("tick_ms", costs.tick_ms), ("member_ms", costs.member_ms)]);
        for (name, ms) in all {
            if !(ms >= 0.0 && ms.is_finite()) {
                return Err(bad(format!(
                    "the cost {ms} ms of {name} makes no sense; give 0 or more"
                )));
            }
        }
        Ok(costs)
    }

    fn from_stats(stats: &Stats) -> Self {
        let mut costs = Self::default();
        for p in &stats.processes {
            let message_ms = p.mean_us.unwrap_or(p.p50_us) / 1e3;
            let tick_ms = message_ms * p.messages as f64 / stats.ticks.max(1) as f64;
            match p.process.split_once('/') {
                Some(("reconstruct", id)) => {
                    costs.reconstruction.insert(id.to_owned(), tick_ms);
                }
                Some(("extract", id)) => {
                    costs
                        .extractor
                        .insert(id.to_owned(), Extraction::Frame(message_ms));
                }
                _ => {}
            }
        }
        costs
    }

    /// Prices for members of these names.
    ///
    /// # Errors
    /// A name is not made of three parts, or has a part without a cost.
    pub(crate) fn of(&self, members: &[String]) -> Result<Prices, EvaluateError> {
        let mut prices = Prices {
            tick_ms: self.tick_ms,
            members: Vec::new(),
            shared_ms: Vec::new(),
        };
        let mut numbers: BTreeMap<(u8, String), usize> = BTreeMap::new();
        let mut shared = |prices: &mut Prices, kind: u8, name: String, ms: f64| {
            *numbers.entry((kind, name)).or_insert_with(|| {
                prices.shared_ms.push(ms);
                prices.shared_ms.len() - 1
            })
        };
        for name in members {
            let parts = MemberName::parse(name).ok_or_else(|| {
                EvaluateError::Asked(format!(
                    "member {name} is not named reconstruction@window/extractor, so its cost is not known"
                ))
            })?;
            let frame = format!("{}@{}", parts.reconstruction, parts.window);
            let (once, each) = (
                self.reconstruction.get(parts.reconstruction),
                self.reconstruction.get(&frame),
            );
            if once.is_none() && each.is_none() {
                return Err(EvaluateError::Asked(format!(
                    "the costs have neither {} nor {frame} in [reconstruction]; add what it takes, ms",
                    parts.reconstruction
                )));
            }
            let extraction = self.extractor.get(parts.extractor).ok_or_else(|| {
                EvaluateError::Asked(format!(
                    "the costs have no {} in [extractor]; add what it takes per frame, ms",
                    parts.extractor
                ))
            })?;
            let (batch_ms, frame_ms) = extraction.parts();
            let uses = [
                shared(
                    &mut prices,
                    0,
                    parts.reconstruction.to_owned(),
                    once.copied().unwrap_or(0.0),
                ),
                shared(&mut prices, 1, frame, each.copied().unwrap_or(0.0)),
                shared(&mut prices, 2, parts.extractor.to_owned(), batch_ms),
            ];
            prices.members.push((frame_ms + self.member_ms, uses));
        }
        Ok(prices)
    }
}

/// Prices of the members of a list.
#[derive(Debug, Clone)]
pub(crate) struct Prices {
    tick_ms: f64,
    /// Per member its own price, ms, and the shared things that it uses.
    members: Vec<(f64, [usize; 3])>,
    shared_ms: Vec<f64>,
}

impl Prices {
    /// What a set takes per tick, ms.
    pub(crate) fn cost(&self, set: &[usize]) -> f64 {
        let uses: BTreeSet<usize> = set.iter().flat_map(|m| self.members[*m].1).collect();
        let shared: f64 = uses.into_iter().map(|u| self.shared_ms[u]).sum();
        let own: f64 = set.iter().map(|m| self.members[*m].0).sum();
        self.tick_ms + shared + own
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, text: &str) -> Result<Costs, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        Costs::read(&path).map_err(|e| e.to_string())
    }

    fn members() -> Vec<String> {
        ["a@1s/x", "a@250ms/x", "b@1s/x", "a@1s/y"]
            .map(str::to_owned)
            .into()
    }

    #[test]
    fn what_is_shared_counts_once() {
        let costs = read(
            "costs.toml",
            "tick_ms = 1000.0\nmember_ms = 0.25\n[reconstruction]\na = 1.0\n\"a@1s\" = 10.0\n\"a@250ms\" = 20.0\n\
             b = 2.0\n[extractor]\nx = 100.0\ny = { batch_ms = 300.0, frame_ms = 5.0 }\n",
        )
        .unwrap();
        let prices = costs.of(&members()).unwrap();
        for (set, want) in [
            (&[0][..], 1000.0 + 11.0 + 100.25),
            (&[0, 1], 1000.0 + 31.0 + 200.5),
            (&[0, 2], 1000.0 + 13.0 + 200.5),
            (&[0, 3], 1000.0 + 11.0 + 100.25 + 305.25),
            (&[], 1000.0),
        ] {
            assert_eq!(prices.cost(set), want, "{set:?}");
        }
    }

    #[test]
    fn statistics_of_a_run_are_costs() {
        let stats = r#"{"ticks": 10, "processes": [
            {"process": "ingest", "messages": 1, "p50_us": 9.0},
            {"process": "reconstruct/a", "messages": 50, "mean_us": 200.0, "p50_us": 1.0},
            {"process": "reconstruct/b", "messages": 10, "p50_us": 2000.0},
            {"process": "extract/x", "messages": 30, "mean_us": 3000.0, "p50_us": 1.0},
            {"process": "extract/y", "messages": 30, "mean_us": 4000.0, "p50_us": 1.0}]}"#;
        let prices = read("stats.json", stats).unwrap().of(&members()).unwrap();
        assert_eq!(prices.cost(&[0, 1, 2, 3]), 1.0 + 2.0 + 3.0 * 3.0 + 4.0);
        let demo = format!("{{\"latency\": {stats}, \"scene\": 3}}");
        assert_eq!(read("results.json", &demo), read("stats.json", stats));
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (name, text, words) in [
            ("c.toml", "[extractor]\nx = -1.0\n", "the cost -1 ms of x"),
            ("c.toml", "[extractor]\nx = \"slow\"\n", "x"),
            ("c.toml", "colour = 1\n", "unknown field"),
            ("c.json", "{}", "no statistics of a run"),
        ] {
            let error = read(name, text).unwrap_err();
            assert!(error.contains(words) && error.lines().count() == 1, "{error}");
        }
        let costs = read("c.toml", "[reconstruction]\na = 1.0\n[extractor]\nx = 1.0\n").unwrap();
        let error = costs.of(&members()).unwrap_err().to_string();
        assert!(error.contains("neither b nor b@1s"), "{error}");
        let error = costs.of(&["a@1s/y".to_owned()]).unwrap_err().to_string();
        assert!(error.contains("no y in [extractor]"), "{error}");
        assert!(costs.of(&["plain".to_owned()]).is_err());
    }
}
