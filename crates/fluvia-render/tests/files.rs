//! Encoded pictures and films, decoded again by the format's own reader.

use fluvia_render::{Error, GifEncoder, Image, Palette, encode_png};

/// A picture with a flat ground, a gradient and a mark that moves.
fn picture(step: u32) -> Image {
    let mut image = Image::filled(64, 40, [24, 29, 37]);
    for y in 0..20 {
        for x in 0..64 {
            put(&mut image, x, y, [(4 * x) as u8, (8 * y) as u8, 90]);
        }
    }
    for x in 0..4 {
        put(&mut image, 5 * step + x, 30, [255, 110, 25]);
    }
    image
}

fn put(image: &mut Image, x: u32, y: u32, color: [u8; 3]) {
    let at = 3 * (y * image.width + x) as usize;
    image.data[at..at + 3].copy_from_slice(&color);
}

/// The film as a viewer shows it: each frame over the last, and the delays in hundredths of a second.
fn play(bytes: &[u8]) -> Vec<(Image, u16)> {
    let mut options = gif::DecodeOptions::new();
    options.set_color_output(gif::ColorOutput::RGBA);
    let mut decoder = options.read_info(bytes).expect("a GIF");
    let mut canvas = Image::filled(decoder.width().into(), decoder.height().into(), [0; 3]);
    let mut film = Vec::new();
    while let Some(frame) = decoder.read_next_frame().expect("a whole frame") {
        assert_eq!(frame.dispose, gif::DisposalMethod::Keep);
        for (i, pixel) in frame.buffer.chunks_exact(4).enumerate().filter(|(_, pixel)| pixel[3] > 0) {
            let (x, y) = (i % usize::from(frame.width), i / usize::from(frame.width));
            let (left, top) = (usize::from(frame.left), usize::from(frame.top));
            put(&mut canvas, (left + x) as u32, (top + y) as u32, [pixel[0], pixel[1], pixel[2]]);
        }
        film.push((canvas.clone(), frame.delay));
    }
    assert_eq!(decoder.repeat(), gif::Repeat::Infinite);
    film
}

#[test]
fn a_png_reads_back_equal() {
    let image = picture(3);
    let bytes = encode_png(&image).unwrap();
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut data).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
    assert_eq!(Image { width: info.width, height: info.height, data }, image);
    assert!(matches!(encode_png(&Image::filled(0, 5, [0; 3])), Err(Error::Encode { .. })));
    assert!(encode_png(&Image { width: 3, height: 3, data: vec![0; 5] }).is_err());
}

#[test]
fn a_film_plays_back_in_the_palettes_colours_and_in_time() {
    let images: Vec<Image> = (0..9).map(picture).collect();
    let palette = Palette::of(&images);
    let mut encoder = GifEncoder::new(64, 40, palette.clone()).unwrap();
    for image in &images {
        encoder.push(image, 1.0 / 30.0).unwrap();
    }
    // A frame like the one before.
    encoder.push(&images[8], 0.5).unwrap();
    let bytes = encoder.finish().unwrap();
    let film = play(&bytes);
    assert_eq!(film.len(), 10);
    for ((shown, _), image) in film.iter().zip(images.iter().chain([&images[8]])) {
        let mut error = 0;
        for (found, asked) in shown.data.chunks_exact(3).zip(image.data.chunks_exact(3)) {
            let asked = [asked[0], asked[1], asked[2]];
            assert_eq!(found, palette.colors()[usize::from(palette.nearest(asked))]);
            error += (0..3).map(|k| u64::from(found[k].abs_diff(asked[k]))).sum::<u64>();
        }
        // 255 entries for 1282 colours of a plane 256 by 160 levels wide lie about 13 levels apart, so a channel
        // is wrong by a quarter of that on average; the ground, half of the picture, is exact.
        assert!(error < 3 * 3 * (64 * 40), "errors of {error} levels in all");
    }
    // What stands still has the same colour in every frame.
    assert!(film.iter().all(|(image, _)| image.data[..3 * 64 * 20] == film[0].0.data[..3 * 64 * 20]));
    let delays: u16 = film[..9].iter().map(|(_, delay)| delay).sum();
    assert_eq!((delays, film[9].1), (30, 50));
}

#[test]
fn a_film_of_one_frame_and_one_of_none_are_files_too() {
    let encoder = GifEncoder::new(64, 40, Palette::of([])).unwrap();
    assert!(encoder.finish().unwrap().starts_with(b"GIF89a"));
    let mut encoder = GifEncoder::new(64, 40, Palette::of([&picture(0)])).unwrap();
    encoder.push(&picture(0), f64::NAN).unwrap();
    assert_eq!(play(&encoder.finish().unwrap()).len(), 1);
}

#[test]
fn frames_of_another_size_and_impossible_sizes_are_errors() {
    let palette = Palette::of([&picture(0)]);
    assert!(GifEncoder::new(0, 10, palette.clone()).is_err());
    assert!(GifEncoder::new(70_000, 10, palette.clone()).is_err());
    let mut encoder = GifEncoder::new(64, 41, palette).unwrap();
    assert!(matches!(encoder.push(&picture(0), 0.1), Err(Error::Parameter { .. })));
}
