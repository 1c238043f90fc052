//! The dashboard: one page over HTTP that shows a run as it goes on, and with a token steers it.
//!
//! Whoever runs it gives it data ([`Hub`]) and a way to ask the instance ([`Instance`]); it knows nothing of channels or
//! sockets. [`serve`] takes a listener and answers:
//!
//! | | |
//! |---|---|
//! | `GET /` | the page, with its style and scripts: no request leaves the host |
//! | `GET /api/stream` | server-sent events: what the run is (`graph`), what has been (`history`), then what comes (`answer`, `scores`, `frames`, `process`, `status`, `lost`, `end`) |
//! | `GET /api/frame/RECONSTRUCTION/WINDOW` | the newest frame, by index in the plan, as PNG |
//! | `GET /api/status` | the run at this moment, as `evpr status --json` |
//! | `POST /api/members` | switches and weighs members ([`MembersChange`]), with the token |
//! | `POST /api/set` | changes the fuser's settings ([`SettingsChange`]), with the token |
//!
//! Nobody waits for a browser: each has a bounded queue of events, and one that does not keep up is sent away.

mod api;
mod connection;
mod frame;
mod guard;
mod hub;
mod page;
mod serve;
mod stream;

pub use api::{Change, Instance, MembersChange, Refusal, SettingsChange};
pub use frame::Frame;
pub use guard::{BadToken, Token};
pub use hub::{Graph, Hub, MemberInfo, Moved, Place};
pub use serve::{Options, serve};
