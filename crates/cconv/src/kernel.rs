//! Which instruction set computes, and what an operation may ask of it.
//!
//! One source for all instruction sets: an operation is written once, free of branches, against
//! [`InstructionSet`], and compiled for each set ([`Kernel::run`]); only the inner loop of the matrix product is
//! written by hand, one file a set.

#[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
mod avx2;
#[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
mod avx512;
#[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
mod avx512_bf16;
pub(crate) mod bf16;
#[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
mod instructions;
mod portable;

use std::ops::Range;

#[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
use instructions::instructions;
pub(crate) use portable::Portable;

/// Rows that one call of the matrix product works on: a multiple of the rows of every register tile.
pub(crate) const ROWS: usize = 12;

/// Columns of a panel of packed weights: four vectors of the widest kind, so that 6 rows of accumulators
/// fill 24 of 32 registers.
pub(crate) const PANEL: usize = 64;

/// An instruction set that this processor has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernel(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
    Avx512Bf16,
    #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
    Avx512,
    #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
    Avx2,
    Portable,
}

impl Kernel {
    /// The fastest kernel for this processor. Compiled with `--cfg fluvia_portable`, the portable one.
    pub fn detect() -> Kernel {
        Self::available()[0]
    }

    /// All kernels that this processor can run, the fastest first.
    pub fn available() -> Vec<Kernel> {
        let mut kernels = Vec::new();
        #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
        {
            if avx512::available() && avx512::bf16_available() {
                kernels.push(Kernel(Set::Avx512Bf16));
            }
            if avx512::available() {
                kernels.push(Kernel(Set::Avx512));
            }
            if avx2::available() {
                kernels.push(Kernel(Set::Avx2));
            }
        }
        kernels.push(Kernel(Set::Portable));
        kernels
    }

    /// The name by which reports call it: "avx512-bf16", "avx512", "avx2" or "portable".
    pub fn name(self) -> &'static str {
        match self.0 {
            #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
            Set::Avx512Bf16 => "avx512-bf16",
            #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
            Set::Avx512 => "avx512",
            #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
            Set::Avx2 => "avx2",
            Set::Portable => "portable",
        }
    }

    /// Runs an operation as compiled for this kernel.
    pub(crate) fn run(self, operation: impl Operation) {
        match self.0 {
            // SAFETY: only `available` makes these values, after it has asked the processor.
            #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
            Set::Avx512Bf16 => unsafe { avx512::run_bf16(operation) },
            // SAFETY: as above.
            #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
            Set::Avx512 => unsafe { avx512::run(operation) },
            // SAFETY: as above.
            #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
            Set::Avx2 => unsafe { avx2::run(operation) },
            Set::Portable => operation.run::<Portable>(),
        }
    }
}

impl Default for Kernel {
    fn default() -> Self {
        Kernel::detect()
    }
}

/// What is compiled once for each instruction set. `run` and all that it calls must be `inline(always)`.
pub(crate) trait Operation {
    fn run<I: InstructionSet>(self);
}

/// Vectors of float32 and the operations on them. One line each in the file of a set; all of them
/// `inline(always)`, so that they become single instructions inside [`Kernel::run`].
///
/// The sets of one processor are private to this module and named in [`Kernel::run`] alone, after the processor was
/// asked. So code that is generic over a set runs only where its instructions are, and may call them.
pub(crate) trait InstructionSet {
    /// `LANES` floats.
    type Vector: Copy;
    /// The result of a comparison, lane by lane.
    type Mask: Copy;
    /// Four floats.
    type Quad: Copy;
    /// Floats in a vector; divides 16.
    const LANES: usize;

    fn splat(x: f32) -> Self::Vector;
    /// Reads the first `LANES` values.
    fn load(from: &[f32]) -> Self::Vector;
    /// Writes the first `LANES` values.
    fn store(x: Self::Vector, to: &mut [f32]);
    /// Writes the first `LANES` values as integers; they lie in 0..2¹⁶.
    fn store_u16(x: Self::Vector, to: &mut [u16]);
    fn add(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn sub(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn mul(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn div(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn min(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn max(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn sqrt(x: Self::Vector) -> Self::Vector;
    fn abs(x: Self::Vector) -> Self::Vector;
    /// The magnitude of `x` with the sign of `sign`.
    fn copysign(x: Self::Vector, sign: Self::Vector) -> Self::Vector;
    /// Rounds numbers of magnitude below 2³¹ towards zero.
    fn truncate(x: Self::Vector) -> Self::Vector;
    fn less_equal(a: Self::Vector, b: Self::Vector) -> Self::Mask;
    /// `a` where the mask holds, else `b`.
    fn select(mask: Self::Mask, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a · b + c, fused where that is one instruction.
    fn multiply_add(a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;

    fn quad_splat(x: f32) -> Self::Quad;
    fn quad_load(from: &[f32]) -> Self::Quad;
    fn quad_store(x: Self::Quad, to: &mut [f32]);
    fn quad_multiply_add(a: Self::Quad, b: Self::Quad, c: Self::Quad) -> Self::Quad;

    /// Asks for the cache line of `value`, where there is such an instruction.
    fn prefetch(value: &f32);

    /// The sum of all lanes.
    fn sum(x: Self::Vector) -> f32;

    /// c += a · b, see [`Product`].
    fn multiply(product: Product<'_>);
    /// c += aᵀ · b, see [`Outer`].
    fn multiply_outer(outer: Outer<'_>);

    /// c += a · b for factors in bfloat16.
    #[inline(always)]
    fn multiply_bf16(product: Product<'_, Bf16>) {
        bf16::multiply(product);
    }
    /// c += aᵀ · b for factors in bfloat16.
    #[inline(always)]
    fn multiply_outer_bf16(outer: Outer<'_, Bf16>) {
        bf16::multiply_outer(outer);
    }
    /// Rounds values to bfloat16, to the nearest, ties to even. The lengths are equal and multiples of 4.
    #[inline(always)]
    fn round_bf16(from: &[f32], to: &mut [Bf16]) {
        bf16::round(from, to);
    }
    /// Rounds two rows to bfloat16, a value of the one and a value of the other in turn. The rows are of one
    /// length, a multiple of 4, and `to` of twice that.
    #[inline(always)]
    fn interleave_bf16(first: &[f32], second: &[f32], to: &mut [Bf16]) {
        bf16::interleave(first, second, to);
    }
}

/// A bfloat16: the upper half of a float32.
pub(crate) type Bf16 = u16;

/// c += a · b for a few rows: a is [rows, depth], b a panel [depth, width], c [rows, width].
///
/// `rows` is at most [`ROWS`], `width` a multiple of 16 and at most [`PANEL`]. The slices must hold `ROWS`
/// rows, however many are live: tiles are computed whole. In bfloat16 the depth is even, and b is
/// [depth / 2, width, 2], for the instructions take two products a lane.
pub(crate) struct Product<'a, T = f32> {
    pub rows: usize,
    pub depth: usize,
    pub width: usize,
    pub a: &'a [T],
    pub a_stride: usize,
    pub b: &'a [T],
    pub c: &'a mut [f32],
    pub c_stride: usize,
}

impl<T> Product<'_, T> {
    /// # Panics
    /// If the slices are too short, so that a kernel can work with pointers after this.
    #[inline(always)]
    fn validate(&self) {
        assert!(self.rows <= ROWS && is_panel(self.width), "a tile's shape");
        assert!(self.a.len() >= (ROWS - 1) * self.a_stride + self.depth, "{ROWS} rows of a");
        assert!(self.b.len() >= self.depth * self.width, "a whole panel of b");
        assert!(self.c.len() >= (ROWS - 1) * self.c_stride + self.width, "{ROWS} rows of c");
    }
}

/// c += aᵀ · b: a is [depth, rows], b a panel [depth, width], c [rows, width].
///
/// `rows` is a multiple of 4, `width` a multiple of 16 and at most [`PANEL`]. In bfloat16 the depth counts pairs: a is
/// [depth, rows, 2] and b [depth, width, 2].
pub(crate) struct Outer<'a, T = f32> {
    pub rows: usize,
    pub depth: usize,
    pub width: usize,
    pub a: &'a [T],
    pub a_stride: usize,
    pub b: &'a [T],
    pub c: &'a mut [f32],
    pub c_stride: usize,
}

impl<T> Outer<'_, T> {
    /// `each` is how many values stand in the place of one: 1, or 2 in bfloat16.
    ///
    /// # Panics
    /// If the slices are too short, so that a kernel can work with pointers after this.
    #[inline(always)]
    fn validate(&self, each: usize) {
        let Outer { rows, depth, width, a_stride, c_stride, .. } = *self;
        assert!(rows.is_multiple_of(4) && is_panel(width), "a tile's shape");
        assert!(depth == 0 || self.a.len() >= (depth - 1) * a_stride + each * rows, "{depth} rows of a");
        assert!(self.b.len() >= each * depth * width, "a whole panel of b");
        assert!(rows == 0 || self.c.len() >= (rows - 1) * c_stride + width, "{rows} rows of c");
    }
}

/// Whether a panel can be so wide.
#[inline(always)]
fn is_panel(width: usize) -> bool {
    width > 0 && width <= PANEL && width.is_multiple_of(16)
}

/// How input channels are cut into slabs. The patches of a slab and its weights stay in the second-level
/// cache while all points of a task are multiplied by them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slabs {
    padded: usize,
}

/// Channels of a full slab: 65 cells × 32 channels × 64 outputs are 532 kB of weights.
const SLAB: usize = 32;

impl Slabs {
    pub fn new(channels: usize) -> Slabs {
        let padded = match channels {
            0..=4 => 4,
            5..=8 => 8,
            _ => channels.next_multiple_of(16),
        };
        Slabs { padded }
    }

    /// The number of channels with padding.
    pub fn padded(&self) -> usize {
        self.padded
    }

    /// The channels of each slab; 4, 8, 16 or 32 of them.
    pub fn iter(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let padded = self.padded;
        (0..padded).step_by(SLAB).map(move |first| first..padded.min(first + SLAB))
    }
}
