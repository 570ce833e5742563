//! Pictures of the page, to be looked at; made by hand.

use serde_json::json;

use super::browser::Browser;
use super::client::View;
use crate::common::Folder;

/// Writes the README's pictures of the page; into the folder FLUVIA_PICTURES, if it is set, many more to look at.
#[test]
#[ignore = "writes docs/images/view_*.png"]
fn pictures_of_the_page() {
    let mut browser = Browser::start().expect("a browser");
    let folder = Folder::new();
    let all = std::env::var("FLUVIA_PICTURES").ok();
    let images = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/images");
    let pictures = std::path::Path::new(all.as_deref().unwrap_or(images));
    let view = View::start(&folder, "dam_break --solver dfsph --paused");
    let mut client = view.connect();
    client.frame();
    for number in 1..=44 {
        client.send(json!({"do": "step", "by": 1}));
        client.until_frame("it has stepped", |frame| frame.number == number);
    }
    let save = |browser: &mut Browser, name: &str| {
        std::thread::sleep(std::time::Duration::from_secs(4));
        std::fs::write(pictures.join(name), browser.screenshot()).expect("a picture");
    };
    let choose = |browser: &mut Browser, scheme: &str, look: &str| {
        browser.set_scheme(scheme);
        browser.value(&format!("document.querySelector('[value={look}]').click()"));
    };
    browser.open(&format!("{}?fine", view.page()), 1280, 800);
    browser.until("document.getElementById('particles').textContent !== '–'");
    choose(&mut browser, "dark", "particles");
    save(&mut browser, "view_particles.png");
    choose(&mut browser, "light", "surface");
    save(&mut browser, "view_surface.png");
    if all.is_none() {
        return;
    }
    choose(&mut browser, "dark", "surface");
    save(&mut browser, "view_surface_dark.png");
    choose(&mut browser, "light", "particles");
    save(&mut browser, "view_particles_light.png");
    browser.resize(1920, 1080);
    save(&mut browser, "view_large.png");
    client.send(json!({"do": "compare", "on": true}));
    save(&mut browser, "view_compare.png");
    browser.key("?");
    save(&mut browser, "view_help.png");
    browser.value("document.getElementById('help').close()");
    browser.resize(390, 844);
    save(&mut browser, "view_compare_small.png");
    client.send(json!({"do": "compare", "on": false}));
    choose(&mut browser, "dark", "surface");
    save(&mut browser, "view_small.png");
    browser.value("document.getElementById('settings-toggle').click()");
    save(&mut browser, "view_small_settings.png");
    browser.resize(844, 390);
    save(&mut browser, "view_flat.png");
    // What is to be known, and what is refused.
    let view = View::start(&folder, "three_viscosities --solver dfsph --paused");
    browser.open(&format!("{}?fine", view.page()), 1280, 800);
    browser.until("document.getElementById('particles').textContent !== '–'");
    view.connect().send(json!({"do": "compare", "on": true}));
    save(&mut browser, "view_warning.png");
    choose(&mut browser, "light", "particles");
    save(&mut browser, "view_warning_light.png");
    browser.value("document.getElementById('canvas').focus()");
    save(&mut browser, "view_focus.png");
}
