//! technique.
