// Photons on their way, one a path of the slice: what they leave behind at every surface that they reach.
//
// Of `Path` they use `passing` as the photon's number, `throughput` as its weight, and `class_so_far` as that of light at the next
// surface, if that scatters it diffusely to the eye.

/// A photon at a surface, or on its way out of the scene.
struct KeptPhoton {
    b1: f32,
    b2: f32,
    triangle: u32,
    /// Index of the instance above `MARK_BITS`; `ESCAPED` of what met nothing.
    place: u32,
    /// With which it arrived.
    weight: vec3f,
    /// Luminance of what went on; 0 where it was absorbed.
    leaving: f32,
    /// Where it went.
    direction: vec3f,
    /// Its path's slot above `BOUNCE_BITS`, and the surfaces before.
    name: u32,
}

/// `products/carried.rs`.
const MARK_FRONT: u32 = 4u;
const MARK_DIFFUSE: u32 = 8u;
const MARK_BITS: u32 = 4u;
const ESCAPED: u32 = 0xffffffffu;
const BOUNCE_BITS: u32 = 13u;

@group(2) @binding(4) var<storage, read_write> kept: array<KeptPhoton>;

/// What has no place is counted all the same, so that it is known that some is missing.
fn keep(photon: KeptPhoton) {
    let place = atomicAdd(&counters.kept, 1u);
    if place < arrayLength(&kept) {
        kept[place] = photon;
    }
}
