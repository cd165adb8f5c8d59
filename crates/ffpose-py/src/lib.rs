//! `ffpose._rust`: ffpose-core, ffpose-scene and ffpose-track for NumPy arrays and torch tensors. Every function checks, releases the GIL, computes and maps errors.

mod array;
mod border;
mod earth;
mod in_use;
mod noise;
mod pool;
mod pose;
mod spectral;
mod tensor;
mod textures;
mod tracking;

use pyo3::prelude::*;

/// Refuses a processor on which NumPy's wheels end with an illegal instruction; this library itself needs none of the newer ones.
fn expect_processor() -> PyResult<()> {
    #[cfg(target_arch = "x86_64")]
    if !(is_x86_feature_detected!("sse4.2") && is_x86_feature_detected!("popcnt")) {
        return Err(pyo3::exceptions::PyImportError::new_err(
            "ffpose and NumPy need a processor with SSE4.2 and POPCNT (x86-64-v2: Intel from 2009, AMD from 2011), and this one lacks them",
        ));
    }
    Ok(())
}

/// Whether the processor adds products of 8-bit numbers in 32 bits (AVX512-VNNI, AVX-VNNI); others add pairs in 16, which saturate.
///
/// `ffpose-onboard`, which depends on nothing here, has the same.
#[pyfunction]
fn has_vnni() -> bool {
    #[cfg(target_arch = "x86_64")]
    return is_x86_feature_detected!("avxvnni")
        || is_x86_feature_detected!("avx512vnni")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

/// The compiled core of ffpose. Arrays are C-contiguous float32 or float64.
///
/// What a call reads and writes is noted under the interpreter's lock (`in_use`).
#[pymodule(gil_used = true)]
mod _rust {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::earth::shade_earth;
    #[pymodule_export]
    use super::has_vnni;
    #[pymodule_export]
    use super::noise::fractal_noise;
    #[pymodule_export]
    use super::pose::{
        canonical_quaternion, esa_score, euler_to_quaternion, normalize_quaternion,
        normalize_quaternion_backward, quaternion_to_euler, rotation_error, speed_plus_score,
        translation_error,
    };
    #[pymodule_export]
    use super::spectral::{
        filter_tensors, filter_tensors_backward, isa, isas, spectral_filter,
        spectral_filter_backward,
    };
    #[pymodule_export]
    use super::textures::sample_texture;
    #[pymodule_export]
    use super::tracking::PyTracker;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::expect_processor()?;
        super::pool::watch_forks();
        super::array::initialize(module.py())?;
        super::spectral::initialize();
        Ok(())
    }

    #[pymodule_export]
    #[allow(non_upper_case_globals)] // Python's name for it
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
