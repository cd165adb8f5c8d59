//! The watch over deadlines: a thread that ends what another one does when its time is over.
#![allow(unsafe_code)] // the scheduler's functions are C's

use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender};
use std::thread::{Builder, JoinHandle};
use std::time::Instant;

use crate::error::{Error, Result};

/// Bytes of the thread's stack, which a process that locks its memory holds in full.
const STACK: usize = 64 << 10;

/// A thread that keeps deadlines, one after the other.
///
/// Under a real-time policy it runs at a priority above that of the thread it watches, or on one processor it would wait until
/// that has ended. Where the process may not raise it, it stays as it is.
pub struct Watch {
    messages: Option<SyncSender<Message>>,
    thread: Option<JoinHandle<()>>,
}

enum Message {
    /// What is to be done at a time, unless the end comes before.
    Begin(Instant, Box<dyn FnOnce() + Send>),
    End,
}

impl Watch {
    /// Starts the thread, which ends with the watch.
    ///
    /// # Errors
    /// The system has no more threads.
    pub fn start() -> Result<Self> {
        let (messages, received) = mpsc::sync_channel(1);
        let thread = Builder::new().name("ffpose-watch".into()).stack_size(STACK);
        let thread = thread
            .spawn(move || keep(&received))
            .map_err(|error| Error::new(format!("no thread can be started: {error}")))?;
        Ok(Self { messages: Some(messages), thread: Some(thread) })
    }

    /// Returns what `run` returns, during which `end_it` is called if the time comes.
    pub fn over<T>(
        &self,
        end: Instant,
        end_it: impl FnOnce() + Send + 'static,
        run: impl FnOnce() -> T,
    ) -> T {
        self.thread.as_ref().into_iter().for_each(outrank);
        self.tell(Message::Begin(end, Box::new(end_it)));
        let _ended = Ended(self); // also where `run` panics
        run()
    }

    fn tell(&self, message: Message) {
        // The thread takes messages as long as there is the watch.
        let _ = self.messages.as_ref().map(|messages| messages.send(message));
    }
}

struct Ended<'a>(&'a Watch);

impl Drop for Ended<'_> {
    fn drop(&mut self) {
        self.0.tell(Message::End);
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.messages = None; // which ends the thread
        // The library may be unloaded next.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Keeps deadlines until no more can come.
fn keep(messages: &Receiver<Message>) {
    while let Ok(message) = messages.recv() {
        let Message::Begin(end, end_it) = message else { continue };
        let left = end.saturating_duration_since(Instant::now());
        if matches!(messages.recv_timeout(left), Err(RecvTimeoutError::Timeout)) {
            end_it();
        }
    }
}

/// Gives a thread the calling one's real-time policy and a priority above it, if it has one.
#[cfg(target_os = "linux")]
fn outrank(thread: &JoinHandle<()>) {
    use std::os::unix::thread::JoinHandleExt;

    let mut policy = 0;
    // SAFETY: a structure of numbers, some of which not every C library has.
    let mut scheduling: libc::sched_param = unsafe { std::mem::zeroed() };
    // SAFETY: `pthread_self` has no condition; the pointers are of variables that outlive the call.
    let failed = unsafe {
        libc::pthread_getschedparam(libc::pthread_self(), &raw mut policy, &raw mut scheduling)
    };
    if failed != 0 || ![libc::SCHED_FIFO, libc::SCHED_RR].contains(&policy) {
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
    use std::sync::Arc;
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

    #[test]
    fn only_what_takes_too_long_is_ended() {
        let watch = Watch::start().unwrap();
        let (count, add) = counter();
        for number in 0..3 {
            let soon = Instant::now() + Duration::from_millis(5);
            let late = Instant::now() + Duration::from_hours(1);
            assert_eq!(watch.over(late, add(), || 7), 7);
            watch.over(soon, add(), || {
                while count.load(Ordering::SeqCst) == number {
                    sleep(Duration::from_millis(1));
                }
            });
        }
        drop(watch); // which waits for the thread
        assert_eq!(count.load(Ordering::SeqCst), 3);
    }

    #[test]
    fn a_panic_ends_the_watch_over_it_alone() {
        let watch = Watch::start().unwrap();
        let (count, add) = counter();
        let late = Instant::now() + Duration::from_hours(1);
        let run = std::panic::AssertUnwindSafe(|| watch.over(late, add(), || panic!("a run")));
        assert!(std::panic::catch_unwind(run).is_err());
        assert_eq!(watch.over(late, add(), || 7), 7);
        drop(watch);
        assert_eq!(count.load(Ordering::SeqCst), 0);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_real_time_thread_is_ended_on_its_own_processor() {
        let spin = || {
            // SAFETY: both structures are of numbers, and the pointers are of variables that outlive the calls.
            let refused = unsafe {
                let mut own: libc::sched_param = std::mem::zeroed();
                own.sched_priority = 10;
                let mut one: libc::cpu_set_t = std::mem::zeroed();
                libc::CPU_SET(usize::try_from(libc::sched_getcpu()).unwrap(), &mut one);
                libc::sched_setaffinity(0, size_of_val(&one), &raw const one);
                libc::pthread_setschedparam(libc::pthread_self(), libc::SCHED_FIFO, &raw const own)
            };
            if refused != 0 {
                return; // the right to it is the system's to give
            }
            let pinned = Watch::start().unwrap();
            let (count, add) = counter();
            let begin = Instant::now();
            pinned.over(begin + Duration::from_millis(20), add(), || {
                while count.load(Ordering::SeqCst) == 0 && begin.elapsed().as_millis() < 900 {}
            });
            assert!(begin.elapsed().as_millis() < 500, "{:?}", begin.elapsed());
        };
        thread::spawn(spin).join().unwrap();
    }
}
