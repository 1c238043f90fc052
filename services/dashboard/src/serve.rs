//! The listener: takes connections, a bounded number of them, and gives none for ever.

use crate::Hub;
use crate::api::{Instance, Shared, router};
use crate::connection::Patient;
use crate::guard::Token;
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::io;
use std::net::TcpListener;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Semaphore, watch};

/// Connections that are open at a time; more wait.
const CONNECTIONS: usize = 64;
/// A connection over which no request comes for so long is closed.
const IDLE: Duration = Duration::from_secs(30);
/// A client that takes nothing of what it is sent for so long is given up.
const STALLED: Duration = Duration::from_secs(10);
/// After an end, what has been written still goes out for so long at most.
const FLUSH: Duration = Duration::from_millis(300);
/// After a connection that could not be taken.
const AFTER_FAILURE: Duration = Duration::from_millis(50);
/// The longest head of a request, bytes.
const MAX_HEAD: usize = 16 << 10;

/// How to serve.
#[derive(Debug, Default)]
pub struct Options {
    /// What lets clients change the run; none: nothing does.
    pub token: Option<Token>,
}

/// Serves until the hub is ended.
///
/// # Errors
/// When the listener or the runtime cannot be used.
pub fn serve(
    listener: TcpListener,
    options: Options,
    hub: Arc<Hub>,
    instance: Arc<dyn Instance>,
) -> io::Result<()> {
    listener.set_nonblocking(true)?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .thread_name("http")
        .max_blocking_threads(8)
        .build()?;
    let served = runtime.block_on(async {
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let shared = Shared::new(hub.clone(), instance, options.token);
        let places = Arc::new(Semaphore::new(CONNECTIONS));
        let (closing, closed) = watch::channel(());
        tokio::select! {
            () = accept(listener, router(shared), places.clone(), closed) => {}
            () = hub.ended() => {}
        }
        // Everybody gets what is written to them, and no more.
        drop(closing);
        let _ = tokio::time::timeout(FLUSH, places.acquire_many(CONNECTIONS as u32)).await;
        Ok(())
    });
    // A question that the instance does not answer is not waited for.
    runtime.shutdown_background();
    served
}

/// Takes connections until there is something wrong with all of them. They end when `closed` does.
async fn accept(
    listener: tokio::net::TcpListener,
    router: Router,
    places: Arc<Semaphore>,
    closed: watch::Receiver<()>,
) {
    loop {
        let Ok(place) = places.clone().acquire_owned().await else {
            return;
        };
        let Ok((stream, client)) = listener.accept().await else {
            // The client has gone again, or there are no descriptors: others give some back.
            tokio::time::sleep(AFTER_FAILURE).await;
            continue;
        };
        let service = TowerToHyperService::new(router.clone().layer(Extension(client)));
        let mut closed = closed.clone();
        tokio::spawn(async move {
            let stream = TokioIo::new(Patient::new(stream, STALLED));
            let mut connection = pin!(
                http1::Builder::new()
                    .timer(TokioTimer::new())
                    .header_read_timeout(IDLE)
                    .max_buf_size(MAX_HEAD)
                    .serve_connection(stream, service)
            );
            // How a connection ends is the client's affair.
            tokio::select! {
                _ = connection.as_mut() => {}
                _ = closed.changed() => {
                    connection.as_mut().graceful_shutdown();
                    let _ = connection.await;
                }
            }
            drop(place);
        });
    }
}
