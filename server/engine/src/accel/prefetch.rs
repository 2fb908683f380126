//! A hint to the memory: what a ray will need soon is fetched while it does something else.

/// Bytes that one hint fetches.
const LINE: usize = 64;

/// Asks for all that `data` holds. Changes nothing but when it arrives; does nothing where there is no such hint.
#[inline(always)]
#[allow(unsafe_code)]
pub(super) fn prefetch<T>(data: &[T]) {
    #[cfg(target_arch = "x86_64")]
    for line in 0..size_of_val(data).div_ceil(LINE) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let start = data.as_ptr().cast::<i8>().wrapping_add(line * LINE);
        // SAFETY: a prefetch reads nothing and cannot fault, whatever the address; SSE, which it needs, is part of
        // x86-64.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(start) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (data, LINE);
}
