//! Scenes of our own making, built in: a Cornell-like box to show, furnaces to test by.

use glam::{DAffine3, DMat3, DVec3};

use super::{
    Camera, CameraView, Environment, Id, Light, LightKind, Material, MeshSource, Node, Primitive, Scene,
    SceneBuilder, SceneError, SceneLimits,
};
use crate::math::Rgb;

fn id(name: &str) -> Id {
    Id::sanitised(name, "object")
}

/// A quad with corners counter-clockwise seen from its front.
pub fn quad(corners: [DVec3; 4], material: &Id) -> MeshSource {
    mesh_of(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]], material)
}

/// A box with outward faces from `min` to `max`.
pub fn cuboid(min: DVec3, max: DVec3, material: &Id) -> MeshSource {
    let corner = |i: usize| DVec3::select(glam::BVec3::new(i & 1 != 0, i & 2 != 0, i & 4 != 0), max, min);
    let faces: [[usize; 4]; 6] =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for face in faces {
        let first = positions.len() as u32;
        positions.extend(face.map(corner));
        triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    mesh_of(positions, triangles, material)
}

/// A sphere of `2 · rings²` quads with exact normals.
pub fn sphere(centre: DVec3, radius_m: f64, rings: u32, material: &Id) -> MeshSource {
    let segments = rings * 2;
    let mut mesh = MeshSource::default();
    for ring in 0..=rings {
        for segment in 0..=segments {
            let (theta, phi) = (
                std::f64::consts::PI * f64::from(ring) / f64::from(rings),
                std::f64::consts::TAU * f64::from(segment % segments) / f64::from(segments),
            );
            let sin_theta = if ring == 0 || ring == rings { 0.0 } else { theta.sin() };
            let normal = DVec3::new(sin_theta * phi.cos(), theta.cos(), -sin_theta * phi.sin());
            mesh.positions.push(centre + normal * radius_m);
            mesh.normals.push(normal.as_vec3());
        }
    }
    let row = segments + 1;
    for ring in 0..rings {
        for segment in 0..segments {
            let [a, b] = [ring * row + segment, (ring + 1) * row + segment];
            if ring > 0 {
                mesh.triangles.push([a, b, a + 1]);
            }
            if ring + 1 < rings {
                mesh.triangles.push([a + 1, b, b + 1]);
            }
        }
    }
    mesh.primitives = vec![Primitive {
        first_triangle: 0,
        triangle_count: mesh.triangles.len() as u32,
        material: material.clone(),
    }];
    mesh
}

/// A mesh of one material.
pub(crate) fn mesh_of(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>, material: &Id) -> MeshSource {
    let primitives = vec![Primitive {
        first_triangle: 0,
        triangle_count: triangles.len() as u32,
        material: material.clone(),
    }];
    MeshSource { positions, triangles, primitives, ..MeshSource::default() }
}

/// A scene in the making, for the scenes below and for tests: objects by name, one node per mesh.
#[derive(Debug)]
pub struct Stage {
    builder: SceneBuilder,
}

impl Default for Stage {
    fn default() -> Stage {
        Stage { builder: SceneBuilder::new(SceneLimits::default()) }
    }
}

impl Stage {
    /// Adds a material and returns its id.
    pub fn material(&mut self, name: &str, material: Material) -> Result<Id, SceneError> {
        self.builder.set_material(id(name), material)?;
        Ok(id(name))
    }

    /// Adds a mesh and a node of the same name that shows it.
    pub fn place(
        &mut self,
        name: &str,
        mesh: MeshSource,
        world_from_mesh: DAffine3,
    ) -> Result<(), SceneError> {
        self.builder.add_mesh(id(name), mesh)?;
        self.builder.add_node(
            id(name),
            Node { parent: None, parent_from_node: world_from_mesh, mesh: Some(id(name)) },
        )
    }

    /// Adds a punctual light.
    pub fn light(&mut self, name: &str, light: Light) -> Result<(), SceneError> {
        self.builder.add_light(id(name), light)
    }

    /// Adds a camera.
    pub fn camera(&mut self, name: &str, view: CameraView, aspect: f64) -> Result<(), SceneError> {
        let (parent_from_camera, projection) = (view.world_from_camera, view.projection);
        self.builder.set_camera(
            id(name),
            Camera { parent: None, parent_from_camera, projection, aspect: Some(aspect) },
        )
    }

    /// The builder, for what the stage has no word for.
    pub fn builder(&mut self) -> &mut SceneBuilder {
        &mut self.builder
    }

    /// The finished scene.
    pub fn finish(self) -> Scene {
        self.builder.finish().0
    }
}

/// The built-in scene: a Cornell-like box of our own measures, two metres wide, with a block, a glass
/// ball and a mirror block under a square lamp; cameras `main` and `corner`.
pub fn cornell_box() -> Result<Scene, SceneError> {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::new(0.73, 0.72, 0.68)))?;
    let red = stage.material("red", Material::lambert(Rgb::new(0.60, 0.07, 0.05)))?;
    let green = stage.material("green", Material::lambert(Rgb::new(0.12, 0.43, 0.10)))?;
    let lamp = stage.material("lamp", Material::emitter(Rgb::new(17.0, 12.5, 7.5)))?;
    let mirror = stage.material(
        "mirror",
        Material {
            base_color: Rgb::new(0.95, 0.93, 0.88),
            metallic: 1.0,
            roughness: 0.0,
            ..Material::default()
        },
    )?;
    let glass =
        stage.material("glass", Material { transmission: 1.0, roughness: 0.0, ..Material::default() })?;
    let v = DVec3::new;
    let at_origin = DAffine3::IDENTITY;
    stage.place(
        "floor",
        quad([v(-1., 0., 1.), v(1., 0., 1.), v(1., 0., -1.), v(-1., 0., -1.)], &white),
        at_origin,
    )?;
    stage.place(
        "ceiling",
        quad([v(-1., 2., -1.), v(1., 2., -1.), v(1., 2., 1.), v(-1., 2., 1.)], &white),
        at_origin,
    )?;
    stage.place(
        "back",
        quad([v(-1., 0., -1.), v(1., 0., -1.), v(1., 2., -1.), v(-1., 2., -1.)], &white),
        at_origin,
    )?;
    stage.place(
        "left",
        quad([v(-1., 0., 1.), v(-1., 0., -1.), v(-1., 2., -1.), v(-1., 2., 1.)], &red),
        at_origin,
    )?;
    stage.place(
        "right",
        quad([v(1., 0., -1.), v(1., 0., 1.), v(1., 2., 1.), v(1., 2., -1.)], &green),
        at_origin,
    )?;
    let lamp_corners = [v(-0.25, 0., -0.25), v(0.25, 0., -0.25), v(0.25, 0., 0.25), v(-0.25, 0., 0.25)];
    stage.place("lamp", quad(lamp_corners, &lamp), DAffine3::from_translation(v(0.0, 1.995, 0.0)))?;
    let turned = |x: f64, z: f64, angle_deg: f64| {
        DAffine3::from_mat3_translation(DMat3::from_rotation_y(angle_deg.to_radians()), v(x, 0.0, z))
    };
    stage.place(
        "tall block",
        cuboid(v(-0.3, 0., -0.3), v(0.3, 1.2, 0.3), &white),
        turned(-0.38, -0.35, 18.0),
    )?;
    stage.place(
        "mirror block",
        cuboid(v(-0.2, 0., -0.2), v(0.2, 0.4, 0.2), &mirror),
        turned(0.05, 0.45, -30.0),
    )?;
    stage.place("glass ball", sphere(v(0., 0.35, 0.), 0.35, 48, &glass), turned(0.5, 0.1, 0.0))?;
    let main = CameraView::look_at(v(0., 1., 4.2), v(0., 0.98, 0.), DVec3::Y, 36f64.to_radians());
    stage.camera("main", main, 1.0)?;
    let corner = CameraView::look_at(v(-0.75, 1.6, 1.6), v(0.25, 0.5, -0.3), DVec3::Y, 60f64.to_radians());
    stage.camera("corner", corner, 16.0 / 9.0)?;
    Ok(stage.finish())
}

/// A closed room of white boxes under a square lamp, 50 triangles, four metres wide; camera `main`. A stand-in for the
/// scene "Boxes" of [Vivanloc2007, figure 13], of which only the number of polygons is known.
pub fn boxes() -> Result<Scene, SceneError> {
    let mut stage = Stage::default();
    let wall = stage.material("wall", Material::lambert(Rgb::new(0.7, 0.7, 0.65)))?;
    let white = stage.material("white", Material::lambert(Rgb::splat(0.75)))?;
    let red = stage.material("red", Material::lambert(Rgb::new(0.65, 0.12, 0.08)))?;
    let blue = stage.material("blue", Material::lambert(Rgb::new(0.1, 0.16, 0.55)))?;
    let lamp = stage.material("lamp", Material::emitter(Rgb::new(20.0, 18.0, 15.0)))?;
    let v = DVec3::new;
    let turned = |x: f64, z: f64, angle_deg: f64| {
        DAffine3::from_mat3_translation(DMat3::from_rotation_y(angle_deg.to_radians()), v(x, 0.0, z))
    };
    // Surfaces reflect on both sides: seen from inside, the outward faces are the walls.
    stage.place("room", cuboid(v(-2., 0., -2.), v(2., 2.5, 2.), &wall), DAffine3::IDENTITY)?;
    let lamp_corners = [v(-0.4, 0., -0.4), v(0.4, 0., -0.4), v(0.4, 0., 0.4), v(-0.4, 0., 0.4)];
    stage.place("lamp", quad(lamp_corners, &lamp), DAffine3::from_translation(v(0.0, 2.49, 0.0)))?;
    let standing = |width: f64, height: f64| (v(-width, 0., -width), v(width, height, width));
    for (name, (min, max), material, place) in [
        ("tall box", standing(0.3, 1.4), &white, turned(-0.9, -0.8, 20.0)),
        ("red box", standing(0.35, 0.7), &red, turned(0.7, -0.5, -15.0)),
        ("blue box", standing(0.25, 0.5), &blue, turned(0.1, 0.6, 40.0)),
    ] {
        stage.place(name, cuboid(min, max, material), place)?;
    }
    let main = CameraView::look_at(v(0.3, 1.4, 1.9), v(-0.05, 0.6, -0.5), DVec3::Y, 60f64.to_radians());
    stage.camera("main", main, 16.0 / 9.0)?;
    Ok(stage.finish())
}

/// Two white rooms of 2 × 2 × 2 m on one floor, between the same walls and under one ceiling, parted at x = 0 by a wall 2 cm thin;
/// each has a square lamp under the ceiling. Light of the one must not get into the other.
///
/// - `emission`: of the lamps at x < 0 and at x > 0, W/(m² sr)
pub fn parted_rooms(emission: [f32; 2]) -> Result<Scene, SceneError> {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.6)))?;
    let v = DVec3::new;
    stage.place("rooms", cuboid(v(-2., 0., -1.), v(2., 2., 1.), &white), DAffine3::IDENTITY)?;
    stage.place("wall", cuboid(v(-0.01, 0., -1.), v(0.01, 2., 1.), &white), DAffine3::IDENTITY)?;
    for (name, emission, x) in [("left lamp", emission[0], -1.0), ("right lamp", emission[1], 1.0)] {
        let lamp = stage.material(name, Material::emitter(Rgb::splat(emission)))?;
        let corners = [v(-0.3, 0., -0.3), v(0.3, 0., -0.3), v(0.3, 0., 0.3), v(-0.3, 0., 0.3)];
        stage.place(name, quad(corners, &lamp), DAffine3::from_translation(v(x, 1.99, 0.0)))?;
    }
    let main = CameraView::look_at(v(1.8, 1.2, 0.3), v(0.0, 0.6, -0.1), DVec3::Y, 70f64.to_radians());
    stage.camera("main", main, 4.0 / 3.0)?;
    Ok(stage.finish())
}

/// A room of 4 × 2.5 × 4 m with a window and a box in it, on ground sixty metres wide, under an even sky and the sun; camera `main`,
/// inside.
pub fn room_on_ground() -> Result<Scene, SceneError> {
    Ok(staged_room_on_ground()?.finish())
}

/// The same with a pane of clear glass, a centimetre thick, in the window.
pub fn glazed_room() -> Result<Scene, SceneError> {
    let mut stage = staged_room_on_ground()?;
    let clear = Material { transmission: 1.0, roughness: 0.0, base_color: Rgb::WHITE, ..Material::default() };
    let clear = stage.material("clear", clear)?;
    let pane = cuboid(DVec3::new(2.09, 0.8, -0.9), DVec3::new(2.1, 2.1, 0.9), &clear);
    stage.place("pane", pane, DAffine3::IDENTITY)?;
    Ok(stage.finish())
}

fn staged_room_on_ground() -> Result<Stage, SceneError> {
    let mut stage = Stage::default();
    let wall = stage.material("wall", Material::lambert(Rgb::new(0.75, 0.75, 0.72)))?;
    let floor = stage.material("floor", Material::lambert(Rgb::new(0.5, 0.36, 0.24)))?;
    let meadow = stage.material("meadow", Material::lambert(Rgb::new(0.3, 0.36, 0.24)))?;
    let v = DVec3::new;
    let ground = [v(-30., -0.2, 30.), v(30., -0.2, 30.), v(30., -0.2, -30.), v(-30., -0.2, -30.)];
    stage.place("ground", quad(ground, &meadow), DAffine3::IDENTITY)?;
    for (name, min, max, material) in [
        ("floor", v(-2.2, -0.2, -2.2), v(2.2, 0., 2.2), &floor),
        ("ceiling", v(-2.2, 2.5, -2.2), v(2.2, 2.7, 2.2), &wall),
        ("back wall", v(-2.2, 0., -2.2), v(-2., 2.5, 2.2), &wall),
        ("left wall", v(-2., 0., -2.2), v(2.2, 2.5, -2.), &wall),
        ("right wall", v(-2., 0., 2.), v(2.2, 2.5, 2.2), &wall),
        ("parapet", v(2., 0., -2.), v(2.2, 0.8, 2.), &wall),
        ("lintel", v(2., 2.1, -2.), v(2.2, 2.5, 2.), &wall),
        ("left of the window", v(2., 0.8, -2.), v(2.2, 2.1, -0.9), &wall),
        ("right of the window", v(2., 0.8, 0.9), v(2.2, 2.1, 2.), &wall),
        ("box", v(-1.2, 0., -1.2), v(-0.5, 0.7, -0.5), &wall),
    ] {
        stage.place(name, cuboid(min, max, material), DAffine3::IDENTITY)?;
    }
    let kind = LightKind::Directional { irradiance: Rgb::new(20.0, 19.0, 17.0) };
    let direction = v(-1.0, -0.8, -0.35).normalize();
    stage.light("sun", Light { parent: None, position: DVec3::ZERO, direction, kind })?;
    stage.builder().set_environment(Environment::Constant(Rgb::new(0.7, 0.9, 1.2)))?;
    let main = CameraView::look_at(v(-1.8, 1.5, 1.6), v(0.8, 0.9, -0.5), DVec3::Y, 70f64.to_radians());
    stage.camera("main", main, 16.0 / 9.0)?;
    Ok(stage)
}

/// A closed box whose every face emits `emission` and reflects `albedo`: the radiance everywhere inside is
/// exactly emission / (1 − albedo) [techniques.md, numerical laws].
pub fn furnace(albedo: f32, emission: f32) -> Result<Scene, SceneError> {
    let mut stage = Stage::default();
    let material = Material {
        emission: Rgb::splat(emission),
        double_sided: true,
        ..Material::lambert(Rgb::splat(albedo))
    };
    let wall = stage.material("wall", material)?;
    stage.place("box", cuboid(DVec3::splat(-1.0), DVec3::ONE, &wall), DAffine3::IDENTITY)?;
    let inside = CameraView::look_at(DVec3::new(0.3, 0.2, 0.1), DVec3::new(-1.0, 0.1, -0.4), DVec3::Y, 1.2);
    stage.camera("inside", inside, 1.0)?;
    Ok(stage.finish())
}
