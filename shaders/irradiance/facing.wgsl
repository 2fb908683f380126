// Which way a point faces that is asked for its irradiance: `technique/irradiance/record.rs`.

/// Where a point lies and which way it faces.
struct Facing {
    position: vec3f,
    normal: vec3f,
    n_geo: vec3f,
}

/// `Facing::of`: on the side that is seen.
///
/// - `wo`: unit, to the eye
fn facing_towards(wo: vec3f, position: vec3f, n: vec3f, n_geo: vec3f) -> Facing {
    return Facing(position, select(n, -n, dot(wo, n) < 0.0), select(n_geo, -n_geo, dot(wo, n_geo) < 0.0));
}
