//! Vector types of one register each, from the names of their intrinsics.

/// Methods of a vector, in which the intrinsics need their instruction set.
macro_rules! of_registers {
    ($(fn $method:ident($($argument:tt)*) -> $result:ty { $body:expr })*) => {$(
        #[inline(always)]
        fn $method($($argument)*) -> $result {
            // SAFETY: a vector of this type exists only below `Isa::run`, which found its instruction set.
            unsafe { $body }
        }
    )*};
    ($(unsafe fn $method:ident($($argument:tt)*) $(-> $result:ty)? { $body:expr })*) => {$(
        #[inline(always)]
        unsafe fn $method($($argument)*) $(-> $result)? {
            // SAFETY: the caller promises the elements; the instruction needs no alignment.
            unsafe { $body }
        }
    )*};
}
pub(super) use of_registers;

/// A vector type of single precision, which is loaded from halves and stored as them too.
macro_rules! vector {
    ($name:ident($raw:ty); $splat:ident $load:ident $store:ident $add:ident $sub:ident $mul:ident $neg:ident
     $mul_add:ident $neg_mul_add:ident $mul_sub:ident $interleave:ident $deinterleave:ident $deinterleave_reversed:ident
     $reverse:ident $exchange_halves:ident $transpose_in_halves:ident
     $load_bf16:ident $store_bf16:ident $load_f16:ident $store_f16:ident) => {
        #[derive(Clone, Copy)]
        #[repr(transparent)]
        pub(crate) struct $name($raw);

        impl Add for $name {
            type Output = Self;
            of_registers! { fn add(self, other: Self) -> Self { Self($add(self.0, other.0)) } }
        }

        impl Sub for $name {
            type Output = Self;
            of_registers! { fn sub(self, other: Self) -> Self { Self($sub(self.0, other.0)) } }
        }

        impl Mul for $name {
            type Output = Self;
            of_registers! { fn mul(self, other: Self) -> Self { Self($mul(self.0, other.0)) } }
        }

        impl Neg for $name {
            type Output = Self;
            of_registers! { fn neg(self) -> Self { Self($neg(self.0)) } }
        }

        // SAFETY: a register is its floats without padding; loads and stores move a whole one.
        unsafe impl Vector for $name {
            type Element = f32;
            const LANES: usize = size_of::<$raw>() / size_of::<f32>();

            of_registers! {
                unsafe fn load(from: *const f32) -> Self { Self($load(from)) }
                unsafe fn store(self, to: *mut f32) { $store(to, self.0) }
                unsafe fn load_bf16(from: *const Bf16) -> Self { Self($load_bf16(from)) }
                unsafe fn store_bf16(self, to: *mut Bf16) { $store_bf16(self.0, to) }
                unsafe fn load_f16(from: *const F16) -> Self { Self($load_f16(from)) }
                unsafe fn store_f16(self, to: *mut F16) { $store_f16(self.0, to) }
            }

            of_registers! {
                fn splat(x: f32) -> Self { Self($splat(x)) }
                fn mul_add(self, b: Self, c: Self) -> Self { Self($mul_add(self.0, b.0, c.0)) }
                fn neg_mul_add(self, b: Self, c: Self) -> Self { Self($neg_mul_add(self.0, b.0, c.0)) }
                fn mul_sub(self, b: Self, c: Self) -> Self { Self($mul_sub(self.0, b.0, c.0)) }
                fn interleave(a: Self, b: Self) -> (Self, Self) {{
                    let (low, high) = $interleave(a.0, b.0);
                    (Self(low), Self(high))
                }}
                fn deinterleave(low: Self, high: Self) -> (Self, Self) {{
                    let (a, b) = $deinterleave(low.0, high.0);
                    (Self(a), Self(b))
                }}
                fn deinterleave_reversed(low: Self, high: Self) -> (Self, Self) {{
                    let (a, b) = $deinterleave_reversed(low.0, high.0);
                    (Self(a), Self(b))
                }}
                fn reverse(self) -> Self { Self($reverse(self.0)) }
                fn exchange_halves(a: Self, b: Self) -> (Self, Self) {{
                    let (first, second) = $exchange_halves(a.0, b.0);
                    (Self(first), Self(second))
                }}
            }

            #[inline(always)]
            fn transpose_in_halves(vectors: &mut [Self]) {
                // loops: `map` would not be inlined
                let mut raw = [vectors[0].0; Self::LANES / 2];
                for i in 0..Self::LANES / 2 {
                    raw[i] = vectors[i].0;
                }
                // SAFETY: a vector of this type exists only below `Isa::run`, which found its instruction set.
                raw = unsafe { $transpose_in_halves(raw) };
                for i in 0..Self::LANES / 2 {
                    vectors[i] = Self(raw[i]);
                }
            }
        }
    };
}
pub(super) use vector;
