//! Some piece of surface as light from afar sees it: how much there is, and where it faces.

use glam::{Mat3, Vec3};

/// Some piece of surface, as light from afar sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::technique) struct Facets {
    /// Its area, m².
    pub(in crate::technique) area_m2: f32,
    /// Sum of its parts' normals times their areas, m².
    pub(super) facing_m2: Vec3,
    /// Sum of the squares of its parts' normals times their areas, by axis, m² …
    pub(super) squares_m2: Vec3,
    /// … and of their products, xy, yz and zx, m².
    pub(super) products_m2: Vec3,
}

impl Facets {
    /// The same piece from its other side.
    pub(in crate::technique::products) fn turned(self) -> Facets {
        Facets { facing_m2: -self.facing_m2, ..self }
    }

    /// The same piece turned, and so many times as large.
    ///
    /// - `turn`: at right angles and of length one; may mirror
    pub(in crate::technique::products) fn turned_by(self, turn: Mat3, times: f32) -> Facets {
        let Facets { area_m2, facing_m2, squares_m2: s, products_m2: p } = self.share(times);
        let outer =
            Mat3::from_cols(Vec3::new(s.x, p.x, p.z), Vec3::new(p.x, s.y, p.y), Vec3::new(p.z, p.y, s.z));
        let [x, y, z] = (turn * outer * turn.transpose()).to_cols_array_2d();
        Facets {
            area_m2,
            facing_m2: turn * facing_m2,
            squares_m2: Vec3::new(x[0], y[1], z[2]),
            products_m2: Vec3::new(x[1], y[2], z[0]),
        }
    }

    pub(super) fn share(self, share: f32) -> Facets {
        Facets {
            area_m2: self.area_m2 * share,
            facing_m2: self.facing_m2 * share,
            squares_m2: self.squares_m2 * share,
            products_m2: self.products_m2 * share,
        }
    }

    /// Mean over the piece of the cosine with which light from the unit direction `wi` meets it, 0 on what faces away from it.
    ///
    /// Cosines are taken to lie evenly around their mean, as far as their variance says. Exact where all face one way and, to
    /// rounding, where all face the light well; within 0.05 for balls, columns and edges, 0.2 for both sides of a sheet together.
    #[inline]
    pub(in crate::technique::products) fn mean_cos(&self, wi: Vec3) -> f32 {
        let per_m2 = 1.0 / self.area_m2;
        let mean = wi.dot(self.facing_m2) * per_m2;
        let crossed = Vec3::new(wi.x * wi.y, wi.y * wi.z, wi.z * wi.x);
        let square = ((wi * wi).dot(self.squares_m2) + 2.0 * crossed.dot(self.products_m2)) * per_m2;
        let reach = (3.0 * (square - mean * mean)).max(0.0).sqrt();
        let above = mean + reach;
        // Without branches, so that the compiler asks for four directions at a time.
        let some = above * above / (4.0 * reach);
        let of_some = if above > 0.0 { some } else { 0.0 };
        if mean >= reach { mean } else { of_some }
    }

    /// How far the number of it that is farthest off is from another's, m².
    #[cfg(test)]
    pub(in crate::technique) fn farthest_from(&self, other: &Facets) -> f32 {
        let vectors = [
            self.facing_m2 - other.facing_m2,
            self.squares_m2 - other.squares_m2,
            self.products_m2 - other.products_m2,
        ];
        let farthest = vectors.into_iter().map(|off| off.abs().max_element()).fold(0.0, f32::max);
        farthest.max((self.area_m2 - other.area_m2).abs())
    }

    /// Area of one normal.
    pub(super) fn flat(area_m2: f32, n: Vec3) -> Facets {
        Facets {
            area_m2,
            facing_m2: n * area_m2,
            squares_m2: n * n * area_m2,
            products_m2: Vec3::new(n.x * n.y, n.y * n.z, n.z * n.x) * area_m2,
        }
    }
}

impl std::ops::AddAssign for Facets {
    fn add_assign(&mut self, other: Facets) {
        self.area_m2 += other.area_m2;
        self.facing_m2 += other.facing_m2;
        self.squares_m2 += other.squares_m2;
        self.products_m2 += other.products_m2;
    }
}

impl std::iter::Sum for Facets {
    fn sum<I: Iterator<Item = Facets>>(pieces: I) -> Facets {
        let mut sum = Facets::default();
        pieces.for_each(|piece| sum += piece);
        sum
    }
}
