//! Frames on their way to the page, 10 bytes a particle: little endian, every part at a multiple of 8 bytes.
//!
//! ```text
//! header, 32 bytes   "FLVF"; sequence, frame, panels u32; time f64, s; flags u32 (bit 0: densities); index u32
//! a panel, 48 bytes  particles u32; ms a step f32; low, high 3 f32 each, m; highest speed f32, m/s; mean 3 f32, m
//! then of each panel
//!   8 bytes a particle  x, y, z, speed u16: low + (high - low) x / 65535; highest speed * speed / 65535
//!   2 bytes a particle  density u8, in hundredths of rest density; body u8, modulo 256; filled up to 8 bytes
//! ```
//!
//! Both blocks can be given to a GPU as they are, as attributes of an instance.

/// The first bytes of a frame.
pub const MAGIC: [u8; 4] = *b"FLVF";

const HEADER: usize = 32;
const PANEL: usize = 48;
const HAS_DENSITIES: u32 = 1;

/// One moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame<'a> {
    /// Its number in the simulation.
    pub number: u64,
    /// Its place among the stored frames, whose numbers may have gaps; 0 where none are stored.
    pub index: usize,
    /// Seconds since the simulation began.
    pub time: f64,
    /// What is side by side: one or two.
    pub panels: Vec<Panel<'a>>,
}

/// The particles of one simulation; every slice has one entry a particle, or none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Panel<'a> {
    /// Positions, metres.
    pub position: &'a [[f32; 3]],
    /// Velocities, metres per second.
    pub velocity: &'a [[f32; 3]],
    /// Densities over the rest density.
    pub density: &'a [f32],
    /// Indices of the bodies that particles came from.
    pub body: &'a [u32],
    /// How long a step takes, milliseconds; 0 where none is taken.
    pub ms_per_step: f32,
}

/// The bytes of a frame.
pub fn encode(frame: &Frame<'_>, sequence: u32) -> Vec<u8> {
    let sizes =
        frame.panels.iter().map(|panel| PANEL + 8 * panel.position.len() + small(panel.position.len()));
    let mut bytes = Vec::with_capacity(HEADER + sizes.sum::<usize>());
    let has_densities = frame.panels.iter().any(|panel| !panel.density.is_empty());
    bytes.extend(MAGIC);
    // A frame's number past 2³² is a run of 2.7 years at 50 Hz.
    let numbers = [sequence, frame.number as u32, frame.panels.len() as u32];
    numbers.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
    bytes.extend(frame.time.to_le_bytes());
    bytes.extend(if has_densities { HAS_DENSITIES } else { 0 }.to_le_bytes());
    bytes.extend((frame.index as u32).to_le_bytes());
    let scales: Vec<Scale> = frame.panels.iter().map(Scale::of).collect();
    for (panel, scale) in frame.panels.iter().zip(&scales) {
        bytes.extend((panel.position.len() as u32).to_le_bytes());
        let numbers = [panel.ms_per_step].into_iter().chain(scale.low).chain(scale.high);
        let numbers = numbers.chain([scale.highest_speed]).chain(scale.mean);
        numbers.for_each(|number| bytes.extend(number.to_le_bytes()));
    }
    for (panel, scale) in frame.panels.iter().zip(&scales) {
        push_particles(panel, scale, &mut bytes);
    }
    bytes
}

/// What the numbers of a panel are relative to.
struct Scale {
    low: [f32; 3],
    high: [f32; 3],
    highest_speed: f32,
    mean: [f32; 3],
}

impl Scale {
    fn of(panel: &Panel<'_>) -> Scale {
        let Some(&first) = panel.position.first() else {
            return Scale { low: [0.0; 3], high: [0.0; 3], highest_speed: 0.0, mean: [0.0; 3] };
        };
        let (mut low, mut high, mut sum) = (first, first, [0.0_f64; 3]);
        for x in panel.position {
            for a in 0..3 {
                low[a] = low[a].min(x[a]);
                high[a] = high[a].max(x[a]);
                sum[a] += f64::from(x[a]);
            }
        }
        let mean = sum.map(|sum| (sum / panel.position.len() as f64) as f32);
        let highest = panel.velocity.iter().map(squared).fold(0.0, f32::max);
        Scale { low, high, highest_speed: highest.sqrt(), mean }
    }
}

fn squared(v: &[f32; 3]) -> f32 {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

fn push_particles(panel: &Panel<'_>, scale: &Scale, bytes: &mut Vec<u8>) {
    let steps = |extent: f32| if extent > 0.0 { 65535.0 / extent } else { 0.0 };
    let factor: [f32; 3] = std::array::from_fn(|a| steps(scale.high[a] - scale.low[a]));
    let speed_factor = steps(scale.highest_speed);
    for (i, x) in panel.position.iter().enumerate() {
        let speed = panel.velocity.get(i).map_or(0.0, |v| squared(v).sqrt());
        let place = |a: usize| ((x[a] - scale.low[a]) * factor[a]).round() as u16;
        let row = [place(0), place(1), place(2), (speed * speed_factor).round() as u16];
        row.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
    }
    for i in 0..panel.position.len() {
        let density = panel.density.get(i).map_or(0, |density| (100.0 * density).round() as u8);
        bytes.extend([density, panel.body.get(i).map_or(0, |&body| body as u8)]);
    }
    let fill = small(panel.position.len()) - 2 * panel.position.len();
    bytes.extend(std::iter::repeat_n(0, fill));
}

/// The size of the block of densities and bodies.
fn small(particles: usize) -> usize {
    (2 * particles).next_multiple_of(8)
}

/// A frame as it was received.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoded {
    /// Goes up by one with every frame that the program publishes.
    pub sequence: u32,
    /// The number of the frame in the simulation.
    pub number: u32,
    /// Its place among the stored frames.
    pub index: u32,
    /// Seconds.
    pub time: f64,
    /// Whether densities were computed.
    pub has_densities: bool,
    /// One or two.
    pub panels: Vec<DecodedPanel>,
}

/// The particles of a [`Decoded`] frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DecodedPanel {
    /// Milliseconds.
    pub ms_per_step: f32,
    /// The mean position, metres.
    pub mean: [f32; 3],
    /// Metres, to 1 / 65535 of the extent of the panel along each axis.
    pub position: Vec<[f32; 3]>,
    /// Metres per second.
    pub speed: Vec<f32>,
    /// Over the rest density, to a hundredth, at most 2.55.
    pub density: Vec<f32>,
    /// Modulo 256.
    pub body: Vec<u8>,
}

/// Reads the bytes of a frame.
///
/// # Errors
/// What is wrong with them, in one line.
pub fn decode(bytes: &[u8]) -> Result<Decoded, String> {
    let mut reader = Reader { bytes, at: 0 };
    if reader.take::<4>()? != MAGIC {
        return Err("not a frame".into());
    }
    let [sequence, number, count] = [reader.u32()?, reader.u32()?, reader.u32()?];
    let time = f64::from_le_bytes(reader.take()?);
    let [flags, index] = [reader.u32()?, reader.u32()?];
    if count > 2 {
        return Err(format!("{count} panels, expected one or two"));
    }
    let mut heads = Vec::new();
    for _ in 0..count {
        let particles = reader.u32()? as usize;
        let mut floats = [0.0; 11];
        for float in &mut floats {
            *float = f32::from_le_bytes(reader.take()?);
        }
        heads.push((particles, floats));
    }
    let mut panels = Vec::new();
    for (particles, floats) in heads {
        panels.push(decode_panel(particles, floats, &mut reader)?);
    }
    if reader.at != bytes.len() {
        return Err(format!("{} bytes, expected {}", bytes.len(), reader.at));
    }
    Ok(Decoded { sequence, number, index, time, has_densities: flags & HAS_DENSITIES != 0, panels })
}

fn decode_panel(
    particles: usize,
    floats: [f32; 11],
    reader: &mut Reader<'_>,
) -> Result<DecodedPanel, String> {
    let [ms_per_step, lx, ly, lz, hx, hy, hz, highest, mx, my, mz] = floats;
    let (low, high) = ([lx, ly, lz], [hx, hy, hz]);
    let rows = reader.slice(8 * particles)?;
    let small = reader.slice(small(particles))?;
    let mut panel = DecodedPanel { ms_per_step, mean: [mx, my, mz], ..DecodedPanel::default() };
    for row in rows.chunks_exact(8) {
        let part = |k: usize| f32::from(u16::from_le_bytes([row[2 * k], row[2 * k + 1]])) / 65535.0;
        panel.position.push(std::array::from_fn(|a| low[a] + (high[a] - low[a]) * part(a)));
        panel.speed.push(highest * part(3));
    }
    for pair in small[..2 * particles].chunks_exact(2) {
        panel.density.push(f32::from(pair[0]) / 100.0);
        panel.body.push(pair[1]);
    }
    Ok(panel)
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn slice(&mut self, count: usize) -> Result<&'a [u8], String> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or_else(|| format!("{} bytes, expected more", self.bytes.len()))?;
        let slice = &self.bytes[self.at..end];
        self.at = end;
        Ok(slice)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut array = [0; N];
        array.copy_from_slice(self.slice(N)?);
        Ok(array)
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.take().map(u32::from_le_bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_comes_back_as_precise_as_it_says() {
        let position = [[0.0, -1.0, 2.0], [2.0, 3.0, 2.0], [0.3, 0.123_456, 2.0]];
        let velocity = [[0.0; 3], [3.0, 0.0, 4.0], [0.0, 1.0, 0.0]];
        let first = Panel {
            position: &position,
            velocity: &velocity,
            density: &[0.8, 9.0, 1.004],
            body: &[0, 1, 258],
            ms_per_step: 12.5,
        };
        let second = Panel { position: &position[1..2], ..Panel::default() };
        let frame = Frame { number: 7, index: 5, time: 0.14, panels: vec![first, second] };
        let bytes = encode(&frame, 3);
        assert_eq!(bytes.len(), 32 + 2 * 48 + (3 * 8 + 8) + (8 + 8));
        let decoded = decode(&bytes).unwrap();
        assert_eq!((decoded.sequence, decoded.number, decoded.index, decoded.time), (3, 7, 5, 0.14));
        assert!(decoded.has_densities);
        let panel = &decoded.panels[0];
        for (exact, found) in position.iter().zip(&panel.position) {
            for a in 0..3 {
                // Half a step of the longest axis, 4 m, and the rounding of float32.
                assert!((exact[a] - found[a]).abs() < 0.5 * 4.0 / 65535.0 + 1e-6, "{exact:?} {found:?}");
            }
        }
        assert_eq!((panel.speed[0], panel.speed[1], panel.ms_per_step), (0.0, 5.0, 12.5));
        assert!((panel.speed[2] - 1.0).abs() < 0.5 * 5.0 / 65535.0 + 1e-6);
        assert_eq!(
            (panel.density.as_slice(), panel.body.as_slice()),
            (&[0.8, 2.55, 1.0][..], &[0, 1, 2][..])
        );
        assert!((panel.mean[0] - 2.3 / 3.0).abs() < 1e-6 && panel.mean[2] == 2.0);
        // What has no extent, no velocity, no density and no body.
        let panel = &decoded.panels[1];
        assert_eq!((panel.position[0], panel.speed[0]), (position[1], 0.0));
        assert_eq!((panel.density[0], panel.body[0]), (0.0, 0));
    }

    #[test]
    fn large_frames_take_ten_bytes_a_particle() {
        let position = vec![[0.5; 3]; 6000];
        let panels = vec![Panel { position: &position, ..Panel::default() }];
        let frame = Frame { panels, ..Frame::default() };
        let bytes = encode(&frame, 0).len();
        assert!(bytes <= 10 * 6000 + 80, "{bytes}");
        let decoded = decode(&encode(&Frame::default(), 1)).unwrap();
        assert!(decoded.panels.is_empty() && !decoded.has_densities);
    }

    #[test]
    fn damaged_bytes_are_errors() {
        let position = [[0.5; 3]; 5];
        let frame =
            Frame { panels: vec![Panel { position: &position, ..Panel::default() }], ..Frame::default() };
        let bytes = encode(&frame, 0);
        for length in 0..bytes.len() {
            assert!(decode(&bytes[..length]).is_err(), "{length}");
        }
        assert!(decode(&[bytes.as_slice(), &[0]].concat()).is_err());
        let mut many = bytes;
        many[32..36].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(decode(&many).is_err());
    }
}
