//! The page in a real browser.

use serde_json::json;

use super::browser::Browser;
use super::client::View;
use crate::common::{Folder, SCENE, scene_of};

/// The part of a window of 1000 x 700 in which the scene is, without what is written over it.
const SCENE_COLUMNS: std::ops::Range<usize> = 30..660;
const SCENE_ROWS: std::ops::Range<usize> = 110..560;

#[test]
fn a_scene_runs_and_is_touched() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf");
    browser.set_scheme("dark");
    browser.open(&format!("{}?fine", view.page()), 1000, 700);
    browser.until("document.getElementById('particles').textContent === '64'");
    assert_eq!(browser.text("title"), "scene");
    let time = browser.number("time");
    browser.until(&format!("Number(document.getElementById('time').textContent) > {}", time + 0.1));
    let dark = browser.pixels();
    assert!(dark.colors(SCENE_COLUMNS, SCENE_ROWS) > 200, "a blank picture");
    assert!(dark.brightness() < 80.0, "{}", dark.brightness());

    // A click on the floor drops a cube.
    browser.value("(() => { const s = document.getElementById('size'); s.value = 0.15; s.dispatchEvent(new Event('input')); })()");
    browser.click(350.0, 380.0);
    browser.until("document.getElementById('particles').textContent === '91'");

    // Pause, by the button and by a key: time stands still where the program stands.
    browser.press("play");
    browser.until("document.getElementById('play').getAttribute('aria-label') === 'Play'");
    let mut client = view.connect();
    let stopped = client.frame().time;
    browser.until(&format!("document.getElementById('time').textContent === '{stopped:.2}'"));
    std::thread::sleep(std::time::Duration::from_millis(400));
    assert_eq!(browser.number("time"), format!("{stopped:.2}").parse::<f64>().unwrap());
    let still = browser.settled();
    browser.press("forward");
    browser.until(&format!("document.getElementById('time').textContent === '{:.2}'", stopped + 0.02));
    browser.value("document.getElementById('canvas').focus()");
    browser.key(" ");
    browser.until("document.getElementById('play').getAttribute('aria-label') === 'Pause'");
    browser.until(&format!("Number(document.getElementById('time').textContent) > {}", stopped + 0.3));
    browser.until_picture("the fluid has moved", |later| {
        still.differing(later, SCENE_COLUMNS, SCENE_ROWS) > 0.002
    });

    // A drag turns the camera, and drops nothing.
    browser.key(" ");
    browser.until("document.getElementById('play').getAttribute('aria-label') === 'Play'");
    let before = browser.settled();
    browser.drag([300.0, 300.0], [420.0, 320.0]);
    browser.until_picture("the camera has turned", |now| {
        before.differing(now, SCENE_COLUMNS, SCENE_ROWS) > 0.01
    });
    browser.key("v");
    browser.until_picture("the view is as it was", |now| {
        before.differing(now, SCENE_COLUMNS, SCENE_ROWS) < 0.002
    });
    assert_eq!(browser.text("particles"), "91");

    // The surface, and the light scheme, are other pictures of the same.
    browser.key("s");
    browser
        .until_picture("there is a surface", |now| before.differing(now, SCENE_COLUMNS, SCENE_ROWS) > 0.005);
    browser.set_scheme("light");
    browser.until_picture("it is light", |now| now.brightness() > 150.0);

    // Two solvers, and a recording.
    browser.key("b");
    browser.until("document.getElementById('labels').children.length === 2");
    browser.press("record");
    browser.until("document.getElementById('record').getAttribute('aria-pressed') === 'true'");
    browser.press("record");
    browser.until("document.getElementById('toast').textContent.includes('out/view/scene-001')");
    browser.key("?");
    browser.until("document.getElementById('help').open");
    assert_eq!(browser.complaints, [""; 0]);
}

#[test]
fn stored_frames_are_scrubbed() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 30 --out run");
    let view = View::start(&folder, "run --paused");
    browser.open(&format!("{}?fine", view.page()), 1000, 700);
    browser.until("document.getElementById('particles').textContent === '64'");
    assert_eq!(browser.value("document.getElementById('scrub').max"), "30");
    let first = browser.settled();
    // What is for simulations is not there.
    assert_eq!(browser.value("document.getElementById('record').offsetParent"), json!(null));
    browser.value(
        "(() => { const s = document.getElementById('scrub'); s.value = 20; \
         s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change')); })()",
    );
    browser.until("document.getElementById('frame-number').textContent === 'frame 20'");
    browser.until_picture("another frame is shown", |now| {
        first.differing(now, SCENE_COLUMNS, SCENE_ROWS) > 0.002
    });
    browser.key(",");
    browser.until("document.getElementById('frame-number').textContent === 'frame 19'");
    browser.press("play");
    browser.until("document.getElementById('frame-number').textContent === 'frame 30'");
    assert_eq!(browser.complaints, [""; 0]);

    // The page reads bytes as the program does: the frame as Rust decodes it, and as the page's module does.
    let mut client = view.connect();
    let frame = client.frame();
    let panel = &frame.panels[0];
    let expected: Vec<f64> = panel
        .position
        .iter()
        .zip(&panel.speed)
        .flat_map(|(x, speed)| [x[0], x[1], x[2], *speed])
        .map(f64::from)
        .collect();
    let decoded = browser.value(
        "(async () => { const { decode, decodePanel } = await import('./protocol.js'); \
         const socket = new WebSocket(`ws://${location.host}/socket`); socket.binaryType = 'arraybuffer'; \
         const frame = await new Promise((found) => { socket.onmessage = ({ data }) => { \
           if (typeof data !== 'string') { const message = decode(data); if (message.kind === 'frame') found(message); } }; }); \
         socket.close(); \
         return { number: frame.number, time: frame.time, count: frame.panels[0].count, \
           values: [...decodePanel(frame.panels[0])], small: [...frame.panels[0].small] }; })()",
    );
    assert_eq!((&decoded["number"], &decoded["count"]), (&frame.number.into(), &64.into()));
    let values: Vec<f64> =
        decoded["values"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    assert_eq!(values.len(), expected.len());
    for (found, exact) in values.iter().zip(&expected) {
        // The rounding of float32 in a box of 0.5 m.
        assert!((found - exact).abs() < 1e-6, "{found} and {exact}");
    }
}

/// Frames whose numbers have gaps: the slider goes by their places.
#[test]
fn the_slider_stands_at_the_frame_that_is_shown() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    let view = View::of_frames_with_gaps(&folder);
    browser.open(&format!("{}?draw=off", view.page()), 1000, 700);
    browser.until("document.getElementById('scrub').max === '3'");
    for (key, number, place) in [(".", 7, "1"), (".", 8, "2"), (".", 9, "3"), (",", 8, "2")] {
        browser.key(key);
        browser.until(&format!("document.getElementById('frame-number').textContent === 'frame {number}'"));
        // It is set with the number, in the same round of read-outs.
        assert_eq!(browser.value("document.getElementById('scrub').value"), place);
    }
    assert_eq!(browser.complaints, [""; 0]);
}

#[test]
fn a_held_key_asks_once() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    let mut client = view.connect();
    browser.open(&format!("{}?fine", view.page()), 1000, 700);
    browser.until("document.getElementById('particles').textContent === '64'");
    // It has been drawn.
    browser.until("document.getElementById('canvas').width > 300");
    browser.value("(() => { const s = document.getElementById('size'); s.value = 0.15; s.dispatchEvent(new Event('input')); })()");
    browser.value("document.getElementById('canvas').focus()");
    browser.hold("d", 5);
    browser.hold(".", 5);
    // All that comes after them.
    browser.key("b");
    let frame = client.until_frame("there are two", |frame| frame.panels.len() == 2);
    assert_eq!((frame.number, frame.panels[0].position.len()), (1, 64 + 27));
    // Speeds are gone through: one press alone would halve it.
    browser.hold("[", 9);
    client.until("it is slow", |state| state["speed"].as_f64() < Some(0.5));
    assert_eq!(browser.complaints, [""; 0]);
}

#[test]
fn the_picture_follows_its_window() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    browser.open(&format!("{}?fine", view.page()), 1000, 700);
    browser.until("document.getElementById('particles').textContent === '64'");
    let before = browser.settled();
    assert!(before.colors(SCENE_COLUMNS, SCENE_ROWS) > 200, "a blank picture");

    // Who goes through the page by keys sees where he is: a line along the edge of the scene.
    browser.value("document.getElementById('canvas').focus()");
    browser.until_picture("the scene has the focus", |now| before.differing(now, 0..2, 200..500) > 0.9);

    // The graphics of a browser come and go, and it is said.
    browser.value(
        "(() => { window.graphics = document.getElementById('canvas').getContext('webgl2').getExtension('WEBGL_lose_context'); \
         window.graphics.loseContext(); })()",
    );
    browser.until("!document.getElementById('notice').hidden");
    assert!(browser.text("notice").contains("graphics"));
    browser.value("window.graphics.restoreContext()");
    browser.until("document.getElementById('notice').hidden");
    browser
        .until_picture("it is drawn again", |now| before.differing(now, SCENE_COLUMNS, SCENE_ROWS) < 0.002);

    // A picture of another size is empty: it is drawn before anybody sees that.
    browser.value(
        "(() => { Object.assign(window, { sizes: 0, flashes: 0 }); let isBlank = false; \
         const { get, set } = Object.getOwnPropertyDescriptor(HTMLCanvasElement.prototype, 'width'); \
         Object.defineProperty(HTMLCanvasElement.prototype, 'width', { get, set(value) { \
           set.call(this, value); window.sizes++; isBlank = true; \
           queueMicrotask(() => { if (isBlank) window.flashes++; }); } }); \
         const draw = WebGL2RenderingContext.prototype.drawArrays; \
         WebGL2RenderingContext.prototype.drawArrays = function (...all) { isBlank = false; return draw.apply(this, all); }; })()",
    );
    let fits = "document.getElementById('canvas').width === document.getElementById('canvas').clientWidth";
    browser.press("settings-toggle");
    browser.until("document.getElementById('canvas').clientWidth === 1000");
    browser.until(fits);
    browser.resize(900, 600);
    browser.until("document.getElementById('canvas').clientWidth === 900");
    browser.until(fits);
    assert_eq!(browser.value("[window.sizes > 0, window.flashes]"), json!([true, 0]));

    // A window of the same size on a finer screen.
    browser.resize_on(2, 900, 600);
    browser.until("document.getElementById('canvas').width === 1800");
}

#[test]
fn what_is_to_be_known_can_be_read() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    let thick = r#""shape": "box", "scale": 0.2, "translation": [0, 0.3, 0], "viscosity": 0.1"#;
    folder.write("scene.json", scene_of(thick));
    let view = View::start(&folder, "scene.json --solver dfsph --paused");
    browser.open(&format!("{}?draw=off", view.page()), 1000, 700);
    browser.until("document.querySelector('#labels .warning') !== null");
    let said = browser.value("document.querySelector('#labels .warning').textContent");
    assert!(said.as_str().unwrap().contains("viscosity 0.1 acts once a step"), "{said}");
    let refused = browser.text("solver-hint");
    assert!(refused.contains("Not Network default: ") && refused.contains("Not PBF: "), "{refused}");
    assert!(!refused.contains("Not DFSPH") && !refused.contains("Not Network viscosity"), "{refused}");
    assert_eq!(browser.complaints, [""; 0]);
}

#[test]
fn sliders_say_what_is_so() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    let fluid = |x: f64, viscosity: f64| {
        let at = format!(r#""translation": [{x}, 0.3, 0], "viscosity": {viscosity}"#);
        format!(r#"{{"shape": "box", "scale": 0.2, {at}}}"#)
    };
    let walls = r#"[{"shape": "container", "scale": [0.8, 0.8, 0.5]}]"#;
    let fluids = [fluid(-0.15, 0.01), fluid(0.15, 0.1)].join(", ");
    folder.write(
        "scene.json",
        format!(r#"{{"gravity": [0, -50, -9.81], "walls": {walls}, "fluids": [{fluids}]}}"#),
    );
    let view = View::start(&folder, "scene.json --solver dfsph --paused");
    browser.open(&format!("{}?draw=off", view.page()), 1000, 700);
    browser.until("document.getElementById('gravity-1-value').textContent === '−50.00 m/s²'");
    assert_eq!(browser.text("gravity-2-value"), "−9.81 m/s²");
    // Who listens hears the same.
    let heard =
        "['gravity-1', 'viscosity'].map((id) => document.getElementById(id).getAttribute('aria-valuetext'))";
    assert_eq!(browser.value(heard), json!(["−50.00 m/s²", "several"]));
    // One slip of a finger, and back.
    browser.value(
        "(() => { const s = document.getElementById('viscosity'); s.value = 0.5; \
         s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change')); })()",
    );
    browser.until("document.getElementById('viscosity-value').textContent === '0.125'");
    browser.press("viscosity-reset");
    browser.until("document.getElementById('viscosity-value').textContent === 'several'");
    assert_eq!(browser.complaints, [""; 0]);
}

#[test]
fn a_small_window_and_fingers() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    browser.call("Emulation.setTouchEmulationEnabled", json!({"enabled": true, "maxTouchPoints": 2}));
    browser.open(&format!("{}?fine", view.page()), 390, 780);
    browser.until("document.getElementById('particles').textContent === '64'");
    // Everything is inside the window, and nothing needs a scroll bar.
    let outside = browser.value(
        "[...document.querySelectorAll('#top, #tools, #transport, #transport *')].filter((e) => { \
         const b = e.getBoundingClientRect(); return b.width > 0 && (b.left < -1 || b.right > innerWidth + 1); })\
         .map((e) => e.id || e.tagName)",
    );
    assert_eq!(outside, json!([]));
    let (columns, rows) = (20..370, 120..600);
    let before = browser.settled();
    assert!(before.colors(columns.clone(), rows.clone()) > 200, "a blank picture");
    browser.value("(() => { const s = document.getElementById('size'); s.value = 0.15; s.dispatchEvent(new Event('input')); })()");
    browser.tap(195.0, 400.0);
    browser.until("document.getElementById('particles').textContent === '91'");
    // Two fingers apart: nearer; and nothing is dropped.
    // The ring where it was tapped has gone by then.
    browser.until("document.getElementById('marks').children.length === 0");
    let dropped = browser.settled();
    browser.touch("touchStart", &[[180.0, 400.0], [210.0, 400.0]]);
    browser.touch("touchMove", &[[150.0, 400.0], [240.0, 400.0]]);
    browser.touch("touchEnd", &[]);
    browser.until_picture("it is nearer", |now| dropped.differing(now, columns.clone(), rows.clone()) > 0.02);
    assert_eq!(browser.text("particles"), "91");
    // The settings are a sheet that opens and closes.
    browser.press("settings-toggle");
    browser.until("document.getElementById('settings').offsetHeight > 100");
    assert_eq!(browser.complaints, [""; 0]);
}

#[test]
fn everything_has_a_name_and_emitters_have_handles() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    let jet = r#""shape": "box", "scale": [0.1, 0.05, 0.1], "translation": [0, 0.6, 0], "velocity": [0, -3, 0],
        "start": 0, "stop": 600, "step": 2"#;
    folder.write("scene.json", scene_of(jet));
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    browser.open(&format!("{}?fine", view.page()), 1000, 700);
    browser.until("document.querySelectorAll('#handles button').length === 1");
    browser.call("Accessibility.enable", json!({}));
    let tree = browser.call("Accessibility.getFullAXTree", json!({}));
    let controls = ["button", "slider", "switch", "radio", "combobox", "checkbox", "textbox", "application"];
    let mut named = 0;
    for node in tree["nodes"].as_array().unwrap() {
        let role = node["role"]["value"].as_str().unwrap_or_default();
        if node["ignored"] != true && controls.contains(&role) {
            let name = node["name"]["value"].as_str().unwrap_or_default();
            assert!(!name.trim().is_empty(), "{node}");
            named += 1;
        }
    }
    assert!(named > 20, "{named} controls");
    assert!(browser.text("viscosity-hint").starts_with("PBF has no viscosity"));
    // The arrow keys move the emitter.
    let mut client = view.connect();
    let at = |client: &super::client::Client| client.state["emitters"][0]["position"][1].as_f64().unwrap();
    client.until("there is one", |_| true);
    let before = at(&client);
    browser.value("document.querySelector('#handles button').focus()");
    browser.key("ArrowDown");
    client
        .until("it has moved", |state| state["emitters"][0]["position"][1].as_f64().unwrap() < before - 0.03);
    assert_eq!(browser.complaints, [""; 0]);
}

/// Measures: the frames of the directory FLUVIA_FRAMES, as fast as they come, received and decoded in the page (`?draw=off`).
#[test]
#[ignore = "a measurement, see validation/view.sh"]
fn frames_that_the_page_receives() {
    let mut browser = Browser::start().expect("a browser");
    let frames = std::env::var("FLUVIA_FRAMES").expect("FLUVIA_FRAMES names a directory of frames");
    let folder = Folder::new();
    let view = View::start(&folder, &frames);
    browser.open(&format!("{}?draw=off", view.page()), 1000, 700);
    browser.value(
        "(() => { const s = document.getElementById('speed'); s.value = 'null'; s.dispatchEvent(new Event('change')); \
         setInterval(() => { const play = document.getElementById('play'); \
           if (play.getAttribute('aria-label') === 'Play') play.click(); }, 5); })()",
    );
    browser.until("document.getElementById('frame-number').textContent !== ''");
    std::thread::sleep(std::time::Duration::from_secs(3));
    let rates: Vec<f64> = (0..8)
        .map(|_| {
            std::thread::sleep(std::time::Duration::from_secs(1));
            browser.number("received")
        })
        .collect();
    let mean = rates.iter().sum::<f64>() / rates.len() as f64;
    println!(
        "{} particles: {mean:.0} frames a second received and decoded, dropped {}",
        browser.text("particles"),
        browser.text("dropped")
    );
    assert!(mean > 0.0 && browser.complaints.is_empty(), "{:?}", browser.complaints);
}
