//! Who is kept out, what closes a connection, and what ends the program with one line.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use serde_json::json;
use tungstenite::Message;

use super::client::View;
use crate::common::{Folder, SCENE, fixture, scene_with, sequence};

fn small() -> (Folder, View) {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf");
    (folder, view)
}

#[test]
fn the_page_comes_with_its_policy() {
    let (_folder, view) = small();
    let page = view.get("/").to_lowercase();
    assert!(page.starts_with("http/1.1 200") && page.contains("<canvas"), "{page}");
    for header in [
        "content-type: text/html; charset=utf-8",
        "x-content-type-options: nosniff",
        "x-frame-options: deny",
        "cross-origin-resource-policy: same-origin",
        "default-src 'none'; script-src 'self'; style-src 'self';",
        "frame-ancestors 'none'",
        &format!("connect-src 'self' ws://{};", view.address),
    ] {
        assert!(page.contains(header), "{header} in {page}");
    }
    assert!(view.get("/main.js?draw=off").contains("content-type: text/javascript"));
    // There is nothing else: no file of the system, of the scene's folder, or of the page's.
    for path in [
        "/scene.json",
        "/../scene.json",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/..%2f..%2fetc%2fpasswd",
        "/page/main.js",
        "/main.js/..",
        "/index.html",
    ] {
        let answer = view.get(path);
        assert!(answer.starts_with("HTTP/1.1 404") && !answer.contains("root:"), "{path}: {answer}");
    }
    let host = &view.address;
    let post = view
        .ask(&format!("POST / HTTP/1.1\r\nHost: {host}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"));
    assert!(post.starts_with("HTTP/1.1 405"), "{post}");
    // What is no connection of the page's kind.
    assert!(view.get("/socket").starts_with("HTTP/1.1 4"));
}

#[test]
fn other_sites_are_kept_out() {
    let (_folder, view) = small();
    let port = view.address.rsplit_once(':').unwrap().1.to_owned();
    let get = |host: &str, more: &str| {
        view.ask(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n{more}Connection: close\r\n\r\n"))
    };
    for host in [
        "evil.example",
        &format!("evil.example:{port}"),
        "127.0.0.1",
        &format!("127.0.0.1.evil.example:{port}"),
    ] {
        let answer = get(host, "");
        assert!(answer.starts_with("HTTP/1.1 403") && !answer.contains("<canvas"), "{host}: {answer}");
        assert_eq!(view.connect_as(host, None).err(), Some(403), "{host}");
    }
    for origin in ["http://evil.example", "null", "http://127.0.0.1:1", &format!("https://127.0.0.1:{port}")]
    {
        assert!(get(&view.address, &format!("Origin: {origin}\r\n")).starts_with("HTTP/1.1 403"), "{origin}");
        assert_eq!(view.connect_as(&view.address, Some(origin)).err(), Some(403), "{origin}");
    }
    assert!(view.ask("GET / HTTP/1.0\r\n\r\n").starts_with("HTTP/1.0 403"));
    // Programs of this machine have no origin, and some call it by its name.
    let localhost = format!("localhost:{port}");
    assert!(get(&localhost, "").starts_with("HTTP/1.1 200"));
    let origin = format!("http://{localhost}");
    assert!(view.connect_as(&localhost, Some(&origin)).is_ok());
    assert!(view.connect_as(&view.address, None).is_ok());
}

#[test]
fn a_broken_message_closes_its_connection_alone() {
    let (_folder, view) = small();
    let mut good = view.connect();
    good.frame();
    for broken in [
        Message::text("play"),
        Message::text(""),
        Message::text(r#"{"do":"fly"}"#),
        Message::text(
            r#"{"do":"drop","panel":0,"origin":[0,0],"direction":[0,0,0],"body":{"form":"cube","size":1}}"#,
        ),
        Message::binary(vec![1, 2, 3]),
        Message::text(format!(r#"{{"do":"solver","panel":0,"name":"{}"}}"#, "x".repeat(5000))),
    ] {
        let mut bad = view.connect();
        bad.frame();
        bad.socket.send(broken.clone()).unwrap();
        assert!(bad.closed().is_some(), "{broken:?}");
        good.frame();
    }
    // Not even a message; half a handshake; nothing at all.
    let mut bad = view.connect();
    bad.frame();
    bad.socket.get_mut().write_all(&[0xff; 64]).unwrap();
    assert!(bad.closed().is_some());
    let mut half = TcpStream::connect(&view.address).unwrap();
    half.write_all(b"GET /socket HTTP/1.1\r\nHost: ").unwrap();
    let _silent = TcpStream::connect(&view.address).unwrap();
    let mut garbage = TcpStream::connect(&view.address).unwrap();
    garbage.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    garbage.write_all(&[0x16, 3, 1, 2, 0, 1, 0, 1, 0xfc, 3, 3, b'\r', b'\n', b'\r', b'\n']).unwrap();
    // It is told so, and let go.
    let mut answer = String::new();
    garbage.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 400"), "{answer}");
    let first = good.frame().number;
    let later = good.until_frame("time has passed", |frame| frame.number > first + 3);
    assert!(later.number > first);
    // Numbers that mean nothing are refused by the simulation, which goes on.
    for (command, word) in [
        (json!({"do": "speed", "factor": 0}), "speed 0, expected"),
        (json!({"do": "speed", "factor": 1e300}), "expected"),
        (json!({"do": "gravity", "to": [0, 1e39, 0]}), "gravity"),
        (json!({"do": "viscosity", "to": 0.1}), "viscosity"),
        (json!({"do": "solver", "panel": 7, "name": "pbf"}), "picture 7"),
        (json!({"do": "solver", "panel": 0, "name": "magic"}), "no solver magic"),
        (json!({"do": "move-emitter", "index": 0, "to": [0, 0, 0]}), "no such emitter"),
        (json!({"do": "seek", "index": 3}), "only frames on disk"),
        (json!({"do": "step", "by": -1}), "backwards"),
        (
            json!({"do": "drop", "panel": 0, "origin": [0, 9, 0], "direction": [0, 0, 0],
                   "body": {"form": "ball", "size": 0.2}}),
            "nothing to drop it on",
        ),
        (
            json!({"do": "drop", "panel": 0, "origin": [0, 9, 0], "direction": [0, -1, 0],
                   "body": {"form": "ball", "size": 1e9}}),
            "expected 0.1 to 2",
        ),
    ] {
        let said = good.answer(command.clone());
        assert!(said.contains(word), "{command}: {said}");
        assert_eq!(good.state["message"]["is_error"], true);
    }
    assert_eq!(good.state["playing"], true, "what is refused stops nothing");
}

/// The address of all addresses is none to go to.
#[test]
#[cfg(unix)]
fn who_listens_everywhere_is_told_where_the_page_is() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --bind 0.0.0.0");
    assert!(view.address.starts_with("127.0.0.1:"), "{}", view.address);
    assert!(view.get("/").starts_with("HTTP/1.1 200"));
    let (_, said) = view.interrupt();
    assert!(said.contains("everybody who can reach this machine"), "{said}");
}

/// More connections than are let in at a time say nothing, or half of something.
#[test]
fn who_asks_for_nothing_is_let_go() {
    let (_folder, view) = small();
    let mut asking: Vec<TcpStream> = (0..200)
        .map(|_| {
            let stream = TcpStream::connect(&view.address).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
            stream
        })
        .collect();
    asking[0].write_all(b"GET /socket HTTP/1.1\r\nHost: ").unwrap();
    // Who has something to ask waits for a place, and gets it.
    assert!(view.get("/").starts_with("HTTP/1.1 200"));
    match std::fs::read_dir(format!("/proc/{}/fd", view.process())) {
        // Those that are let in, and some files of the program's own.
        Ok(files) => assert!(files.count() < 190, "a file for each connection"),
        Err(_) => println!("skipped: this system does not say which files a process has open"),
    }
    view.connect().frame();
    for stream in &mut asking {
        assert!(stream.read_to_end(&mut Vec::new()).is_ok(), "still open");
    }
}

#[test]
fn what_cannot_be_shown_is_one_line() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.write("notes.txt", "no frames");
    std::fs::create_dir(folder.path("empty")).unwrap();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    folder.fail(
        &format!("view scene.json --solver pbf --port {port}"),
        &[&format!("127.0.0.1:{port}"), "in use"],
    );
    folder.fail("view nowhere", &["nowhere", "neither frames nor a shipped scene", "dam_break"]);
    folder.fail("view out/missing", &["out/missing"]);
    folder.fail("view missing.json", &["missing.json"]);
    folder.fail("view empty", &["empty", "no frames"]);
    folder.fail("view notes.txt", &["notes.txt", "no frames"]);
    folder.fail("view scene.json --weights missing.pt", &["missing.pt"]);
    folder.fail("view scene.json --dt 0.1", &["--dt", "expected frames on disk"]);
    folder.succeed("simulate scene.json --solver pbf --steps 1 --out run");
    let record = std::fs::read_to_string(folder.path("run/run.json")).unwrap();
    for (key, wrong) in [("dt", "-0.02"), ("particle_radius", "0.0")] {
        let mut changed: serde_json::Value = serde_json::from_str(&record).unwrap();
        changed[key] = serde_json::from_str(wrong).unwrap();
        folder.write("run/run.json", changed.to_string());
        folder.fail("view run", &["run/run.json", &format!("`{key}`"), "expected a positive number"]);
    }
    folder.fail("view scene.json --solver pbf --bind 203.0.113.7", &["203.0.113.7"]);
    let frames = sequence("plain");
    for option in ["--solver pbf", "--weights default", "--seed 1", "--precision bf16", "--format ply"] {
        let name = option.split(' ').next().unwrap();
        folder.fail(&format!("view {frames} {option}"), &[name, "expected a scene"]);
    }
    folder.write("other.json", scene_with(r#""dt": 0.01"#));
    folder.fail(&format!("view other.json --weights {}", fixture("plain.pt")), &["other.json", "`dt`"]);
}
