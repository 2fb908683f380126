//! Pictures → bytes: EXR, PNG, JPEG.
