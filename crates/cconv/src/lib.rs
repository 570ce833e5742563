//! cconv
