//! What the processor says of its caches.

use std::sync::OnceLock;

/// Bytes of the second cache of a core; of a processor that does not say, what is common.
pub(crate) fn second_cache() -> usize {
    static SIZE: OnceLock<usize> = OnceLock::new();
    *SIZE.get_or_init(|| detected().unwrap_or(1 << 20))
}

/// The leaf that AMD defined and Intel has as well.
#[cfg(target_arch = "x86_64")]
#[allow(unused_unsafe)] // newer Rust has the instruction as a safe function
fn detected() -> Option<usize> {
    use std::arch::x86_64::__cpuid;
    const HIGHEST: u32 = 0x8000_0000;
    const CACHES: u32 = 0x8000_0006;
    // SAFETY: every 64-bit x86 has the instruction, and the first leaf tells whether there is the second.
    let kilobytes = unsafe { (__cpuid(HIGHEST).eax >= CACHES).then(|| __cpuid(CACHES).ecx >> 16)? };
    (kilobytes > 0).then_some((kilobytes as usize) << 10)
}

#[cfg(not(target_arch = "x86_64"))]
fn detected() -> Option<usize> {
    None
}
