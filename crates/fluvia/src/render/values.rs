//! Values of the options of `fluvia render`: where the camera stands, sizes, shapes of sheets.

/// Where the camera stands.
#[derive(clap::Args)]
#[command(next_help_heading = "Camera")]
pub struct Place {
    /// The turn of the camera about the vertical, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 24.0, allow_negative_numbers = true)]
    pub yaw: f32,
    /// How far the camera looks down, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 18.0, allow_negative_numbers = true)]
    pub pitch: f32,
    /// The highest point to show, metres; the highest particle if not given.
    #[arg(long, value_name = "HEIGHT", allow_negative_numbers = true)]
    pub top: Option<f32>,
    /// How fast the camera of a film goes around what it looks at, degrees a second.
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, value_parser = turn)]
    pub orbit: Option<f32>,
    /// The point in the middle of the picture, metres; if not given the whole scene fills it.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point)]
    pub look_at: Option<[f32; 3]>,
    /// Where the camera stands, metres; far from the scene, by --yaw and --pitch, if not given.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point, conflicts_with_all = ["yaw", "pitch"])]
    pub eye: Option<[f32; 3]>,
    /// The angle of view from the lower to the upper edge, degrees; if not given all is to be seen.
    #[arg(long, value_name = "DEGREES")]
    pub field_of_view: Option<f32>,
}

/// Columns and rows of a sheet.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    pub columns: usize,
    pub rows: usize,
}

impl std::str::FromStr for Shape {
    type Err = String;

    fn from_str(text: &str) -> Result<Shape, String> {
        let number = |text: &str| text.parse().ok().filter(|n| (1..=100).contains(n));
        let shape = text.split_once(['x', 'X']).map(|(c, r)| (number(c), number(r)));
        match shape {
            Some((Some(columns), Some(rows))) => Ok(Shape { columns, rows }),
            _ => Err("expected COLUMNSxROWS, each 1 to 100, as in 4x2".into()),
        }
    }
}

/// The width of a picture, and its height if that is given, pixels.
#[derive(Clone, Copy, Debug)]
pub struct Size {
    pub width: u32,
    pub height: Option<u32>,
}

impl std::str::FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Size, String> {
        let size = match text.split_once(['x', 'X']) {
            Some((width, height)) => {
                width.parse().ok().zip(height.parse().ok()).map(|(width, height)| (width, Some(height)))
            }
            None => text.parse().ok().map(|width| (width, None)),
        };
        let (width, height) = size.ok_or("expected a width in pixels, or WIDTHxHEIGHT, as in 1280x720")?;
        Ok(Size { width, height })
    }
}

/// The fastest turn of a camera, degrees a second.
const FASTEST_TURN: f32 = 36_000.0;

/// Parses degrees a second.
fn turn(text: &str) -> Result<f32, String> {
    let number = text.parse().ok().filter(|x: &f32| x.abs() <= FASTEST_TURN);
    number.ok_or_else(|| format!("expected degrees a second from -{FASTEST_TURN} to {FASTEST_TURN}"))
}

/// Parses three numbers.
fn point(text: &str) -> Result<[f32; 3], String> {
    let numbers: Vec<f32> =
        text.split(',').filter_map(|word| word.trim().parse().ok()).filter(|x: &f32| x.is_finite()).collect();
    let count = text.split(',').count();
    let point = <[f32; 3]>::try_from(numbers).ok().filter(|_| count == 3);
    point.ok_or_else(|| "expected three numbers, as in 0.5,1,-2".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_and_sizes_are_read() {
        assert_eq!(point("0.5, 1,-2"), Ok([0.5, 1.0, -2.0]));
        assert!(["", "1,2", "1,2,3,4", "1,2,x", "1,,2", "1,2,nan"].iter().all(|text| point(text).is_err()));
        let size = |text: &str| text.parse().map(|Size { width, height }| (width, height));
        assert_eq!(size("640"), Ok((640, None)));
        assert_eq!(size("1280x720"), Ok((1280, Some(720))));
        assert!(["", "x", "1280x", "-1", "12 x 7"].iter().all(|text| size(text).is_err()));
    }

    #[test]
    fn turns_are_numbers() {
        assert_eq!(turn("-12.5"), Ok(-12.5));
        assert!(["", "nan", "inf", "1e9", "fast"].iter().all(|text| turn(text).is_err()));
    }
}
