//! A kept run: a folder with everything that is needed to say what a run did, and to do it again.
//!
//! `run.json` says what it is: versions, hashes of what was read, how it ended. `config.toml` is the configuration as it
//! was given, `plan.json` what it came to with the command line; `matches.jsonl` the answers, `stats.json` what each process
//! took, and `events.aedat4` with its ticks the tape, where events were recorded.

use crate::failure::Failure;
use evpr_core::Plan;
use evpr_ingest::tape::{self, sha256_hex};
use evpr_onnx::sha256_of;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// The version of what is written; others are refused.
const VERSION: u32 = 1;
/// The tape, where the command line does not name one.
pub(crate) const EVENTS: &str = "events.aedat4";
const ABOUT: &str = "run.json";

/// What `run.json` says.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct About {
    kept_run: u32,
    /// Version of evpr, and what it was built with.
    evpr: String,
    features: Vec<String>,
    command: Vec<String>,
    /// Seconds since 1970.
    started_s: u64,
    plan_sha256: String,
    /// The tape; in this folder, unless it is a whole path.
    events: Option<PathBuf>,
    /// What was read; none until it is hashed.
    inputs: Option<Vec<KeptInput>>,
    /// Networks, with the hashes that they were checked against.
    networks: Vec<KeptInput>,
    /// None while the run goes on, and when it was killed.
    ended: Option<Ended>,
}

/// Something that a run read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct KeptInput {
    /// `map`, `recording`, `positions`, or the id of a network.
    what: String,
    path: PathBuf,
    /// Of a folder: of the names and hashes of its files.
    sha256: String,
}

/// How a run ended.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Ended {
    outcome: String,
    answers: u64,
    seconds: f64,
}

/// The folder of a run that goes on.
pub(crate) struct KeptRun {
    path: PathBuf,
    about: About,
    hashing: Option<JoinHandle<io::Result<Vec<KeptInput>>>>,
    began: Instant,
}

impl KeptRun {
    /// Makes the folder, with what is known before the run of this plan begins.
    pub(crate) fn create(path: &Path, config: &Path, plan: &Plan) -> Result<Self, Failure> {
        let failed = |e: io::Error| Failure::new(format!("cannot write {}: {e}", path.display()));
        if path.exists() {
            return Err(exists(path));
        }
        let config = fs::read(config)
            .map_err(|e| Failure::new(format!("cannot read the configuration {}: {e}", config.display())))?;
        let folder = absolute_path(path)?;
        let mut kept = absolute(plan)?;
        let events = kept.record_events.take();
        let plan_json = serde_json::to_string_pretty(&kept)? + "\n";
        let started = SystemTime::now().duration_since(UNIX_EPOCH);
        let about = About {
            kept_run: VERSION,
            evpr: env!("CARGO_PKG_VERSION").to_owned(),
            features: features(),
            command: std::env::args().collect(),
            started_s: started.map_or(0, |t| t.as_secs()),
            plan_sha256: sha256_hex(plan_json.as_bytes()),
            events: events.map(|events| {
                events
                    .strip_prefix(&folder)
                    .map_or(events.clone(), Path::to_owned)
            }),
            inputs: None,
            networks: networks(&kept),
            ended: None,
        };
        fs::create_dir(path).map_err(failed)?;
        let mut run = Self {
            path: path.to_owned(),
            about,
            hashing: None,
            began: Instant::now(),
        };
        run.write("config.toml", &config)?;
        run.write("plan.json", plan_json.as_bytes())?;
        run.write_about()?;
        let inputs = inputs(&kept);
        let hash = move || {
            inputs
                .into_iter()
                .map(|(what, path)| KeptInput::of(what, path))
                .collect()
        };
        let thread = std::thread::Builder::new().name("hashes".to_owned());
        run.hashing = Some(thread.spawn(hash).map_err(failed)?);
        Ok(run)
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), Failure> {
        let path = self.path.join(name);
        fs::write(&path, bytes).map_err(|e| Failure::new(format!("cannot write {}: {e}", path.display())))
    }

    /// Whole at once: it is what makes the folder a kept run.
    fn write_about(&self) -> Result<(), Failure> {
        self.write(
            "run.json.new",
            (serde_json::to_string_pretty(&self.about)? + "\n").as_bytes(),
        )?;
        let path = self.path.join(ABOUT);
        fs::rename(self.path.join("run.json.new"), &path)
            .map_err(|e| Failure::new(format!("cannot write {}: {e}", path.display())))
    }

    /// A file in it.
    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Says how the run ended, and what it had read.
    pub(crate) fn finish(mut self, outcome: &str, answers: u64) -> Result<(), Failure> {
        let hashed = self.hashing.take().map(JoinHandle::join);
        let hashed =
            hashed.map(|joined| joined.unwrap_or_else(|_| Err(io::Error::other("hashing panicked"))));
        self.about.inputs = hashed.transpose().unwrap_or_else(|e| {
            tracing::warn!("{}: what was read cannot be hashed: {e}", self.path.display());
            None
        });
        self.about.ended = Some(Ended {
            outcome: outcome.to_owned(),
            answers,
            seconds: self.began.elapsed().as_secs_f64(),
        });
        self.write_about()
    }

    /// Removes it again: of a run that never began there is nothing to keep.
    pub(crate) fn discard(mut self) {
        if let Some(hashing) = self.hashing.take() {
            let _ = hashing.join();
        }
        let _ = fs::remove_dir_all(&self.path);
    }
}

fn exists(path: &Path) -> Failure {
    let what = "exists already; choose another name or remove it";
    Failure::new(format!("{} {what}", path.display()))
}

fn features() -> Vec<String> {
    let all = [
        ("parquet", cfg!(feature = "parquet")),
        ("usb", cfg!(feature = "usb")),
    ];
    all.into_iter()
        .filter(|(_, on)| *on)
        .map(|(name, _)| name.to_owned())
        .collect()
}

fn absolute_path(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path)
        .map_err(|e| Failure::new(format!("{}: its place is not known: {e}", path.display())))
}

/// The plan with paths that hold wherever it is read.
pub(crate) fn absolute(plan: &Plan) -> Result<Plan, Failure> {
    let mut plan = plan.clone();
    let mut wrong = None;
    plan.each_path(&mut |path| match absolute_path(path) {
        Ok(whole) => *path = whole,
        Err(e) => wrong = Some(e),
    });
    wrong.map_or(Ok(plan), Err)
}

/// What a plan reads, but for networks.
fn inputs(plan: &Plan) -> Vec<(&'static str, PathBuf)> {
    let map = plan.map.iter().map(|p| ("map", p.clone()));
    let source = &plan.source;
    let is_read = source.live.is_none() && source.street.is_none() && !source.is_tape();
    let recording = is_read.then(|| ("recording", source.path.clone()));
    let positions = source.positions.iter().map(|p| ("positions", p.path.clone()));
    map.chain(recording).chain(positions).collect()
}

fn networks(plan: &Plan) -> Vec<KeptInput> {
    let networks = plan.reconstructions.iter().map(|r| &r.network);
    let networks = networks
        .chain(plan.extractors.iter().map(|e| &e.network))
        .flatten();
    networks
        .map(|n| KeptInput {
            what: n.model.id.clone(),
            path: n.model.file.clone(),
            sha256: n.model.sha256.clone(),
        })
        .collect()
}

impl KeptInput {
    fn of(what: &str, path: PathBuf) -> io::Result<Self> {
        let sha256 = if path.is_dir() {
            folder_sha256(&path)?
        } else {
            sha256_of(&path)?
        };
        Ok(Self {
            what: what.to_owned(),
            path,
            sha256,
        })
    }
}

/// Of the names, in order, and hashes of all files in a folder.
fn folder_sha256(folder: &Path) -> io::Result<String> {
    fn list(folder: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.is_dir() {
                list(&path, files)?;
            } else {
                files.push(path);
            }
        }
        Ok(())
    }
    let mut files = Vec::new();
    list(folder, &mut files)?;
    files.sort();
    let mut lines = String::new();
    for file in files {
        let name = file.strip_prefix(folder).unwrap_or(&file);
        lines += &format!("{}  {}\n", sha256_of(&file)?, name.display());
    }
    Ok(sha256_hex(lines.as_bytes()))
}

/// Something that can be replayed.
pub(crate) struct Replayable {
    /// The plan of the replay.
    pub(crate) plan: Plan,
    /// The answers of the run, where they were kept.
    pub(crate) matches: Option<PathBuf>,
}

/// Reads a kept run, or a tape alone. `map` takes the place of the one that the run was matched against.
pub(crate) fn open(path: &Path, map: Option<&Path>) -> Result<Replayable, Failure> {
    if !path.is_dir() {
        if !path.exists() {
            return Err(Failure::new(format!(
                "{}: there is no such file or folder",
                path.display()
            )));
        }
        let head = tape::read_head(path)?;
        warn_of_version(path, &head.evpr);
        let mut plan = head.plan.of_tape(absolute_path(path)?);
        plan.map = map.map(Path::to_owned).or(plan.map);
        return Ok(Replayable { plan, matches: None });
    }
    let about = read_about(path)?;
    let mut plan = read_plan(path, &about)?;
    warn_of_version(path, &about.evpr);
    plan = match &about.events {
        Some(events) => plan.of_tape(absolute_path(&path.join(events))?),
        None if plan.source.live.is_some() => {
            return Err(Failure::new(format!(
                "{}: the events of this live run were not recorded, so it cannot be replayed; --record-events does that",
                path.display()
            )));
        }
        None => plan.replayed(),
    };
    let given = map.is_some();
    plan.map = map.map(Path::to_owned).or(plan.map);
    check_inputs(path, &about, given, &plan)?;
    let matches = path.join("matches.jsonl");
    Ok(Replayable {
        plan,
        matches: matches.exists().then_some(matches),
    })
}

fn warn_of_version(path: &Path, version: &str) {
    let ours = env!("CARGO_PKG_VERSION");
    if version != ours {
        let path = path.display();
        tracing::warn!("{path} was made by evpr {version}, this is {ours}: the answers may differ for that");
    }
}

fn read_about(path: &Path) -> Result<About, Failure> {
    let file = path.join(ABOUT);
    let wrong = |what: String| Failure::new(format!("{}: {what}", file.display()));
    let text = fs::read_to_string(&file).map_err(|e| match e.kind() {
        io::ErrorKind::NotFound => Failure::new(format!(
            "{} is no kept run: there is no {ABOUT} in it; `evpr run --keep` makes one",
            path.display()
        )),
        _ => wrong(format!("cannot be read: {e}")),
    })?;
    // What it is comes first: of another version, the rest may be something else.
    #[derive(Deserialize)]
    struct Which {
        kept_run: u32,
        evpr: String,
    }
    let which: Which =
        serde_json::from_str(&text).map_err(|e| wrong(format!("does not say what it is: {e}")))?;
    if which.kept_run != VERSION {
        return Err(wrong(format!(
            "is of a kept run of version {}, made by evpr {}; this evpr reads version {VERSION}: replay it with that one",
            which.kept_run, which.evpr
        )));
    }
    serde_json::from_str(&text).map_err(|e| wrong(format!("is not understood: {e}")))
}

fn read_plan(path: &Path, about: &About) -> Result<Plan, Failure> {
    let file = path.join("plan.json");
    let wrong = |what: &str| Failure::new(format!("{}: {what}", file.display()));
    let text = fs::read(&file).map_err(|e| wrong(&format!("cannot be read: {e}")))?;
    if sha256_hex(&text) != about.plan_sha256 {
        return Err(wrong(
            "is not the plan that was kept; it is damaged, or somebody edited it",
        ));
    }
    serde_json::from_slice(&text).map_err(|e| {
        wrong(&format!(
            "is not understood ({e}); it was made by evpr {}, replay it with that one",
            about.evpr
        ))
    })
}

/// Refuses what is not as it was. `given`: the map was named now, so it need not be the same.
fn check_inputs(path: &Path, about: &About, given: bool, plan: &Plan) -> Result<(), Failure> {
    let Some(kept) = &about.inputs else {
        tracing::warn!(
            "{}: the run was cut short, so it does not say of which state its map was; if that has changed since, the \
             answers differ",
            path.display()
        );
        return Ok(());
    };
    for (what, now) in inputs(plan) {
        let Some(then) = kept.iter().find(|input| input.what == what) else {
            continue;
        };
        if what == "map" && given {
            continue;
        }
        let hash = KeptInput::of(what, now.clone()).map_err(|e| {
            Failure::new(format!(
                "the {what} {} of the run cannot be read: {e}",
                now.display()
            ))
        })?;
        if hash.sha256 != then.sha256 {
            let way_out = match what {
                "map" => "restore it, or name a map with --map and expect other answers",
                _ => "restore it",
            };
            return Err(Failure::new(format!(
                "the {what} {} has changed since the run {}; {way_out}",
                now.display(),
                path.display()
            )));
        }
    }
    Ok(())
}
