//! Surfaces of liquids as files for other programs: triangles with normals and velocities at their vertices.
//!
//! | format | what is written |
//! | --- | --- |
//! | ply | binary little endian: `x y z nx ny nz`, with velocities `vx vy vz`, float; faces as lists of uint |
//! | obj | `v`, `vn` and `f a//a`; the format has no place for velocities |
//! | vtk | legacy version 3.0, binary, an unstructured grid of triangles; `normals` and `velocity` vectors float |
//!
//! A surface without triangles is a file too: a film has as many surfaces as frames. Each has a line of comment, for how
//! it was made: in ply the third line, in obj the first, in vtk the title.

use std::fmt;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;
use std::str::FromStr;

use super::TriangleMesh;
use crate::frames::write_atomically;
use crate::{Error, Result};

/// The surface of a liquid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// Vertices, metres, and triangles, counter-clockwise seen from outside.
    pub mesh: TriangleMesh,
    /// Unit normals that point out of the liquid, one a vertex.
    pub normal: Vec<[f32; 3]>,
    /// Velocities of the liquid, metres per second, one a vertex.
    pub velocity: Option<Vec<[f32; 3]>>,
}

/// A format that surfaces are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SurfaceFormat {
    /// PLY, binary little endian.
    Ply,
    /// Wavefront OBJ, without velocities.
    Obj,
    /// VTK legacy unstructured grid, binary.
    Vtk,
}

impl SurfaceFormat {
    /// Every format.
    pub const ALL: [SurfaceFormat; 3] = [SurfaceFormat::Ply, SurfaceFormat::Obj, SurfaceFormat::Vtk];

    /// The file name extension, without the dot; also the name that users type.
    pub fn extension(self) -> &'static str {
        match self {
            SurfaceFormat::Ply => "ply",
            SurfaceFormat::Obj => "obj",
            SurfaceFormat::Vtk => "vtk",
        }
    }
}

impl fmt::Display for SurfaceFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.extension())
    }
}

impl FromStr for SurfaceFormat {
    type Err = Error;

    fn from_str(name: &str) -> Result<SurfaceFormat> {
        SurfaceFormat::ALL.into_iter().find(|format| format.extension() == name).ok_or_else(|| {
            let known = SurfaceFormat::ALL.map(SurfaceFormat::extension).join(", ");
            Error::Parameter(format!("format '{name}' is not known, expected one of {known}"))
        })
    }
}

impl Surface {
    /// Writes the surface, atomically, with a comment of one line. Of that readers get printable ASCII, and no more of it
    /// than a title of vtk may have: 255 characters.
    ///
    /// # Errors
    /// `Io`.
    ///
    /// # Panics
    /// If there is not one normal, and with velocities one velocity, a vertex.
    pub fn write(&self, path: &Path, format: SurfaceFormat, comment: &str) -> Result<()> {
        let vertices = self.mesh.positions.len();
        assert_eq!(self.normal.len(), vertices, "a normal a vertex");
        assert!(self.velocity.as_ref().is_none_or(|v| v.len() == vertices), "a velocity a vertex");
        let comment = &printable(comment);
        write_atomically(path, |out| match format {
            SurfaceFormat::Ply => self.ply(comment, out),
            SurfaceFormat::Obj => self.obj(comment, out),
            SurfaceFormat::Vtk => self.vtk(comment, out),
        })
    }

    /// Whether a file has the comment that [`write`](Surface::write) gives it.
    ///
    /// # Errors
    /// `Io`.
    pub fn has_comment(path: &Path, format: SurfaceFormat, comment: &str) -> Result<bool> {
        let mut head = Vec::new();
        let read = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
        read.map_err(Error::io(path))?;
        let (line, before) = match format {
            SurfaceFormat::Ply => (2, PLY_COMMENT),
            SurfaceFormat::Obj => (0, OBJ_COMMENT),
            SurfaceFormat::Vtk => (1, ""),
        };
        let head = String::from_utf8_lossy(&head);
        let found = head.lines().nth(line).and_then(|line| line.strip_prefix(before));
        Ok(found == Some(printable(comment).as_str()))
    }

    fn ply(&self, comment: &str, out: &mut dyn Write) -> io::Result<()> {
        let (vertices, faces) = (self.mesh.positions.len(), self.mesh.triangles.len());
        let columns =
            [("", Some(&self.mesh.positions)), ("n", Some(&self.normal)), ("v", self.velocity.as_ref())];
        writeln!(
            out,
            "ply\nformat binary_little_endian 1.0\n{PLY_COMMENT}{comment}\nelement vertex {vertices}"
        )?;
        for (prefix, _) in columns.iter().filter(|(_, values)| values.is_some()) {
            for axis in ["x", "y", "z"] {
                writeln!(out, "property float {prefix}{axis}")?;
            }
        }
        writeln!(out, "element face {faces}\nproperty list uchar uint vertex_indices\nend_header")?;
        for vertex in 0..vertices {
            for value in columns.iter().filter_map(|(_, values)| *values).flat_map(|values| values[vertex]) {
                out.write_all(&value.to_le_bytes())?;
            }
        }
        for triangle in &self.mesh.triangles {
            out.write_all(&[3])?;
            for corner in triangle {
                out.write_all(&corner.to_le_bytes())?;
            }
        }
        Ok(())
    }

    fn obj(&self, comment: &str, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{OBJ_COMMENT}{comment}")?;
        for [x, y, z] in &self.mesh.positions {
            writeln!(out, "v {x} {y} {z}")?;
        }
        for [x, y, z] in &self.normal {
            writeln!(out, "vn {x} {y} {z}")?;
        }
        for triangle in &self.mesh.triangles {
            let [a, b, c] = triangle.map(|v| u64::from(v) + 1);
            writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
        }
        Ok(())
    }

    fn vtk(&self, comment: &str, out: &mut dyn Write) -> io::Result<()> {
        let (vertices, cells) = (self.mesh.positions.len(), self.mesh.triangles.len());
        // In this version a list of cells is 32-bit integers, and its length one too.
        if i32::try_from(4 * cells).is_err() {
            let most = i32::MAX / 4;
            return Err(io::Error::other(format!("legacy vtk holds {most} triangles, found {cells}")));
        }
        writeln!(out, "# vtk DataFile Version 3.0\n{comment}\nBINARY\nDATASET UNSTRUCTURED_GRID")?;
        writeln!(out, "POINTS {vertices} float")?;
        vectors(&self.mesh.positions, out)?;
        writeln!(out, "\nCELLS {cells} {}", 4 * cells)?;
        for triangle in &self.mesh.triangles {
            for number in std::iter::once(3).chain(*triangle) {
                out.write_all(&number.to_be_bytes())?;
            }
        }
        writeln!(out, "\nCELL_TYPES {cells}")?;
        for _ in 0..cells {
            out.write_all(&TRIANGLE_CELL.to_be_bytes())?;
        }
        writeln!(out, "\nPOINT_DATA {vertices}")?;
        // Normals are declared as vectors, because not every reader knows the keyword NORMALS.
        for (name, values) in [("normals", Some(&self.normal)), ("velocity", self.velocity.as_ref())] {
            if let Some(values) = values {
                writeln!(out, "VECTORS {name} float")?;
                vectors(values, out)?;
                out.write_all(b"\n")?;
            }
        }
        Ok(())
    }
}

/// The number of VTK_TRIANGLE.
const TRIANGLE_CELL: u32 = 5;

/// What stands before a comment.
const PLY_COMMENT: &str = "comment ";
const OBJ_COMMENT: &str = "# ";

/// Bytes of a file that its comment is in.
const HEAD: u64 = 512;

/// The part of a comment that every reader takes; a backslash at the end of a line would join it with the next.
fn printable(comment: &str) -> String {
    let readable = |c: char| if matches!(c, ' '..='~') && c != '\\' { c } else { '?' };
    let comment: String = comment.chars().take(255).map(readable).collect();
    comment.trim_end().to_owned()
}

fn vectors(values: &[[f32; 3]], out: &mut dyn Write) -> io::Result<()> {
    values.iter().flatten().try_for_each(|value| out.write_all(&value.to_be_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames;
    use crate::shapes::Shape;

    /// A sphere with its normals, and the velocities of a rotation.
    fn ball() -> Surface {
        let mesh = Shape::Sphere.mesh();
        let normal = mesh.positions.iter().map(|p| p.map(|x| 2.0 * x)).collect();
        let velocity = mesh.positions.iter().map(|&[x, y, z]| [-z, 0.25 * y, x]).collect();
        Surface { mesh, normal, velocity: Some(velocity) }
    }

    #[test]
    fn ply_and_obj_are_read_back_as_meshes() {
        let folder = tempfile::tempdir().unwrap();
        let surface = ball();
        for format in [SurfaceFormat::Ply, SurfaceFormat::Obj] {
            let path = folder.path().join(format!("ball.{format}"));
            surface.write(&path, format, "a ball").unwrap();
            assert_eq!(TriangleMesh::load(&path).unwrap(), surface.mesh, "{format}");
        }
    }

    #[test]
    fn ply_and_vtk_are_read_back_as_points_with_normals_and_velocities() {
        let folder = tempfile::tempdir().unwrap();
        let surface = ball();
        for format in [SurfaceFormat::Ply, SurfaceFormat::Vtk] {
            let path = folder.path().join(format!("ball.{format}"));
            surface.write(&path, format, "a ball").unwrap();
            let points = frames::read(&path).unwrap();
            assert_eq!(points.position, surface.mesh.positions, "{format}");
            assert_eq!(points.normal.as_ref(), Some(&surface.normal), "{format}");
            assert_eq!(points.velocity, surface.velocity, "{format}");
        }
        let bare = Surface { velocity: None, ..surface };
        let path = folder.path().join("bare.vtk");
        bare.write(&path, SurfaceFormat::Vtk, "").unwrap();
        assert_eq!(frames::read(&path).unwrap().velocity, None);
    }

    #[test]
    fn a_surface_without_triangles_is_a_file() {
        let folder = tempfile::tempdir().unwrap();
        for format in SurfaceFormat::ALL {
            let path = folder.path().join(format!("nothing.{format}"));
            Surface::default().write(&path, format, "nothing").unwrap();
            assert!(path.exists());
        }
        assert!(frames::read(&folder.path().join("nothing.ply")).unwrap().position.is_empty());
    }

    #[test]
    fn comments_are_known_again_whatever_is_in_them() {
        let folder = tempfile::tempdir().unwrap();
        let surface = ball();
        for format in SurfaceFormat::ALL {
            let path = folder.path().join(format!("ball.{format}"));
            let long = "x".repeat(400);
            for comment in ["a ball", "C:\\balls\\", "zwei\nBälle", &long, ""] {
                surface.write(&path, format, comment).unwrap();
                assert!(Surface::has_comment(&path, format, comment).unwrap(), "{format}: {comment}");
                assert!(!Surface::has_comment(&path, format, "another").unwrap());
                match format {
                    SurfaceFormat::Vtk => assert!(frames::read(&path).is_ok()),
                    _ => assert_eq!(TriangleMesh::load(&path).unwrap(), surface.mesh),
                }
            }
            std::fs::write(&path, [0xff; 3]).unwrap();
            assert!(!Surface::has_comment(&path, format, "a ball").unwrap());
        }
    }

    #[test]
    fn formats_are_known_by_name() {
        assert_eq!("vtk".parse::<SurfaceFormat>().unwrap(), SurfaceFormat::Vtk);
        let error = "stl".parse::<SurfaceFormat>().unwrap_err().to_string();
        assert!(error.contains("ply, obj, vtk"), "{error}");
    }
}
