// The nearest photons of gathers, each by one invocation: `PhotonMaps::search`. Nothing is kept while looking: photons within a radius are
// counted, then the bits of the distance of the k-th are found four at a time, then those before it are listed. All looks together take
// WORK_MAX nodes and photons, and the radius grows GROWTHS_MAX times at most: what needs more is cut short.

/// Photons that follow each other in a map; those behind it in depth-first order, up to `end`, are its parts.
struct PhotonNode {
    low: vec3f,
    end: u32,
    high: vec3f,
    /// First photon, sixteen times, and how many; none of what has parts.
    photons: u32,
}

struct MapPhoton {
    position: vec3f,
    /// Its place in its map.
    item: u32,
    normal: vec3f,
    padding: u32,
}

/// By side: its first node, and the one behind its last.
@group(0) @binding(3) var<storage, read> roots: array<vec2u>;
@group(0) @binding(4) var<storage, read> nodes: array<PhotonNode>;
@group(0) @binding(5) var<storage, read> photons: array<MapPhoton>;
@group(0) @binding(6) var<storage, read_write> found: array<Found>;
/// Side and place in its map of each photon, so many places for each gather.
@group(0) @binding(7) var<storage, read_write> lists: array<vec2u>;

const COUNT: u32 = 0u;
const DIGIT: u32 = 1u;
const LIST: u32 = 2u;

/// What a walk is for: to count all, those of each next digit of their distance, or to list.
var<private> purpose: u32;
var<private> radius2: f32;
/// Counted: all before the walls, those that face well and better, those behind.
var<private> near_count: u32;
var<private> facing_count: u32;
var<private> alike_count: u32;
var<private> behind_count: u32;
/// Least cosine of those that are told by digits, or listed.
var<private> facing_cos: f32;
/// The k-th squared distance as far as it is known, as bits, and how many bits those are short of all.
var<private> kth_bits: u32;
var<private> shift: u32;
var<private> digits: array<u32, 16>;
/// Of those as far away as the k-th how many are still to be listed.
var<private> tie_count: u32;
var<private> listed: u32;

fn is_far(node: u32, gather: u32, radius_m: f32) -> bool {
    let centre = asked[gather].centre;
    let off = max(max(nodes[node].low - centre, centre - nodes[node].high), vec3f(0.0));
    // The farthest first: its square is in the range of floats then. Rounding leaves room.
    return max(off.x, max(off.y, off.z)) > radius_m || length2(off) > radius2 * 1.00001;
}

fn visit(photon: u32, side: u32, gather: u32, radius_m: f32) {
    let from_middle = photons[photon].position - asked[gather].centre;
    let size = abs(from_middle);
    if !(max(size.x, max(size.y, size.z)) <= radius_m) {
        return;
    }
    let distance2 = length2(flattened(from_middle, asked[gather].normal));
    if !(distance2 <= radius2) {
        return;
    }
    if behind_m(gather, from_middle) > 0.0 {
        behind_count += 1u;
        return;
    }
    let cos = cosine(photons[photon].normal, asked[gather].normal);
    if purpose == COUNT {
        near_count += 1u;
        facing_count += select(0u, 1u, cos >= GATHER_FACING_COS);
        alike_count += select(0u, 1u, cos >= GATHER_ALIKE_COS);
        return;
    }
    if cos < facing_cos {
        return;
    }
    let bits = bitcast<u32>(distance2);
    if purpose == DIGIT {
        // In two steps, since no number is shifted by all of its bits.
        if ((bits >> shift) >> 4u) == ((kth_bits >> shift) >> 4u) {
            digits[(bits >> shift) & 15u] += 1u;
        }
        return;
    }
    if bits < kth_bits || (bits == kth_bits && tie_count > 0u) {
        tie_count -= select(0u, 1u, bits == kth_bits);
        if listed < gathers.list_length {
            lists[gather * gathers.list_length + listed] = vec2u(side, photons[photon].item);
        }
        listed += 1u;
    }
}

/// All that lies within a radius on the sides of a gather, side by side in the order of their maps.
fn walk(gather: u32, radius_m: f32, what_for: u32) {
    purpose = what_for;
    radius2 = radius_m * radius_m;
    behind_count = 0u;
    var place = asked[gather].first_side;
    for (; place < asked[gather].end_side; place++) {
        let side = sides[place];
        let root = roots[side];
        var node = root.x;
        while node < root.y && work < WORK_MAX {
            work += 1u;
            if is_far(node, gather, radius_m) {
                node = nodes[node].end;
                continue;
            }
            let leaf = nodes[node].photons;
            let end = (leaf >> 4u) + (leaf & 15u);
            work += leaf & 15u;
            var photon = leaf >> 4u;
            for (; photon < end; photon++) {
                visit(photon, side, gather, radius_m);
            }
            is_cut_short = is_cut_short || photon < end;
            node += 1u;
        }
        is_cut_short = is_cut_short || node < root.y;
    }
    is_cut_short = is_cut_short || place < asked[gather].end_side;
}

/// How many photons count of those within a radius, and of which normals.
fn look(gather: u32, radius_m: f32) -> u32 {
    near_count = 0u;
    facing_count = 0u;
    alike_count = 0u;
    walk(gather, radius_m, COUNT);
    if alike_count >= asked[gather].count_min {
        facing_cos = GATHER_ALIKE_COS;
        return alike_count;
    }
    if facing_count >= GATHER_FACING_MIN || facing_count == near_count {
        facing_cos = GATHER_FACING_COS;
        return facing_count;
    }
    facing_cos = GATHER_ANY_COS;
    return near_count;
}

/// Finds the squared distance of the k-th photon, and how many of those as far away come before it.
fn find_kth(gather: u32, radius_m: f32, k: u32) {
    var rank = k - 1u;
    kth_bits = 0u;
    for (var digit = 0u; digit < 8u; digit++) {
        shift = 28u - 4u * digit;
        for (var value = 0u; value < 16u; value++) {
            digits[value] = 0u;
        }
        walk(gather, radius_m, DIGIT);
        var value = 0u;
        while value < 15u && rank >= digits[value] {
            rank -= digits[value];
            value += 1u;
        }
        kth_bits |= value << shift;
    }
    tie_count = rank;
}

@compute @workgroup_size(WORKGROUP)
fn search(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let gather = gather_of(group, groups, invocation);
    if gather >= gathers.count {
        return;
    }
    let count_min = asked[gather].count_min;
    let radius_max_m = asked[gather].radius_max_m;
    var count_max = asked[gather].count_max;
    var radius_m = asked[gather].radius_m;
    var near = look(gather, radius_m);
    var growths = 0u;
    loop {
        // A wall that takes half of them leaves enough.
        let enough = near + min(near, behind_count);
        if enough >= count_min || radius_m >= radius_max_m {
            break;
        }
        // A radius so small that growing leaves it as it is would never get there.
        if is_cut_short || growths == GROWTHS_MAX {
            is_cut_short = true;
            break;
        }
        growths += 1u;
        let missing = f32(count_min) / (f32(enough) + 1.0);
        let farthest = select(GATHER_GROWTH_MAX, GATHER_GROWTH_BLIND, enough < GATHER_TELLING);
        radius_m = min(radius_m * clamp(sqrt(GATHER_AMPLE * missing), GATHER_GROWTH_MIN, farthest), radius_max_m);
        count_max = count_min;
        near = look(gather, radius_m);
    }
    let reach_m = radius_m;
    let behind = behind_count;
    // Where it ended with fewer than asked for because there were enough, the last one defines the radius as well.
    let k = select(count_max, near, near >= 2u && near < count_min && radius_m < radius_max_m);
    // All of them, unless the k-th says how far they count.
    kth_bits = 0xffffffffu;
    tie_count = 0u;
    if near >= k {
        find_kth(gather, radius_m, k);
        let kth_m = sqrt(bitcast<f32>(kth_bits));
        if kth_m > 0.0 {
            radius_m = kth_m;
        } else {
            kth_bits = 0xffffffffu;
        }
    }
    listed = 0u;
    walk(gather, reach_m, LIST);
    found[gather] = Found(radius_m, reach_m, facing_cos, select(listed, 0xffffffffu, is_cut_short), behind);
}
