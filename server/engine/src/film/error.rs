//! The error of a picture against a reference: the contract's one definition.

use crate::math::Rgb;

/// How far a picture is from a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageError {
    /// Mean over pixels and channels of (t−r)² / (r² + 0.01·m²), m = mean of r.
    pub rel_mse: f64,
    /// The same without the worst 0.1 % of pixels (one pixel at least).
    pub trimmed: f64,
    /// (mean t − mean r) / mean r.
    pub bias: f64,
    /// Pixels of the test image that hold a NaN or an infinity; they were compared as black.
    pub non_finite_pixels: u64,
}

impl ImageError {
    /// What people are shown: √relMSE, a share (0.01 = 1 %).
    pub fn error(&self) -> f64 {
        self.rel_mse.sqrt()
    }
}

/// Two pictures that cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CompareError {
    /// Different numbers of pixels, or none.
    #[error("cannot compare {test} pixels with a reference of {reference} pixels")]
    Size {
        /// Pixels of the test picture.
        test: usize,
        /// Pixels of the reference.
        reference: usize,
    },
    /// A reference that is black or not finite gives nothing to be relative to.
    #[error("the reference is black or not finite, so there is no relative error to it")]
    Reference,
}

/// Error of `test` against `reference`, both linear radiance, `[h × w]` in the same order.
pub fn compare(test: &[Rgb], reference: &[Rgb]) -> Result<ImageError, CompareError> {
    if test.len() != reference.len() || test.is_empty() {
        return Err(CompareError::Size { test: test.len(), reference: reference.len() });
    }
    let reference_mean = mean_of(reference.iter().copied());
    if !(reference_mean > 0.0 && reference_mean.is_finite()) {
        return Err(CompareError::Reference);
    }
    let finite = |colour: &Rgb| if colour.is_finite() { *colour } else { Rgb::BLACK };
    let floor = 0.01 * reference_mean * reference_mean;
    let mut errors: Vec<f64> = test
        .iter()
        .zip(reference)
        .map(|(test, reference)| pixel_error(finite(test), *reference, floor))
        .collect();
    Ok(ImageError {
        rel_mse: errors.iter().sum::<f64>() / errors.len() as f64,
        trimmed: trimmed_mean(&mut errors),
        bias: mean_of(test.iter().map(finite)) / reference_mean - 1.0,
        non_finite_pixels: test.iter().filter(|colour| !colour.is_finite()).count() as u64,
    })
}

fn pixel_error(test: Rgb, reference: Rgb, floor: f64) -> f64 {
    let channel = |t: f32, r: f32| (f64::from(t) - f64::from(r)).powi(2) / (f64::from(r).powi(2) + floor);
    (0..3).map(|index| channel(test[index], reference[index])).sum::<f64>() / 3.0
}

fn mean_of(pixels: impl ExactSizeIterator<Item = Rgb>) -> f64 {
    let count = pixels.len() as f64;
    pixels.map(|pixel| pixel.to_array().into_iter().map(f64::from).sum::<f64>() / 3.0).sum::<f64>() / count
}

/// Mean without the largest 0.1 % (one value at least), as `compare.py` has it. Reorders `values`.
/// Zero for a single value.
pub(super) fn trimmed_mean(values: &mut [f64]) -> f64 {
    let left_out = (values.len() / 1000).max(1);
    let Some(kept) = values.len().checked_sub(left_out).filter(|kept| *kept > 0) else { return 0.0 };
    values.select_nth_unstable_by(kept, f64::total_cmp);
    values[..kept].iter().sum::<f64>() / kept as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture with every kind of pixel: below, at and above the reference, coloured, one outlier.
    fn pictures() -> (Vec<Rgb>, Vec<Rgb>) {
        let reference: Vec<Rgb> = (0..2500)
            .map(|i| Rgb::new(0.1 + 0.001 * (i % 50) as f32, 0.2, 0.05 * (1 + i % 3) as f32))
            .collect();
        let mut test: Vec<Rgb> = reference
            .iter()
            .enumerate()
            .map(|(i, r)| *r * (1.0 + 0.1 * ((i % 7) as f32 - 3.0) / 3.0))
            .collect();
        test[17] = Rgb::new(9.0, 4.0, 0.0);
        (test, reference)
    }

    /// The numbers are those of `compare.py` on the same two pictures.
    #[test]
    fn error_trimmed_error_and_bias_equal_those_of_the_reference_tool() {
        let (test, reference) = pictures();
        let error = compare(&test, &reference).unwrap();
        let close = |ours: f64, theirs: f64| assert!((ours / theirs - 1.0).abs() < 1e-6, "{ours} {theirs}");
        close(error.rel_mse, COMPARE_PY.0);
        close(error.trimmed, COMPARE_PY.1);
        close(error.bias, COMPARE_PY.2);
    }

    /// relMSE, relMSE_trim0.1% and bias_rel that the tool printed for the same pictures in a 50 × 50 grid.
    const COMPARE_PY: (f64, f64, f64) = (0.809_891_323_7, 0.004_368_406_578, 0.011_778_770_774);

    /// A picture compared with itself has no error; twice the picture has a bias of exactly 1.
    #[test]
    fn equal_pictures_have_no_error_and_doubled_ones_bias_one() {
        let (_, reference) = pictures();
        let same = compare(&reference, &reference).unwrap();
        assert_eq!((same.rel_mse, same.trimmed, same.bias), (0.0, 0.0, 0.0));
        let doubled: Vec<Rgb> = reference.iter().map(|colour| *colour * 2.0).collect();
        assert!((compare(&doubled, &reference).unwrap().bias - 1.0).abs() < 1e-12);
    }

    /// The measure is relative: a common factor on both pictures changes nothing.
    #[test]
    fn error_does_not_depend_on_the_unit() {
        let (test, reference) = pictures();
        let scaled = |picture: &[Rgb]| picture.iter().map(|c| *c * 1024.0).collect::<Vec<_>>();
        let (one, other) =
            (compare(&test, &reference).unwrap(), compare(&scaled(&test), &scaled(&reference)).unwrap());
        assert!((one.rel_mse / other.rel_mse - 1.0).abs() < 1e-12);
    }

    /// Broken pixels are compared as black and counted.
    #[test]
    fn non_finite_pixels_are_counted() {
        let (mut test, reference) = pictures();
        test[3] = Rgb::new(f32::NAN, 0.0, 0.0);
        let error = compare(&test, &reference).unwrap();
        assert_eq!(error.non_finite_pixels, 1);
        assert!(error.rel_mse.is_finite());
    }

    /// What cannot be compared is refused.
    #[test]
    fn different_sizes_and_black_references_are_refused() {
        let white = [Rgb::WHITE; 4];
        assert_eq!(compare(&white[..3], &white), Err(CompareError::Size { test: 3, reference: 4 }));
        assert_eq!(compare(&white, &[Rgb::BLACK; 4]), Err(CompareError::Reference));
    }
}
