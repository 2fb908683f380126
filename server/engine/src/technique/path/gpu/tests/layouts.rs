//! Rust and WGSL mean the same bytes and the same numbers.

use std::mem::offset_of;

use lumicast_shaders::{
    CAUSTICS_PLACE, FILM_UNJOINED, GATHER_BEGIN, IRRADIANCE_RESOLVE, IRRADIANCE_SEEN, IRRADIANCE_SPLAT,
    IRRADIANCE_SPLAT_TILES, PATH_HAND_OVER, PATH_OCCLUDED, PATH_SHADE, PATH_SHADE_BY_OCTREE, PATH_TURN,
    PHOTONS_BEGIN, PHOTONS_FLY, PLANES, PROOF_CONSTANTS,
};

use super::{
    super::handed::{
        GpuHandedPath, GpuPath, IS_BY_GLASS, IS_BY_MIRRORS, IS_CLOUDED, IS_NEAR, NEAR_COUNT_SHIFT,
    },
    super::lookouts::GpuPlane,
    super::photons::{BOUNCE_BITS, ESCAPED, GpuKeptPhoton, GpuSentPhoton},
    super::sketch::{CELL_WORDS, GpuSketch, GpuWindows, PLACE_WORDS},
    super::splats::{GpuPicture, GpuSeenPoint, GpuTileSlice},
    gather::{GpuGatherRay, GpuRaySample},
    splats::{SEES_DIFFUSE, SEES_NOTHING, SEES_OTHER},
    *,
};
use crate::{
    gpu::{
        FrameOnCard, ShowOnCard,
        tests::{assert_same_layout, layout, numbers_of},
    },
    scene::TextureSlot,
    technique::{
        GpuLightSet, GpuOctreeHeader, PHOTON_MARK_BITS, PHOTON_MARK_DIFFUSE, PHOTON_MARK_FRONT,
        octree::GatherOnCard,
    },
    transport::{
        self, GpuLight, GpuLightNode, GpuMaterial, GpuPlacement, GpuSceneHeader, GpuTextureUse, Passed,
    },
};

/// Planes lie in WGSL as in Rust.
#[test]
fn planes_lie_alike_in_rust_and_wgsl() {
    let source = PLANES.source(PROOF_CONSTANTS);
    assert_same_layout!(
        &source,
        "Plane",
        GpuPlane {
            origin,
            half_width,
            right,
            half_height,
            up,
            nearest_m,
            back,
            left_instance,
            left_triangle,
            padding_0,
            padding_1,
            padding_2,
        }
    );
}

/// So do sketches of caustics, in what counts them and in what looks them up.
#[test]
fn sketches_lie_alike_in_rust_and_wgsl() {
    for step in [&CAUSTICS_PLACE, &PATH_SHADE] {
        let source = step.source(PROOF_CONSTANTS);
        assert_same_layout!(
            &source,
            "Sketch",
            GpuSketch {
                origin,
                half_width,
                right,
                half_height,
                up,
                is_perspective,
                back,
                width_count,
                width,
                height,
                margin,
                photon_count,
                places_at,
                cell_count,
                entries_at,
                padding_0,
                windows,
            }
        );
        assert_same_layout!(
            &source,
            "Windows",
            GpuWindows { half_px, cell_log2, columns, weights_at, cells_at, padding_0, padding_1, padding_2 }
        );
        let numbers = numbers_of(&source);
        for (name, value) in [("SKETCH_PLACE_WORDS", PLACE_WORDS), ("SKETCH_CELL_WORDS", CELL_WORDS)] {
            assert_eq!(numbers[name], f64::from(value), "{name}");
        }
    }
}

/// So do pictures that records are splatted onto.
#[test]
fn pictures_of_records_lie_alike_in_rust_and_wgsl() {
    let steps = [&IRRADIANCE_SEEN, &IRRADIANCE_RESOLVE, &IRRADIANCE_SPLAT_TILES]
        .map(|step| step.source(PROOF_CONSTANTS));
    for source in steps.into_iter().chain([IRRADIANCE_SPLAT.source(PROOF_CONSTANTS)]) {
        assert_same_layout!(
            &source,
            "Picture",
            GpuPicture {
                origin,
                half_width,
                right,
                half_height,
                up,
                width,
                back,
                height,
                row,
                cache,
                padding_0,
                padding_1,
            }
        );
        assert_same_layout!(
            &source,
            "SeenPoint",
            GpuSeenPoint { position, sees, normal, padding_0, n_geo, padding_1 }
        );
        let numbers = numbers_of(&source);
        for (name, number) in
            [("SEES_NOTHING", SEES_NOTHING), ("SEES_OTHER", SEES_OTHER), ("SEES_DIFFUSE", SEES_DIFFUSE)]
        {
            assert_eq!(numbers[name], f64::from(number), "{name}");
        }
    }
    assert_same_layout!(
        &IRRADIANCE_SPLAT_TILES.source(PROOF_CONSTANTS),
        "TileSlice",
        GpuTileSlice { first_tile, end_tile, first_record, end_record, begins, ends, padding_0, padding_1 }
    );
    let numbers = numbers_of(&IRRADIANCE_SPLAT.source(PROOF_CONSTANTS));
    assert_eq!(numbers["SPHERE_SLACK_PX"], f64::from(crate::technique::path::view::SPHERE_SLACK_PX));
}

/// The scene's structs lie in WGSL as in Rust.
#[test]
fn structs_of_scenes_lie_alike_in_rust_and_wgsl() {
    let source = PATH_SHADE.source(PROOF_CONSTANTS);
    assert_same_layout!(
        &source,
        "SceneHeader",
        GpuSceneHeader {
            directional_count,
            environment_kind,
            light_node_count,
            trails_at,
            environment_radiance,
            environment_rotation_rad,
            environment_at,
            environment_width,
            environment_height,
            environment_sums_at,
            directional_at,
            environment_flags,
            padding_0,
            padding_1,
        }
    );
    assert_same_layout!(
        &source,
        "Placement",
        GpuPlacement {
            render_from_mesh_x,
            normals_at,
            render_from_mesh_y,
            tangents_at,
            render_from_mesh_z,
            texcoords_0_at,
            normal_from_mesh_x,
            texcoords_1_at,
            normal_from_mesh_y,
            colors_at,
            normal_from_mesh_z,
            corners_at,
            centre_in_render,
            positions_at,
            faces_at,
            primitives_at,
            primitive_count,
            flags,
            runs_at,
            run_count,
            padding_0,
            padding_1,
        }
    );
    assert_same_layout!(
        &source,
        "TextureUse",
        GpuTextureUse { uv_x, uv_y, uv_offset, texels_at, width, height, flags, padding_0, padding_1 }
    );
    assert_same_layout!(
        &source,
        "Material",
        GpuMaterial {
            base_color,
            alpha,
            emission,
            alpha_cutoff,
            specular_color,
            specular,
            attenuation_color,
            attenuation_distance_m,
            metallic,
            roughness,
            ior,
            transmission,
            normal_scale,
            flags,
            padding_0,
            padding_1,
            textures,
        }
    );
}

/// So do those of lights.
#[test]
fn structs_of_lights_lie_alike_in_rust_and_wgsl() {
    let source = PATH_SHADE_BY_OCTREE.source(PROOF_CONSTANTS);
    assert_same_layout!(
        &source,
        "Light",
        GpuLight {
            position,
            kind,
            intensity,
            instance,
            axis,
            triangle,
            cos_inner,
            cos_outer,
            area_m2,
            is_two_sided,
        }
    );
    assert_same_layout!(
        &source,
        "LightNode",
        GpuLightNode { low, next, high, flags, axis, intensity, cos_normals, cos_emission, end, padding }
    );
    assert_same_layout!(
        &source,
        "OctreeHeader",
        GpuOctreeHeader {
            low,
            cell_m,
            cells,
            depth,
            per_sheet_m2,
            first_sets_at,
            blur_max_m,
            lost_blurs,
            lost_max_m,
            behind_share,
            within_share,
            is_nested,
            padding_0,
            padding_1,
            inner,
        }
    );
    assert_same_layout!(
        &source,
        "LightSet",
        GpuLightSet {
            normal,
            plane_m,
            first_vdl,
            first_caustic_vdl,
            end_vdl,
            reach,
            caustic_reach,
            blur_m,
            evenness,
            flags,
            wall,
        }
    );
}

/// So do those of paths, and buffers whose structs only steps know are as large as these.
#[test]
fn structs_of_paths_lie_alike_in_rust_and_wgsl() {
    let source = PATH_SHADE.source(PROOF_CONSTANTS);
    assert_same_layout!(
        &source,
        "PassHeader",
        GpuPassHeader {
            origin,
            half_width,
            right,
            half_height,
            up,
            is_perspective,
            back,
            width,
            seed_key,
            sequence,
            index,
            height,
            first_pixel,
            path_count,
            capacity,
            traced,
            bounces_end,
            brought,
            shadowed_from,
            dimmed,
            focus,
        }
    );
    assert_same_layout!(
        &source,
        "PixelSample",
        GpuPixelSample {
            emitted,
            depth_m,
            direct,
            albedo_red,
            caustic,
            albedo_green,
            indirect,
            albedo_blue,
            specular,
            is_shining,
            normal,
            beyond_normal,
            beyond_albedo,
            padding_0,
        }
    );
    assert_same_layout!(
        &source,
        "Counters",
        GpuCounters {
            parity,
            ray_count,
            next_ray_count,
            shadow_count,
            next_shadow_count,
            rays,
            shadow_rays,
            kept,
            shadows_at,
            next_left_count,
            pane_rays,
        }
    );
    let begin_ray = GATHER_BEGIN.source(PROOF_CONSTANTS);
    assert_same_layout!(
        &begin_ray,
        "GatherRay",
        GpuGatherRay { origin, left_instance, direction, left_triangle, key, index, padding_0 }
    );
    assert_same_layout!(
        &begin_ray,
        "RaySample",
        GpuRaySample { radiance, distance_m, index, padding_0, padding_1, padding_2 }
    );
    assert_same_layout!(
        &PHOTONS_BEGIN.source(PROOF_CONSTANTS),
        "SentPhoton",
        GpuSentPhoton {
            origin,
            left_instance,
            direction,
            left_triangle,
            weight,
            number,
            key,
            padding_0,
            padding_1,
        }
    );
    assert_same_layout!(
        &PHOTONS_FLY.source(PROOF_CONSTANTS),
        "KeptPhoton",
        GpuKeptPhoton { b1, b2, triangle, place, weight, leaving, direction, name }
    );
    let numbers = numbers_of(&FILM_UNJOINED.source(PROOF_CONSTANTS));
    let word = |at: usize| f64::from(at as u32 / 4);
    for (name, at) in [
        ("SAMPLE_WORDS", size_of::<GpuPixelSample>()),
        ("CLASS_WORDS", offset_of!(GpuPixelSample, direct)),
        ("DEPTH_WORD", offset_of!(GpuPixelSample, depth_m)),
        ("NORMAL_WORD", offset_of!(GpuPixelSample, normal)),
        ("SHINING_WORD", offset_of!(GpuPixelSample, is_shining)),
        ("BEYOND_WORD", offset_of!(GpuPixelSample, beyond_albedo)),
        ("BEYOND_NORMAL_WORD", offset_of!(GpuPixelSample, beyond_normal)),
    ] {
        assert_eq!(numbers[name], word(at), "{name}");
    }
    for (name, class) in ["EMITTED", "BY_SPECULAR"].into_iter().zip(PathClass::SEEN) {
        assert_eq!(numbers[name], f64::from(class as u32), "{name}");
        let of_class = [offset_of!(GpuPixelSample, emitted), offset_of!(GpuPixelSample, specular)];
        assert!(of_class.contains(&(offset_of!(GpuPixelSample, direct) * class as usize)), "{name}");
    }
    assert_eq!(numbers["CLASS_COUNT"], PathClass::COUNT as f64);
    let [red, green, blue] = [
        offset_of!(GpuPixelSample, albedo_red),
        offset_of!(GpuPixelSample, albedo_green),
        offset_of!(GpuPixelSample, albedo_blue),
    ];
    let of_class = offset_of!(GpuPixelSample, direct);
    assert_eq!((numbers["ALBEDO_WORD"], [green, blue]), (word(red), [red + of_class, red + 2 * of_class]));
    let hand_over = PATH_HAND_OVER.source(PROOF_CONSTANTS);
    assert_same_layout!(
        &hand_over,
        "Path",
        GpuPath {
            origin,
            medium,
            direction,
            class_so_far,
            throughput,
            bounce,
            last_position,
            last_pdf,
            last_n,
            eta_squared,
            left_instance,
            left_triangle,
            key,
            lost_m,
            passing,
            since_gathered,
            padding_0,
        }
    );
    assert_same_layout!(
        &hand_over,
        "HandedPath",
        GpuHandedPath { path, slot, padding_0, padding_1, padding_2 }
    );
    for (name, byte_count) in [("Hit", HIT_BYTES), ("Shadow", SHADOW_BYTES)] {
        assert_eq!(u64::from(layout(&source, name).1), byte_count, "{name}");
    }
    let (sizes, byte_count) = layout(&PATH_TURN.source(PROOF_CONSTANTS), "Dispatch");
    assert_eq!(u64::from(byte_count), DISPATCH_BYTES);
    assert_eq!((sizes[3].name.as_str(), u64::from(sizes[3].offset)), ("shadow_rays_x", SHADOW_SIZES_AT));
}

/// Numbers that both languages write down for themselves are the same ones.
#[test]
fn numbers_are_the_same_in_rust_and_wgsl() {
    let numbers = numbers_of(&PATH_SHADE_BY_OCTREE.source(PROOF_CONSTANTS));
    let floats = [
        ("PI", std::f32::consts::PI),
        ("TAU", std::f32::consts::TAU),
        ("INVERSE_PI", std::f32::consts::FRAC_1_PI),
        ("ONE_LESS", 1.0 - f32::EPSILON),
        ("LEAST_NORMAL", f32::MIN_POSITIVE),
        ("LEVEL", transport::LEVEL),
        ("IMPORTANCE_MAX", transport::IMPORTANCE_MAX),
        ("FEW", transport::FEW as f32),
    ];
    for (name, value) in floats {
        assert_eq!(numbers[name], f64::from(value), "{name}");
    }
    for (name, value) in [
        ("IS_NEAR", IS_NEAR),
        ("IS_BY_MIRRORS", IS_BY_MIRRORS),
        ("IS_CLOUDED", IS_CLOUDED),
        ("IS_BY_GLASS", IS_BY_GLASS),
        ("NEAR_COUNT_SHIFT", NEAR_COUNT_SHIFT),
    ] {
        assert_eq!(numbers[name], f64::from(value), "{name}");
    }
    let classes = ["EMITTED", "DIRECT", "CAUSTIC", "INDIRECT", "BY_SPECULAR"];
    for (name, class) in classes.into_iter().zip(PathClass::ALL) {
        assert_eq!(numbers[name], f64::from(class as u32), "{name}");
    }
    let slots = [
        ("BASE_COLOR", TextureSlot::BaseColor),
        ("METALLIC_ROUGHNESS", TextureSlot::MetallicRoughness),
        ("NORMAL", TextureSlot::Normal),
        ("EMISSION", TextureSlot::Emission),
        ("SPECULAR", TextureSlot::Specular),
        ("SPECULAR_COLOR", TextureSlot::SpecularColor),
        ("TRANSMISSION", TextureSlot::Transmission),
    ];
    for (name, slot) in slots {
        assert_eq!(numbers[name], f64::from(slot as u32), "{name}");
    }
    assert_eq!(numbers["ABSENT"], f64::from(u32::MAX));
    let of_focus = [
        ("IS_ASKING", IS_ASKING),
        ("SHOWS_CAUSTICS", SHOWS_CAUSTICS),
        ("LEAVES_SUNS", LEAVES_SUNS),
        ("LEAVES_SKY", LEAVES_SKY),
    ];
    for (name, flag) in of_focus {
        assert_eq!(numbers[name], f64::from(flag), "{name}");
    }
    let numbers = numbers_of(&PATH_OCCLUDED.source(PROOF_CONSTANTS));
    let of_panes = [
        ("BOUNDARIES_MAX", f64::from(Passed::BOUNDARIES_MAX)),
        ("STRAIGHT", f64::from(Passed::STRAIGHT)),
        ("SAME_INDEX", f64::from(Passed::SAME_INDEX)),
    ];
    for (name, number) in of_panes {
        assert!((numbers[name] - number).abs() <= 1e-6 * number, "{name}");
    }
    let numbers = numbers_of(&PHOTONS_FLY.source(PROOF_CONSTANTS));
    let of_photons = [
        ("MARK_BITS", PHOTON_MARK_BITS),
        ("MARK_FRONT", PHOTON_MARK_FRONT),
        ("MARK_DIFFUSE", PHOTON_MARK_DIFFUSE),
        ("BOUNCE_BITS", BOUNCE_BITS),
        ("ESCAPED", ESCAPED),
    ];
    for (name, number) in of_photons {
        assert_eq!(numbers[name], f64::from(number), "{name}");
    }
}

/// Steps are compiled with every constant that the proof of the shaders names: paths with those of scenes and shading, pictures and the
/// noise filter with theirs.
#[test]
fn every_constant_of_the_proof_is_prepended() {
    let Some(gpu) = shared() else { return };
    let world = World::prepare(Arc::new(crate::scene::samples::boxes().unwrap()));
    let on_card = GpuWorld::new(&gpu.session().unwrap(), &PackedScene::of(&world)).unwrap();
    let mut names: Vec<_> = on_card
        .constants_of_shade(PathStart::Rays, Shading::default())
        .into_iter()
        .chain(ShowOnCard::constants())
        .chain(FrameOnCard::constants())
        .chain(GatherOnCard::constants())
        .map(|(name, _)| name)
        .collect();
    let mut proved: Vec<_> = PROOF_CONSTANTS.iter().map(|(name, _)| *name).collect();
    names.sort_unstable();
    // All are compiled for workgroups.
    names.dedup();
    proved.sort_unstable();
    assert_eq!(names, proved);
}
