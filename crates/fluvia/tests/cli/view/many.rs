//! Many connections, and some that do not read: the program goes on, and grows for none of them.

use serde_json::json;

use super::client::{Client, View};
use crate::common::Folder;

/// As many as the server must stand at least.
const CONNECTIONS: usize = 50;

/// Frames of 5,600 particles, 56 kB each: 1,000 of them are 56 MB.
const FRAMES: usize = 1000;

/// What the program may grow by meanwhile, kB: the sockets' own buffers are the system's and do not count, two frames on
/// their way to each connection do (5.6 MB), and what allocators keep.
const GROWTH: u64 = 24_000;

/// The memory that the process uses, kB; `None` where the system does not say.
fn memory(view: &View) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", view.process())).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Puts another frame on show so many times, and sees each of them.
fn go_through(client: &mut Client, frames: usize) {
    for k in 0..frames {
        client.send(json!({"do": "seek", "index": 1 - k % 2}));
        let frame = client.frame();
        assert_eq!(frame.number as usize, 1 - k % 2);
    }
}

#[test]
fn who_does_not_read_costs_nothing() {
    let folder = Folder::new();
    folder.succeed("simulate dam_break --solver pbf --steps 1 --out run");
    let view = View::start(&folder, "run --paused");
    let mut client = view.connect();
    client.frame();
    // Some never read and never acknowledge; some acknowledge what they have not got and never read; some only come.
    let mut idle: Vec<Client> = (0..CONNECTIONS).map(|_| view.connect()).collect();
    for greedy in idle.iter_mut().step_by(2) {
        greedy.send(json!({"do": "acknowledge", "sequence": u32::MAX}));
    }
    go_through(&mut client, 100);
    let before = memory(&view);
    for part in 0..10 {
        go_through(&mut client, FRAMES / 10);
        for greedy in idle.iter_mut().step_by(2) {
            greedy.send(json!({"do": "acknowledge", "sequence": u32::MAX - part}));
        }
    }
    match (before, memory(&view)) {
        (Some(before), Some(after)) => {
            assert!(after < before + GROWTH, "{before} kB before, {after} kB after");
        }
        _ => println!("skipped: this system does not say how much memory a process uses"),
    }
    // Who begins to read gets what is newest after what was on its way.
    let late = &mut idle[1];
    let first = late.frame();
    let newest = late.until_frame("the newest is there", |frame| frame.sequence > FRAMES as u32);
    assert!(newest.sequence > first.sequence + 100, "{} after {}", newest.sequence, first.sequence);
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
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    panic!("no place after connections have gone");
}
