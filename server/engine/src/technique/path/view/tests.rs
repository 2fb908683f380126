//! Where things show in pictures.

use std::sync::Arc;

use super::*;
use crate::{
    math::{sobol::point, warp},
    scene::samples,
};

/// A point shows where the ray through that place of the picture meets it, and covers as much there as its neighbours are
/// apart.
#[test]
fn points_show_where_rays_meet_them() {
    let world = World::prepare(Arc::new(samples::cornell_box().unwrap()));
    let perspective =
        CameraView::look_at(DVec3::new(1.0, 2.0, 5.0), DVec3::new(0.3, 0.2, 0.1), DVec3::Y, 0.8);
    let projection = Projection::Orthographic { half_height_m: 1.5 };
    let orthographic = CameraView { projection, ..perspective };
    for camera in [perspective, orthographic] {
        let view = View::new(&world, &camera, PictureSize::new(64, 36).unwrap());
        for (x, y, t) in [(0.5, 0.5, 3.0), (32.0, 18.0, 0.1), (63.9, 1.3, 400.0), (-70.0, 50.0, 2.0)] {
            let at = |x: f32, y: f32| {
                let ray = view.ray(x, y);
                ray.origin + ray.direction * t
            };
            let [px, py] = view.project(at(x, y)).unwrap();
            assert!((px - x).abs() < 1e-3 && (py - y).abs() < 1e-3, "{px} {py} for {x} {y}");
            let (towards, pixel_m2) = view.pixel_at(at(x, y));
            assert!((towards + view.ray(x, y).direction).length() < 1e-4);
            let (right, down) = (at(x + 0.5, y) - at(x - 0.5, y), at(x, y + 0.5) - at(x, y - 0.5));
            let area = right.cross(down).dot(towards).abs();
            assert!((pixel_m2 / area - 1.0).abs() < 0.01, "{pixel_m2} m² for {area} m²");
        }
    }
    let view = View::new(&world, &perspective, PictureSize::new(64, 36).unwrap());
    let ray = view.ray(10.0, 10.0);
    assert_eq!(view.project(ray.origin - ray.direction), None);
    assert_eq!(view.project(ray.origin), None);
}

/// No point of a sphere shows outside the pixels that are said to show it, wherever the eye is, and these are no more than a box around
/// it would show in.
#[test]
fn spheres_show_in_their_pixels() {
    let world = World::prepare(Arc::new(samples::cornell_box().unwrap()));
    let size = PictureSize::new(64, 36).unwrap();
    let perspective =
        CameraView::look_at(DVec3::new(0.3, 0.2, 0.9), DVec3::new(0.1, 0.2, 0.1), DVec3::Y, 1.1);
    let projection = Projection::Orthographic { half_height_m: 0.5 };
    let (mut shown, mut hidden, mut partly) = (0, 0, 0);
    for camera in [perspective, CameraView { projection, ..perspective }] {
        let view = View::new(&world, &camera, size);
        for number in 0..4_000 {
            let [x, y, z, r] = point(3, number);
            let (centre, radius) = (Vec3::new(x, y, z) * 3.0 - 1.5, 10_f32.powf(-4.0 + 4.0 * r));
            let found = view.pixels_of_sphere(centre, radius);
            let mut is_seen = false;
            for k in 0..32 {
                let [u, v, w, _] = point(4 + u64::from(number), k);
                // Most of them on the sphere itself.
                let inwards = if w < 0.2 { 5.0 * w } else { 1.0 };
                let p = centre + warp::sphere([u, v]) * radius * inwards;
                let Some([px, py]) = view.project(p) else { continue };
                let is_inside = (0.0..64.0).contains(&px) && (0.0..36.0).contains(&py);
                if !is_inside {
                    continue;
                }
                is_seen = true;
                let [[left, top], [right, bottom]] = found.expect("a point of it shows");
                let holds = (left..=right).contains(&(px as u32)) && (top..=bottom).contains(&(py as u32));
                assert!(holds, "{px} {py} outside {left}..={right} {top}..={bottom}");
            }
            match found {
                None => hidden += 1,
                Some([first, last]) if first == [0, 0] && last == [63, 35] => partly += 1,
                Some(_) => shown += 1,
            }
            assert!(!(is_seen && found.is_none()));
        }
    }
    assert!(shown > 1_000 && hidden > 1_000 && partly > 10, "{shown} {hidden} {partly}");
    // It is as wide as it seems, wherever it is and however near.
    for number in 0..300 {
        let [x, y, z, r] = point(5, number);
        let view = View::new(&world, &perspective, size);
        let ahead = view.ray(64.0 * x, 36.0 * y);
        let (away, radius) = (0.1 + z, (0.1 + z) * (0.02 + 0.5 * r));
        let centre = ahead.origin + ahead.direction * away;
        let on_it = |k: u32| {
            let [u, v, ..] = point(1_000 + u64::from(number), k);
            view.project(centre + warp::sphere([u, v]) * radius)
        };
        let seen: Vec<[f32; 2]> = (0..4_000).filter_map(on_it).collect();
        let [[left, top], [right, bottom]] = view.pixels_of_sphere(centre, radius).unwrap();
        for (axis, first, last, count) in [(0, left, right, 64.0), (1, top, bottom, 36.0)] {
            let hull = seen.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[least, most], at| {
                [least.min(at[axis]), most.max(at[axis])]
            });
            let [least, most] = hull.map(|at| at.clamp(0.0, count - 1.0));
            let slack = 2.0 + 0.1 * (most - least);
            assert!((least - first as f32).abs() < slack && (last as f32 - most).abs() < slack, "{hull:?}");
        }
    }
    // Beside the eye, level with it, and outside of what it sees: not in the picture, though some of it lies in front.
    let view = View::new(&world, &perspective, size);
    let side =
        |right: f32, up: f32, back: f32| view.origin + view.right * right + view.up * up + view.back * back;
    for [right, up] in [[3.0, 0.0], [-3.0, 0.0], [0.0, 3.0], [0.0, -3.0]] {
        for back in [-0.1, 0.0, 0.1] {
            assert_eq!(view.pixels_of_sphere(side(right, up, back), 1.0), None, "{right} {up} {back}");
        }
    }
    // From the side it reaches in as far as the line that touches it.
    let [[left, _], [right, _]] = view.pixels_of_sphere(side(3.0, 0.0, 0.1), 2.5).unwrap();
    assert!(left > 32 && right == 63, "{left} {right}");
}
