//! What can be asked over HTTP.

use crate::guard::{Refused, Token, check_change, check_host};
use crate::{Hub, page, stream};
use axum::body::{Body, Bytes, to_bytes};
use axum::extract::{Path, Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Extension, Router};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Semaphore;
use tracing::warn;

/// The longest request, bytes.
const MAX_BODY: usize = 16 << 10;
/// A request whose body does not come within this time is given up.
const BODY_PATIENCE: Duration = Duration::from_secs(5);
/// The instance is asked for its status no more often than this.
const STATUS_AGE: Duration = Duration::from_millis(250);
/// Questions to the instance that are under way at a time.
const QUESTIONS: usize = 4;

/// How to ask the instance. Its methods may take a while: they are called on threads of their own.
pub trait Instance: Send + Sync + 'static {
    /// How the run is: JSON.
    ///
    /// # Errors
    /// Why that is not known, in one line.
    fn status(&self) -> Result<String, String>;

    /// Changes something, for this client; gives the reply as JSON.
    ///
    /// # Errors
    /// When the change is refused, or the instance does not answer.
    fn change(&self, change: Change, who: &str) -> Result<String, Refusal>;
}

/// A change that somebody wants.
#[derive(Debug, Clone, PartialEq)]
pub enum Change {
    /// Of members.
    Members(MembersChange),
    /// Of the fuser's settings.
    Settings(SettingsChange),
}

/// The body of `POST /api/members`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MembersChange {
    /// Names; `all` stands for every member.
    pub members: Vec<String>,
    /// Whether they shall be enabled, if that changes.
    pub enabled: Option<bool>,
    /// Their weight, if that changes: not negative.
    pub weight: Option<f64>,
    /// With `enabled: false`: networks that work for nobody else give their memory back.
    #[serde(default)]
    pub unload: bool,
}

/// The body of `POST /api/set`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingsChange {
    /// Sequence length, ticks.
    pub length: Option<u32>,
    /// Fusion rule.
    pub rule: Option<String>,
    /// Latest delivery: when an answer is due after its last window closed, such as `300ms`.
    pub deadline: Option<String>,
    /// The least confidence of an answer, 0 to 1.
    pub min_confidence: Option<f64>,
}

/// Why nothing was changed, in one line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Refusal {
    /// It makes no sense.
    Refused(String),
    /// The instance does not answer.
    Silent(String),
}

/// What the handlers share.
#[derive(Clone)]
pub(crate) struct Shared {
    pub(crate) hub: Arc<Hub>,
    pub(crate) instance: Arc<dyn Instance>,
    pub(crate) token: Option<Token>,
    questions: Arc<Semaphore>,
}

impl Shared {
    pub(crate) fn new(hub: Arc<Hub>, instance: Arc<dyn Instance>, token: Option<Token>) -> Self {
        Self {
            hub,
            instance,
            token,
            questions: Arc::new(Semaphore::new(QUESTIONS)),
        }
    }
}

/// All routes.
pub(crate) fn router(shared: Shared) -> Router {
    page::routes(Router::new())
        .route("/api/stream", get(events))
        .route("/api/frame/{reconstruction}/{window}", get(frame))
        .route("/api/status", get(status))
        .route("/api/members", post(members))
        .route("/api/set", post(settings))
        .fallback(async || failed(StatusCode::NOT_FOUND, "there is nothing here; the page is at /"))
        .method_not_allowed_fallback(async || {
            failed(
                StatusCode::METHOD_NOT_ALLOWED,
                "this address is not asked in this way",
            )
        })
        .layer(middleware::from_fn(guarded))
        .with_state(shared)
}

fn failed(code: StatusCode, why: &str) -> Response {
    json(code, serde_json::json!({ "error": why }).to_string())
}

fn json(code: StatusCode, text: String) -> Response {
    (code, [(header::CONTENT_TYPE, "application/json")], text + "\n").into_response()
}

/// Refuses who names another host, and tells browsers how little the page may do.
async fn guarded(request: Request, next: Next) -> Response {
    let mut response = match check_host(request.headers()) {
        Ok(()) => next.run(request).await,
        Err((code, why)) => failed(code, why),
    };
    const ALWAYS: [(HeaderName, &str); 6] = [
        (
            header::CONTENT_SECURITY_POLICY,
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
             frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
        ),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (
            HeaderName::from_static("cross-origin-resource-policy"),
            "same-origin",
        ),
        (
            HeaderName::from_static("cross-origin-opener-policy"),
            "same-origin",
        ),
    ];
    for (name, value) in ALWAYS {
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn events(State(shared): State<Shared>) -> Response {
    match shared.hub.view() {
        Some((first, next)) => stream::respond(first, next),
        None => failed(
            StatusCode::SERVICE_UNAVAILABLE,
            "the run has ended, or too many look at it",
        ),
    }
}

async fn frame(State(shared): State<Shared>, Path(which): Path<(usize, usize)>) -> Response {
    match shared.hub.newest_frame(which).and_then(|frame| frame.png()) {
        Some(png) => ([(header::CONTENT_TYPE, "image/png")], png).into_response(),
        None => failed(StatusCode::NOT_FOUND, "there is no such frame now"),
    }
}

/// Asks the instance on a thread of its own.
async fn ask<T: Send + 'static>(
    shared: &Shared,
    question: impl FnOnce(&dyn Instance) -> T + Send + 'static,
) -> Result<T, Response> {
    let busy = |_| failed(StatusCode::SERVICE_UNAVAILABLE, "the dashboard is ending");
    let turn = shared
        .questions
        .clone()
        .acquire_owned()
        .await
        .map_err(|e| busy(e.to_string()))?;
    let instance = shared.instance.clone();
    let answer = tokio::task::spawn_blocking(move || {
        let answer = question(&*instance);
        drop(turn);
        answer
    });
    answer.await.map_err(|e| busy(e.to_string()))
}

async fn status(State(shared): State<Shared>) -> Response {
    if let Some(text) = shared.hub.recent_status(STATUS_AGE) {
        return json(StatusCode::OK, text);
    }
    let hub = shared.hub.clone();
    let asked = ask(&shared, move |instance| {
        // Others may have asked while this one waited for its turn.
        if let Some(text) = hub.recent_status(STATUS_AGE) {
            return Ok(text);
        }
        let status = instance.status();
        hub.status(status.clone());
        status
    });
    match asked.await {
        Ok(Ok(text)) => json(StatusCode::OK, text),
        Ok(Err(why)) => failed(StatusCode::SERVICE_UNAVAILABLE, &why),
        Err(response) => response,
    }
}

async fn members(
    State(shared): State<Shared>,
    Extension(client): Extension<SocketAddr>,
    request: Request,
) -> Response {
    change(shared, client, request, Change::Members).await
}

async fn settings(
    State(shared): State<Shared>,
    Extension(client): Extension<SocketAddr>,
    request: Request,
) -> Response {
    change(shared, client, request, Change::Settings).await
}

/// The body as JSON of this form.
async fn body<T: DeserializeOwned>(body: Body) -> Result<T, (StatusCode, String)> {
    let read = tokio::time::timeout(BODY_PATIENCE, to_bytes(body, MAX_BODY)).await;
    let bytes: Bytes = match read {
        Ok(Ok(bytes)) => bytes,
        Ok(Err(_)) => {
            return Err((
                StatusCode::PAYLOAD_TOO_LARGE,
                format!("a request has at most {MAX_BODY} bytes, and comes whole"),
            ));
        }
        Err(_) => return Err((StatusCode::REQUEST_TIMEOUT, "the request did not come".to_owned())),
    };
    serde_json::from_slice(&bytes).map_err(|e| {
        (
            StatusCode::BAD_REQUEST,
            format!("cannot understand the request: {e}"),
        )
    })
}

async fn change<T: DeserializeOwned + Send + 'static>(
    shared: Shared,
    client: SocketAddr,
    request: Request,
    wrap: fn(T) -> Change,
) -> Response {
    if let Err((code, why)) = check_change(request.headers(), shared.token.as_ref()) as Result<(), Refused> {
        warn!("http {client} may not change anything: {why}");
        return failed(code, why);
    }
    let wanted = match body::<T>(request.into_body()).await {
        Ok(wanted) => wrap(wanted),
        Err((code, why)) => return failed(code, &why),
    };
    let asked = ask(&shared, move |instance| {
        instance.change(wanted, &format!("http {client}"))
    });
    let changed = asked.await;
    shared.hub.want_status();
    match changed {
        Ok(Ok(text)) => json(StatusCode::OK, text),
        Ok(Err(Refusal::Refused(why))) => failed(StatusCode::BAD_REQUEST, &why),
        Ok(Err(Refusal::Silent(why))) => failed(StatusCode::SERVICE_UNAVAILABLE, &why),
        Err(response) => response,
    }
}
