//! A shorthand for the x86 sets: functions that are one instruction, or a few.

/// Declares `inline(always)` functions whose body may call the intrinsics of the set.
macro_rules! instructions {
    ($(fn $name:ident($($argument:ident: $type:ty),*) $(-> $result:ty)? $body:block)*) => {
        $(
            #[inline(always)]
            fn $name($($argument: $type),*) $(-> $result)? {
                // SAFETY: only `Kernel::run` can name the set, and does so after the processor was asked; memory
                // is only touched through slices whose length has been checked.
                unsafe { $body }
            }
        )*
    };
}

pub(crate) use instructions;
