//! The run folder: where one instance keeps its lock, its plan, its sockets and iceoryx2's files; and the names
//! that keep two instances apart.

use crate::RuntimeError;
use crate::channel::Ipc;
use evpr_core::Plan;
use evpr_core::message::{FuseSettings, MemberSetting};
use evpr_core::plan::{self, Rule};
use evpr_core::stage::{self, OpenedTick};
use iceoryx2::prelude::*;
use serde::{Deserialize, Serialize};
use std::fs::{self, File, TryLockError};
use std::io::ErrorKind;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path as FsPath, PathBuf};

/// Socket paths end below this; iceoryx2 adds some fifty characters to the folder.
const MAX_FOLDER_BYTES: usize = 55;

/// The folder of one instance, e.g. `/run/user/1000/evpr/corridor`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunFolder {
    path: PathBuf,
}

/// What the supervisor leaves in the run folder for its processes.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RunSpec {
    /// The run: differs from every other run's on this machine.
    pub run_id: u64,
    /// Process id of the supervisor.
    pub supervisor: u32,
    /// The plan.
    pub plan: Plan,
}

/// Which settings hold from which tick on, for an ingest that starts in the middle of a run.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Schedule {
    /// (first tick, settings), ascending.
    pub(crate) entries: Vec<(u64, Settings)>,
    /// Ticks below this have been opened: changes that come now are not for them.
    pub(crate) opened_before: u64,
    /// The newest tick that has been opened.
    pub(crate) newest: Option<OpenedTick>,
}

/// What a member of the plan shall be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Wanted {
    /// It is wanted, and the governor has not shed it.
    pub(crate) enabled: bool,
    pub(crate) weight: f64,
    /// While it is off, its networks need not stay in memory.
    pub(crate) unload: bool,
}

/// What of the fuser's settings has been changed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct WantedFuse {
    pub(crate) length: Option<u32>,
    pub(crate) rule: Option<Rule>,
    pub(crate) deadline_ns: Option<u64>,
    #[serde(default)]
    pub(crate) min_confidence: Option<f64>,
}

impl WantedFuse {
    pub(crate) fn message(&self) -> FuseSettings {
        FuseSettings {
            length: self.length.unwrap_or(0),
            rule: self.rule.map_or(0, |rule| rule.code()),
            trim: match self.rule {
                Some(Rule::TrimmedMean { trim }) => trim,
                _ => 0.0,
            },
            deadline_ns: self.deadline_ns.unwrap_or(0),
            min_confidence: self.min_confidence.unwrap_or(0.0),
            sets_min_confidence: u32::from(self.min_confidence.is_some()),
            _pad: 0,
        }
    }
}

/// What can change while the run goes on, as it is wanted.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Settings {
    pub(crate) version: u64,
    pub(crate) fuse: WantedFuse,
    pub(crate) members: Vec<Wanted>,
}

impl Settings {
    pub(crate) fn of_plan(plan: &Plan) -> Self {
        let wanted = |m: &plan::Member| Wanted {
            enabled: m.enabled,
            weight: m.weight,
            unload: false,
        };
        Self {
            version: 0,
            fuse: WantedFuse::default(),
            members: plan.members.iter().map(wanted).collect(),
        }
    }

    pub(crate) fn messages(&self) -> Vec<MemberSetting> {
        let message = |wanted: &Wanted| MemberSetting {
            weight: wanted.weight,
            enabled: u32::from(wanted.enabled),
            unload: u32::from(wanted.unload),
        };
        self.members.iter().map(message).collect()
    }

    /// As ingest takes them.
    pub(crate) fn for_ingest(&self) -> stage::Settings {
        stage::Settings {
            version: self.version,
            fuse: self.fuse.message(),
            members: self.messages(),
        }
    }
}

fn io_error(what: &str, path: &FsPath, error: &std::io::Error) -> RuntimeError {
    RuntimeError::Folder(format!("{what} {}: {error}", path.display()))
}

/// Writes a file whole or not at all: readers never see half of it.
fn write_atomically(path: &FsPath, text: &str) -> Result<(), RuntimeError> {
    let draft = path.with_extension("new");
    fs::write(&draft, text).map_err(|e| io_error("cannot write", &draft, &e))?;
    fs::rename(&draft, path).map_err(|e| io_error("cannot write", path, &e))
}

impl RunFolder {
    /// The folder of the instance `name`: under `$EVPR_RUN_DIR`, else `$XDG_RUNTIME_DIR/evpr`, else `/tmp/evpr-<uid>`.
    pub fn of_instance(name: &str) -> Self {
        let root = std::env::var_os("EVPR_RUN_DIR")
            .map(PathBuf::from)
            .or_else(|| std::env::var_os("XDG_RUNTIME_DIR").map(|dir| PathBuf::from(dir).join("evpr")))
            .unwrap_or_else(|| PathBuf::from(format!("/tmp/evpr-{}", nix::unistd::getuid())));
        Self {
            path: root.join(name),
        }
    }

    /// The folder at this path.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// Its path.
    pub fn path(&self) -> &FsPath {
        &self.path
    }

    /// The socket that takes control requests.
    pub(crate) fn control_socket(&self) -> PathBuf {
        self.path.join("control.sock")
    }

    /// Files that outlive the process that writes them, but not the run.
    fn kept(&self) -> PathBuf {
        self.path.join("kept")
    }

    /// Such a file, by the name of its process.
    pub(crate) fn kept_file(&self, name: &str) -> PathBuf {
        self.kept().join(name)
    }

    /// That no instance runs here.
    pub(crate) fn is_not_running(&self) -> RuntimeError {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        RuntimeError::Folder(format!(
            "no instance named \"{name}\" is running ({})",
            self.path.display()
        ))
    }

    fn ipc_root(&self) -> PathBuf {
        self.path.join("ipc")
    }

    /// Begins the names of everything that this instance puts into shared memory.
    pub(crate) fn prefix(&self) -> String {
        // FNV-1a of the folder: one folder, one prefix.
        let hash = self
            .path
            .as_os_str()
            .as_encoded_bytes()
            .iter()
            .fold(0xcbf2_9ce4_8422_2325u64, |h, b| {
                (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3)
            });
        format!("evpr{:010x}_", hash & 0xff_ffff_ffff)
    }

    /// Creates the folder (for its owner alone) and locks it; the lock lasts as long as the returned file.
    ///
    /// # Errors
    /// When another instance of this name runs, or the folder cannot be made.
    pub(crate) fn lock(&self) -> Result<File, RuntimeError> {
        if self.path.as_os_str().len() > MAX_FOLDER_BYTES {
            return Err(RuntimeError::Folder(format!(
                "the run folder {} is too long a path for sockets; set EVPR_RUN_DIR to a shorter one",
                self.path.display()
            )));
        }
        fs::create_dir_all(&self.path).map_err(|e| io_error("cannot create", &self.path, &e))?;
        let owner_only = fs::Permissions::from_mode(0o700);
        fs::set_permissions(&self.path, owner_only)
            .map_err(|e| io_error("cannot protect", &self.path, &e))?;
        let path = self.path.join("lock");
        let file = File::options()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .open(&path)
            .map_err(|e| io_error("cannot open", &path, &e))?;
        match file.try_lock() {
            Ok(()) => Ok(file),
            Err(TryLockError::WouldBlock) => Err(RuntimeError::Folder(format!(
                "an instance named \"{}\" is running already; give this one another name with --name",
                self.path.file_name().unwrap_or_default().to_string_lossy()
            ))),
            Err(TryLockError::Error(e)) => Err(io_error("cannot lock", &path, &e)),
        }
    }

    /// Removes what a run leaves behind in shared memory and in the folder (all but the lock). Only for the holder of
    /// the lock, while none of its processes runs. Returns how many files in shared memory there were.
    pub(crate) fn sweep(&self) -> usize {
        let prefix = self.prefix();
        let mut swept = 0;
        if let Ok(entries) = fs::read_dir("/dev/shm") {
            for entry in entries.flatten() {
                let ours = entry
                    .file_name()
                    .as_encoded_bytes()
                    .starts_with(prefix.as_bytes());
                if ours && fs::remove_file(entry.path()).is_ok() {
                    swept += 1;
                }
            }
        }
        let _ = fs::remove_dir_all(self.ipc_root());
        let _ = fs::remove_dir_all(self.kept());
        for file in ["control.sock", "run.json", "settings.json"] {
            let _ = fs::remove_file(self.path.join(file));
        }
        swept
    }

    /// Removes the folder itself, once it is swept.
    pub(crate) fn remove(&self) {
        let _ = fs::remove_file(self.path.join("lock"));
        let _ = fs::remove_dir(&self.path);
    }

    /// Leaves the plan for the processes.
    pub(crate) fn write_spec(&self, spec: &RunSpec) -> Result<(), RuntimeError> {
        let text = serde_json::to_string(spec).map_err(|e| RuntimeError::Folder(e.to_string()))?;
        fs::create_dir_all(self.kept()).map_err(|e| io_error("cannot create", &self.kept(), &e))?;
        write_atomically(&self.path.join("run.json"), &text)
    }

    /// Reads the plan.
    ///
    /// # Errors
    /// When there is none or it cannot be read.
    pub fn read_spec(&self) -> Result<RunSpec, RuntimeError> {
        let path = self.path.join("run.json");
        let text = fs::read_to_string(&path).map_err(|e| io_error("cannot read", &path, &e))?;
        serde_json::from_str(&text)
            .map_err(|e| RuntimeError::Folder(format!("cannot understand {}: {e}", path.display())))
    }

    pub(crate) fn write_schedule(&self, schedule: &Schedule) -> Result<(), RuntimeError> {
        let text = serde_json::to_string(schedule).map_err(|e| RuntimeError::Folder(e.to_string()))?;
        write_atomically(&self.path.join("settings.json"), &text)
    }

    pub(crate) fn read_schedule(&self) -> Result<Schedule, RuntimeError> {
        let path = self.path.join("settings.json");
        match fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text)
                .map_err(|e| RuntimeError::Folder(format!("cannot understand {}: {e}", path.display()))),
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(Schedule::default()),
            Err(e) => Err(io_error("cannot read", &path, &e)),
        }
    }

    /// A node of this instance. iceoryx2's own signal handling is off: [`crate::Stop`] does it.
    pub(crate) fn node(&self, name: &str) -> Result<Node<Ipc>, RuntimeError> {
        let bad = |e| RuntimeError::ipc(format!("cannot use {} for shared memory", self.path.display()), e);
        let mut config = Config::default();
        config.global.prefix = FileName::new(self.prefix().as_bytes()).map_err(bad)?;
        config
            .global
            .set_root_path(&Path::new(self.ipc_root().as_os_str().as_encoded_bytes()).map_err(bad)?);
        let node_name = NodeName::new(name).map_err(|e| RuntimeError::ipc("bad node name", e))?;
        let node = NodeBuilder::new()
            .name(&node_name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|e| RuntimeError::ipc("cannot create a node in shared memory", e))?;
        self.keep_others_out()?;
        Ok(node)
    }

    /// Takes from others what iceoryx2 gives them: one file, which counts nodes, may be written by everybody.
    fn keep_others_out(&self) -> Result<(), RuntimeError> {
        let prefix = self.prefix();
        let folder = FsPath::new("/dev/shm");
        let entries = fs::read_dir(folder).map_err(|e| io_error("cannot look at", folder, &e))?;
        for entry in entries.flatten() {
            let name = entry.file_name();
            if !name.as_encoded_bytes().starts_with(prefix.as_bytes()) {
                continue;
            }
            let path = entry.path();
            let protected = fs::symlink_metadata(&path).and_then(|meta| {
                let mode = meta.permissions().mode();
                if meta.is_file() && mode & 0o077 != 0 {
                    fs::set_permissions(&path, fs::Permissions::from_mode(mode & 0o700))?;
                }
                Ok(())
            });
            match protected {
                // Another process of this instance has ended.
                Err(e) if e.kind() == ErrorKind::NotFound => {}
                protected => protected.map_err(|e| io_error("cannot protect", &path, &e))?,
            }
        }
        Ok(())
    }
}
