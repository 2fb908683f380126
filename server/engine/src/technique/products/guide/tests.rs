use super::{samples_of_guides::guide_of, *};
use crate::math::sobol::point;

fn on_floor(number: u32) -> Vec3 {
    let [x, y, ..] = point(3, number);
    Vec3::new(x, y, 0.0)
}

/// Half of them from a small spot, the rest from all around.
fn spotted(number: u32) -> (Vec3, Vec3) {
    let [_, _, u, v] = point(5, number);
    let from = if number.is_multiple_of(2) {
        Vec3::new(0.6 + 0.05 * u, 0.05 * v, 0.8).normalize()
    } else {
        warp::cosine_hemisphere([u, v])
    };
    (on_floor(number), on_floor(number) + from)
}

/// Directions are drawn as often as the density says, over every part of the hemisphere, and half of them where half of the light
/// comes from, less what is taken to be even.
#[test]
fn directions_are_drawn_by_their_density() {
    let guide = guide_of(Vec3::Z, (0..1000).map(spotted));
    let guidance = guide.at(Vec3::new(0.5, 0.5, 0.0), Vec3::Z).unwrap();
    const SIDE: usize = 8;
    let place = |direction: Vec3| {
        let [x, y] = warp::square_of_hemisphere(direction).to_array().map(|at| (at * SIDE as f32) as usize);
        y.min(SIDE - 1) * SIDE + x.min(SIDE - 1)
    };
    const DRAWN: u32 = 200_000;
    let [mut drawn, mut expected] = [[0.0f64; SIDE * SIDE]; 2];
    let mut spot = 0.0;
    for number in 0..DRAWN {
        let [u, v, s, t] = point(11, number);
        let by_light = guidance.draw(Vec2::new(u, v));
        assert!(by_light.is_normalized() && by_light.z >= 0.0, "{by_light}");
        drawn[place(by_light)] += 1.0 / f64::from(DRAWN);
        spot += f64::from(u8::from(by_light.dot(Vec3::new(0.62, 0.02, 0.78)) > 0.995)) / f64::from(DRAWN);
        // Even in the cosine, each counts for the density over that of the cosine.
        let even = warp::cosine_hemisphere([s, t]);
        let density = guidance.density(even) / warp::cosine_hemisphere_pdf(even.z);
        expected[place(even)] += f64::from(density) / f64::from(DRAWN);
    }
    for (drawn, expected) in drawn.iter().zip(expected) {
        assert!((drawn - expected).abs() < 0.003 + 0.03 * expected, "{drawn} for {expected}");
    }
    assert!((0.35..0.6).contains(&spot), "{spot}");
    // Guided and not, together, are a density over the whole hemisphere as well.
    let ratios = (0..DRAWN).map(|number| {
        let [u, v, ..] = point(13, number);
        let wi = warp::cosine_hemisphere([u, v]);
        f64::from(guidance.ratio(wi, wi.z))
    });
    let mean = ratios.sum::<f64>() / f64::from(DRAWN);
    assert!((mean - 1.0).abs() < 0.01, "{mean}");
}

/// Of even light photons say nothing, nor where one bright photon is among many faint ones, and little of light that is nearly even.
#[test]
fn chance_and_single_photons_say_little() {
    let even = |number: u32| {
        let [_, _, u, v] = point(5, number);
        (on_floor(number), on_floor(number) + warp::cosine_hemisphere([u, v]))
    };
    for count in [1, 2, 100, 1000, 20_000] {
        let guide = guide_of(Vec3::Z, (0..count).map(even));
        assert!(
            guide.quarters.is_empty() && guide.at(Vec3::new(0.5, 0.5, 0.0), Vec3::Z).is_none(),
            "{count}"
        );
        assert_eq!(guide.told.len(), count as usize, "{count}");
    }
    // Nor is it even where a little comes through a spot of two degrees, whatever parts of the hemisphere that lies in.
    for (number, towards) in
        [Vec3::new(0.3, 0.5, 0.8), Vec3::Z, Vec3::X + 0.1 * Vec3::Z].into_iter().enumerate()
    {
        let frame = Frame::around(towards.normalize());
        let spot = |photon: u32| {
            let [_, _, u, v] = point(40 + number as u64, photon);
            let cosine = warp::cosine_hemisphere([u, v]);
            let within = frame.to_world(Vec3::new(0.03 * (u - 0.5), 0.03 * (v - 0.5), 1.0).normalize());
            let p = on_floor(photon);
            (p, p + if photon.is_multiple_of(14) { within } else { cosine })
        };
        let guide = guide_of(Vec3::Z, (0..250).map(spot));
        assert!(guide.at(Vec3::new(0.5, 0.5, 0.0), Vec3::Z).is_some(), "{towards}");
    }
    // A quarter of it comes from an eighth of the hemisphere.
    let uneven = |number: u32| {
        let [_, _, u, v] = point(5, number);
        let from = warp::cosine_hemisphere([if number.is_multiple_of(4) { 0.125 * u } else { u }, v]);
        (on_floor(number), on_floor(number) + from)
    };
    let of_chance = guide_of(Vec3::Z, (0..1000).map(uneven));
    let faint = |number: u32| {
        let (to, from) = uneven(number);
        let flux_w = if number == 4 { 1e6 } else { 1.0 };
        Flight { from, to, normal: Vec3::Z, flux_w, is_focused: false }
    };
    let of_one = Guide::of((0..200).map(faint).collect()).unwrap();
    assert!(of_one.at(Vec3::new(0.5, 0.5, 0.0), Vec3::Z).is_none());
    let guidance = of_chance.at(Vec3::new(0.5, 0.5, 0.0), Vec3::Z).unwrap();
    let mut squares = 0.0;
    for number in 0..4096 {
        let [u, v, ..] = point(17, number);
        let wi = warp::cosine_hemisphere([u, v]);
        let ratio = guidance.ratio(wi, wi.z);
        assert!((0.5..6.0).contains(&ratio), "{ratio}");
        squares += f64::from(ratio).powi(-1) / 4096.0;
    }
    // Mean square of what even light counts for, over the square of its mean.
    assert!(squares < 1.15, "{squares}");
}

/// Photons of another wall, of the other side of this one and of far away say nothing here.
#[test]
fn every_place_and_side_has_photons_of_its_own() {
    let (near, far) = (Vec3::new(0.3, 0.0, 0.9), Vec3::new(-0.3, 0.0, 0.9));
    let mut flights = Vec::new();
    for number in 0..4000 {
        let p = on_floor(number);
        let [n, position, from] = match number % 4 {
            0 => [Vec3::Z, p, near],
            1 => [Vec3::Z, p + 10.0 * Vec3::X, far],
            2 => [Vec3::NEG_Z, p, -near],
            _ => [Vec3::X, Vec3::new(0.0, p.y, p.x), Vec3::X],
        };
        flights.push(Flight {
            from: position + from,
            to: position,
            normal: n,
            flux_w: 1.0,
            is_focused: false,
        });
    }
    let count = flights.len();
    let guide = Guide::of(flights).unwrap();
    for (p, n, from) in [
        (Vec3::new(0.5, 0.5, 0.0), Vec3::Z, near),
        (Vec3::new(10.5, 0.5, 0.0), Vec3::Z, far),
        (Vec3::new(0.5, 0.5, 0.0), Vec3::NEG_Z, -near),
        (Vec3::new(0.0, 0.5, 0.5), Vec3::X, Vec3::X),
    ] {
        let guidance = guide.at(p, n).unwrap();
        // Those of other places began elsewhere.
        let began = |told: Vec3| (told - p).distance(from) < 1.5;
        assert!(guide.flights_at(p, n).iter().all(|(told, _)| began(*told)), "{p} {n}");
        let many = (0..1000).filter(|number| {
            let [u, v, ..] = point(19, *number);
            guidance.draw(Vec2::new(u, v)).dot(from.normalize()) > 0.99
        });
        assert!(many.count() > 800, "{p} {n}");
    }
    // Nothing fell on the back of the wall, nor far from all.
    assert!(guide.at(Vec3::new(0.0, 0.5, 0.5), Vec3::NEG_X).is_none());
    assert!(guide.at(Vec3::new(0.5, 100.0, 0.0), Vec3::Z).is_none());
    assert!(guide.bytes() > count * size_of::<(Vec3, f32)>());
}

/// A floor that most fall on, in one plane below a gallery, has as many leaves as any other; floor and wall are told apart also where
/// normals are shorter than one by rounding.
#[test]
fn planes_below_others_are_halved_too() {
    let side = |number: u32| Vec3::new(0.3 - 0.6 * f32::from(u8::from(number.is_multiple_of(2))), 0.0, 0.9);
    let photon = |number: u32| {
        let height = if number % 5 < 3 { 0.0 } else { 9.0 };
        let to = 4.0 * on_floor(number) + height * Vec3::Z;
        (to, to + if height > 0.0 { side(number) } else { Vec3::new(0.9, 0.0, 0.1) })
    };
    let guide = guide_of(Vec3::Z, (0..20_000).map(photon));
    let leaf = guide.leaf_at(Vec3::new(1.0, 1.0, 0.0), Vec3::Z, Need::Any).unwrap();
    assert!(leaf.high.x - leaf.low.x < 2.0, "{leaf:?}");
    assert!(guide.leaves.len() > 20_000 / LEAF_FLIGHTS_MAX, "{}", guide.leaves.len());
    let short = 0.999_999_9;
    let on_edge = |number: u32| {
        let p = on_floor(number);
        let (to, normal) =
            if number.is_multiple_of(2) { (p, Vec3::Z * short) } else { (Vec3::new(0.0, p.y, p.x), Vec3::X) };
        Flight { from: to + Vec3::ONE, to, normal, flux_w: 1.0, is_focused: false }
    };
    let guide = Guide::of((0..4000).map(on_edge).collect()).unwrap();
    for (p, n) in [(Vec3::new(0.02, 0.5, 0.0), Vec3::Z), (Vec3::new(0.0, 0.5, 0.02), Vec3::X)] {
        assert!(guide.leaf_at(p, n, Need::Any).unwrap().frame.n.dot(n) > 0.99, "{p} {n}");
    }
}

/// However many photons fall on one point, on points in a row or without light, sorting ends, and limits hold.
#[test]
fn odd_photons_are_sorted_too() {
    let one = guide_of(Vec3::Z, (0..10_000).map(|_| (Vec3::ONE, Vec3::ONE + Vec3::Z)));
    let guidance = one.at(Vec3::ONE, Vec3::Z).unwrap();
    assert_eq!(one.flights_at(Vec3::ONE, Vec3::Z).len(), LEAF_FLIGHTS_MAX);
    assert!(guidance.draw(Vec2::ONE).is_normalized() && guidance.density(Vec3::Z).is_finite());
    assert!(guidance.ratio(Vec3::X, 0.0).is_finite());
    // Each ten times as far as the one before.
    let row = guide_of(
        Vec3::Z,
        (0..400u32).map(|number| {
            (
                Vec3::X * 10f32.powi(number as i32 % 30 - 10),
                Vec3::new(0.0, (number as f32).sin(), 1.0).normalize(),
            )
        }),
    );
    assert!(row.at(Vec3::X, Vec3::Z).is_some());
    let of =
        |flux_w: f32| Flight { from: Vec3::ZERO, to: Vec3::ONE, normal: Vec3::Z, flux_w, is_focused: false };
    assert!(Guide::of(vec![of(0.0), of(f32::INFINITY), of(f32::NAN)]).is_none());
    let many = guide_of(Vec3::Z, (0..300_000).map(spotted));
    let kept = many.told.len();
    assert!(kept <= FLIGHTS_MAX && kept > FLIGHTS_MAX * 9 / 10, "{kept}");
    assert!(many.leaves.len() < 4 * FLIGHTS_MAX / LEAF_FLIGHTS_MAX, "{}", many.leaves.len());
}

/// Light that only mirrors and glass sent on says where paths find light, and nothing of what records of irradiance hold.
#[test]
fn focused_light_guides_paths_alone() {
    let lamp = Vec3::new(0.0, 0.6, 0.8);
    let flight = |number: u32| {
        let to = on_floor(number);
        let is_focused = number.is_multiple_of(2);
        let from =
            to + if is_focused { lamp } else { warp::cosine_hemisphere([0.1, 0.2 + to.x.fract() * 0.1]) };
        Flight { from, to, normal: Vec3::Z, flux_w: 1.0, is_focused }
    };
    let guide = Guide::of((0..4000).map(flight).collect()).unwrap();
    let p = on_floor(8);
    assert!(guide.at(p, Vec3::Z).unwrap().density(lamp) > 5.0);
    assert!(!guide.flights_at(p, Vec3::Z).is_empty());
    assert_eq!(guide.told.len(), 2000);
    // All of a leaf may be so.
    let focused = (0..4000).map(|number| Flight { is_focused: true, ..flight(number) });
    let guide = Guide::of(focused.collect()).unwrap();
    assert!(guide.flights_at(p, Vec3::Z).is_empty() && guide.at(p, Vec3::Z).is_some());
}
