//! How long is waited for whoever has connected, and a connection that fails when what is written to it finds no room so long.
//!
//! Whoever takes a little now and then, as over a slow line, is waited for, however long a message is; whoever takes
//! nothing is not. Nor is one that is there for the system alone, as a machine that was put to sleep: pings find out.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Sleep, sleep};

/// The limits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patience {
    /// Who takes nothing of what is sent for so long is not there any more.
    pub room: Duration,
    /// How often it is asked whether somebody is there.
    pub pulse: Duration,
}

impl Default for Patience {
    fn default() -> Patience {
        let [room, pulse] = [30, 30].map(Duration::from_secs);
        Patience { room, pulse }
    }
}

/// A stream whose writes end with `TimedOut`.
pub(crate) struct Patient {
    stream: TcpStream,
    limit: Duration,
    /// Since a write has found no room.
    waits: Option<Pin<Box<Sleep>>>,
}

impl Patient {
    /// A stream that waits for room for `limit` at most.
    pub(crate) fn new(stream: TcpStream, limit: Duration) -> Patient {
        Patient { stream, limit, waits: None }
    }

    fn limited<T>(&mut self, context: &mut Context<'_>, written: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.waits = None;
            return written;
        }
        let limit = self.limit;
        let waits = self.waits.get_or_insert_with(|| Box::pin(sleep(limit)));
        waits.as_mut().poll(context).map(|()| Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for Patient {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Patient {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        let written = Pin::new(&mut this.stream).poll_write(context, bytes);
        this.limited(context, written)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        let written = Pin::new(&mut this.stream).poll_write_vectored(context, parts);
        this.limited(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;
    use std::net::{Ipv4Addr, SocketAddr};
    use std::time::Instant;

    use tungstenite::WebSocket;

    use super::*;
    use crate::server::Server;
    use crate::walls::Walls;

    /// Longer than a busy machine lets a thread wait.
    const LIMIT: Duration = Duration::from_secs(1);

    /// What never comes to pass in these tests.
    const NEVER: Duration = Duration::from_secs(3600);

    fn server(patience: Patience) -> Server {
        Server::start_with(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), patience).unwrap().0
    }

    fn connect(server: &Server) -> WebSocket<std::net::TcpStream> {
        let stream = std::net::TcpStream::connect(server.address()).unwrap();
        tungstenite::client(format!("ws://{}/socket", server.address()), stream).unwrap().0
    }

    /// Waits until so many places are free.
    fn until_free(server: &Server, places: usize) {
        let start = Instant::now();
        while server.places() != places {
            assert!(start.elapsed() < 30 * LIMIT, "{} places free, expected {places}", server.places());
            std::thread::sleep(LIMIT / 50);
        }
    }

    #[test]
    fn who_takes_little_is_waited_for_and_who_takes_nothing_is_not() {
        let server = server(Patience { room: LIMIT, pulse: NEVER });
        let all = server.places();
        // 48 MB, several times what the buffers of a system hold.
        server.publish_walls(&Walls { vertices: vec![[1.0; 3]; 4_000_000], ..Walls::default() });
        let _silent = connect(&server);
        until_free(&server, all);
        let mut slow = connect(&server);
        let mut part = vec![0; 2 << 20];
        let start = Instant::now();
        for _ in 0..22 {
            slow.get_mut().read_exact(&mut part).unwrap();
            std::thread::sleep(LIMIT / 10);
        }
        assert!(start.elapsed() > 2 * LIMIT && server.places() == all - 1);
    }

    #[test]
    fn who_answers_no_ping_has_gone() {
        let server = server(Patience { room: NEVER, pulse: LIMIT / 4 });
        let all = server.places();
        let mut alive = connect(&server);
        let _asleep = connect(&server);
        alive.get_mut().set_read_timeout(Some(LIMIT / 20)).unwrap();
        let start = Instant::now();
        while start.elapsed() < 3 * LIMIT {
            // Whoever reads answers.
            let _ = alive.read();
        }
        assert_eq!(server.places(), all - 1);
        assert!(server.is_running());
    }
}
