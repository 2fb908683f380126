//! A point of a surface as a path meets it: position, frame, scattering model, emission.

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};

use super::bsdf::{BROAD_ALPHA, Bsdf, Glass, Gltf, SMOOTH_ALPHA};
use crate::{
    accel::{Hit, Instance, SurfacePoint},
    math::{Frame, Rgb},
    scene::{Encoding, Id, Material, Scene, Texture, TextureSlot},
};

/// GGX α from which on a gloss focuses nothing: its reflections are as wide as they are far, at roughness 0.5.
const WIDE_ALPHA: f32 = 0.25;

/// A material with its textures at hand.
#[derive(Debug)]
pub(in crate::transport) struct PreparedMaterial {
    material: Arc<Material>,
    textures: [Option<Arc<Texture>>; 7],
    /// Mean of the emissive texture's luminance, 1 without one.
    mean_emission: f32,
}

/// What a path needs to know where it met a surface.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Where, and how to leave.
    pub point: SurfacePoint,
    /// Shading frame; its normal is on the side of the ray's start for everything but glass, where it is outside.
    pub frame: Frame,
    /// What the frame's normal comes from, on its side.
    pub normals: Normals,
    /// Scattering model.
    pub bsdf: Bsdf,
    /// Radiance sent back along the ray, W/(m² sr).
    pub emitted: Rgb,
    /// Radiance that only counts where the surface is seen (unlit materials).
    pub unlit: Rgb,
    /// What fills the inside of glass that absorbs.
    pub inside: Option<Absorption>,
}

/// Normals of a surface at one point, unit.
#[derive(Clone, Copy, Debug)]
pub struct Normals {
    /// Says which side is seen: interpolated between the corners; the triangle's own, on the side of that, where a normal map bends it.
    pub side: Vec3,
    /// Interpolated and bent by the normal map, which may bend it away from who looks along the surface.
    pub mapped: Vec3,
}

impl Normals {
    /// The normal that `wo` sees (unit, away from the surface). Of bumps the slopes that face away are hidden behind others: what is seen
    /// there counts as the slope that is as steep and faces `wo`, mirrored in the plane across `wo`, so that nothing jumps where
    /// a slope turns away.
    pub fn seen_from(&self, wo: Vec3) -> Vec3 {
        if self.face_alike(wo) { self.mapped } else { self.mapped - wo * (2.0 * wo.dot(self.mapped)) }
    }

    /// `wo` is on the same side of both: the slope is not hidden from there.
    pub fn face_alike(&self, wo: Vec3) -> bool {
        wo.dot(self.mapped) * wo.dot(self.side) >= 0.0
    }

    /// Those of the other side.
    fn turned(self) -> Normals {
        Normals { side: -self.side, mapped: -self.mapped }
    }
}

impl Surface {
    /// Light that comes from `wi` may go to `wo` (both away from the surface): what reflects does not send light on that comes from behind it,
    /// though a bent normal faces both.
    pub fn may_scatter(&self, wo: Vec3, wi: Vec3) -> bool {
        matches!(self.bsdf, Bsdf::Glass(_)) || wo.dot(self.normals.side) * wi.dot(self.normals.side) > 0.0
    }

    /// Lobes that are not diffuse send on photons that come from `wo`. No slope that is hidden from there reflects them, but glass lets
    /// all of them through somewhere.
    pub fn reflects_photons_of(&self, wo: Vec3) -> bool {
        matches!(self.bsdf, Bsdf::Glass(_)) || self.normals.face_alike(wo)
    }
}

/// Beer–Lambert absorption.
#[derive(Clone, Copy, Debug)]
pub struct Absorption {
    color: Rgb,
    distance_m: f32,
}

impl Absorption {
    /// Share of light left after `distance_m`: colour^(distance / reference distance).
    pub fn transmittance(&self, distance_m: f32) -> Rgb {
        let exponent = distance_m / self.distance_m;
        self.color.map(|c| if c <= 0.0 && exponent > 0.0 { 0.0 } else { c.powf(exponent) })
    }
}

/// Interpolated vertex data at a hit.
struct Interpolated {
    texcoords: [Vec2; 2],
    color: Vec4,
}

impl PreparedMaterial {
    pub(in crate::transport) fn new(scene: &Scene, id: &Id) -> PreparedMaterial {
        let material = scene.materials().get(id).cloned().unwrap_or_default();
        let textures = std::array::from_fn(|slot| {
            scene.textures().get(&material.textures[slot].as_ref()?.texture).cloned()
        });
        let mut prepared = PreparedMaterial { material, textures, mean_emission: 1.0 };
        prepared.mean_emission = prepared.mean_emission_luminance();
        prepared
    }

    pub(in crate::transport) fn material(&self) -> &Material {
        &self.material
    }

    pub(in crate::transport) fn shared_material(&self) -> &Arc<Material> {
        &self.material
    }

    pub(in crate::transport) fn texture(&self, slot: TextureSlot) -> Option<&Arc<Texture>> {
        self.textures[slot as usize].as_ref()
    }

    /// Mean luminance of what the material emits; zero when it emits nothing.
    pub(in crate::transport) fn emission_luminance(&self) -> f32 {
        if self.material.is_emissive() {
            self.material.emission.luminance() * self.mean_emission
        } else {
            0.0
        }
    }

    /// Some lobe may send light on in one direction. Textures only lower roughness, so it may say yes too often.
    pub(in crate::transport) fn may_be_smooth(&self) -> bool {
        let material = &self.material;
        material.is_specular()
            && (material.transmission > 0.0
                || material.roughness * material.roughness < SMOOTH_ALPHA
                || material.texture(TextureSlot::MetallicRoughness).is_some())
    }

    /// About what its lobes that are not diffuse send on of even light, where they spread it as rough coats do; 1 of what may focus it, of
    /// metal, and where a picture says how rough it is: pictures only lower roughness.
    pub(in crate::transport) fn sent_on_share(&self) -> f32 {
        let material = &self.material;
        let alpha = material.roughness * material.roughness;
        if material.transmission > 0.0
            || material.metallic > 0.0
            || alpha < BROAD_ALPHA
            || material.texture(TextureSlot::MetallicRoughness).is_some()
        {
            return 1.0;
        }
        // Schlick's term over even light, as where a base lies below: `bsdf/gltf.rs`.
        let f0 = ((material.ior - 1.0) / (material.ior + 1.0)).powi(2);
        let f0 = (material.specular_color.max_component() * f0).min(1.0);
        let share = material.specular * (f0 + (1.0 - f0) / 21.0);
        // By and by, so that a little rougher takes a little fewer.
        share.powf(((alpha - BROAD_ALPHA) / (WIDE_ALPHA - BROAD_ALPHA)).min(1.0))
    }

    fn mean_emission_luminance(&self) -> f32 {
        let Some(texture) = &self.textures[TextureSlot::Emission as usize] else { return 1.0 };
        // A grid of at most 64² texels: the mean steers sampling only, so it need not be exact, but must not be zero
        // where any texel shines.
        let (columns, rows) = (texture.width.min(64), texture.height.min(64));
        let mut sum = 0.0;
        for y in 0..rows {
            for x in 0..columns {
                let texel =
                    texture.texel(x * texture.width / columns, y * texture.height / rows, Encoding::Srgb);
                sum += Rgb::new(texel.x, texel.y, texel.z).luminance();
            }
        }
        (sum / (columns * rows) as f32).max(1e-3)
    }

    /// It emits, and a picture says where how much.
    pub(in crate::transport) fn emits_a_picture(&self) -> bool {
        self.material.is_emissive() && self.texture(TextureSlot::Emission).is_some()
    }

    /// Luminance of the picture of emission at one point, over the mean of all of it, about.
    ///
    /// - `barycentric`: weights of the triangle's second and third corner
    pub(in crate::transport) fn emission_share(
        &self,
        instance: &Instance,
        triangle: u32,
        barycentric: [f32; 2],
    ) -> f32 {
        let [b1, b2] = barycentric;
        let at = interpolated(instance, &Hit { t: 0.0, instance: 0, triangle, b1, b2 });
        let texel = self.sampled(TextureSlot::Emission, &at).unwrap_or(Vec4::ZERO);
        Rgb::new(texel.x, texel.y, texel.z).luminance() / self.mean_emission
    }

    pub(in crate::transport) fn is_masked(&self) -> bool {
        self.material.alpha_cutoff.is_some()
    }

    fn sampled(&self, slot: TextureSlot, at: &Interpolated) -> Option<Vec4> {
        let reference = self.material.texture(slot)?;
        let texture = self.textures[slot as usize].as_ref()?;
        let encoding = if slot.is_colour() { Encoding::Srgb } else { Encoding::Linear };
        Some(reference.sample(texture, at.texcoords[usize::from(reference.texcoord_set.min(1))], encoding))
    }

    /// False where the alpha mask cuts the surface away.
    pub(in crate::transport) fn is_present(&self, instance: &Instance, hit: &Hit) -> bool {
        let Some(cutoff) = self.material.alpha_cutoff else { return true };
        let at = interpolated(instance, hit);
        let texel = self.sampled(TextureSlot::BaseColor, &at).unwrap_or(Vec4::ONE);
        self.material.alpha * texel.w * at.color.w >= cutoff
    }

    /// Radiance that the front or back of the surface sends out.
    pub(in crate::transport) fn emitted(&self, instance: &Instance, hit: &Hit, from_front: bool) -> Rgb {
        if !self.material.is_emissive() || !(from_front || self.material.double_sided) {
            return Rgb::BLACK;
        }
        match self.textures[TextureSlot::Emission as usize] {
            None => self.material.emission,
            Some(_) => self.emission_at(&interpolated(instance, hit)),
        }
    }

    fn emission_at(&self, at: &Interpolated) -> Rgb {
        match self.sampled(TextureSlot::Emission, at) {
            None => self.material.emission,
            Some(texel) => self.material.emission * Rgb::new(texel.x, texel.y, texel.z),
        }
    }

    /// The surface at `hit`, met by a ray along `direction` (unit).
    pub(in crate::transport) fn surface(&self, instance: &Instance, hit: &Hit, direction: Vec3) -> Surface {
        let point = instance.point_of(hit);
        let at = interpolated(instance, hit);
        let wo = -direction;
        let from_front = wo.dot(point.n_geo) > 0.0;
        let emitted = self.emitted(instance, hit, from_front);
        let base = self.base_color(&at);
        let normals = self.normals(instance, hit, &at, point.n_geo);
        if self.material.unlit {
            let (frame, bsdf) = (Frame::around(normals.mapped), Bsdf::Black);
            return Surface { point, frame, normals, bsdf, emitted: Rgb::BLACK, unlit: base, inside: None };
        }
        let bsdf = self.bsdf(base, &at);
        let is_glass = matches!(bsdf, Bsdf::Glass(_));
        // Reflection is two-sided: the frame turns to the viewer. For glass the sides differ and the frame stays.
        let normals = if !is_glass && wo.dot(normals.side) < 0.0 { normals.turned() } else { normals };
        let inside = self.absorption().filter(|_| is_glass);
        let frame = Frame::around(normals.seen_from(wo));
        Surface { point, frame, normals, bsdf, emitted, unlit: Rgb::BLACK, inside }
    }

    /// What fills bodies of glass of this material; `None` where that absorbs nothing.
    pub(in crate::transport) fn absorption(&self) -> Option<Absorption> {
        let Material { attenuation_color: color, attenuation_distance_m: distance_m, .. } = *self.material;
        distance_m.is_finite().then_some(Absorption { color, distance_m })
    }

    fn base_color(&self, at: &Interpolated) -> Rgb {
        let texel = self.sampled(TextureSlot::BaseColor, at).unwrap_or(Vec4::ONE) * at.color;
        self.material.base_color * Rgb::new(texel.x, texel.y, texel.z)
    }

    fn bsdf(&self, base: Rgb, at: &Interpolated) -> Bsdf {
        let material = &*self.material;
        let (mut metallic, mut roughness) = (material.metallic, material.roughness);
        if let Some(texel) = self.sampled(TextureSlot::MetallicRoughness, at) {
            roughness *= texel.y;
            metallic *= texel.z;
        }
        let specular =
            material.specular * self.sampled(TextureSlot::Specular, at).map_or(1.0, |texel| texel.w);
        let transmission =
            material.transmission * self.sampled(TextureSlot::Transmission, at).map_or(1.0, |t| t.x);
        if transmission > 0.0 && metallic < 1.0 {
            return Bsdf::Glass(Glass { eta: material.ior, tint: base, transmission });
        }
        if metallic >= 1.0 && roughness * roughness < SMOOTH_ALPHA {
            return Bsdf::Mirror { reflectance: base };
        }
        if metallic <= 0.0 && specular <= 0.0 {
            return if base.is_black() { Bsdf::Black } else { Bsdf::Lambert { albedo: base } };
        }
        let specular_color =
            self.sampled(TextureSlot::SpecularColor, at).map_or(material.specular_color, |texel| {
                material.specular_color * Rgb::new(texel.x, texel.y, texel.z)
            });
        Bsdf::Gltf(Gltf::new(base, metallic, roughness, material.ior, specular, specular_color))
    }

    /// The interpolated normal, the triangle's own where the mesh has none, bent by the normal map.
    fn normals(&self, instance: &Instance, hit: &Hit, at: &Interpolated, n_geo: Vec3) -> Normals {
        let mesh = instance.mesh();
        let triangle = mesh.triangles()[hit.triangle as usize];
        let weights = weights(hit);
        let normals = mesh.normals();
        let mut n = n_geo;
        if !normals.is_empty() {
            let corners = triangle.map(|vertex| normals[vertex as usize]);
            // A corner of zero length asks for the triangle's own normal.
            if corners.iter().all(|corner| *corner != Vec3::ZERO) {
                let n_in_mesh = corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2];
                n = instance.normal_to_render(n_in_mesh).normalize_or(n_geo);
            }
        }
        let texel = self.sampled(TextureSlot::Normal, at);
        match texel.and_then(|texel| self.bent(instance, triangle, weights, n, texel)) {
            Some(mapped) => Normals { side: if n.dot(n_geo) < 0.0 { -n_geo } else { n_geo }, mapped },
            None => Normals { side: n, mapped: n },
        }
    }

    fn bent(
        &self,
        instance: &Instance,
        triangle: [u32; 3],
        weights: [f32; 3],
        n: Vec3,
        texel: Vec4,
    ) -> Option<Vec3> {
        let scale = self.material.normal_scale;
        let map =
            Vec3::new((texel.x * 2.0 - 1.0) * scale, (texel.y * 2.0 - 1.0) * scale, texel.z * 2.0 - 1.0);
        let mesh = instance.mesh();
        let (tangent, handedness) = if mesh.tangents().is_empty() {
            let set = self.material.texture(TextureSlot::Normal)?.texcoord_set;
            uv_tangent(mesh.texcoords(usize::from(set)), mesh.positions(), triangle)?
        } else {
            let corners = triangle.map(|vertex| mesh.tangents()[vertex as usize]);
            let sum = corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2];
            (sum.truncate(), if corners[0].w < 0.0 { -1.0 } else { 1.0 })
        };
        let t = instance.vector_to_render(tangent);
        let t = (t - n * n.dot(t)).try_normalize()?;
        // Mirroring transforms turn the bitangent round with the mesh.
        let b = n.cross(t) * handedness * instance.handedness();
        (t * map.x + b * map.y + n * map.z).try_normalize()
    }
}

/// Direction of growing u on a triangle, and whether v grows to the left (+1) or right (−1) of it.
fn uv_tangent(texcoords: &[Vec2], positions: &[Vec3], triangle: [u32; 3]) -> Option<(Vec3, f32)> {
    if texcoords.is_empty() {
        return None;
    }
    let [p0, p1, p2] = triangle.map(|vertex| positions[vertex as usize]);
    let [t0, t1, t2] = triangle.map(|vertex| texcoords[vertex as usize]);
    let (e1, e2, d1, d2) = (p1 - p0, p2 - p0, t1 - t0, t2 - t0);
    let determinant = d1.x * d2.y - d1.y * d2.x;
    // glTF's v runs down the picture, a normal map's green up: hence the sign of the bitangent.
    let tangent = (e1 * d2.y - e2 * d1.y) * 1f32.copysign(determinant);
    (determinant != 0.0 && tangent != Vec3::ZERO).then_some((tangent, -1f32.copysign(determinant)))
}

fn weights(hit: &Hit) -> [f32; 3] {
    [1.0 - hit.b1 - hit.b2, hit.b1, hit.b2]
}

fn interpolated(instance: &Instance, hit: &Hit) -> Interpolated {
    let mesh = instance.mesh();
    let triangle = mesh.triangles()[hit.triangle as usize];
    let [w0, w1, w2] = weights(hit);
    let texcoord = |set: usize| match mesh.texcoords(set) {
        [] => Vec2::ZERO,
        texcoords => {
            let [a, b, c] = triangle.map(|vertex| texcoords[vertex as usize]);
            a * w0 + b * w1 + c * w2
        }
    };
    let color = match mesh.colors() {
        [] => Vec4::ONE,
        colors => {
            let [a, b, c] = triangle.map(|vertex| colors[vertex as usize]);
            // Weights may miss 1 by a rounding; a factor above 1 would create energy.
            (a * w0 + b * w1 + c * w2).clamp(Vec4::ZERO, Vec4::ONE)
        }
    };
    Interpolated { texcoords: [texcoord(0), texcoord(1)], color }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::{
        accel::Ray,
        scene::{
            Texels, TextureRef,
            samples::{self, Stage},
        },
        transport::World,
    };

    /// A slope of 60° towards +x on a floor, and what is seen of it from all around.
    #[test]
    fn slopes_that_face_away_are_seen_as_slopes_that_do_not() {
        let normals = Normals { side: Vec3::Y, mapped: Vec3::new(0.75f32.sqrt(), 0.5, 0.0) };
        let mut before: Option<Vec3> = None;
        let mut hidden = 0;
        for step in 1..1800 {
            let angle = (step as f32 * 0.1).to_radians();
            let wo = Vec3::new(angle.cos(), angle.sin(), 0.0);
            let n = normals.seen_from(wo);
            assert!((n.length() - 1.0).abs() < 1e-6 && n.dot(wo) >= 0.0, "{n} from {wo}");
            // As steep to who looks, mirrored in the plane across their way.
            assert!((n.dot(wo) - normals.mapped.dot(wo).abs()).abs() < 1e-6);
            hidden += i32::from(n != normals.mapped);
            let jump = before.map_or(0.0, |before| before.distance(n));
            // It turns twice as fast as the eye.
            assert!(jump < 2.1 * 0.1f32.to_radians(), "{jump} at {angle}");
            before = Some(n);
        }
        assert!((599..=600).contains(&hidden), "from 120° to 180°: {hidden}");
        assert_eq!(normals.turned().seen_from(-Vec3::X), -normals.mapped);
    }

    /// Bumps of a floor seen along it from the side that their slopes turn away from: no black, and the same side of glass as the surface.
    #[test]
    fn bumps_seen_from_aside_are_not_turned_inside_out() {
        // 60° towards +u.
        let texel = [238u8, 128, 191, 255];
        for (is_glass, from_above) in [(false, true), (false, false), (true, true), (true, false)] {
            let mut stage = Stage::default();
            let id = |name: &str| Id::new(name).unwrap();
            let picture = Texture { width: 1, height: 1, texels: Texels::Rgba8(vec![texel]) };
            stage.builder().add_texture(id("bumps"), picture).unwrap();
            let transmission = f32::from(u8::from(is_glass));
            let mut material = Material { transmission, ..Material::lambert(Rgb::WHITE) };
            material.textures[TextureSlot::Normal as usize] = Some(TextureRef::new(id("bumps")));
            let material = stage.material("bumpy", material).unwrap();
            let v = DVec3::new;
            let mut floor = samples::quad(
                [v(-1.0, 0.0, 1.0), v(1.0, 0.0, 1.0), v(1.0, 0.0, -1.0), v(-1.0, 0.0, -1.0)],
                &material,
            );
            floor.texcoords[0] = vec![Vec2::new(0.0, 1.0), Vec2::ONE, Vec2::new(1.0, 0.0), Vec2::ZERO];
            stage.place("floor", floor, DAffine3::IDENTITY).unwrap();
            let world = World::prepare(Arc::new(stage.finish()));
            let height = if from_above { 0.2 } else { -0.2 };
            let ray = Ray::new(Vec3::new(-0.9, height, 0.1), Vec3::new(0.9, -height, 0.0).normalize());
            let surface = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction);
            let (n, wo) = (surface.frame.n, -ray.direction);
            let leaning = surface.normals.mapped * if from_above || is_glass { 1.0 } else { -1.0 };
            assert!((leaning - Vec3::new(0.866, 0.5, 0.0)).length() < 0.01, "{leaning}");
            // Seen from below, the bumps lean towards who looks from there: upwards they are the hollows.
            let outwards = if is_glass { Vec3::Y } else { Vec3::Y * height.signum() };
            assert!(n.dot(wo) * outwards.dot(wo) > 0.0, "glass {is_glass}, {height}: {n} from {wo}");
            let sun = outwards;
            assert!(n.dot(sun) > 0.3, "glass {is_glass}, {height}: {n} is not lit");
        }
    }
}
