//! The page, as it is in the folder `page`.

/// A file of the page.
pub(crate) struct Asset {
    /// The path that it is asked for by.
    pub path: &'static str,
    pub content_type: &'static str,
    pub bytes: &'static [u8],
}

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

macro_rules! asset {
    ($path:literal, $file:literal, $type:expr) => {
        Asset { path: $path, content_type: $type, bytes: include_bytes!(concat!("../page/", $file)) }
    };
}

/// All of them.
pub(crate) const ASSETS: [Asset; 17] = [
    asset!("/", "index.html", HTML),
    asset!("/style.css", "style.css", CSS),
    asset!("/icon.svg", "icon.svg", SVG),
    asset!("/main.js", "main.js", SCRIPT),
    asset!("/camera.js", "camera.js", SCRIPT),
    asset!("/colors.js", "colors.js", SCRIPT),
    asset!("/connection.js", "connection.js", SCRIPT),
    asset!("/controls.js", "controls.js", SCRIPT),
    asset!("/emitters.js", "emitters.js", SCRIPT),
    asset!("/gl.js", "gl.js", SCRIPT),
    asset!("/input.js", "input.js", SCRIPT),
    asset!("/protocol.js", "protocol.js", SCRIPT),
    asset!("/readouts.js", "readouts.js", SCRIPT),
    asset!("/renderer.js", "renderer.js", SCRIPT),
    asset!("/spheres.js", "spheres.js", SCRIPT),
    asset!("/surface.js", "surface.js", SCRIPT),
    asset!("/walls.js", "walls.js", SCRIPT),
];

#[cfg(test)]
mod tests {
    use super::*;

    /// The modules import each other by paths that are served, nothing is named that lies elsewhere, and no script or style is
    /// in the markup, where the policy forbids it.
    #[test]
    fn the_page_is_whole_and_names_nothing_else() {
        for asset in &ASSETS {
            let text = std::str::from_utf8(asset.bytes).unwrap();
            for (_, rest) in text.match_indices(" from \"").map(|(at, found)| text.split_at(at + found.len()))
            {
                let path = rest.split('"').next().unwrap().trim_start_matches('.');
                assert!(ASSETS.iter().any(|other| other.path == path), "{}: {path}", asset.path);
            }
            // The namespace of SVG is a name, not an address.
            let text = text.replace("http://www.w3.org/2000/svg", "");
            assert!(!text.contains("http://") && !text.contains("https://"), "{}", asset.path);
            if asset.content_type == SCRIPT {
                assert!(text.starts_with("// ") && text.lines().count() <= 420, "{}", asset.path);
            }
            if asset.content_type == HTML {
                assert!(!text.contains(" style=") && !text.contains(" onclick"), "{}", asset.path);
                assert!(text.matches("<script").count() == 1 && text.contains("src=\"main.js\""));
            }
        }
    }
}
