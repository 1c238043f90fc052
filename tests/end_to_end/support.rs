//! What the end-to-end tests share: a private instance, a synthetic recording, and reading of answers.

use serde_json::Value;
use std::collections::HashMap;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Nothing here takes nearly as long; a hang must end as a failure.
const WATCHDOG: Duration = Duration::from_secs(120);

/// Ticks of the synthetic recording.
pub(crate) const TICKS: u64 = 300;
/// Length of its ticks in ms of sensor time.
pub(crate) const TICK_MS: u64 = 100;

/// A folder for one test, with an instance of its own in it.
pub(crate) struct Bench {
    pub(crate) folder: tempfile::TempDir,
    run_root: tempfile::TempDir,
}

/// What a finished command said.
#[derive(Debug)]
pub(crate) struct Said {
    pub(crate) status: ExitStatus,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Said {
    pub(crate) fn code(&self) -> i32 {
        self.status.code().unwrap_or(-1)
    }

    /// The lines that report errors.
    pub(crate) fn errors(&self) -> Vec<&str> {
        self.stderr.lines().filter(|l| l.starts_with("error: ")).collect()
    }
}

impl Bench {
    pub(crate) fn new() -> Self {
        // Short, because socket paths are.
        let run_root = tempfile::Builder::new()
            .prefix("ev")
            .rand_bytes(5)
            .tempdir_in("/tmp")
            .unwrap();
        Self {
            folder: tempfile::tempdir().unwrap(),
            run_root,
        }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// The executable with this bench's run folder.
    pub(crate) fn evpr(&self) -> Command {
        self.command(env!("CARGO_BIN_EXE_evpr"))
    }

    /// A program with this bench's run folder, started in this bench's folder.
    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command
            .env("EVPR_RUN_DIR", self.run_root.path())
            .current_dir(self.folder.path());
        if self.delays().exists() {
            command.env("EVPR_TEST_DELAYS", self.delays());
        }
        command
    }

    fn delays(&self) -> PathBuf {
        self.path("delays")
    }

    /// Has each message of this process take so much longer from now on. Runs started after the first call obey.
    pub(crate) fn delay(&self, process: &str, ms: u64) {
        fs::create_dir_all(self.delays()).unwrap();
        let path = self.delays().join(process.replace('/', "_"));
        // Whole at once: it is read all the time.
        let draft = self.path("delay.new");
        fs::write(&draft, ms.to_string()).unwrap();
        fs::rename(draft, path).unwrap();
    }

    /// The run folder of the instance with the default name.
    pub(crate) fn run_folder(&self) -> PathBuf {
        self.run_root.path().join("evpr")
    }

    /// What the names of that instance in shared memory begin with.
    pub(crate) fn shm_prefix(&self) -> String {
        shm_prefix(&self.run_folder())
    }

    /// The socket of the instance with the default name.
    pub(crate) fn control_socket(&self) -> PathBuf {
        self.run_folder().join("control.sock")
    }

    /// Runs a shell script in a mount namespace of its own, so that its mounts are seen by nobody else. `mount` makes
    /// the mounts, then `script` is run; in it `$EVPR` is the executable. None, with a note that names the test, where
    /// this user may not mount.
    pub(crate) fn run_with_mounts(&self, test: &str, mount: &str, script: &str) -> Option<Said> {
        const CANNOT_MOUNT: i32 = 99;
        let script = format!("{{ {mount}; }} || exit {CANNOT_MOUNT}\n{script}");
        let may_unshare = Command::new("unshare")
            .args(["-m", "true"])
            .stderr(Stdio::null())
            .status();
        if may_unshare.is_ok_and(|status| status.success()) {
            let mut command = self.command("unshare");
            command
                .args(["-m", "sh", "-c", &script])
                .env("EVPR", env!("CARGO_BIN_EXE_evpr"));
            let said = finish(&mut command);
            if said.code() != CANNOT_MOUNT {
                return Some(said);
            }
        }
        println!("skipped: {test}: this user may not mount file systems");
        None
    }

    /// Runs a command to its end, under the watchdog.
    pub(crate) fn run(&self, args: &[&str]) -> Said {
        finish(self.evpr().args(args))
    }

    /// A configuration for the synthetic recording: three reconstructions, two windows, two extractors.
    pub(crate) fn ensemble_config(&self) -> PathBuf {
        self.file(
            "ensemble.toml",
            "[sensor]\nheight = 48\nwidth = 64\n[source]\non_outside_sensor = \"error\"\n\
             [slicing]\ntick = \"100ms\"\nwindows = [\"50ms\", \"100ms\"]\norigin = 0\n\
             [[reconstruction]]\nid = \"event_count\"\n[[reconstruction]]\nid = \"time_surface\"\n\
             [[extractor]]\nid = \"patch_norm\"\n[[extractor]]\nid = \"raw_pixels\"\n\
             [fuse]\nsequence = { method = \"paper\", length = 5 }\n[runtime]\ndeadline = \"300ms\"\n",
        )
    }

    /// A synthetic recording: a pattern that moves on with each tick, seen with `noise`.
    pub(crate) fn recording(&self, name: &str, ticks: u64, noise: u64) -> PathBuf {
        let path = self.path(name);
        let mut out = std::io::BufWriter::new(fs::File::create(&path).unwrap());
        writeln!(out, "t x y p").unwrap();
        let mut state = 0x9e37_79b9_7f4a_7c15u64.wrapping_mul(noise + 1);
        let mut random = move |below: u64| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state % below
        };
        const PER_TICK: u64 = 250;
        for tick in 0..=ticks {
            for i in 0..PER_TICK {
                let t_us = tick * TICK_MS * 1_000 + i * (TICK_MS * 1_000 / PER_TICK);
                // Each tick has its own few bright spots.
                let spot = tick * 7 + i % 5;
                let (cx, cy) = ((spot * 37) % 60, (spot * 23) % 44);
                let (x, y) = (cx + random(4), cy + random(4));
                writeln!(
                    out,
                    "{}.{:06} {x} {y} {}",
                    t_us / 1_000_000,
                    t_us % 1_000_000,
                    random(2)
                )
                .unwrap();
            }
        }
        out.flush().unwrap();
        path
    }

    /// Maps a recording, whatever comes of it.
    pub(crate) fn build_map(&self, config: &Path, input: &Path, map: &Path) -> Said {
        let build = ["map", "build", "-q", "-c", text(config)];
        self.run(&[&build[..], &["-i", text(input), "-o", text(map)]].concat())
    }

    /// Records what a recording becomes, and answers nothing.
    pub(crate) fn record(&self, config: &Path, input: &Path, traverse: &Path) -> Said {
        let run = ["run", "-q", "-c", text(config)];
        self.run(&[&run[..], &["-i", text(input), "-r", text(traverse)]].concat())
    }

    /// Maps the synthetic street once.
    pub(crate) fn map(&self, config: &Path) -> PathBuf {
        let recording = self.recording("reference.txt", TICKS, 1);
        let map = self.path("map");
        let said = self.build_map(config, &recording, &map);
        assert_eq!(said.code(), 0, "{}", said.stderr);
        map
    }

    /// What the running instance of the default name has in shared memory.
    pub(crate) fn shared_memory(&self) -> Vec<PathBuf> {
        let prefix = self.shm_prefix();
        let entries = fs::read_dir("/dev/shm").unwrap().flatten();
        let own = entries.filter(|e| e.file_name().to_string_lossy().starts_with(&prefix));
        own.map(|e| e.path()).collect()
    }

    /// Names in /dev/shm that belong to this bench: all of the machine's that were not there before are not told
    /// apart by name, so the run folder's own prefix is asked for.
    pub(crate) fn left_behind(&self) -> Vec<String> {
        let mut left: Vec<String> = fs::read_dir(self.run_root.path())
            .unwrap()
            .flatten()
            .map(|e| e.path().display().to_string())
            .collect();
        let prefix = self.shm_prefix();
        let shared = fs::read_dir("/dev/shm")
            .unwrap()
            .flatten()
            .map(|e| e.file_name().to_string_lossy().into_owned());
        left.extend(shared.filter(|name| name.starts_with(&prefix)));
        left
    }
}

/// The prefix of an instance's names in shared memory (FNV-1a of its run folder).
fn shm_prefix(run_folder: &Path) -> String {
    let hash = run_folder
        .as_os_str()
        .as_encoded_bytes()
        .iter()
        .fold(0xcbf2_9ce4_8422_2325u64, |h, b| {
            (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3)
        });
    format!("evpr{:010x}_", hash & 0xff_ffff_ffff)
}

pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// What starts a quiet run: `more` comes behind.
pub(crate) fn run_args<'a>(
    config: &'a Path,
    input: &'a Path,
    map: &'a Path,
    more: &[&'a str],
) -> Vec<&'a str> {
    let run = [
        "run",
        "-q",
        "-c",
        text(config),
        "-i",
        text(input),
        "-m",
        text(map),
    ];
    [&run, more].concat()
}

/// Kills a process unless it is told that all is well in time.
pub(crate) struct Watchdog {
    _done: Sender<()>,
}

impl Watchdog {
    pub(crate) fn over(pid: u32) -> Self {
        Self::over_within(pid, WATCHDOG)
    }

    pub(crate) fn over_within(pid: u32, longest: Duration) -> Self {
        let (done, wait) = channel::<()>();
        std::thread::spawn(move || {
            if wait.recv_timeout(longest) == Err(RecvTimeoutError::Timeout) {
                eprintln!("watchdog: process {pid} took longer than {longest:?} and is killed");
                let _ =
                    nix::sys::signal::kill(nix::unistd::Pid::from_raw(pid as i32), nix::sys::signal::SIGKILL);
            }
        });
        Self { _done: done }
    }
}

/// Runs a command to its end under the watchdog.
pub(crate) fn finish(command: &mut Command) -> Said {
    let child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let _watchdog = Watchdog::over(child.id());
    let output = child.wait_with_output().unwrap();
    Said {
        status: output.status,
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

/// A running graph whose answers are read as they come.
pub(crate) struct Running {
    child: Child,
    lines: BufReader<ChildStdout>,
    stderr: std::thread::JoinHandle<String>,
    log: Receiver<String>,
    /// Where it was started with one.
    pub(crate) stdin: Option<ChildStdin>,
    pub(crate) answers: Vec<Value>,
    _watchdog: Watchdog,
}

impl Running {
    pub(crate) fn start(bench: &Bench, args: &[&str]) -> Self {
        Self::start_with(bench, args, Stdio::null())
    }

    pub(crate) fn start_with(bench: &Bench, args: &[&str], stdin: Stdio) -> Self {
        let mut child = bench
            .evpr()
            .args(args)
            .stdin(stdin)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap());
        let child_stdin = child.stdin.take();
        let errors = BufReader::new(child.stderr.take().unwrap());
        let (say, log) = channel();
        let stderr = std::thread::spawn(move || {
            let mut text = String::new();
            for line in errors.lines().map_while(Result::ok) {
                text += &line;
                text.push('\n');
                let _ = say.send(line);
            }
            text
        });
        let _watchdog = Watchdog::over(child.id());
        Self {
            child,
            lines,
            stderr,
            log,
            stdin: child_stdin,
            answers: Vec::new(),
            _watchdog,
        }
    }

    /// Waits until a line that it logs contains this; false when it ended before.
    pub(crate) fn logs(&self, what: &str) -> bool {
        self.line(what).is_some()
    }

    /// Waits for a line of its log that contains this.
    pub(crate) fn line(&self, what: &str) -> Option<String> {
        self.log.iter().find(|line| line.contains(what))
    }

    pub(crate) fn pid(&self) -> i32 {
        self.child.id() as i32
    }

    /// Reads answers up to and including this tick; false when the run ended before.
    pub(crate) fn read_to(&mut self, tick: u64) -> bool {
        while self
            .answers
            .last()
            .is_none_or(|a| a["tick"].as_u64().unwrap() < tick)
        {
            let mut line = String::new();
            if self.lines.read_line(&mut line).unwrap() == 0 {
                return false;
            }
            self.answers.push(serde_json::from_str(&line).unwrap());
        }
        true
    }

    /// Process id of the service with this number in the plan, while it runs.
    pub(crate) fn service(&self, number: usize) -> Option<i32> {
        let is_it = |pid: &i32| {
            let line = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let words: Vec<_> = line.split(|b| *b == 0).collect();
            words
                .windows(2)
                .any(|w| w[0] == b"--service" && w[1] == number.to_string().as_bytes())
        };
        self.children().into_iter().find(is_it)
    }

    fn children(&self) -> Vec<i32> {
        let children = fs::read_to_string(format!("/proc/{0}/task/{0}/children", self.pid())).unwrap();
        children
            .split_whitespace()
            .map(|pid| pid.parse().unwrap())
            .collect()
    }

    /// Process ids of the services whose command line has this kind.
    pub(crate) fn services(&self, kind: &str) -> Vec<i32> {
        let of_kind = |pid: &i32| {
            let line = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let words: Vec<_> = line.split(|b| *b == 0).collect();
            words.get(1) == Some(&&b"service"[..]) && words.get(2) == Some(&kind.as_bytes())
        };
        self.children().into_iter().filter(of_kind).collect()
    }

    pub(crate) fn signal(pid: i32, signal: nix::sys::signal::Signal) {
        nix::sys::signal::kill(nix::unistd::Pid::from_raw(pid), signal).unwrap();
    }

    /// Reads to the end.
    pub(crate) fn finish(mut self) -> (Vec<Value>, Said) {
        self.read_to(u64::MAX);
        let status = self.child.wait().unwrap();
        let stderr = self.stderr.join().unwrap();
        (
            self.answers,
            Said {
                status,
                stdout: String::new(),
                stderr,
            },
        )
    }
}

/// Reads a file of answers.
pub(crate) fn read_answers(path: &Path) -> Vec<Value> {
    fs::read_to_string(path)
        .unwrap()
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect()
}

/// Every tick once and in order.
pub(crate) fn assert_ticks(answers: &[Value], ticks: u64) {
    let got: Vec<u64> = answers.iter().map(|a| a["tick"].as_u64().unwrap()).collect();
    assert_eq!(got, (0..ticks).collect::<Vec<_>>());
}

/// An answer without its times.
pub(crate) fn timeless(answer: &Value) -> Value {
    let mut answer = answer.clone();
    answer.as_object_mut().unwrap().remove("latency_us");
    answer
}

/// How many answers give each reason for a missing member.
pub(crate) fn reasons(answers: &[Value]) -> HashMap<String, usize> {
    let mut counts = HashMap::new();
    for answer in answers {
        for reason in answer["missing"].as_object().unwrap().values() {
            *counts.entry(reason.as_str().unwrap().to_owned()).or_default() += 1;
        }
    }
    counts
}

/// The folder with real data beside the project, or None with a note that names the test.
pub(crate) fn shared_data(test: &str, file: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared")
        .join(file);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {test}: {} is absent", path.display());
    None
}
