//! Events to one browser.

use axum::body::Body;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_core::Stream;
use std::convert::Infallible;
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::sync::mpsc::Receiver;

struct Events {
    first: Option<Bytes>,
    next: Receiver<Bytes>,
}

impl Stream for Events {
    type Item = Result<Bytes, Infallible>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if let Some(first) = self.first.take() {
            return Poll::Ready(Some(Ok(first)));
        }
        self.next.poll_recv(context).map(|event| event.map(Ok))
    }
}

/// Server-sent events: these first, then what comes, until the sender is gone.
pub(crate) fn respond(first: Bytes, next: Receiver<Bytes>) -> Response {
    let events = Events {
        first: Some(first),
        next,
    };
    (
        [(header::CONTENT_TYPE, "text/event-stream")],
        Body::from_stream(events),
    )
        .into_response()
}
