//! Asking for memory ahead of its use.

use super::LINE_BYTES;

/// Asks for as many cache lines as `len` elements fill, from `start` on, whatever is there.
#[inline(always)]
pub(super) fn prefetch_lines<T>(start: *const T, len: usize) {
    for line in 0..(len * size_of::<T>()).div_ceil(LINE_BYTES) {
        prefetch(start.wrapping_add(line * (LINE_BYTES / size_of::<T>())));
    }
}

/// Asks for a cache line, if the instruction set has a way to.
#[inline(always)]
pub(super) fn prefetch<T>(address: *const T) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: the instruction is part of the base architecture, and no address makes it fail.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(address.cast());
    }
    #[cfg(target_arch = "aarch64")]
    // SAFETY: the instruction is part of the base architecture, and no address makes it fail. It changes no register and no
    // memory.
    unsafe {
        use std::arch::asm; // its intrinsic is not stable
        asm!("prfm pldl1keep, [{}]", in(reg) address.addr(), options(nomem, nostack, preserves_flags));
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = address;
}
