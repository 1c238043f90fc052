//! The dashboard of a run: its socket and token, which are there before anything starts and outlive its process; and that
//! process, which reads along and serves the page.

use crate::args::RunArgs;
use crate::failure::Failure;
use crate::{colors, matches};
use evpr_core::message::{
    Candidate, ChannelOrder, FrameHeader, MatchHeader, ScoresHeader, ServiceHealth, ServiceState,
};
use evpr_core::plan::{Delivery, Rule, SCORE_COLUMNS};
use evpr_core::time::parse_duration_ns;
use evpr_core::{Plan, Reason};
use evpr_dashboard::{
    Change, Frame, Graph, Hub, Instance, MemberInfo, Moved, Options, Place, Refusal, Token, serve,
};
use evpr_fuse::{Observer, write_overview};
use evpr_runtime::{
    ControlReply, ControlRequest, RunFolder, ScoresSender, ServiceContext, Spectator, request, request_for,
    run_watcher,
};
use std::fs::File;
use std::io::Read;
use std::net::{SocketAddr, TcpListener};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tracing::warn;

/// Carries the token to the dashboard's process. The environment of a process is its user's alone to read.
const TOKEN_VARIABLE: &str = "EVPR_DASHBOARD_TOKEN";
/// The most places of the route that the page is given.
const MOST_PLACES: usize = 2_000;
/// How often the instance is asked how it is, while somebody looks.
const CALM: Duration = Duration::from_secs(1);
/// The same while a process is not there.
const UNEASY: Duration = Duration::from_millis(200);

/// Where the dashboard serves. Held by `evpr run`, so that a dashboard that dies finds it again.
#[derive(Debug)]
pub(crate) struct DashboardSocket {
    listener: TcpListener,
    token: Option<String>,
}

impl DashboardSocket {
    /// Listens where the command line says, if it does, and says where the page is.
    pub(crate) fn open(args: &RunArgs) -> Result<Option<Self>, Failure> {
        let Some(address) = args.dashboard else {
            return Ok(None);
        };
        let token = match (&args.token_file, args.allow_control) {
            (Some(path), _) => Some(read_token(path)?),
            (None, true) => Some(new_token()?),
            (None, false) => None,
        };
        let listener = TcpListener::bind(address).map_err(|e| {
            Failure::new(format!(
                "cannot listen for the dashboard at {address}: {e}; give --dashboard another address or port"
            ))
        })?;
        let address = listener.local_addr()?;
        match (&token, &args.token_file) {
            (Some(token), None) => eprintln!("dashboard: http://{address}/#token={token}"),
            (_, None) => eprintln!("dashboard: http://{address}/"),
            (_, Some(path)) => eprintln!(
                "dashboard: http://{address}/ (to change the run, add #token= and what {} holds)",
                path.display()
            ),
        }
        if !address.ip().is_loopback() {
            warn_of_others(&address, token.is_some());
        }
        Ok(Some(Self { listener, token }))
    }

    /// Gives the process that is about to be started what it needs: the socket as its standard input.
    pub(crate) fn hand_over(&self, command: &mut Command) {
        // One that cannot be copied is missed by the process itself, which says so.
        if let Ok(listener) = self.listener.try_clone() {
            command.stdin(Stdio::from(OwnedFd::from(listener)));
        }
        match &self.token {
            Some(token) => command.env(TOKEN_VARIABLE, token),
            None => command.env_remove(TOKEN_VARIABLE),
        };
    }
}

fn warn_of_others(address: &SocketAddr, control: bool) {
    let read = "whoever reaches it sees the run";
    let change = if control {
        ", and the token goes over the network in the clear: put something with TLS in front of it"
    } else {
        ""
    };
    warn!("the dashboard at {address} is not for this machine alone: {read}{change}");
}

/// 128 random bits.
fn new_token() -> Result<String, Failure> {
    let mut bytes = [0; 16];
    File::open("/dev/urandom")
        .and_then(|mut random| random.read_exact(&mut bytes))
        .map_err(|e| {
            Failure::new(format!(
                "cannot make a token from /dev/urandom: {e}; give --token-file"
            ))
        })?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn read_token(path: &Path) -> Result<String, Failure> {
    const LONGEST: u64 = 4 << 10;
    let failed = |what: String| Failure::new(format!("{}: {what}", path.display()));
    let file = File::open(path).map_err(|e| failed(format!("the token cannot be read: {e}")))?;
    if file.metadata().is_ok_and(|about| about.mode() & 0o077 != 0) {
        warn!(
            "{}: others than you may read the token; chmod 600 it",
            path.display()
        );
    }
    let mut text = String::new();
    file.take(LONGEST)
        .read_to_string(&mut text)
        .map_err(|e| failed(format!("the token cannot be read: {e}")))?;
    let text = text.trim();
    Token::new(text).map_err(|e| failed(format!("{e}; such as of `openssl rand -hex 16`")))?;
    Ok(text.to_owned())
}

/// Sends the dashboard what the fuser made of a tick.
pub(crate) fn observer(mut scores: ScoresSender, members: usize) -> Observer {
    Box::new(move |tick| {
        if tick.fused.is_empty() || !scores.is_due() {
            return;
        }
        let columns = tick.fused.len().min(SCORE_COLUMNS);
        let header = ScoresHeader {
            tick: tick.tick,
            references: tick.fused.len() as u64,
            columns: columns as u32,
            ..ScoresHeader::default()
        };
        scores.send(header, columns + members, &mut |out| {
            write_overview(&tick, columns, out);
        });
    })
}

/// The dashboard's process: shows the run until it is asked to stop.
pub(crate) fn work(ctx: ServiceContext) -> Result<(), Failure> {
    let listener = TcpListener::from(std::io::stdin().as_fd().try_clone_to_owned()?);
    listener
        .local_addr()
        .map_err(|_| Failure::usage("the dashboard is started by `evpr run --dashboard ADDRESS`"))?;
    let token = match std::env::var(TOKEN_VARIABLE) {
        Ok(text) => Some(Token::new(&text)?),
        Err(_) => None,
    };
    let hub = Arc::new(Hub::new(&graph(&ctx.plan, token.is_some()))?);
    let asker = Arc::new(Asker(ctx.folder().clone()));
    let ending = Arc::new(AtomicBool::new(false));
    let http = {
        let (hub, asker, stop) = (hub.clone(), asker.clone(), ctx.stop().clone());
        let serving = move || {
            let served = serve(listener, Options { token }, hub, asker);
            stop.raise();
            served
        };
        std::thread::Builder::new()
            .name("http".to_owned())
            .spawn(serving)?
    };
    {
        let (hub, ending) = (hub.clone(), ending.clone());
        let asking = move || keep_asking(&hub, &asker, &ending);
        // Not waited for: its question may take longer than anybody wants to wait at the end.
        std::thread::Builder::new()
            .name("status".to_owned())
            .spawn(asking)?;
    }
    let mut show = Show {
        plan: ctx.plan.clone(),
        hub: hub.clone(),
        known: Vec::new(),
    };
    let watched = run_watcher(ctx, &mut show);
    ending.store(true, Ordering::Release);
    hub.end();
    let served = http.join();
    watched?;
    match served {
        Ok(served) => Ok(served?),
        Err(_) => Err(Failure::new("the dashboard's server ended unexpectedly")),
    }
}

/// Asks the instance how it is, for as long as somebody looks.
fn keep_asking(hub: &Hub, asker: &Asker, ending: &AtomicBool) {
    let mut pause = CALM;
    while !ending.load(Ordering::Acquire) {
        hub.wait(pause);
        if !hub.is_watched() {
            continue;
        }
        let status = asker.ask();
        let there = |state: &str| matches!(state, "ready" | "done");
        let calm = status
            .as_ref()
            .is_ok_and(|s| s.services.iter().all(|s| there(&s.state)));
        pause = if calm { CALM } else { UNEASY };
        hub.status(status.and_then(|s| serde_json::to_string(&s).map_err(|e| e.to_string())));
    }
}

/// What does not change of a run.
fn graph(plan: &Plan, control: bool) -> Graph {
    let (references, route) = places(plan);
    Graph {
        name: plan.name.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        delivery: match plan.delivery {
            Delivery::Lossless => "lossless",
            Delivery::Latest => "latest",
        }
        .to_owned(),
        reconstructions: plan.reconstructions.iter().map(|r| r.id.clone()).collect(),
        windows: (0..plan.slicing.windows.len())
            .map(|w| plan.slicing.window_id(w))
            .collect(),
        members: plan
            .members
            .iter()
            .map(|m| MemberInfo {
                name: m.name.clone(),
                reconstruction: m.reconstruction,
                window: m.window,
            })
            .collect(),
        references,
        exclusion: plan.fuse.exclusion as u64,
        route,
        rules: (1..)
            .map_while(|code| Rule::from_code(code, Rule::TRIM))
            .map(|rule| rule.name().to_owned())
            .collect(),
        has_length: plan.fuse.sequence.has_length(),
        has_deadline: plan.delivery == Delivery::Latest,
        control,
    }
}

/// How many places the map has, and where some of them are.
fn places(plan: &Plan) -> (u64, Vec<Place>) {
    let Some(path) = &plan.map else {
        return (0, Vec::new());
    };
    let map = match evpr_store::Traverse::open(path) {
        Ok(map) => map,
        Err(e) => {
            warn!("the dashboard shows no route: {e}");
            return (0, Vec::new());
        }
    };
    let ticks = map.ticks();
    let every = ticks.len().div_ceil(MOST_PLACES).max(1);
    let place = |tick: &evpr_store::TickRecord| {
        tick.position.map(|[east_m, north_m]| Place {
            reference: tick.tick,
            east_m,
            north_m,
        })
    };
    let route = ticks.iter().step_by(every).filter_map(place).collect();
    (ticks.len() as u64, route)
}

/// Asks the instance over its control socket.
struct Asker(RunFolder);

impl Asker {
    fn ask(&self) -> Result<evpr_runtime::Status, String> {
        let reply = request(&self.0, &ControlRequest::Status).map_err(|e| e.to_string())?;
        match (reply.error, reply.status) {
            (None, Some(status)) => Ok(*status),
            (error, _) => Err(error.unwrap_or_else(|| "the instance does not say how it is".to_owned())),
        }
    }
}

/// The request for a change.
fn wanted(change: Change) -> Result<ControlRequest, String> {
    Ok(match change {
        Change::Members(change) => ControlRequest::Set {
            members: change.members,
            enabled: change.enabled,
            weight: change.weight,
            unload: change.unload,
        },
        Change::Settings(change) => ControlRequest::Configure {
            length: change.length,
            rule: change.rule,
            deadline_ns: change.deadline.as_deref().map(parse_duration_ns).transpose()?,
            min_confidence: change.min_confidence,
        },
    })
}

impl Instance for Asker {
    fn status(&self) -> Result<String, String> {
        serde_json::to_string(&self.ask()?).map_err(|e| e.to_string())
    }

    fn change(&self, change: Change, who: &str) -> Result<String, Refusal> {
        let request = wanted(change).map_err(Refusal::Refused)?;
        let silent = |e: &dyn std::fmt::Display| Refusal::Silent(e.to_string());
        let reply: ControlReply = request_for(&self.0, &request, who).map_err(|e| silent(&e))?;
        match reply.error {
            Some(why) => Err(Refusal::Refused(why)),
            None => serde_json::to_string(&reply).map_err(|e| silent(&e)),
        }
    }
}

/// Hands on what there is to see.
struct Show {
    plan: Plan,
    hub: Arc<Hub>,
    /// Per service, as it was last heard of.
    known: Vec<ServiceState>,
}

impl Spectator for Show {
    fn answer(&mut self, header: &MatchHeader, candidates: &[Candidate]) {
        match matches::text(&self.plan, header, candidates) {
            Ok(line) => self.hub.answer(line),
            Err(e) => warn!("an answer cannot be shown: {e}"),
        }
    }

    fn scores(&mut self, header: &ScoresHeader, values: &[f32]) {
        if let Some((columns, places)) = values.split_at_checked(header.columns as usize) {
            self.hub.scores(header.tick, columns, places);
        }
    }

    fn frame(&mut self, header: &FrameHeader, pixels: &[u8]) {
        if !self.hub.is_watched() {
            return;
        }
        let (height, width) = (header.height as usize, header.width as usize);
        let frame = match (
            Reason::from_code(header.reason),
            ChannelOrder::from_code(header.channel_order),
        ) {
            (Some(reason), _) => Err(reason.text()),
            (None, None) => Err("its channels are not known"),
            (None, Some(order)) => {
                let pixels = colors::pixels(order, pixels).map(|pixel| colors::color(order, pixel));
                Frame::new(height, width, pixels).ok_or("it is too small")
            }
        };
        let which = (header.reconstruction as usize, header.window as usize);
        self.hub.frame(which, (header.tick, header.events), frame);
    }

    fn lifecycle(&mut self, services: &[ServiceState]) {
        let all = self.plan.services();
        for (index, (service, now)) in all.iter().zip(services).enumerate() {
            // Of who is not known yet, only what is wrong now is told.
            let before = self.known.get(index).copied().unwrap_or(ServiceState {
                dead_through: now.dead_through,
                ..ServiceState::default()
            });
            let up = |state: &ServiceState| state.health == ServiceHealth::Up as u32;
            if now.dead_through > before.dead_through || (up(&before) && !up(now)) {
                let given_up = now.health == ServiceHealth::Down as u32;
                let moved = if given_up { Moved::GivenUp } else { Moved::Down };
                self.hub.process(&service.name, moved);
                if up(now) {
                    self.hub.process(&service.name, Moved::Back);
                }
            } else if !up(&before) && up(now) {
                self.hub.process(&service.name, Moved::Back);
            }
        }
        self.known = services.to_vec();
        self.hub.want_status();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_dashboard::SettingsChange;

    #[test]
    fn tokens_are_random_and_accepted() {
        let (a, b) = (new_token().unwrap(), new_token().unwrap());
        assert_ne!(a, b);
        assert_eq!(a.len(), 32);
        assert!(Token::new(&a).is_ok());
    }

    #[test]
    fn a_deadline_is_written_as_in_configurations() {
        let change = |deadline: &str| {
            wanted(Change::Settings(SettingsChange {
                length: None,
                rule: None,
                deadline: Some(deadline.to_owned()),
                min_confidence: None,
            }))
        };
        let ControlRequest::Configure { deadline_ns, .. } = change("1.5s").unwrap() else {
            panic!("a change of settings");
        };
        assert_eq!(deadline_ns, Some(1_500_000_000));
        assert!(change("soon").unwrap_err().contains("is not a duration"));
    }
}
