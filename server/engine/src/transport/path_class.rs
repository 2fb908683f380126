//! Which part of the picture a path belongs to.

/// Cuts every light path at its last diffuse scattering before the eye [layout.md].
///
/// Classes go by the lobe that scattered, not by material, so every path has exactly one class and the
/// layers of a picture add up to the picture. Light that met no diffuse surface, which the layout has in one class, is in two
/// here: the contract asks for what mirrors, glass and gloss show by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum PathClass {
    /// No scattering at all: light seen directly (LE).
    Emitted,
    /// Light falls on the diffuse surface straight from the source (LDS*E).
    Direct,
    /// Only specular lobes between the source and the diffuse surface (LS+DS*E).
    Caustic,
    /// Another diffuse scattering between (L(S|D)*D(S|D)*DS*E less caustics).
    Indirect,
    /// Scattered, but by no diffuse lobe: light seen in mirrors and glosses and through glass (LS+E). The last, so that the classes of
    /// light that falls on diffuse surfaces fit into two bits.
    Specular,
}

impl PathClass {
    /// Every class, in layer order.
    pub const ALL: [PathClass; 5] =
        [PathClass::Emitted, PathClass::Direct, PathClass::Caustic, PathClass::Indirect, PathClass::Specular];
    /// Those of light that comes to the eye without any diffuse scattering.
    pub const SEEN: [PathClass; 2] = [PathClass::Emitted, PathClass::Specular];
    /// Number of classes.
    pub const COUNT: usize = Self::ALL.len();

    /// Lower-case name, as in layer names and statistics.
    pub fn name(self) -> &'static str {
        match self {
            PathClass::Emitted => "emitted",
            PathClass::Direct => "direct",
            PathClass::Caustic => "caustic",
            PathClass::Indirect => "indirect",
            PathClass::Specular => "specular",
        }
    }
}

/// What scattered at a vertex of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scatter {
    /// The diffuse lobe: D in path notation.
    Diffuse,
    /// Any other lobe (glossy, mirror, glass): S.
    Specular,
}

impl PathClass {
    /// The class of a path that was `self` when it is followed through one more scattering, walking from the eye.
    ///
    /// A path of no scattering is [`PathClass::Emitted`]; the class of the part walked so far says all that the next
    /// vertex needs to know.
    pub fn after(self, scatter: Scatter) -> PathClass {
        match (self, scatter) {
            (PathClass::Emitted | PathClass::Specular, Scatter::Specular) => PathClass::Specular,
            (PathClass::Emitted | PathClass::Specular, Scatter::Diffuse) => PathClass::Direct,
            (PathClass::Direct | PathClass::Caustic, Scatter::Specular) => PathClass::Caustic,
            (_, _) => PathClass::Indirect,
        }
    }

    /// Whether a diffuse lobe scattered its light.
    pub fn meets_diffuse(self) -> bool {
        !Self::SEEN.contains(&self)
    }
}

/// Some of the classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PathClasses(u8);

impl PathClasses {
    /// All of them.
    pub const ALL: PathClasses = PathClasses::of(&PathClass::ALL);
    /// Light that met no diffuse surface, and light that falls on the first one straight from its source.
    pub const SEEN_AND_DIRECT: PathClasses =
        PathClasses::of(&[PathClass::Emitted, PathClass::Specular, PathClass::Direct]);

    /// These.
    pub const fn of(classes: &[PathClass]) -> PathClasses {
        let (mut bits, mut at) = (0, 0);
        while at < classes.len() {
            bits |= 1 << classes[at] as u8;
            at += 1;
        }
        PathClasses(bits)
    }

    /// All of these but one.
    pub fn without(self, class: PathClass) -> PathClasses {
        PathClasses(self.0 & !(1 << class as u8))
    }

    /// Those of light that a diffuse lobe scattered.
    pub fn beyond_diffuse(self) -> PathClasses {
        PathClass::SEEN.into_iter().fold(self, PathClasses::without)
    }

    /// Bit c: the class whose number is c is among them.
    pub fn bits(self) -> u32 {
        u32::from(self.0)
    }

    /// Those that are in both.
    pub fn and(self, other: PathClasses) -> PathClasses {
        PathClasses(self.0 & other.0)
    }

    /// Whether one is among them.
    pub fn contains(self, class: PathClass) -> bool {
        self.0 >> class as u8 & 1 == 1
    }

    /// Whether a path that is of `class` so far becomes one of these by some further scatterings, one at least.
    pub fn are_beyond(self, class: PathClass) -> bool {
        let beyond = match class {
            PathClass::Emitted | PathClass::Specular => PathClasses::ALL.without(PathClass::Emitted),
            PathClass::Direct | PathClass::Caustic => {
                PathClasses::of(&[PathClass::Caustic, PathClass::Indirect])
            }
            PathClass::Indirect => PathClasses::of(&[PathClass::Indirect]),
        };
        self.and(beyond) != PathClasses(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What lies beyond a class is what some scatterings make of it.
    #[test]
    fn what_lies_beyond_a_class_is_what_scatterings_make_of_it() {
        for class in PathClass::ALL {
            let mut reached = [false; PathClass::COUNT];
            let mut next = vec![class];
            while let Some(class) = next.pop() {
                for after in [Scatter::Diffuse, Scatter::Specular].map(|scatter| class.after(scatter)) {
                    if !std::mem::replace(&mut reached[after as usize], true) {
                        next.push(after);
                    }
                }
            }
            for other in PathClass::ALL {
                assert_eq!(
                    PathClasses::of(&[other]).are_beyond(class),
                    reached[other as usize],
                    "{class:?} {other:?}"
                );
                assert!(PathClasses::ALL.contains(other) && !PathClasses::ALL.without(other).contains(other));
            }
        }
    }

    /// The state machine agrees with the definition on every path of up to seven scatterings.
    #[test]
    fn classes_follow_the_definition_on_all_short_paths() {
        for length in 0..=7 {
            for bits in 0..1u32 << length {
                let path: Vec<Scatter> = (0..length)
                    .map(|i| if bits >> i & 1 == 1 { Scatter::Diffuse } else { Scatter::Specular })
                    .collect();
                let diffuse: Vec<usize> = (0..length).filter(|i| path[*i] == Scatter::Diffuse).collect();
                let expected = match (diffuse.len(), diffuse.first()) {
                    (0, _) if length == 0 => PathClass::Emitted,
                    (0, _) => PathClass::Specular,
                    (1, Some(first)) if first + 1 == length => PathClass::Direct,
                    (1, _) => PathClass::Caustic,
                    _ => PathClass::Indirect,
                };
                let walked = path.iter().fold(PathClass::Emitted, |class, scatter| class.after(*scatter));
                assert_eq!(walked, expected, "{path:?}");
                assert_eq!(walked.meets_diffuse(), !diffuse.is_empty(), "{path:?}");
            }
        }
    }
}
