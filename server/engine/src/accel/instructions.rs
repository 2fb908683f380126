//! Which vector instructions rays are walked with: found once at run time, the same source and answers for all.

use fearless_simd::Level;

/// Vector instructions, each set including those before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Instructions {
    /// What every machine of the architecture has: SSE2, NEON.
    Baseline,
    /// AVX2 and FMA. Machines with AVX-512 use these too: its masks and wider registers made rays a sixth slower.
    Avx2,
}

impl Instructions {
    /// The best level of this machine that needs no more than these.
    pub(super) fn level(self) -> Level {
        let here = Level::new();
        #[cfg(target_arch = "x86_64")]
        {
            use fearless_simd::Simd;
            let sse2 = || here.as_sse2().map(Simd::level);
            let best = match self {
                Instructions::Baseline => sse2(),
                Instructions::Avx2 => here.as_avx2().map(Simd::level).or_else(sse2),
            };
            best.unwrap_or(here)
        }
        #[cfg(not(target_arch = "x86_64"))]
        here
    }
}

/// Runs `$body` with `$simd` the token of `$level`, compiled for its instructions. Of those of x86-64 two are told apart: every
/// further one would add as much again to the time that compiling takes.
macro_rules! vectorized {
    ($level:expr, $simd:ident => $body:expr) => {{
        #[cfg(target_arch = "x86_64")]
        {
            use fearless_simd::{Level, Simd as _};
            match $level {
                Level::Avx2($simd) => $simd.vectorize(
                    #[inline(always)]
                    || $body,
                ),
                level => match level.as_sse2() {
                    Some($simd) => $simd.vectorize(
                        #[inline(always)]
                        || $body,
                    ),
                    None => unreachable!("every x86-64 has SSE2"),
                },
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            fearless_simd::dispatch!($level, $simd => $body)
        }
    }};
}
pub(super) use vectorized;
