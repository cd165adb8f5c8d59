//! Loops that are unrolled whatever the compiler thinks of it.

/// Repeats a block with constants: the compiler would not unroll all of these loops, and then twiddles and indices were variables.
macro_rules! unroll {
    ($i:ident in $from:literal..$to:ident $body:block) => {
        unroll!(@ $i, $from, $to, $body, 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15)
    };
    (@ $i:ident, $from:literal, $to:ident, $body:block, $($number:literal)*) => {
        const { assert!($to <= 16) };
        $(if $from <= $number && $number < $to {
            let $i: usize = $number;
            $body
        })*
    };
}
pub(crate) use unroll;
