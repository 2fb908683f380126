//! Where the sky shows from one place.

use glam::{Vec2, Vec3};

use super::Through;
use crate::{
    accel::{Ray, SurfacePoint},
    math::{Frame, sobol, warp},
    transport::{ShadowRay, World},
};

/// Parts along either side of the square that the hemisphere is spread out on, each as large as the others by the cosine. With 32 a room had
/// 2.2 times the variance: too few of as many rays go through each.
const SIDE: usize = 16;
const PARTS: usize = SIDE * SIDE;
/// Points that rays are sent from, at most.
const POINTS: u32 = 16;
/// … of a cube that nothing is known about: many surfaces may lie in it.
const POINTS_EVERYWHERE: u32 = 64;
/// Rays that are sent where it is known about where the sky shows, and where nothing is; squares of whole numbers.
const RAYS: u32 = 256;
const RAYS_EVERYWHERE: u32 = 1024;
/// Share of the former that go where the sky was seen.
const LOOKED_THROUGH: f32 = 0.75;
/// A surface faces one of six ways if the cosine is more.
const FACING_COS: f32 = 0.5;
/// Samples of the sky as it is without surfaces that say how many of them arrive.
const SAMPLES: u32 = 128;
/// With so many of them arriving to know more gains little: with half of them a street paid a tenth of its time for nothing. From all over a
/// cube that may be cut, whose surfaces may see different things, it takes more.
const OPEN: f32 = 0.2;
const OPEN_ALL_OVER: f32 = 0.95;
/// What part of the hemisphere the sky shows through ends between where rays went: a part beside one that light came through gets this share
/// of it at least.
const BESIDE: f32 = 0.25;
/// Of all rays, those that would bring most count as if they brought what the brightest of the others does, by so large a share: a sun in the
/// sky's picture that one of a thousand meets would else be all that is known.
const BRIGHTEST: f32 = 0.05;

/// Where the sky shows from surfaces about a place that face about one way: directions are drawn as light came from them.
#[derive(Debug)]
pub struct Opening {
    frame: Frame,
    /// `[y][x]` of the square that the hemisphere is spread out on, in shares of the brightest; not all are 0.
    parts: [u8; PARTS],
    /// Sums over each row.
    rows: [u16; SIDE],
    /// Sum over all.
    total: f32,
}

/// A cube, and the surfaces in it that face one of six ways.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// In render space.
    pub(super) low: Vec3,
    pub(super) side_m: f32,
    /// `[+x, +y, +z, -x, -y, -z]`.
    pub(super) face: usize,
    pub(super) through: Through,
    /// Names its random numbers.
    pub(super) name: u64,
}

/// What rays brought through parts of the hemisphere.
pub(super) struct Seen {
    frame: Frame,
    /// Share of the samples of the whole sky that arrive.
    arriving: f32,
    /// Luminance that came through each part, W/(m² sr), summed over rays as they would be drawn by the cosine.
    light: [f32; PARTS],
    /// Rays through each part.
    sent: [u16; PARTS],
    /// Of these, how many the sky lit.
    lit: [u16; PARTS],
}

impl Seen {
    /// `None` where no light came.
    fn of(frame: Frame, arriving: f32, looks: &[Look]) -> Option<Seen> {
        let mut luminance: Vec<f32> = looks.iter().map(|look| look.luminance).collect();
        luminance.sort_unstable_by(f32::total_cmp);
        let most = *luminance.get(((1.0 - BRIGHTEST) * luminance.len() as f32) as usize)?;
        let (light, counts) = ([0.0; PARTS], [0; PARTS]);
        let mut seen = Seen { frame, arriving, light, sent: counts, lit: counts };
        for Look { part, luminance, ratio, arrives } in looks {
            seen.sent[*part] += 1;
            if *arrives {
                // Where all but a few directions are black, those few are all there is.
                let counted = if most > 0.0 { luminance.min(most) } else { *luminance };
                seen.light[*part] += counted / ratio;
                seen.lit[*part] += 1;
            }
        }
        let came: f32 = seen.light.iter().sum();
        (came > 0.0 && came.is_finite()).then_some(seen)
    }

    /// Nearly all samples of the sky arrive, from all over a cube.
    pub(super) fn is_open_all_over(&self) -> bool {
        self.arriving > OPEN_ALL_OVER
    }

    /// So many samples of the sky arrive that there is little to gain.
    pub(super) fn is_open(&self) -> bool {
        self.arriving > OPEN
    }
}

/// A ray through a part of the hemisphere.
struct Look {
    part: usize,
    /// Luminance that it would bring without surfaces, W/(m² sr).
    luminance: f32,
    /// How much likelier it was drawn than by the cosine.
    ratio: f32,
    arrives: bool,
}

impl Spot {
    /// How many ways there are to face.
    pub(super) const FACES: usize = 6;

    /// Which way `n` faces.
    pub(super) fn face_of(n: Vec3) -> usize {
        let axis = n.abs().max_position();
        if n[axis] < 0.0 { 3 + axis } else { axis }
    }

    /// - `number`: of the eighth, less than 8
    /// - `upper`: for each axis 1 in its upper half, else 0
    pub(super) fn eighth(&self, number: u32, upper: Vec3) -> Spot {
        let side_m = 0.5 * self.side_m;
        let name = sobol::mix(self.name ^ ((u64::from(number) + 1) << 32));
        Spot { low: self.low + upper * side_m, side_m, name, ..*self }
    }

    fn axis(&self) -> Vec3 {
        let axis = Vec3::AXES[self.face % 3];
        if self.face < 3 { axis } else { -axis }
    }

    /// What rays bring that are drawn by the cosine; `None` where there is no surface, or no light.
    pub(super) fn look_everywhere(&self, world: &World) -> Option<Seen> {
        self.look(world, POINTS_EVERYWHERE, RAYS_EVERYWHERE, |[x, y]| {
            Some((warp::cosine_hemisphere([x, y]), 1.0))
        })
    }

    /// What rays bring most of which go where the sky was seen from around.
    pub(super) fn look_through(&self, world: &World, around: &Opening) -> Option<Seen> {
        self.look(world, POINTS, RAYS, |[x, y]| {
            let direction = match x / LOOKED_THROUGH {
                through if through < 1.0 => around.draw_local([through, y]),
                _ => warp::cosine_hemisphere([(x - LOOKED_THROUGH) / (1.0 - LOOKED_THROUGH), y]),
            };
            let ratio = (1.0 - LOOKED_THROUGH) + LOOKED_THROUGH * around.ratio_local(direction)?;
            Some((direction, ratio))
        })
    }

    /// - `draw`: a direction in the frame of the face, and how much likelier it is than by the cosine
    fn look(
        &self,
        world: &World,
        points_max: u32,
        rays: u32,
        draw: impl Fn([f32; 2]) -> Option<(Vec3, f32)>,
    ) -> Option<Seen> {
        let environment = world.lights().environment()?;
        let points = self.points(world, points_max);
        if points.is_empty() {
            return None;
        }
        let axis = self.axis();
        let frame = Frame::around(axis);
        // Of the sky's light that comes straight, or straight through panes.
        let share_of = |wi: Vec3, which: f32| {
            let point = &points[((which * points.len() as f32) as usize).min(points.len() - 1)];
            // Meshes are met from either side.
            let is_before = wi.dot(point.n_geo) * axis.dot(point.n_geo) > 0.0;
            if !is_before {
                return None;
            }
            let ray = point.ray_towards(wi);
            if !world.is_occluded(&ShadowRay { ray, light: None }) {
                return Some(1.0);
            }
            let passage = match self.through {
                Through::Holes => None,
                Through::HolesAndPanes => world.through_panes(&ray, |_| ()),
            };
            passage.map(|passage| passage.share.luminance())
        };
        let rows = rays.isqrt();
        let looks = (0..rays).filter_map(|number| {
            let [x, y, which, _] = sobol::point(sobol::mix(self.name ^ 1), number);
            let square = [(number % rows) as f32 + x, (number / rows) as f32 + y].map(|at| at / rows as f32);
            let (direction, ratio) = draw(square)?;
            let wi = frame.to_world(direction);
            let luminance = environment.radiance(wi).luminance();
            let share = if luminance > 0.0 { share_of(wi, which) } else { None };
            let luminance = luminance * share.unwrap_or(1.0);
            Some(Look { part: part_of(direction), luminance, ratio, arrives: share.is_some() })
        });
        let looks: Vec<Look> = looks.collect();
        let arriving = (0..SAMPLES).filter(|number| {
            let [x, y, which, _] = sobol::point(sobol::mix(self.name ^ 2), *number);
            environment.sample(axis, [x, y]).is_some_and(|(wi, _)| share_of(wi, which).is_some())
        });
        let arriving = arriving.count() as f32 / SAMPLES as f32;
        Seen::of(frame, arriving, &looks)
    }

    /// Points of surfaces in the cube that face this way, met by rays from its side and from within it.
    fn points(&self, world: &World, count_max: u32) -> Vec<SurfacePoint> {
        let axis = self.axis();
        let along = self.face % 3;
        let side = if self.face < 3 { 1.0 } else { 0.0 };
        let meet = |number: u32| {
            let [x, y, z, _] = sobol::point(self.name, number);
            let mut at = Vec3::new(x, y, z);
            // Half of them see the first of surfaces that lie behind each other, the others any.
            if number.is_multiple_of(2) {
                at[along] = side;
            }
            let way_m = if self.face < 3 { at[along] } else { 1.0 - at[along] } * self.side_m;
            let ray = Ray { t_max: way_m, ..Ray::new(self.low + at * self.side_m, -axis) };
            let hit = world.closest_hit(&ray)?;
            let instance = &world.accel().instances()[hit.instance as usize];
            let point = instance.surface_point(hit.triangle, hit.b1, hit.b2);
            (point.n_geo.dot(axis).abs() > FACING_COS).then_some(point)
        };
        (0..count_max).filter_map(meet).collect()
    }
}

impl Opening {
    /// A sky is drawn from by where it shows with this chance, and else as without: where what is known is wrong its squares grow to four times
    /// what they were at most, and it is known only where a fifth of them arrive at most. With 0.9 a room had 0.93 times as much variance.
    pub(crate) const SHARE: f32 = 0.75;
    /// With so large a share of directions that the sky shows in there is little to gain by looking from nearer.
    pub(super) const SHARE_ENOUGH: f32 = 0.5;

    pub(super) fn of(seen: &Seen) -> Opening {
        let light = &seen.light;
        let all = light.iter().fold(f32::MIN_POSITIVE, |all, light| all.max(*light));
        let beside = |part: usize| {
            let [x, y] = [part % SIDE, part / SIDE].map(|at| at.saturating_sub(1)..(at + 2).min(SIDE));
            let around = y.flat_map(|y| x.clone().map(move |x| y * SIDE + x));
            around.fold(0.0f32, |most, part| most.max(light[part]))
        };
        let share = |part: usize| light[part].max(BESIDE * beside(part)) / all;
        let parts: [u8; PARTS] = std::array::from_fn(|part| (share(part) * f32::from(u8::MAX)).ceil() as u8);
        let row = |y: usize| parts[y * SIDE..(y + 1) * SIDE].iter().map(|part| u16::from(*part)).sum();
        let rows: [u16; SIDE] = std::array::from_fn(row);
        let total = rows.iter().map(|row| f32::from(*row)).sum();
        Opening { frame: seen.frame, parts, rows, total }
    }

    /// Share of the directions that are drawn by it in which the sky shows, as far as rays went there.
    pub(super) fn share_of_sky(&self, seen: &Seen) -> f32 {
        let lit = |part: usize| {
            f32::from(self.parts[part]) * f32::from(seen.lit[part]) / f32::from(seen.sent[part].max(1))
        };
        (0..PARTS).map(lit).sum::<f32>() / self.total
    }

    /// A unit vector.
    ///
    /// - `u`: from 0 to 1
    pub(in crate::transport::light) fn draw(&self, u: [f32; 2]) -> Vec3 {
        self.frame.to_world(self.draw_local(u))
    }

    /// Density of [`Opening::draw`], 1/sr.
    pub(in crate::transport::light) fn pdf(&self, wi: Vec3) -> f32 {
        let direction = self.frame.to_local(wi);
        let by_cosine = warp::cosine_hemisphere_pdf(direction.z);
        self.ratio_local(direction).map_or(0.0, |ratio| ratio * by_cosine)
    }

    fn draw_local(&self, [x, y]: [f32; 2]) -> Vec3 {
        let (row, y) = choose(&self.rows, self.total, y);
        let parts = &self.parts[row * SIDE..(row + 1) * SIDE];
        let (column, x) = choose(parts, f32::from(self.rows[row]), x);
        let square = Vec2::new(column as f32 + x, row as f32 + y) / SIDE as f32;
        warp::cosine_hemisphere(square.to_array())
    }

    /// How much likelier a direction is than by the cosine; `None` below the horizon.
    fn ratio_local(&self, direction: Vec3) -> Option<f32> {
        let share = f32::from(self.parts[part_of(direction)]) / self.total;
        (direction.z > 0.0).then_some(share * PARTS as f32)
    }
}

/// The part of the hemisphere's square that a direction above its plane goes through.
fn part_of(direction: Vec3) -> usize {
    let [x, y] = (warp::square_of_hemisphere(direction) * SIDE as f32)
        .to_array()
        .map(|at| (at as usize).min(SIDE - 1));
    y * SIDE + x
}

/// One of some that are not all 0, as likely as it is large, and where in it, from 0 to 1.
///
/// - `sum`: of all
pub(super) fn choose<T: Copy + Into<f32>>(sizes: &[T], sum: f32, u: f32) -> (usize, f32) {
    // Below the sum, which rounding may reach: whole numbers are added up without any.
    let target = (u * sum).min(sum * (1.0 - f32::EPSILON));
    let mut below = 0.0;
    let mut index = 0;
    loop {
        let size: f32 = sizes[index].into();
        if target < below + size {
            return (index, ((target - below) / size).min(1.0));
        }
        below += size;
        index += 1;
    }
}
