//! The server: a thread of its own, on which all connections take turns.
//!
//! What the program publishes is kept once, the newest only. A connection takes it when it has room (two frames on their
//! way at most, see `connection.rs`; all together no more than `budget.rs` has), so the memory of the server depends on the
//! number of connections and the size of a frame, never on how slowly anyone reads.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use axum::Router;
use axum::body::Body;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Request, State as Shares};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderName, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{any, get};
use bytes::Bytes;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, oneshot, watch};

use crate::assets::{ASSETS, Asset};
use crate::budget::Budget;
use crate::command::Command;
use crate::frame::{self, Frame};
use crate::patience::Patience;
use crate::state::State;
use crate::walls::{self, Walls};
use crate::{accept, connection, guard};

/// Commands that wait for the program at most; connections that send more wait with them.
const WAITING_COMMANDS: usize = 64;

/// The most connections at a time that frames are sent over: more than people look, fewer than a process may open.
const MOST_CONNECTIONS: usize = 256;

/// The longest message that a connection may send, bytes: commands are a tenth of it.
const LONGEST_MESSAGE: usize = 4096;

/// Why there is no server.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The address cannot be used.
    #[error("{address}: {}", reason(source))]
    Address {
        /// The one that was asked for.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The system gives no thread or no event queue.
    #[error("cannot start the server: {0}")]
    Start(std::io::Error),
}

fn reason(error: &std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::AddrInUse => "the port is in use, expected a free one (0 finds one)".into(),
        _ => error.to_string(),
    }
}

/// What all connections share.
pub(crate) struct Shared {
    pub frames: watch::Sender<Bytes>,
    pub walls: watch::Sender<Bytes>,
    pub state: watch::Sender<String>,
    pub commands: SyncSender<Command>,
    /// Whether anybody has ever come to look.
    pub is_seen: AtomicBool,
    /// Connections that want densities.
    pub density: AtomicUsize,
    pub budget: Budget,
    pub places: Arc<Semaphore>,
    pub patience: Patience,
    port: u16,
}

/// A running server. It ends when this is dropped.
pub struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    sequence: AtomicU32,
    thread: Option<(oneshot::Sender<()>, JoinHandle<()>)>,
}

impl Server {
    /// Starts a server at the address, whose port may be 0 for a free one. Commands come out of the receiver.
    ///
    /// # Errors
    /// If the address cannot be used, or the system gives no thread.
    pub fn start(address: SocketAddr) -> Result<(Server, Receiver<Command>), Error> {
        Server::start_with(address, Patience::default())
    }

    pub(crate) fn start_with(
        address: SocketAddr,
        patience: Patience,
    ) -> Result<(Server, Receiver<Command>), Error> {
        let listen = || -> std::io::Result<_> {
            let listener = std::net::TcpListener::bind(address)?;
            listener.set_nonblocking(true)?;
            Ok((listener.local_addr()?, listener))
        };
        let (bound, listener) = listen().map_err(|source| Error::Address { address, source })?;
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(Error::Start)?;
        let inside = runtime.enter();
        let listener = TcpListener::from_std(listener).map_err(Error::Start)?;
        drop(inside);
        let (commands, receiver) = sync_channel(WAITING_COMMANDS);
        let shared = Arc::new(Shared {
            frames: watch::Sender::default(),
            walls: watch::Sender::default(),
            state: watch::Sender::default(),
            commands,
            is_seen: AtomicBool::new(false),
            density: AtomicUsize::new(0),
            budget: Budget::new(),
            places: Arc::new(Semaphore::new(MOST_CONNECTIONS)),
            patience,
            port: bound.port(),
        });
        let app = router(Arc::clone(&shared));
        let (end, ended) = oneshot::channel();
        let run = move || {
            runtime.block_on(async {
                tokio::select! {
                    _ = ended => {}
                    () = accept::accept(listener, app, patience) => {}
                }
            });
        };
        let thread = std::thread::Builder::new().name("server".into()).spawn(run).map_err(Error::Start)?;
        let sequence = AtomicU32::new(0);
        Ok((Server { address: bound, shared, sequence, thread: Some((end, thread)) }, receiver))
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether it still serves; it ends by itself only where something has gone wrong.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|(_, thread)| !thread.is_finished())
    }

    /// How many connections more are let in.
    #[cfg(test)]
    pub(crate) fn places(&self) -> usize {
        self.shared.places.available_permits()
    }

    /// Shows a frame. What nobody has taken of the one before is gone.
    pub fn publish_frame(&self, frame: &Frame<'_>) {
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed).wrapping_add(1);
        self.shared.frames.send_replace(frame::encode(frame, sequence).into());
    }

    /// Shows walls.
    pub fn publish_walls(&self, walls: &Walls) {
        self.shared.walls.send_replace(walls::encode(walls).into());
    }

    /// Tells the state, if it is another.
    pub fn publish_state(&self, state: &State) {
        // Only maps could fail, for their keys, and a state has none.
        let Ok(text) = serde_json::to_string(state) else { return };
        self.shared.state.send_if_modified(|old| {
            let is_new = *old != text;
            *old = text;
            is_new
        });
    }

    /// Whether somebody wants to see densities.
    pub fn wants_density(&self) -> bool {
        self.shared.density.load(Ordering::Relaxed) > 0
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some((end, thread)) = self.thread.take() {
            // It may have ended by itself.
            let _ = end.send(());
            let _ = thread.join();
        }
    }
}

/// Where the page connects to.
const SOCKET: &str = "/socket";

fn router(shared: Arc<Shared>) -> Router {
    let mut router = Router::new().route(SOCKET, any(connect));
    for asset in &ASSETS {
        router = router.route(asset.path, get(|| async { serve(asset) }));
    }
    router.layer(middleware::from_fn_with_state(Arc::clone(&shared), guarded)).with_state(shared)
}

fn serve(asset: &'static Asset) -> Response {
    let mut response = Response::new(Body::from(asset.bytes));
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(asset.content_type));
    response
}

/// Lets nobody in who has no business here, and tells browsers how little the page may do.
async fn guarded(Shares(shared): Shares<Arc<Shared>>, request: Request, next: Next) -> Response {
    let host = match guard::check(request.headers(), shared.port) {
        Ok(host) => host,
        Err(message) => return (StatusCode::FORBIDDEN, message).into_response(),
    };
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    let policy = format!(
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self' ws://{host}; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    // The host has been found to be a name or an address: it fits a header.
    headers.extend(HeaderValue::try_from(policy).ok().map(|policy| (CONTENT_SECURITY_POLICY, policy)));
    let fixed = [
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (HeaderName::from_static("x-frame-options"), "DENY"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (REFERRER_POLICY, "no-referrer"),
        // The page belongs to the program that runs: another version may be at this address tomorrow.
        (CACHE_CONTROL, "no-store"),
    ];
    headers.extend(fixed.map(|(name, value)| (name, HeaderValue::from_static(value))));
    response
}

async fn connect(Shares(shared): Shares<Arc<Shared>>, upgrade: WebSocketUpgrade) -> Response {
    let Ok(place) = Arc::clone(&shared.places).try_acquire_owned() else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many connections\n").into_response();
    };
    upgrade
        .max_message_size(LONGEST_MESSAGE)
        .max_frame_size(LONGEST_MESSAGE)
        // Messages go out as they are sent: nothing is gathered.
        .write_buffer_size(0)
        .on_upgrade(async move |socket| {
            connection::run(socket, &shared).await;
            drop(place);
        })
}
