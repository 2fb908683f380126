//! Which part of the picture a path belongs to.

/// Cuts every light path at its last diffuse scattering before the eye [layout.md].
///
/// Classes go by the lobe that scattered, not by material, so every path has exactly one class and the
/// layers of a picture add up to the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum PathClass {
    /// No diffuse scattering at all: light seen directly or through mirrors and glass (LS*E).
    Emitted,
    /// Light falls on the diffuse surface straight from the source (LDS*E).
    Direct,
    /// Only specular lobes between the source and the diffuse surface (LS+DS*E).
    Caustic,
    /// Another diffuse scattering between (L(S|D)*D(S|D)*DS*E less caustics).
    Indirect,
}

impl PathClass {
    /// Every class, in layer order.
    pub const ALL: [PathClass; 4] =
        [PathClass::Emitted, PathClass::Direct, PathClass::Caustic, PathClass::Indirect];
    /// Number of classes.
    pub const COUNT: usize = Self::ALL.len();

    /// Lower-case name, as in layer names and statistics.
    pub fn name(self) -> &'static str {
        match self {
            PathClass::Emitted => "emitted",
            PathClass::Direct => "direct",
            PathClass::Caustic => "caustic",
            PathClass::Indirect => "indirect",
        }
    }
}
