//! Areas within gathers against triangles one by one, counted points and closed forms.

use super::*;
use crate::{math::sobol::point, technique::products::walls::Walls};

/// A crumpled sheet of 2 × 2 m, in strips of triangles of very different sizes.
fn crumpled() -> Vec<[Vec3; 3]> {
    let height = |x: f32, z: f32| 0.2 * (5.0 * x).sin() * (3.0 * z).cos();
    let at = |i: usize, n: usize| (i as f32 / n as f32).powi(2) * 2.0 - 1.0;
    let vertex = |i: usize, j: usize| {
        let (x, z) = (at(i, 40), at(j, 25));
        Vec3::new(x, height(x, z), z)
    };
    let quads = (0..40).flat_map(|i| (0..25).map(move |j| (i, j)));
    quads
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [vertex(i, j), vertex(i, j + 1), vertex(i + 1, j + 1), vertex(i + 1, j)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

fn extent_of(triangles: &[[Vec3; 3]]) -> Extent {
    let all: Vec<u32> = (0..triangles.len() as u32).collect();
    Extent::of(&all, |triangle| triangles[triangle as usize], 1.0)
}

/// A unit vector that leans from the upright, at most by 45°.
fn leaning(by: f32, turn: f32) -> Vec3 {
    Vec3::new((6.0 * turn).sin() * by, 1.0, (6.0 * turn).cos() * by).normalize()
}

/// The tree says what going through the triangles one by one says, and that is the share of points that lie within.
#[test]
fn areas_are_those_of_all_triangles_and_of_counted_points() {
    let sheet = crumpled();
    let (corners, extent) = (|triangle: u32| sheet[triangle as usize], extent_of(&sheet));
    for index in 0..200 {
        let [x, z, r, turn] = point(3, index);
        let centre = Vec3::new(2.0 * x - 1.0, 0.1, 2.0 * z - 1.0);
        let normal = leaning(r, turn);
        let radius_m = 0.02 + 1.5 * r * r;
        let facing_cos = if index % 3 == 0 { -2.0 } else { 0.5 + 0.4 * turn };
        let bounds = GatherBounds::at(centre, normal);
        let reach = Reach { radius_m, facing_cos };
        let found = extent.within(&bounds, reach, corners).area_m2;
        let exactly = |face: &Face| {
            let cos = face.normal.dot(normal);
            let area_m2 = || face.area_within(&bounds, radius_m, cos, false, &corners);
            if cos >= facing_cos { area_m2() } else { 0.0 }
        };
        let one_by_one: f32 = extent.faces.iter().map(exactly).sum();
        // Small pieces at the rim may be whole nodes or single triangles.
        assert!(
            (found - one_by_one).abs() <= 0.02 * one_by_one + 2e-3 * radius_m * radius_m,
            "{found} for {one_by_one}"
        );
        if index % 10 == 0 && one_by_one > 0.05 {
            let counted = counted_m2(&extent, &bounds, radius_m, facing_cos, corners);
            assert!((found / counted - 1.0).abs() < 0.03, "{found} for {counted}");
        }
    }
}

/// Of a sheet that lies wholly within reach counts what faces the gather, exactly, with its directions.
#[test]
fn what_lies_wholly_within_counts_as_far_as_it_faces() {
    let sheet = crumpled();
    let (corners, extent) = (|triangle: u32| sheet[triangle as usize], extent_of(&sheet));
    for index in 0..50 {
        let [x, z, lean, turn] = point(5, index);
        let normal = leaning(lean, turn);
        for facing_cos in [-2.0, 0.5, 0.79, 0.9] {
            let reach = Reach { radius_m: 12.0, facing_cos };
            let found = extent.within(&GatherBounds::at(Vec3::new(x, 0.0, z), normal), reach, corners);
            let facing = extent.faces.iter().filter(|face| face.normal.dot(normal) >= facing_cos);
            let expected: Facets = facing.map(|face| face.facets(face.area_m2)).sum();
            assert!((found.area_m2 - expected.area_m2).abs() < 1e-4, "{found:?} for {expected:?}");
            for (found, expected) in [
                (found.facing_m2, expected.facing_m2),
                (found.squares_m2, expected.squares_m2),
                (found.products_m2, expected.products_m2),
            ] {
                assert!((found - expected).abs().max_element() < 1e-4, "{found} for {expected}");
            }
        }
    }
}

/// Before walls lies the share of points that lie there.
#[test]
fn walls_part_areas() {
    let sheet = crumpled();
    let (corners, extent) = (|triangle: u32| sheet[triangle as usize], extent_of(&sheet));
    let mut parted = 0;
    for index in 0..100 {
        let [x, z, angle, far] = point(4, index);
        let without = GatherBounds::at(Vec3::new(x - 0.5, 0.0, z - 0.5), Vec3::Y);
        let (sin, cos) = (std::f32::consts::TAU * angle).sin_cos();
        let [first, second] = [Vec3::new(cos, 0.0, sin), Vec3::new(-sin, 0.0, cos)];
        let walls = Walls::at([(first, 0.6 * far * far), (second, 0.4 + far)]);
        let bounds = GatherBounds { walls, ..without };
        let reach = Reach { radius_m: 0.3 + far, facing_cos: -2.0 };
        let before_m2 = extent.within(&bounds, reach, corners).area_m2;
        let all_m2 = extent.within(&without, reach, corners).area_m2;
        let counted = counted_m2(&extent, &bounds, reach.radius_m, reach.facing_cos, corners);
        assert!((before_m2 - counted).abs() <= 0.03 * all_m2, "{before_m2} for {counted} of {all_m2}");
        parted += u32::from(before_m2 < 0.9 * all_m2);
    }
    assert!(parted > 30, "{parted}");
}

fn counted_m2(
    extent: &Extent,
    bounds: &GatherBounds,
    radius_m: f32,
    facing_cos: f32,
    corners: impl Fn(u32) -> [Vec3; 3],
) -> f32 {
    let of_face = |face: &Face| {
        let [a, b, c] = corners(face.triangle);
        let is_within = |index: &u32| {
            let [u, v, ..] = point(u64::from(face.triangle), *index);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let from = a + (b - a) * u + (c - a) * v - bounds.centre;
            let along = bounds.normal.dot(from);
            let across = from - bounds.normal * along;
            let is_before = bounds.walls.behind_m(from) <= 0.0;
            is_before && across.length_squared() + (along * FLATNESS).powi(2) <= radius_m * radius_m
        };
        let share = (0..64).filter(is_within).count() as f32 / 64.0;
        if face.normal.dot(bounds.normal) >= facing_cos { face.area_m2 * share } else { 0.0 }
    };
    extent.faces.iter().map(of_face).sum()
}

/// The mean cosine is that of the parts, one by one: of a plane, caps of balls, arcs of columns, edges, whole balls and sheets.
#[test]
fn mean_cosines_are_those_of_the_parts() {
    let cap = |angle: f32| -> Vec<Vec3> {
        let normal = |index: u32| {
            let [u, v, ..] = point(7, index);
            let (sin, cos) = (std::f32::consts::TAU * u).sin_cos();
            // Evenly over a cap: the height is.
            let y = 1.0 - v * (1.0 - angle.cos());
            let across = (1.0 - y * y).max(0.0).sqrt();
            Vec3::new(across * cos, y, across * sin)
        };
        (0..1024).map(normal).collect()
    };
    let arc = |angle: f32| -> Vec<Vec3> {
        let turns = (0..1024).map(|index| angle * ((2 * index + 1) as f32 / 1024.0 - 1.0));
        turns.map(|turn| Vec3::new(turn.sin(), turn.cos(), 0.0)).collect()
    };
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let edge = vec![Vec3::new(half, half, 0.0), Vec3::new(-half, half, 0.0)];
    let pieces = [
        (cap(0.0), 1e-3),
        (cap(0.3), 0.01),
        (cap(0.7), 0.02),
        (cap(1.0), 0.03),
        (cap(std::f32::consts::PI), 0.01),
        (arc(0.66), 0.03),
        (arc(1.05), 0.04),
        (edge, 0.05),
        (vec![Vec3::Y, -Vec3::Y], 0.2),
    ];
    for (piece, (normals, tolerance)) in pieces.into_iter().enumerate() {
        let facets: Facets = normals.iter().map(|normal| Facets::flat(2.0, *normal)).sum();
        for index in 0..500 {
            let [u, v, ..] = point(8, index);
            let (sin, cos) = (std::f32::consts::TAU * u).sin_cos();
            let y = 2.0 * v - 1.0;
            let across = (1.0 - y * y).sqrt();
            let wi = Vec3::new(across * cos, y, across * sin);
            let count = normals.len() as f32;
            let mean = normals.iter().map(|normal| normal.dot(wi).max(0.0)).sum::<f32>() / count;
            let found = facets.mean_cos(wi);
            assert!((found - mean).abs() < tolerance, "{piece}, {wi}: {found}, not {mean}");
        }
    }
}

/// A surface far smaller than the gather is cut at its rim like a large one: its photons are counted one by one.
#[test]
fn small_surfaces_at_the_rim_are_cut() {
    let at = |angle: f32| Vec3::new(angle.cos(), 0.0, -angle.sin());
    let third = std::f32::consts::TAU / 3.0;
    let sheet = [[at(0.0), at(third), at(2.0 * third)]];
    let corners = |triangle: u32| sheet[triangle as usize];
    let extent = Extent::of(&[0], corners, 1.0);
    for inside_m in [-0.9, -0.5, 0.0, 0.3] {
        let bounds = GatherBounds::at(Vec3::new(-40.0 + inside_m, 0.0, 0.0), Vec3::Y);
        let found = extent.within(&bounds, Reach { radius_m: 40.0, facing_cos: 0.5 }, corners).area_m2;
        // The rim is next to straight: what lies left of x = inside_m.
        let right: f32 = (1.0 - inside_m).powi(2) / 3f32.sqrt();
        let left = if inside_m <= -0.5 { 0.0 } else { 0.75 * 3f32.sqrt() - right };
        assert!((found - left).abs() < 0.02, "{inside_m}: {found} for {left}");
    }
}

/// Triangles without area, and none at all, have none.
#[test]
fn nothing_has_no_area() {
    let corners = |_| [Vec3::ONE; 3];
    for triangles in [&[][..], &[0, 1, 2, 3, 4, 5][..]] {
        let extent = Extent::of(triangles, corners, 1.0);
        let reach = Reach { radius_m: 3.0, facing_cos: -2.0 };
        assert_eq!(extent.within(&GatherBounds::at(Vec3::ZERO, Vec3::Y), reach, corners), Facets::default());
        assert_eq!(extent.area_m2(), 0.0);
    }
}
