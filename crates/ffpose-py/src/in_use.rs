//! Memory that calls use while other Python threads run: readers share it, a writer has it for itself.
//!
//! Python's lock is held wherever this is asked or told, so that nobody comes in between.

use std::ops::Range;
use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::pool::forks;

/// An argument's memory, and what a call does with it.
pub(crate) struct Use<'a> {
    pub(crate) name: &'a str,
    pub(crate) bytes: Range<usize>,
    pub(crate) writes: bool,
    /// The torch tensor that it belongs to, which another thread may give other memory.
    pub(crate) tensor: Option<&'a Bound<'a, PyAny>>,
}

/// What a call that runs uses.
struct Entry {
    call: usize,
    bytes: Range<usize>,
    writes: bool,
    /// Forks before the call: a child has the entries of its parent's calls, but not their threads.
    forks: usize,
}

struct Calls {
    last: usize,
    entries: Vec<Entry>,
}

static CALLS: Mutex<Calls> = Mutex::new(Calls { last: 0, entries: Vec::new() });

/// A call whose memory others leave alone, until it is dropped.
pub(crate) struct Held {
    call: usize,
}

/// That no call of another thread stands in the way of these.
pub(crate) fn check(uses: &[Use<'_>]) -> PyResult<()> {
    check_in(&mut calls(), uses)
}

/// As [`check`], and that no other call uses them from now on but as they may be.
pub(crate) fn hold(uses: &[Use<'_>]) -> PyResult<Held> {
    let mut calls = calls();
    check_in(&mut calls, uses)?;
    calls.last = calls.last.wrapping_add(1);
    let (call, forks) = (calls.last, forks());
    let entry = |u: &Use<'_>| Entry { call, bytes: u.bytes.clone(), writes: u.writes, forks };
    calls.entries.extend(uses.iter().map(entry));
    Ok(Held { call })
}

impl Drop for Held {
    fn drop(&mut self) {
        calls().entries.retain(|entry| entry.call != self.call);
    }
}

fn check_in(calls: &mut Calls, uses: &[Use<'_>]) -> PyResult<()> {
    if calls.entries.is_empty() {
        return Ok(());
    }
    let forks = forks();
    calls.entries.retain(|entry| entry.forks == forks);
    for Use { name, bytes, writes, .. } in uses {
        let meets = |entry: &&Entry| {
            (*writes || entry.writes)
                && bytes.start < entry.bytes.end.min(bytes.end)
                && entry.bytes.start < bytes.end.min(entry.bytes.end)
        };
        if let Some(entry) = calls.entries.iter().find(meets) {
            let does = if entry.writes { "writes to" } else { "reads" };
            let own = if *writes { "uses" } else { "writes to" };
            return Err(PyValueError::new_err(format!(
                "{name} must be memory that no other thread {own} meanwhile, got some that a call there {does}"
            )));
        }
    }
    Ok(())
}

fn calls() -> MutexGuard<'static, Calls> {
    CALLS.lock().unwrap_or_else(PoisonError::into_inner)
}
