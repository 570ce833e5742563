//! Pure functions that judge a state: density, escapes, energy.
