//! Laws of import and export, on small files made here, and on the shared scenes where they are at hand.

mod shared;
