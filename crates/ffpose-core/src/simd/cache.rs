//! What the processor says of its caches.

/// Bytes of the L2 cache of a core; of a processor that does not say, what is common.
pub(crate) fn l2_cache() -> usize {
    detected_l2_cache().unwrap_or(1 << 20)
}

#[cfg(target_arch = "x86_64")]
#[allow(unused_unsafe)] // newer Rust has the instruction as a safe function
fn cpuid(leaf: u32) -> std::arch::x86_64::CpuidResult {
    // SAFETY: every 64-bit x86 has the instruction, which answers for any leaf.
    unsafe { std::arch::x86_64::__cpuid(leaf) }
}

/// From the leaf that AMD defined and Intel has as well.
#[cfg(target_arch = "x86_64")]
fn detected_l2_cache() -> Option<usize> {
    const HIGHEST: u32 = 0x8000_0000;
    const CACHES: u32 = 0x8000_0006;
    let kilobytes = (cpuid(HIGHEST).eax >= CACHES).then(|| cpuid(CACHES).ecx >> 16)?;
    (kilobytes > 0).then_some((kilobytes as usize) << 10)
}

/// Whether the hardware prefetcher brings lines from the L3 cache soon enough: Intel's does.
#[cfg(target_arch = "x86_64")]
pub(crate) fn fetches_ahead() -> bool {
    let name = cpuid(0);
    [name.ebx, name.edx, name.ecx].map(u32::to_le_bytes).as_flattened() == b"GenuineIntel"
}

#[cfg(not(target_arch = "x86_64"))]
fn detected_l2_cache() -> Option<usize> {
    None
}

#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn fetches_ahead() -> bool {
    false
}
