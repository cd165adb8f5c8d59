//! The watch over deadlines: a thread that ends what another one does when its time is over.
#![allow(unsafe_code)] // the scheduler's functions are C's

use std::process;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::Instant;

use crate::error::{Error, Result};

/// Bytes of the thread's stack, which a process that locks its memory holds in full.
const STACK: usize = 64 << 10;

/// A thread that keeps deadlines, one after the other.
///
/// Under a real-time policy it runs at a priority above that of the thread it watches, or on one processor it would wait until
/// that has ended. Where the process may not raise it, it stays as it is; who is watched never waits for it.
pub struct Watch {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    /// The process that has the thread: none that was forked from it.
    process: u32,
}

#[derive(Default)]
struct Shared {
    task: Mutex<Task>,
    changed: Condvar,
}

#[derive(Default)]
enum Task {
    /// There is nothing to end.
    #[default]
    Idle,
    /// What is to be done at a time, unless it is over before.
    Until(Instant, Box<dyn FnOnce() + Send>),
    /// The thread is to end.
    Stop,
}

impl Shared {
    fn task(&self) -> MutexGuard<'_, Task> {
        self.task.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set(&self, task: Task) {
        *self.task() = task;
        self.changed.notify_one();
    }

    /// Keeps deadlines until there are no more.
    fn keep(&self) {
        let mut task = self.task();
        loop {
            let wait = match &*task {
                Task::Stop => return,
                Task::Idle => None,
                Task::Until(end, _) => Some(end.saturating_duration_since(Instant::now())),
            };
            task = match wait {
                None => self.changed.wait(task).unwrap_or_else(PoisonError::into_inner),
                Some(left) if !left.is_zero() => {
                    let waited = self.changed.wait_timeout(task, left);
                    waited.unwrap_or_else(PoisonError::into_inner).0
                }
                Some(_) => {
                    if let Task::Until(_, end_it) = std::mem::take(&mut *task) {
                        end_it(); // while nothing else can begin
                    }
                    task
                }
            };
        }
    }
}

impl Watch {
    /// Starts the thread, which ends with the watch.
    ///
    /// # Errors
    /// The system has no more threads.
    pub fn start() -> Result<Self> {
        let shared = Arc::<Shared>::default();
        let kept = Arc::clone(&shared);
        let thread = Builder::new().name("ffpose-watch".into()).stack_size(STACK);
        let thread = thread
            .spawn(move || kept.keep())
            .map_err(|error| Error::new(format!("no thread can be started: {error}")))?;
        Ok(Self { shared, thread: Some(thread), process: process::id() })
    }

    /// Returns what `run` returns, during which `end_it` is called if the time comes.
    ///
    /// # Errors
    /// This process was forked from the one of the thread, and the system has no more threads.
    pub fn over<T>(
        &mut self,
        end: Instant,
        end_it: impl FnOnce() + Send + 'static,
        run: impl FnOnce() -> T,
    ) -> Result<T> {
        if self.process != process::id() {
            std::mem::forget(std::mem::replace(self, Self::start()?)); // none to join
        }
        if let Some(thread) = &self.thread {
            outrank(thread);
        }
        self.shared.set(Task::Until(end, Box::new(end_it)));
        let _ended = Ended(&self.shared); // also where `run` panics
        Ok(run())
    }
}

struct Ended<'a>(&'a Shared);

impl Drop for Ended<'_> {
    fn drop(&mut self) {
        *self.0.task() = Task::Idle; // the thread looks when it wakes
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        if self.process == process::id() {
            self.shared.set(Task::Stop);
            // The library may be unloaded next.
            let _ = self.thread.take().map(JoinHandle::join);
        }
    }
}

/// Gives a thread the calling one's real-time policy and a priority above it, if it has one.
///
/// The kernel is asked: C libraries keep what they were told, or have no answer (glibc, musl).
#[cfg(target_os = "linux")]
fn outrank(thread: &JoinHandle<()>) {
    use std::os::unix::thread::JoinHandleExt;

    const SCHED_RESET_ON_FORK: libc::c_long = 0x4000_0000;
    // SAFETY: it has no condition; 0 is the calling thread.
    let policy = unsafe { libc::syscall(libc::SYS_sched_getscheduler, 0) } & !SCHED_RESET_ON_FORK;
    let real_time = [libc::SCHED_FIFO, libc::SCHED_RR];
    let Some(policy) = real_time.into_iter().find(|each| libc::c_long::from(*each) == policy)
    else {
        return;
    };
    // SAFETY: a structure of numbers, some of which not every C library has.
    let mut scheduling: libc::sched_param = unsafe { std::mem::zeroed() };
    // SAFETY: the pointer is of a variable that outlives the call.
    if unsafe { libc::syscall(libc::SYS_sched_getparam, 0, &raw mut scheduling) } != 0 {
        return;
    }
    // SAFETY: it has no condition.
    let most = unsafe { libc::sched_get_priority_max(policy) };
    scheduling.sched_priority = most.min(scheduling.sched_priority + 1);
    // SAFETY: the thread is not joined, as there is its handle; the pointer is of a variable that outlives the call.
    unsafe { libc::pthread_setschedparam(thread.as_pthread_t(), policy, &raw const scheduling) };
}

/// Leaves the priorities of other systems as they are.
#[cfg(not(target_os = "linux"))]
fn outrank(_: &JoinHandle<()>) {}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};
    use std::thread::{self, sleep};
    use std::time::Duration;

    use super::*;

    fn counter() -> (Arc<AtomicU32>, impl Fn() -> Box<dyn FnOnce() + Send>) {
        let count = Arc::new(AtomicU32::new(0));
        let counted = Arc::clone(&count);
        let add = move || -> Box<dyn FnOnce() + Send> {
            let counted = Arc::clone(&counted);
            Box::new(move || {
                counted.fetch_add(1, Ordering::SeqCst);
            })
        };
        (count, add)
    }

    fn after(time: Duration) -> Instant {
        Instant::now() + time
    }

    const SOON: Duration = Duration::from_millis(5);
    const LATE: Duration = Duration::from_hours(1);

    #[test]
    fn only_what_takes_too_long_is_ended() {
        let mut watch = Watch::start().unwrap();
        let (count, add) = counter();
        for number in 0..3 {
            assert_eq!(watch.over(after(LATE), add(), || 7).unwrap(), 7);
            let wait = || {
                while count.load(Ordering::SeqCst) == number {
                    sleep(Duration::from_millis(1));
                }
            };
            watch.over(after(SOON), add(), wait).unwrap();
        }
        watch.over(after(SOON), add(), || ()).unwrap();
        sleep(4 * SOON); // its time comes when it is over
        drop(watch); // which waits for the thread
        assert_eq!(count.load(Ordering::SeqCst), 3);
    }

    #[test]
    fn a_panic_ends_the_watch_over_it_alone() {
        let mut watch = Watch::start().unwrap();
        let (count, add) = counter();
        let run = || watch.over(after(SOON), add(), || panic!("a run"));
        assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)).is_err());
        sleep(4 * SOON);
        assert_eq!(watch.over(after(LATE), add(), || 7).unwrap(), 7);
        drop(watch);
        assert_eq!(count.load(Ordering::SeqCst), 0);
    }

    #[test]
    fn a_forked_process_has_a_watch_of_its_own() {
        let mut watch = Watch::start().unwrap();
        let there = watch.process;
        watch.process += 1; // as a child sees it
        let (count, add) = counter();
        let wait = || {
            while count.load(Ordering::SeqCst) == 0 {
                sleep(Duration::from_millis(1));
            }
        };
        watch.over(after(SOON), add(), wait).unwrap();
        assert_eq!(watch.process, there);
        watch.process += 1;
        drop(watch); // joins no thread of another process
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_real_time_thread_is_ended_on_its_own_processor() {
        let spin = || {
            let mut watch = Watch::start().unwrap();
            let (count, add) = counter();
            watch.over(after(LATE), add(), || ()).unwrap(); // under the usual policy
            // SAFETY: both structures are of numbers, and the pointers are of variables that outlive the calls.
            let refused = unsafe {
                let mut own: libc::sched_param = std::mem::zeroed();
                own.sched_priority = 10;
                let mut one: libc::cpu_set_t = std::mem::zeroed();
                libc::CPU_SET(usize::try_from(libc::sched_getcpu()).unwrap(), &mut one);
                let id =
                    watch.thread.as_ref().map(std::os::unix::thread::JoinHandleExt::as_pthread_t);
                libc::pthread_setaffinity_np(id.unwrap(), size_of_val(&one), &raw const one);
                libc::sched_setaffinity(0, size_of_val(&one), &raw const one);
                libc::syscall(libc::SYS_sched_setscheduler, 0, libc::SCHED_FIFO, &raw const own)
            };
            if refused != 0 {
                eprintln!("not tested: the system gives no right to SCHED_FIFO");
                return;
            }
            let begin = Instant::now();
            let wait = || {
                while count.load(Ordering::SeqCst) == 0 && begin.elapsed().as_millis() < 900 {}
            };
            watch.over(begin + Duration::from_millis(20), add(), wait).unwrap();
            assert!(begin.elapsed().as_millis() < 500, "{:?}", begin.elapsed());
        };
        thread::spawn(spin).join().unwrap();
    }
}
