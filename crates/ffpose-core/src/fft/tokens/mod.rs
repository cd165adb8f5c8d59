//! The filter on tokens whose sizes have codelets: `X = A B`, and Y a multiple of the lanes.
//!
//! Element `L y1 + y0` of a row is lane `y0` of vector `y1`, so that a row is a real line of `M = Y / L` vectors, and all but
//! one of the transforms go across vectors. That one, over `y0`, comes last, next to the product, with one transpose each way:
//!
//! 1. For each `x2`, rows `x = B x1 + x2`: the lines, then `A` over `x1`, twiddles ([`lines`], [`columns`]).
//! 2. For each pair of blocks `u1` and `-u1`, rows `u = u1 + A u2`: `B` over `x2`; transpose, `L` over `y0`, product, and back
//!    ([`lanes`]); `B` back.
//! 3. As the first, back.
//!
//! Between passes the spectrum is in the output, block after block. No pass moves more than a few rows of it into its scratch.

mod columns;
mod lanes;
mod lines;
mod order;
mod pack;

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis};

use self::columns::{Block, block_to_image, image_to_block};
use self::lanes::{Accumulate, Filter, Middle, Product, Turns};
use self::order::{SPARE, Step};
use self::pack::{Pack, Plan, Unpack};
use super::roots::root;
use crate::kernel::{Backward, Kernel};
use crate::simd::{Complex, Element, Isa, Table, Tile, TileMut, aligned, slack};

/// The plan for images `(X, Y)`.
pub(crate) struct Tokens<T> {
    isa: Isa,
    lanes: usize,
    width: usize,
    /// `X = A B`.
    factors: [usize; 2],
    /// `exp(-2πi x2 u1 / X)`, for each `x2` in turn.
    twiddles: Vec<Complex<T>>,
    steps: Vec<Step>,
    rows_each: usize,
    turns: Table<T>,
}

/// Scratch of one call.
struct Scratch<'a, T> {
    block: &'a mut [T],
    other: &'a mut [T],
    work: &'a mut [T],
    spectrum: &'a mut [T],
    other_spectrum: &'a mut [T],
}

/// Runs `$run` with the constant `$run_length` equal to the largest power of two in lanes and slots.
macro_rules! with_run {
    ($length:expr, $name:ident => $run:expr) => {
        with_run!(@ $length, $name, $run, 1 2 4 8 16)
    };
    (@ $length:expr, $name:ident, $run:expr, $($of:literal)*) => {
        match $length {
            $($of => {
                const $name: usize = $of;
                $run
            })*
            length => unreachable!("runs of {length} lanes"),
        }
    };
}

impl<T: Element> Tokens<T> {
    /// The plan for images `(points, width)`, if they have codelets.
    pub(crate) fn new(isa: Isa, points: usize, width: usize) -> Option<Self> {
        let lanes = isa.lanes::<T>();
        let is_whole = lanes > 1 && width.is_multiple_of(lanes);
        if !is_whole || !lines::has_codelet(width / lanes) {
            return None;
        }
        let factors = factors(points)?;
        let slots = width / lanes / 2;
        let pairs_each = lanes / lanes.min(2 * slots & (2 * slots).wrapping_neg());
        let steps: Vec<_> =
            (0..=factors[0] / 2).map(|u1| Step::new(factors, u1, pairs_each)).collect();
        let twiddles = (0..points).map(|i| (i / factors[0]) * (i % factors[0]));
        let twiddles = twiddles.map(|n| {
            let (c, s) = root(n, points);
            Complex::new(T::nearest(c), T::nearest(-s))
        });
        let rows_each = 2 * pairs_each;
        Some(Self {
            isa,
            lanes,
            width,
            factors,
            twiddles: twiddles.collect(),
            steps,
            rows_each,
            turns: Table::new(&turns(width, lanes, rows_each)),
        })
    }

    fn points(&self) -> usize {
        self.factors[0] * self.factors[1]
    }

    fn slots(&self) -> usize {
        self.width / self.lanes / 2
    }

    /// Items of one row that stay together in a group.
    fn run(&self) -> usize {
        self.lanes.min(self.slots() & self.slots().wrapping_neg())
    }

    /// Complex vectors from one row of a block to the next: odd, since an even number would meet the same few sets of the cache.
    fn pitch(&self) -> usize {
        self.slots() | 1
    }

    fn block_len(&self) -> usize {
        let [a, b] = self.factors;
        2 * self.lanes * self.pitch() * a.max(2 * b + SPARE)
    }

    /// Numbers of the packed weight of a step.
    fn packed_len_of(&self, step: &Step) -> usize {
        step.rows.len() * self.width
    }

    fn scratch<'a>(&self, scratch: &'a mut [T]) -> Scratch<'a, T> {
        let (block, rest) = aligned(scratch).split_at_mut(self.block_len());
        let (other, rest) = rest.split_at_mut(self.block_len());
        let (work, rest) = rest.split_at_mut(self.width);
        let (spectrum, rest) = rest.split_at_mut(self.points() * self.width);
        let other_spectrum = &mut rest[..self.points() * self.width];
        Scratch { block, other, work, spectrum, other_spectrum }
    }

    fn plan(&self) -> Plan {
        Plan { points: self.points(), width: self.width, slots: self.slots() }
    }

    /// An image to the transforms of its lines and of their parts `x1`.
    fn first_pass(
        &self,
        x: ArrayView2<'_, T>,
        mut spectrum: ArrayViewMut2<'_, T>,
        block: &mut [T],
        work: &mut [T],
    ) {
        let ([a, b], pitch) = (self.factors, self.pitch());
        let x = x.to_shape((a, b, self.width)).expect("rows of an image");
        let mut spectrum = blocks(&mut spectrum, self.factors);
        let columns = x.axis_iter(Axis(1)).zip(spectrum.axis_iter_mut(Axis(1)));
        for ((x, y), twiddles) in columns.zip(self.twiddles.chunks_exact(a)) {
            lines::forward(self.isa, Tile::new(x), Block { vectors: block, pitch }, work);
            let block = Block { vectors: block, pitch };
            block_to_image::<T, false>(self.isa, block, twiddles, TileMut::new(y));
        }
    }

    /// Undoes [`first_pass`](Self::first_pass) in place, up to a factor.
    fn last_pass(&self, mut y: ArrayViewMut2<'_, T>, block: &mut [T], work: &mut [T]) {
        let ([a, _], pitch) = (self.factors, self.pitch());
        let mut y = blocks(&mut y, self.factors);
        for (y, twiddles) in y.axis_iter_mut(Axis(1)).zip(self.twiddles.chunks_exact(a)) {
            let y = TileMut::new(y);
            let to = Block { vectors: block, pitch };
            image_to_block::<T, true>(self.isa, y.reader(), twiddles, to);
            lines::inverse(self.isa, Block { vectors: block, pitch }, y, work);
        }
    }

    /// The blocks of a step to `block`, transformed.
    fn gather(&self, step: usize, spectrum: ArrayView3<'_, T>, block: &mut [T]) {
        let ([a, b], pitch) = (self.factors, self.pitch());
        let row = 2 * self.lanes * pitch;
        for (number, u1) in blocks_of(a, step).enumerate() {
            let image = Tile::new(spectrum.index_axis_move(Axis(0), u1));
            let vectors = &mut block[number * b * row..];
            image_to_block::<T, false>(self.isa, image, &[], Block { vectors, pitch });
        }
        let Step { copies, fillers, .. } = &self.steps[step];
        for &(from, to) in copies {
            block.copy_within(from * row..(from + 1) * row, to * row);
        }
        block[fillers * row..(fillers + 2) * row].fill(T::default());
    }

    /// Undoes [`gather`](Self::gather), up to a factor.
    fn put(&self, step: usize, block: &mut [T], mut spectrum: ArrayViewMut3<'_, T>) {
        let ([a, b], pitch) = (self.factors, self.pitch());
        for (number, u1) in blocks_of(a, step).enumerate() {
            let vectors = &mut block[number * b * 2 * self.lanes * pitch..];
            let image = TileMut::new(spectrum.index_axis_mut(Axis(0), u1));
            block_to_image::<T, true>(self.isa, Block { vectors, pitch }, &[], image);
        }
    }

    /// `middle` on the spectrum of a block.
    fn filter(&self, step: &Step, block: &mut [T], middle: impl Middle<T>) {
        let turns = Turns {
            rows: &step.rows,
            rows_each: self.rows_each,
            slots: self.slots(),
            twiddles: self.turns.values(),
        };
        let block = Block { vectors: block, pitch: self.pitch() };
        with_run!(self.run(), RUN => self.isa.run(Filter::<T, _, RUN> { block, turns, middle }));
    }

    /// The places of each step in a packed weight.
    fn places(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        self.steps.iter().scan(0, |end, step| {
            let start = *end;
            *end += self.packed_len_of(step);
            Some(start..*end)
        })
    }
}

impl<T: Element> Kernel<T> for Tokens<T> {
    fn tile(&self) -> usize {
        self.width
    }

    fn packed_len(&self) -> usize {
        self.steps.iter().map(|step| self.packed_len_of(step)).sum()
    }

    fn scratch_len(&self) -> usize {
        slack::<T>() + 2 * self.block_len() + self.width + 2 * self.points() * self.width
    }

    fn pack(&self, weight: ArrayView3<'_, T>, packed: &mut [T]) {
        let (plan, weight) = (self.plan(), weight.to_slice().expect("a whole weight"));
        for (step, places) in self.steps.iter().zip(self.places()) {
            let packed = &mut packed[places];
            with_run!(self.run(), RUN => self.isa.run(Pack::<T, RUN> { plan, step, weight, packed }));
        }
    }

    fn forward(
        &self,
        x: ArrayView3<'_, T>,
        packed: &[T],
        mut y: ArrayViewMut3<'_, T>,
        scratch: &mut [T],
    ) {
        let Scratch { block, work, .. } = self.scratch(scratch);
        for (x, mut y) in x.outer_iter().zip(y.outer_iter_mut()) {
            self.first_pass(x, y.view_mut(), block, work);
            let mut spectrum = blocks(&mut y, self.factors);
            for (number, (step, places)) in self.steps.iter().zip(self.places()).enumerate() {
                self.gather(number, spectrum.view(), block);
                self.filter(step, block, Product::<T, false>(&packed[places]));
                self.put(number, block, spectrum.view_mut());
            }
            self.last_pass(y, block, work);
        }
    }

    fn backward(&self, pass: Backward<'_, T>, scratch: &mut [T]) {
        let Backward { grad, x, packed, mut grad_x, mut grad_sum } = pass;
        let Scratch { block, other, work, spectrum, other_spectrum } = self.scratch(scratch);
        let (shape, inverse) = ((self.points(), self.width), grad_x.is_some());
        let mut other_spectrum =
            ArrayViewMut2::from_shape(shape, other_spectrum).expect("room for an image");
        for (image, (grad, x)) in grad.outer_iter().zip(x.outer_iter()).enumerate() {
            let mut spectrum = match &mut grad_x {
                Some(grad_x) => grad_x.index_axis_mut(Axis(0), image),
                None => {
                    ArrayViewMut2::from_shape(shape, &mut *spectrum).expect("room for an image")
                }
            };
            self.first_pass(grad, spectrum.view_mut(), block, work);
            if grad_sum.is_some() {
                self.first_pass(x, other_spectrum.view_mut(), block, work);
            }
            let mut rows = blocks(&mut spectrum, self.factors);
            let other_rows = blocks(&mut other_spectrum, self.factors);
            for (number, (step, places)) in self.steps.iter().zip(self.places()).enumerate() {
                self.gather(number, rows.view(), block);
                let product = inverse.then(|| Product::<T, true>(&packed[places.clone()]));
                if let Some(sum) = &mut grad_sum {
                    self.gather(number, other_rows.view(), other);
                    let x = Block { vectors: other, pitch: self.pitch() };
                    let accumulate = Accumulate { x, sum: &mut sum[places] };
                    match product {
                        Some(product) => self.filter(step, block, (accumulate, product)),
                        None => self.filter(step, block, accumulate),
                    }
                } else if let Some(product) = product {
                    self.filter(step, block, product);
                }
                if inverse {
                    self.put(number, block, rows.view_mut());
                }
            }
            if inverse {
                self.last_pass(spectrum, block, work);
            }
        }
    }

    fn unpack_gradient(&self, grad_sum: &[T], grad_weight: ArrayViewMut3<'_, T>) {
        let plan = self.plan();
        let gradient = grad_weight.into_slice().expect("a whole weight");
        for (step, places) in self.steps.iter().zip(self.places()) {
            let sum = &grad_sum[places];
            let gradient = &mut *gradient;
            with_run!(self.run(), RUN => self.isa.run(Unpack::<T, RUN> { plan, step, sum, gradient }));
        }
    }
}

/// `X = A B` with codelets for both, as near to a square as can be.
fn factors(points: usize) -> Option<[usize; 2]> {
    let pairs = (1..=points).filter(|a| points.is_multiple_of(*a)).map(|a| [a, points / a]);
    pairs
        .filter(|[a, b]| columns::has_codelet(*a) && columns::has_codelet(*b))
        .min_by_key(|[a, b]| a.abs_diff(*b))
}

/// The blocks of a step.
fn blocks_of(a: usize, u1: usize) -> impl Iterator<Item = usize> {
    [u1, a - u1].into_iter().take(if u1 == 0 || 2 * u1 == a { 1 } else { 2 })
}

/// Rows `(X, Y)` as `(A, B, Y)`.
fn blocks<'a, T>(rows: &'a mut ArrayViewMut2<'_, T>, [a, b]: [usize; 2]) -> ArrayViewMut3<'a, T> {
    let width = rows.ncols();
    rows.view_mut().into_shape_with_order((a, b, width)).expect("rows without gaps")
}

/// `exp(-2πi k y / Y)` for each group and each `y` of some rows: real parts of all lanes, then imaginary ones.
fn turns<T: Element>(width: usize, lanes: usize, rows: usize) -> Vec<T> {
    let slots = width / lanes / 2;
    let mut numbers = Vec::new();
    for group in 0..rows * slots / lanes {
        for y in 0..lanes {
            let roots: Vec<_> = (0..lanes)
                .map(|lane| {
                    let (row, slot) =
                        ((group * lanes + lane) / slots, (group * lanes + lane) % slots);
                    let k = if slot == 0 { row % 2 * slots } else { slot };
                    root(k * y, width)
                })
                .collect();
            numbers.extend(roots.iter().map(|&(c, _)| T::nearest(c)));
            numbers.extend(roots.iter().map(|&(_, s)| T::nearest(-s)));
        }
    }
    numbers
}
