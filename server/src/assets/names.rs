//! Names of a file → ids of a scene. File names need not be there, be valid or be unique; ids are all three.

use std::collections::HashMap;

use lumicast_engine::scene::Id;

/// Makes ids for one kind of object.
#[derive(Debug, Default)]
pub(in crate::assets) struct Names {
    prefix: String,
    /// The number to try next for a name that was taken: without it a file of equal names takes quadratic time.
    next: HashMap<Id, u32>,
}

impl Names {
    pub(in crate::assets) fn new(prefix: Option<&str>) -> Names {
        Names { prefix: prefix.unwrap_or_default().into(), next: HashMap::new() }
    }

    /// The first of `names` that is there (else `fallback`), with ` #2`, ` #3` … behind it when taken.
    pub(in crate::assets) fn unique(
        &mut self,
        names: &[Option<&str>],
        fallback: &str,
        is_taken: impl Fn(&Id) -> bool,
    ) -> Id {
        let name = names.iter().flatten().find(|name| !name.is_empty()).copied().unwrap_or(fallback);
        let text = format!("{}{name}", self.prefix);
        let cut = Id::sanitised(&text, fallback);
        // A valid name of full length stays whole; only names that need a number must leave room for it.
        let id = Id::new(&text).unwrap_or_else(|| cut.clone());
        if !is_taken(&id) {
            return id;
        }
        let next = self.next.entry(cut.clone()).or_insert(2);
        loop {
            let candidate = Id::sanitised(&format!("{cut} #{next}"), fallback);
            let candidate = Id::new(&format!("{cut} #{next}")).unwrap_or(candidate);
            *next += 1;
            if !is_taken(&candidate) {
                return candidate;
            }
        }
    }
}
