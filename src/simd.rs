//! Instruction sets of the inner loops: detected once at run time, and capped by an environment variable.
//!
//! A loop in plain Rust is compiled once for every level, and the best level that the processor has is taken when it is
//! called. Loops use `a*b + c` without contraction and add in a fixed order, so every level gives the same bits. The
//! environment variable `HELIOSPLAT_SIMD` (`sse2`, `avx2` or `avx512`) caps the level, for tests of this.

use std::sync::OnceLock;

/// A set of instructions; each includes those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// The level the binary is compiled for: SSE2 on x86-64.
    Sse2,
    /// AVX2, of 2013 and later.
    Avx2,
    /// AVX-512 as processors have it since Ice Lake and Zen 4; earlier ones slow down for it.
    Avx512,
}

/// Environment variable that caps the level.
pub const VARIABLE: &str = "HELIOSPLAT_SIMD";

impl Level {
    /// The best level that this processor has.
    fn of_processor() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let avx2 = has!("avx2") && has!("popcnt");
            let avx512 = has!("avx512f") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl");
            if avx2 && avx512 && has!("avx512vpopcntdq") {
                return Self::Avx512;
            }
            if avx2 {
                return Self::Avx2;
            }
        }
        Self::Sse2
    }

    /// The level of a name; `None` for an unknown one.
    fn named(name: &str) -> Option<Self> {
        match name {
            "sse2" => Some(Self::Sse2),
            "avx2" => Some(Self::Avx2),
            "avx512" => Some(Self::Avx512),
            _ => None,
        }
    }
}

/// The level in use: the processor's best, or the cap of [`VARIABLE`] where that is lower.
pub fn level() -> Level {
    static LEVEL: OnceLock<Level> = OnceLock::new();
    *LEVEL.get_or_init(|| {
        let best = Level::of_processor();
        let asked = std::env::var(VARIABLE).ok();
        match asked.as_deref().map(Level::named) {
            None => best,
            Some(Some(cap)) => best.min(cap),
            Some(None) => {
                tracing::warn!("{VARIABLE} is none of sse2, avx2, avx512: ignored");
                best
            }
        }
    })
}

/// The level in use, capped at `cap` if all `conditions` hold.
pub fn level_up_to(cap: Level, conditions: &[bool]) -> Level {
    match conditions.iter().all(|&holds| holds) {
        true => level().min(cap),
        false => level(),
    }
}

/// Compiles a function of plain loops for every level and selects one at each call. Called functions are included only
/// where they are inlined. `up to LEVEL;` before the function caps its level, where a higher one was measured to be
/// slower; `up to LEVEL where CONDITION;` does so for some of its constants only.
#[macro_export]
macro_rules! vectorised {
    (
        up to $cap:ident $(where $capped:expr)?;
        $(#[$meta:meta])*
        $vis:vis fn $name:ident $(<$(const $k:ident: $kind:ty),+>)? ($($arg:ident: $of:ty),* $(,)?) $(-> $out:ty)?
        $body:block
    ) => {
        $(#[$meta])*
        $vis fn $name $(<$(const $k: $kind),+>)? ($($arg: $of),*) $(-> $out)? {
            #[inline(always)]
            fn plain $(<$(const $k: $kind),+>)? ($($arg: $of),*) $(-> $out)? $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,popcnt")]
                fn avx2 $(<$(const $k: $kind),+>)? ($($arg: $of),*) $(-> $out)? {
                    plain $(::<$($k),+>)? ($($arg),*)
                }
                #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vpopcntdq")]
                fn avx512 $(<$(const $k: $kind),+>)? ($($arg: $of),*) $(-> $out)? {
                    plain $(::<$($k),+>)? ($($arg),*)
                }
                #[allow(
                    unsafe_code,
                    clippy::undocumented_unsafe_blocks,
                    reason = "a function compiled for more than the baseline can be called no other way"
                )]
                match $crate::simd::level_up_to($crate::simd::Level::$cap, &[$($capped)?]) {
                    $crate::simd::Level::Avx512 => {
                        // SAFETY: a level is never above the one detected on the processor.
                        return unsafe { avx512 $(::<$($k),+>)? ($($arg),*) };
                    }
                    $crate::simd::Level::Avx2 => {
                        // SAFETY: a level is never above the one detected on the processor.
                        return unsafe { avx2 $(::<$($k),+>)? ($($arg),*) };
                    }
                    $crate::simd::Level::Sse2 => {}
                }
            }
            #[allow(unreachable_code)]
            { plain $(::<$($k),+>)? ($($arg),*) }
        }
    };
    ($($function:tt)*) => {
        $crate::vectorised! { up to Avx512; $($function)* }
    };
}

/// Prefetches `items[index]`; an index beyond the end has no effect.
#[inline(always)]
pub(crate) fn prefetch<T>(items: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let address = items.as_ptr().wrapping_add(index).cast();
        // SAFETY: part of SSE, which every x86-64 has; a prefetch reads nothing that the program sees, at any address.
        #[allow(unsafe_code, reason = "a hint to the cache has no safe form")]
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(address);
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (items, index);
}

#[cfg(test)]
mod tests {
    use super::*;

    vectorised! {
        /// A sum that would change if it were contracted or reordered.
        fn sum_of_products<const LANES: usize>(a: &[f32], b: &[f32]) -> f32 {
            let mut sums = [0.0f32; LANES];
            for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
                for l in 0..LANES {
                    sums[l] += a[l] * b[l];
                }
            }
            sums.iter().sum()
        }
    }

    #[test]
    fn the_level_in_use_is_one_that_the_processor_has() {
        assert!(level() <= Level::of_processor());
        assert!(Level::Sse2 < Level::Avx2 && Level::Avx2 < Level::Avx512);
    }

    #[test]
    fn names_are_levels_and_other_names_are_none() {
        assert_eq!(Level::named("sse2"), Some(Level::Sse2));
        assert_eq!(Level::named("avx2"), Some(Level::Avx2));
        assert_eq!(Level::named("avx512"), Some(Level::Avx512));
        assert_eq!(Level::named("AVX9"), None);
    }

    #[test]
    fn a_prefetch_changes_nothing_wherever_it_points() {
        let values = [1.0f32, 2.0, 3.0];
        for index in [0, 2, 3, 1 << 20, usize::MAX / 8] {
            prefetch(&values, index);
        }
        prefetch::<f32>(&[], 0);
        assert_eq!(values, [1.0, 2.0, 3.0]);
    }

    #[test]
    fn a_vectorised_sum_has_the_bits_of_a_plain_one() {
        let value = |i: usize| ((i * 7919 + 13) % 1009) as f32 * 0.37 - 180.0;
        let a: Vec<f32> = (0..4096).map(value).collect();
        let b: Vec<f32> = (0..4096).map(|i| value(i + 77)).collect();
        let mut sums = [0.0f32; 8];
        for (i, (a, b)) in a.iter().zip(&b).enumerate() {
            sums[i % 8] += std::hint::black_box(a * b);
        }
        assert_eq!(
            sum_of_products::<8>(&a, &b).to_bits(),
            sums.iter().sum::<f32>().to_bits()
        );
    }
}
