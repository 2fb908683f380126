//! Sampling the radiance that arrives from outside the scene.

use std::{
    f32::consts::{PI, TAU},
    sync::Arc,
};

use glam::Vec3;

use super::Opening;
use crate::{
    math::{Frame, Rgb, warp},
    scene::{Encoding, Environment, Scene, Texture},
};

/// The environment, ready to be looked up and sampled.
#[derive(Debug)]
pub(in crate::transport) enum EnvironmentLight {
    Constant(Rgb),
    Image(EnvironmentImage),
}

/// An equirectangular picture with the running sums that choose a texel by its light.
#[derive(Debug)]
pub(in crate::transport) struct EnvironmentImage {
    pub(super) texture: Arc<Texture>,
    pub(super) scale: Rgb,
    pub(super) rotation_rad: f32,
    /// `[h]` running sums over rows, then `[h × w]` over the texels of each row; each ends in its total.
    pub(super) rows: Vec<f32>,
    pub(super) columns: Vec<f32>,
}

impl EnvironmentLight {
    /// `None` when nothing arrives from outside.
    pub(in crate::transport) fn of(scene: &Scene) -> Option<EnvironmentLight> {
        match scene.environment() {
            Environment::None => None,
            Environment::Constant(radiance) => {
                (!radiance.is_black()).then_some(EnvironmentLight::Constant(*radiance))
            }
            Environment::Image { texture, scale, rotation_rad } => {
                let image =
                    EnvironmentImage::new(scene.textures().get(texture)?.clone(), *scale, *rotation_rad);
                image.map(EnvironmentLight::Image)
            }
        }
    }

    /// Radiance from direction `wi`, W/(m² sr).
    pub(in crate::transport) fn radiance(&self, wi: Vec3) -> Rgb {
        match self {
            EnvironmentLight::Constant(radiance) => *radiance,
            EnvironmentLight::Image(image) => image.radiance(wi),
        }
    }

    /// A direction for a surface that faces `n` (zero vector: faces anywhere), and its density, 1/sr.
    pub(in crate::transport) fn sample(&self, n: Vec3, u: [f32; 2]) -> Option<(Vec3, f32)> {
        match self {
            EnvironmentLight::Constant(_) if n == Vec3::ZERO => Some((warp::sphere(u), 1.0 / (4.0 * PI))),
            EnvironmentLight::Constant(_) => {
                let local = warp::cosine_hemisphere(u);
                let pdf = warp::cosine_hemisphere_pdf(local.z);
                (pdf > 0.0).then(|| (Frame::around(n).to_world(local), pdf))
            }
            EnvironmentLight::Image(image) => image.sample(u),
        }
    }

    /// Density of [`EnvironmentLight::sample`] at `wi`, 1/sr.
    pub(in crate::transport) fn pdf(&self, n: Vec3, wi: Vec3) -> f32 {
        match self {
            EnvironmentLight::Constant(_) if n == Vec3::ZERO => 1.0 / (4.0 * PI),
            EnvironmentLight::Constant(_) => warp::cosine_hemisphere_pdf(n.dot(wi)),
            EnvironmentLight::Image(image) => image.pdf(wi),
        }
    }

    /// The same where it is known where the environment shows: with a fixed chance from there.
    pub(in crate::transport) fn sample_through(
        &self,
        opening: Option<&Opening>,
        n: Vec3,
        u: [f32; 2],
    ) -> Option<(Vec3, f32)> {
        let Some(opening) = opening else { return self.sample(n, u) };
        let [which, other] = u;
        let wi = if which < Opening::SHARE {
            opening.draw([which / Opening::SHARE, other])
        } else {
            self.sample(n, [(which - Opening::SHARE) / (1.0 - Opening::SHARE), other])?.0
        };
        let pdf = self.pdf_through(Some(opening), n, wi);
        (pdf > 0.0).then_some((wi, pdf))
    }

    /// Density of [`EnvironmentLight::sample_through`] at `wi`, 1/sr.
    pub(in crate::transport) fn pdf_through(&self, opening: Option<&Opening>, n: Vec3, wi: Vec3) -> f32 {
        let anywhere = self.pdf(n, wi);
        opening
            .map_or(anywhere, |opening| (1.0 - Opening::SHARE) * anywhere + Opening::SHARE * opening.pdf(wi))
    }

    /// Bytes of its tables.
    pub(in crate::transport) fn bytes(&self) -> usize {
        match self {
            EnvironmentLight::Constant(_) => 0,
            EnvironmentLight::Image(image) => (image.rows.len() + image.columns.len()) * 4,
        }
    }
}

impl EnvironmentImage {
    fn new(texture: Arc<Texture>, scale: Rgb, rotation_rad: f32) -> Option<EnvironmentImage> {
        let (width, height) = (texture.width, texture.height);
        let mut columns = Vec::with_capacity(width as usize * height as usize);
        let mut rows = Vec::with_capacity(height as usize);
        let mut total = 0.0f64;
        for y in 0..height {
            // A row's share of the sphere goes with sin θ at its middle.
            let sin_theta = f64::from((y as f32 + 0.5) / height as f32 * PI).sin();
            let mut sum = 0.0f64;
            for x in 0..width {
                let texel = texture.texel(x, y, Encoding::Linear);
                let radiance = Rgb::new(texel.x, texel.y, texel.z) * scale;
                sum += f64::from(radiance.luminance());
                columns.push(sum as f32);
            }
            total += sum * sin_theta;
            rows.push(total as f32);
        }
        let lit = total > 0.0 && total.is_finite();
        lit.then_some(EnvironmentImage { texture, scale, rotation_rad, rows, columns })
    }

    /// Texel column and row that `wi` falls into.
    fn texel_of(&self, wi: Vec3) -> (u32, u32) {
        let (width, height) = (self.texture.width, self.texture.height);
        // u = 0 looks along −Z, u grows towards +X (right-handed turn around +Y is then −u).
        let phi = wi.x.atan2(-wi.z) + self.rotation_rad;
        let u = (phi / TAU).rem_euclid(1.0);
        let v = wi.y.clamp(-1.0, 1.0).acos() / PI;
        (((u * width as f32) as u32).min(width - 1), ((v * height as f32) as u32).min(height - 1))
    }

    fn radiance(&self, wi: Vec3) -> Rgb {
        let (x, y) = self.texel_of(wi);
        // The texel as it stands: sampling then draws exactly what is shown, edge of a sun disc included.
        let texel = self.texture.texel(x, y, Encoding::Linear);
        Rgb::new(texel.x, texel.y, texel.z) * self.scale
    }

    fn row(&self, y: usize) -> &[f32] {
        let width = self.texture.width as usize;
        &self.columns[y * width..(y + 1) * width]
    }

    fn sample(&self, u: [f32; 2]) -> Option<(Vec3, f32)> {
        let (y, v_in_row) = choose(&self.rows, u[1])?;
        let (x, u_in_texel) = choose(self.row(y), u[0])?;
        let (width, height) = (self.texture.width as f32, self.texture.height as f32);
        let theta = (y as f32 + v_in_row) / height * PI;
        let phi = (x as f32 + u_in_texel) / width * TAU - self.rotation_rad;
        let (sin, cos) = theta.sin_cos();
        let wi = Vec3::new(sin * phi.sin(), cos, -sin * phi.cos());
        // Rounding may carry the direction into the neighbouring texel: its density counts, not the chosen one's.
        let pdf = self.pdf(wi);
        (pdf > 0.0).then_some((wi, pdf))
    }

    fn pdf(&self, wi: Vec3) -> f32 {
        let (x, y) = self.texel_of(wi);
        let (x, y) = (x as usize, y as usize);
        let weight = |sums: &[f32], i: usize| {
            (sums[i] - if i == 0 { 0.0 } else { sums[i - 1] }) / sums[sums.len() - 1]
        };
        let row = self.row(y);
        let row_weight = weight(&self.rows, y);
        if row_weight <= 0.0 || row[row.len() - 1] <= 0.0 {
            return 0.0;
        }
        let chance = row_weight * weight(row, x);
        // dω = sin θ dθ dφ = sin θ · (π/h) · (2π/w) · du dv within a texel.
        let sin_theta = (1.0 - wi.y * wi.y).max(0.0).sqrt();
        let texel_sr = sin_theta * (PI / self.texture.height as f32) * (TAU / self.texture.width as f32);
        if texel_sr > 0.0 { chance / texel_sr } else { 0.0 }
    }
}

/// The interval of running sums that `u` falls into, and where in it, both by proportion.
fn choose(sums: &[f32], u: f32) -> Option<(usize, f32)> {
    let total = *sums.last()?;
    if !(total > 0.0) {
        return None;
    }
    let target = u * total;
    let index = sums.partition_point(|sum| *sum <= target).min(sums.len() - 1);
    let below = if index == 0 { 0.0 } else { sums[index - 1] };
    let share = sums[index] - below;
    // Only rounding at the very end can point at an empty interval.
    (share > 0.0).then(|| (index, ((target - below) / share).clamp(0.0, 1.0 - f32::EPSILON)))
}
