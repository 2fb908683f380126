//! Pictures whose every pixel is known beforehand: cameras, textures, masks, normals, glass, bounces.

use std::sync::{Arc, atomic::AtomicBool};

use glam::{Affine2, DAffine3, DMat3, DQuat, DVec3, Vec2, Vec3, Vec4};

use crate::{
    film::{Film, PictureSize},
    math::Rgb,
    render::{RenderSettings, Rendering},
    scene::{
        CameraView, Filter, Id, Light, LightKind, Material, MeshSource, Projection, Scene, Texels, Texture,
        TextureRef, TextureSlot,
        samples::{self, Stage, quad},
    },
    transport::{PathClass, World},
};

pub(super) fn id(name: &str) -> Id {
    Id::new(name).unwrap()
}

/// Down −Z from z = 5, parallel, 2 metres high: pixel (x, y) of n sees the square from −1 to 1 at that place.
pub(super) fn straight_on() -> CameraView {
    CameraView {
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, 5.0)),
        projection: Projection::Orthographic { half_height_m: 1.0 },
    }
}

fn render(scene: Scene, view: CameraView, side: u32, passes: u32, bounces_max: Option<u32>) -> Film {
    let world = Arc::new(World::prepare(Arc::new(scene)));
    let settings = RenderSettings { bounces_max, seed: 1, ..RenderSettings::default() };
    let mut rendering = Rendering::new(world, view, PictureSize::new(side, side).unwrap(), settings);
    for _ in 0..passes {
        rendering.step(&AtomicBool::new(false));
    }
    assert_eq!(rendering.film().dropped_samples(), 0);
    rendering.film().clone()
}

/// Corners of the square from −1 to 1 that faces +Z.
pub(super) const SQUARE: [DVec3; 4] = [
    DVec3::new(-1.0, -1.0, 0.0),
    DVec3::new(1.0, -1.0, 0.0),
    DVec3::new(1.0, 1.0, 0.0),
    DVec3::new(-1.0, 1.0, 0.0),
];

/// The square with glTF's texture coordinates: v = 0 at its top.
pub(super) fn square(material: &Id) -> MeshSource {
    let texcoords = vec![Vec2::new(0.0, 1.0), Vec2::ONE, Vec2::new(1.0, 0.0), Vec2::ZERO];
    MeshSource { texcoords: [texcoords, Vec::new()], ..quad(SQUARE, material) }
}

/// A sun along −Z whose light, π W/m², gives a facing surface the radiance of its albedo.
pub(super) fn sun() -> Light {
    let irradiance = Rgb::splat(std::f32::consts::PI);
    let kind = LightKind::Directional { irradiance };
    Light { parent: None, position: DVec3::ZERO, direction: DVec3::NEG_Z, kind }
}

fn assert_colour(got: Rgb, expected: Rgb, what: &str) {
    let off = (got - expected).map(f32::abs).max_component();
    assert!(off <= 2e-5 * expected.max_component() + 1e-7, "{what}: {got:?} for {expected:?}");
}

pub(super) fn picture(width: u32, height: u32, texels: &[[u8; 4]]) -> Texture {
    Texture { width, height, texels: Texels::Rgba8(texels.to_vec()) }
}

/// A parallel camera's picture ends where its magnification says, upright and not mirrored; and a node's texture lies
/// on it as glTF has it: first texel at u = 0, v = 0, rows downwards.
#[test]
fn textures_lie_upright_in_the_pictures_of_parallel_cameras() {
    let [red, green, blue, white] =
        [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 255]];
    let mut stage = Stage::default();
    stage.builder().add_texture(id("corners"), picture(2, 2, &[red, green, blue, white])).unwrap();
    let mut material = Material::lambert(Rgb::new(0.8, 0.6, 0.4));
    let reference = TextureRef { filter: Filter::Nearest, ..TextureRef::new(id("corners")) };
    material.textures[TextureSlot::BaseColor as usize] = Some(reference);
    let material = stage.material("painted", material).unwrap();
    stage.place("square", square(&material), DAffine3::IDENTITY).unwrap();
    stage.light("sun", sun()).unwrap();
    let image = render(stage.finish(), straight_on(), 4, 4, Some(1)).radiance();
    let expected = [
        (0, Rgb::new(0.8, 0.0, 0.0)),
        (3, Rgb::new(0.0, 0.6, 0.0)),
        (12, Rgb::new(0.0, 0.0, 0.4)),
        (15, Rgb::new(0.8, 0.6, 0.4)),
        (5, Rgb::new(0.8, 0.0, 0.0)),
        (10, Rgb::new(0.8, 0.6, 0.4)),
    ];
    for (pixel, colour) in expected {
        assert_colour(image[pixel], colour, &format!("pixel {pixel}"));
    }
}

/// A pinhole camera shows a point where similar triangles say, on wide and on high pictures: the height is the angle's.
#[test]
fn pinhole_cameras_show_points_where_similar_triangles_say() {
    let yfov_rad = 1.1f64;
    for (width, height) in [(64u32, 32u32), (24, 48)] {
        for target in [DVec3::new(0.3, 0.2, -2.0), DVec3::new(-0.5, -0.4, -3.0), DVec3::new(-0.4, 0.6, -2.5)]
        {
            let mut stage = Stage::default();
            let lamp = stage.material("lamp", Material::emitter(Rgb::WHITE)).unwrap();
            let spot = quad(SQUARE.map(|corner| corner * 0.02 + target), &lamp);
            let world_from_camera = DAffine3::from_rotation_translation(
                DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 2.0),
                DVec3::new(3.0, -1.0, 2.0),
            );
            stage.place("spot", spot, world_from_camera).unwrap();
            let world = Arc::new(World::prepare(Arc::new(stage.finish())));
            let view = CameraView { world_from_camera, projection: Projection::Perspective { yfov_rad } };
            let size = PictureSize::new(width, height).unwrap();
            let mut rendering = Rendering::new(world, view, size, RenderSettings::default());
            for _ in 0..16 {
                rendering.step(&AtomicBool::new(false));
            }
            let image = rendering.film().radiance();
            let brightest = (0..image.len()).max_by(|a, b| image[*a].g.total_cmp(&image[*b].g)).unwrap();
            let focal = f64::from(height) / 2.0 / (yfov_rad / 2.0).tan();
            let x = f64::from(width) / 2.0 + focal * target.x / -target.z;
            let y = f64::from(height) / 2.0 - focal * target.y / -target.z;
            let got = (brightest % width as usize, brightest / width as usize);
            // The marker is up to two pixels wide.
            assert!(
                (got.0 as f64 + 0.5 - x).abs() < 1.6 && (got.1 as f64 + 0.5 - y).abs() < 1.6,
                "{got:?} {x} {y}"
            );
            let depth = f64::from(rendering.film().depth()[brightest]);
            assert!((depth / -target.z - 1.0).abs() < 1e-5, "depth {depth} of {target}");
        }
    }
}

/// Vertex colours are interpolated and tint the base colour; unlit surfaces show it as it is, seen directly and in
/// mirrors, and light nothing.
#[test]
fn vertex_colours_tint_and_unlit_surfaces_show_their_colour_only() {
    let colours = vec![
        Vec4::new(0.0, 0.5, 1.0, 1.0),
        Vec4::new(1.0, 0.5, 1.0, 1.0),
        Vec4::new(1.0, 0.5, 1.0, 1.0),
        Vec4::new(0.0, 0.5, 1.0, 1.0),
    ];
    for unlit in [false, true] {
        let mut stage = Stage::default();
        let material = Material { unlit, ..Material::lambert(Rgb::new(0.9, 0.8, 0.2)) };
        let material = stage.material("tinted", material).unwrap();
        stage
            .place("square", MeshSource { colors: colours.clone(), ..square(&material) }, DAffine3::IDENTITY)
            .unwrap();
        // A wall at its right edge, which light scattered by the square would show.
        let wall = stage.material("wall", Material::lambert(Rgb::WHITE)).unwrap();
        let turned = DAffine3::from_rotation_y(-std::f64::consts::FRAC_PI_2);
        let beside = DAffine3::from_translation(DVec3::new(1.0, 0.0, 1.0)) * turned;
        stage.place("wall", square(&wall), beside).unwrap();
        if !unlit {
            stage.light("sun", sun()).unwrap();
        }
        let scene = stage.finish();
        // The pixel's jitter averages to its middle; the colour is linear in x. 256 stratified samples.
        let film = render(scene.clone(), straight_on(), 4, 512, Some(1));
        for (pixel, u) in [(4, 0.125f32), (5, 0.375), (6, 0.625), (7, 0.875)] {
            let got = film.radiance()[pixel];
            let expected = Rgb::new(0.9 * u, 0.4, 0.2);
            let off = (got - expected).map(f32::abs).max_component();
            assert!(off < 1e-3, "unlit {unlit} pixel {pixel}: {got:?} for {expected:?}");
        }
        let to_wall =
            CameraView::look_at(DVec3::new(-1.0, 0.0, 1.5), DVec3::new(1.0, 0.0, 1.0), DVec3::Y, 0.2);
        let wall_light = render(scene, to_wall, 4, 16, None);
        let lit = wall_light.radiance().iter().map(|rgb| rgb.b).sum::<f32>();
        assert_eq!(lit > 0.0, !unlit, "what the square sends to the wall: {lit}");
    }
}

/// Masks let light and sight through exactly where alpha is below the cutoff: texture, factor and vertex colour alike.
#[test]
fn masks_let_sight_and_light_through_where_alpha_is_low() {
    let mut stage = Stage::default();
    // Alpha 200 on the left, 100 on the right; the factor and the vertex colour bring them to 0.49 and 0.25.
    stage
        .builder()
        .add_texture(id("mask"), picture(2, 1, &[[255, 255, 255, 200], [255, 255, 255, 100]]))
        .unwrap();
    let mut material =
        Material { alpha: 0.9, alpha_cutoff: Some(0.4), ..Material::lambert(Rgb::splat(0.25)) };
    let reference = TextureRef { filter: Filter::Nearest, ..TextureRef::new(id("mask")) };
    material.textures[TextureSlot::BaseColor as usize] = Some(reference);
    let mask = stage.material("mask", material).unwrap();
    let colors = vec![Vec4::new(1.0, 1.0, 1.0, 0.7); 4];
    stage
        .place("mask", MeshSource { colors, ..square(&mask) }, DAffine3::from_translation(DVec3::Z))
        .unwrap();
    let wall = stage.material("wall", Material::lambert(Rgb::splat(0.75))).unwrap();
    stage.place("wall", square(&wall), DAffine3::IDENTITY).unwrap();
    stage.light("sun", sun()).unwrap();
    let scene = stage.finish();
    let image = render(scene.clone(), straight_on(), 4, 4, Some(1)).radiance();
    assert_colour(image[4], Rgb::splat(0.25), "the mask");
    assert_colour(image[7], Rgb::splat(0.75), "the wall through the hole");
    // From between the two the wall shows the mask's shadow on the left and the sun on the right.
    let between = CameraView {
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, 0.5)),
        ..straight_on()
    };
    let image = render(scene, between, 4, 4, Some(1)).radiance();
    assert_colour(image[4], Rgb::BLACK, "the wall in the mask's shadow");
    assert_colour(image[7], Rgb::splat(0.75), "the wall in the sun");
}

/// A normal map's red leans the normal towards growing u, its green towards the top of the picture; with tangents
/// given or found, on turned, stretched and mirrored nodes.
#[test]
fn normal_maps_lean_normals_along_the_picture() {
    // A texel of a normal leaned 30° towards +u and up: (sin 30° / √2, the same, cos 30°), as bytes.
    let bytes = [218u8, 218, 238, 255].map(|b| b);
    let leaned =
        Vec3::new(f32::from(bytes[0]), f32::from(bytes[1]), f32::from(bytes[2])) / 255.0 * 2.0 - Vec3::ONE;
    let leaned = leaned.normalize();
    for with_tangents in [false, true] {
        for (name, world_from_square) in [
            ("plain", DMat3::IDENTITY),
            ("turned", DMat3::from_rotation_z(0.8)),
            ("stretched", DMat3::from_diagonal(DVec3::new(2.0, 3.0, 1.0))),
            ("mirrored in x", DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))),
            (
                "mirrored in y, turned",
                DMat3::from_rotation_z(0.3) * DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0)),
            ),
            ("seen from behind", DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0))),
        ] {
            let mut stage = Stage::default();
            stage.builder().add_texture(id("normals"), picture(1, 1, &[bytes])).unwrap();
            let mut material = Material::lambert(Rgb::WHITE);
            material.textures[TextureSlot::Normal as usize] = Some(TextureRef::new(id("normals")));
            let material = stage.material("bumpy", material).unwrap();
            let mut mesh = square(&material);
            if with_tangents {
                mesh.normals = vec![Vec3::Z; 4];
                mesh.tangents = vec![Vec4::new(1.0, 0.0, 0.0, 1.0); 4];
            }
            stage.place("square", mesh, DAffine3::from_mat3(world_from_square)).unwrap();
            let film = render(stage.finish(), straight_on(), 2, 2, Some(1));
            // Directions on the square go with the node: u along its x, up along its y.
            let along = |v: DVec3| (world_from_square * v).normalize().as_vec3();
            let outward = along(DVec3::Z);
            let expected = along(DVec3::X) * leaned.x + along(DVec3::Y) * leaned.y + outward * leaned.z;
            // Reflection is two-sided: from behind the normal turns to the viewer.
            let expected = if expected.z < 0.0 { -expected } else { expected };
            let got = film.normal()[0];
            assert!(got.distance(expected) < 1e-4, "{name}, tangents {with_tangents}: {got} for {expected}");
        }
    }
}

/// `--bounces n` is the sum of the first n scatterings: in a closed furnace E Σ ρᵏ up to k = n.
#[test]
fn bounces_of_a_furnace_add_up_one_by_one() {
    for bounces in 0..4u32 {
        let scene = samples::furnace(0.6, 0.5).unwrap();
        let view = scene.camera_view(None).unwrap();
        let film = render(scene, view, 24, 64, Some(bounces));
        let expected: f32 = (0..=bounces).map(|k| 0.5 * 0.6f32.powi(k as i32)).sum();
        let mut statistics = crate::math::RunningStatistics::default();
        film.radiance().iter().for_each(|rgb| statistics.add(f64::from(rgb.mean())));
        let off = (statistics.mean() - f64::from(expected)).abs();
        assert!(
            off < 5.0 * statistics.standard_error() + 1e-5,
            "{bounces} bounces: {} for {expected}",
            statistics.mean()
        );
    }
}

/// A block of coloured glass of the given index, 1 m deep, seen from +Z; a lamp of radiance 2 as far behind its front
/// as `lamp_z` says: the front is at z = 0, the back at z = −1.
fn lamp_and_glass(ior: f32, lamp_z: f64) -> Film {
    let mut stage = Stage::default();
    let glass = Material {
        transmission: 1.0,
        roughness: 0.0,
        ior,
        attenuation_color: Rgb::new(0.9, 0.5, 0.1),
        attenuation_distance_m: 0.5,
        ..Material::default()
    };
    let glass = stage.material("glass", glass).unwrap();
    let block = samples::cuboid(DVec3::new(-3.0, -3.0, -1.0), DVec3::new(3.0, 3.0, 0.0), &glass);
    stage.place("block", block, DAffine3::IDENTITY).unwrap();
    let lamp = stage.material("lamp", Material::emitter(Rgb::splat(2.0))).unwrap();
    stage.place("lamp", square(&lamp), DAffine3::from_translation(DVec3::Z * lamp_z)).unwrap();
    render(stage.finish(), straight_on(), 2, 4096, None)
}

/// Light loses colour^(d / distance) over d metres in glass, whether the lamp stands behind the block or inside it.
#[test]
fn coloured_glass_takes_its_share_of_every_metre() {
    let left = |d: f32| Rgb::new(0.9, 0.5, 0.1).map(|c| c.powf(d / 0.5));
    let behind = lamp_and_glass(1.0, -1.5).radiance()[0];
    assert_colour(behind, left(1.0) * 2.0, "a lamp behind the block");
    let inside = lamp_and_glass(1.0, -0.25).radiance()[0];
    assert_colour(inside, left(0.25) * 2.0, "a lamp inside the block");
}

/// Radiance is scaled by 1/η² on its way out of glass: a lamp inside shows 2 (1 − F) / η² times what the glass leaves.
#[test]
fn radiance_thins_out_where_it_leaves_glass() {
    let ior = 1.5f32;
    let fresnel = ((ior - 1.0) / (ior + 1.0)).powi(2);
    let got = lamp_and_glass(ior, -0.25).radiance()[0];
    let expected = Rgb::new(0.9, 0.5, 0.1).map(|c| 2.0 * (1.0 - fresnel) / (ior * ior) * c.powf(0.5));
    // 16,384 samples choose between reflection (4 %) and passing: 5 standard errors of that choice are 0.8 %; the
    // Owen-scrambled points are far better than that, which the test does not need.
    let off = (got - expected).map(f32::abs);
    assert!(off.r < 0.01 * expected.r && off.g < 0.01 * expected.g, "{got:?} for {expected:?}");
}

/// A camera that stands on a surface to the last bit, or a hair off it, loses no sample.
#[test]
fn cameras_on_surfaces_lose_no_sample() {
    let mut stage = Stage::default();
    let wall = stage.material("wall", Material::lambert(Rgb::splat(0.5))).unwrap();
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    let placed = DAffine3::from_rotation_translation(turn, DVec3::new(0.3, -0.2, 0.7));
    stage.place("wall", square(&wall), placed).unwrap();
    stage.light("sun", sun()).unwrap();
    let scene = stage.finish();
    for i in 0..60 {
        let (x, y) = (f64::from(i % 8) * 0.21 - 0.8, f64::from(i / 8) * 0.19 - 0.7);
        let position = placed.transform_point3(DVec3::new(x, y, f64::from(i % 3 - 1) * 1e-9));
        let along = placed.transform_vector3(DVec3::new(0.6, 0.8, 0.0));
        let view = CameraView::look_at(position, position + along, placed.transform_vector3(DVec3::Z), 2.5);
        // `render` asserts that nothing was dropped.
        render(scene.clone(), view, 16, 2, None);
    }
}

/// A one-sided lamp, a bumpy floor with a picture, a glossy block: everything that a mirror could turn wrong.
pub(super) fn asymmetric_room(
    mirror: impl Fn(MeshSource) -> MeshSource,
    placed: DAffine3,
    seen_from: DVec3,
) -> (Scene, CameraView) {
    let mut stage = Stage::default();
    let texels: Vec<[u8; 4]> = (0..64u8).map(|i| [90 + i * 2, 200 - i * 3, 60 + (i % 7) * 25, 255]).collect();
    stage.builder().add_texture(id("paint"), picture(8, 8, &texels)).unwrap();
    let bumps: Vec<[u8; 4]> = (0..64u8).map(|i| [150 + i, 200 - (i % 8) * 9, 220, 255]).collect();
    stage.builder().add_texture(id("bumps"), picture(8, 8, &bumps)).unwrap();
    let painted = |name: &str, material: Material, stage: &mut Stage| {
        let mut material = material;
        material.textures[TextureSlot::BaseColor as usize] = Some(TextureRef::new(id("paint")));
        let mut bumps = TextureRef::new(id("bumps"));
        bumps.uv_transform = Affine2::from_scale(Vec2::new(2.0, 1.0));
        material.textures[TextureSlot::Normal as usize] = Some(bumps);
        stage.material(name, material).unwrap()
    };
    let matt = painted("matt", Material::lambert(Rgb::splat(0.9)), &mut stage);
    let glossy =
        painted("glossy", Material { metallic: 1.0, roughness: 0.5, ..Material::default() }, &mut stage);
    let lamp = stage.material("lamp", Material::emitter(Rgb::new(9.0, 8.0, 7.0))).unwrap();
    let floor = samples::quad(SQUARE.map(|c| DVec3::new(c.x, -1.0, -c.y)), &matt);
    let texcoords = square(&matt).texcoords;
    let floor = MeshSource { texcoords: texcoords.clone(), ..floor };
    let wall = MeshSource { texcoords, ..samples::quad(SQUARE.map(|c| c - DVec3::Z), &glossy) };
    let mut wall = wall;
    wall.normals = vec![Vec3::Z; 4];
    wall.tangents = vec![Vec4::new(0.6, 0.8, 0.0, -1.0); 4];
    let lamp_corners = SQUARE.map(|c| DVec3::new(-0.5 - c.y * 0.1, 0.4 * c.x + 0.3, c.y * 0.5));
    for (name, mesh) in [("floor", floor), ("wall", wall), ("lamp", quad(lamp_corners, &lamp))] {
        stage.place(name, mirror(mesh), placed).unwrap();
    }
    let view = CameraView::look_at(seen_from, DVec3::new(0.0, -0.3, -0.5), DVec3::Y, 0.9);
    (stage.finish(), view)
}

/// A mesh shown by a mirroring node is the mesh mirrored by hand: positions, winding, normals, tangents.
#[test]
fn mirroring_nodes_show_what_mirrored_meshes_show() {
    let by_hand = |mut mesh: MeshSource| {
        mesh.positions.iter_mut().for_each(|p| p.x = -p.x);
        mesh.normals.iter_mut().for_each(|n| n.x = -n.x);
        // The bitangent is n × t times w, and a mirror turns the cross product round.
        mesh.tangents.iter_mut().for_each(|t| (t.x, t.w) = (-t.x, -t.w));
        mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        mesh
    };
    let mirror = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    let eye = DVec3::new(0.7, 0.8, 2.6);
    let (node, view) = asymmetric_room(|mesh| mesh, mirror, eye);
    let (mesh, _) = asymmetric_room(by_hand, DAffine3::IDENTITY, eye);
    let (a, b) = (render(node, view, 32, 256, None), render(mesh, view, 32, 256, None));
    for (a, b) in a.albedo().iter().zip(&b.albedo()) {
        assert!((*a - *b).map(f32::abs).max_component() < 1e-4, "{a:?} {b:?}");
    }
    for (a, b) in a.normal().iter().zip(&b.normal()) {
        assert!(a.distance(*b) < 1e-3, "{a} {b}");
    }
    for class in PathClass::ALL {
        compare_blocks(&a.layer(class), &b.layer(class), 32, class.name());
    }
}

/// Means over blocks of 8 × 8 pixels agree within their noise, which the spread of the differences tells.
fn compare_blocks(a: &[Rgb], b: &[Rgb], width: usize, what: &str) {
    let blocks = (width / 8) * (a.len() / width / 8);
    for block in 0..blocks {
        let (left, top) = (block % (width / 8) * 8, block / (width / 8) * 8);
        let mut difference = crate::math::RunningStatistics::default();
        let mut level = 0.0;
        for i in 0..64 {
            let at = (top + i / 8) * width + left + i % 8;
            difference.add(f64::from(a[at].mean() - b[at].mean()));
            level += f64::from(a[at].mean()) / 64.0;
        }
        // 64 differences are few for a normal law: at 63 degrees of freedom Student's t beyond 5 has p = 5e-6, and there
        // are a few hundred blocks in all tests. 1e-4 of the level is for rounding.
        let off = difference.mean().abs();
        assert!(
            off <= 5.0 * difference.standard_error() + 1e-4 * level,
            "{what}, block {block}: {} ± {} of {level}",
            difference.mean(),
            difference.standard_error()
        );
    }
}

/// The meshes of a scene in another dress.
fn with_meshes(scene: &Scene, dress: impl Fn(MeshSource) -> MeshSource) -> Scene {
    let mut builder = crate::scene::SceneBuilder::new(crate::scene::SceneLimits::default());
    for (id, material) in scene.materials() {
        builder.set_material(id.clone(), (**material).clone()).unwrap();
    }
    for (id, mesh) in scene.meshes() {
        let source = MeshSource {
            positions: mesh.positions().iter().map(|p| p.as_dvec3() + mesh.centre()).collect(),
            normals: mesh.normals().to_vec(),
            triangles: mesh.triangles().to_vec(),
            primitives: mesh.primitives().to_vec(),
            ..MeshSource::default()
        };
        builder.add_mesh(id.clone(), dress(source)).unwrap();
    }
    for (id, node) in scene.nodes() {
        builder.add_node(id.clone(), node.clone()).unwrap();
    }
    for (id, camera) in scene.cameras() {
        builder.set_camera(id.clone(), camera.clone()).unwrap();
    }
    builder.finish().0
}

/// The order of triangles, and how finely a flat surface is cut into them, lamps included, changes nothing but noise.
#[test]
fn permuted_and_split_triangles_show_the_same_picture() {
    let scene = samples::cornell_box().unwrap();
    let view = scene.camera_view(None).unwrap();
    let original = render(scene.clone(), view, 32, 128, None);
    let permuted = with_meshes(&scene, |mut mesh| {
        mesh.triangles.reverse();
        mesh.triangles.iter_mut().for_each(|triangle| triangle.rotate_left(1));
        mesh
    });
    let split = with_meshes(&scene, |mut mesh| {
        // A smooth mesh bends between other corners when it is cut: flat ones only.
        if !mesh.normals.is_empty() {
            return mesh;
        }
        let mut triangles = Vec::new();
        for [a, b, c] in mesh.triangles {
            // Off the middle, so that the parts are uneven.
            let weights = [(a, 0.5), (b, 0.2), (c, 0.3)];
            let inner = weights.iter().map(|(v, w)| mesh.positions[*v as usize] * *w).sum();
            let d = mesh.positions.len() as u32;
            mesh.positions.push(inner);
            triangles.extend([[a, b, d], [b, c, d], [c, a, d]]);
        }
        mesh.primitives[0].triangle_count = triangles.len() as u32;
        MeshSource { triangles, ..mesh }
    });
    for (name, scene) in [("permuted", permuted), ("split", split)] {
        let other = render(scene, view, 32, 128, None);
        for class in PathClass::ALL {
            compare_blocks(
                &original.layer(class),
                &other.layer(class),
                32,
                &format!("{name}, {}", class.name()),
            );
        }
    }
}
