//! Lines that meet posts, edges, corners and planes exactly, and those that have no length or no room.

use sightline::los::Verdict;

use super::{Asked, Terrain, mix};

#[test]
fn lines_from_post_to_post_and_beside() {
    let asked = Asked::new(&Terrain::rough(5, 4, 3));
    let mut blocked = 0;
    for n in 0..20 * 20_u32 {
        let (p, q) = (n % 20, n / 20);
        let end = |p: u32| [f64::from(p % 5), f64::from(p / 5), (mix(3 ^ u64::from(p % 5 * 1000 + p / 5)) % 4) as f64];
        if p < q {
            blocked += asked.ask_beside(end(p), end(q));
        }
    }
    assert!(blocked > 200, "{blocked}");
}

#[test]
fn lines_along_edges_diagonals_and_the_border() {
    let asked = Asked::new(&Terrain::rough(6, 6, 5));
    for z in [0.0, 1.0, 2.0, 3.0] {
        for (a, b) in [
            ([0.0, 0.0], [5.0, 0.0]),
            ([0.0, 5.0], [5.0, 5.0]),
            ([5.0, -1.0], [5.0, 6.0]),
            ([0.0, 0.0], [5.0, 5.0]),
            ([4.0, 0.0], [0.0, 4.0]),
            ([0.5, 0.5], [3.25, 3.25]),
            ([-1.0, 1.0], [1.0, -1.0]),
            ([1.0, 0.0], [5.0, 4.0]),
            ([2.0, 0.25], [2.0, 4.75]),
        ] {
            asked.ask_beside([a[0], a[1], z], [b[0], b[1], z]);
            asked.ask_beside([a[0], f64::next_up(a[1]), z], [b[0], b[1], 3.0 - z]);
        }
    }
}

#[test]
fn lines_across_a_lake() {
    let asked = Asked::new(&Terrain::new(20, 12, |_, _| Some(7.0)));
    for (a, b) in [([0.0, 0.0], [19.0, 11.0]), ([0.3, 0.7], [18.9, 10.1]), ([3.0, 3.0], [9.0, 9.0])] {
        let at = |[x, y]: [f64; 2], z| [x, y, z];
        assert_eq!(asked.ask(at(a, 7.0), at(b, 7.0)), Verdict::Visible);
        assert_eq!(asked.ask(at(a, 7.0), at(b, f64::next_up(7.0))), Verdict::Visible);
        assert_eq!(asked.ask(at(a, 7.0), at(b, f64::next_down(7.0))), Verdict::Blocked);
        assert_eq!(asked.ask_beside(at(a, 7.0), at(b, 7.0)), 2);
    }
}

#[test]
fn an_end_in_the_plane_of_another_triangle() {
    // Slopes that meet in ridges; ends far off in the plane of one of them.
    let height = |i: u32, j: u32| Some(f64::from(i.abs_diff(4)) * 3.0 - f64::from(j) * 2.0);
    let asked = Asked::new(&Terrain::new(9, 7, height));
    for (x, y) in [(0.5, 0.5), (1.25, 3.5), (2.0, 6.0)] {
        let in_plane = |x: f64, y: f64| [x, y, (4.0 - x) * 3.0 - y * 2.0];
        asked.ask_beside(in_plane(x, y), in_plane(x + 6.0, y));
        asked.ask_beside(in_plane(x, y), in_plane(-x, y + 0.5));
    }
}

#[test]
fn a_void_at_every_place_of_the_triangles() {
    for (nx, ny) in [(2, 2), (3, 3), (2, 3)] {
        for void in 0..nx * ny {
            let height = move |i, j| (j * nx + i != void).then_some(f64::from((i + j) % 3));
            let asked = Asked::new(&Terrain::new(nx, ny, height));
            let ends = [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5], [1.0, 0.25], [0.25, 0.5], [0.75, 0.25]];
            for (n, a) in ends.iter().enumerate() {
                for b in &ends[n..] {
                    for z in [0.0, 1.0, 5.0] {
                        asked.ask([a[0], a[1], z], [b[0], b[1], 1.0]);
                    }
                }
            }
        }
    }
}

#[test]
fn vertical_zero_length_and_one_ulp_lines() {
    let asked = Asked::new(&Terrain::rough(4, 4, 9));
    for (x, y) in [(0.0, 0.0), (1.0, 2.0), (1.5, 1.5), (2.0, 0.5), (0.3, 0.9), (3.0, 3.0), (-0.5, 1.0)] {
        for z in [-1.0, 0.0, 1.0, 1.5, 2.0, 3.0, 9.0] {
            asked.ask([x, y, z], [x, y, z]);
            asked.ask([x, y, z], [x, y, 9.0]);
            asked.ask([x, y, z], [x.next_up(), y, z]);
            asked.ask([x, y, z], [x.next_down(), y.next_up(), z.next_down()]);
        }
    }
}

#[test]
fn lines_in_a_plane() {
    // Whole slopes: the ground is one plane, and so are all its lines.
    let plane = |x: f64, y: f64| 2.0 * x - 3.0 * y + 1.0;
    let asked = Asked::new(&Terrain::new(9, 7, move |i, j| Some(plane(f64::from(i), f64::from(j)))));
    for (a, b) in
        [([0.0, 0.0], [8.0, 6.0]), ([0.5, 0.25], [7.75, 5.5]), ([1.0, 3.0], [7.0, 3.0]), ([2.5, 0.5], [6.5, 4.5])]
    {
        let on = |[x, y]: [f64; 2]| [x, y, plane(x, y)];
        let answer = asked.answer(on(a), on(b));
        assert_eq!((answer.verdict, answer.grazes), (Verdict::Visible, true));
        assert_eq!(asked.ask_beside(on(a), on(b)), 2);
    }
}

#[test]
fn several_grazes_on_one_line() {
    // Summits of every third column reach a slope of one half, and no further.
    let slope = |x: f64| 0.5 * x + 2.0;
    let height = move |i: u32, _: u32| Some(if i % 3 == 1 { slope(f64::from(i)) } else { 0.0 });
    let asked = Asked::new(&Terrain::new(13, 9, height));
    for (ay, by) in [(2.0, 2.0), (0.0, 8.0), (0.25, 7.125), (4.0, 4.0_f64.next_up())] {
        let (a, b) = ([0.0, ay, slope(0.0)], [12.0, by, slope(12.0)]);
        let answer = asked.answer(a, b);
        assert_eq!((answer.verdict, answer.grazes), (Verdict::Visible, true));
        assert_eq!(asked.ask_beside(a, b), 2);
        assert_eq!(asked.ask(a, [12.0, by, slope(12.0).next_down()]), Verdict::Blocked);
    }
}

#[test]
fn walks_that_meet_a_corner_in_x_and_y_at_once() {
    let asked = Asked::new(&Terrain::rough(9, 9, 21));
    for (dx, dy) in [(1.0, 1.0), (2.0, 1.0), (1.0, 3.0), (3.0, 2.0), (4.0, 3.0)] {
        for start in [[0.0, 0.0], [0.5, 0.5], [1.0, 0.0], [2.0, 1.0]] {
            for z in [1.0, 2.0, 2.5, 3.0] {
                // Through posts all the way, to a post or short of one; and a unit in the last place beside.
                for length in [2.0, 1.5, 1.0] {
                    let end = [start[0] + length * dx, start[1] + length * dy];
                    asked.ask([start[0], start[1], z], [end[0], end[1], 3.0]);
                    asked.ask([start[0], start[1], z], [end[0].next_up(), end[1], z]);
                    asked.ask([start[0].next_up(), start[1], z], [end[0], end[1].next_down(), z]);
                }
            }
        }
    }
}

#[test]
fn both_ends_in_one_triangle_above_on_and_below_it() {
    let height = |i: u32, j: u32| Some(f64::from(2 * i + 5 * j));
    let asked = Asked::new(&Terrain::new(4, 4, height));
    let ground = |[x, y]: [f64; 2]| 2.0 * x + 5.0 * y;
    let inside = [[1.25, 1.5], [1.125, 1.75], [1.25, 1.25], [1.0, 1.5], [1.5, 2.0], [1.0, 1.0], [1.0, 2.0]];
    for (n, a) in inside.into_iter().enumerate() {
        for &b in &inside[n..] {
            for (up_a, up_b) in [(1.0, 1.0), (0.0, 1.0), (0.0, 0.0), (-1.0, 1.0), (-1.0, -1.0), (0.0, -0.5)] {
                let verdict = asked.ask([a[0], a[1], ground(a) + up_a], [b[0], b[1], ground(b) + up_b]);
                assert_eq!(verdict == Verdict::Blocked, up_a < 0.0 || up_b < 0.0, "{a:?} {b:?} {up_a} {up_b}");
            }
        }
    }
}

#[test]
fn ends_in_different_pits_see_each_other_over_the_rim_only() {
    let height = |i: u32, j: u32| Some(if matches!((i, j), (2, 3) | (6, 3)) { -5.0 } else { 1.0 });
    let asked = Asked::new(&Terrain::new(9, 7, height));
    for z in [-5.0, -1.0, 0.0, 1.0_f64.next_down()] {
        assert_eq!(asked.ask([2.0, 3.0, z], [6.0, 3.0, z]), Verdict::Blocked);
        assert_eq!(asked.ask([2.0, 3.0, z], [6.0, 3.0, 8.0]) == Verdict::Blocked, z < -1.0, "{z}");
    }
    assert_eq!(asked.ask([2.0, 3.0, 1.0], [6.0, 3.0, 1.0]), Verdict::Visible);
    assert_eq!(asked.ask([2.0, 3.0, -5.0], [2.0, 3.0, 1e300]), Verdict::Visible);
}

#[test]
fn ends_on_below_and_outside_the_terrain() {
    let asked = Asked::new(&Terrain::rough(5, 5, 33));
    let places = [
        [2.0, 2.0],
        [1.5, 3.0],
        [0.25, 0.5],
        [0.0, 4.0],
        [-0.5, 2.0],
        [-3.0, -3.0],
        [2.0, 4.0_f64.next_up()],
        [9.0, 1.0],
    ];
    for a in places {
        for b in places {
            for (az, bz) in [(3.0, 3.0), (1.0, 5.0), (-1.0, 9.0), (0.0, 0.0)] {
                let verdict = asked.ask([a[0], a[1], az], [b[0], b[1], bz]);
                let is_outside = |[x, y]: [f64; 2]| !(0.0..=4.0).contains(&x) || !(0.0..=4.0).contains(&y);
                assert!(verdict != Verdict::Visible || !is_outside(a) && !is_outside(b), "{a:?} {b:?}");
            }
        }
    }
}
