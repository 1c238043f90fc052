//! The control socket of a running instance: one JSON request per connection, one JSON reply.

use crate::RuntimeError;
use crate::channel::WakeSender;
use crate::domain::RunFolder;
use crate::profile::Status;
use crossbeam::channel::{Receiver, Sender, bounded};
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;
use tracing::warn;

/// A client that does not say what it wants within this time is sent away.
const PATIENCE: Duration = Duration::from_secs(2);
/// Longest time until a change has taken effect and is answered.
const REPLY_TIMEOUT: Duration = Duration::from_secs(10);
/// Clients that are served at a time.
const MAX_CLIENTS: usize = 16;
const MAX_REQUEST_BYTES: u64 = 64 << 10;

/// What can be asked of a running instance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "ask")]
pub enum ControlRequest {
    /// The members with their settings.
    List,
    /// How everything is: see [`Status`].
    Status,
    /// Changes members from the next tick on.
    Set {
        /// Names; `all` stands for every member.
        members: Vec<String>,
        /// Whether they shall be enabled, if that changes.
        enabled: Option<bool>,
        /// Their weight, if that changes: finite, not negative.
        weight: Option<f64>,
        /// With `enabled: false`: networks that work for nobody else need not stay in memory.
        #[serde(default)]
        unload: bool,
    },
    /// Changes the fuser's settings from the next tick on.
    Configure {
        /// Sequence length, ticks: 1 to [`MAX_LENGTH`].
        length: Option<u32>,
        /// Name of the fusion rule.
        rule: Option<String>,
        /// Latest delivery: when an answer is due after its last window closed, ns.
        deadline_ns: Option<u64>,
        /// The least confidence of an answer, 0 to 1: below it there is none.
        #[serde(default)]
        min_confidence: Option<f64>,
    },
}

pub(crate) use evpr_core::plan::{MAX_DEADLINE_NS, MAX_LENGTH};

/// A request as it goes over the socket.
#[derive(Debug, Serialize, Deserialize)]
struct Asking {
    #[serde(flatten)]
    request: ControlRequest,
    /// For whom, where a process asks for somebody else.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    on_behalf_of: Option<String>,
}

/// Who asks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Peer {
    pub(crate) uid: u32,
    pub(crate) pid: i32,
    /// As the process at the other end says.
    pub(crate) on_behalf_of: Option<String>,
}

impl std::fmt::Display for Peer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        const LONGEST: usize = 64;
        if let Some(other) = &self.on_behalf_of {
            let plain = |c: char| if c.is_ascii_graphic() || c == ' ' { c } else { '?' };
            let other: String = other.chars().take(LONGEST).map(plain).collect();
            write!(f, "{other} by ")?;
        }
        write!(f, "uid {} pid {}", self.uid, self.pid)
    }
}

/// A change of settings.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Change {
    /// When it was asked for, ms since 1970.
    pub at_unix_ms: u64,
    /// Who asked: user and process of whoever was connected to the socket, with the client that a dashboard asked for;
    /// or `governor`.
    pub who: String,
    /// What changed.
    pub what: String,
    /// The first tick at which it holds; none while no tick has opened since.
    pub from_tick: Option<u64>,
}

/// One member's settings.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MemberState {
    /// Its name.
    pub name: String,
    /// Whether it is enabled.
    pub enabled: bool,
    /// Whether it is off because the governor shed it.
    #[serde(default)]
    pub shed: bool,
    /// Its weight.
    pub weight: f64,
}

/// The answer.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ControlReply {
    /// Why the request was refused, if it was.
    pub error: Option<String>,
    /// The members as they are wanted now.
    pub members: Vec<MemberState>,
    /// The first tick at which a change is in force everywhere; none when no tick has opened since.
    pub from_tick: Option<u64>,
    /// How everything is, if that was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub status: Option<Box<Status>>,
}

impl ControlReply {
    pub(crate) fn refusal(error: String) -> Self {
        Self {
            error: Some(error),
            ..Self::default()
        }
    }
}

/// A request with the way back.
#[derive(Debug)]
pub(crate) struct Asked {
    pub(crate) request: ControlRequest,
    pub(crate) peer: Peer,
    pub(crate) reply: Sender<ControlReply>,
}

impl Asked {
    /// Answers the client; one that has gone is its own affair.
    pub(crate) fn answer(self, reply: ControlReply) {
        let _ = self.reply.send(reply);
    }

    /// Sends the client away: the run is ending.
    pub(crate) fn refuse(self) {
        let _ = self
            .reply
            .send(ControlReply::refusal("the instance is stopping".to_owned()));
    }
}

/// Takes requests on a thread of its own and hands them to the supervisor's loop.
#[derive(Debug)]
pub(crate) struct ControlServer {
    path: PathBuf,
    closing: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
    pub(crate) requests: Receiver<Asked>,
}

impl ControlServer {
    pub(crate) fn start(folder: &RunFolder, wake: WakeSender) -> Result<Self, RuntimeError> {
        let path = folder.control_socket();
        let failed =
            |e: std::io::Error| RuntimeError::Folder(format!("cannot listen on {}: {e}", path.display()));
        let listener = UnixListener::bind(&path).map_err(failed)?;
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).map_err(failed)?;
        let (asked, requests) = bounded(4);
        let closing = Arc::new(AtomicBool::new(false));
        let closed = closing.clone();
        let under_way = Arc::new(AtomicUsize::new(0));
        let thread = std::thread::Builder::new()
            .name("control".to_owned())
            .spawn(move || {
                for stream in listener.incoming() {
                    if closed.load(Ordering::Acquire) {
                        return;
                    }
                    let Ok(stream) = stream else { continue };
                    if under_way.fetch_add(1, Ordering::AcqRel) >= MAX_CLIENTS {
                        under_way.fetch_sub(1, Ordering::AcqRel);
                        continue; // dropped: it is told so by the end of the stream
                    }
                    let (asked, wake, done) = (asked.clone(), wake.clone(), under_way.clone());
                    // One thread per client, so that one that dawdles keeps nobody else waiting.
                    let served = std::thread::Builder::new()
                        .name("client".to_owned())
                        .spawn(move || {
                            // A client that hangs up early is its own affair.
                            let _ = serve(&stream, &asked, &wake);
                            done.fetch_sub(1, Ordering::AcqRel);
                        });
                    if let Err(e) = served {
                        warn!("a control request cannot be served: {e}");
                        under_way.fetch_sub(1, Ordering::AcqRel);
                    }
                }
            })
            .map_err(|e| RuntimeError::Process(format!("cannot start a thread: {e}")))?;
        Ok(Self {
            path,
            closing,
            thread: Some(thread),
            requests,
        })
    }
}

impl Drop for ControlServer {
    fn drop(&mut self) {
        self.closing.store(true, Ordering::Release);
        while let Ok(asked) = self.requests.try_recv() {
            asked.refuse();
        }
        // The accept loop looks at the flag when somebody knocks.
        let knocked = UnixStream::connect(&self.path).is_ok();
        if let (true, Some(thread)) = (knocked, self.thread.take()) {
            let _ = thread.join();
        }
        let _ = std::fs::remove_file(&self.path);
    }
}

fn serve(stream: &UnixStream, asked: &Sender<Asked>, wake: &WakeSender) -> std::io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let peer = nix::sys::socket::getsockopt(&stream, nix::sys::socket::sockopt::PeerCredentials)?;
    let (uid, pid) = (peer.uid(), peer.pid());
    let mut line = String::new();
    BufReader::new(stream.take(MAX_REQUEST_BYTES)).read_line(&mut line)?;
    let reply = match serde_json::from_str(&line) {
        Ok(Asking {
            request,
            on_behalf_of,
        }) => {
            let peer = Peer {
                uid,
                pid,
                on_behalf_of,
            };
            let (reply, answered) = bounded(1);
            let unanswered = || ControlReply::refusal("the instance is stopping".to_owned());
            match asked.send(Asked { request, peer, reply }) {
                Ok(()) => {
                    wake.wake();
                    answered
                        .recv_timeout(REPLY_TIMEOUT)
                        .unwrap_or_else(|_| unanswered())
                }
                Err(_) => unanswered(),
            }
        }
        Err(e) => ControlReply::refusal(format!("cannot understand the request: {e}")),
    };
    let mut text = serde_json::to_string(&reply)?;
    text.push('\n');
    (&mut &*stream).write_all(text.as_bytes())
}

/// Asks the instance of this folder.
///
/// # Errors
/// When no instance runs there, or it does not answer.
pub fn request(folder: &RunFolder, request: &ControlRequest) -> Result<ControlReply, RuntimeError> {
    ask(folder, request, None)
}

/// Asks the instance of this folder for somebody else, whom the audit line names.
///
/// # Errors
/// As [`request`].
pub fn request_for(
    folder: &RunFolder,
    request: &ControlRequest,
    who: &str,
) -> Result<ControlReply, RuntimeError> {
    ask(folder, request, Some(who.to_owned()))
}

fn ask(
    folder: &RunFolder,
    request: &ControlRequest,
    on_behalf_of: Option<String>,
) -> Result<ControlReply, RuntimeError> {
    let path = folder.control_socket();
    let name = folder.path().file_name().unwrap_or_default().to_string_lossy();
    let silent =
        |e: std::io::Error| RuntimeError::Folder(format!("the instance \"{name}\" does not answer: {e}"));
    let stream = UnixStream::connect(&path).map_err(|e| {
        RuntimeError::Folder(format!(
            "no instance named \"{name}\" is running ({}: {e})",
            path.display()
        ))
    })?;
    stream
        .set_read_timeout(Some(REPLY_TIMEOUT + PATIENCE))
        .map_err(silent)?;
    let asking = Asking {
        request: request.clone(),
        on_behalf_of,
    };
    let mut text = serde_json::to_string(&asking).map_err(|e| RuntimeError::Folder(e.to_string()))?;
    text.push('\n');
    (&mut &stream).write_all(text.as_bytes()).map_err(silent)?;
    let mut line = String::new();
    BufReader::new(&stream).read_line(&mut line).map_err(silent)?;
    serde_json::from_str(&line)
        .map_err(|e| RuntimeError::Folder(format!("the instance \"{name}\" answered nonsense: {e}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_say_for_whom_and_the_log_stays_one_line() {
        let asking: Asking = serde_json::from_str("{\"ask\":\"status\"}").unwrap();
        assert_eq!(
            (asking.request, asking.on_behalf_of),
            (ControlRequest::Status, None)
        );
        let asking = Asking {
            request: ControlRequest::List,
            on_behalf_of: Some("http\n127.0.0.1:5 ".to_owned() + &"x".repeat(100)),
        };
        let text = serde_json::to_string(&asking).unwrap();
        let asking: Asking = serde_json::from_str(&text).unwrap();
        let peer = Peer {
            uid: 1,
            pid: 2,
            on_behalf_of: asking.on_behalf_of,
        };
        let said = peer.to_string();
        assert!(
            said.starts_with("http?127.0.0.1:5 xx") && said.ends_with("x by uid 1 pid 2"),
            "{said}"
        );
        assert!(said.len() < 100);
    }
}
