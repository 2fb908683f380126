use std::sync::Arc;

use glam::Vec3;

use super::*;
use crate::{
    math::{Rgb, sobol::point},
    technique::irradiance::{
        IrradianceSettings, horizon,
        record::{self, Facing},
    },
};

/// Records all over, of many sizes.
fn cache_of(count: u32, reach_m: f32) -> IrradianceCache {
    let mut cache = IrradianceCache::new(IrradianceSettings::default(), None);
    for number in 0..count {
        let [x, y, z, size] = point(71, number);
        let [turn, ..] = point(72, number);
        let normal = Vec3::new(turn - 0.5, 1.0, 0.25 - turn * turn).normalize();
        cache.insert(Record {
            irradiance: Rgb::new(x, y, z),
            reach_min_m: reach_m * (size * 9.0).exp2(),
            turning: [Vec3::X, Vec3::Y, Vec3::Z],
            moving: [Vec3::Z; 3],
            ..Record::dark_in_the_open((Vec3::new(x, y, z) - 0.5) * 20.0, Facing::flat(normal), 0.0)
        });
    }
    cache
}

/// What the table of a packed cache names at a point, as the card looks for it.
fn found(packed: &PackedRecords, number: usize, p: Vec3) -> Vec<u32> {
    let words = &packed.words;
    let [_, _, levels_at, levels_end, table_at, mask] =
        std::array::from_fn(|word| words[CACHES_AT + CACHE_WORDS * number + word]);
    let mut found = Vec::new();
    for level_at in (levels_at..levels_end).step_by(2) {
        let level = words[level_at as usize] as i32;
        let per_cell = f32::from_bits(words[level_at as usize + 1]);
        let at = (p * per_cell).floor().as_ivec3();
        let mut place = hash_of_cell(level, at) & mask;
        loop {
            let cell = &words[table_at as usize + CELL_WORDS * place as usize..][..CELL_WORDS];
            if cell[5] == 0 {
                break;
            }
            if cell[..4] == [level as u32, at.x as u32, at.y as u32, at.z as u32] {
                found.extend(&words[cell[4] as usize..][..cell[5] as usize]);
                break;
            }
            place = (place + 1) & mask;
        }
    }
    found
}

/// The table of each cache names what its index does, over twelve orders of magnitude, also where two caches are packed and where there
/// are no records at all.
#[test]
fn tables_name_what_indices_name() {
    for scale in [1e-6, 1e-2, 1.0, 1e6] {
        let rougher = Arc::new(cache_of(40, scale));
        let cache = IrradianceCache { rougher: Some(Arc::clone(&rougher)), ..cache_of(300, scale * 0.1) };
        let packed = cache.pack_records();
        assert_eq!((packed.words[0], packed.records.len()), (2, 340));
        assert_eq!(packed.counts, [300, 40]);
        for number in 0..2_000 {
            let [x, y, z, _] = point(73, number);
            let p = (Vec3::new(x, y, z) - 0.5) * 24.0;
            let expected = |cache: &IrradianceCache, first: u32| -> Vec<u32> {
                cache.index.around(p).map(|record| first + record).collect()
            };
            assert_eq!(found(&packed, 0, p), expected(&cache, 0), "{p} at {scale}");
            assert_eq!(found(&packed, 1, p), expected(&rougher, 300), "{p} at {scale}");
        }
    }
    let empty = IrradianceCache::new(IrradianceSettings::default(), None).pack_records();
    assert_eq!(found(&empty, 0, Vec3::ZERO), []);
}

/// No number that cards may not meet, also of records that count nowhere, and no gradients where none count.
#[test]
fn packed_records_are_finite() {
    let mut settings = IrradianceSettings::default();
    settings.weighing.has_gradients = false;
    let mut cache = IrradianceCache::new(settings, None);
    let nowhere = Record { radius_m: 0.0, reach_min_m: 0.0, ..cache_of(1, 1.0).records()[0] };
    cache.insert(nowhere);
    for record in cache.pack_records().records {
        let numbers = [record.reach_m, record.way_share, record.nearest_m];
        assert!(numbers.iter().all(|number| number.is_finite()) && record.reach_m > 0.0, "{record:?}");
        assert_eq!((record.turning_red, record.moving_blue), ([0.0; 3], [0.0; 3]));
    }
    let facing = Facing::flat(Vec3::Y);
    assert_eq!(nowhere.weight(nowhere.position + Vec3::X * 1e-3, &facing, &settings.weighing), 0.0);
}

/// Rust and WGSL mean the same bytes and the same numbers.
#[cfg(feature = "gpu")]
#[test]
fn records_lie_alike_in_rust_and_wgsl() {
    use crate::gpu::tests::{assert_same_layout, numbers_of};
    use lumicast_shaders::{PATH_SHADE_BY_RECORDS, PROOF_CONSTANTS};

    let source = PATH_SHADE_BY_RECORDS.source(PROOF_CONSTANTS);
    assert_same_layout!(
        &source,
        "Record",
        GpuRecord {
            position,
            reach_m,
            normal,
            way_share,
            n_geo,
            nearest_m,
            irradiance,
            coat_rise,
            turning_red,
            ways_0,
            turning_green,
            ways_1,
            turning_blue,
            ways_2,
            moving_red,
            rises_0,
            moving_green,
            rises_1,
            moving_blue,
            rises_2,
        }
    );
    let numbers = numbers_of(&source);
    let expected = [
        ("HAS_BASE", f64::from(HAS_BASE)),
        ("HAS_CAUSTICS", f64::from(HAS_CAUSTICS)),
        ("CACHES_AT", CACHES_AT as f64),
        ("CACHE_WORDS", CACHE_WORDS as f64),
        ("CELL_WORDS", CELL_WORDS as f64),
        ("INVERSE_WEIGHT_MIN", f64::from(record::INVERSE_WEIGHT_MIN)),
        ("SAME_SURFACE_COS", f64::from(record::SAME_SURFACE_COS)),
        ("BEHIND", f64::from(record::BEHIND)),
        ("SECTORS", horizon::SECTORS as f64),
        ("WAYS_PER_OCTAVE", f64::from(horizon::PER_OCTAVE)),
        ("ENDLESS", f64::from(horizon::ENDLESS)),
        ("SILHOUETTE", f64::from(horizon::SILHOUETTE)),
        ("RISE_CODE_MAX", f64::from(horizon::RISE_CODE_MAX)),
        ("RISE_MAX", f64::from(horizon::RISE_MAX)),
        ("BETWEEN", f64::from(horizon::BETWEEN)),
    ];
    for (name, value) in expected {
        assert_eq!(numbers[name], value, "{name}");
    }
}
