//! The interface for C, `include/ffpose_onboard.h`, which says what each function does.
//!
//! No panic leaves it: each function runs in `catch_unwind`. Errors are codes, and a sentence of the thread's last one.
#![allow(unsafe_code)] // pointers of C are fenced in this one file

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ffi::{CStr, CString, c_char};
use std::mem;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::process;
use std::ptr::without_provenance_mut;
use std::slice;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use ffpose_track::{Outcome, Step};

use crate::error::Error;
use crate::estimator::{Deadline, Estimator, Look};
use crate::options::{MAX_THREADS, Setup, Taken, default_runtime, digest};
use crate::picture::{Picture, expect_size};
use crate::pose::Outputs;
use crate::track::{Track, measurement};

const OK: i32 = 0;
const LATE: i32 = 1;
const FAILED: i32 = 2;
const NULL: i32 = 3;
const PANIC: i32 = 4;

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// What a model and its track are opened with.
#[repr(C)]
pub struct FfposeSettings {
    model: *const c_char,
    runtime: *const c_char,
    operators: *const c_char,
    camera: *const c_char,
    track: *const c_char,
    sha256: *const c_char,
    threads: u32,
    resize: u32,
}

/// Pixels of the caller's.
#[repr(C)]
pub struct FfposeImage {
    pixels: *const u8,
    width: u32,
    height: u32,
    channels: u32,
    stride: usize,
}

/// A pose.
#[repr(C)]
pub struct FfposePose {
    position: [f64; 3],
    orientation: [f64; 4],
    position_covariance: [[f64; 3]; 3],
    rotation_covariance: [[f64; 3]; 3],
    degrees_of_freedom: [f64; 2],
    alternative: [f64; 4],
    probabilities: [f64; 2],
    in_view: f64,
    is_flagged: i32,
}

/// A motion.
#[repr(C)]
pub struct FfposeMotion {
    time: f64,
    outcome: i32,
    has_track: i32,
    is_accepted: i32,
    position: [f64; 3],
    orientation: [f64; 4],
    velocity: [f64; 3],
    rate: [f64; 3],
    covariance: [[f64; 12]; 12],
    nis: f64,
}

/// What a handle points to: nothing, as its address is a number that is given once.
pub struct Ffpose;

/// A model that is open, and its track.
struct Opened {
    estimator: Estimator,
    track: Track,
    /// The process that opened it: none that was forked from it.
    process: u32,
}

/// What is open, by its handle's number.
static OPENED: Mutex<BTreeMap<usize, Arc<Mutex<Opened>>>> = Mutex::new(BTreeMap::new());

static NEXT: AtomicUsize = AtomicUsize::new(1);

/// Why a function does not do what it says.
enum Fault {
    Failed(Error),
    /// A pointer of this name is null.
    Null(&'static str),
}

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

/// Runs what a function does, and keeps its error's sentence.
fn guarded(run: impl FnOnce() -> Result<i32, Fault>) -> i32 {
    let (code, text) = match catch_unwind(AssertUnwindSafe(run)) {
        Ok(Ok(code)) => return code,
        Ok(Err(Fault::Failed(error))) => (FAILED, error.to_string()),
        Ok(Err(Fault::Null(name))) => (NULL, format!("{name}: expected a pointer, got null")),
        Err(_) => (PANIC, "a panic, a bug of this library: the handle is to be closed".into()),
    };
    let text = CString::new(text.replace('\0', " ")).unwrap_or_default();
    // A destructor of the thread may call after the sentence's own: it is dropped then.
    let _ = LAST.try_with(|last| last.replace(text));
    code
}

/// The sentence of this thread's last error; empty before the first, and once the thread's own memory is given back.
#[unsafe(no_mangle)]
pub extern "C" fn ffpose_error() -> *const c_char {
    LAST.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

/// Refuses a pointer that is null, or that no value of its type may have.
fn expect_pointer<T>(name: &'static str, pointer: *const T) -> Result<(), Fault> {
    if pointer.is_null() {
        return Err(Fault::Null(name));
    }
    if pointer.is_aligned() {
        return Ok(());
    }
    let (multiple, got) = (align_of::<T>(), pointer.addr());
    let error =
        format!("{name}: expected an address that is a multiple of {multiple}, got {got:#x}");
    Err(Error::new(error).into())
}

/// Runs what a function does with an open handle.
fn with<T>(
    handle: *const Ffpose,
    run: impl FnOnce(&mut Opened) -> Result<T, Fault>,
) -> Result<T, Fault> {
    expect_pointer("handle", handle)?;
    let opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner).get(&handle.addr()).cloned();
    let refused = |got| {
        Fault::Failed(Error::new(format!(
            "handle: expected one that is open and in no other call, got {got}"
        )))
    };
    let opened = opened.ok_or_else(|| refused("one that is closed, or none of ffpose_open"))?;
    let mut opened = opened.try_lock().map_err(|error| {
        refused(match error {
            TryLockError::WouldBlock => "one in a call of another thread",
            TryLockError::Poisoned(_) => "one whose call ended in a panic: close it",
        })
    })?;
    run(&mut opened)
}

/// Opens a model, and a track of its poses.
///
/// # Safety
/// `settings` is null or valid, its strings null or ended by a zero; `handle` is null or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ffpose_open(
    settings: *const FfposeSettings,
    handle: *mut *mut Ffpose,
) -> i32 {
    guarded(|| {
        expect_pointer("settings", settings)?;
        expect_pointer("handle", handle)?;
        // SAFETY: not null, aligned, and valid as the caller says, with its strings.
        let (setup, settings) = unsafe { setup(&*settings) }?;
        let estimator = Estimator::open(&setup)?;
        let track = Track::new(&estimator, settings.as_deref())?;
        let opened = Arc::new(Mutex::new(Opened { estimator, track, process: process::id() }));
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        OPENED.lock().unwrap_or_else(PoisonError::into_inner).insert(number, opened);
        // SAFETY: not null, aligned, and valid for a write as the caller says.
        unsafe { handle.write(without_provenance_mut(number)) };
        Ok(OK)
    })
}

/// Frees a handle; null is none, nor is one that is closed.
#[unsafe(no_mangle)]
pub extern "C" fn ffpose_close(handle: *mut Ffpose) {
    guarded(|| {
        let opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner).remove(&handle.addr());
        let other =
            |one: &Arc<Mutex<Opened>>| one.try_lock().is_ok_and(|one| one.process != process::id());
        if opened.as_ref().is_some_and(other) {
            mem::forget(opened); // ONNX Runtime would wait for threads that a forked process has not
        } else {
            drop(opened); // or at the end of the call that another thread is in
        }
        Ok(OK)
    });
}

/// Poses one image.
///
/// # Safety
/// `image` and `pose` are null or valid; the image's pixels are there.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ffpose_pose(
    handle: *mut Ffpose,
    image: *const FfposeImage,
    seconds: f64,
    pose: *mut FfposePose,
) -> i32 {
    guarded(|| {
        with(handle, |Opened { estimator, .. }| {
            expect_pointer("image", image)?;
            expect_pointer("pose", pose)?;
            let deadline = deadline(seconds)?;
            if deadline.is_past() {
                return Ok(LATE);
            }
            // SAFETY: not null, aligned, and valid as the caller says.
            let picture = unsafe { picture(&*image) }?;
            let Some(outputs) = estimator.look(&picture, Look { at: None, deadline })? else {
                return Ok(LATE);
            };
            let told = told(&outputs, estimator);
            // SAFETY: not null, aligned, and valid for a write as the caller says.
            unsafe { pose.write(told) };
            Ok(OK)
        })
    })
}

/// Poses a frame and moves the track on; without an image, or where time runs out, the track coasts.
///
/// # Safety
/// As of `ffpose_pose`, with `motion` in the pose's place.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ffpose_track(
    handle: *mut Ffpose,
    time: f64,
    image: *const FfposeImage,
    seconds: f64,
    motion: *mut FfposeMotion,
) -> i32 {
    guarded(|| {
        with(handle, |Opened { estimator, track, .. }| {
            expect_pointer("motion", motion)?;
            let deadline = deadline(seconds)?;
            estimator.expect_uncertainty()?;
            track.expect_time(time)?;
            let outputs = if image.is_null() || deadline.is_past() {
                None
            } else {
                expect_pointer("image", image)?;
                // SAFETY: not null, aligned, and valid as the caller says.
                let picture = unsafe { picture(&*image) }?;
                estimator.look(&picture, Look { at: track.expected(time), deadline })?
            };
            let meaning = estimator.meaning();
            let seen = outputs.as_ref().map(|outputs| measurement(outputs, meaning)).transpose()?;
            let told = moved(time, &track.step(time, seen.as_ref())?);
            // SAFETY: not null, aligned, and valid for a write as the caller says.
            unsafe { motion.write(told) };
            Ok(if outputs.is_none() && !image.is_null() { LATE } else { OK })
        })
    })
}

/// Forgets the track, and the times of its frames.
#[unsafe(no_mangle)]
pub extern "C" fn ffpose_reset(handle: *mut Ffpose) -> i32 {
    guarded(|| {
        with(handle, |opened| {
            opened.track.reset();
            Ok(OK)
        })
    })
}

/// Writes the track to a file.
///
/// # Safety
/// `path` is null or ended by a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ffpose_save(handle: *const Ffpose, path: *const c_char) -> i32 {
    guarded(|| {
        with(handle, |opened| {
            // SAFETY: as the caller says.
            let path = unsafe { path_of("path", path) }?.ok_or(Fault::Null("path"))?;
            opened.track.save(&path)?;
            Ok(OK)
        })
    })
}

/// Takes up the track of a file.
///
/// # Safety
/// As of `ffpose_save`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ffpose_restore(handle: *mut Ffpose, path: *const c_char) -> i32 {
    guarded(|| {
        with(handle, |opened| {
            // SAFETY: as the caller says.
            let path = unsafe { path_of("path", path) }?.ok_or(Fault::Null("path"))?;
            opened.track.restore(&path)?;
            Ok(OK)
        })
    })
}

/// # Safety
/// The strings are null or ended by a zero.
unsafe fn setup(settings: &FfposeSettings) -> Result<(Setup, Option<PathBuf>), Fault> {
    let s = settings;
    // SAFETY: as the caller says.
    let path = |name, text| unsafe { path_of(name, text) };
    let (model, runtime) = (path("settings.model", s.model)?, path("settings.runtime", s.runtime)?);
    let (operators, camera) =
        (path("settings.operators", s.operators)?, path("settings.camera", s.camera)?);
    let (track, sha256) = (path("settings.track", s.track)?, path("settings.sha256", s.sha256)?);
    let sha256 = sha256.map(|text| digest("settings.sha256", text.as_os_str())).transpose();
    let images = match (camera, s.resize != 0) {
        (None, false) => Taken::ByModelsCamera,
        (Some(file), false) => Taken::ByCamera(file),
        (None, true) => Taken::Resized,
        (Some(_), true) => return Err(Error::new("expected camera or resize, got both").into()),
    };
    let threads = s.threads as usize;
    if threads > MAX_THREADS {
        let found = format!("settings.threads: expected at most {MAX_THREADS}, got {threads}");
        return Err(Error::new(found).into());
    }
    let setup = Setup {
        model: model.ok_or(Fault::Null("settings.model"))?,
        tracks: true,
        has_deadlines: true,
        threads: (threads > 0).then_some(threads),
        sha256: sha256.map_err(Error::new)?,
        runtime: runtime.or_else(default_runtime),
        operators,
        images,
    };
    Ok((setup, track))
}

/// Returns a path; None of null.
///
/// # Safety
/// `text` is null or ended by a zero.
unsafe fn path_of(name: &'static str, text: *const c_char) -> Result<Option<PathBuf>, Fault> {
    if text.is_null() {
        return Ok(None);
    }
    // SAFETY: not null, and ended by a zero as the caller says.
    let bytes = unsafe { CStr::from_ptr(text) };
    let text =
        bytes.to_str().map_err(|_| Error::new(format!("{name}: expected UTF-8, got {bytes:?}")))?;
    if text.is_empty() {
        return Err(
            Error::new(format!("{name}: expected a text or null, got an empty text")).into()
        );
    }
    Ok(Some(text.into()))
}

/// Copies an image, its size checked first.
///
/// # Safety
/// Its pixels are there: `height` rows, `stride` bytes apart.
unsafe fn picture(image: &FfposeImage) -> Result<Picture, Fault> {
    expect_pointer("image.pixels", image.pixels)?;
    let (width, height) = (image.width as usize, image.height as usize);
    expect_size(width, height)?;
    let channels = image.channels as usize;
    if channels != 1 && channels != 3 {
        return Err(Error::new(format!("channels: expected 1 or 3, got {channels}")).into());
    }
    let row = width * channels;
    let stride = if image.stride == 0 { row } else { image.stride };
    if !(row..=isize::MAX as usize / height).contains(&stride) {
        return Err(Error::new(format!(
            "stride: expected at least the {row} bytes of a row, and rows that fit in memory, got {stride}"
        ))
        .into());
    }
    let mut pixels = Vec::with_capacity(3 * width * height);
    for place in 0..height {
        // SAFETY: not null, the rows are there as the caller says, and the last one's offset does not overflow.
        let row = unsafe { slice::from_raw_parts(image.pixels.add(place * stride), row) };
        match channels {
            3 => pixels.extend_from_slice(row),
            _ => pixels.extend(row.iter().flat_map(|&level| [level; 3])),
        }
    }
    Ok(Picture { width, height, pixels })
}

/// When `seconds` from now are over, at once where they are negative; None for zero and for more than a clock counts, which is
/// no limit.
fn deadline(seconds: f64) -> Result<Deadline, Error> {
    if seconds.is_nan() {
        return Err(Error::new("seconds: expected a number, got NaN"));
    }
    let limit = Duration::try_from_secs_f64(seconds.max(0.0)).ok();
    let limit = limit.filter(|_| seconds != 0.0);
    Ok(Deadline(limit.and_then(|limit| Instant::now().checked_add(limit))))
}

fn told(outputs: &Outputs, estimator: &Estimator) -> FfposePose {
    let said = outputs.uncertainty.as_ref();
    let unknown = [[f64::NAN; 3]; 3];
    FfposePose {
        position: outputs.translation,
        orientation: outputs.orientation,
        position_covariance: said.map_or(unknown, |said| said.translation_covariance),
        rotation_covariance: said.map_or(unknown, |said| said.rotation_covariance),
        degrees_of_freedom: estimator.meaning().degrees_of_freedom.unwrap_or([f64::INFINITY; 2]),
        alternative: said.map_or(outputs.orientation, |said| said.alternative),
        probabilities: said.map_or([1.0, 0.0], |said| said.probabilities),
        in_view: said.map_or(f64::NAN, |said| said.in_view),
        is_flagged: i32::from(outputs.flagged(estimator.meaning()) == Some(true)),
    }
}

fn moved(time: f64, step: &Step) -> FfposeMotion {
    let outcome = match step.outcome {
        Outcome::Accepted => 0,
        Outcome::Switched => 1,
        Outcome::Gated => 2,
        Outcome::Coasted => 3,
        Outcome::Flagged => 4,
        Outcome::Acquiring => 5,
        Outcome::Lost => 6,
    };
    let none = [f64::NAN; 3];
    let one = step.estimate.as_ref();
    FfposeMotion {
        time,
        outcome,
        has_track: i32::from(one.is_some()),
        is_accepted: i32::from(step.accepted),
        position: one.map_or(none, |one| one.position),
        orientation: one.map_or([f64::NAN; 4], |one| one.orientation),
        velocity: one.map_or(none, |one| one.velocity),
        rate: one.map_or(none, |one| one.rate.map(f64::to_degrees)),
        covariance: one.map_or([[f64::NAN; 12]; 12], |one| one.covariance.into()),
        nis: step.nis.unwrap_or(f64::NAN),
    }
}
