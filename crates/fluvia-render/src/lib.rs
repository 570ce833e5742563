//! Pictures of particle fluids without a display or a GPU: pixels from points and triangles.
//!
//! ```text
//! walls, positions   ->  Subject -> Camera        one camera for a whole film or sheet
//! walls              ->  Stage                    their points as a surface, made once
//! positions, values, ->  draw_frame -> Image      particles as spheres, or the liquid's surface as water, before the
//! surface                                         walls, in the light of a lamp with soft shadows and of a sky
//!                    ->  Page -> Image            labelled tiles, title, legend
//! Image              ->  encode_png, GifEncoder   bytes
//! ```
//!
//! Inputs are slices, outputs are images and encoded bytes; the crate reads and writes no file and keeps no
//! state. Lengths are metres, times seconds, angles degrees; image sizes are pixels. The same input gives the
//! same bits at any thread count.
//!
//! ```
//! use fluvia_render::{
//!     Camera, Frame, Stage, Style, Subject, Values, View, Walls, draw_frame, encode_png, speeds,
//! };
//!
//! let position = [[0.0, 0.1, 0.0], [0.05, 0.1, 0.0]];
//! let speed = speeds(&[[0.0, -1.0, 0.0], [0.0, -2.0, 0.0]]);
//! let style = Style::default();
//! let mut subject = Subject::new(Walls::default(), style.radius);
//! subject.add(&position);
//! let camera = Camera::fit(&subject, &View::default())?;
//! let frame = Frame { position: &position, values: Values::Scalar(&speed), ..Frame::default() };
//! let png: Vec<u8> = encode_png(&draw_frame(&frame, &Stage::default(), &camera, &style)?)?;
//! # Ok::<(), fluvia_render::Error>(())
//! ```

mod bounds;
mod camera;
mod color;
mod draw;
mod error;
mod frame;
mod gif;
mod image;
mod layers;
mod light;
mod outside;
mod paint;
mod palette;
mod raster;
mod shade;
mod sheet;
mod splat;
mod stage;
mod subject;
mod text;
mod tree;
mod upright;
mod vector;
mod view;

pub use camera::Camera;
pub use color::{BODY_COLORS, Curve, Rgb, Scale, body_color, heights, speeds};
pub use draw::{Style, draw_frame};
pub use error::Error;
pub use frame::{Frame, Surface, Values, Walls};
pub use gif::GifEncoder;
pub use image::{Image, encode_png};
pub use outside::OutsideTest;
pub use palette::{Palette, PaletteBuilder};
pub use sheet::{Legend, Page, Tile};
pub use stage::Stage;
pub use subject::Subject;
pub use view::View;

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;
