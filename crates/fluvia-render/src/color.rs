//! Colours: the scale that turns a number into a colour, the colours of bodies, the theme.
//!
//! The scale runs from blue to pale yellow in equal steps of Oklab (Ottosson 2020): lightness and hue are
//! linear and chroma is constant, so that equal differences look equally large.

/// Red, green, blue: sRGB, 0..=255.
pub type Rgb = [u8; 3];

/// The sheet around the tiles.
pub(crate) const PAGE: Rgb = [13, 16, 21];
/// The background of a tile.
pub(crate) const TILE: Rgb = [24, 29, 37];
/// Wall points without a normal.
pub(crate) const DOT: Rgb = [165, 182, 204];
/// Walls.
pub(crate) const WALL_COLOR: Rgb = [120, 128, 140];
/// Titles and labels.
pub(crate) const TEXT: Rgb = [234, 238, 244];
/// Times, units and other text that stands back.
pub(crate) const QUIET: Rgb = [158, 168, 182];
/// Particles outside the walls, and labels that count them.
pub(crate) const OUTSIDE: Rgb = [255, 110, 25];
/// Particles without a value, or with one that is not finite.
pub(crate) const NO_VALUE: Rgb = [150, 158, 170];

/// Colours of bodies 0, 1, 2, ...; they repeat after the last. None is near the orange that marks particles
/// outside the walls; neighbours differ in lightness too, for readers who see fewer hues.
pub const BODY_COLORS: [Rgb; 8] = [
    [74, 158, 232],
    [243, 220, 112],
    [52, 186, 150],
    [236, 142, 196],
    [140, 116, 226],
    [168, 214, 92],
    [204, 214, 228],
    [86, 196, 222],
];

/// Where a value lies between the ends of a [`Scale`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Curve {
    /// In proportion.
    #[default]
    Linear,
    /// By the square root: small values, where most of a fluid is, get more of the scale.
    SquareRoot,
}

/// How numbers become colours; one for all frames that are to be compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Scale {
    /// The value of the blue end; values below it get the same colour.
    pub low: f32,
    /// The value of the yellow end; values above it get the same colour.
    pub high: f32,
    /// What lies between.
    pub curve: Curve,
    /// What the legend says, with the unit: "speed in m/s".
    pub label: String,
}

impl Scale {
    /// Speeds from 0 to `max` metres per second on a square-root scale.
    pub fn speed(max: f32) -> Scale {
        let label = "speed in m/s, square-root scale".to_owned();
        Scale { low: 0.0, high: max, curve: Curve::SquareRoot, label }
    }

    /// Heights from `low` to `high` metres.
    pub fn height(low: f32, high: f32) -> Scale {
        Scale { low, high, curve: Curve::Linear, label: "height in m".to_owned() }
    }

    /// The position of a value on the scale, 0..=1; `None` if it is not finite.
    pub fn place(&self, value: f32) -> Option<f32> {
        let span = self.high - self.low;
        if !value.is_finite() {
            return None;
        }
        // A scale without extent has one colour, the lowest.
        let linear = if span > 0.0 { ((value - self.low) / span).clamp(0.0, 1.0) } else { 0.0 };
        Some(match self.curve {
            Curve::Linear => linear,
            Curve::SquareRoot => linear.sqrt(),
        })
    }

    /// The value at a position in 0..=1: the inverse of [`Scale::place`].
    pub fn value(&self, place: f32) -> f32 {
        let linear = match self.curve {
            Curve::Linear => place,
            Curve::SquareRoot => place * place,
        };
        self.low + (self.high - self.low) * linear
    }
}

/// The length of each velocity, metres per second.
pub fn speeds(velocity: &[[f32; 3]]) -> Vec<f32> {
    velocity.iter().map(|[x, y, z]| (x * x + y * y + z * z).sqrt()).collect()
}

/// The height of each position along `up` (a unit vector), metres.
pub fn heights(position: &[[f32; 3]], up: [f32; 3]) -> Vec<f32> {
    position.iter().map(|p| p[0] * up[0] + p[1] * up[1] + p[2] * up[2]).collect()
}

/// The colour of body `index`: one of [`BODY_COLORS`], in their order, again and again.
pub fn body_color(index: u32) -> Rgb {
    BODY_COLORS[index as usize % BODY_COLORS.len()]
}

/// Steps of the scale's table: more than 8-bit colours can tell apart.
const RAMP_STEPS: usize = 512;

/// The scale's colours as a table, to look up once a particle.
pub(crate) struct Ramp([Rgb; RAMP_STEPS]);

impl Ramp {
    pub(crate) fn new() -> Ramp {
        Ramp(std::array::from_fn(|step| ramp_color(step as f32 / (RAMP_STEPS - 1) as f32)))
    }

    /// The colour at a position in 0..=1.
    pub(crate) fn at(&self, place: f32) -> Rgb {
        self.0[((place * (RAMP_STEPS - 1) as f32).round() as usize).min(RAMP_STEPS - 1)]
    }
}

/// Oklab lightness at the two ends of the scale: dark enough for slow water, light enough for spray.
const RAMP_LIGHTNESS: [f32; 2] = [0.52, 0.94];
/// Hues at the two ends, degrees in Oklab: blue, yellow.
const RAMP_HUE: [f32; 2] = [262.0, 105.0];
/// The largest chroma at which nearly the whole way between them stays inside sRGB.
const RAMP_CHROMA: f32 = 0.125;

fn ramp_color(place: f32) -> Rgb {
    let between = |[start, end]: [f32; 2]| start + (end - start) * place;
    let (sine, cosine) = between(RAMP_HUE).to_radians().sin_cos();
    oklab_to_srgb([between(RAMP_LIGHTNESS), RAMP_CHROMA * cosine, RAMP_CHROMA * sine])
}

/// Oklab lightness, a, b to sRGB; what lies outside is clipped.
pub(crate) fn oklab_to_srgb([l, a, b]: [f32; 3]) -> Rgb {
    let long = (l + 0.396_337_78 * a + 0.215_803_76 * b).powi(3);
    let medium = (l - 0.105_561_346 * a - 0.063_854_17 * b).powi(3);
    let short = (l - 0.089_484_18 * a - 1.291_485_5 * b).powi(3);
    [
        4.076_741_7 * long - 3.307_711_6 * medium + 0.230_969_94 * short,
        -1.268_438 * long + 2.609_757_4 * medium - 0.341_319_4 * short,
        -0.004_196_086 * long - 0.703_418_6 * medium + 1.707_614_7 * short,
    ]
    .map(|linear| (255.0 * srgb_from_linear(linear.clamp(0.0, 1.0))).round() as u8)
}

/// sRGB to Oklab lightness, a, b.
pub(crate) fn srgb_to_oklab(color: Rgb) -> [f32; 3] {
    let [r, g, b] = color.map(|channel| linear_from_srgb(f32::from(channel) / 255.0));
    let long = (0.412_221_46 * r + 0.536_332_55 * g + 0.051_445_995 * b).cbrt();
    let medium = (0.211_903_5 * r + 0.680_699_5 * g + 0.107_396_96 * b).cbrt();
    let short = (0.088_302_46 * r + 0.281_718_85 * g + 0.629_978_7 * b).cbrt();
    [
        0.210_454_26 * long + 0.793_617_8 * medium - 0.004_072_047 * short,
        1.977_998_5 * long - 2.428_592_2 * medium + 0.450_593_7 * short,
        0.025_904_037 * long + 0.782_771_77 * medium - 0.808_675_77 * short,
    ]
}

/// A colour in linear light, 0 to 1.
pub(crate) fn linear(color: Rgb) -> [f32; 3] {
    color.map(|channel| linear_from_srgb(f32::from(channel) / 255.0))
}

/// Steps of the table from linear light to bytes.
const TONE_STEPS: usize = 8192;
/// Light from which on it is compressed: highlights keep their shape and do not tear.
const TONE_KNEE: f32 = 0.75;

/// From linear light to the bytes of a picture, as a table.
pub(crate) struct Tone(Vec<u8>);

impl Tone {
    pub(crate) fn new() -> Tone {
        let byte = |step: usize| (255.0 * srgb_from_linear(step as f32 / TONE_STEPS as f32)).round() as u8;
        Tone((0..=TONE_STEPS).map(byte).collect())
    }

    /// The colour of light: its bytes, compressed above the knee.
    pub(crate) fn color(&self, light: [f32; 3]) -> Rgb {
        light.map(|x| {
            // From the knee on the way to 1 takes for ever.
            let over = (x - TONE_KNEE) / (1.0 - TONE_KNEE);
            let x = if over > 0.0 { TONE_KNEE + (1.0 - TONE_KNEE) * over / (1.0 + over) } else { x };
            // Casts saturate, and round down.
            self.0[((x * TONE_STEPS as f32 + 0.5) as usize).min(TONE_STEPS)]
        })
    }
}

fn srgb_from_linear(x: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

fn linear_from_srgb(x: f32) -> f32 {
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}
