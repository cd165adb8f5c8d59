//! Plans that are kept: each thread has its own list, which costs no lock, and takes what it lacks from one that all share.

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::sync::{Arc, Mutex};

use crate::Shape;
use crate::tuning::{PLANS_KEPT, PLANS_KEPT_BY_A_THREAD};

/// Plans in a list; a program that filters more shapes than this in turn plans again.
const KEPT: usize = 64;

/// A plan with what it is for.
#[derive(Clone)]
struct Entry {
    of: (TypeId, Shape),
    /// Bytes that it takes, at most.
    bytes: usize,
    plan: Arc<dyn Any + Send + Sync>,
}

static SHARED: Mutex<Plans> = Mutex::new(Plans::new(PLANS_KEPT));

thread_local! {
    static OWN: RefCell<Plans> = const { RefCell::new(Plans::new(PLANS_KEPT_BY_A_THREAD)) };
}

/// Few plans, oldest first, compared one by one: that is quicker than hashing.
struct Plans {
    kept: Vec<Entry>,
    bytes: usize,
    most_bytes: usize,
}

impl Plans {
    const fn new(most_bytes: usize) -> Self {
        Self { kept: Vec::new(), bytes: 0, most_bytes }
    }

    fn find<P: 'static>(&self, shape: Shape) -> Option<&Entry> {
        self.kept.iter().find(|entry| entry.of == (TypeId::of::<P>(), shape))
    }

    /// Keeps a plan, if it is not larger than all may be together, and gives back those that leave for it.
    fn keep(&mut self, entry: Entry) -> Vec<Entry> {
        if entry.bytes > self.most_bytes {
            return vec![entry];
        }
        self.bytes += entry.bytes;
        self.kept.push(entry);
        let (mut gone, mut bytes) = (0, self.bytes);
        while bytes > self.most_bytes || self.kept.len() - gone > KEPT {
            bytes -= self.kept[gone].bytes;
            gone += 1;
        }
        self.bytes = bytes;
        self.kept.drain(..gone).collect()
    }
}

/// The plan of type `P` for a shape, of at most so many `bytes`, made by `make` if no thread has made it yet.
///
/// Nobody waits for the shared list: a forked process may find it locked for ever, by a thread that it does not have. Where it is
/// locked a plan is made anew, which is the same.
pub(crate) fn kept<P: Clone + Send + Sync + 'static, E>(
    shape: Shape,
    bytes: usize,
    make: impl FnOnce() -> Result<P, E>,
) -> Result<P, E> {
    kept_in(&SHARED, shape, bytes, make)
}

fn kept_in<P: Clone + Send + Sync + 'static, E>(
    shared: &Mutex<Plans>,
    shape: Shape,
    bytes: usize,
    make: impl FnOnce() -> Result<P, E>,
) -> Result<P, E> {
    OWN.with_borrow_mut(|own| {
        if let Some(plan) = own.find::<P>(shape) {
            return Ok(cloned(plan));
        }
        let found = shared.try_lock().ok().and_then(|plans| plans.find::<P>(shape).cloned());
        let plan = if let Some(plan) = found {
            plan
        } else {
            let plan = Arc::new(make()?);
            let plan = Entry { of: (TypeId::of::<P>(), shape), bytes, plan };
            let gone = shared.try_lock().map(|mut plans| plans.keep(plan.clone()));
            drop(gone); // after the lock
            plan
        };
        let result = cloned(&plan);
        own.keep(plan);
        Ok(result)
    })
}

fn cloned<P: Clone + 'static>(plan: &Entry) -> P {
    plan.plan.downcast_ref::<P>().expect("a plan has the type that it is kept under").clone()
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::thread;

    use super::*;
    use crate::Layout;

    #[derive(Clone, Debug, PartialEq)]
    struct Number(usize);

    fn shape(lanes: usize) -> Shape {
        Shape { layout: Layout::Grid, rows: 1, columns: 1, lanes }
    }

    #[test]
    fn a_plan_is_made_once_for_all_threads() {
        let shared = Mutex::new(Plans::new(1 << 10));
        let plan = |number| kept_in(&shared, shape(1), 1, || Ok::<_, Infallible>(Number(number)));
        let other = thread::scope(|scope| scope.spawn(|| plan(5)).join().unwrap());
        assert_eq!([plan(6), plan(7)], [other.clone(), other]);
    }

    #[test]
    fn a_locked_list_is_not_waited_for() {
        let shared = Mutex::new(Plans::new(1 << 10));
        let _locked = shared.lock();
        let plan = kept_in(&shared, shape(2), 1, || Ok::<_, Infallible>(Number(5)));
        assert_eq!(plan, Ok(Number(5)));
    }

    #[test]
    fn a_failure_is_not_kept() {
        assert_eq!(kept::<Number, _>(shape(3), 1, || Err("no memory")), Err("no memory"));
        assert_eq!(kept::<_, &str>(shape(3), 1, || Ok(Number(6))), Ok(Number(6)));
    }

    /// Lanes of the plans that a list keeps, after plans of so many bytes were made for 0, 1, 2... lanes.
    fn kept_of(bytes: &[usize]) -> Vec<usize> {
        let mut plans = Plans::new(1 << 10);
        for (lanes, &bytes) in bytes.iter().enumerate() {
            let of = (TypeId::of::<Number>(), shape(lanes));
            plans.keep(Entry { of, bytes, plan: Arc::new(Number(lanes)) });
            assert_eq!(plans.bytes, plans.kept.iter().map(|entry| entry.bytes).sum::<usize>());
            assert!(plans.bytes <= 1 << 10, "{}", plans.bytes);
        }
        plans.kept.iter().map(|entry| entry.of.1.lanes).collect()
    }

    #[test]
    fn plans_are_bounded_by_bytes_and_the_oldest_leave() {
        assert_eq!(kept_of(&[500, 500]), [0, 1]);
        assert_eq!(kept_of(&[500, 500, 24, 1]), [1, 2, 3]);
        assert_eq!(kept_of(&[500, 500, 1 << 10]), [2]);
        assert_eq!(kept_of(&[500, 1 + (1 << 10), usize::MAX]), [0]);
        assert!(kept_of(&[1; 100]).into_iter().eq(100 - KEPT..100));
    }

    /// What a thread holds is not all of what the process may: a large plan is shared, and found there.
    #[test]
    fn a_plan_too_large_for_a_thread_is_made_once_all_the_same() {
        let shared = Mutex::new(Plans::new(PLANS_KEPT));
        let bytes = PLANS_KEPT_BY_A_THREAD + 1;
        let plan =
            |number| kept_in(&shared, shape(4), bytes, || Ok::<_, Infallible>(Number(number)));
        assert_eq!([plan(5), plan(6)], [Ok(Number(5)), Ok(Number(5))]);
        assert!(OWN.with_borrow(|own| own.find::<Number>(shape(4)).is_none()));
    }
}
