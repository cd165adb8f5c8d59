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

/// From Linux's description of the first core's caches. Where cores differ the first is a small one, as a rule; a cache that cores
/// share counts as a whole.
#[cfg(not(target_arch = "x86_64"))]
fn detected_l2_cache() -> Option<usize> {
    let caches = std::fs::read_dir("/sys/devices/system/cpu/cpu0/cache").ok()?;
    caches.flatten().find_map(|cache| {
        let text = |name| std::fs::read_to_string(cache.path().join(name)).unwrap_or_default();
        l2_bytes(&text("level"), &text("type"), &text("size"))
    })
}

/// Bytes of a cache that Linux describes by these texts, if it is an L2 cache that holds data.
#[cfg(any(test, not(target_arch = "x86_64")))]
fn l2_bytes(level: &str, kind: &str, size: &str) -> Option<usize> {
    let holds_data = matches!(kind.trim(), "Unified" | "Data");
    let kilobytes: usize = size.trim().strip_suffix('K')?.parse().ok()?;
    (level.trim() == "2" && holds_data && kilobytes > 0).then(|| kilobytes.checked_mul(1 << 10))?
}

/// Unknown of other processors: prefetching in vain costs less than not prefetching (see `Tuning`).
#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn fetches_ahead() -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_l2_cache_is_found_among_what_linux_describes() {
        let xeon = [
            ["1\n", "Data\n", "48K\n"],
            ["1\n", "Instruction\n", "32K\n"],
            ["2\n", "Unified\n", "1280K\n"],
            ["3\n", "Unified\n", "49152K\n"],
        ];
        let l2 = |caches: &[[&str; 3]]| {
            caches.iter().find_map(|[level, kind, size]| l2_bytes(level, kind, size))
        };
        assert_eq!(l2(&xeon), Some(1280 << 10));
        assert_eq!(
            l2(&[["2\n", "Instruction\n", "1024K\n"], ["2\n", "Data\n", "256K\n"]]),
            Some(1 << 18)
        );
        assert_eq!(l2(&xeon[..2]), None);
    }

    #[test]
    fn no_size_is_invented_where_linux_gives_none() {
        let too_large = format!("{}K\n", usize::MAX);
        for size in ["", "\n", "K\n", "0K\n", "-1K\n", "1M\n", "1048576\n", &too_large] {
            assert_eq!(l2_bytes("2\n", "Unified\n", size), None, "{size}");
        }
        assert_eq!(l2_bytes("", "Unified\n", "1024K\n"), None);
        assert_eq!(l2_bytes("2\n", "", "1024K\n"), None);
    }
}
