//! fluvia-net
