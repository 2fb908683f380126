//! The rays: what a camera sees, and what a path tracer asks from there.

use glam::{DVec3, Vec3};
use lumicast_engine::{
    accel::{Accel, Ray, SurfacePoint},
    scene::{Aabb, CameraView, Projection, Scene},
};
use lumicast_tests::Random;

/// The picture that primary rays are shot for where nothing else is asked: what the serving benches show.
pub(crate) const SIZE: [u32; 2] = [640, 360];
/// Rays of every kind for that.
pub(crate) const RAY_COUNT: usize = (SIZE[0] * SIZE[1]) as usize;
/// Side of the tiles that a picture is made in.
const TILE: u32 = 16;
/// Blocks of pixels within a tile: eight rays that fit one packet, as the path tracer asks for them.
const BLOCK: [u32; 2] = [4, 2];
/// Side of the lamps that shadow rays run to, metres, unless the scene is smaller.
const LAMP_M: f64 = 1.0;

/// What a ray is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Camera to closest surface, neighbours side by side.
    Primary,
    /// Surface to closest surface, every which way.
    Diffuse,
    /// Surface to lamp: is anything between?
    Shadow,
}

impl Kind {
    pub(crate) const ALL: [Kind; 3] = [Kind::Primary, Kind::Diffuse, Kind::Shadow];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Kind::Primary => "primary",
            Kind::Diffuse => "diffuse",
            Kind::Shadow => "shadow",
        }
    }
}

/// A ray a pixel, of every kind, in render space.
pub(crate) struct RaySet {
    of_kind: [Vec<Ray>; 3],
}

impl RaySet {
    /// The rays of a picture of `scene`, the same on every run.
    ///
    /// # Panics
    /// When the camera sees no surface at all: there is nothing to measure then.
    pub(crate) fn seen_by(view: &CameraView, size: [u32; 2], accel: &Accel, scene: &Scene) -> RaySet {
        let primary = primary_rays(view, size, accel);
        let seen: Vec<(Vec3, SurfacePoint)> = primary
            .iter()
            .filter_map(|ray| {
                let hit = accel.closest_hit(ray, |_| true)?;
                Some((ray.direction, accel.instances()[hit.instance as usize].point_of(&hit)))
            })
            .collect();
        assert!(!seen.is_empty(), "the camera sees nothing");
        // Where some pixels see nothing, the others are gone through again: all kinds have as many rays.
        let seen = || seen.iter().cycle().take(primary.len());
        let mut random = Random::new(1);
        let diffuse = seen().map(|(wi, point)| diffuse_ray(*wi, point, &mut random)).collect();
        let lamps = lamps(&scene.bounds().unwrap_or(Aabb::UNIT));
        let shadow = seen()
            .map(|(_, point)| {
                let target = accel.to_render(point_on_a_lamp(&lamps, &mut random));
                let endless = point.ray_towards(target - point.position);
                Ray { direction: target - endless.origin, t_max: 1.0, ..endless }
            })
            .collect();
        RaySet { of_kind: [primary, diffuse, shadow] }
    }

    pub(crate) fn of(&self, kind: Kind) -> &[Ray] {
        &self.of_kind[kind as usize]
    }
}

/// One ray through the middle of every pixel, tile by tile, block by block within a tile.
fn primary_rays(view: &CameraView, size: [u32; 2], accel: &Accel) -> Vec<Ray> {
    let half_height = match view.projection {
        Projection::Perspective { yfov_rad } => (yfov_rad / 2.0).tan(),
        Projection::Orthographic { .. } => panic!("the subjects' cameras are perspective"),
    };
    let [width, height] = size.map(f64::from);
    let origin = accel.to_render(view.world_from_camera.translation);
    let through = |[x, y]: [u32; 2]| {
        let in_camera = DVec3::new(
            (2.0 * (f64::from(x) + 0.5) / width - 1.0) * half_height * width / height,
            (1.0 - 2.0 * (f64::from(y) + 0.5) / height) * half_height,
            -1.0,
        );
        let direction = view.world_from_camera.transform_vector3(in_camera).normalize();
        Ray::new(origin, direction.as_vec3())
    };
    let tiles = cells([0, 0], size, [TILE; 2]);
    let blocks = tiles.flat_map(|tile| {
        let end = [0, 1].map(|axis| (tile[axis] + TILE).min(size[axis]));
        cells(tile, end, BLOCK)
    });
    let pixels = blocks.flat_map(|block| cells(block, [block[0] + BLOCK[0], block[1] + BLOCK[1]], [1, 1]));
    pixels.map(through).collect()
}

/// First corners of the cells of size `step` that fill the rectangle from `start` to `end`, row by row.
fn cells(start: [u32; 2], end: [u32; 2], step: [u32; 2]) -> impl Iterator<Item = [u32; 2]> {
    let rows = (start[1]..end[1]).step_by(step[1] as usize);
    rows.flat_map(move |y| (start[0]..end[0]).step_by(step[0] as usize).map(move |x| [x, y]))
}

/// Reflected by a Lambert surface: pdf_solid_angle cos θ / π about the normal on the side the light came from.
fn diffuse_ray(arriving: Vec3, point: &SurfacePoint, random: &mut Random) -> Ray {
    let n_facing = if arriving.dot(point.n_geo) < 0.0 { point.n_geo } else { -point.n_geo };
    // A uniform point on the unit sphere around the tip of the normal is cosine-distributed seen from its foot.
    let z = random.between(-1.0, 1.0);
    let phi = random.between(0.0, std::f64::consts::TAU);
    let r = (1.0 - z * z).max(0.0).sqrt();
    let on_sphere = DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3();
    // Opposite to the normal the sum is about zero and has no direction.
    let direction = (n_facing + on_sphere).try_normalize().unwrap_or(n_facing);
    point.ray_towards(direction)
}

/// From where rays end, reflected: the next bounce of the paths they belong to. Where some end nowhere, the others are gone
/// through again: as many rays come out as went in.
///
/// # Panics
/// When no ray meets a surface.
pub(crate) fn onward_rays(rays: &[Ray], accel: &Accel) -> Vec<Ray> {
    let met = rays.iter().filter_map(|ray| {
        let hit = accel.closest_hit(ray, |_| true)?;
        Some((ray.direction, accel.instances()[hit.instance as usize].point_of(&hit)))
    });
    let met: Vec<(Vec3, SurfacePoint)> = met.collect();
    assert!(!met.is_empty(), "no ray meets a surface");
    let mut random = Random::new(2);
    let onward = met.iter().cycle().take(rays.len());
    onward.map(|(arriving, point)| diffuse_ray(*arriving, point, &mut random)).collect()
}

/// Middles of five lamps below the top of the scene and their side: random lamps make shadow rays run as far apart as
/// those of a scene with many lights do.
fn lamps(bounds: &Aabb) -> ([DVec3; 5], f64) {
    let size = bounds.max - bounds.min;
    // At nine tenths of the height: under most ceilings, so that the ceiling itself decides nothing.
    let at = |x: f64, z: f64| bounds.min + size * DVec3::new(x, 0.9, z);
    let middles = [at(0.5, 0.5), at(0.25, 0.25), at(0.75, 0.25), at(0.25, 0.75), at(0.75, 0.75)];
    (middles, LAMP_M.min(0.1 * size.x.min(size.z)))
}

fn point_on_a_lamp((middles, side): &([DVec3; 5], f64), random: &mut Random) -> DVec3 {
    let middle = middles[random.below(middles.len())];
    let half = side / 2.0;
    middle + DVec3::new(random.between(-half, half), 0.0, random.between(-half, half))
}
