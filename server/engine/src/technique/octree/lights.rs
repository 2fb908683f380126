//! The lights of all groups as shading asks for them, four side by side, and the soft cosine by which a surface sees them;
//! `shaders/octree/look_up.wgsl` has the cosine's twin.

use glam::{Vec3, Vec4};

use super::{PackedVdl, Vdl, cluster::Spread};
use crate::{
    math::Rgb,
    transport::{CoatedBase, EVEN_RISE, schlick_rise},
};

/// Lights to a block: a register of numbers.
const LANES: usize = 4;

/// How gently the cosine with a light ends below the horizon: a light stands for photons from around its direction, some of
/// which still reach a surface that has turned away from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Softness {
    pub(super) reach: f32,
}

impl Softness {
    /// Where photons lie `chord_rms` around their light: with a deviation of σ = chord / √2 to either side, a normal
    /// distribution has a mean cosine of σ / √(2π) at the horizon, and next to none 1.6 σ below it.
    pub(super) fn of(chord_rms: f32) -> Softness {
        let reach = 2.0 * chord_rms / std::f32::consts::PI.sqrt();
        Softness { reach: reach.clamp(SOFTNESS_MIN, 1.0) }
    }

    /// The mean of max(cos, 0) over the light's photons, about.
    #[inline]
    pub(super) fn cos(self, cos: f32) -> f32 {
        let above = (cos + self.reach).max(0.0);
        if cos > self.reach { cos } else { above * above * (0.25 / self.reach) }
    }

    /// The same of four.
    #[inline]
    fn cosines(self, cos: Vec4) -> Vec4 {
        let reach = Vec4::splat(self.reach);
        let above = (cos + reach).max(Vec4::ZERO);
        Vec4::select(cos.cmpgt(reach), cos, above * above * (0.25 / self.reach))
    }
}

/// Softens lights of a single direction.
const SOFTNESS_MIN: f32 = 4.0 * GRAZING;
/// Least soft cosine of a light with its group: that on the horizon.
const GRAZING: f32 = 0.1;

/// A light made ready for shading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ShadedVdl {
    pub(super) direction: Vec3,
    /// Irradiance over the softened cosine with its group: see [`Softness`].
    pub(super) scaled: Rgb,
}

impl ShadedVdl {
    pub(super) fn of(vdl: &Vdl, n_set: Vec3, softness: Softness) -> ShadedVdl {
        // Photons are counted on surfaces that lean to either side of the group's normal.
        let cos = softness.cos(n_set.dot(vdl.direction)).max(GRAZING);
        // As a card unpacks it: a light drawn of thirty by their weights would else often be another one there.
        let scaled = Vdl { direction: vdl.direction, irradiance: vdl.irradiance * (1.0 / cos) };
        let Vdl { direction, irradiance } = PackedVdl::pack(&scaled).unpack();
        ShadedVdl { direction, scaled: irradiance }
    }
}

/// Four lights; those that only fill the block bring nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LightBlock {
    direction: [Vec4; 3],
    scaled: [Vec4; 3],
}

impl LightBlock {
    fn set(&mut self, lane: usize, vdl: &ShadedVdl) {
        for axis in 0..3 {
            self.direction[axis][lane] = vdl.direction[axis];
            self.scaled[axis][lane] = vdl.scaled[axis];
        }
    }

    /// With `n`.
    #[inline]
    fn cosines(&self, n: Vec3) -> Vec4 {
        let [x, y, z] = self.direction;
        x * n.x + y * n.y + z * n.z
    }

    fn light(&self, lane: usize) -> ShadedVdl {
        let [x, y, z] = [0, 1, 2].map(|axis: usize| self.direction[axis][lane]);
        let [r, g, b] = [0, 1, 2].map(|channel: usize| self.scaled[channel][lane]);
        ShadedVdl { direction: Vec3::new(x, y, z), scaled: Rgb::new(r, g, b) }
    }
}

/// Blocks that so many lights fill.
pub(super) fn blocks_of(count: u32) -> u32 {
    count.div_ceil(LANES as u32)
}

/// Appends some lights, from a block of their own on.
pub(super) fn push(blocks: &mut Vec<LightBlock>, lights: impl IntoIterator<Item = ShadedVdl>) {
    for (place, vdl) in lights.into_iter().enumerate() {
        if place % LANES == 0 {
            blocks.push(LightBlock::default());
        }
        if let Some(block) = blocks.last_mut() {
            block.set(place % LANES, &vdl);
        }
    }
}

/// The lights of one class of a group.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lights<'a> {
    pub(super) blocks: &'a [LightBlock],
    pub(super) count: usize,
    pub(super) softness: Softness,
    pub(super) spread: RiseOfSpread,
}

impl<'a> Lights<'a> {
    pub(super) fn get(&self, place: usize) -> ShadedVdl {
        self.blocks[place / LANES].light(place % LANES)
    }

    pub(super) fn iter(self) -> impl Iterator<Item = ShadedVdl> + Clone + 'a {
        (0..self.count).map(move |place| self.get(place))
    }

    /// What each sends on from what faces `n`, in their order: its brightest channel.
    #[inline]
    pub(super) fn brightness(self, n: Vec3) -> impl Iterator<Item = f32> + 'a {
        let of_block = move |block: &LightBlock| {
            let [r, g, b] = block.scaled;
            (r.max(g).max(b) * self.softness.cosines(block.cosines(n))).to_array()
        };
        self.blocks.iter().flat_map(of_block).take(self.count)
    }

    /// Adds what they bring to what faces `n`, as often as `weight` says.
    #[inline]
    pub(super) fn add_irradiance(&self, n: Vec3, weight: f32, sum: &mut Irradiance) {
        for block in self.blocks {
            let cosines = self.softness.cosines(block.cosines(n)) * weight;
            for (sum, scaled) in sum.0.iter_mut().zip(block.scaled) {
                *sum += scaled * cosines;
            }
        }
    }

    /// Adds what they bring to a base that faces `n`, as often as `weight` says, without what its coat keeps off.
    #[inline]
    pub(super) fn add_passing(&self, base: &CoatedBase, n: Vec3, weight: f32, sum: &mut Irradiance) {
        if base.rise == 0.0 {
            return self.add_irradiance(n, weight, sum);
        }
        for block in self.blocks {
            let cosines = block.cosines(n);
            let soft = self.softness.cosines(cosines);
            let passing = base.four_passing_around(arriving_cosines(cosines, soft), self.spread.get());
            for (sum, scaled) in sum.0.iter_mut().zip(block.scaled) {
                *sum += scaled * (soft * passing * weight);
            }
        }
    }
}

/// [`RiseOfSpread`] of even light at most: twice what it is where its lights are straight ahead.
const RISE_OF_SPREAD_MAX: f32 = 2.0 * EVEN_RISE;

/// What a coat reflects of photons, on average, beyond what it would if all came from their lights: [`schlick_rise`] grows so fast towards the
/// horizon that the mean direction of many tells little of its mean. Without it even light, of which a coat reflects F₀ + (1 − F₀) / 21, lost
/// F₀ alone: rooms of glTF's default material had 3 % too much of it. In 255ths.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RiseOfSpread(pub(super) u8);

impl RiseOfSpread {
    /// Of lights that stand for photons, on their own surface.
    ///
    /// - `evenness`: of the photons, see [`evenness_of`](super::drawing::evenness_of)
    pub(super) fn of(
        spread: Spread,
        evenness: f32,
        lights: impl Iterator<Item = ShadedVdl>,
        n_set: Vec3,
        softness: Softness,
    ) -> RiseOfSpread {
        let [mut of_lights, mut sum] = [0f64; 2];
        for vdl in lights {
            let cos_light = n_set.dot(vdl.direction);
            let soft = softness.cos(cos_light);
            let brought = f64::from((vdl.scaled.luminance() * soft).min(f32::MAX));
            of_lights += brought * f64::from(schlick_rise(arriving_cos(cos_light, soft)));
            sum += brought;
        }
        let more = if sum > 0.0 { f64::from(spread.rise) - of_lights / sum } else { 0.0 };
        // What is below 0, or more than photons so close around their lights can be off by, is the error of the softened cosine, and another
        // one where a shading normal leans.
        let most = f64::from(RISE_OF_SPREAD_MAX * evenness);
        RiseOfSpread((255.0 * more.clamp(0.0, most)).round() as u8)
    }

    /// Of [`schlick_rise`].
    #[inline]
    pub(super) fn get(self) -> f32 {
        f32::from(self.0) * (1.0 / 255.0)
    }
}

/// From where photons of a light come on average that do arrive: along the surface as their light, over it by the softened cosine, so
/// never from below the horizon. A light from straight below brings nothing, from anywhere.
///
/// - `cos_light`: with the light itself
/// - `soft`: [`Softness::cos`] of it
#[inline]
pub(super) fn arriving_cos(cos_light: f32, soft: f32) -> f32 {
    soft / ((1.0 - cos_light * cos_light).max(ALONG_MIN) + soft * soft).sqrt()
}

/// The same of four.
#[inline]
fn arriving_cosines(cosines: Vec4, soft: Vec4) -> Vec4 {
    let along_squared = (Vec4::ONE - cosines * cosines).max(Vec4::splat(ALONG_MIN));
    soft / (along_squared + soft * soft).sqrt()
}

/// Keeps lights straight above and below in range.
const ALONG_MIN: f32 = 1e-12;

/// Irradiance in the making: each channel in four parts.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Irradiance([Vec4; 3]);

impl Irradiance {
    pub(super) fn total(&self) -> Rgb {
        Rgb::from(self.0.map(Vec4::element_sum))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Frame, sobol::point};

    /// The soft cosine is what photons spread around a light send to a surface on average, wherever the surface turns.
    #[test]
    fn softness_is_the_mean_over_a_lights_photons() {
        for sigma in [0.25f32, 0.4, 0.6] {
            let photons: Vec<Vec3> = (0..4096)
                .map(|index| {
                    let [u, v, ..] = point(7, index);
                    // Normal deviates by Box and Muller.
                    let (r, turn) = ((-2.0 * (1.0 - u).ln()).sqrt() * sigma, std::f32::consts::TAU * v);
                    Vec3::new(r * turn.cos(), r * turn.sin(), 1.0).normalize()
                })
                .collect();
            let squared = photons.iter().map(|photon| (*photon - Vec3::Z).length_squared()).sum::<f32>();
            let softness = Softness::of((squared / 4096.0).sqrt());
            // Wide lights are shortened by their spread, which stands in the light's flux already.
            let shortened = photons.iter().map(|photon| photon.z).sum::<f32>() / 4096.0;
            for degrees in (0..=180).step_by(10) {
                let angle = (degrees as f32).to_radians();
                let n = Vec3::new(angle.sin(), 0.0, angle.cos());
                let mean = photons.iter().map(|photon| photon.dot(n).max(0.0)).sum::<f32>() / 4096.0;
                let soft = softness.cos(n.z);
                let expected = soft * shortened;
                assert!((expected - mean).abs() < 0.035, "σ {sigma}, {degrees}°: {expected} for {mean}");
            }
            assert!(softness.cos(0.0) > 0.0 && softness.cos(-1.0) == 0.0);
        }
    }

    /// The cosine with which light arrives is that of its light's direction, raised to the softened cosine: also straight above, along
    /// the surface and below it.
    #[test]
    fn light_arrives_from_over_the_surface() {
        let frame = Frame::around(Vec3::new(0.3, 0.5, -0.8).normalize());
        let lights = (0..500).map(|index| {
            let [x, y, z, _] = point(9, index);
            (Vec3::new(x, y, z) - 0.5).normalize_or(Vec3::Y)
        });
        for direction in lights.chain([frame.n, -frame.n, frame.to_world(Vec3::X)]) {
            for softness in [0.0, 0.3, 1.2].map(Softness::of) {
                let cos_light = frame.n.dot(direction);
                let soft = softness.cos(cos_light);
                let raised = frame.to_local(direction).truncate().extend(soft);
                let found = arriving_cos(cos_light, soft);
                assert!((0.0..=1.0).contains(&found), "{direction}: {found}");
                if soft > 1e-3 {
                    let expected = raised.normalize().z;
                    assert!((found - expected).abs() < 1e-4, "{direction}: {found} for {expected}");
                }
            }
        }
    }

    /// Of any number of lights of two classes each comes back as it went in, and side by side they bring and send on what they do
    /// one by one.
    #[test]
    fn lights_side_by_side_are_those_one_by_one() {
        let light = |index: u32| {
            let [x, y, z, r] = point(5, index);
            let direction = (Vec3::new(x, y, z) - 0.5).normalize_or(Vec3::Y);
            ShadedVdl { direction, scaled: Rgb::new(r, 2.0 * x, 0.1 + y) }
        };
        let softness = Softness::of(0.6);
        let n = Vec3::new(0.3, 0.5, -0.8).normalize();
        for counts in (0..10).flat_map(|first| (0..10).map(move |second| [first, second])) {
            let pushed = [0, 1].map(|class: usize| {
                let first = 20 * class as u32;
                (first..first + counts[class]).map(light).collect::<Vec<_>>()
            });
            let mut blocks = vec![LightBlock::default()];
            pushed.iter().for_each(|lights| push(&mut blocks, lights.iter().copied()));
            let mut first = 1;
            for (class, pushed) in pushed.iter().enumerate() {
                let end = first + blocks_of(counts[class]) as usize;
                let lights = Lights {
                    blocks: &blocks[first..end],
                    count: pushed.len(),
                    softness,
                    spread: RiseOfSpread(30),
                };
                first = end;
                assert_eq!(&lights.iter().collect::<Vec<_>>(), pushed, "{counts:?}");
                let cos = |vdl: &ShadedVdl| softness.cos(n.dot(vdl.direction));
                let expected = pushed.iter().fold(Rgb::BLACK, |sum, vdl| sum + vdl.scaled * cos(vdl) * 0.7);
                let mut irradiance = Irradiance::default();
                lights.add_irradiance(n, 0.7, &mut irradiance);
                let off = (irradiance.total() - expected).to_array().map(f32::abs);
                assert!(off.iter().all(|off| *off <= 1e-5), "{counts:?}: {irradiance:?} for {expected:?}");
                let base = CoatedBase { scale: Rgb::WHITE, rise: 0.9 };
                let passing = |vdl: &ShadedVdl| {
                    let arriving = arriving_cos(n.dot(vdl.direction), cos(vdl));
                    cos(vdl) * (base.passing(arriving) - 0.9 * 30.0 / 255.0).max(0.0)
                };
                let expected =
                    pushed.iter().fold(Rgb::BLACK, |sum, vdl| sum + vdl.scaled * passing(vdl) * 0.7);
                let mut irradiance = Irradiance::default();
                lights.add_passing(&base, n, 0.7, &mut irradiance);
                let off = (irradiance.total() - expected).to_array().map(f32::abs);
                assert!(off.iter().all(|off| *off <= 1e-5), "{counts:?}: {irradiance:?} for {expected:?}");
                let sent: Vec<f32> = lights.brightness(n).collect();
                assert_eq!(sent.len(), pushed.len());
                for (sent, vdl) in sent.into_iter().zip(pushed) {
                    assert!((sent - vdl.scaled.max_component() * cos(vdl)).abs() <= 1e-6);
                }
            }
            assert_eq!(first, blocks.len(), "{counts:?}");
        }
    }
}
