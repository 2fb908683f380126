//! The stability suite: what must hold of every technique whatever the scene.
//!
//! `laws`: the numerical laws of `techniques.md`, each for each technique: similar scenes, other triangles, twice the light, light
//! by light, furnaces, reciprocity. `hostile`: scenes drawn from a seed that files and people will send one day, from degenerate
//! triangles to eyes inside walls; every technique must end, with finite numbers, and say how far off it is. `found`: what that
//! has found, by name.
//!
//! By default as many hostile scenes as a minute allows; `LUMICAST_STABILITY_CASES=1000` takes so many, `forever` goes on until it
//! is stopped or twenty fail, `LUMICAST_STABILITY_SEED=7` takes the one of that seed, and both together so many from there on:
//!
//!     LUMICAST_STABILITY_SEED=7 cargo test -p lumicast-tests --test stability hostile -- --nocapture

mod draft;
mod drawing;
mod found;
mod hostile;
mod laws;
