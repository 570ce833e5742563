//! One connection: takes the newest of everything when it has room for it, and gives commands on.
//!
//! The page acknowledges frames; two at most are on their way. A frame that was published and replaced while there was no
//! room is never sent: the page sees the gap in the sequence numbers. What is wrong closes this connection and no other.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::sync::mpsc::TrySendError;
use std::time::{Duration, Instant};

use axum::extract::ws::{CloseFrame, Message, WebSocket, close_code};
use bytes::Bytes;

use crate::command::{Command, Received};
use crate::frame::MAGIC;
use crate::server::Shared;

/// Frames on their way at most: one that travels while another is drawn.
const ON_THEIR_WAY: usize = 2;

/// Who answers none of so many pings in a row is not there any more.
const MOST_UNANSWERED: u32 = 4;

/// How often a command is offered to a program that is behind.
const COMMAND_PAUSE: Duration = Duration::from_millis(5);

/// Where the sequence number of a frame is.
const SEQUENCE: std::ops::Range<usize> = MAGIC.len()..MAGIC.len() + 4;

/// Serves a connection until it closes.
pub(crate) async fn run(mut socket: WebSocket, shared: &Shared) {
    let mut wish = Wish { shared, density: false };
    if let Err(refusal) = exchange(&mut socket, &mut wish).await {
        let close = Message::Close(Some(CloseFrame { code: refusal.0, reason: refusal.1.into() }));
        // It may be gone already.
        let _ = socket.send(close).await;
    }
}

/// Why a connection is closed by us: a code of RFC 6455 and what to say. Nothing is said to who has left.
struct Refusal(u16, String);

async fn exchange(socket: &mut WebSocket, wish: &mut Wish<'_>) -> Result<(), Refusal> {
    let shared = wish.shared;
    if !shared.is_seen.swap(true, Ordering::Relaxed) {
        give(shared, Command::Look).await;
    }
    let mut frames = shared.frames.subscribe();
    let mut walls = shared.walls.subscribe();
    let mut state = shared.state.subscribe();
    frames.mark_changed();
    walls.mark_changed();
    state.mark_changed();
    let mut sent: VecDeque<u32> = VecDeque::new();
    // When the next frame may be sent, if there is one.
    let mut due: Option<Instant> = None;
    // When it was last asked whether anybody is there, and how often since something came.
    let (mut asked, mut unanswered) = (Instant::now(), 0);
    loop {
        let message = tokio::select! {
            biased;
            received = socket.recv() => {
                let Some(Ok(message)) = received else { return Ok(()) };
                unanswered = 0;
                if let Message::Ping(payload) = message {
                    // Nothing more is read until the answer has found room: else answers would pile up here.
                    Message::Pong(payload)
                } else {
                    take(message, wish, &mut sent).await?;
                    continue;
                }
            }
            () = tokio::time::sleep_until((asked + shared.patience.pulse).into()) => {
                if unanswered == MOST_UNANSWERED {
                    return Ok(());
                }
                (asked, unanswered) = (Instant::now(), unanswered + 1);
                Message::Ping(Bytes::new())
            }
            Ok(()) = state.changed() => Message::Text(state.borrow_and_update().as_str().into()),
            Ok(()) = walls.changed() => Message::Binary(walls.borrow_and_update().clone()),
            Ok(()) = frames.changed(), if due.is_none() && sent.len() < ON_THEIR_WAY => {
                due = Some(shared.budget.reserve(frames.borrow().len(), Instant::now()));
                continue;
            }
            () = tokio::time::sleep_until(due.unwrap_or_else(Instant::now).into()), if due.is_some() => {
                due = None;
                // Meanwhile there may be a newer one.
                let frame = frames.borrow_and_update().clone();
                if let Some(Ok(bytes)) = frame.get(SEQUENCE).map(TryInto::try_into) {
                    sent.push_back(u32::from_le_bytes(bytes));
                }
                Message::Binary(frame)
            }
            else => return Ok(()),
        };
        // What has not been published yet is empty.
        let is_empty = match &message {
            Message::Text(text) => text.is_empty(),
            Message::Binary(bytes) => bytes.is_empty(),
            _ => false,
        };
        if is_empty {
            continue;
        }
        if socket.send(message).await.is_err() {
            // Gone, or as good as.
            return Ok(());
        }
    }
}

/// Does what a message asks for.
async fn take(message: Message, wish: &mut Wish<'_>, sent: &mut VecDeque<u32>) -> Result<(), Refusal> {
    let shared = wish.shared;
    match receive(message)? {
        Some(Received::Command(command)) => give(shared, command).await,
        Some(Received::Density(on)) => {
            let is_first = wish.set_density(on);
            if is_first {
                give(shared, Command::Refresh).await;
            }
        }
        Some(Received::Acknowledge(sequence)) => {
            while sent.front().is_some_and(|front| *front <= sequence) {
                sent.pop_front();
            }
        }
        None => {}
    }
    Ok(())
}

fn receive(message: Message) -> Result<Option<Received>, Refusal> {
    match message {
        Message::Text(text) => Received::parse(&text)
            .map(Some)
            .map_err(|error| Refusal(close_code::POLICY, shortened(format!("not a command: {error}")))),
        Message::Binary(_) => Err(Refusal(close_code::UNSUPPORTED, "expected texts".into())),
        Message::Ping(_) | Message::Pong(_) | Message::Close(_) => Ok(None),
    }
}

/// The most bytes of a reason for closing (RFC 6455, 5.5 and 7.1.6).
const LONGEST_REASON: usize = 123;

fn shortened(mut reason: String) -> String {
    let end = (0..=LONGEST_REASON.min(reason.len())).rev().find(|&end| reason.is_char_boundary(end));
    reason.truncate(end.unwrap_or_default());
    reason
}

/// Gives a command to the program. This connection waits while there are too many.
async fn give(shared: &Shared, command: Command) {
    let mut command = command;
    while let Err(TrySendError::Full(back)) = shared.commands.try_send(command) {
        command = back;
        tokio::time::sleep(COMMAND_PAUSE).await;
    }
}

/// What a connection wants the program to compute; nothing any more when it is gone.
struct Wish<'a> {
    shared: &'a Shared,
    density: bool,
}

impl Wish<'_> {
    /// Whether it is the first that wants it.
    fn set_density(&mut self, on: bool) -> bool {
        if self.density == on {
            return false;
        }
        self.density = on;
        let count = &self.shared.density;
        if on {
            count.fetch_add(1, Ordering::Relaxed) == 0
        } else {
            count.fetch_sub(1, Ordering::Relaxed) == 0
        }
    }
}

impl Drop for Wish<'_> {
    fn drop(&mut self) {
        self.set_density(false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_cut_between_characters() {
        let long = shortened("ü".repeat(100));
        assert_eq!((long.len(), long.chars().count()), (122, 61));
        assert_eq!(shortened("short".into()), "short");
    }
}
