//! Light that comes straight through panes.

use super::{
    super::photons::{Came, CausticTracer},
    *,
};

/// A floor under clear panes: level, tilted, two behind each other, one that absorbs; and a prism and a ball, which turn light aside. The sun
/// stands at a slant in an even sky.
fn under_glass() -> World {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
    let clear = stage.material("clear", clear_glass()).unwrap();
    let green = Material {
        base_color: Rgb::new(0.7, 0.9, 0.8),
        attenuation_color: Rgb::new(0.3, 0.8, 0.5),
        attenuation_distance_m: 0.1,
        ior: 1.7,
        ..clear_glass()
    };
    let green = stage.material("green", green).unwrap();
    let square = [v(-8., 0., 8.), v(8., 0., 8.), v(8., 0., -8.), v(-8., 0., -8.)];
    stage.place("floor", quad(square, &white), DAffine3::IDENTITY).unwrap();
    let pane = |material: &Id| cuboid(v(-1., 0., -1.), v(1., 0.02, 1.), material);
    for (name, material, at, tilt) in [
        ("level", &clear, v(-3., 1., -3.), 0.0),
        ("tilted", &clear, v(0., 1., -3.), 0.5),
        ("low", &clear, v(3., 1., -3.), 0.0),
        ("high", &green, v(3., 1.3, -3.), 0.2),
        ("green", &green, v(-3., 1., 0.), -0.3),
    ] {
        let placed = DAffine3::from_translation(at) * DAffine3::from_rotation_z(tilt);
        stage.place(name, pane(material), placed).unwrap();
    }
    // Two panes' worth of one, of which the upper face leans.
    let mut prism = cuboid(v(-1., 0., -1.), v(1., 0.3, 1.), &clear);
    for position in &mut prism.positions {
        position.y += if position.y > 0.1 && position.x > 0.0 { 0.3 } else { 0.0 };
    }
    stage.place("prism", prism, DAffine3::from_translation(v(0., 1., 0.))).unwrap();
    let ball = sphere(v(3., 1., 0.), 0.7, 48, &clear);
    stage.place("ball", ball, DAffine3::IDENTITY).unwrap();
    let sun = LightKind::Directional { irradiance: Rgb::splat(3.0) };
    let direction = v(0.4, -1.0, 0.3).normalize();
    stage.light("sun", Light { kind: sun, parent: None, position: DVec3::ZERO, direction }).unwrap();
    let sky = crate::scene::Environment::Constant(Rgb::new(0.4, 0.5, 0.6));
    stage.builder().set_environment(sky).unwrap();
    world_of(stage.finish())
}

/// Photons of a pass with how they came, those as well that maps do not hold.
fn photons_of_all_ways(world: &World, settings: &CausticSettings) -> Vec<(Came, CausticPhoton)> {
    let emission = Emission::of(world, settings);
    let tracer = CausticTracer { world, settings };
    let mut photons = Vec::new();
    for job in emission.jobs(0) {
        let light = &emission.lights[job.light];
        for number in job.numbers {
            tracer.trace(light, job.half, number as u32, |came, photon| photons.push((came, photon)));
        }
    }
    let focused: Vec<CausticPhoton> =
        photons.iter().filter(|(came, _)| *came == Came::Focused).map(|(_, photon)| *photon).collect();
    let places = |photons: &[CausticPhoton]| -> Vec<Vec3> { photons.iter().map(|p| p.position).collect() };
    assert!(places(&photons_of_a_pass(world, settings)) == places(&focused), "maps hold these");
    photons
}

/// Photons that came straight through panes are those that light sampling finds where they fell, and bring as much light as it does; what
/// prisms and balls turn aside is none of them.
#[test]
fn photons_through_panes_are_what_light_sampling_finds() {
    let world = under_glass();
    let photons = photons_of_all_ways(&world, &settings(4_000_000));
    let lifted = |at: Vec3, wi: Vec3| Ray::new(at + Vec3::Y * 1e-4, wi);
    let middle = world.accel().to_render(DVec3::ZERO);
    let is_on_floor = |photon: &CausticPhoton| (photon.position.y - middle.y).abs() < 1e-3;
    let on_floor: Vec<&(Came, CausticPhoton)> =
        photons.iter().filter(|(_, photon)| is_on_floor(photon)).collect();
    // At the very edges rounding decides.
    let of_panes = |(came, photon): &&(Came, CausticPhoton)| (*came == Came::ByPanes).then_some(*photon);
    let straight: Vec<CausticPhoton> = on_floor.iter().filter_map(of_panes).collect();
    let is_found = |photon: &&CausticPhoton| {
        world.through_panes(&lifted(photon.position, photon.direction), |_| ()).is_some()
    };
    let lost = straight.len() - straight.iter().filter(is_found).count();
    assert!(straight.len() > 80_000 && lost * 1_000 < straight.len(), "{lost} of {}", straight.len());
    let under = |at: DVec3| {
        let middle = world.accel().to_render(at);
        move |photon: &&CausticPhoton| (photon.position - middle).abs().max_element() < 1.0
    };
    // Under the ball, but for what has missed it on its way through others, and the prism.
    for at in [v(0., 0., 0.), v(3., 0., 0.)] {
        let of_straight = straight.iter().filter(under(at)).count();
        let of_all = on_floor.iter().map(|(_, photon)| photon).filter(under(at)).count();
        assert!(10 * of_straight < 3 * of_all && of_all > 1_000, "{of_straight} of {of_all} at {at}");
    }
    // Flux on squares of the floor, W.
    for at in [v(-3., 0., -3.), v(0., 0., -3.), v(3., 0., -3.), v(-3., 0., 0.), v(0., 0., 0.)] {
        let mut brought = Rgb::BLACK;
        straight.iter().filter(under(at)).for_each(|photon| brought += photon.flux_w);
        let mut found = Rgb::BLACK;
        let (mut taken, count) = (0, 200_000);
        for number in 0..count {
            let ([x, z, choice, _], [a, b, ..]) = (sobol::point(51, number), sobol::point(52, number));
            let p = world.accel().to_render(at) + Vec3::new(2.0 * x - 1.0, 0.0, 2.0 * z - 1.0);
            let lights = world.lights();
            let Some(light) = lights.sample(world.accel(), p, Vec3::Y, || None, [choice, a, b]) else {
                continue;
            };
            if let Some(passage) = world.through_panes(&lifted(p, light.wi), |_| ()) {
                taken += 1;
                // Over 4 m².
                let per_sample = 4.0 * light.wi.y.max(0.0) / light.pdf / count as f32;
                found += light.radiance * passage.share * per_sample;
            }
        }
        assert!(taken > 5_000 || at == DVec3::ZERO, "{taken}");
        for (brought, found) in brought.to_array().into_iter().zip(found.to_array()) {
            // Where next to nothing comes some ten photons do.
            let off = (brought - found).abs();
            assert!(off < 0.02 * found + 0.01, "{brought} W for {found} W at {at}");
        }
    }
}

/// Where suns are sampled through panes, on lobes with a width, photons of hidden light stop: paths find what those send on.
#[test]
fn hidden_light_is_not_what_paths_find_through_panes() {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
    let clear = stage.material("clear", clear_glass()).unwrap();
    for (name, roughness) in [("narrow", 0.25), ("broad", 0.6)] {
        let metal = Material { metallic: 1.0, roughness, ..Material::lambert(Rgb::splat(0.8)) };
        let metal = stage.material(name, metal).unwrap();
        let z = if name == "narrow" { -1.0 } else { 1.0 };
        let square = [v(-1., 0., z + 0.9), v(1., 0., z + 0.9), v(1., 0., z - 0.9), v(-1., 0., z - 0.9)];
        stage.place(name, quad(square, &metal), DAffine3::IDENTITY).unwrap();
    }
    let wall = [v(-4., 0., 4.), v(-4., 0., -4.), v(-4., 6., -4.), v(-4., 6., 4.)];
    stage.place("wall", quad(wall, &white), DAffine3::IDENTITY).unwrap();
    stage.place("pane", cuboid(v(1., 2., -2.), v(3.5, 2.02, 2.), &clear), DAffine3::IDENTITY).unwrap();
    let sun = LightKind::Directional { irradiance: Rgb::splat(3.0) };
    let direction = v(-1.0, -1.0, 0.0).normalize();
    stage.light("sun", Light { kind: sun, parent: None, position: DVec3::ZERO, direction }).unwrap();
    let world = world_of(stage.finish());
    let on_wall = |light| {
        let photons = photons_of_a_pass(&world, &CausticSettings { light, ..settings(200_000) });
        let is_there = |photon: &&CausticPhoton| photon.normal.x.abs() > 0.9;
        let flux = |photon: &CausticPhoton| f64::from(photon.flux_w.g);
        photons.iter().filter(is_there).map(flux).sum::<f64>()
    };
    let [all, hidden] = [CausticLight::All, CausticLight::Hidden].map(on_wall);
    assert!(all > 1.0 && hidden < 0.15 * all, "{hidden} W of {all}");
}
