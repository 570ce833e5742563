//! The program as its users run it.

mod common;
mod compare;
mod evaluate;
mod faults;
mod generate;
mod mesh;
mod render;
mod sequences;
mod simulate;
mod tools;
mod train;
mod view;
