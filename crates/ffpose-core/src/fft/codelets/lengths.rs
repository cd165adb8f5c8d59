//! Which lengths have a codelet: one table, by what is transformed.
//!
//! Lengths of several factors are codelets one after the other; constants are theirs.

/// Runs `$run` with the constants of the codelet of a length, or `$otherwise` where there is none.
macro_rules! with_codelet {
    // a radix of a mixed-radix transform: `Dft<R>`
    (radix $length:expr, $r:ident => $run:expr, _ => $otherwise:expr) => {
        $crate::fft::codelets::with_codelet!(@one $length, $r, $run, $otherwise, 2 3 4 5 7 8 11 13 16)
    };
    // a row of a grid: `RealDft<P, ROWS>` across, then `Dft<Q>`
    (row $length:expr, ($p:ident, $q:ident, $rows:ident) => $run:expr, _ => $otherwise:expr) => {
        $crate::fft::codelets::with_codelet!(@three $length, $p, $q, $rows, $run, $otherwise,
            2 => 2 1 1, 4 => 4 1 2, 7 => 7 1 4, 8 => 8 1 4, 14 => 2 7 1, 16 => 2 8 1, 28 => 4 7 2,
            32 => 4 8 2, 56 => 8 7 4, 64 => 8 8 4)
    };
    // a column of a grid, by its radices: `Dft<P>`, then `Dft<Q>` beside the product
    (column $radices:expr, ($p:ident, $q:ident) => $run:expr, _ => $otherwise:expr) => {
        $crate::fft::codelets::with_codelet!(@two $radices, $p, $q, $run, $otherwise,
            (1, 7) => 1 7, (1, 8) => 1 8, (1, 16) => 1 16, (7, 2) => 7 2, (7, 4) => 7 4,
            (7, 8) => 7 8, (4, 8) => 4 8, (8, 8) => 8 8)
    };
    // a line of tokens, in vectors: `RealDft<P, ROWS>` across, then `Dft<Q>`
    (line $length:expr, ($p:ident, $q:ident, $rows:ident) => $run:expr, _ => $otherwise:expr) => {
        $crate::fft::codelets::with_codelet!(@three $length, $p, $q, $rows, $run, $otherwise,
            4 => 4 1 2, 8 => 8 1 4, 16 => 4 4 2, 24 => 8 3 4, 32 => 4 8 2, 48 => 16 3 8,
            64 => 8 8 4, 128 => 16 8 8)
    };
    // a factor of the rows of tokens: `Dft<P>`, then `Dft<Q>`, coprime
    (factor $length:expr, ($p:ident, $q:ident) => $run:expr, _ => $otherwise:expr) => {
        $crate::fft::codelets::with_codelet!(@two $length, $p, $q, $run, $otherwise,
            1 => 1 1, 7 => 1 7, 8 => 1 8, 12 => 3 4, 14 => 7 2, 16 => 1 16, 28 => 7 4, 48 => 3 16)
    };

    (@one $length:expr, $a:ident, $run:expr, $otherwise:expr, $($a_of:literal)*) => {
        match $length {
            $($a_of => {
                const $a: usize = $a_of;
                $run
            })*
            _ => $otherwise,
        }
    };
    (@two $length:expr, $a:ident, $b:ident, $run:expr, $otherwise:expr,
     $($of:pat => $a_of:literal $b_of:literal),*) => {
        match $length {
            $($of => {
                const $a: usize = $a_of;
                const $b: usize = $b_of;
                $run
            })*
            _ => $otherwise,
        }
    };
    (@three $length:expr, $a:ident, $b:ident, $c:ident, $run:expr, $otherwise:expr,
     $($of:pat => $a_of:literal $b_of:literal $c_of:literal),*) => {
        match $length {
            $($of => {
                const $a: usize = $a_of;
                const $b: usize = $b_of;
                const $c: usize = $c_of;
                $run
            })*
            _ => $otherwise,
        }
    };
}
pub(crate) use with_codelet;

/// Whether a length has a codelet in the table of [`with_codelet`].
macro_rules! has_codelet {
    (radix $length:expr) => {
        $crate::fft::codelets::with_codelet!(radix $length, R => R > 0, _ => false)
    };
    (row $length:expr) => {
        $crate::fft::codelets::with_codelet!(row $length, (P, Q, ROWS) => P * Q > ROWS, _ => false)
    };
    (column $radices:expr) => {
        $crate::fft::codelets::with_codelet!(column $radices, (P, Q) => P * Q > 0, _ => false)
    };
    (line $length:expr) => {
        $crate::fft::codelets::with_codelet!(line $length, (P, Q, ROWS) => P * Q > ROWS, _ => false)
    };
    (factor $length:expr) => {
        $crate::fft::codelets::with_codelet!(factor $length, (P, Q) => P * Q > 0, _ => false)
    };
}
pub(crate) use has_codelet;
