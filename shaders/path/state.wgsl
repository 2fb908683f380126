// Paths on their way, one a pixel of a slice of the picture, or one a ray of a slice of those that light is gathered along,
// or one a photon.
// `technique/path/gpu.rs` says which step follows which; `pixel.wgsl` and `ray.wgsl` say what the paths bring.

struct PassHeader {
    origin: vec3f,
    half_width: f32,
    right: vec3f,
    half_height: f32,
    up: vec3f,
    is_perspective: u32,
    back: vec3f,
    width: u32,
    /// `PixelSampler`'s key before the pixel goes in.
    seed_key: vec2u,
    sequence: u32,
    index: u32,
    height: u32,
    first_pixel: u32,
    path_count: u32,
    /// Places in each queue; twice as many for shadow rays, where there may be two of a path.
    capacity: u32,
    /// Bit c: paths of class c are traced.
    traced: u32,
    /// Scatterings after which a path ends.
    bounces_end: u32,
    /// Bit c: rays bring light of paths of class c.
    brought: u32,
    /// The first sample for which what lies near shadows known light.
    shadowed_from: u32,
    /// Known light is shown times so much.
    dimmed: vec3f,
    /// `IS_ASKING`, `SHOWS_CAUSTICS`, `LEAVES_SUNS`, `LEAVES_SKY`.
    focus: u32,
}

struct Path {
    origin: vec3f,
    /// What it crosses, as `Surface::inside`.
    medium: u32,
    direction: vec3f,
    class_so_far: u32,
    throughput: vec3f,
    bounce: u32,
    last_position: vec3f,
    /// Density of the last direction; below 0: light sampling does not compete with it.
    last_pdf: f32,
    last_n: vec3f,
    eta_squared: f32,
    left_instance: u32,
    left_triangle: u32,
    key: vec2u,
    /// How near to the last surface what the ray meets hides some of what is known of the light there, m; 0: at no distance.
    lost_m: f32,
    /// What it passed, see `shade.wgsl`.
    passing: u32,
    /// Scatterings since a broad gloss for which light by way of mirrors was gathered, that one included; 0 before there is one,
    /// and after a diffuse one.
    since_gathered: u32,
    padding_0: u32,
}

/// A light sample, or known light, that waits for its shadow ray.
struct Shadow {
    origin: vec3f,
    t_max: f32,
    direction: vec3f,
    /// Classes of the diffuse and, from bit 8, of the glossy lobe's light.
    classes: u32,
    diffuse: vec3f,
    light_instance: u32,
    glossy: vec3f,
    light_triangle: u32,
    left_instance: u32,
    left_triangle: u32,
    /// Of a light without extent, its number; NO_INDEX of others. What comes by panes: boundaries that it may pass.
    light: u32,
    /// Place of what the same light brings by panes where something hides it; NO_INDEX: nothing.
    by_panes: u32,
}

/// Paths that go on: queue `parity` is read, the other filled.
struct Counters {
    parity: u32,
    ray_count: u32,
    next_ray_count: atomic<u32>,
    shadow_count: u32,
    next_shadow_count: atomic<u32>,
    /// All of the slice.
    rays: u32,
    shadow_rays: u32,
    /// What photons left behind, with what had no place.
    kept: atomic<u32>,
    /// Where the queue of shadow rays begins.
    shadows_at: u32,
    /// Those that maps leave to rays.
    next_left_count: atomic<u32>,
    /// Rays that followed light through panes.
    pane_rays: atomic<u32>,
}

/// What is focused on surfaces holds all light by way of mirrors and glass that falls there; else what is not found without it.
const IS_ASKING: u32 = 1u;
const SHOWS_CAUSTICS: u32 = 2u;
/// Light of suns, and of the sky too, that comes straight through panes is for light sampling to find.
const LEAVES_SUNS: u32 = 4u;
const LEAVES_SKY: u32 = 8u;

/// Queues of shadow rays, by how many times `capacity` they begin.
const SHADOWS: u32 = 2u;
const LEFT_SHADOWS: u32 = 4u;

/// Places among shadows, in the same way.
const BY_PANES: u32 = 1u;
const OF_KNOWN: u32 = select(1u, 2u, HAS_GLASS);

const EMITTED: u32 = 0u;
const DIRECT: u32 = 1u;
const CAUSTIC: u32 = 2u;
const INDIRECT: u32 = 3u;
const BY_SPECULAR: u32 = 4u;

@group(2) @binding(0) var<uniform> pass_header: PassHeader;
@group(2) @binding(1) var<storage, read_write> paths: array<Path>;
@group(2) @binding(2) var<storage, read_write> hits: array<Hit>;
/// By slot; behind those, `capacity` further on each, where there is glass what comes by panes, and where shadows of that are asked for,
/// known light.
@group(2) @binding(3) var<storage, read_write> shadows: array<Shadow>;
// Binding 4: `samples`.
/// Queues of `capacity` slots: rays, rays, and shadow rays, of which there may be twice as many; where maps are asked, again of
/// those that are left.
@group(2) @binding(5) var<storage, read_write> queues: array<u32>;
@group(2) @binding(6) var<storage, read_write> counters: Counters;

/// `PathClass::meets_diffuse`.
fn meets_diffuse(class_so_far: u32) -> bool {
    return class_so_far != EMITTED && class_so_far != BY_SPECULAR;
}

/// `PathClass::after`.
fn class_after(class_so_far: u32, is_specular: bool) -> u32 {
    if !meets_diffuse(class_so_far) {
        return select(DIRECT, BY_SPECULAR, is_specular);
    }
    if is_specular && class_so_far != INDIRECT {
        return CAUSTIC;
    }
    return INDIRECT;
}

fn is_traced(class_of_path: u32) -> bool {
    return ((pass_header.traced >> class_of_path) & 1u) != 0u;
}

/// `PathClasses::are_beyond`.
fn are_traced_beyond(class_of_path: u32) -> bool {
    var beyond = 30u;
    if class_of_path == INDIRECT {
        beyond = 8u;
    } else if meets_diffuse(class_of_path) {
        beyond = 12u;
    }
    return (pass_header.traced & beyond) != 0u;
}

/// The slot of one of the paths that go on.
fn slot_at(place: u32) -> u32 {
    return queues[counters.parity * pass_header.capacity + place];
}

/// The path goes on in the scattering to come.
fn go_on(slot: u32) {
    let place = atomicAdd(&counters.next_ray_count, 1u);
    queues[(1u - counters.parity) * pass_header.capacity + place] = slot;
}

/// Of a slice that begins: nothing done yet.
fn begin_counting() {
    counters.parity = 0u;
    counters.ray_count = pass_header.path_count;
    atomicStore(&counters.next_ray_count, 0u);
    counters.shadow_count = 0u;
    atomicStore(&counters.next_shadow_count, 0u);
    counters.rays = 0u;
    counters.shadow_rays = 0u;
    atomicStore(&counters.kept, 0u);
    counters.shadows_at = SHADOWS * pass_header.capacity;
    atomicStore(&counters.next_left_count, 0u);
    atomicStore(&counters.pane_rays, 0u);
}
