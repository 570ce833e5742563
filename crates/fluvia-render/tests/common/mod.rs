//! What the tests of pictures share.

use fluvia_render::{Camera, Image, Subject, View, Walls};

/// The colour of a tile where nothing is drawn.
pub const TILE: [u8; 3] = [24, 29, 37];

/// The radius of particles, metres.
pub const RADIUS: f32 = 0.025;

/// The camera that sees all of this.
pub fn camera(walls: Walls<'_>, position: &[[f32; 3]], view: &View) -> Camera {
    let mut subject = Subject::new(walls, RADIUS);
    subject.add(position);
    Camera::fit(&subject, view).expect("a view in range")
}

/// Makes sure that a disc and nothing else is drawn, its radius `reach` up to `rim` pixels.
///
/// # Panics
/// If a pixel is drawn that should not be, or is not that should be.
pub fn assert_disc(image: &Image, [x, y]: [f32; 2], reach: f32, rim: f32) {
    for row in 0..image.height {
        for column in 0..image.width {
            let away = (column as f32 + 0.5 - x).hypot(row as f32 + 0.5 - y);
            let drawn = image.get(column, row) != Some(TILE);
            assert!(drawn || away > reach - rim, "hole at {column}, {row}");
            assert!(!drawn || away < reach + rim, "speck at {column}, {row}");
        }
    }
}
