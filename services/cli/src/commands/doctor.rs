//! `evpr doctor`: is this machine fit?

use crate::args::DoctorArgs;
use crate::catalog;
use crate::failure::Failure;
use crate::output::say;
use evpr_core::Plan;
use evpr_core::config::Overrides;
use evpr_runtime::RunFolder;
use nix::sys::resource::{Resource, getrlimit};
use nix::time::{ClockId, clock_getres};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The default size of /dev/shm in containers: what the demo fits into.
const SMALL_SHM_BYTES: u64 = 64 << 20;
/// What a graph with many members opens: channels, events and sockets.
const ENOUGH_FILES: u64 = 1024;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Verdict {
    Ok,
    /// It runs, but not as well as it could.
    Warning,
    /// It does not run.
    Failure,
}

#[derive(Debug, Serialize)]
struct Finding {
    what: &'static str,
    verdict: Verdict,
    found: String,
    /// What to do about it; empty when nothing.
    advice: &'static str,
}

fn finding(what: &'static str, verdict: Verdict, found: String, advice: &'static str) -> Finding {
    Finding {
        what,
        verdict,
        found,
        advice: if verdict == Verdict::Ok { "" } else { advice },
    }
}

fn shared_memory() -> Finding {
    const ADVICE: &str =
        "mount or enlarge /dev/shm (mount -o remount,size=256m /dev/shm; docker run --shm-size=256m)";
    match nix::sys::statvfs::statvfs("/dev/shm") {
        Err(e) => finding(
            "shared memory",
            Verdict::Failure,
            format!("/dev/shm: {e}"),
            ADVICE,
        ),
        Ok(stat) => {
            let size = stat.blocks() * stat.fragment_size();
            let free = stat.blocks_available() * stat.fragment_size();
            let verdict = if free < SMALL_SHM_BYTES {
                Verdict::Warning
            } else {
                Verdict::Ok
            };
            let found = format!("/dev/shm: {} MiB, {} MiB free", size >> 20, free >> 20);
            finding("shared memory", verdict, found, ADVICE)
        }
    }
}

fn writable(what: &'static str, folder: &Path, advice: &'static str) -> Finding {
    let probe = folder.join(format!("evpr-doctor-{}", std::process::id()));
    let tried = std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&probe, b"x"));
    let _ = std::fs::remove_file(&probe);
    match tried {
        Ok(()) => finding(
            what,
            Verdict::Ok,
            format!("{} can be written", folder.display()),
            advice,
        ),
        Err(e) => finding(
            what,
            Verdict::Failure,
            format!("{}: {e}", folder.display()),
            advice,
        ),
    }
}

fn open_files() -> Finding {
    const ADVICE: &str = "raise it: ulimit -n 4096, or LimitNOFILE= in a systemd unit";
    match getrlimit(Resource::RLIMIT_NOFILE) {
        Err(e) => finding(
            "open files",
            Verdict::Warning,
            format!("the limit is not known: {e}"),
            ADVICE,
        ),
        Ok((soft, _)) => {
            let verdict = if soft < ENOUGH_FILES {
                Verdict::Warning
            } else {
                Verdict::Ok
            };
            finding(
                "open files",
                verdict,
                format!("at most {soft} per process"),
                ADVICE,
            )
        }
    }
}

fn processor() -> Finding {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let features = features();
    let verdict = if cores < 2 { Verdict::Warning } else { Verdict::Ok };
    let found = format!("{cores} cores, {}, {features}", std::env::consts::ARCH);
    finding(
        "processor",
        verdict,
        found,
        "processes take turns on one core: expect higher latencies",
    )
}

#[cfg(target_arch = "x86_64")]
fn features() -> String {
    let all = [
        ("sse4.2", is_x86_feature_detected!("sse4.2")),
        ("avx2", is_x86_feature_detected!("avx2")),
        ("fma", is_x86_feature_detected!("fma")),
        ("avx512f", is_x86_feature_detected!("avx512f")),
    ];
    let present: Vec<&str> = all
        .iter()
        .filter(|(_, there)| *there)
        .map(|(name, _)| *name)
        .collect();
    present.join(" ")
}

#[cfg(not(target_arch = "x86_64"))]
fn features() -> String {
    "features not looked at".to_owned()
}

fn clock() -> Finding {
    const ADVICE: &str =
        "latencies cannot be measured better than this; use a kernel with high-resolution timers";
    match clock_getres(ClockId::CLOCK_MONOTONIC) {
        Err(e) => finding(
            "clock",
            Verdict::Failure,
            format!("no monotonic clock: {e}"),
            ADVICE,
        ),
        Ok(step) => {
            let ns = step.tv_sec() as u64 * 1_000_000_000 + step.tv_nsec() as u64;
            let verdict = if ns > 1_000 { Verdict::Warning } else { Verdict::Ok };
            finding("clock", verdict, format!("monotonic, {ns} ns steps"), ADVICE)
        }
    }
}

/// The plan of a configuration, with a fuser and a recorder.
fn plan_of(config: &Path) -> Result<Plan, Failure> {
    let overrides = Overrides {
        map: Some(PathBuf::from("map")),
        record: Some(PathBuf::from("record")),
        ..Overrides::default()
    };
    catalog::plan(config, &overrides)
}

fn room(plan: &Plan) -> Result<Finding, Failure> {
    let room = evpr_runtime::room(plan)?;
    let verdict = if room.needed > room.free {
        Verdict::Failure
    } else {
        Verdict::Ok
    };
    let found = format!("{} MiB needed, {} MiB free", room.needed >> 20, room.free >> 20);
    Ok(finding(
        "room for the plan",
        verdict,
        found,
        "enlarge /dev/shm, or use fewer members (see `evpr graph`)",
    ))
}

/// ONNX Runtime is only needed by networks.
fn onnx_runtime(configured: Option<&Path>) -> Finding {
    match evpr_onnx::Library::load(configured) {
        Ok(library) => finding(
            "ONNX Runtime",
            Verdict::Ok,
            library.path().display().to_string(),
            "",
        ),
        Err(e) => finding(
            "ONNX Runtime",
            Verdict::Warning,
            e.to_string(),
            "needed by networks only: run scripts/get-onnxruntime",
        ),
    }
}

/// `evpr doctor`: exit code 1 when something keeps evpr from running.
pub(crate) fn doctor(args: &DoctorArgs) -> Result<ExitCode, Failure> {
    let instance = RunFolder::of_instance("doctor");
    let run_root = instance.path().parent().unwrap_or(instance.path());
    let mut findings = vec![
        shared_memory(),
        writable(
            "shared memory use",
            Path::new("/dev/shm"),
            "give this user the right to write there",
        ),
        writable(
            "run folder",
            run_root,
            "set EVPR_RUN_DIR to a folder that this user may write",
        ),
        open_files(),
        processor(),
        clock(),
    ];
    let plan = args.config.as_deref().map(plan_of).transpose()?;
    let library = plan.as_ref().and_then(|plan| plan.inference.library.as_deref());
    findings.push(onnx_runtime(library));
    if let Some(plan) = &plan {
        findings.push(room(plan)?);
    }
    if args.json {
        say!("{}", serde_json::to_string_pretty(&findings)?);
    } else {
        for f in &findings {
            let mark = match f.verdict {
                Verdict::Ok => "ok     ",
                Verdict::Warning => "warning",
                Verdict::Failure => "FAILURE",
            };
            say!("{mark}  {:<18} {}", f.what, f.found);
            if !f.advice.is_empty() {
                say!("         {:<18} → {}", "", f.advice);
            }
        }
    }
    let failed = findings.iter().any(|f| f.verdict == Verdict::Failure);
    Ok(if failed {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}
