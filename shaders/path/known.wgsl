// What is known of the light that falls on a surface, whoever knows it: `technique/products`, `ScatteredLight`.

struct ScatteredLight {
    indirect: vec3f,
    caustic: vec3f,
    blur_m: f32,
    /// A direction that some of the indirect light comes from.
    lit_from: vec3f,
    /// What the light that was drawn sends on, over its chance.
    share: vec3f,
    /// What lies nearer is lost in the blur, m; 0: nobody asked, or there is no light.
    lost_m: f32,
    /// Nothing is known here, though elsewhere it is.
    is_missing: bool,
}

fn nothing_known() -> ScatteredLight {
    return ScatteredLight(vec3f(0.0), vec3f(0.0), 0.0, vec3f(0.0), vec3f(0.0), 0.0, false);
}
