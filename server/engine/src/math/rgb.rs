//! Linear RGB triple with Rec.709 primaries: radiance, irradiance, albedo or throughput, per channel.

use std::ops::{Add, AddAssign, Div, Index, Mul, MulAssign, Sub};

use bytemuck::{Pod, Zeroable};

/// Linear Rec.709 colour. The unit is the quantity's own (radiance, albedo, …).
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Rgb {
    /// Red.
    pub r: f32,
    /// Green.
    pub g: f32,
    /// Blue.
    pub b: f32,
}

impl Rgb {
    /// Zero in every channel.
    pub const BLACK: Rgb = Rgb::splat(0.0);
    /// One in every channel.
    pub const WHITE: Rgb = Rgb::splat(1.0);

    /// What each channel adds to the luminance, Rec.709.
    pub const LUMINANCE: Rgb = Rgb::new(0.2126, 0.7152, 0.0722);

    /// A colour from its channels.
    pub const fn new(r: f32, g: f32, b: f32) -> Rgb {
        Rgb { r, g, b }
    }

    /// The same value in every channel.
    pub const fn splat(value: f32) -> Rgb {
        Rgb { r: value, g: value, b: value }
    }

    /// Rec.709 luminance of the colour.
    pub fn luminance(self) -> f32 {
        Rgb::LUMINANCE.r * self.r + Rgb::LUMINANCE.g * self.g + Rgb::LUMINANCE.b * self.b
    }

    /// Largest channel.
    pub fn max_component(self) -> f32 {
        self.r.max(self.g).max(self.b)
    }

    /// Mean of the channels.
    pub fn mean(self) -> f32 {
        (self.r + self.g + self.b) / 3.0
    }

    /// True when every channel is exactly zero.
    pub fn is_black(self) -> bool {
        self.r == 0.0 && self.g == 0.0 && self.b == 0.0
    }

    /// True when no channel is NaN or infinite.
    pub fn is_finite(self) -> bool {
        self.r.is_finite() && self.g.is_finite() && self.b.is_finite()
    }

    /// True when no channel is negative (or NaN).
    pub fn is_non_negative(self) -> bool {
        self.r >= 0.0 && self.g >= 0.0 && self.b >= 0.0
    }

    /// Applies `f` to every channel.
    pub fn map(self, f: impl Fn(f32) -> f32) -> Rgb {
        Rgb::new(f(self.r), f(self.g), f(self.b))
    }

    /// Linear blend from `self` (t = 0) to `other` (t = 1).
    pub fn lerp(self, other: Rgb, t: f32) -> Rgb {
        self * (1.0 - t) + other * t
    }

    /// The channels in order r, g, b.
    pub fn to_array(self) -> [f32; 3] {
        [self.r, self.g, self.b]
    }
}

impl From<[f32; 3]> for Rgb {
    fn from([r, g, b]: [f32; 3]) -> Rgb {
        Rgb { r, g, b }
    }
}

impl Add for Rgb {
    type Output = Rgb;
    fn add(self, o: Rgb) -> Rgb {
        Rgb::new(self.r + o.r, self.g + o.g, self.b + o.b)
    }
}

impl Sub for Rgb {
    type Output = Rgb;
    fn sub(self, o: Rgb) -> Rgb {
        Rgb::new(self.r - o.r, self.g - o.g, self.b - o.b)
    }
}

impl Mul for Rgb {
    type Output = Rgb;
    fn mul(self, o: Rgb) -> Rgb {
        Rgb::new(self.r * o.r, self.g * o.g, self.b * o.b)
    }
}

impl Mul<f32> for Rgb {
    type Output = Rgb;
    fn mul(self, s: f32) -> Rgb {
        Rgb::new(self.r * s, self.g * s, self.b * s)
    }
}

impl Div<f32> for Rgb {
    type Output = Rgb;
    fn div(self, s: f32) -> Rgb {
        Rgb::new(self.r / s, self.g / s, self.b / s)
    }
}

impl AddAssign for Rgb {
    fn add_assign(&mut self, o: Rgb) {
        *self = *self + o;
    }
}

impl MulAssign<f32> for Rgb {
    fn mul_assign(&mut self, s: f32) {
        *self = *self * s;
    }
}

impl MulAssign for Rgb {
    fn mul_assign(&mut self, o: Rgb) {
        *self = *self * o;
    }
}

impl Index<usize> for Rgb {
    type Output = f32;
    fn index(&self, channel_index: usize) -> &f32 {
        match channel_index {
            0 => &self.r,
            1 => &self.g,
            _ => &self.b,
        }
    }
}
