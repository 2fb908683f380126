//! Glass and mirrors as they should not be modelled and are: glass in glass, glass that touches a wall or other glass, faces in
//! one place, no refraction at all and that of diamond, rays along a face, mirrors that face each other. All of it loses no
//! light, so that in white surroundings it is as bright as these to an eye outside; and under a lamp, looked up or traced,
//! every layer is the same.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use lumicast_engine::math::{Rgb, RunningStatistics};
use lumicast_engine::render::{Indirect, RenderSettings};
use lumicast_engine::scene::samples::{Stage, cuboid, quad, sphere};
use lumicast_engine::scene::{CameraView, Environment, Material};
use lumicast_engine::transport::World;
use lumicast_tests::{compare_layers, mean, picture};

fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

fn glass(ior: f32) -> Material {
    Material { transmission: 1.0, roughness: 0.0, base_color: Rgb::WHITE, ior, ..Material::default() }
}

/// Things in a cube of 2 m around the origin, and from where they are looked at.
struct Case {
    name: &'static str,
    /// Radiance at the eye where that of the surroundings is 1.
    radiance: f64,
    place: fn(&mut Stage),
    eye: DVec3,
}

fn thing(
    stage: &mut Stage,
    name: &str,
    material: Material,
    shape: impl Fn(&lumicast_engine::scene::Id) -> lumicast_engine::scene::MeshSource,
) {
    let id = stage.material(name, material).expect("a material");
    stage.place(name, shape(&id), DAffine3::IDENTITY).expect("a thing");
}

const FRONT: DVec3 = DVec3::new(0.3, 0.4, 2.6);

const CASES: [Case; 9] = [
    Case {
        name: "glass in glass",
        radiance: 1.0,
        place: |stage| {
            thing(stage, "outer", glass(1.5), |id| sphere(DVec3::ZERO, 0.8, 32, id));
            thing(stage, "inner", glass(1.33), |id| sphere(v(0.1, 0.0, 0.0), 0.5, 32, id));
        },
        eye: FRONT,
    },
    Case {
        name: "glass that touches a wall",
        radiance: 1.0,
        place: |stage| {
            thing(stage, "wall", Material::lambert(Rgb::WHITE), |id| {
                quad([v(-1., -1., -0.5), v(1., -1., -0.5), v(1., 1., -0.5), v(-1., 1., -0.5)], id)
            });
            thing(stage, "glass", glass(1.5), |id| cuboid(v(-0.5, -0.5, -0.5), v(0.5, 0.5, 0.3), id));
        },
        eye: FRONT,
    },
    Case {
        name: "two blocks with a face in one place",
        radiance: 1.0,
        place: |stage| {
            thing(stage, "left", glass(1.5), |id| cuboid(v(-0.6, -0.5, -0.5), v(0.0, 0.5, 0.5), id));
            thing(stage, "right", glass(1.5), |id| cuboid(v(0.0, -0.5, -0.5), v(0.6, 0.5, 0.5), id));
        },
        eye: FRONT,
    },
    Case {
        name: "the same block twice",
        radiance: 1.0,
        place: |stage| {
            thing(stage, "one", glass(1.5), |id| cuboid(v(-0.5, -0.5, -0.5), v(0.5, 0.5, 0.5), id));
            thing(stage, "two", glass(1.5), |id| cuboid(v(-0.5, -0.5, -0.5), v(0.5, 0.5, 0.5), id));
        },
        eye: FRONT,
    },
    Case {
        name: "glass that does not refract",
        radiance: 1.0,
        place: |stage| thing(stage, "air", glass(1.0), |id| sphere(DVec3::ZERO, 0.8, 32, id)),
        eye: FRONT,
    },
    Case {
        name: "diamond",
        radiance: 1.0,
        place: |stage| {
            thing(stage, "diamond", glass(2.4), |id| cuboid(v(-0.6, -0.5, -0.4), v(0.6, 0.5, 0.4), id))
        },
        eye: FRONT,
    },
    Case {
        name: "along the face of a pane",
        radiance: 1.0,
        place: |stage| {
            thing(stage, "pane", glass(1.5), |id| cuboid(v(-0.9, -0.02, -0.9), v(0.9, 0.02, 0.9), id))
        },
        eye: DVec3::new(0.0, 0.021, 2.6),
    },
    Case {
        name: "from inside",
        // Inside glass light is denser by the square of its index.
        radiance: 2.25,
        place: |stage| thing(stage, "glass", glass(1.5), |id| sphere(v(0.3, 0.4, 2.6), 0.6, 32, id)),
        eye: FRONT,
    },
    Case {
        name: "two mirrors that face each other",
        radiance: 1.0,
        place: |stage| {
            let mirror =
                Material { base_color: Rgb::WHITE, metallic: 1.0, roughness: 0.0, ..Material::default() };
            let square = |x: f64| [v(x, -1., -1.), v(x, -1., 1.), v(x, 1., 1.), v(x, 1., -1.)];
            thing(stage, "left", mirror.clone(), |id| quad(square(-0.7), id));
            thing(stage, "right", mirror, |id| quad(square(0.7), id));
        },
        eye: DVec3::new(0.3, 0.2, 0.8),
    },
];

fn looked_at(case: &Case, mut stage: Stage) -> Arc<World> {
    (case.place)(&mut stage);
    let view = CameraView::look_at(case.eye, v(0.05, 0.02, 0.0), DVec3::Y, 0.7);
    stage.camera("main", view, 1.0).expect("a camera");
    Arc::new(World::prepare(Arc::new(stage.finish())))
}

#[test]
fn in_white_surroundings_what_loses_no_light_is_white() {
    for case in &CASES {
        let mut stage = Stage::default();
        stage.builder().set_environment(Environment::Constant(Rgb::WHITE)).expect("a sky");
        let world = looked_at(case, stage);
        for (indirect, allowed) in [(Indirect::Path, 2e-3), (Indirect::Irradiance, 0.03)] {
            let settings = RenderSettings { indirect, seed: 3, ..RenderSettings::default() };
            let rendering = picture(&world, 32, settings, 64);
            assert_eq!(rendering.dropped_samples(), 0, "{}", case.name);
            let mut radiance = RunningStatistics::default();
            rendering.picture().radiance().iter().for_each(|colour| radiance.add(f64::from(colour.mean())));
            let off = (radiance.mean() / case.radiance - 1.0).abs();
            let doubt = 5.0 * radiance.standard_error() / case.radiance + allowed;
            assert!(off < doubt, "{}, {indirect:?}: {} ± {doubt}", case.name, radiance.mean());
        }
    }
}

/// A matt room with a lamp around the case; its eye is inside.
fn room() -> Stage {
    let mut stage = Stage::default();
    thing(&mut stage, "room", Material::lambert(Rgb::splat(0.6)), |id| {
        cuboid(v(-3., -2., -3.), v(3., 2.5, 3.), id)
    });
    thing(&mut stage, "lamp", Material::emitter(Rgb::splat(10.0)), |id| {
        quad([v(-0.6, 2.4, -0.6), v(0.6, 2.4, -0.6), v(0.6, 2.4, 0.6), v(-0.6, 2.4, 0.6)], id)
    });
    stage
}

#[test]
fn under_a_lamp_every_layer_is_that_of_the_path_tracer() {
    let mut failures = Vec::new();
    for case in &CASES {
        let world = looked_at(case, room());
        failures.extend(compare_layers(case.name, &world, Indirect::Irradiance, 48).failures);
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Glass of index 1 neither bends nor reflects: the picture is that of the room without it.
#[test]
fn glass_that_does_not_refract_is_not_there() {
    let [with, without] = [true, false].map(|is_there| {
        let case = CASES.iter().find(|case| case.name == "glass that does not refract").expect("a case");
        let nothing = Case { place: |_| (), ..*case };
        looked_at(if is_there { case } else { &nothing }, room())
    });
    for indirect in [Indirect::Path, Indirect::Irradiance] {
        let of = |world: &Arc<World>| {
            let settings = RenderSettings { indirect, seed: 8, ..RenderSettings::default() };
            mean(&picture(world, 32, settings, 256).picture().radiance())
        };
        let [with, without] = [&with, &without].map(of);
        assert!((with / without - 1.0).abs() < 0.02, "{indirect:?}: {with} for {without}");
    }
}
