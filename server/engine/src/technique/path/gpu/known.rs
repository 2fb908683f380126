//! What paths ask for light on a card: cells of the light octree, records of irradiance, and photons of a pass.

use std::sync::{Arc, Weak};

use bytemuck::Zeroable;

use super::{
    shadow_maps::Shadows,
    sketch::{GpuSketch, SketchOnCard},
};

use crate::{
    gpu::{BindGroup, Binding, Buffer, GpuError, Layout, Session},
    math::Rgb,
    technique::{
        FocusedLight, GpuOctreeHeader, PackedFocused, PackedLight, PackedPhotons, PackedRecords,
        SecondaryLight,
    },
};

/// Lights that stay on the card for whoever asks them next; those that were asked longest ago go first. An octree and records are what the
/// viewers of a scene ask in turns, and a drawing for somebody else has its own of both.
const LIGHTS_MAX: usize = 4;
/// The same of photons: those of a looked-up film and of the path-traced one beside it.
const FOCUSED_MAX: usize = 2;

/// What paths ask for light that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// The light octree.
    Octree,
    /// Records of irradiance, and the octree where none counts.
    Records,
}

/// How paths are shaded: each is a shader of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shading {
    /// `None`: nobody is asked.
    pub asked: Option<Asked>,
    /// Photons bring light that mirrors and glass focus.
    pub is_focused: bool,
}

impl Shading {
    pub(super) const COUNT: usize = 6;

    /// All there are of pictures of a scene.
    ///
    /// - `has_focused`: something in it focuses light
    pub fn all(has_focused: bool) -> impl Iterator<Item = Shading> {
        // As viewers need them: by records and, before those are there, by nothing.
        let asked = [Some(Asked::Records), None, Some(Asked::Octree)];
        let focused = if has_focused { &[true, false][..] } else { &[false][..] };
        let each =
            move |asked| focused.iter().map(move |is_focused| Shading { asked, is_focused: *is_focused });
        asked.into_iter().flat_map(each)
    }

    /// Its place among all of them.
    pub(super) fn index(self) -> usize {
        let asked = match self.asked {
            None => 0,
            Some(Asked::Octree) => 1,
            Some(Asked::Records) => 2,
        };
        2 * asked + usize::from(self.is_focused)
    }
}

/// Light that paths ask for beside what they find.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LightBeside<'a> {
    /// What is known of light that other surfaces scatter.
    pub(super) known: Option<&'a Arc<dyn SecondaryLight>>,
    /// What mirrors and glass focus, of one pass.
    pub(super) focused: Option<&'a Arc<dyn FocusedLight>>,
    /// Who tells what lights without extent reach.
    pub(super) shadows: Shadows,
}

impl<'a> LightBeside<'a> {
    pub(super) fn is_any(self) -> bool {
        self.known.is_some() || self.focused.is_some()
    }

    /// The focused light, where it is a sketch.
    pub(super) fn sketch(self) -> Option<&'a Arc<dyn FocusedLight>> {
        self.focused.filter(|focused| focused.is_sketch())
    }
}

/// What of some light is brought to a card, and what it is shown times there: packed is what was learnt.
pub(super) fn undimmed(known: Option<&Arc<dyn SecondaryLight>>) -> (Option<&Arc<dyn SecondaryLight>>, Rgb) {
    match known.and_then(|known| known.undimmed()) {
        Some((light, by)) => (Some(light), by),
        None => (known, Rgb::WHITE),
    }
}

/// Both are one, or there are none.
pub(super) fn is_same<T: ?Sized>(a: Option<&Arc<T>>, b: Option<&Arc<T>>) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => Arc::ptr_eq(a, b),
        (a, b) => a.is_none() && b.is_none(),
    }
}

/// Names light without keeping it: its memory is that of whoever made it.
#[derive(Clone, Debug)]
struct Name<T: ?Sized>(Option<Weak<T>>);

impl<T: ?Sized> Name<T> {
    fn of(light: Option<&Arc<T>>) -> Name<T> {
        Name(light.map(Arc::downgrade))
    }

    fn is_of(&self, light: Option<&Arc<T>>) -> bool {
        match (&self.0, light) {
            (Some(own), Some(light)) => std::ptr::addr_eq(own.as_ptr(), Arc::as_ptr(light)),
            (own, light) => own.is_none() && light.is_none(),
        }
    }

    /// Both name one light.
    fn is_as(&self, other: &Name<T>) -> bool {
        match (&self.0, &other.0) {
            (Some(own), Some(other)) => std::ptr::addr_eq(own.as_ptr(), other.as_ptr()),
            (own, other) => own.is_none() && other.is_none(),
        }
    }

    /// Nobody has it any more.
    fn is_gone(&self) -> bool {
        self.0.as_ref().is_some_and(|own| own.strong_count() == 0)
    }
}

fn not_packed(what: &str) -> GpuError {
    GpuError::Failed { what: format!("{what} is not packed for graphics cards") }
}

/// Light that is to be brought to the card, in words.
#[derive(Debug, Default)]
pub(super) struct PackedBeside {
    records: Option<PackedRecords>,
    cells: Option<PackedLight>,
    photons: Option<PackedFocused>,
}

impl PackedBeside {
    /// Packs what is lacking. It takes threads, and so is not to be called with a lock held: a thread that waits for others may begin what
    /// waits for the lock.
    pub(super) fn pack(&mut self, light: LightBeside<'_>, lacking: Lacking) -> Result<(), GpuError> {
        if let Some(known) = light.known {
            if lacking.records {
                self.records = known.packed_records();
            }
            if lacking.cells {
                self.cells = Some(cells_of(cells_asked(known))?);
            }
        }
        if let Some(focused) = light.focused.filter(|_| lacking.photons) {
            let sketched = || not_packed("what a camera sees of focused light");
            self.photons = Some(focused.packed().ok_or_else(sketched)?);
        }
        Ok(())
    }
}

/// What is asked in cells: the base of what has records, and otherwise itself.
fn cells_asked(known: &Arc<dyn SecondaryLight>) -> Option<&Arc<dyn SecondaryLight>> {
    if known.has_records() { known.base() } else { Some(known) }
}

fn cells_of(known: Option<&Arc<dyn SecondaryLight>>) -> Result<PackedLight, GpuError> {
    match known {
        Some(known) => known.packed().ok_or_else(|| not_packed(known.card().name)),
        None => Ok(PackedLight {
            header: GpuOctreeHeader::zeroed(),
            words: Vec::new(),
            sets: Vec::new(),
            vdls: Vec::new(),
        }),
    }
}

/// What of some light is neither on the card nor packed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Lacking {
    records: bool,
    cells: bool,
    photons: bool,
}

/// Light in cells.
#[derive(Debug)]
struct Cells {
    known: Name<dyn SecondaryLight>,
    /// Header, nodes, groups and lights.
    buffers: [Buffer; 4],
}

impl Cells {
    fn new(
        session: &Session,
        known: Option<&Arc<dyn SecondaryLight>>,
        packed: &PackedLight,
    ) -> Result<Cells, GpuError> {
        let buffers = [
            session.buffer_of("octree header", &[packed.header])?,
            session.buffer_of("octree", &packed.words)?,
            session.buffer_of("light sets", &packed.sets)?,
            session.buffer_of("virtual lights", &packed.vdls)?,
        ];
        Ok(Cells { known: Name::of(known), buffers })
    }
}

/// Records of some light.
#[derive(Debug)]
pub(super) struct RecordsOnCard {
    /// Themselves, and words that say where they are.
    pub(super) buffers: [Buffer; 2],
    /// How many of each cache, which lie one after the other, the finest first.
    pub(super) counts: Vec<u32>,
}

impl RecordsOnCard {
    fn new(session: &Session, packed: &PackedRecords) -> Result<RecordsOnCard, GpuError> {
        let buffers = [
            session.buffer_of("records", &packed.records)?,
            session.buffer_of("words of records", &packed.words)?,
        ];
        Ok(RecordsOnCard { buffers, counts: packed.counts.clone() })
    }
}

/// Photons, words that say where they are, and of a sketch what says how it is read: zeros of what is none.
fn photons_of(session: &Session, packed: &PackedPhotons) -> Result<[Buffer; 3], GpuError> {
    Ok([
        session.buffer_of("photons", &packed.photons)?,
        session.buffer_of("words of photons", &packed.words)?,
        session.buffer_of::<GpuSketch>("no sketch", &[])?,
    ])
}

/// What is asked for light.
#[derive(Debug)]
struct Light {
    known: Name<dyn SecondaryLight>,
    cells: Arc<Cells>,
    /// `None`: it has none.
    records: Option<RecordsOnCard>,
}

/// Photons of a pass.
#[derive(Debug)]
struct Focused {
    light: Name<dyn FocusedLight>,
    photons: [Buffer; 3],
    /// A sketch that says too little of its picture is not.
    is_fit: bool,
}

/// Light on a card. What was asked last stays there for a while: films take turns.
#[derive(Debug)]
pub(super) struct KnownOnCard {
    /// The ones asked last at the end.
    lights: Vec<Light>,
    focused: Vec<Focused>,
    /// What stands for cells, records and photons where there are none.
    no_cells: Cells,
    no_records: RecordsOnCard,
    no_photons: [Buffer; 3],
    pub(super) layout: Arc<Layout>,
    /// What shaders see.
    pub(super) group: BindGroup,
    /// What is in the group, and what shades by it.
    bound: (Name<dyn SecondaryLight>, Name<dyn FocusedLight>),
    shading: Shading,
}

impl KnownOnCard {
    /// No light at all.
    pub(super) fn nothing(session: &Session) -> Result<KnownOnCard, GpuError> {
        let no_cells = Cells::new(session, None, &cells_of(None)?)?;
        let nothing = PackedRecords { records: Vec::new(), counts: Vec::new(), words: Vec::new() };
        let no_records = RecordsOnCard::new(session, &nothing)?;
        let no_photons = photons_of(session, &PackedPhotons { photons: Vec::new(), words: Vec::new() })?;
        // The same for all that is asked: what a shader does not read it may have.
        let [uniform, read] = [Binding::Uniform, Binding::Read];
        let layout = session.layout(&[uniform, read, read, read, read, read, read, read, uniform])?;
        let group = bind(session, &layout, &no_cells, &no_records, &no_photons)?;
        Ok(KnownOnCard {
            lights: Vec::new(),
            focused: Vec::new(),
            no_cells,
            no_records,
            no_photons,
            layout,
            group,
            bound: (Name(None), Name(None)),
            shading: Shading::default(),
        })
    }

    /// What is to be packed before it can be brought.
    pub(super) fn lacking(&self, light: LightBeside<'_>, packed: &PackedBeside) -> Lacking {
        let LightBeside { known, focused, .. } = light;
        let new = known.filter(|known| !self.lights.iter().any(|light| light.known.is_of(Some(known))));
        let cells = known.and_then(cells_asked);
        let has_cells = self.cells_of(cells).is_some() || packed.cells.is_some();
        let has_photons = self.focused.iter().any(|own| own.light.is_of(focused)) || packed.photons.is_some();
        Lacking {
            records: new.is_some_and(|known| known.has_records()) && packed.records.is_none(),
            cells: new.is_some() && !has_cells,
            photons: focused.is_some() && !has_photons,
        }
    }

    fn cells_of(&self, known: Option<&Arc<dyn SecondaryLight>>) -> Option<&Arc<Cells>> {
        self.lights.iter().map(|light| &light.cells).find(|cells| cells.known.is_of(known))
    }

    /// Brings light to the card as far as it is not there, and says what shades by it. Where there is no room, all other light goes
    /// first, for a sketch that of other passes alone; what nobody has any more goes in any case.
    ///
    /// - `packed`: what was [lacking](KnownOnCard::lacking)
    ///
    /// Errors: [`GpuError::LightTooLarge`], then that light [is not here](KnownOnCard::too_large), and what the card does not do.
    pub(super) fn bring(
        &mut self,
        session: &Arc<Session>,
        light: LightBeside<'_>,
        packed: &PackedBeside,
    ) -> Result<Shading, GpuError> {
        if !(self.bound.0.is_of(light.known) && self.bound.1.is_of(light.focused)) {
            // What goes leaves the card before something else comes: the group holds what is in it.
            self.unbind(session)?;
            let cells = self.cells_of(light.known.and_then(cells_asked)).cloned();
            match self.bind_all(session, light, packed, cells.as_ref()) {
                Err(GpuError::OutOfMemory { .. }) => {
                    if light.sketch().is_none() {
                        self.lights.retain(|own| own.known.is_of(light.known));
                    }
                    self.focused.retain(|own| own.light.is_of(light.focused));
                    match self.bind_all(session, light, packed, cells.as_ref()) {
                        Err(error @ GpuError::OutOfMemory { .. }) => {
                            return Err(self.too_large(session, light, error)?);
                        }
                        done => done?,
                    }
                }
                done => done?,
            }
        }
        self.lights.retain(|light| !light.known.is_gone());
        self.focused.retain(|focused| !focused.light.is_gone());
        Ok(self.shading)
    }

    /// Records of the light that is there for who asks; `None` where it has none.
    pub(super) fn records(&self) -> Option<&RecordsOnCard> {
        self.lights.iter().find(|light| light.known.is_as(&self.bound.0))?.records.as_ref()
    }

    /// Counts a sketch as far as it is not here, before paths ask it, and says whether it is fit for its picture. Where there is no room,
    /// light of other passes goes first, and nothing else.
    ///
    /// - `packed`: what was [lacking](KnownOnCard::lacking)
    ///
    /// Errors: [`GpuError::LightTooLarge`], and what the card does not do.
    pub(super) fn count(
        &mut self,
        session: &Arc<Session>,
        sketch: &Arc<dyn FocusedLight>,
        packed: &PackedBeside,
    ) -> Result<bool, GpuError> {
        // As in `bring`: what the group holds cannot go.
        self.unbind(session)?;
        self.focused.retain(|own| !own.light.is_gone());
        let mut place = self.bring_focused(session, sketch, packed);
        if matches!(place, Err(GpuError::OutOfMemory { .. })) {
            self.focused.clear();
            place = self.bring_focused(session, sketch, packed);
        }
        match place {
            Ok(place) => Ok(self.focused.get(place).is_some_and(|own| own.is_fit)),
            Err(error @ GpuError::OutOfMemory { .. }) => {
                Err(GpuError::LightTooLarge { source: Box::new(error) })
            }
            Err(error) => Err(error),
        }
    }

    /// Lets go of all light but that which is there for who asks.
    pub(super) fn forget_others(&mut self) {
        let KnownOnCard { lights, focused, bound, .. } = self;
        lights.retain(|light| light.known.is_as(&bound.0));
        focused.retain(|focused| focused.light.is_as(&bound.1));
    }

    /// Lets go of all light.
    pub(super) fn forget(&mut self, session: &Session) -> Result<(), GpuError> {
        self.lights.clear();
        self.focused.clear();
        self.unbind(session)
    }

    /// Lets go of what mirrors and glass focus, which is of one pass.
    pub(super) fn forget_focused(&mut self, session: &Session) -> Result<(), GpuError> {
        self.focused.clear();
        self.unbind(session)
    }

    /// Lets go of light that has no room, and says so: of a sketch alone where there is one, since the CPU draws its one pass, and of
    /// all light else.
    pub(super) fn too_large(
        &mut self,
        session: &Session,
        light: LightBeside<'_>,
        error: GpuError,
    ) -> Result<GpuError, GpuError> {
        match light.sketch() {
            Some(sketch) => {
                self.focused.retain(|own| !own.light.is_of(Some(sketch)));
                self.unbind(session)?;
            }
            None => self.forget(session)?,
        }
        Ok(GpuError::LightTooLarge { source: Box::new(error) })
    }

    fn unbind(&mut self, session: &Session) -> Result<(), GpuError> {
        self.group = bind(session, &self.layout, &self.no_cells, &self.no_records, &self.no_photons)?;
        (self.bound, self.shading) = ((Name(None), Name(None)), Shading::default());
        Ok(())
    }

    fn bind_all(
        &mut self,
        session: &Arc<Session>,
        light: LightBeside<'_>,
        packed: &PackedBeside,
        cells: Option<&Arc<Cells>>,
    ) -> Result<(), GpuError> {
        let LightBeside { known, focused, .. } = light;
        let light = known.map(|known| self.bring_known(session, known, packed, cells)).transpose()?;
        let photons = focused.map(|focused| self.bring_focused(session, focused, packed)).transpose()?;
        let light = light.and_then(|place| self.lights.get(place));
        let photons = photons.and_then(|place| self.focused.get(place));
        let cells = light.map_or(&self.no_cells, |light| &*light.cells);
        let records = light.and_then(|light| light.records.as_ref());
        let asked = light.map(|_| if records.is_some() { Asked::Records } else { Asked::Octree });
        self.group = bind(
            session,
            &self.layout,
            cells,
            records.unwrap_or(&self.no_records),
            photons.map_or(&self.no_photons, |focused| &focused.photons),
        )?;
        self.bound = (Name::of(known), Name::of(focused));
        self.shading = Shading { asked, is_focused: focused.is_some() };
        Ok(())
    }

    /// Its place among the lights, the last.
    ///
    /// - `there`: cells of it that are on the card
    fn bring_known(
        &mut self,
        session: &Session,
        known: &Arc<dyn SecondaryLight>,
        packed: &PackedBeside,
        there: Option<&Arc<Cells>>,
    ) -> Result<usize, GpuError> {
        if let Some(place) = self.lights.iter().position(|light| light.known.is_of(Some(known))) {
            let light = self.lights.remove(place);
            self.lights.push(light);
            return Ok(self.lights.len() - 1);
        }
        if self.lights.len() >= LIGHTS_MAX {
            self.lights.remove(0);
        }
        let unpacked = || not_packed(known.card().name);
        let cells = match there {
            Some(cells) => Arc::clone(cells),
            None => {
                let packed = packed.cells.as_ref().ok_or_else(unpacked)?;
                Arc::new(Cells::new(session, cells_asked(known), packed)?)
            }
        };
        let packed = packed.records.as_ref().filter(|_| known.has_records());
        if known.has_records() && packed.is_none() {
            return Err(unpacked());
        }
        let records = packed.map(|packed| RecordsOnCard::new(session, packed)).transpose()?;
        self.lights.push(Light { known: Name::of(Some(known)), cells, records });
        Ok(self.lights.len() - 1)
    }

    /// Its place among the photons, the last.
    fn bring_focused(
        &mut self,
        session: &Arc<Session>,
        focused: &Arc<dyn FocusedLight>,
        packed: &PackedBeside,
    ) -> Result<usize, GpuError> {
        if let Some(place) = self.focused.iter().position(|own| own.light.is_of(Some(focused))) {
            let own = self.focused.remove(place);
            self.focused.push(own);
            return Ok(self.focused.len() - 1);
        }
        if self.focused.len() >= FOCUSED_MAX {
            self.focused.remove(0);
        }
        let (photons, is_fit) = match packed.photons.as_ref() {
            None => return Err(not_packed("focused light")),
            Some(PackedFocused::Grids(packed)) => (photons_of(session, packed)?, true),
            Some(PackedFocused::Sketch(packed)) => {
                let SketchOnCard { buffers, is_fit, .. } = SketchOnCard::new(session, packed)?;
                (buffers, is_fit)
            }
        };
        self.focused.push(Focused { light: Name::of(Some(focused)), photons, is_fit });
        Ok(self.focused.len() - 1)
    }
}

fn bind(
    session: &Session,
    layout: &Layout,
    cells: &Cells,
    records: &RecordsOnCard,
    photons: &[Buffer; 3],
) -> Result<BindGroup, GpuError> {
    let buffers: Vec<&Buffer> = cells.buffers.iter().chain(&records.buffers).chain(photons).collect();
    session.bind(layout, &buffers)
}
