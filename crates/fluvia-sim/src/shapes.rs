//! Built-in shapes, named in scene files.
