//! fluvia-render
