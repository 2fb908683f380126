//! Scene files → scene builder, and export.
