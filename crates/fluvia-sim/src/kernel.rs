//! Smoothing kernels of smoothed particle hydrodynamics.
