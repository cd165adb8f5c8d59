//! Plans that are kept: each thread has its own list, which costs no lock, and takes what it lacks from one that all share.

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::sync::{Arc, Mutex};

use crate::Shape;

/// Plans in a list; a program that filters more shapes than this in turn plans again.
const KEPT: usize = 64;

/// A plan with what it is for.
type Entry = (TypeId, Shape, Arc<dyn Any + Send + Sync>);

static SHARED: Mutex<Plans> = Mutex::new(Plans(Vec::new()));

thread_local! {
    static OWN: RefCell<Plans> = const { RefCell::new(Plans(Vec::new())) };
}

/// Few plans, compared one by one: that is quicker than hashing.
struct Plans(Vec<Entry>);

impl Plans {
    fn find<P: 'static>(&self, shape: Shape) -> Option<&Entry> {
        self.0.iter().find(|plan| (plan.0, plan.1) == (TypeId::of::<P>(), shape))
    }

    fn keep(&mut self, plan: Entry) {
        if self.0.len() >= KEPT {
            self.0.clear();
        }
        self.0.push(plan);
    }
}

/// The plan of type `P` for a shape, made by `make` if no thread has made it yet.
///
/// Nobody waits for the shared list: a forked process may find it locked for ever, by a thread that it does not have. Where it is
/// locked a plan is made anew, which is the same.
pub(crate) fn kept<P: Clone + Send + Sync + 'static, E>(
    shape: Shape,
    make: impl FnOnce() -> Result<P, E>,
) -> Result<P, E> {
    kept_in(&SHARED, shape, make)
}

fn kept_in<P: Clone + Send + Sync + 'static, E>(
    shared: &Mutex<Plans>,
    shape: Shape,
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
            let plan: Entry = (TypeId::of::<P>(), shape, Arc::new(make()?));
            if let Ok(mut plans) = shared.try_lock() {
                plans.keep(plan.clone());
            }
            plan
        };
        let result = cloned(&plan);
        own.keep(plan);
        Ok(result)
    })
}

fn cloned<P: Clone + 'static>(plan: &Entry) -> P {
    plan.2.downcast_ref::<P>().expect("a plan has the type that it is kept under").clone()
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
        let shared = Mutex::new(Plans(Vec::new()));
        let plan = |number| kept_in(&shared, shape(1), || Ok::<_, Infallible>(Number(number)));
        let other = thread::scope(|scope| scope.spawn(|| plan(5)).join().unwrap());
        assert_eq!([plan(6), plan(7)], [other.clone(), other]);
    }

    #[test]
    fn a_locked_list_is_not_waited_for() {
        let shared = Mutex::new(Plans(Vec::new()));
        let _locked = shared.lock();
        let plan = kept_in(&shared, shape(2), || Ok::<_, Infallible>(Number(5)));
        assert_eq!(plan, Ok(Number(5)));
    }

    #[test]
    fn a_failure_is_not_kept() {
        assert_eq!(kept::<Number, _>(shape(3), || Err("no memory")), Err("no memory"));
        assert_eq!(kept::<_, &str>(shape(3), || Ok(Number(6))), Ok(Number(6)));
    }
}
