//! Connections as they come: each gets a request read and answered, in a time that has an end.
//!
//! axum's own loop sets no such end. Who connects and says nothing would keep a file of the process open for ever, and
//! after some hundred of them nobody else could come.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::time::{sleep, timeout};

use crate::patience::{Patience, Patient};

/// Connections at a time that still ask for the page, or for nothing yet. Who comes then waits until one of them is done.
const MOST: usize = 128;

/// So long a connection may take to say what it wants, the first time and after each answer.
const HEADER: Duration = Duration::from_secs(5);

/// So long a connection may last until it has become one that frames are sent over: the page is there in a second, on a slow
/// line in some.
const WHOLE: Duration = Duration::from_secs(60);

/// Before the next try where the system lets nobody in, as without files to open.
const PAUSE: Duration = Duration::from_millis(100);

/// Lets connections in for as long as it is polled.
pub(crate) async fn accept(listener: TcpListener, router: Router, patience: Patience) {
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADER);
    let places = Arc::new(Semaphore::new(MOST));
    // Nobody closes the semaphore.
    while let Ok(place) = Arc::clone(&places).acquire_owned().await {
        let Ok((stream, _)) = listener.accept().await else {
            sleep(PAUSE).await;
            continue;
        };
        // Frames are whole messages: nothing is gained by waiting for more.
        drop(stream.set_nodelay(true));
        let service = TowerToHyperService::new(router.clone());
        let connection =
            http.serve_connection(TokioIo::new(Patient::new(stream, patience.room)), service).with_upgrades();
        tokio::spawn(async move {
            // What is wrong with a connection concerns nobody else.
            drop(timeout(WHOLE, connection).await);
            drop(place);
        });
    }
}
