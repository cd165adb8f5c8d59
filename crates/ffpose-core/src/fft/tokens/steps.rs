//! Which rows of a spectrum are transformed together, and in which order.
//!
//! Row `u = u1 + A u2` of the spectrum is row `u2` of block `u1`. Blocks `u1` and `-u1` make a step, for `-u` is in the other one.

use std::ops::Range;

use super::weight::{Run, TokenShape};

/// Blocks `u1` and `A - u1` as one: rows `u2`, then `B + u2`, then copies and fillers.
pub(super) struct Step {
    /// Positions of `u` and `-u` in turn.
    pub(super) rows: Vec<usize>,
    /// Where the frequencies `u` and `-u` of each two of these rows are among the rows of the two blocks: a copy is where its
    /// original is. Fillers, which come last, have none.
    pub(super) positions: Vec<[usize; 2]>,
    /// The runs of these rows, with rows of a weight, and with those of the two blocks, without fillers.
    pub(super) runs: Vec<Run>,
    pub(super) gradient_runs: Vec<Run>,
    /// Rows that are their own mirrors, and where a copy stands for the mirror.
    pub(super) copies: Vec<(usize, usize)>,
    /// Positions of the rows of zeros that fill the last turn, each a place of its own.
    pub(super) fillers: Range<usize>,
}

impl Step {
    /// The step of blocks `u1 <= A / 2` and `-u1`, of a multiple of `pairs_each` pairs, in runs of `run` items.
    pub(super) fn new(
        shape: TokenShape,
        [a, b]: [usize; 2],
        u1: usize,
        pairs_each: usize,
        run: usize,
    ) -> Self {
        let (mut rows, mut copies) = (Vec::new(), Vec::new());
        let own = if a == 1 { b } else { 2 * b }; // block 0 is its own mirror
        let (mut frequencies, mut positions) = (Vec::new(), Vec::new());
        for u2 in 0..b {
            let (u, minus_u) = (u1 + a * u2, (a * b - u1 - a * u2) % (a * b));
            let (block, u2_of_mirror) = (minus_u % a, minus_u / a);
            if block == u1 && u2_of_mirror < u2 {
                continue;
            }
            let mirror = if block == u1 { u2_of_mirror } else { b + u2_of_mirror };
            frequencies.push([u, minus_u]);
            positions.push([u2, mirror]);
            if u == minus_u {
                let copy = own + copies.len();
                copies.push((u2, copy));
                rows.extend([u2, copy]);
            } else {
                rows.extend([u2, mirror]);
            }
        }
        let fillers = own + copies.len();
        let gradient_runs = shape.runs(&rows, &positions, run);
        let turn = 2 * pairs_each;
        let fillers = fillers..fillers + rows.len().next_multiple_of(turn) - rows.len();
        rows.extend(fillers.clone());
        let runs = shape.runs(&rows, &frequencies, run);
        Self { rows, positions, runs, gradient_runs, copies, fillers }
    }
}
