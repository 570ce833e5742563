//! Many connections, and some that do not read: the program goes on, and grows for none of them.

use std::io::Write;
use std::time::Duration;

use serde_json::json;
use tungstenite::Message;

use super::client::{Client, View};
use crate::common::Folder;

/// As many as the server must stand at least.
const CONNECTIONS: usize = 50;

/// Frames of 5,600 particles, 56 kB each: 1,000 of them are 56 MB, more than the buffers of a system hold for a connection.
const FRAMES: usize = 1000;

/// What the program may grow by meanwhile, kB: the sockets' own buffers are the system's and do not count, two frames on
/// their way to each connection do (5.6 MB), and what allocators keep.
const GROWTH: u64 = 24_000;

/// Bytes of pings that are sent, and none of the answers is read.
const PINGS: usize = 50_000_000;

/// The memory that the process uses, kB; `None` where the system does not say.
fn memory(view: &View) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", view.process())).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Puts another frame on show, and sees it.
fn seek(client: &mut Client, index: usize) {
    client.send(json!({"do": "seek", "index": index}));
    assert_eq!(client.frame().number as usize, index);
}

/// What must not have grown.
fn assert_small(before: Option<u64>, after: Option<u64>) {
    match (before, after) {
        (Some(before), Some(after)) => {
            assert!(after < before + GROWTH, "{before} kB before, {after} kB after");
        }
        _ => println!("skipped: this system does not say how much memory a process uses"),
    }
}

#[test]
fn who_does_not_read_costs_nothing() {
    let folder = Folder::new();
    folder.succeed("simulate dam_break --solver pbf --steps 1 --out run");
    let view = View::start(&folder, "run --paused");
    let mut client = view.connect();
    client.frame();
    // None of them reads; some acknowledge all the same, so that frames are sent to them until nothing more fits anywhere.
    let mut idle: Vec<Client> = (0..CONNECTIONS).map(|_| view.connect()).collect();
    (0..100).for_each(|k| seek(&mut client, 1 - k % 2));
    let before = memory(&view);
    for k in 0..FRAMES {
        seek(&mut client, 1 - k % 2);
        for greedy in idle.iter_mut().step_by(5) {
            // It is let go after a while.
            let all = json!({"do": "acknowledge", "sequence": u32::MAX});
            let _ = greedy.socket.send(Message::text(all.to_string()));
        }
    }
    assert_small(before, memory(&view));
    // Who begins to read gets what is newest after what was on its way.
    let late = &mut idle[1];
    let first = late.frame();
    let newest = late.until_frame("the newest is there", |frame| frame.sequence > FRAMES as u32);
    assert!(newest.sequence > first.sequence + 100, "{} after {}", newest.sequence, first.sequence);
}

/// Whoever asks has to take the answers.
#[test]
fn who_pings_and_does_not_read_costs_nothing() {
    let folder = Folder::new();
    folder.write("scene.json", crate::common::SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    let mut client = view.connect();
    let first = client.frame().number;
    let before = memory(&view);
    let mut pinging = view.connect();
    pinging.socket.get_mut().set_write_timeout(Some(Duration::from_secs(3))).unwrap();
    // Frames of RFC 6455, 5.2: final, a ping; masked, 125 bytes; a mask of zeros.
    let ping = [&[0x89, 0x80 | 125, 0, 0, 0, 0][..], &[7; 125]].concat();
    let many = ping.repeat(1000);
    let mut sent = 0;
    // Until there is no room for more anywhere.
    while sent < PINGS && pinging.socket.get_mut().write_all(&many).is_ok() {
        sent += many.len();
    }
    assert_small(before, memory(&view));
    client.send(json!({"do": "step", "by": 1}));
    client.until_frame("it has stepped", |frame| frame.number > first);
}

#[test]
fn two_frames_are_on_their_way_at_most() {
    let folder = Folder::new();
    folder.write("scene.json", crate::common::SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 1 --out run");
    let view = View::start(&folder, "run --paused");
    let (mut client, mut silent) = (view.connect(), view.connect());
    silent.reads = false;
    client.frame();
    let mut got = vec![silent.frame().sequence];
    // A state that has come says that the frames before it would have come too.
    let speed = |k: u32| json!(1.0 + f64::from(k) / 10.0);
    for k in 1..=10 {
        for index in [1, 0, 1, 0] {
            client.send(json!({"do": "seek", "index": index}));
            client.until_frame("it is sought", |frame| frame.number == index);
        }
        client.send(json!({"do": "speed", "factor": speed(k)}));
        client.until("it is faster", |state| state["speed"] == speed(k));
    }
    while silent.state["speed"] != speed(10) {
        got.extend(silent.next().map(|frame| frame.sequence));
    }
    assert!(got.len() <= 2, "{got:?}");
    // With room again it gets the newest.
    silent.send(json!({"do": "acknowledge", "sequence": got.last()}));
    silent.reads = true;
    client.send(json!({"do": "seek", "index": 1}));
    let newest = client.until_frame("it is sought", |frame| frame.number == 1).sequence;
    let next = silent.until_frame("the newest is there", |frame| frame.sequence >= newest);
    assert!(next.sequence > got[0] + 10, "{} after {got:?}", next.sequence);
}

#[test]
fn fifty_connections_see_a_simulation_run() {
    let folder = Folder::new();
    folder.write("scene.json", crate::common::SCENE);
    let view = View::start(&folder, "scene.json --solver pbf");
    let mut clients: Vec<Client> = (0..CONNECTIONS).map(|_| view.connect()).collect();
    let first = clients[0].frame().number;
    for client in &mut clients {
        let frame = client.until_frame("time has passed", |frame| frame.number > first);
        assert_eq!(frame.panels[0].position.len(), 64);
    }
    // All at once leave; who comes then is served.
    drop(clients);
    let frame = view.connect().until_frame("time has passed", |frame| frame.number > first + 1);
    assert_eq!(frame.panels.len(), 1);
}

#[test]
fn there_is_an_end_to_connections() {
    let folder = Folder::new();
    folder.write("scene.json", crate::common::SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    let mut all: Vec<Client> = Vec::new();
    let origin = view.page();
    let refused = loop {
        match view.connect_as(&view.address, Some(origin.trim_end_matches('/'))) {
            Ok(client) => all.push(client),
            Err(status) => break status,
        }
        assert!(all.len() < 1000, "no end to connections");
    };
    assert_eq!(refused, 503);
    assert!(all.len() > CONNECTIONS, "{}", all.len());
    all[0].frame();
    // A place that is left is free.
    all.truncate(1);
    for _ in 0..1000 {
        if view.connect_as(&view.address, None).is_ok() {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("no place after connections have gone");
}
