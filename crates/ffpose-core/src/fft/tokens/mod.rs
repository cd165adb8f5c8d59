//! The filter on tokens, or on a grid of one channel, whose sizes have codelets: `X = A B`, and Y a multiple of the lanes.
//!
//! Element `L y1 + y0` of a row is lane `y0` of vector `y1`, so that a row is a real line of `M = Y / L` vectors, and all but
//! one of the transforms go across vectors. That one, over `y0`, comes last, next to the product, with one transpose each way:
//!
//! 1. For each `x2`, rows `x = B x1 + x2`: the lines, then `A` over `x1`, twiddles ([`lines`], [`blocks`]).
//! 2. For each pair of blocks `u1` and `-u1`, rows `u = u1 + A u2`: `B` over `x2`; transpose, `L` over `y0`, product, and back
//!    ([`groups`]); `B` back.
//! 3. As the first, back.
//!
//! Between passes the spectrum is in the output, or in scratch where that is of half precision, block after block. No pass moves
//! more than a few rows of it at a time.

/// Runs `$run` with the constant `$name` equal to `$length`, a power of two.
macro_rules! with_run {
    ($length:expr, $name:ident => $run:expr) => {
        with_run!(@ $length, $name, $run, 2 4 8 16)
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

mod blocks;
mod gradient;
mod groups;
mod images;
mod lines;
mod passes;
mod pointwise;
mod rows;
mod steps;
mod twiddles;
mod weight;

use std::collections::VecDeque;

use ndarray::{ArrayBase, ArrayView3, ArrayViewMut3, Ix3, RawData};

use self::images::{BackwardImage, Context, SumPart};
use self::steps::Step;
use self::weight::TokenShape;
use crate::fft::codelets::{has_codelet, twiddle};
use crate::kernel::{Backward, Kernel, Packing};
use crate::parallel::Team;
use crate::simd::{Aligned, Complex, Element, Isa, Stored, slack};
use crate::tuning::{CODELET_ROWS, TOKENS_AT_ONCE, Tuning};
use crate::views::{BATCH, in_order};

/// The plan for images `(X, Y)`.
pub(crate) struct Tokens<T> {
    isa: Isa,
    tuning: &'static Tuning,
    lanes: usize,
    shape: TokenShape,
    /// Items of one row that stay together in a group.
    run: usize,
    /// `X = A B`.
    factors: [usize; 2],
    /// `exp(-2πi x2 u1 / X)`, for each `x2` in turn.
    twiddles: Vec<Complex<T>>,
    steps: Vec<Step>,
    /// Rows of a step that fill groups without a rest, and what their items are turned by.
    rows_each: usize,
    turns: Aligned<T>,
}

impl<T: Element> Tokens<T> {
    /// The plan for images `(points, width)`, if they have codelets.
    pub(crate) fn new(
        isa: Isa,
        points: usize,
        width: usize,
        tuning: &'static Tuning,
    ) -> Option<Self> {
        let lanes = isa.lanes::<T>();
        if !width.is_multiple_of(lanes) || !has_codelet!(line width / lanes) {
            return None;
        }
        let factors = factors(points, width)?;
        let slots = width / lanes / 2;
        let shape = TokenShape { points, width, slots };
        // a power of two that divides both
        let run = lanes.min(slots & slots.wrapping_neg());
        let pairs_each = lanes / lanes.min((2 * slots) & (2 * slots).wrapping_neg());
        let steps: Vec<_> =
            (0..=factors[0] / 2).map(|u1| Step::new(shape, factors, u1, pairs_each, run)).collect();
        let turns = (0..points).map(|i| twiddle((i / factors[0]) * (i % factors[0]), points));
        let rows_each = 2 * pairs_each;
        Some(Self {
            isa,
            tuning,
            lanes,
            shape,
            run,
            factors,
            twiddles: turns.collect(),
            steps,
            rows_each,
            turns: Aligned::copy_of(&twiddles::twiddles([points, width], lanes, rows_each)),
        })
    }

    /// Numbers of the sum of a step's gradient.
    fn sum_len_of(&self, step: &Step) -> usize {
        step.rows.len() * self.shape.width
    }

    /// Images of tokens, or of one channel of a grid, as those of tokens.
    fn images<S: RawData>(&self, images: ArrayBase<S, Ix3>) -> ArrayBase<S, Ix3> {
        let dim = (images.len_of(BATCH), self.shape.points, self.shape.width);
        images.into_shape_with_order(dim).expect("whole images without gaps")
    }

    /// Numbers of the spectrum of an image.
    fn spectrum_len(&self) -> usize {
        self.shape.points * self.shape.width
    }

    /// Bytes of an image as it is stored.
    fn image_bytes<X>(&self) -> usize {
        self.spectrum_len() * size_of::<X>()
    }

    /// Images that each member of a team takes through a pass before the next pass.
    fn images_at_once(&self) -> usize {
        (TOKENS_AT_ONCE / self.image_bytes::<T>()).max(1)
    }

    /// The parts of a sum that belong to each step.
    fn parts<'a>(&self, mut sum: &'a [T]) -> impl Iterator<Item = &'a [T]> {
        let steps = self.steps.iter();
        steps.map(move |step| sum.split_off(..self.sum_len_of(step)).expect("room for each step"))
    }

    /// As [`parts`](Self::parts), to write.
    fn parts_mut<'a>(&self, mut sum: &'a mut [T]) -> impl Iterator<Item = &'a mut [T]> {
        let lens = self.steps.iter().map(|step| self.sum_len_of(step));
        lens.map(move |len| sum.split_off_mut(..len).expect("room for each step"))
    }
}

impl<X: Stored> Kernel<X> for Tokens<X::Real> {
    fn tile(&self) -> usize {
        self.shape.width
    }

    fn scratch_len(&self, _: usize) -> usize {
        2 * self.images_at_once() * self.spectrum_len() + self.member_len()
    }

    /// The product reads the weight in natural order.
    fn packing(&self) -> Option<&dyn Packing<X::Real>> {
        None
    }

    fn sum_len(&self, _: usize) -> usize {
        let sum: usize = self.steps.iter().map(|step| self.sum_len_of(step)).sum();
        sum.next_multiple_of(slack::<X::Real>())
    }

    fn forward(
        &self,
        x: ArrayView3<'_, X>,
        weight: &[X::Real],
        y: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
    ) {
        let (x, mut y) = (self.images(x), self.images(y));
        if self.shape.points == 1 {
            return self.forward_rows(x.outer_iter().zip(y.outer_iter_mut()), weight, team);
        }
        let at_once = team.members() * self.images_at_once();
        let (spectra, mut team) = team.share(self.images_at_once() * self.spectrum_len());
        let far =
            !self.tuning.are_prefetched(2 * x.len() * size_of::<X>(), self.image_bytes::<X>());
        let mut images = x.outer_iter().zip(y.outer_iter_mut()).peekable();
        while images.peek().is_some() {
            let together: Vec<_> = images.by_ref().take(at_once).collect();
            let context = Context { spectra: &mut *spectra, far, team: &mut team };
            self.forward_images(together, weight, context);
        }
    }

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
        let Backward { grad, x, weight, grad_x, grad_sum, images_each } = pass;
        let (grad, x) = (self.images(grad), self.images(x));
        let mut grad_x = grad_x.map(|grad_x| self.images(grad_x));
        let images_each = if grad_sum.is_some() { images_each } else { 1 };
        let members = team.members();
        let far =
            !self.tuning.are_prefetched(3 * x.len() * size_of::<X>(), self.image_bytes::<X>());
        let count = x.len_of(BATCH);
        let grad_x = in_order(count, grad_x.as_mut().map(|grad_x| grad_x.outer_iter_mut()));
        let mut images = grad.outer_iter().zip(x.outer_iter()).zip(grad_x);
        let len = Kernel::<X>::sum_len(self, self.shape.width);
        let parts = count.div_ceil(images_each);
        let sums = in_order(parts, grad_sum.map(|sums| sums.chunks_exact_mut(len)));
        let mut parts: Vec<_> = sums
            .map(|sum| {
                let images = images.by_ref().take(images_each);
                let images = images.map(|((grad, x), grad_x)| BackwardImage { grad, x, grad_x });
                (images.collect::<VecDeque<_>>(), sum)
            })
            .collect();
        if self.shape.points == 1 {
            return self.backward_rows(parts, weight, team);
        }
        let at_once = members * self.images_at_once();
        let (spectra, mut team) = team.share(2 * self.images_at_once() * self.spectrum_len());
        // a part for each member, or several of few images; and as many images of each
        let most = members.max(at_once / images_each);
        let parts_each = parts.len().div_ceil(parts.len().div_ceil(most));
        for parts in parts.chunks_mut(parts_each) {
            let images_each = (at_once / parts.len()).max(1);
            while !parts[0].0.is_empty() {
                let round = parts.iter_mut().map(|(images, sum)| {
                    let images = images.drain(..images_each.min(images.len()));
                    let images = images.map(BackwardImage::reborrow).collect();
                    let sums = sum.as_deref_mut().map(|sum| self.parts_mut(sum));
                    SumPart { images, sums: sums.map(Iterator::collect) }
                });
                let round: Vec<_> = round.collect();
                let context = Context { spectra: &mut *spectra, far, team: &mut team };
                self.backward_images(round, weight, context);
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        grad_weight: ArrayViewMut3<'_, X::Real>,
        team: &mut Team<'_, X::Real>,
    ) {
        let dim = (self.shape.points, self.shape.half(), 2);
        let grad_weight = grad_weight.into_shape_with_order(dim).expect("whole rows of bins");
        let steps = self.steps.iter().zip(self.parts(grad_sum));
        let jobs = steps.zip(self.gradients_of_steps(grad_weight));
        team.run(jobs, |((step, sum), mut gradient), _| self.unpack(step, sum, &mut gradient));
    }

    fn shares(&self, _: usize) -> bool {
        self.shape.points > 1
    }
}

/// `X = A B` with codelets for both, as near to a square as can be. Where `A` is 1, the pass over it is a copy.
fn factors(points: usize, width: usize) -> Option<[usize; 2]> {
    let pairs = (1..=points.isqrt()).rev().map(|a| [a, points / a]);
    let has_codelets = |&[a, b]: &[usize; 2]| has_codelet!(factor a) && has_codelet!(factor b);
    let pays = |&[a, _]: &[usize; 2]| a > 1 || CODELET_ROWS[0] * points <= CODELET_ROWS[1] * width;
    pairs.filter(|[a, b]| a * b == points).find(|pair| has_codelets(pair) && pays(pair))
}
