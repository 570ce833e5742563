//! What the page computes, apart from drawing it.

use serde_json::json;

use super::browser::Browser;
use super::client::View;
use crate::common::{Folder, SCENE};

#[test]
fn its_modules_compute_what_they_say() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    browser.open(&format!("{}?draw=off", view.page()), 1000, 700);
    // A ray through a point of the picture is seen at that point, whatever is up and however it is turned.
    let seen = browser.value(
        "(async () => { const { Camera, project, rayThrough } = await import('./camera.js'); \
         const found = []; \
         for (const up of [[0, 1, 0], [0, 0, 1], [-1, 0, 0]]) { \
           const camera = new Camera(); camera.setUp(up); camera.setBox([-1, 0, -1], [2, 1, 1]); \
           camera.turn(0.7, -0.3); camera.pan(0.1, 0.2); camera.zoom(0.8); \
           const look = camera.look(1.5, 700); \
           const { origin, direction } = rayThrough(look, 0.3, -0.6); \
           const { x, y, distance } = project(look, origin.map((x, a) => x + 2.5 * direction[a])); \
           const above = project(look, camera.target.map((x, a) => x + 0.1 * camera.up[a])); \
           found.push([x, y, distance > 0 ? 1 : 0, above.y > 0 ? 1 : 0]); } \
         return found; })()",
    );
    for row in seen.as_array().unwrap() {
        let row: Vec<f64> = row.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        assert!((row[0] - 0.3).abs() < 1e-9 && (row[1] + 0.6).abs() < 1e-9, "{row:?}");
        assert_eq!(row[2..], [1.0, 1.0], "{row:?}");
    }
    // Everything that is fitted is inside the picture.
    let outside = browser.value(
        "(async () => { const { Camera, project } = await import('./camera.js'); \
         const camera = new Camera(); camera.setBox([-3, 0, -0.5], [1, 2, 0.5]); let most = 0; \
         for (const aspect of [0.4, 1, 2.5]) { const look = camera.look(aspect, 700); \
           for (let k = 0; k < 8; k++) { \
             const corner = [0, 1, 2].map((a) => (k & (1 << a) ? camera.high[a] : camera.low[a])); \
             const { x, y } = project(look, corner); most = Math.max(most, Math.abs(x), Math.abs(y)); } } \
         return most; })()",
    );
    assert!((0.7..=1.0).contains(&outside.as_f64().unwrap()), "{outside}");
    // A cube has twelve edges, the diagonals of its sides are none; inside out it holds fluid, else it is an obstacle.
    let cube = browser.value(
        "(async () => { const { buildSurface } = await import('./walls.js'); \
         const vertices = Float32Array.from({ length: 24 }, (_, k) => (Math.floor(k / 3) >> (k % 3)) & 1); \
         const sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]; \
         const outwards = sides.flatMap(([a, b, c, d]) => [a, b, c, a, c, d]); \
         const built = (corners, height) => { \
           const { faces, lines } = buildSurface({ vertices: vertices.map((x) => x + height), triangles: Uint32Array.from(corners) }); \
           return [faces.length / 21, lines.length / 14, faces[6]]; }; \
         return [outwards, [...outwards].reverse()].flatMap((corners) => \
           [built(corners, 0), built(corners, 1000), built(corners.slice(0, 30), 1000)]); })()",
    );
    // Without its last side it is open, and no obstacle, wherever it is.
    assert_eq!(cube, json!([[12, 12, 1], [12, 12, 1], [10, 12, 0], [12, 12, 0], [12, 12, 0], [10, 12, 0]]));
    // Slow pictures make coarser ones, fast ones finer; what was too fine is tried again, after longer.
    let finenesses = browser.value(
        "(async () => { const { Fineness } = await import('./renderer.js'); \
         const fineness = new Fineness(); \
         const after = ([count, milliseconds]) => { for (let k = 0; k < count; k++) fineness.adapt(milliseconds); return fineness.value; }; \
         return [[5, 100], [1, 100], [20, 100], [80, 17], [200, 17], [6, 100], [100, 17], [100, 17]].map(after); })()",
    );
    assert_eq!(finenesses, json!([1, 0.75, 0.5, 0.5, 1, 0.75, 0.75, 1]));
    // The colours are those of the pictures of `fluvia render`.
    let colors = browser.value(
        "(async () => { const { BODIES, scaleOf } = await import('./colors.js'); \
         const bytes = (color) => color.map((x) => Math.round(255 * x)); \
         return { bodies: BODIES.map(bytes), speed: scaleOf('speed').high }; })()",
    );
    assert_eq!(colors["bodies"], json!(fluvia_render::BODY_COLORS));
    assert_eq!(colors["speed"].as_f64(), Some(fluvia_render::Style::default().scale.high.into()));
    // The scale is lighter at every step, by as much.
    let steps = browser.value(
        "(async () => { const { ramp } = await import('./colors.js'); \
         const light = ([r, g, b]) => { const [R, G, B] = [r, g, b].map((x) => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4); \
           return 0.2104542553 * Math.cbrt(0.4122214708 * R + 0.5363325363 * G + 0.0514459929 * B) \
             + 0.793617785 * Math.cbrt(0.2119034982 * R + 0.6806995451 * G + 0.1073969566 * B) \
             - 0.0040720468 * Math.cbrt(0.0883024619 * R + 0.2817188376 * G + 0.6299787005 * B); }; \
         const values = Array.from({ length: 21 }, (_, k) => light(ramp(k / 20))); \
         return values.slice(1).map((value, k) => value - values[k]); })()",
    );
    for step in steps.as_array().unwrap() {
        // Steps of 0.42 / 20; where the colour leaves sRGB it is clipped.
        assert!((step.as_f64().unwrap() - 0.021).abs() < 0.008, "{steps}");
    }
    assert_eq!(browser.complaints, [""; 0]);
}
