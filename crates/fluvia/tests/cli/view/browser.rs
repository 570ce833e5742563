//! A browser without a window, driven over the DevTools protocol: JSON over a WebSocket.

use std::collections::HashSet;
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine;
use serde_json::{Value, json};
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// Browsers as systems call them; the environment variable FLUVIA_BROWSER names another.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];

/// How long something may take to show on a machine that draws without a GPU.
const PATIENCE: Duration = Duration::from_secs(120);

/// A browser with one page.
pub struct Browser {
    child: Child,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    session: String,
    next: u64,
    /// What the page has complained about.
    pub complaints: Vec<String>,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Starts one; `None`, with the reason printed, where there is none. In continuous integration there must be one.
    pub fn start() -> Option<Browser> {
        let asked = std::env::var("FLUVIA_BROWSER").ok();
        let names: Vec<&str> = asked.as_deref().map_or(NAMES.to_vec(), |name| vec![name]);
        let profile = tempfile::tempdir().expect("a temporary folder");
        let child = names.iter().find_map(|name| launch(name, profile.path()).ok());
        let Some(mut child) = child else {
            assert!(std::env::var_os("CI").is_none(), "no browser of {names:?}, which CI needs");
            println!("skipped: no browser, none of {} starts (set FLUVIA_BROWSER)", names.join(", "));
            return None;
        };
        let stderr = BufReader::new(child.stderr.take().expect("a pipe"));
        let mut lines = stderr.lines().map_while(Result::ok);
        let address =
            lines.find_map(|line| line.split_once("DevTools listening on ").map(|(_, a)| a.to_owned()));
        let address = address.expect("a browser that listens");
        // Whatever else it says must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        let (socket, _) = tungstenite::connect(address).expect("a connection to the browser");
        let mut browser = Browser {
            child,
            socket,
            session: String::new(),
            next: 0,
            complaints: Vec::new(),
            _profile: profile,
        };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let session = browser.call("Target.attachToTarget", attach);
        browser.session = session["sessionId"].as_str().expect("a session").to_owned();
        for domain in ["Page.enable", "Runtime.enable", "Log.enable"] {
            browser.call(domain, json!({}));
        }
        Some(browser)
    }

    /// Calls a method and gives its result.
    pub fn call(&mut self, method: &str, params: Value) -> Value {
        self.next += 1;
        let mut message = json!({"id": self.next, "method": method, "params": params});
        if !self.session.is_empty() {
            message["sessionId"] = self.session.as_str().into();
        }
        self.socket.send(Message::text(message.to_string())).expect("a connection");
        loop {
            let Message::Text(text) = self.socket.read().expect("an answer") else { continue };
            let answer: Value = serde_json::from_str(&text).expect("JSON");
            if answer["id"] == self.next {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
            self.listen(&answer);
        }
    }

    /// Keeps what the page complains about: errors and warnings of the console, exceptions, refused requests.
    fn listen(&mut self, event: &Value) {
        let params = &event["params"];
        let text = match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => params["exceptionDetails"].to_string(),
            Some("Log.entryAdded") if params["entry"]["level"] == "error" => params["entry"].to_string(),
            Some("Runtime.consoleAPICalled")
                if ["error", "warning", "assert"].map(Value::from).contains(&params["type"]) =>
            {
                params["args"].to_string()
            }
            _ => return,
        };
        self.complaints.push(text);
    }

    pub fn open(&mut self, address: &str, width: u32, height: u32) {
        self.resize(width, height);
        self.call("Page.navigate", json!({"url": address}));
        self.until("document.readyState === 'complete'");
    }

    pub fn resize(&mut self, width: u32, height: u32) {
        self.resize_on(1, width, height);
    }

    /// The same on a screen with so many pixels a pixel of the page.
    pub fn resize_on(&mut self, fineness: u32, width: u32, height: u32) {
        let metrics =
            json!({"width": width, "height": height, "deviceScaleFactor": fineness, "mobile": width < 600});
        self.call("Emulation.setDeviceMetricsOverride", metrics);
    }

    /// "light" or "dark", as the system would say.
    pub fn set_scheme(&mut self, scheme: &str) {
        let features = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        self.call("Emulation.setEmulatedMedia", features);
    }

    /// The value of an expression.
    pub fn value(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let result = self.call("Runtime.evaluate", params);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {}", result["exceptionDetails"]);
        result["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn until(&mut self, expression: &str) {
        let start = Instant::now();
        while self.value(expression) != true {
            assert!(start.elapsed() < PATIENCE, "never: {expression}; {:?}", self.complaints);
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// The text of an element.
    pub fn text(&mut self, id: &str) -> String {
        let text = self.value(&format!("document.getElementById('{id}').textContent"));
        text.as_str().expect("a text").to_owned()
    }

    /// A number in the read-outs, which group its digits.
    pub fn number(&mut self, id: &str) -> f64 {
        let text: String = self.text(id).chars().filter(|c| c.is_ascii_digit() || *c == '.').collect();
        text.parse().unwrap_or(f64::NAN)
    }

    /// Presses an element as a hand does.
    pub fn press(&mut self, id: &str) {
        let place = self.value(&format!(
            "(() => {{ const e = document.getElementById('{id}'); e.scrollIntoView({{block: 'nearest'}}); \
             const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; }})()"
        ));
        self.click(place[0].as_f64().expect("a place"), place[1].as_f64().expect("a place"));
    }

    pub fn click(&mut self, x: f64, y: f64) {
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({"type": kind, "x": x, "y": y, "button": "left", "clickCount": 1});
            self.call("Input.dispatchMouseEvent", event);
        }
    }

    /// Taps with a finger.
    pub fn tap(&mut self, x: f64, y: f64) {
        self.touch("touchStart", &[[x, y]]);
        self.touch("touchEnd", &[]);
    }

    /// Fingers on the screen.
    pub fn touch(&mut self, kind: &str, fingers: &[[f64; 2]]) {
        let points: Vec<Value> =
            fingers.iter().enumerate().map(|(id, [x, y])| json!({"x": x, "y": y, "id": id})).collect();
        self.call("Input.dispatchTouchEvent", json!({"type": kind, "touchPoints": points}));
    }

    pub fn drag(&mut self, from: [f64; 2], to: [f64; 2]) {
        let mut event = |kind: &str, [x, y]: [f64; 2]| {
            let buttons = u8::from(kind != "mouseReleased");
            let event =
                json!({"type": kind, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1});
            self.call("Input.dispatchMouseEvent", event);
        };
        event("mousePressed", from);
        event("mouseMoved", [0.5 * (from[0] + to[0]), 0.5 * (from[1] + to[1])]);
        event("mouseMoved", to);
        event("mouseReleased", to);
    }

    pub fn key(&mut self, key: &str) {
        let text = if key.chars().count() == 1 { key } else { "" };
        for kind in ["keyDown", "keyUp"] {
            let event = json!({"type": kind, "key": key, "text": if kind == "keyDown" { text } else { "" }});
            self.call("Input.dispatchKeyEvent", event);
        }
    }

    /// Holds a key for so many repetitions.
    pub fn hold(&mut self, key: &str, repetitions: usize) {
        for k in 0..=repetitions {
            let event = json!({"type": "keyDown", "key": key, "text": key, "autoRepeat": k > 0});
            self.call("Input.dispatchKeyEvent", event);
        }
        self.call("Input.dispatchKeyEvent", json!({"type": "keyUp", "key": key}));
    }

    /// A picture of the page, as a PNG file.
    pub fn screenshot(&mut self) -> Vec<u8> {
        let shot = self.call("Page.captureScreenshot", json!({"format": "png"}));
        let data = shot["data"].as_str().expect("a picture");
        base64::engine::general_purpose::STANDARD.decode(data).expect("base64")
    }

    /// Looks until the picture is so, and gives it.
    pub fn until_picture(&mut self, what: &str, holds: impl Fn(&Pixels) -> bool) -> Pixels {
        let start = Instant::now();
        loop {
            let pixels = self.pixels();
            if holds(&pixels) {
                return pixels;
            }
            assert!(start.elapsed() < PATIENCE, "no picture in which {what}; {:?}", self.complaints);
        }
    }

    /// Looks until two pictures in a row are the same, and gives them.
    pub fn settled(&mut self) -> Pixels {
        let mut before = self.pixels();
        let start = Instant::now();
        loop {
            std::thread::sleep(Duration::from_millis(200));
            let pixels = self.pixels();
            if pixels.bytes == before.bytes {
                return pixels;
            }
            assert!(start.elapsed() < PATIENCE, "the picture does not settle");
            before = pixels;
        }
    }

    /// The colours of a picture of the page.
    pub fn pixels(&mut self) -> Pixels {
        let file = self.screenshot();
        let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().expect("a PNG");
        let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
        let info = reader.next_frame(&mut bytes).expect("a picture");
        bytes.truncate(info.buffer_size());
        Pixels { width: info.width as usize, channels: info.color_type.samples(), bytes }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn launch(name: &str, profile: &std::path::Path) -> std::io::Result<Child> {
    Command::new(name)
        .args(["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
        .args(["--remote-debugging-port=0", "--no-first-run", "--hide-scrollbars", "--disable-dev-shm-usage"])
        .arg(format!("--user-data-dir={}", profile.display()))
        .arg("about:blank")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
}

/// A picture.
pub struct Pixels {
    pub width: usize,
    channels: usize,
    bytes: Vec<u8>,
}

impl Pixels {
    /// How many different colours are in a part of it.
    pub fn colors(&self, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> usize {
        self.part(columns, rows).collect::<HashSet<_>>().len()
    }

    /// The part of pixels that differ visibly from those of another picture.
    pub fn differing(
        &self,
        other: &Pixels,
        columns: std::ops::Range<usize>,
        rows: std::ops::Range<usize>,
    ) -> f64 {
        let count = columns.len() * rows.len();
        let pairs = self.part(columns.clone(), rows.clone()).zip(other.part(columns, rows));
        let differ = |(a, b): ([u8; 3], [u8; 3])| a.iter().zip(b).any(|(a, b)| a.abs_diff(b) > 12);
        pairs.filter(|pair| differ(*pair)).count() as f64 / count as f64
    }

    /// The mean of all channels.
    pub fn brightness(&self) -> f64 {
        let pixels = self.bytes.chunks_exact(self.channels);
        let sum: u64 = pixels.flat_map(|pixel| &pixel[..3]).map(|&channel| u64::from(channel)).sum();
        sum as f64 / (self.bytes.len() / self.channels * 3) as f64
    }

    fn part(
        &self,
        columns: std::ops::Range<usize>,
        rows: std::ops::Range<usize>,
    ) -> impl Iterator<Item = [u8; 3]> {
        rows.flat_map(move |y| columns.clone().map(move |x| (x, y))).map(|(x, y)| {
            let at = self.channels * (y * self.width + x);
            [self.bytes[at], self.bytes[at + 1], self.bytes[at + 2]]
        })
    }
}
