//! Triangle meshes from OBJ, PLY and STL files.
