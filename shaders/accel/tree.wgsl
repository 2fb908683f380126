// The two-level tree and how rays walk it. The engine's `accel/upload.rs` says what the words mean; its
// `accel/upload/twin.rs` is the same walk in Rust, statement by statement, and tests compare the two.
//
// Prepended: `const STACK_SIZE: u32`, at least `AccelBuffers::stack_need`; `const HAS_MASKS: bool`. Another part defines
// `fn is_present(instance: u32, triangle: u32, b1: f32, b2: f32) -> bool`, asked of hits where HAS_MASKS.
//
// Nothing here relies on infinity or NaN, nor on whether a compiler fuses a product and a sum.

// A half line in render space. `t` counts in lengths of `direction`, which must not be zero.
struct Ray {
    origin: vec3f,
    // Surfaces beyond do not count; at most the largest f32, never infinite.
    t_max: f32,
    direction: vec3f,
    // The triangle that it starts on, which is flat and so never met again; NO_INDEX for others.
    left_instance: u32,
    left_triangle: u32,
}

struct Hit {
    // t_max of the ray where nothing was met.
    t: f32,
    // NO_INDEX where nothing was met.
    instance: u32,
    triangle: u32,
    // Weights of the triangle's second and third vertex: neither below 0, their sum not above 1.
    b1: f32,
    b2: f32,
}

struct GpuNode {
    origin: vec3f,
    // Bytes 0 to 2 the exponents of x, y, z, byte 3 `inner`.
    exponents_and_inner: u32,
    child_base: u32,
    member_base: u32,
    member_ends: vec2u,
    // Of an axis: low planes of slots 0 to 3 and 4 to 7, high planes of slots 0 to 3 and 4 to 7.
    planes: array<vec4u, 3>,
}

struct GpuTriangle {
    a: vec3f,
    number: u32,
    b: vec3f,
    slope_0: f32,
    c: vec3f,
    slope_1: f32,
}

struct GpuPart {
    instance: u32,
    start: u32,
}

struct GpuInstance {
    mesh_from_render_x: vec3f,
    node_base: u32,
    mesh_from_render_y: vec3f,
    triangle_base: u32,
    mesh_from_render_z: vec3f,
    flags: u32,
    centre_in_render: vec3f,
    mesh_reach: f32,
}

struct AccelHeader {
    // Largest coordinate of the top tree's bounds.
    top_reach: f32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
}

@group(0) @binding(0) var<storage, read> top_nodes: array<GpuNode>;
@group(0) @binding(1) var<storage, read> nodes: array<GpuNode>;
@group(0) @binding(2) var<storage, read> parts: array<GpuPart>;
@group(0) @binding(3) var<storage, read> instances: array<GpuInstance>;
@group(0) @binding(4) var<storage, read> triangles: array<GpuTriangle>;
@group(0) @binding(5) var<uniform> accel_header: AccelHeader;

// Stands for no instance and no triangle.
const NO_INDEX: u32 = 0xffffffffu;
const INSTANCE_IS_ONLY_MOVED: u32 = 1u;
const START_IS_LEAF: u32 = 0x80000000u;
const START_COUNT_SHIFT: u32 = 28u;
const TRIANGLE_AXIS_SHIFT: u32 = 30u;
const SIGN_BIT: u32 = 0x80000000u;

// Directions whose components differ by more are tilted by as much, as on the CPU.
const FLATTEST: f32 = 1e-12;
// Room around boxes relative to the tree's reach from the ray's origin: 16 units of rounding, 2^-19.
const ROOM: f32 = 1.9073486328125e-6;
// Room for the rounding of the origin times the scale: 2 units, 2^-22.
const ROOM_OF_ORIGIN: f32 = 2.384185791015625e-7;
// Room for the reciprocal, off by up to 2.5 units, and the last rounding: 4 units, 2^-21.
const ROOM_OF_SCALE: f32 = 4.76837158203125e-7;
// Edge functions below this times their products have no certain sign: 2 units, 2^-22.
const UNSURE: f32 = 2.384185791015625e-7;
// Nor have those so small that the products may have been flushed to zero: 8 times the smallest normal number, 2^-123.
const UNSURE_AT_ALL: f32 = 9.40395480657830e-38;

// What a walk looks for: the nearest triangle, or any.
const SEEK_NEAREST: u32 = 0u;
const SEEK_ANY: u32 = 1u;

// Nodes that wait: `child_base`, and `inner` in bits 0 to 7 with the slots left in bits 8 to 15. Bit p of these: the slot
// `p ^ octant`. Both levels share it, the mesh's entries above the top tree's.
var<private> waiting: array<vec2u, STACK_SIZE>;

// ---- boxes ----

// A ray ready for the boxes of one space.
struct Slab {
    near_scale: vec3f,
    near_shift: vec3f,
    far_scale: vec3f,
    far_shift: vec3f,
    // Bit a: the direction is negative on axis a.
    octant: u32,
}

fn with_sign_of(size: vec3f, signed: vec3f) -> vec3f {
    return bitcast<vec3f>(bitcast<vec3u>(size) | (bitcast<vec3u>(signed) & vec3u(SIGN_BIT)));
}

fn largest(v: vec3f) -> f32 {
    return max(max(v.x, v.y), v.z);
}

fn slab_of(origin: vec3f, direction: vec3f, tree_reach: f32) -> Slab {
    let size = abs(direction);
    let inverse = vec3f(1.0) / with_sign_of(max(size, vec3f(largest(size) * FLATTEST)), direction);
    let far_off = abs(origin);
    let room = vec3f((largest(far_off) + tree_reach) * ROOM) + far_off * ROOM_OF_ORIGIN;
    let negative = inverse < vec3f(0.0);
    // Towards the ray's direction: planes are met earlier from an origin that is farther along.
    let ahead = with_sign_of(room, inverse);
    let near_scale = inverse * (1.0 - ROOM_OF_SCALE);
    let far_scale = inverse * (1.0 + ROOM_OF_SCALE);
    let octant = select(0u, 1u, negative.x) | select(0u, 2u, negative.y) | select(0u, 4u, negative.z);
    return Slab(near_scale, (origin + ahead) * near_scale, far_scale, (origin - ahead) * far_scale, octant);
}

fn byte_of(words: vec2u, slot: u32) -> u32 {
    return (select(words.x, words.y, slot >= 4u) >> (8u * (slot & 3u))) & 0xffu;
}

// Where the members of a slot begin and end, from the node's `member_base`; both the same where it has none.
fn members_of(member_ends: vec2u, slot: u32) -> vec2u {
    let start = select(byte_of(member_ends, max(slot, 1u) - 1u), 0u, slot == 0u);
    return vec2u(start, byte_of(member_ends, slot));
}

fn bits_of(flags: vec4<bool>) -> u32 {
    let bits = select(vec4u(0u), vec4u(1u, 2u, 4u, 8u), flags);
    return bits.x | bits.y | bits.z | bits.w;
}

// Where a ray meets four planes of an axis, whose places are the bytes of `word`.
fn planes_met(word: u32, origin: f32, step: f32, scale: f32, shift: f32) -> vec4f {
    return (origin + vec4f(unpack4xU8(word)) * step) * scale - shift;
}

// Which of four slots the ray enters, bit s for the one in byte s of the words.
fn entered_of_four(node: GpuNode, step: vec3f, near: vec3u, far: vec3u, slab: Slab, t_max: f32) -> u32 {
    let near_x = planes_met(near.x, node.origin.x, step.x, slab.near_scale.x, slab.near_shift.x);
    let near_y = planes_met(near.y, node.origin.y, step.y, slab.near_scale.y, slab.near_shift.y);
    let near_z = planes_met(near.z, node.origin.z, step.z, slab.near_scale.z, slab.near_shift.z);
    let far_x = planes_met(far.x, node.origin.x, step.x, slab.far_scale.x, slab.far_shift.x);
    let far_y = planes_met(far.y, node.origin.y, step.y, slab.far_scale.y, slab.far_shift.y);
    let far_z = planes_met(far.z, node.origin.z, step.z, slab.far_scale.z, slab.far_shift.z);
    let t_near = max(max(near_x, near_y), max(near_z, vec4f(0.0)));
    let t_far = min(min(far_x, far_y), min(far_z, vec4f(t_max)));
    return bits_of(t_near <= t_far);
}

// Bit s of eight moved to `s ^ octant`.
fn reordered(bits: u32, octant: u32) -> u32 {
    let singles = select(bits, ((bits & 0x55u) << 1u) | ((bits >> 1u) & 0x55u), (octant & 1u) != 0u);
    let pairs = select(singles, ((singles & 0x33u) << 2u) | ((singles >> 2u) & 0x33u), (octant & 2u) != 0u);
    return select(pairs, ((pairs & 0x0fu) << 4u) | (pairs >> 4u), (octant & 4u) != 0u);
}

// The slots of a node that the ray enters before `t_max`: bit p for slot `p ^ octant`. Four at a time and without a loop,
// which compilers would have to unroll first, around the checks that bound every loop.
fn entered_slots(node: GpuNode, slab: Slab, t_max: f32) -> u32 {
    let exponents = node.exponents_and_inner;
    let step = bitcast<vec3f>((vec3u(exponents, exponents >> 8u, exponents >> 16u) & vec3u(0xffu)) << vec3u(23u));
    let backwards = (vec3u(slab.octant, slab.octant >> 1u, slab.octant >> 2u) & vec3u(1u)) == vec3u(1u);
    let low_first = vec3u(node.planes[0].x, node.planes[1].x, node.planes[2].x);
    let low_last = vec3u(node.planes[0].y, node.planes[1].y, node.planes[2].y);
    let high_first = vec3u(node.planes[0].z, node.planes[1].z, node.planes[2].z);
    let high_last = vec3u(node.planes[0].w, node.planes[1].w, node.planes[2].w);
    let first = entered_of_four(
        node, step, select(low_first, high_first, backwards), select(high_first, low_first, backwards), slab, t_max,
    );
    let last = entered_of_four(
        node, step, select(low_last, high_last, backwards), select(high_last, low_last, backwards), slab, t_max,
    );
    // A slot has members where its sum is above that before it.
    let ends = node.member_ends;
    let has_members = bits_of(unpack4xU8(ends.x) > unpack4xU8(ends.x << 8u))
        | (bits_of(unpack4xU8(ends.y) > unpack4xU8((ends.y << 8u) | (ends.x >> 24u))) << 4u);
    return reordered((first | (last << 4u)) & ((exponents >> 24u) | has_members), slab.octant);
}

// ---- triangles ----

// A ray ready for the triangles of one mesh: the axis of space that its longest component lies along comes last.
struct Shear {
    origin: vec3f,
    direction: vec3f,
    axis: u32,
    inverse_z: f32,
    slope: vec2f,
}

// The components after `axis`, in turn, and that of `axis` last.
fn turned(v: vec3f, axis: u32) -> vec3f {
    return select(select(v, v.zxy, axis == 1u), v.yzx, axis == 0u);
}

fn shear_of(origin: vec3f, direction: vec3f) -> Shear {
    let size = abs(direction);
    var axis = 2u;
    if size.x > size.y && size.x > size.z {
        axis = 0u;
    } else if size.y > size.z {
        axis = 1u;
    }
    let along = turned(direction, axis);
    let inverse_z = 1.0 / along.z;
    return Shear(origin, direction, axis, inverse_z, along.xy * inverse_z);
}

// sign · (high · 2²⁴ + low) · 2^exponent, the highest bit of 48 set; all zero for zero.
struct Product {
    sign: i32,
    exponent: i32,
    high: u32,
    low: u32,
}

// 24 bits, the highest set; zero for zero. Subnormal numbers are moved up.
fn mantissa_of(bits: u32) -> u32 {
    let fraction = bits & 0x7fffffu;
    if ((bits >> 23u) & 0xffu) != 0u {
        return fraction | 0x800000u;
    }
    if fraction == 0u {
        return 0u;
    }
    return fraction << (countLeadingZeros(fraction) - 8u);
}

// The exponent that goes with `mantissa_of`.
fn exponent_of(bits: u32) -> i32 {
    let biased = (bits >> 23u) & 0xffu;
    if biased != 0u {
        return i32(biased);
    }
    return 9 - i32(countLeadingZeros(bits & 0x7fffffu));
}

fn product_of(factors: vec2f) -> Product {
    let bits = bitcast<vec2u>(factors);
    let m = mantissa_of(bits.x);
    let n = mantissa_of(bits.y);
    if m == 0u || n == 0u {
        return Product(0, 0, 0u, 0u);
    }
    // 24 × 24 bits, in halves of 12 so that no product leaves 32.
    let middle = (m >> 12u) * (n & 0xfffu) + (m & 0xfffu) * (n >> 12u);
    let low_sum = (m & 0xfffu) * (n & 0xfffu) + ((middle & 0xfffu) << 12u);
    let high = (m >> 12u) * (n >> 12u) + (middle >> 12u) + (low_sum >> 24u);
    let low = low_sum & 0xffffffu;
    let sign = select(-1, 1, ((bits.x ^ bits.y) & SIGN_BIT) == 0u);
    let exponent = exponent_of(bits.x) + exponent_of(bits.y);
    if (high >> 23u) != 0u {
        return Product(sign, exponent, high, low);
    }
    return Product(sign, exponent - 1, (high << 1u) | (low >> 23u), (low << 1u) & 0xffffffu);
}

// Sign of a.x a.y − b.x b.y by integer arithmetic.
fn compare_products(a: vec2f, b: vec2f) -> i32 {
    let p = product_of(a);
    let q = product_of(b);
    if p.sign != q.sign {
        return select(-1, 1, p.sign > q.sign);
    }
    if p.exponent != q.exponent {
        return p.sign * select(-1, 1, p.exponent > q.exponent);
    }
    if p.high != q.high {
        return p.sign * select(-1, 1, p.high > q.high);
    }
    if p.low != q.low {
        return p.sign * select(-1, 1, p.low > q.low);
    }
    return 0;
}

// p.x q.y − p.y q.x, and its sign: exact for the numbers it is given, whatever the compiler makes of the expression.
struct Edge {
    value: f32,
    sign: i32,
}

fn edge_of(p: vec2f, q: vec2f) -> Edge {
    let left = p.x * q.y;
    let right = p.y * q.x;
    let edge = left - right;
    if abs(edge) <= max(abs(left), abs(right)) * UNSURE + UNSURE_AT_ALL {
        return Edge(edge, compare_products(vec2f(p.x, q.y), vec2f(p.y, q.x)));
    }
    return Edge(edge, select(-1, 1, edge > 0.0));
}

// Where a ray meets a triangle: t, not above 0 where it passes by or meets it behind its start; weights b1, b2.
fn meet(shear: Shear, triangle: GpuTriangle) -> vec3f {
    let axis = triangle.number >> TRIANGLE_AXIS_SHIFT;
    if axis == 3u {
        return vec3f(0.0);
    }
    let from_origin_a = triangle.a - shear.origin;
    let p = turned(from_origin_a, shear.axis);
    let q = turned(triangle.b - shear.origin, shear.axis);
    let r = turned(triangle.c - shear.origin, shear.axis);
    let a = p.xy - p.z * shear.slope;
    let b = q.xy - q.z * shear.slope;
    let c = r.xy - r.z * shear.slope;
    let u = edge_of(c, b);
    let v = edge_of(a, c);
    let w = edge_of(b, a);
    // One zero and two of a sign: on an edge, which belongs to both its triangles. Three zeros: seen on edge.
    let lowest = min(min(u.sign, v.sign), w.sign);
    let highest = max(max(u.sign, v.sign), w.sign);
    if (lowest == -1) == (highest == 1) {
        return vec3f(0.0);
    }
    let along_plane = turned(from_origin_a, axis);
    let towards = turned(shear.direction, axis);
    let height = along_plane.z + triangle.slope_0 * along_plane.x + triangle.slope_1 * along_plane.y;
    let approach = towards.z + triangle.slope_0 * towards.x + triangle.slope_1 * towards.y;
    let distances = vec3f(p.z, q.z, r.z) * shear.inverse_z;
    let low = min(min(distances.x, distances.y), distances.z);
    let high = max(max(distances.x, distances.y), distances.z);
    var t = select(low, high, (height < 0.0) == (approach < 0.0));
    // Asked before the division, which must not overflow where the ray runs along the plane.
    if abs(height) < abs(approach) * max(abs(low), abs(high)) {
        t = min(max(height / approach, low), high);
    }
    // Where all three rounded to nothing, one corner is as good as another.
    let sum = u.value + v.value + w.value;
    let scale = select(0.0, 1.0 / select(sum, 1.0, sum == 0.0), abs(sum) > UNSURE_AT_ALL);
    let b1 = clamp(v.value * scale, 0.0, 1.0);
    return vec3f(t, b1, clamp(w.value * scale, 0.0, 1.0 - b1));
}

// ---- walks ----

// What a walk asks of triangles, and what it has found.
struct Search {
    seek: u32,
    left_instance: u32,
    left_triangle: u32,
    light_instance: u32,
    light_triangle: u32,
    // The nearest so far; its t is how far the walk looks.
    best: Hit,
}

// Tests triangles of an instance; true ends the walk.
fn test_triangles(shear: Shear, instance: u32, first: u32, end: u32, search: ptr<function, Search>) -> bool {
    for (var index = first; index < end; index++) {
        let triangle = triangles[index];
        let number = triangle.number & ((1u << TRIANGLE_AXIS_SHIFT) - 1u);
        if instance == (*search).left_instance && number == (*search).left_triangle {
            continue;
        }
        let met = meet(shear, triangle);
        let best = (*search).best;
        if !(met.x > 0.0 && met.x <= best.t) {
            continue;
        }
        // Of surfaces at the same distance the one with the smallest (instance, triangle) counts.
        let is_before = met.x < best.t
            || instance < best.instance || (instance == best.instance && number < best.triangle);
        let is_light = instance == (*search).light_instance && number == (*search).light_triangle;
        if !is_before || is_light {
            continue;
        }
        if HAS_MASKS {
            if !is_present(instance, number, met.y, met.z) {
                continue;
            }
        }
        (*search).best = Hit(met.x, instance, number, met.y, met.z);
        if (*search).seek == SEEK_ANY {
            return true;
        }
    }
    return false;
}

// Walks the part of an instance's mesh below `part`, `floor` entries of the stack being others'; true ends the walk.
fn walk_part(ray: Ray, part: GpuPart, floor: u32, search: ptr<function, Search>) -> bool {
    let instance = instances[part.instance];
    var origin = ray.origin - instance.centre_in_render;
    var direction = ray.direction;
    if (instance.flags & INSTANCE_IS_ONLY_MOVED) == 0u {
        let mesh_from_render =
            mat3x3f(instance.mesh_from_render_x, instance.mesh_from_render_y, instance.mesh_from_render_z);
        origin = mesh_from_render * origin;
        direction = mesh_from_render * direction;
    }
    let shear = shear_of(origin, direction);
    if (part.start & START_IS_LEAF) != 0u {
        let first = instance.triangle_base + (part.start & ((1u << START_COUNT_SHIFT) - 1u));
        let count = ((part.start >> START_COUNT_SHIFT) & 7u) + 1u;
        return test_triangles(shear, part.instance, first, first + count, search);
    }
    let slab = slab_of(origin, direction, instance.mesh_reach);
    var depth = floor;
    // As if it were the child in slot 0 of a node above.
    var child_base = part.start;
    var inner = 1u;
    var left = 1u << slab.octant;
    loop {
        if left == 0u {
            if depth == floor {
                return false;
            }
            depth -= 1u;
            let group = waiting[depth];
            child_base = group.x;
            inner = group.y & 0xffu;
            left = group.y >> 8u;
        }
        let slot = firstTrailingBit(left) ^ slab.octant;
        left &= left - 1u;
        let index = child_base + countOneBits(inner & ((1u << slot) - 1u));
        if left != 0u {
            waiting[depth] = vec2u(child_base, inner | (left << 8u));
            depth += 1u;
        }
        let node = nodes[instance.node_base + index];
        var entered = entered_slots(node, slab, (*search).best.t);
        child_base = node.child_base;
        inner = node.exponents_and_inner >> 24u;
        left = 0u;
        while entered != 0u {
            let position = firstTrailingBit(entered);
            entered &= entered - 1u;
            let entered_slot = position ^ slab.octant;
            if ((inner >> entered_slot) & 1u) == 1u {
                left |= 1u << position;
                continue;
            }
            let members = members_of(node.member_ends, entered_slot) + instance.triangle_base + node.member_base;
            if test_triangles(shear, part.instance, members.x, members.y, search) {
                return true;
            }
        }
    }
    return false;
}

// The same loop over the top tree, whose leaves hold a part each: WGSL has no closures to write it once with.
fn walk(ray: Ray, search: ptr<function, Search>) {
    let slab = slab_of(ray.origin, ray.direction, accel_header.top_reach);
    var depth = 0u;
    var child_base = 0u;
    var inner = 1u;
    var left = 1u << slab.octant;
    loop {
        if left == 0u {
            if depth == 0u {
                return;
            }
            depth -= 1u;
            let group = waiting[depth];
            child_base = group.x;
            inner = group.y & 0xffu;
            left = group.y >> 8u;
        }
        let slot = firstTrailingBit(left) ^ slab.octant;
        left &= left - 1u;
        let index = child_base + countOneBits(inner & ((1u << slot) - 1u));
        if left != 0u {
            waiting[depth] = vec2u(child_base, inner | (left << 8u));
            depth += 1u;
        }
        let node = top_nodes[index];
        var entered = entered_slots(node, slab, (*search).best.t);
        child_base = node.child_base;
        inner = node.exponents_and_inner >> 24u;
        left = 0u;
        while entered != 0u {
            let position = firstTrailingBit(entered);
            entered &= entered - 1u;
            let entered_slot = position ^ slab.octant;
            if ((inner >> entered_slot) & 1u) == 1u {
                left |= 1u << position;
                continue;
            }
            let part = parts[node.member_base + members_of(node.member_ends, entered_slot).x];
            if walk_part(ray, part, depth, search) {
                return;
            }
        }
    }
}

// The nearest surface along `ray`; `instance` is NO_INDEX where there is none.
fn closest_hit(ray: Ray) -> Hit {
    var search = Search(
        SEEK_NEAREST, ray.left_instance, ray.left_triangle, NO_INDEX, NO_INDEX,
        Hit(ray.t_max, NO_INDEX, NO_INDEX, 0.0, 0.0),
    );
    walk(ray, &search);
    return search.best;
}

// True when any surface lies on `ray` but the triangle of the light that it leads to; NO_INDEX for other lights.
fn is_occluded(ray: Ray, light_instance: u32, light_triangle: u32) -> bool {
    var search = Search(
        SEEK_ANY, ray.left_instance, ray.left_triangle, light_instance, light_triangle,
        Hit(ray.t_max, NO_INDEX, NO_INDEX, 0.0, 0.0),
    );
    walk(ray, &search);
    return search.best.instance != NO_INDEX;
}
