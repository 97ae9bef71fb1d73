use std::collections::BTreeMap;

use sightline_proto::diamond::{Post, RootSquare};
use sightline_proto::mesh::Mesh;

use super::*;

/// A mesh of all posts of a small grid, without padding.
struct All {
    root: RootSquare,
    heights: BTreeMap<Post, f64>,
}

impl Mesh for All {
    fn root(&self) -> RootSquare {
        self.root
    }

    fn grid_size(&self) -> (u32, u32) {
        (self.root.side() + 1, self.root.side() + 1)
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.heights.get(&p).copied()
    }
}

fn surface(height: impl Fn(u32, u32) -> f64) -> Surface {
    let root = RootSquare::new(3).unwrap();
    let posts = (0..=8).flat_map(|j| (0..=8).map(move |i| Post::new(i, j)));
    let heights = posts.map(|p| (p, height(p.i, p.j))).collect();
    Surface::of_mesh(&All { root, heights }, [100.0, 100.0, 1.0])
}

/// A camera 200 m above the south border of the grid, looking north and level.
fn northward() -> Camera {
    let half = 0.5_f64.sqrt();
    Camera {
        eye: [400.0, -10.0, 200.0],
        rotation: [half, 0.0, 0.0, half],
        projection: Projection::Perspective { tan_half_fov: 0.5, near_m: 1.0 },
        width_px: 96,
        height_px: 64,
    }
}

fn brightness(picture: &Picture, x: u32, y: u32) -> u32 {
    picture.pixel(x, y).unwrap().iter().map(|&c| u32::from(c)).sum()
}

#[test]
fn a_mesh_becomes_triangles_that_turn_counter_clockwise_and_cover_the_grid() {
    let surface = surface(|i, j| f64::from(i * j));
    assert_eq!((surface.vertices.len(), surface.triangles.len()), (81, 128));
    let doubled: f64 = surface.triangles.iter().map(|t| surface.face_normal(t, 1.0).z).sum();
    assert!(surface.triangles.iter().all(|t| surface.face_normal(t, 1.0).z > 0.0));
    assert_eq!(doubled, 2.0 * 800.0 * 800.0);
    assert_eq!(surface.height_range_m(), [0.0, 64.0]);
}

#[test]
fn every_sample_of_a_map_is_covered_without_cracks() {
    let surface = surface(|i, j| f64::from((i * 37 + j * 91) % 50));
    let map = draw_map(&surface, None, 97, &[], &Style::default());
    assert_eq!((map.width_px, map.height_px), (97, 97));
    let paper = palette::PAPER.map(|c| (c * 255.0 + 0.5) as u8);
    assert!(map.rgb.chunks(3).all(|p| p != paper), "paper shines through");
}

#[test]
fn the_nearer_ground_hides_the_farther_and_sky_is_above() {
    // A wall along row 2 hides a bright summit along row 6, from a camera that looks level at half its height.
    let camera = northward();
    let wall = surface(|_, j| if j == 2 { 400.0 } else { 0.0 });
    let both = surface(|_, j| f64::from(u32::from(j == 2) * 400 + u32::from(j == 6) * 390));
    let style = Style { height_range_m: Some([0.0, 400.0]), ..Style::default() };
    let [one, two] = [wall, both].map(|s| draw_view(&s, &camera, &[], &style));
    assert_eq!(one.pixel(48, 20), two.pixel(48, 20));
    let open = draw_view(&surface(|_, _| 0.0), &camera, &[], &style);
    let [red, _, blue] = open.pixel(48, 2).unwrap();
    assert!(blue > red, "the sky is blue");
    assert!(brightness(&open, 48, 2) > brightness(&open, 48, 60), "the sky is brighter than the ground");
}

#[test]
fn a_triangle_behind_and_before_the_eye_is_cut_at_the_near_plane() {
    // The eye is above the middle of the grid: the triangle below it reaches behind the eye.
    let flat = surface(|_, _| 0.0);
    let camera = Camera { eye: [410.0, 430.0, 20.0], ..northward() };
    let picture = draw_view(&flat, &camera, &[], &Style::default());
    let sky = draw_view(&Surface::default(), &camera, &[], &Style::default());
    for x in [0, 30, 48, 95] {
        assert_ne!(picture.pixel(x, 63), sky.pixel(x, 63), "ground at the lower border, column {x}");
        assert_eq!(picture.pixel(x, 0), sky.pixel(x, 0), "sky at the upper border, column {x}");
    }
}

#[test]
fn ground_without_data_is_blue_from_above_and_from_its_side() {
    let mut ground = surface(|_, _| 0.0);
    let style = Style { height_range_m: Some([0.0, 100.0]), ..Style::default() };
    let pictures =
        |ground: &Surface| [draw_map(ground, None, 400, &[], &style), draw_view(ground, &northward(), &[], &style)];
    let is_blue = |picture: &Picture, [x, y]: [u32; 2]| {
        let [red, green, blue] = picture.pixel(x, y).unwrap();
        blue > green && green > red
    };
    // Of 9 by 9 posts those of the four columns in the west.
    ground.voids = Voids::new(9, 9, (0..81).map(|n| n % 9 < 4).collect()).map(std::sync::Arc::new);
    for (picture, [west, east]) in pictures(&ground).iter().zip([[[100, 300], [300, 300]], [[5, 60], [90, 60]]]) {
        assert!(is_blue(picture, west) && !is_blue(picture, east));
    }
    ground.voids = None;
    assert!(pictures(&ground).iter().zip([[100, 300], [5, 60]]).all(|(picture, west)| !is_blue(picture, west)));
}

#[test]
fn the_light_comes_from_the_north_west() {
    let slope = |di: i32, dj: i32| surface(move |i, j| f64::from(400 + di * i as i32 * 20 + dj * j as i32 * 20));
    let style = Style { height_range_m: Some([0.0, 1e6]), ..Style::default() };
    let lit = |s: &Surface| brightness(&draw_map(s, None, 32, &[], &style), 16, 16);
    // A slope that rises to the south-east faces the north-west.
    assert!(lit(&slope(1, -1)) > lit(&slope(0, 0)) && lit(&slope(0, 0)) > lit(&slope(-1, 1)));
}

#[test]
fn marks_are_full_in_the_open_and_faint_behind_terrain() {
    let wall = surface(|_, j| if j == 4 { 400.0 } else { 0.0 });
    let camera = northward();
    let line = |y: f64, kind| Mark { a: [300.0, y, 200.0], b: [500.0, y, 200.0], kind };
    let clean = draw_view(&wall, &camera, &[], &Style::default());
    let red_change = |mark: Mark| {
        let drawn = draw_view(&wall, &camera, &[mark], &Style::default());
        let centre = |p: &Picture| i32::from(p.pixel(48, 32).unwrap()[0]);
        centre(&drawn) - centre(&clean)
    };
    let (near, far) = (red_change(line(150.0, MarkKind::Blocked)), red_change(line(700.0, MarkKind::Blocked)));
    assert!(near > 2 * far && far >= 0, "near {near}, far {far}");
    // A mark that passes through the eye's plane is cut, not mirrored.
    let through = Mark { a: [400.0, -500.0, 200.0], b: [400.0, 100.0, 200.0], kind: MarkKind::Visible };
    draw_view(&wall, &camera, &[through], &Style::default());
}

#[test]
fn wires_and_captions_change_the_picture_and_png_keeps_it() {
    let flat = surface(|_, _| 0.0);
    let bare = draw_map(&flat, None, 400, &[], &Style::default());
    let wired = draw_map(&flat, None, 400, &[], &Style { wireframe: true, ..Style::default() });
    assert_ne!(bare, wired);
    let caption = vec!["128 triangles".into(), "epoch 3, hash 0123456789abcdef".into()];
    let printed = draw_map(&flat, None, 400, &[], &Style { caption, ..Style::default() });
    assert_ne!(printed.pixel(8, 8), bare.pixel(8, 8));
    let bytes = printed.png().unwrap();
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
    let mut decoded = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut decoded).unwrap();
    assert_eq!(decoded, printed.rgb);
}

#[test]
fn every_character_of_a_caption_has_a_glyph_of_its_own() {
    let used = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ.,:-+=/%()_#";
    let drawn: std::collections::BTreeSet<_> = used.chars().map(font::glyph).collect();
    assert_eq!(drawn.len(), used.len());
    assert!(!drawn.contains(&font::glyph('~')));
}
