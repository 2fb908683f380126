//! accel.
