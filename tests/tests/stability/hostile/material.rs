//! Hostile materials: glass in glass, glass that touches, no loss of light at all or all of it, near-mirrors.

use lumicast_engine::math::Rgb;
use lumicast_engine::scene::Material;
use lumicast_engine::scene::samples::{cuboid, sphere};

use super::case::Case;
use super::hostility::Hostility;
use super::rooms::somewhere;
use crate::draft::{glass, matt, metal, v};

pub(super) const ALL: [Hostility; 14] = [
    Hostility::mild("glass in glass", |case, random| {
        let at = somewhere(random);
        for (radius, ior) in [(0.4, 1.5), (0.3, 1.33), (0.2, 1.0), (0.1, 2.4)] {
            case.draft.thing("shell", glass(ior), |id| sphere(at, radius, 12, id));
        }
    }),
    Hostility::mild("glass that touches glass", |case, random| {
        let at = somewhere(random);
        for (name, ior, from, to) in [("left", 1.5, -0.3, 0.0), ("right", 1.7, 0.0, 0.3)] {
            case.draft
                .thing(name, glass(ior), |id| cuboid(at + v(from, -0.2, -0.2), at + v(to, 0.2, 0.2), id));
        }
    }),
    Hostility::mild("glass on the floor", |case, _| {
        case.draft.thing("slab", glass(1.5), |id| cuboid(v(-0.6, 0.0, -0.9), v(0.2, 0.3, 0.0), id));
    }),
    Hostility::mild("glass that does not refract", |case, random| {
        let at = somewhere(random);
        case.draft.thing("air", glass(1.0), |id| sphere(at, 0.4, 12, id));
    }),
    Hostility::mild("diamond", |case, random| {
        let at = somewhere(random);
        case.draft.thing("diamond", glass(2.4), |id| cuboid(at - 0.3, at + 0.3, id));
    }),
    Hostility::mild("ink", |case, random| {
        let at = somewhere(random);
        let attenuation_distance_m = 10f32.powf(random.between(-6.0, 0.0) as f32);
        let attenuation_color = Rgb::new(0.0, 0.5, 1.0);
        let ink = Material { attenuation_color, attenuation_distance_m, ..glass(1.4) };
        case.draft.thing("ink", ink, |id| sphere(at, 0.4, 12, id));
    }),
    Hostility::harsh("white that loses nothing", |case, _| {
        every_matt(case, |material| material.base_color = Rgb::WHITE);
    }),
    Hostility::mild("black", |case, _| every_matt(case, |material| material.base_color = Rgb::BLACK)),
    Hostility::harsh("mirrors all around", |case, random| {
        let albedo = [0.5, 0.9, 1.0][random.below(3)];
        if let Some(walls) = case.draft.things.first_mut() {
            walls.material = Material { emission: walls.material.emission, ..metal(albedo, 0.0) };
        }
    }),
    Hostility::harsh("walls of glass", |case, random| {
        let ior = [1.0, 1.3, 2.4][random.below(3)];
        if let Some(walls) = case.draft.things.first_mut() {
            walls.material = Material { emission: walls.material.emission, ..glass(ior) };
        }
    }),
    Hostility::harsh("nearly a mirror", |case, random| {
        let roughness = 10f32.powf(random.between(-4.0, -0.7) as f32);
        if let Some(at) = (!case.draft.things.is_empty()).then(|| random.below(case.draft.things.len())) {
            case.draft.things[at].material = metal(0.95, roughness);
        }
    }),
    Hostility::harsh("half glass", |case, _| {
        if let Some(last) = case.draft.things.last_mut() {
            last.material.transmission = 0.5;
            last.material.roughness = 0.0;
        }
    }),
    Hostility::mild("coats on everything", |case, random| {
        let roughness = random.between(0.3, 1.0) as f32;
        every_matt(case, |material| (material.specular, material.roughness) = (1.0, roughness));
    }),
    Hostility::harsh("index without bound", |case, random| {
        let at = somewhere(random);
        let coat = Material { ior: 1e6, ..matt(0.5) };
        case.draft.thing("dense", Material { specular: 1.0, ..coat }, |id| sphere(at, 0.3, 12, id));
        case.draft.thing("denser", glass(1e4), |id| sphere(at + v(0.0, 0.1, 0.5), 0.2, 12, id));
    }),
];

fn every_matt(case: &mut Case, change: impl Fn(&mut Material)) {
    let things = case.draft.things.iter_mut().map(|thing| &mut thing.material);
    things.filter(|material| material.transmission == 0.0 && material.metallic == 0.0).for_each(change);
}
