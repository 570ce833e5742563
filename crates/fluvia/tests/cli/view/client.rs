//! A running `fluvia view`, and connections to it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::time::Duration;

use fluvia_view::frame::{Decoded, decode};
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

use crate::common::{Folder, SCENE};

/// Longer than anything takes here: what has not come then does not come.
const PATIENCE: Duration = Duration::from_secs(60);

/// The program, serving at a free port; ended when dropped.
pub struct View {
    child: Child,
    /// "127.0.0.1:PORT".
    pub address: String,
}

impl View {
    pub fn start(folder: &Folder, arguments: &str) -> View {
        let mut command = folder.command(&format!("view {arguments} --port 0"));
        let mut child =
            command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
        let mut line = String::new();
        let stdout = child.stdout.as_mut().expect("a pipe");
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        let address = line.trim().strip_prefix("http://").and_then(|rest| rest.strip_suffix('/'));
        let Some(address) = address.map(str::to_owned) else {
            let output = child.wait_with_output().expect("an end");
            panic!("view {arguments}: {line} {}", String::from_utf8_lossy(&output.stderr));
        };
        View { child, address }
    }

    /// Plays back a run whose frames have gaps: 0, 7, 8, 9.
    pub fn of_frames_with_gaps(folder: &Folder) -> View {
        folder.write("scene.json", SCENE);
        folder.succeed("simulate scene.json --solver pbf --steps 9 --out run");
        for number in 1..=6 {
            std::fs::remove_file(folder.path(&format!("run/fluid_{number:04}.npz"))).expect("a frame");
        }
        View::start(folder, "run --paused")
    }

    pub fn page(&self) -> String {
        format!("http://{}/", self.address)
    }

    pub fn process(&self) -> u32 {
        self.child.id()
    }

    /// Sends Ctrl-C; gives the exit code and what was said.
    #[cfg(unix)]
    pub fn interrupt(mut self) -> (Option<i32>, String) {
        let pid = self.child.id().to_string();
        assert!(std::process::Command::new("kill").args(["-INT", &pid]).status().expect("kill").success());
        let status = self.child.wait().expect("an end");
        let mut said = String::new();
        self.child.stderr.take().expect("a pipe").read_to_string(&mut said).expect("UTF-8");
        assert!(!said.contains("panicked"), "{said}");
        (status.code(), said)
    }

    /// What comes back for a request, with its headers.
    pub fn ask(&self, request: &str) -> String {
        let mut stream = TcpStream::connect(&self.address).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a time limit");
        stream.write_all(request.as_bytes()).expect("a request");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        answer
    }

    /// The same for a path, as a browser at our address asks.
    pub fn get(&self, path: &str) -> String {
        self.ask(&format!("GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", self.address))
    }

    /// A connection as the page makes it.
    pub fn connect(&self) -> Client {
        let origin = format!("http://{}", self.address);
        self.connect_as(&self.address, Some(&origin)).expect("a connection")
    }

    /// A connection under another name or from elsewhere; the status where it is refused.
    pub fn connect_as(&self, host: &str, origin: Option<&str>) -> Result<Client, u16> {
        let mut request = format!("ws://{}/socket", self.address).into_client_request().expect("a request");
        request.headers_mut().insert("host", host.parse().expect("a header"));
        if let Some(origin) = origin {
            request.headers_mut().insert("origin", origin.parse().expect("a header"));
        }
        let stream = TcpStream::connect(&self.address).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a time limit");
        // Of two small messages the second would wait for the system's word on the first, 40 ms.
        stream.set_nodelay(true).expect("an option");
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(Client { socket, state: Value::Null, walls: Vec::new(), reads: true }),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
                Err(answer.status().as_u16())
            }
            Err(error) => panic!("{error}"),
        }
    }
}

impl Drop for View {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A connection.
pub struct Client {
    pub socket: WebSocket<TcpStream>,
    /// The newest state that has come.
    pub state: Value,
    /// The walls that have come.
    pub walls: Vec<u8>,
    /// Whether frames are acknowledged.
    pub reads: bool,
}

impl Client {
    pub fn send(&mut self, command: Value) {
        self.socket.send(Message::text(command.to_string())).expect("a connection");
    }

    /// The next frame; what else comes before it is kept.
    pub fn frame(&mut self) -> Decoded {
        loop {
            if let Some(frame) = self.next() {
                return frame;
            }
        }
    }

    /// Reads until the state is so, and gives it.
    pub fn until(&mut self, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
        for _ in 0..10_000 {
            if !self.state.is_null() && holds(&self.state) {
                return self.state.clone();
            }
            self.next();
        }
        panic!("no state in which {what}: {}", self.state);
    }

    /// Reads until a frame is so, and gives it.
    pub fn until_frame(&mut self, what: &str, holds: impl Fn(&Decoded) -> bool) -> Decoded {
        for _ in 0..10_000 {
            let frame = self.frame();
            if holds(&frame) {
                return frame;
            }
        }
        panic!("no frame in which {what}");
    }

    /// What the program says next, after `send`.
    pub fn answer(&mut self, command: Value) -> String {
        let before = self.state["message"]["number"].as_u64().unwrap_or(0);
        self.send(command);
        let number = |state: &Value| state["message"]["number"].as_u64().unwrap_or(0);
        let state = self.until("something is said", |state| number(state) > before);
        state["message"]["text"].as_str().expect("a text").to_owned()
    }

    /// Whether the connection is closed, after whatever still comes; the reason that is given.
    pub fn closed(&mut self) -> Option<String> {
        loop {
            match self.socket.read() {
                Ok(Message::Close(frame)) => {
                    return Some(frame.map_or(String::new(), |f| f.reason.to_string()));
                }
                Ok(_) => {}
                Err(tungstenite::Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => {
                    return None;
                }
                Err(_) => return Some(String::new()),
            }
        }
    }

    /// Reads a message; gives it if it is a frame, and keeps what else it is.
    pub fn next(&mut self) -> Option<Decoded> {
        match self.socket.read().expect("a message") {
            Message::Text(text) => {
                self.state = serde_json::from_str(&text).expect("JSON");
                None
            }
            Message::Binary(bytes) if bytes.starts_with(b"FLVW") => {
                self.walls = bytes.to_vec();
                None
            }
            Message::Binary(bytes) => {
                let frame = decode(&bytes).expect("a frame");
                if self.reads {
                    self.send(json!({"do": "acknowledge", "sequence": frame.sequence}));
                }
                Some(frame)
            }
            // It is answered when the next message is read.
            Message::Ping(_) => None,
            other => panic!("{other:?}"),
        }
    }
}
