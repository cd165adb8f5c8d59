//! Which rows of a spectrum are transformed together, and in which order.
//!
//! Row `u = u1 + A u2` of the spectrum is row `u2` of block `u1`. Blocks `u1` and `-u1` make a step, for `-u` is in the other one.

/// Blocks `u1` and `A - u1` as one: rows `u2`, then `B + u2`, then copies and fillers.
pub(super) struct Step {
    /// Positions of `u` and `-u` in turn.
    pub(super) rows: Vec<usize>,
    /// The frequencies of these rows, or none for fillers.
    pub(super) frequencies: Vec<Option<usize>>,
    /// Rows that are their own mirrors, and where a copy stands for the mirror.
    pub(super) copies: Vec<(usize, usize)>,
    /// Position of the two rows of zeros that fill the last turn.
    pub(super) fillers: usize,
}

/// Rows of a step beside those of two blocks: two copies, two fillers.
pub(super) const SPARE: usize = 4;

impl Step {
    /// The step of blocks `u1 <= A / 2` and `-u1`, of a multiple of `pairs_each` pairs.
    pub(super) fn new([a, b]: [usize; 2], u1: usize, pairs_each: usize) -> Self {
        let fillers = 2 * b + 2;
        let (mut rows, mut frequencies, mut copies) = (Vec::new(), Vec::new(), Vec::new());
        for u2 in 0..b {
            let (u, minus_u) = (u1 + a * u2, (a * b - u1 - a * u2) % (a * b));
            let (block, mirror) = (minus_u % a, minus_u / a);
            if block == u1 && mirror < u2 {
                continue;
            }
            let mirror = if u == minus_u {
                copies.push((u2, 2 * b + copies.len()));
                2 * b + copies.len() - 1
            } else if block == u1 {
                mirror
            } else {
                b + mirror
            };
            rows.extend([u2, mirror]);
            frequencies.extend([Some(u), Some(minus_u)]);
        }
        while !rows.len().is_multiple_of(2 * pairs_each) {
            rows.extend([fillers, fillers + 1]);
            frequencies.extend([None, None]);
        }
        Self { rows, frequencies, copies, fillers }
    }
}
