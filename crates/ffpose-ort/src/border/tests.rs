//! What no graph can bring about: panics, and an ONNX Runtime that is too old.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ptr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use ffpose_core::Pool;

use super::api::guard;
use super::pool::{SessionPool, SessionThreads};
use super::register::RegisterCustomOps;
use super::sys::{
    ApiBase, ApiTable, Body, INVALID_ARGUMENT, RUNTIME_EXCEPTION, StatusPtr, VERSION,
};
use super::{Api, Context, Element, ElementType, Failure, Info, Kernel, Operator};

/// As many functions as the table of an ONNX Runtime 1.17 has at least.
const FUNCTIONS: usize = size_of::<ApiTable>() / size_of::<*const c_void>();

/// A status of the fake runtime.
type Told = (c_int, CString);

unsafe extern "system" fn create_status(code: c_int, text: *const c_char) -> StatusPtr {
    // SAFETY: the caller gives a C string.
    let text = unsafe { CStr::from_ptr(text) }.to_owned();
    Box::into_raw(Box::new((code, text))).cast()
}

unsafe extern "system" fn code_of(status: *const c_void) -> c_int {
    // SAFETY: made in `create_status`.
    unsafe { (*status.cast::<Told>()).0 }
}

unsafe extern "system" fn message_of(status: *const c_void) -> *const c_char {
    // SAFETY: made in `create_status`.
    unsafe { (*status.cast::<Told>()).1.as_ptr() }
}

unsafe extern "system" fn release_status(status: StatusPtr) {
    // SAFETY: made in `create_status`, and released once.
    drop(unsafe { Box::from_raw(status.cast::<Told>()) });
}

/// Runs every index on a thread of its own.
unsafe extern "system" fn parallel_for(
    _: *const c_void,
    body: Body,
    total: usize,
    _: usize,
    data: *mut c_void,
) -> StatusPtr {
    let data = data.addr();
    thread::scope(|scope| {
        for index in 0..total {
            // SAFETY: the data live until all threads are done.
            scope.spawn(move || unsafe { body(ptr::with_exposed_provenance_mut(data), index) });
        }
    });
    ptr::null_mut()
}

/// Runs the indices one by one on `THREADS` threads, the caller's own among them, as a session of so many does.
unsafe extern "system" fn parallel_for_of<const THREADS: usize>(
    _: *const c_void,
    body: Body,
    total: usize,
    _: usize,
    data: *mut c_void,
) -> StatusPtr {
    let (data, next) = (data.addr(), AtomicUsize::new(0));
    let work = || {
        for index in std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed)) {
            if index >= total {
                break;
            }
            // SAFETY: the data live until all threads are done.
            unsafe { body(ptr::with_exposed_provenance_mut(data), index) };
        }
    };
    thread::scope(|scope| {
        (1..THREADS).for_each(|_| drop(scope.spawn(work)));
        work();
    });
    ptr::null_mut()
}

/// What fails: every other function of the fake runtime.
unsafe extern "system" fn refuse() -> StatusPtr {
    // SAFETY: it is a C string.
    unsafe { create_status(INVALID_ARGUMENT, c"refused".as_ptr()) }
}

fn table() -> *const ApiTable {
    table_with(parallel_for as *const c_void)
}

fn table_with(parallel_for: *const c_void) -> *const ApiTable {
    let mut functions = [refuse as *const c_void; FUNCTIONS];
    functions[0] = create_status as *const c_void;
    functions[1] = code_of as *const c_void;
    functions[2] = message_of as *const c_void;
    functions[93] = release_status as *const c_void;
    functions[274] = parallel_for;
    Box::leak(Box::new(functions)).as_ptr().cast()
}

fn api() -> Api {
    // SAFETY: every place of the table has a function, and it is never freed.
    unsafe { Api::new(table()) }
}

/// What a status says.
fn told(status: StatusPtr) -> Option<(c_int, String)> {
    // SAFETY: null, or made in `create_status`.
    (!status.is_null()).then(|| unsafe { Box::from_raw(status.cast::<Told>()) }).map(|told| {
        let (code, text) = *told;
        (code, text.into_string().expect("UTF-8"))
    })
}

/// Makes ONNX Runtime's part of a life: create, compute, destroy; the statuses of the first two.
fn live<K: Kernel>() -> [Option<(c_int, String)>; 2] {
    let operator = Box::leak(Box::new(Operator::new::<K>(api())));
    // SAFETY: an operator begins with its table.
    let functions = unsafe { &*operator.table() };
    let mut kernel = ptr::dangling_mut();
    // SAFETY: the kernels of these tests look at neither node nor run.
    unsafe {
        let created = (functions.create)(functions, table(), ptr::null(), &raw mut kernel);
        if !created.is_null() {
            assert!(kernel.is_null());
        }
        let computed = if kernel.is_null() {
            ptr::null_mut()
        } else {
            (functions.compute)(kernel, ptr::null_mut())
        };
        (functions.destroy)(kernel);
        [told(created), told(computed)]
    }
}

/// Panics in its making, if `CREATE`, else in its use and its end.
struct Panics<const CREATE: bool>;

impl<const CREATE: bool> Kernel for Panics<CREATE> {
    const NAME: &'static CStr = c"Panics";
    const INPUTS: &'static [ElementType] = &[f32::TYPE];
    const LIKE_FIRST: bool = true;

    fn create(_: &Info<'_>) -> Result<Self, Failure> {
        assert!(!CREATE, "in the making");
        Ok(Self)
    }

    fn compute(&self, _: Context<'_>) -> Result<(), Failure> {
        panic!("in use {}", 1);
    }
}

impl<const CREATE: bool> Drop for Panics<CREATE> {
    fn drop(&mut self) {
        panic!("at the end");
    }
}

/// What [`told`] gives for a panic.
#[allow(clippy::unnecessary_wraps)] // to be compared with that
fn inside(text: &str) -> Option<(c_int, String)> {
    Some((RUNTIME_EXCEPTION, format!("ffpose failed inside; please report this call: {text}")))
}

#[test]
fn a_panic_becomes_a_status() {
    assert_eq!(live::<Panics<true>>(), [inside("in the making"), None]);
    assert_eq!(live::<Panics<false>>(), [None, inside("in use 1")]);
    assert_eq!(told(guard(api(), || std::panic::panic_any(1))), inside("no message"));
}

#[test]
fn a_failure_becomes_a_status_and_a_status_a_failure() {
    let failure = || Failure::invalid("expected one, got \0".into()).at("x");
    assert_eq!(told(guard(api(), || Ok(()))), None);
    let status = guard(api(), || Err(failure()));
    // SAFETY: the status is nobody else's.
    let result = unsafe { api().check(status) };
    assert_eq!(result, Err(Failure::invalid("x: expected one, got ?".into())));
}

#[test]
fn what_the_runtime_refuses_is_passed_on() {
    let threads = SessionThreads::default();
    // SAFETY: the fake runtime refuses without a look at the node or the run.
    let (info, context) =
        unsafe { (Info::new(api(), ptr::null()), Context::new(api(), ptr::null_mut(), &threads)) };
    let refused = || Failure::invalid("refused".into());
    assert_eq!(info.string(c"layout"), Err(refused()));
    assert_eq!(info.sizes(0), Err(refused()));
    assert_eq!(context.input::<f32>(0).map(|_| ()), Err(refused()));
    assert_eq!(context.into_output::<f32>(&[1]).map(|_| ()), Err(refused()));
}

#[test]
fn each_worker_runs_once_and_a_panic_reaches_the_caller_after_the_others() {
    // SAFETY: the fake runtime does not look at the run.
    let pool = unsafe { SessionPool::new(api(), ptr::null(), &SessionThreads::default()) };
    let runs = [const { AtomicUsize::new(0) }; 5];
    let count = |worker: usize| runs[worker].fetch_add(1, Ordering::Relaxed);
    pool.run(5, &|worker| {
        count(worker);
    });
    let work = |worker| {
        count(worker);
        assert!(worker != 2, "worker {worker} is lost");
    };
    let lost = || {
        pool.run(5, &work);
        Ok(())
    };
    assert_eq!(told(guard(api(), lost)), inside("worker 2 is lost"));
    assert!(runs.iter().all(|runs| runs.load(Ordering::Relaxed) == 2));
}

/// Threads that a pool plans for in the runs of a kernel of a session of `THREADS`, on a machine of so many processors.
fn planned<const THREADS: usize>(processors: usize, runs: usize) -> Vec<usize> {
    let threads = SessionThreads::new(processors, Duration::from_millis(100));
    // SAFETY: every place of the table has a function, and it is never freed.
    let api = unsafe { Api::new(table_with(parallel_for_of::<THREADS> as *const c_void)) };
    // SAFETY: the fake runtime does not look at the run.
    let pool = || unsafe { SessionPool::new(api, ptr::null(), &threads) };
    (0..runs).map(|_| pool().threads()).collect()
}

#[test]
fn work_is_planned_for_the_threads_of_the_session() {
    assert_eq!(planned::<1>(8, 5), [1; 5]);
    assert_eq!(planned::<3>(8, 5), [3; 5]);
    assert_eq!(planned::<8>(4, 2), [4; 2]);
    assert_eq!(planned::<2>(1, 2), [1; 2]);
}

#[test]
fn threads_that_came_too_late_are_counted_in_a_later_run() {
    let threads = SessionThreads::new(2, Duration::from_millis(100));
    // SAFETY: every place of the tables has a function, and they are never freed.
    let [late, in_time] =
        [parallel_for_of::<1> as *const c_void, parallel_for_of::<2> as *const c_void]
            .map(|parallel_for| unsafe { Api::new(table_with(parallel_for)) });
    // SAFETY: the fake runtime does not look at the run.
    let planned = |api| unsafe { SessionPool::new(api, ptr::null(), &threads) }.threads();
    let found = [late, in_time, late, in_time].map(planned);
    assert_eq!(found, [1, 2, 2, 2]);
}

unsafe extern "system" fn of_1_16(version: u32) -> *const ApiTable {
    if version < VERSION { table() } else { ptr::null() }
}

unsafe extern "system" fn of_no_version(_: u32) -> *const ApiTable {
    ptr::null()
}

unsafe extern "system" fn version() -> *const c_char {
    c"1.16.3".as_ptr()
}

#[test]
fn an_old_runtime_is_told() {
    let register = |get_api| {
        let base = ApiBase { get_api, get_version: version };
        // SAFETY: the options are not looked at.
        told(unsafe { RegisterCustomOps(ptr::null_mut(), &raw const base) })
    };
    let message = "ffpose: expected ONNX Runtime 1.17 or newer, got 1.16.3";
    assert_eq!(register(of_1_16), Some((INVALID_ARGUMENT, message.into())));
    assert_eq!(register(of_no_version), None);
}
