//! The program as its users run it.

mod common;
mod faults;
mod simulate;
mod tools;
