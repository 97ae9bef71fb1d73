//! A mesh as glTF 2.0 in one binary file (GLB): Khronos Group, "glTF 2.0 Specification", 2021, sections 3 and 4.
//!
//! glTF has the y axis up and single precision. So a vertex is stored as (east, up, -north) metres from the middle of the
//! mesh's bounding box, which is the translation of the one node, in JSON numbers and thus in f64: what is lost is the
//! rounding of an f32 half the size of the mesh, and none of it depends on where the mesh lies.

use std::io::{self, Write};

use glam::DVec3;
use serde_json::json;

use super::export::Surface;

const MAGIC: &[u8; 4] = b"glTF";
const CONTAINER_VERSION: u32 = 2;
const JSON_CHUNK: &[u8; 4] = b"JSON";
const BINARY_CHUNK: &[u8; 4] = b"BIN\0";
/// The header of the file, or of the two chunks: magic, version and length; length and kind, twice.
const HEADERS_BYTES: usize = 12 + 8 + 8;
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34_962;
const ELEMENT_ARRAY_BUFFER: u32 = 34_963;
const VECTOR_BYTES: usize = 3 * 4;

/// Writes `surface` as one GLB file. Its lengths have 32 bits: what does not fit is an error before anything is written.
pub(super) fn write(surface: &Surface, out: &mut impl Write) -> io::Result<()> {
    let middle = middle(&surface.positions);
    let positions: Vec<[f32; 3]> = surface.positions.iter().map(|&p| upright(p - middle)).collect();
    let vectors_bytes = positions.len() * VECTOR_BYTES;
    let binary_bytes = 2 * vectors_bytes + surface.triangles.len() * VECTOR_BYTES;
    let mut document = serde_json::to_vec(&document(surface, &positions, middle))?;
    document.resize(document.len().next_multiple_of(4), b' ');
    let length = |bytes: usize| {
        u32::try_from(bytes).map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, "more than a .glb file can hold"))
    };
    let total = length(HEADERS_BYTES + document.len() + binary_bytes)?;

    out.write_all(MAGIC)?;
    out.write_all(&CONTAINER_VERSION.to_le_bytes())?;
    out.write_all(&total.to_le_bytes())?;
    out.write_all(&length(document.len())?.to_le_bytes())?;
    out.write_all(JSON_CHUNK)?;
    out.write_all(&document)?;
    out.write_all(&length(binary_bytes)?.to_le_bytes())?;
    out.write_all(BINARY_CHUNK)?;
    for vector in positions.iter().copied().chain(surface.normals.iter().map(|&n| upright(n))) {
        for v in vector {
            out.write_all(&v.to_le_bytes())?;
        }
    }
    for n in surface.triangles.iter().flatten() {
        out.write_all(&n.to_le_bytes())?;
    }
    Ok(())
}

/// East, north, up to glTF's east, up, south.
fn upright(v: DVec3) -> [f32; 3] {
    [v.x as f32, v.z as f32, -v.y as f32]
}

fn middle(positions: &[DVec3]) -> DVec3 {
    let bounds = positions.iter().map(|&p| (p, p)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    bounds.map_or(DVec3::ZERO, |(low, high)| (low + high) * 0.5)
}

fn document(surface: &Surface, positions: &[[f32; 3]], middle: DVec3) -> serde_json::Value {
    let vectors_bytes = positions.len() * VECTOR_BYTES;
    let indices = surface.triangles.len() * 3;
    let extreme = |pick: fn(f32, f32) -> f32| {
        let all = positions.iter().copied().reduce(|a, b| std::array::from_fn(|k| pick(a[k], b[k])));
        all.unwrap_or_default()
    };
    let view = |offset: usize, bytes: usize, target: u32| json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes, "target": target });
    json!({
        "asset": { "version": "2.0", "generator": concat!("sightline ", env!("CARGO_PKG_VERSION")) },
        "extras": { "frame": "metres east (x), up (y) and south (z) of the south-west post" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "translation": [middle.x, middle.z, -middle.y] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "NORMAL": 1 }, "indices": 2, "mode": 4 }] }],
        "accessors": [
            {
                "bufferView": 0, "componentType": FLOAT, "type": "VEC3", "count": positions.len(),
                "min": extreme(f32::min), "max": extreme(f32::max),
            },
            { "bufferView": 1, "componentType": FLOAT, "type": "VEC3", "count": positions.len() },
            { "bufferView": 2, "componentType": UNSIGNED_INT, "type": "SCALAR", "count": indices },
        ],
        "bufferViews": [
            view(0, vectors_bytes, ARRAY_BUFFER),
            view(vectors_bytes, vectors_bytes, ARRAY_BUFFER),
            view(2 * vectors_bytes, indices * 4, ELEMENT_ARRAY_BUFFER),
        ],
        "buffers": [{ "byteLength": 2 * vectors_bytes + indices * 4 }],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles far from the origin, in the scene frame.
    fn surface() -> Surface {
        let at = |x, y, z| DVec3::new(500_000.0 + x, 300_000.0 + y, z);
        Surface {
            positions: vec![at(0.0, 0.0, 10.0), at(20.0, 0.0, 30.0), at(20.0, 30.25, 50.0), at(0.0, 30.25, 10.0)],
            normals: vec![DVec3::Z, DVec3::X, DVec3::Y, DVec3::Z],
            triangles: vec![[0, 1, 2], [2, 3, 0]],
        }
    }

    fn word(bytes: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    /// The chunks of a file: its JSON, its binary part. Checks everything that the container's lengths promise.
    fn parse(bytes: &[u8]) -> (serde_json::Value, Vec<u8>) {
        assert_eq!((&bytes[..4], word(bytes, 4), word(bytes, 8) as usize), (&b"glTF"[..], 2, bytes.len()));
        let json_bytes = word(bytes, 12) as usize;
        assert_eq!((&bytes[16..20], json_bytes % 4), (&b"JSON"[..], 0));
        let json = serde_json::from_slice(&bytes[20..20 + json_bytes]).unwrap();
        let rest = &bytes[20 + json_bytes..];
        assert_eq!((word(rest, 0) as usize, &rest[4..8], rest.len() % 4), (rest.len() - 8, &b"BIN\0"[..], 0));
        (json, rest[8..].to_vec())
    }

    /// The 32-bit words of an accessor, by its buffer view.
    fn accessor(json: &serde_json::Value, binary: &[u8], n: usize, components: usize) -> Vec<u32> {
        let number = |v: &serde_json::Value| v.as_u64().unwrap() as usize;
        let accessor = &json["accessors"][n];
        let view = &json["bufferViews"][number(&accessor["bufferView"])];
        let (from, bytes) = (number(&view["byteOffset"]), number(&view["byteLength"]));
        assert_eq!(bytes, number(&accessor["count"]) * components * 4);
        (from..from + bytes).step_by(4).map(|at| word(binary, at)).collect()
    }

    #[test]
    fn a_glb_file_holds_the_surface() {
        let surface = surface();
        let mut bytes = Vec::new();
        write(&surface, &mut bytes).unwrap();
        let (json, binary) = parse(&bytes);
        assert_eq!(json["buffers"][0]["byteLength"], binary.len());
        let vectors = |n| -> Vec<[f64; 3]> {
            let floats: Vec<f64> =
                accessor(&json, &binary, n, 3).into_iter().map(|w| f32::from_bits(w).into()).collect();
            floats.chunks(3).map(|c| [c[0], c[1], c[2]]).collect()
        };
        let (positions, normals) = (vectors(0), vectors(1));
        let translation: [f64; 3] = serde_json::from_value(json["nodes"][0]["translation"].clone()).unwrap();
        let back = |v: [f64; 3]| DVec3::new(v[0], -v[2], v[1]);
        for ((stored, normal), n) in positions.iter().zip(&normals).zip(0..) {
            assert_eq!(back(*stored) + back(translation), surface.positions[n]);
            assert_eq!(back(*normal), surface.normals[n]);
        }
        assert_eq!(accessor(&json, &binary, 2, 1), surface.triangles.concat());
        let least = |k: usize| positions.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
        let greatest = |k: usize| positions.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max);
        assert_eq!(json["accessors"][0]["min"], json!([least(0), least(1), least(2)]));
        assert_eq!(json["accessors"][0]["max"], json!([greatest(0), greatest(1), greatest(2)]));
    }

    #[test]
    fn triangles_of_a_glb_file_face_up() {
        let surface = surface();
        for triangle in &surface.triangles {
            let [a, b, c] = triangle.map(|n| upright(surface.positions[n as usize]).map(f64::from)).map(DVec3::from);
            assert!((b - a).cross(c - a).y > 0.0);
        }
    }
}
