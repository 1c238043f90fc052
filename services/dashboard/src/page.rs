//! The page: a few texts in the executable.

use crate::api::Shared;
use axum::Router;
use axum::http::header;
use axum::routing::get;

const HTML: &str = "text/html; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Where each is, and what it is.
static TEXTS: [(&str, &str, &str); 6] = [
    ("/", HTML, include_str!("../assets/dashboard.html")),
    ("/dashboard.css", STYLE, include_str!("../assets/dashboard.css")),
    ("/run.js", SCRIPT, include_str!("../assets/run.js")),
    ("/charts.js", SCRIPT, include_str!("../assets/charts.js")),
    ("/tables.js", SCRIPT, include_str!("../assets/tables.js")),
    ("/control.js", SCRIPT, include_str!("../assets/control.js")),
];

/// The routes of the page.
pub(crate) fn routes(router: Router<Shared>) -> Router<Shared> {
    TEXTS.iter().fold(router, |router, text| {
        let (path, kind, body) = *text;
        router.route(
            path,
            get(move || async move { ([(header::CONTENT_TYPE, kind)], body) }),
        )
    })
}
