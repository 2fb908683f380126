//! Another way to the same hits, which shares nothing with the engine's: all triangles taken to render space in double
//! precision, a loop over them, and a distance by which the engine may differ at their rims.

use super::*;

/// Distance by which single precision may be off, relative to the distance from the ray's origin: the triangle test
/// lets 8 · 2⁻²³ pass at rims, an instance's transform adds about as much.
const TOLERANCE: f64 = 2e-6;

pub(super) struct Reference {
    /// Corners in render space, instance and triangle.
    triangles: Vec<([DVec3; 3], (u32, u32))>,
}

/// Where a ray's line passes a triangle.
struct Passing {
    /// Metres along the ray to the triangle's plane; not finite where the ray is parallel to it.
    distance_m: f64,
    /// Metres along the ray between the first and the last corner.
    range_m: [f64; 2],
    /// Metres between the line and the triangle's rim, negative outside.
    inside_m: f64,
    /// Sine of the angle between ray and plane.
    sine: f64,
    /// Metres by which the engine may differ here.
    tolerance_m: f64,
}

impl Reference {
    pub(super) fn new(scene: &Scene, accel: &Accel) -> Reference {
        let mut triangles = Vec::new();
        for (index, instance) in accel.instances().iter().enumerate() {
            let world_from_mesh = scene.world_from_node(Some(instance.node_id()));
            let mesh = instance.mesh();
            let corner = |vertex: u32| {
                let p_in_mesh = mesh.centre() + mesh.positions()[vertex as usize].as_dvec3();
                world_from_mesh.transform_point3(p_in_mesh) - accel.origin_in_world()
            };
            let named = mesh.triangles().iter().enumerate();
            triangles
                .extend(named.map(|(number, corners)| (corners.map(corner), (index as u32, number as u32))));
        }
        Reference { triangles }
    }

    /// Judges what the engine answered; true when nothing was in doubt and it hit.
    pub(super) fn judge(&self, ray: &Ray, found: Option<Hit>) -> bool {
        let length = ray.direction.as_dvec3().length();
        let passings: Vec<(Passing, (u32, u32))> = self
            .triangles
            .iter()
            .filter_map(|(corners, name)| Some((passing(ray, corners)?, *name)))
            .collect();
        let certain = |passing: &Passing| {
            passing.inside_m > passing.tolerance_m && passing.distance_m > passing.tolerance_m
        };
        let slack = |passing: &Passing| passing.tolerance_m * (1.0 + 1.0 / passing.sine.max(1e-9));
        let nearest = passings
            .iter()
            .filter(|(passing, _)| certain(passing))
            .min_by(|a, b| a.0.distance_m.total_cmp(&b.0.distance_m));
        let Some(hit) = found else {
            assert!(nearest.is_none(), "{ray:?} misses {:?}", nearest.map(|(_, name)| name));
            return false;
        };
        let own = passings.iter().find(|(_, name)| *name == (hit.instance, hit.triangle));
        let Some((passing, name)) = own else { panic!("{ray:?} hits {hit:?} from afar") };
        let distance_m = f64::from(hit.t) * length;
        let on_plane = (distance_m - passing.distance_m).abs() <= slack(passing);
        let [low, high] = passing.range_m;
        let on_rim = passing.inside_m < passing.tolerance_m
            && (low - passing.tolerance_m..=high + passing.tolerance_m).contains(&distance_m);
        assert!(on_plane || on_rim, "{ray:?} hits {hit:?} at {distance_m}, not {}", passing.distance_m);
        if let Some((nearest, nearest_name)) = nearest {
            let beyond = distance_m - nearest.distance_m;
            assert!(
                beyond <= slack(nearest),
                "{ray:?} passes {nearest_name:?} by {beyond} m and hits {hit:?}"
            );
        }
        nearest.is_some_and(|(_, nearest)| nearest == name)
    }
}

/// `None` where the line passes farther from the triangle than the engine may err.
fn passing(ray: &Ray, corners: &[DVec3; 3]) -> Option<Passing> {
    let direction = ray.direction.as_dvec3().normalize();
    let [a, b, c] = corners.map(|corner| corner - ray.origin.as_dvec3());
    let reach = a.abs().max(b.abs()).max(c.abs()).max_element();
    let tolerance_m = TOLERANCE * reach;
    let (right, up) = direction.any_orthonormal_pair();
    let seen = [a, b, c].map(|p| glam::DVec2::new(p.dot(right), p.dot(up)));
    let sides = [0, 1, 2].map(|i| {
        let (p, q) = (seen[i], seen[(i + 1) % 3]);
        let edge = q - p;
        let to_segment = (p + edge * (-p.dot(edge) / edge.length_squared()).clamp(0.0, 1.0)).length();
        (p.perp_dot(q), to_segment)
    });
    let is_inside = sides.iter().all(|(side, _)| *side > 0.0) || sides.iter().all(|(side, _)| *side < 0.0);
    let to_rim = sides.iter().map(|(_, distance)| *distance).fold(f64::INFINITY, f64::min);
    if !is_inside && to_rim > tolerance_m {
        return None;
    }
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let along = [a, b, c].map(|p| p.dot(direction));
    Some(Passing {
        distance_m: normal.dot(a) / normal.dot(direction),
        range_m: [
            along.into_iter().fold(f64::INFINITY, f64::min),
            along.into_iter().fold(f64::NEG_INFINITY, f64::max),
        ],
        inside_m: if is_inside { to_rim } else { -to_rim },
        sine: normal.dot(direction).abs(),
        tolerance_m,
    })
}
