//! ONNX Runtime, whose library and that of ffpose's operator are loaded at run time.

use std::env::{self, consts};
use std::error::Error as _;
use std::path::{Path, PathBuf, absolute};
use std::sync::{Mutex, PoisonError};

use ort::LoadDynamicError;
use ort::environment::Environment;
use ort::logging::LogLevel;
use ort::session::Session;
use ort::session::builder::SessionBuilder;

use crate::error::{Error, Result};
use crate::model::Model;
use crate::options::Setup;

/// A process has one.
static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);

/// Opens the model of a file as it was read, by the library of the first that was opened in this process.
///
/// # Errors
/// ONNX Runtime, the operator's library or the model cannot be loaded, or the library is needed and not named.
pub fn open_session(options: &Setup, path: &Path, model: &Model) -> Result<Session> {
    if model.metadata.needs_operators && options.operators.is_none() {
        return Err(Error::new(format!(
            "{}: expected --operators with the path of libffpose_ort.so, by which this model computes its filters, got none",
            path.display()
        )));
    }
    let mut loaded = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    let environment = match &mut *loaded {
        Some(environment) => environment,
        none => none.insert(load(options.runtime.as_deref())?),
    };
    let mut builder = Session::builder(environment)
        .map_err(|error| refused(&error))?
        .with_log_level(LogLevel::Fatal)
        .map_err(|error| refused(&error))?;
    if !has_vnni() {
        // Without it sums of int8 products saturate on x86-64; it has no effect on other architectures.
        builder = builder.with_precise_qmm().map_err(|error| refused(&error))?;
    }
    if let Some(threads) = options.threads {
        builder = builder.with_intra_threads(threads).map_err(|error| refused(&error))?;
    }
    if let Some(library) = &options.operators {
        builder = register(builder, library)?;
    }
    let session = builder.commit_from_memory(&model.bytes);
    session.map_err(|error| refused(&error).of(path.display()))
}

/// Whether the processor adds products of 8-bit numbers in 32 bits (AVX512-VNNI, AVX-VNNI); others add pairs in 16, which saturate.
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

/// An error of ONNX Runtime.
pub fn refused<R>(error: &ort::Error<R>) -> Error {
    Error::new(error.to_string()).of("ONNX Runtime")
}

/// Loads ONNX Runtime. Its errors come back as values, so that it logs none itself.
fn load(named: Option<&Path>) -> Result<Environment> {
    // Not of the working folder, which may be anybody's.
    let usual = || format!("{}onnxruntime{}", consts::DLL_PREFIX, consts::DLL_SUFFIX).into();
    let library = named.map_or_else(usual, located);
    if library.is_relative() && env::current_exe().is_err() {
        return Err(Error::new(format!(
            "ONNX Runtime's library: expected an absolute path, as the place of this program is not known, got {}",
            library.display()
        )));
    }
    let builder = ort::init_from(&library).map_err(|error| {
        let detail = match &error {
            LoadDynamicError::Dlopen { error, .. } => error.source().map(ToString::to_string),
            _ => None,
        };
        let detail = detail.unwrap_or_else(|| error.to_string());
        let named = library.display();
        Error::new(format!("ONNX Runtime's library {named} (--runtime) cannot be loaded: {detail}"))
    })?;
    let environment = builder.build().map_err(|error| refused(&error))?;
    environment.set_log_level(LogLevel::Fatal);
    Ok(environment)
}

fn register(builder: SessionBuilder, library: &Path) -> Result<SessionBuilder> {
    builder.with_operator_library(located(library)).map_err(|error| {
        let (named, architecture) = (library.display(), consts::ARCH);
        Error::new(format!(
            "the operator's library {named} (--operators), which must be of this architecture ({architecture}), cannot be \
             loaded: {error}"
        ))
    })
}

/// Returns the absolute path of a file that exists. Another name is looked for beside this program, and where the system has
/// its libraries.
fn located(library: &Path) -> PathBuf {
    let absolute = library.exists().then(|| absolute(library).ok()).flatten();
    absolute.unwrap_or_else(|| library.to_path_buf())
}
