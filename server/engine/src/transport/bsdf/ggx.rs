//! The GGX microfacet distribution with height-correlated Smith masking [Walter2007, Heitz2014].

use std::f32::consts::{PI, TAU};

use glam::Vec3;

/// Distribution of microfacet normals; α in [`super::SMOOTH_ALPHA`], 1].
#[derive(Clone, Copy, Debug)]
pub(super) struct Ggx {
    pub(super) alpha: f32,
}

impl Ggx {
    /// D(m), 1/sr.
    pub(super) fn d(self, m: Vec3) -> f32 {
        let a2 = self.alpha * self.alpha;
        // sin² from x and y, not 1 − cos²: near the normal that difference has no digits left.
        let t = (m.x * m.x + m.y * m.y) / a2 + m.z * m.z;
        if m.z <= 0.0 { 0.0 } else { 1.0 / (PI * a2 * t * t) }
    }

    fn lambda(self, w: Vec3) -> f32 {
        let cos2 = w.z * w.z;
        if cos2 <= 0.0 {
            return f32::INFINITY;
        }
        let tan2 = (w.x * w.x + w.y * w.y) / cos2;
        0.5 * ((1.0 + self.alpha * self.alpha * tan2).sqrt() - 1.0)
    }

    /// Masking of one direction.
    pub(super) fn g1(self, w: Vec3) -> f32 {
        1.0 / (1.0 + self.lambda(w))
    }

    /// Joint masking and shadowing of two directions on the same side.
    pub(super) fn g2(self, wo: Vec3, wi: Vec3) -> f32 {
        1.0 / (1.0 + self.lambda(wo) + self.lambda(wi))
    }

    /// Density of [`Ggx::sample_visible`] at `m`, seen from `wo` with wo.z > 0, 1/sr.
    pub(super) fn visible_pdf(self, wo: Vec3, m: Vec3) -> f32 {
        self.g1(wo) * wo.dot(m).max(0.0) * self.d(m) / wo.z
    }

    /// A microfacet normal, as often as `wo` (wo.z > 0) sees it [Dupuy2023, spherical caps].
    pub(super) fn sample_visible(self, wo: Vec3, u: [f32; 2]) -> Vec3 {
        let stretched = Vec3::new(wo.x * self.alpha, wo.y * self.alpha, wo.z).normalize();
        let phi = TAU * u[0];
        let z = (1.0 - u[1]) * (1.0 + stretched.z) - stretched.z;
        let r = (1.0 - z * z).max(0.0).sqrt();
        let half = Vec3::new(r * phi.cos(), r * phi.sin(), z) + stretched;
        Vec3::new(half.x * self.alpha, half.y * self.alpha, half.z.max(0.0)).normalize_or(Vec3::Z)
    }
}
