//! The filter on sequences of few channels: the lanes of a vector are the channels of several phases.
//!
//! Phase `l` of a sequence `x(n)` of `N` points is its every `L`-th point, `x(L j + l)` (polyphase decomposition). In memory the
//! phases of a point follow each other as channels do, so that a sequence `(N, C)` is one of `N / L` points and `L C` lanes; `C` is
//! a power of two, or the channels are copied with gaps. Each lane is transformed as a real line, and `L`-point transforms across
//! the phases, with twiddles, make the spectrum of the whole (decimation in time): [`across`].

mod across;

use bytemuck::cast_slice_mut;
use ndarray::{ArrayView3, ArrayViewMut3};

use self::across::{Across, Spectrum};
use super::batched::spread::{collect, spread};
use crate::fft::codelets::{root, with_codelet};
use crate::fft::columns::order::Bins;
use crate::fft::transform::Transform;
use crate::kernel::{Backward, Factor, Kernel, Packing};
use crate::parallel::Team;
use crate::simd::{
    Algorithm, Aligned, Complex, Element, Isa, Stored, Tile, TileMut, Vector, aligned,
    complex_vectors, slack,
};
use crate::tuning::Tuning;
use crate::views::BATCH;
use crate::{Layout, Shape};

/// The plan for sequences of one length and of fewer channels than half a vector has lanes.
pub(crate) struct Polyphase<T> {
    isa: Isa,
    /// Lanes of a vector.
    lanes: usize,
    phases: usize,
    /// Lanes of an image.
    tile: usize,
    channels: usize,
    /// Lanes of a phase.
    slots: usize,
    /// Points of a phase, an even number.
    points: usize,
    /// Of the even and odd points of a phase as one complex line.
    transform: Transform<T>,
    /// `exp(-2πi k / points)` for each frequency `k` of a pair.
    turns: Vec<Complex<T>>,
    /// `exp(-2πi l k / N)` for each phase `l` but the first: `[group][l - 1][re, im][slot][place]`.
    twiddles: Aligned<T>,
    /// `[group][frequency across the phases][place]`.
    bins: Vec<Bin<T>>,
}

/// The bin of the half spectrum that a place holds, or its conjugate, and what it is multiplied by there.
struct Bin<T> {
    index: usize,
    weight: [T; 2],
    gradient: [T; 2],
}

/// The instruction set and the phases that images of `shape` are filtered with, if these are several: as many as fit in a vector,
/// or in a narrower one.
pub(super) fn chosen<T: Element>(isa: Isa, shape: Shape, tuning: &Tuning) -> Option<(Isa, usize)> {
    let with = |isa: Isa| phases(isa.lanes::<T>(), shape).map(|phases| (isa, phases));
    let (wide, narrow) = (with(isa), isa.narrower().and_then(with));
    let is_short = wide.is_some_and(|(_, phases)| phases == 16) && shape.columns <= tuning.narrow;
    if is_short { narrow.or(wide) } else { wide.or(narrow) }
}

/// As many phases of images of `shape` as fit in a vector of `lanes`, if these are several.
fn phases(lanes: usize, shape: Shape) -> Option<usize> {
    let phases = lanes / channels(shape).next_power_of_two();
    let is_whole = phases > 1 && shape.columns.is_multiple_of(2 * phases);
    (shape.rows == 1 && is_whole).then_some(phases)
}

/// One row of tokens is a sequence of one channel.
fn channels(shape: Shape) -> usize {
    match shape.layout {
        Layout::Tokens => 1,
        Layout::Grid => shape.lanes,
    }
}

impl<T: Element> Polyphase<T> {
    pub(crate) fn new(isa: Isa, shape: Shape, phases: usize) -> Self {
        let (lanes, length) = (isa.lanes::<T>(), shape.columns);
        let points = length / phases;
        let half = points / 2;
        let complex = |(c, s): (f64, f64)| Complex::new(T::nearest(c), T::nearest(-s));
        let slots = lanes / phases;
        let (mut twiddles, mut bins) = (Vec::new(), Vec::new());
        for group in frequencies(half, phases).chunks_exact(phases) {
            for phase in 1..phases {
                let roots = group.iter().map(|k| complex(root(phase * k, length)));
                let (re, im): (Vec<_>, Vec<_>) = roots.map(|root| (root.re, root.im)).unzip();
                twiddles.extend([re.repeat(slots), im.repeat(slots)].concat());
            }
            for across in 0..phases {
                bins.extend(group.iter().map(|k| Bin::of(k + across * points, length)));
            }
        }
        Self {
            isa,
            lanes,
            phases,
            tile: shape.lanes,
            channels: channels(shape),
            slots,
            points,
            transform: Transform::new(isa, half),
            turns: (0..=half / 2).map(|k| complex(root(k, points))).collect(),
            twiddles: Aligned::copy_of(&twiddles),
            bins,
        }
    }

    /// Numbers of the lines of all lanes.
    fn line_len(&self) -> usize {
        self.points * self.lanes
    }

    /// Numbers of a spectrum, or of a packed weight: `[group][frequency across the phases][re, im][slot][place]`.
    fn spectrum_len(&self) -> usize {
        2 * self.slots * self.bins.len()
    }

    fn work_len(&self) -> usize {
        2 * self.lanes * self.transform.work_len()
    }

    fn buffers<'a, X: Stored<Real = T>>(&self, scratch: &'a mut [T]) -> Buffers<'a, X> {
        let (line, rest) = aligned(scratch).split_at_mut(self.line_len());
        let (spectrum, rest) = rest.split_at_mut(self.spectrum_len());
        let (work, rest) = rest.split_at_mut(self.work_len());
        let stage = &mut cast_slice_mut(rest)[..self.line_len()];
        if self.channels < self.slots {
            stage.fill(X::zeroed()); // what was there might be numbers too small to be normal, which are slow
        }
        Buffers { line, spectrum, work, stage }
    }

    /// A sequence to the spectra of its phases.
    fn enter<X: Stored<Real = T>>(&self, image: &[X], buffers: &mut Buffers<'_, X>) {
        let image = if self.channels == self.slots {
            Tile::dense(image, self.lanes)
        } else {
            spread(self.channels, image, buffers.stage, self.slots, 0);
            Tile::dense(buffers.stage, self.lanes)
        };
        let inputs = self.transform.inputs();
        self.isa.run(Enter { inputs, image, line: buffers.line });
        self.transform.forward(buffers.line, buffers.work);
    }

    /// Undoes [`enter`](Self::enter).
    fn leave<X: Stored<Real = T>>(&self, buffers: &mut Buffers<'_, X>, image: &mut [X]) {
        let inputs = self.transform.inputs();
        self.transform.inverse(buffers.line, buffers.work);
        let line = &mut *buffers.line;
        if self.channels == self.slots {
            self.isa.run(Leave { inputs, image: TileMut::dense(image, self.lanes), line });
        } else {
            let stage = TileMut::dense(buffers.stage, self.lanes);
            self.isa.run(Leave { inputs, image: stage, line });
            collect(self.channels, buffers.stage, self.slots, 0, image);
        }
    }

    /// The transforms across the phases, what is done with the spectrum, and back.
    fn across(&self, line: &mut [T], spectrum: Spectrum<'_, T>) {
        with_codelet!(phases self.phases,
            L => self.isa.run(Across::<T, L> { plan: self, line, spectrum }),
            _ => unreachable!("planned phases"));
    }
}

/// The frequencies of a real line of `2 half` points in groups of `places`, an even number: some `k`, and behind them each
/// `half - k`, which comes from the same complex numbers. The last pair fills what is left of the last group.
fn frequencies(half: usize, places: usize) -> Vec<usize> {
    let pairs = half / 2 + 1;
    let in_group = |first: usize| {
        let ks = (first..first + places / 2).map(move |k| k.min(pairs - 1));
        ks.clone().chain(ks.map(move |k| half - k))
    };
    (0..pairs).step_by(places / 2).flat_map(in_group).collect()
}

impl<T: Element> Bin<T> {
    /// The bin of frequency `k` of a spectrum of `length`, which the transforms make two times as large, and the inverse again.
    fn of(k: usize, length: usize) -> Self {
        let (index, is_conjugate) = Bins { rows: 1, columns: length }.of(0, k);
        let norm = 0.5 / length as f64;
        let is_real = index == 0 || 2 * index == length;
        let im = match (is_real, is_conjugate) {
            (true, _) => 0.0,
            (_, true) => -norm,
            _ => norm,
        };
        let [weight, gradient] =
            [1.0, if is_real { 0.5 } else { 1.0 }].map(|by| [norm, im].map(|x| T::nearest(by * x)));
        Self { index, weight, gradient }
    }
}

/// The scratch of one call, cut into its uses.
struct Buffers<'a, X: Stored> {
    /// The phases, all lanes of a complex number together.
    line: &'a mut [X::Real],
    /// A spectrum beside that of the line.
    spectrum: &'a mut [X::Real],
    work: &'a mut [X::Real],
    /// A sequence whose phases are fewer than the lanes.
    stage: &'a mut [X],
}

impl<T: Element> Packing<T> for Polyphase<T> {
    fn packed_len(&self, _: usize) -> usize {
        self.spectrum_len()
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, T>,
        factor: Factor,
        packed: &mut [T],
        _: &mut Team<'_, T>,
    ) {
        let weight = weight.to_slice().expect("a weight has no gaps");
        let (weight, _) = weight.as_chunks::<2>();
        let vectors = packed.chunks_exact_mut(2 * self.lanes);
        for (bins, packed) in self.bins.chunks_exact(self.phases).zip(vectors) {
            let (re, im) = packed.split_at_mut(self.lanes);
            let slots = re.chunks_exact_mut(self.phases).zip(im.chunks_exact_mut(self.phases));
            for (slot, (re, im)) in slots.enumerate() {
                let channel = slot.min(self.channels - 1); // what a gap has does not matter
                for ((bin, re), im) in bins.iter().zip(re).zip(im) {
                    let w = weight[bin.index * self.channels + channel];
                    (*re, *im) = (w[0] * bin.weight[0], w[1] * bin.weight[1]);
                    if factor == Factor::Conjugate {
                        *im = T::default() - *im;
                    }
                }
            }
        }
    }
}

impl<X: Stored> Kernel<X> for Polyphase<X::Real> {
    fn tile(&self) -> usize {
        self.tile
    }

    fn scratch_len(&self) -> usize {
        slack::<X::Real>() + 2 * self.line_len() + self.spectrum_len() + self.work_len()
    }

    fn packing(&self) -> Option<&dyn Packing<X::Real>> {
        Some(self)
    }

    fn sum_len(&self, _: usize) -> usize {
        self.spectrum_len()
    }

    fn forward(
        &self,
        x: ArrayView3<'_, X>,
        factor: &[X::Real],
        mut y: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
    ) {
        let mut buffers = self.buffers(team.scratch());
        for (x, mut y) in x.outer_iter().zip(y.outer_iter_mut()) {
            self.enter(x.to_slice().expect("an image has no gaps"), &mut buffers);
            self.across(buffers.line, Spectrum::Product(factor));
            self.leave(&mut buffers, y.as_slice_mut().expect("an image has no gaps"));
        }
    }

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
        let Backward { grad, x, weight: factor, mut grad_x, mut grad_sum, .. } = pass;
        let mut buffers = self.buffers(team.scratch());
        for (image, grad) in grad.outer_iter().enumerate() {
            if grad_sum.is_some() {
                let x = x.index_axis(BATCH, image);
                self.enter(x.to_slice().expect("an image has no gaps"), &mut buffers);
                self.across(buffers.line, Spectrum::Kept(buffers.spectrum));
            }
            self.enter(grad.to_slice().expect("an image has no gaps"), &mut buffers);
            let factor = grad_x.is_some().then_some(factor);
            self.across(
                buffers.line,
                match grad_sum.as_deref_mut() {
                    Some(sum) => Spectrum::Gradient { x: buffers.spectrum, sum, factor },
                    None => Spectrum::Product(factor.unwrap_or(&[])),
                },
            );
            if let Some(grad_x) = &mut grad_x {
                let mut grad_x = grad_x.index_axis_mut(BATCH, image);
                self.leave(&mut buffers, grad_x.as_slice_mut().expect("an image has no gaps"));
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        mut grad_weight: ArrayViewMut3<'_, X::Real>,
        _: &mut Team<'_, X::Real>,
    ) {
        let grad_weight = grad_weight.as_slice_mut().expect("a weight has no gaps");
        let (grad_weight, _) = grad_weight.as_chunks_mut::<2>();
        let vectors = grad_sum.chunks_exact(2 * self.lanes);
        for (bins, sums) in self.bins.chunks_exact(self.phases).zip(vectors) {
            let (re, im) = sums.split_at(self.lanes);
            let slots = re.chunks_exact(self.phases).zip(im.chunks_exact(self.phases));
            for (channel, (re, im)) in slots.enumerate().take(self.channels) {
                for ((bin, re), im) in bins.iter().zip(re).zip(im) {
                    grad_weight[bin.index * self.channels + channel] =
                        [*re * bin.gradient[0], *im * bin.gradient[1]];
                }
            }
        }
    }
}

/// Even and odd points as real and imaginary parts, where the transform takes them.
struct Enter<'a, X: Stored> {
    inputs: &'a [usize],
    image: Tile<'a, X>,
    line: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for Enter<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let line = complex_vectors::<V>(self.line);
        for (n, &input) in self.inputs.iter().enumerate() {
            let [re, im] = self.image.gather(2 * n, 1);
            line[input] = Complex::new(re, im);
        }
    }
}

/// Undoes [`Enter`].
struct Leave<'a, X: Stored> {
    inputs: &'a [usize],
    image: TileMut<'a, X>,
    line: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for Leave<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let line = complex_vectors::<V>(self.line);
        for (n, &input) in self.inputs.iter().enumerate() {
            let Complex { re, im } = line[input];
            self.image.scatter(2 * n, 1, [re, im]);
        }
    }
}
