//! Walls on their way to the page: once a connection, and again when they change. Little endian.
//!
//! ```text
//! header, 40 bytes  "FLVW"; vertices V, triangles T, points P u32; low, high 3 f32 each, m: what to look at
//! 3 f32 a vertex, m; 3 u32 a triangle, counter-clockwise seen from the fluid; 6 f32 a point: m, unit normal or zeros
//! ```

/// The first bytes.
pub const MAGIC: [u8; 4] = *b"FLVW";

/// The most points that are sent: enough to see the shape of a wall.
const MOST_POINTS: usize = 40_000;

/// The walls of a scene, and the box around what happens in it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Walls {
    /// The vertices of triangles, metres.
    pub vertices: Vec<[f32; 3]>,
    /// Their corners, counter-clockwise seen from the fluid.
    pub triangles: Vec<[u32; 3]>,
    /// Wall particles where there is no surface, metres.
    pub points: Vec<[f32; 3]>,
    /// Their unit normals, into the fluid; none where they are not known.
    pub normals: Vec<[f32; 3]>,
    /// The lowest coordinates of what is to be seen, metres.
    pub low: [f32; 3],
    /// The highest.
    pub high: [f32; 3],
}

/// The bytes of walls; of many points only an even part.
pub fn encode(walls: &Walls) -> Vec<u8> {
    let every = walls.points.len().div_ceil(MOST_POINTS).max(1);
    let points: Vec<usize> = (0..walls.points.len()).step_by(every).collect();
    let mut bytes = Vec::new();
    bytes.extend(MAGIC);
    let counts = [walls.vertices.len(), walls.triangles.len(), points.len()];
    counts.iter().for_each(|count| bytes.extend((*count as u32).to_le_bytes()));
    push(&mut bytes, &[walls.low, walls.high]);
    push(&mut bytes, &walls.vertices);
    walls.triangles.iter().flatten().for_each(|corner| bytes.extend(corner.to_le_bytes()));
    for point in points {
        push(&mut bytes, &[walls.points[point], walls.normals.get(point).copied().unwrap_or_default()]);
    }
    bytes
}

fn push(bytes: &mut Vec<u8>, vectors: &[[f32; 3]]) {
    vectors.iter().flatten().for_each(|x| bytes.extend(x.to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layout_is_the_one_described() {
        let walls = Walls {
            vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            points: vec![[5.0, 6.0, 7.0]],
            normals: vec![[0.0, 0.0, 1.0]],
            low: [-1.0; 3],
            high: [2.0; 3],
        };
        let bytes = encode(&walls);
        assert_eq!(bytes.len(), 40 + 3 * 12 + 12 + 24);
        assert_eq!(&bytes[..8], b"FLVW\x03\0\0\0");
        assert_eq!(bytes[28..32], 2.0_f32.to_le_bytes());
        assert_eq!(bytes[40 + 36 + 8..40 + 36 + 12], 2_u32.to_le_bytes());
        assert_eq!(bytes[bytes.len() - 16..bytes.len() - 12], 7.0_f32.to_le_bytes());
        assert_eq!(bytes[bytes.len() - 4..], 1.0_f32.to_le_bytes());
    }

    #[test]
    fn of_many_points_a_part_is_sent() {
        let walls = Walls { points: vec![[0.0; 3]; 3 * MOST_POINTS + 1], ..Walls::default() };
        let points = (encode(&walls).len() - 40) / 24;
        assert!((MOST_POINTS / 2..=MOST_POINTS).contains(&points), "{points}");
    }
}
