//! Particles for meshes: Poisson disks on surfaces, a lattice in volumes.
