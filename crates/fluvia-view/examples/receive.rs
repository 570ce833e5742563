//! Receives and decodes the frames of a running `fluvia view`, and says how many come:
//!
//! ```text
//! cargo run --release -p fluvia-view --example receive -- 127.0.0.1:8642 10        one connection, for 10 seconds
//! cargo run --release -p fluvia-view --example receive -- 127.0.0.1:8642 10 50 5   50, and 5 that never read
//! ```
//!
//! It asks for as fast as possible, and for play again where stored frames have ended.

use std::error::Error;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use fluvia_view::frame::{Decoded, decode};
use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// What one connection has seen.
#[derive(Default)]
struct Seen {
    frames: u32,
    bytes: usize,
    particles: usize,
    /// Sequence numbers that were never sent.
    dropped: u32,
    /// How far the simulation has come meanwhile, frames.
    simulated: u32,
    ms_per_step: f32,
}

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let usage = "expected HOST:PORT SECONDS [CONNECTIONS [CONNECTIONS_THAT_NEVER_READ]]";
    let address = arguments.next().ok_or(usage)?;
    let seconds: f64 = arguments.next().ok_or(usage)?.parse()?;
    let connections: usize = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let silent: usize = arguments.next().map_or(Ok(0), |text| text.parse())?;
    let never_read = (0..silent).map(|_| connect(&address)).collect::<Result<Vec<_>>>()?;
    let threads: Vec<_> = (0..connections)
        .map(|_| {
            let address = address.clone();
            std::thread::spawn(move || receive(&address, Duration::from_secs_f64(seconds)))
        })
        .collect();
    let mut all = Vec::new();
    for thread in threads {
        all.push(thread.join().map_err(|_| "a connection panicked")??);
    }
    drop(never_read);
    let rate = |seen: &Seen| f64::from(seen.frames) / seconds;
    let slowest = all.iter().map(rate).fold(f64::INFINITY, f64::min);
    let mean = all.iter().map(rate).sum::<f64>() / all.len() as f64;
    let first = &all[0];
    println!("{connections} connections, {silent} that never read");
    println!("frames a second: {mean:.1}, the slowest connection {slowest:.1}; dropped {}", first.dropped);
    println!(
        "particles: {}, bytes a particle: {:.2}",
        first.particles,
        first.bytes as f64 / (first.particles as f64 * f64::from(first.frames))
    );
    println!(
        "simulated frames a second: {:.1}, ms a step: {:.1}",
        f64::from(first.simulated) / seconds,
        first.ms_per_step
    );
    Ok(())
}

fn connect(address: &str) -> Result<WebSocket<TcpStream>> {
    let stream = TcpStream::connect(address)?;
    stream.set_nodelay(true)?;
    let (socket, _) = tungstenite::client(format!("ws://{address}/socket"), stream)?;
    Ok(socket)
}

fn receive(address: &str, time: Duration) -> Result<Seen> {
    let mut socket = connect(address)?;
    socket.send(Message::text(json!({"do": "speed", "factor": null}).to_string()))?;
    let start = Instant::now();
    let mut seen = Seen::default();
    let mut last: Option<Decoded> = None;
    while start.elapsed() < time {
        match socket.read()? {
            Message::Text(text) => {
                let state: Value = serde_json::from_str(&text)?;
                if state["playing"] == false {
                    socket.send(Message::text(json!({"do": "play"}).to_string()))?;
                }
            }
            Message::Binary(bytes) if bytes.starts_with(&fluvia_view::frame::MAGIC) => {
                let frame = decode(&bytes)?;
                let acknowledge = json!({"do": "acknowledge", "sequence": frame.sequence});
                socket.send(Message::text(acknowledge.to_string()))?;
                seen.frames += 1;
                seen.bytes += bytes.len();
                seen.particles = frame.panels.iter().map(|panel| panel.position.len()).sum();
                seen.ms_per_step = frame.panels.iter().map(|panel| panel.ms_per_step).sum();
                if let Some(last) = &last {
                    seen.dropped += frame.sequence.saturating_sub(last.sequence + 1);
                    seen.simulated += frame.number.saturating_sub(last.number);
                }
                last = Some(frame);
            }
            _ => {}
        }
    }
    Ok(seen)
}
