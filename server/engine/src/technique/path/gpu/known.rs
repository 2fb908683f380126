//! What paths ask for light on a card: cells of the light octree, records of irradiance, and photons of a pass.

use std::sync::Arc;

use bytemuck::Zeroable;

use crate::{
    gpu::{BindGroup, Binding, Buffer, GpuError, Layout, Session},
    technique::{FocusedLight, GpuOctreeHeader, PackedLight, PackedPhotons, PackedRecords, SecondaryLight},
};

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
}

/// Both are one, or there are none.
pub(super) fn is_same<T: ?Sized>(a: Option<&Arc<T>>, b: Option<&Arc<T>>) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => Arc::ptr_eq(a, b),
        (a, b) => a.is_none() && b.is_none(),
    }
}

fn not_packed(what: &str) -> GpuError {
    GpuError::Failed { what: format!("{what} is not packed for graphics cards") }
}

/// Light in cells.
#[derive(Debug)]
struct Cells {
    /// `None`: nothing is known.
    known: Option<Arc<dyn SecondaryLight>>,
    /// Header, nodes, groups and lights.
    buffers: [Buffer; 4],
}

impl Cells {
    fn new(session: &Session, known: Option<&Arc<dyn SecondaryLight>>) -> Result<Cells, GpuError> {
        let packed = match known {
            Some(known) => known.packed().ok_or_else(|| not_packed(known.card().name))?,
            None => PackedLight {
                header: GpuOctreeHeader::zeroed(),
                words: Vec::new(),
                sets: Vec::new(),
                vdls: Vec::new(),
            },
        };
        let buffers = [
            session.buffer_of("octree header", &[packed.header])?,
            session.buffer_of("octree", &packed.words)?,
            session.buffer_of("light sets", &packed.sets)?,
            session.buffer_of("virtual lights", &packed.vdls)?,
        ];
        Ok(Cells { known: known.cloned(), buffers })
    }
}

/// Records, and words that say where they are.
fn records_of(session: &Session, packed: &PackedRecords) -> Result<[Buffer; 2], GpuError> {
    Ok([
        session.buffer_of("records", &packed.records)?,
        session.buffer_of("words of records", &packed.words)?,
    ])
}

/// Photons, and words that say where they are.
fn photons_of(session: &Session, packed: &PackedPhotons) -> Result<[Buffer; 2], GpuError> {
    Ok([
        session.buffer_of("photons", &packed.photons)?,
        session.buffer_of("words of photons", &packed.words)?,
    ])
}

/// What is asked for light.
#[derive(Debug)]
struct Light {
    known: Arc<dyn SecondaryLight>,
    cells: Arc<Cells>,
    /// `None`: it has none.
    records: Option<[Buffer; 2]>,
}

/// Light on a card: what was last asked, of each kind. It stays there until something else of its kind is: films that ask and films that
/// do not take turns.
#[derive(Debug)]
pub(super) struct KnownOnCard {
    octree: Option<Light>,
    records: Option<Light>,
    focused: Option<(Arc<dyn FocusedLight>, [Buffer; 2])>,
    /// What stands for cells, records and photons where there are none.
    no_cells: Cells,
    no_records: [Buffer; 2],
    no_photons: [Buffer; 2],
    pub(super) layout: Arc<Layout>,
    /// What shaders see.
    pub(super) group: BindGroup,
    /// What is in the group, and what shades by it.
    bound: (Option<Arc<dyn SecondaryLight>>, Option<Arc<dyn FocusedLight>>),
    shading: Shading,
}

impl KnownOnCard {
    /// No light at all.
    pub(super) fn nothing(session: &Session) -> Result<KnownOnCard, GpuError> {
        let no_cells = Cells::new(session, None)?;
        let no_records = records_of(session, &PackedRecords { records: Vec::new(), words: Vec::new() })?;
        let no_photons = photons_of(session, &PackedPhotons { photons: Vec::new(), words: Vec::new() })?;
        // The same for all that is asked: what a shader does not read it may have.
        let [uniform, read] = [Binding::Uniform, Binding::Read];
        let layout = session.layout(&[uniform, read, read, read, read, read, read, read])?;
        let group = bind(session, &layout, &no_cells, &no_records, &no_photons)?;
        Ok(KnownOnCard {
            octree: None,
            records: None,
            focused: None,
            no_cells,
            no_records,
            no_photons,
            layout,
            group,
            bound: (None, None),
            shading: Shading::default(),
        })
    }

    /// Brings light to the card as far as it is not there, and says what shades by it.
    pub(super) fn bring(&mut self, session: &Session, light: LightBeside<'_>) -> Result<Shading, GpuError> {
        let LightBeside { known, focused } = light;
        if is_same(self.bound.0.as_ref(), known) && is_same(self.bound.1.as_ref(), focused) {
            return Ok(self.shading);
        }
        // What goes leaves the card before something else comes: the group holds what is in it.
        self.group = bind(session, &self.layout, &self.no_cells, &self.no_records, &self.no_photons)?;
        let asked = known.map(|known| self.bring_known(session, known)).transpose()?;
        if let Some(focused) = focused {
            self.bring_focused(session, focused)?;
        }
        let light = match asked {
            None => None,
            Some(Asked::Octree) => self.octree.as_ref(),
            Some(Asked::Records) => self.records.as_ref(),
        };
        let cells = light.map_or(&self.no_cells, |light| &*light.cells);
        let records = light.and_then(|light| light.records.as_ref()).unwrap_or(&self.no_records);
        let photons = self.focused.as_ref().filter(|_| focused.is_some());
        let photons = photons.map_or(&self.no_photons, |(_, photons)| photons);
        self.group = bind(session, &self.layout, cells, records, photons)?;
        self.bound = (known.cloned(), focused.cloned());
        self.shading = Shading { asked, is_focused: focused.is_some() };
        Ok(self.shading)
    }

    fn bring_known(&mut self, session: &Session, known: &Arc<dyn SecondaryLight>) -> Result<Asked, GpuError> {
        let is_this = |light: &Light| Arc::ptr_eq(&light.known, known);
        if self.octree.as_ref().is_some_and(is_this) {
            return Ok(Asked::Octree);
        }
        if self.records.as_ref().is_some_and(is_this) {
            return Ok(Asked::Records);
        }
        let packed = known.packed_records();
        let of_cells = if packed.is_some() { known.base() } else { Some(known) };
        let mut lights = self.octree.iter().chain(&self.records);
        let there = lights.find(|light| is_same(light.cells.known.as_ref(), of_cells));
        let there = there.map(|light| Arc::clone(&light.cells));
        let (asked, place) = match &packed {
            Some(_) => (Asked::Records, &mut self.records),
            None => (Asked::Octree, &mut self.octree),
        };
        // The old light makes room first.
        *place = None;
        let cells = match there {
            Some(cells) => cells,
            None => Arc::new(Cells::new(session, of_cells)?),
        };
        let records = packed.map(|packed| records_of(session, &packed)).transpose()?;
        *place = Some(Light { known: Arc::clone(known), cells, records });
        Ok(asked)
    }

    fn bring_focused(&mut self, session: &Session, focused: &Arc<dyn FocusedLight>) -> Result<(), GpuError> {
        if self.focused.as_ref().is_some_and(|(own, _)| Arc::ptr_eq(own, focused)) {
            return Ok(());
        }
        self.focused = None;
        let packed = focused.packed().ok_or_else(|| not_packed("what a camera sees of focused light"))?;
        self.focused = Some((Arc::clone(focused), photons_of(session, &packed)?));
        Ok(())
    }
}

fn bind(
    session: &Session,
    layout: &Layout,
    cells: &Cells,
    records: &[Buffer; 2],
    photons: &[Buffer; 2],
) -> Result<BindGroup, GpuError> {
    let buffers: Vec<&Buffer> = cells.buffers.iter().chain(records).chain(photons).collect();
    session.bind(layout, &buffers)
}
