//! A mesh as vertices and triangles, and its file formats: PLY (binary, little-endian) and Wavefront OBJ here, glTF
//! binary in [`super::glb`].
//!
//! Positions are f64 metres in the scene frame: in f32 a terrain of 500 km would lose centimetres (glTF has no f64; see
//! there). Normals are the mean
//! of the adjoining triangles' normals weighted by area. Triangles that share no interior with the grid are left out;
//! those that reach beyond it are whole.

use std::{
    collections::HashMap,
    io::{self, Write},
};

use glam::DVec3;
use sightline_proto::{diamond::Post, mesh::Mesh};

use super::glb;
use crate::terrain::SceneScale;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Format {
    Ply,
    Obj,
    Glb,
}

/// Triangles with shared vertices; counter-clockwise seen from above.
pub(super) struct Surface {
    pub(super) positions: Vec<DVec3>,
    pub(super) normals: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Surface {
    /// The part of a mesh that is over its grid. Vertices are in the order in which the triangles use them.
    pub(super) fn of(mesh: &impl Mesh, scale: SceneScale) -> Self {
        let (nx, ny) = mesh.grid_size();
        let mut surface = Self { positions: Vec::new(), normals: Vec::new(), triangles: Vec::new() };
        let mut numbers: HashMap<u64, u32> = HashMap::new();
        mesh.for_each_triangle(|t| {
            let corners = t.corners();
            let least = |of: fn(&Post) -> u32| corners.iter().map(of).min().unwrap_or(0);
            if least(|p| p.i) >= nx - 1 || least(|p| p.j) >= ny - 1 {
                return;
            }
            let triangle = corners.map(|p| {
                *numbers.entry(p.key()).or_insert_with(|| {
                    let z = mesh.height(p).unwrap_or(0.0);
                    let position = scale.scene_from_grid(DVec3::new(f64::from(p.i), f64::from(p.j), z));
                    surface.positions.push(position);
                    (surface.positions.len() - 1) as u32
                })
            });
            surface.triangles.push(triangle);
        });
        surface.find_normals();
        surface
    }

    fn find_normals(&mut self) {
        self.normals = vec![DVec3::ZERO; self.positions.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|n| self.positions[n as usize]);
            let doubled_area = (b - a).cross(c - a);
            for n in triangle {
                self.normals[*n as usize] += doubled_area;
            }
        }
        for normal in &mut self.normals {
            *normal = normal.normalize_or(DVec3::Z);
        }
    }

    pub(super) fn vertices(&self) -> usize {
        self.positions.len()
    }

    pub(super) fn triangles(&self) -> usize {
        self.triangles.len()
    }

    pub(super) fn write(&self, format: Format, out: &mut impl Write) -> io::Result<()> {
        match format {
            Format::Ply => self.write_ply(out)?,
            Format::Obj => self.write_obj(out)?,
            Format::Glb => glb::write(self, out)?,
        }
        out.flush()
    }

    fn write_ply(&self, out: &mut impl Write) -> io::Result<()> {
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\ncomment metres east, north and up of the south-west post\n\
             element vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
             property float nx\nproperty float ny\nproperty float nz\n\
             element face {}\nproperty list uchar int vertex_indices\nend_header\n",
            self.vertices(),
            self.triangles()
        )?;
        for (p, n) in self.positions.iter().zip(&self.normals) {
            for v in p.to_array() {
                out.write_all(&v.to_le_bytes())?;
            }
            for v in n.to_array() {
                out.write_all(&(v as f32).to_le_bytes())?;
            }
        }
        for triangle in &self.triangles {
            out.write_all(&[3])?;
            for n in triangle {
                out.write_all(&n.to_le_bytes())?;
            }
        }
        Ok(())
    }

    fn write_obj(&self, out: &mut impl Write) -> io::Result<()> {
        writeln!(out, "# metres east, north and up of the south-west post")?;
        for p in &self.positions {
            writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
        }
        for n in &self.normals {
            writeln!(out, "vn {:.6} {:.6} {:.6}", n.x, n.y, n.z)?;
        }
        for [a, b, c] in self.triangles.iter().map(|t| t.map(|n| n + 1)) {
            writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{
        roam::{Target, ViewMesh},
        terrain::synthetic,
        view::Camera,
        wedgie::MemoryTerrain,
    };

    fn surface(nx: u32, ny: u32) -> Surface {
        let scale = SceneScale { east_m: 20.0, north_m: 30.0, up_m: 0.5 };
        let terrain = MemoryTerrain::new(synthetic::fractal(nx, ny, 3, 100).unwrap(), scale).unwrap();
        let mut mesh = ViewMesh::new(Arc::new(terrain), scale).unwrap();
        mesh.update(&Camera::everywhere(), Target::TriangleBudget(500), &[]).unwrap();
        Surface::of(&mesh, scale)
    }

    #[test]
    fn triangles_face_up_and_cover_the_grid() {
        let surface = surface(33, 33);
        let area: f64 = surface
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|n| surface.positions[n as usize]);
                (b - a).cross(c - a).z * 0.5
            })
            .sum();
        assert_eq!(area, 32.0 * 20.0 * 32.0 * 30.0);
        assert!(surface.normals.iter().all(|n| n.z > 0.0 && (n.length() - 1.0).abs() < 1e-12));
    }

    #[test]
    fn padding_is_left_out() {
        let surface = surface(40, 21);
        assert!(surface.triangles.iter().all(|t| {
            t.iter().any(|&n| surface.positions[n as usize].x < 39.0 * 20.0)
                && t.iter().any(|&n| surface.positions[n as usize].y < 20.0 * 30.0)
        }));
    }

    #[test]
    fn files_hold_what_their_headers_say() {
        let surface = surface(20, 17);
        let (mut ply, mut obj) = (Vec::new(), Vec::new());
        surface.write(Format::Ply, &mut ply).unwrap();
        surface.write(Format::Obj, &mut obj).unwrap();
        let header = b"end_header\n";
        let body = ply.windows(header.len()).position(|w| w == header).unwrap() + header.len();
        assert_eq!(ply.len() - body, surface.vertices() * 36 + surface.triangles() * 13);
        let obj = String::from_utf8(obj).unwrap();
        let count = |prefix: &str| obj.lines().filter(|line| line.starts_with(prefix)).count();
        assert_eq!(count("v "), surface.vertices());
        assert_eq!(count("vn "), surface.vertices());
        assert_eq!(count("f "), surface.triangles());
    }
}
