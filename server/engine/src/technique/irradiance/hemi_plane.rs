//! A hemisphere sampled on one plane before a point: what each of its pixels counts for in the point's irradiance.
//!
//! A plane at distance 1 that reaches 2 to all sides sees 83 % of an even hemisphere's irradiance; what comes in lower is missed
//! [Larsen2004, 11]. That can be left out, taken to be as bright as the rest in the mean [Larsen2004, 11.2], or taken to be as bright as
//! the plane's border in the same direction [Gautron2008, 8.4.1]. Weights are exact integrals, so that even light comes out right
//! whatever the number of pixels.

use crate::math::Rgb;

/// What comes in past the plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PastPlane {
    /// Nothing.
    Dark,
    /// What the plane sees in the mean.
    Mean,
    /// What the border's pixels see, stretched to the horizon.
    Border,
}

/// A square of pixels on a plane at distance 1.
#[derive(Clone, Debug, PartialEq)]
pub struct HemiPlane {
    /// ∫ cos θ dω over each pixel, row by row, sr.
    on_plane: Vec<f64>,
    /// The same of what lies below a pixel of the border, down to the horizon; 0 for others.
    below: Vec<f64>,
}

impl HemiPlane {
    /// How far the plane reaches: twice as far as it is away, an aperture of 127°.
    pub const HALF_SIDE: f64 = 2.0;

    /// - `half_side`: how far it reaches to all sides, 1e-6 to 1e6: beyond, rounding is all there is of some pixels
    /// - `side`: pixels across, 1 at least
    pub fn new(half_side: f64, side: u32) -> HemiPlane {
        let side = side.max(1);
        let edge = |number: u32| half_side * (2.0 * f64::from(number) / f64::from(side) - 1.0);
        let pixels = (0..side).flat_map(|y| (0..side).map(move |x| (x, y)));
        let on_plane = |(x, y): (u32, u32)| {
            let corner = |x: u32, y: u32| corner_integral(edge(x), edge(y));
            corner(x + 1, y + 1) - corner(x, y + 1) - corner(x + 1, y) + corner(x, y)
        };
        let below = |(x, y): (u32, u32)| {
            let along = |number: u32| {
                wedge_integral(half_side, edge(number + 1)) - wedge_integral(half_side, edge(number))
            };
            let is_border = |number: u32| number == 0 || number + 1 == side;
            // Of a plane of one pixel all four sides are its own.
            let sides = if side == 1 { 2.0 } else { 1.0 };
            let of_side = |is_there: bool, number: u32| if is_there { sides * along(number) } else { 0.0 };
            of_side(is_border(x), y) + of_side(is_border(y), x)
        };
        HemiPlane { on_plane: pixels.clone().map(on_plane).collect(), below: pixels.map(below).collect() }
    }

    /// Share of an even hemisphere's irradiance that it sees.
    pub fn coverage(&self) -> f64 {
        self.on_plane.iter().sum::<f64>() / std::f64::consts::PI
    }

    /// Irradiance by what its pixels see, row by row, W/m².
    ///
    /// Panics where that is not one radiance for each of them.
    pub fn irradiance(&self, radiance: &[Rgb], past: PastPlane) -> Rgb {
        assert_eq!(radiance.len(), self.on_plane.len(), "a radiance for each pixel");
        let scale = if past == PastPlane::Mean { 1.0 / self.coverage() } else { 1.0 };
        let weights = self.on_plane.iter().zip(&self.below).map(|(on_plane, below)| {
            scale * (on_plane + if past == PastPlane::Border { *below } else { 0.0 })
        });
        // In order and in double precision: thousands of pixels are summed.
        let sum = weights.zip(radiance).fold([0.0; 3], |sum: [f64; 3], (weight, radiance)| {
            let seen = radiance.to_array();
            std::array::from_fn(|c| sum[c] + weight * f64::from(seen[c]))
        });
        Rgb::from(sum.map(|channel| channel as f32))
    }
}

/// ∫∫ dA / (1 + x² + y²)² over the rectangle from the plane's middle to (x, y): π times the form factor of a parallel rectangle.
fn corner_integral(x: f64, y: f64) -> f64 {
    let part = |a: f64, b: f64| a / (1.0 + a * a).sqrt() * (b / (1.0 + a * a).sqrt()).atan();
    0.5 * (part(x, y) + part(y, x))
}

/// ∫ cos θ dω between a side of the plane, `half_side` from its middle, and the horizon, from the middle of the side to `along` it.
///
/// With φ from the middle of the side the plane ends at the slope h / cos φ: ½ ∫ dφ / (1 + h² / cos² φ).
fn wedge_integral(half_side: f64, along: f64) -> f64 {
    let slant = (1.0 + half_side * half_side).sqrt();
    let phi = (along / half_side).atan();
    0.5 * (phi - half_side / slant * (along / slant).atan())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    /// What the pixels of a plane see of so much light in each direction over it.
    fn seen(half_side: f64, side: u32, radiance: impl Fn(f64, f64) -> f64) -> Vec<Rgb> {
        let at = |number: u32| half_side * (2.0 * (f64::from(number) + 0.5) / f64::from(side) - 1.0);
        let pixels = (0..side).flat_map(|y| (0..side).map(move |x| (x, y)));
        pixels.map(|(x, y)| Rgb::splat(radiance(at(x), at(y)) as f32)).collect()
    }

    /// The coverage is the closed form's, and even light is π times as much, whatever the plane, but for what it does not see.
    #[test]
    fn even_light_comes_out_right() {
        for (half_side, side, coverage) in
            [(2.0, 32, 0.831), (2.0, 1, 0.831), (1.0, 17, 0.554), (1.0, 2, 0.554)]
        {
            let plane = HemiPlane::new(half_side, side);
            assert!((plane.coverage() - coverage).abs() < 5e-4, "{half_side} {side}: {}", plane.coverage());
            let even = seen(half_side, side, |_, _| 1.0);
            let of = |past: PastPlane| f64::from(plane.irradiance(&even, past).r) / PI;
            assert!((of(PastPlane::Dark) - plane.coverage()).abs() < 1e-6);
            for past in [PastPlane::Mean, PastPlane::Border] {
                assert!((of(past) - 1.0).abs() < 1e-6, "{half_side} {side} {past:?}: {}", of(past));
            }
        }
    }

    /// Light that depends on the azimuth alone is stretched to what it is; light that is brighter towards the horizon is caught
    /// best by its border.
    #[test]
    fn borders_stand_for_what_lies_below_them() {
        let plane = HemiPlane::new(HemiPlane::HALF_SIDE, 256);
        let of = |radiance: &[Rgb], past: PastPlane| f64::from(plane.irradiance(radiance, past).r) / PI;
        // A fan of 47°, not along any side.
        let fan = seen(HemiPlane::HALF_SIDE, 256, |x, y| {
            let turned = (y.atan2(x) - 0.3).rem_euclid(2.0 * PI);
            if turned < 0.26 * PI { 1.0 } else { 0.0 }
        });
        assert!((of(&fan, PastPlane::Border) - 0.13).abs() < 1e-3, "{}", of(&fan, PastPlane::Border));
        // sin² θ: irradiance π / 2.
        let low = seen(HemiPlane::HALF_SIDE, 256, |x, y| (x * x + y * y) / (1.0 + x * x + y * y));
        let off = |past: PastPlane| (of(&low, past) - 0.5).abs();
        assert!(off(PastPlane::Border) < 0.03, "{}", off(PastPlane::Border));
        assert!(off(PastPlane::Border) < 0.5 * off(PastPlane::Mean));
        assert!(off(PastPlane::Mean) < off(PastPlane::Dark));
    }
}
