//! Lamps without size.

use super::*;

/// A lamp without size in the plane of a sheet lights what lies on either side of it; a millimetre behind it, that side alone.
#[test]
fn a_point_in_the_plane_of_a_ceiling_is_not_hidden_by_it() {
    for (turned, scale) in [(0.0, 1.0), (0.7, 1.0), (2.3, 1e-3), (1.1, 1e3)] {
        let placed = DAffine3::from_scale(DVec3::splat(scale))
            * DAffine3::from_rotation_translation(
                DQuat::from_scaled_axis(DVec3::new(0.3, 1.0, 0.2) * turned),
                DVec3::new(7.0, 2.6, -3.0),
            );
        for height in [0.0, -1e-3, 1e-3] {
            let mut stage = Stage::default();
            let white = stage.material("white", Material::lambert(Rgb::WHITE)).unwrap();
            // Away from the lamp's foot, where its corners meet it, and under it.
            let corners = [(-3.1, -2.3), (4.7, -2.9), (3.9, 5.3), (-2.7, 3.3)];
            stage
                .place("ceiling", quad(corners.map(|(x, z)| DVec3::new(x, 0.0, z)), &white), placed)
                .unwrap();
            let position = placed.transform_point3(DVec3::new(0.3, height, -0.7));
            let kind = LightKind::Point { intensity: Rgb::WHITE };
            let light = Light { parent: None, position, direction: DVec3::NEG_Y, kind };
            stage.builder().add_light(Id::new("lamp").unwrap(), light).unwrap();
            let world = World::prepare(Arc::new(stage.finish()));
            let mut seen = [0; 2];
            const COUNT: i32 = 4096;
            for i in 0..COUNT as u32 {
                let [a, b, c, _] = point(11, i).map(f64::from);
                // From 5 cm off the plane, where the lamp is up to 4.5 m away, to 2.5 m.
                let off = 0.05 + 2.5 * c * c;
                for (side, y) in [-off, off].into_iter().enumerate() {
                    let p = placed.transform_point3(DVec3::new(6.0 * a - 3.0, y, 6.0 * b - 3.0));
                    let n = placed.transform_vector3(DVec3::Y * -y).normalize();
                    let at = receiver(&world, p, n);
                    let sample =
                        world.lights().sample(world.accel(), at.position, at.n_geo, || None, [0.5; 3]);
                    let (_, shadow) = world.towards_light(&at, &sample.unwrap()).unwrap();
                    seen[side] += i32::from(!world.is_occluded(&shadow));
                }
            }
            let expected = [height <= 0.0, height >= 0.0].map(|is_seen| if is_seen { COUNT } else { 0 });
            assert_eq!(seen, expected, "turned by {turned}, of {scale}, {height} above the plane");
            // And photons go both ways.
            let source = &world.sources()[0];
            let caught = (0..COUNT as u32).filter(|i| {
                let ([a, b, c, d], [side, ..]) = (point(1, *i), point(2, *i));
                let numbers = EmissionNumbers { direction: [a, b], position: [c, d], side };
                world.closest_hit(&world.emit(source, &numbers).unwrap().ray).is_some()
            });
            let caught = caught.count() as f64 / f64::from(COUNT);
            let half = if height == 0.0 { 0.0 } else { 0.5 };
            assert!((caught - half).abs() < 0.05, "{caught} of {turned}, {scale}, {height} met the ceiling");
        }
    }
}
