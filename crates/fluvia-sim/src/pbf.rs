//! Position-based fluids (Macklin & Müller 2013).
