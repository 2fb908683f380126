//! Figures 13, 14 and 17 of [Vivanloc2007], measured again.

use super::{
    Effort, ReportError, accuracy,
    light::{Built, Photons, Shape, build, look_ups_per_second},
    notebook::Notebook,
    subject::{Prepared, Subject},
    table::{Cell, Cells, Column, Table},
};

/// Scenes of the paper that we have, or others like them; figures 14 and 17 are of the last one.
pub(super) const SCENES: [&str; 4] = ["boxes", "bunny-room", "sponza", "dragon-room"];

/// Photons in the maps, figures 13 and 17.
const PHOTON_COUNT: u32 = 600_000;

/// Seconds of figure 13 at depths 4, 5 and 6 by the name of our scene.
const FIGURE_13: [(&str, [f64; 3]); 3] =
    [("boxes", [5.0, 37.0, 165.0]), ("bunny-room", [8.0, 40.0, 161.0]), ("dragon-room", [6.0, 37.0, 227.0])];

/// Photons of figure 14.
const FIGURE_14_PHOTONS: [u32; 4] = [150_000, 300_000, 600_000, 1_200_000];

/// Neighbours of figure 14, and seconds by photons.
const FIGURE_14: [(u32, [f64; 4]); 4] = [
    (50, [4.0, 5.0, 6.0, 6.0]),
    (100, [6.0, 7.0, 10.0, 14.0]),
    (250, [16.0, 21.0, 20.0, 29.0]),
    (500, [33.0, 44.0, 44.0, 47.0]),
];

/// Lights of figure 17: seconds, spread in degrees, frames per second.
const FIGURE_17: [(u32, [f64; 3]); 6] = [
    (1, [58.0, 30.0, 25.0]),
    (2, [85.0, 25.0, 20.0]),
    (3, [97.0, 22.5, 17.0]),
    (4, [108.0, 20.0, 14.0]),
    (6, [132.0, 15.0, 12.0]),
    (8, [150.0, 10.0, 10.0]),
];

const SCENE: Column = Column::given("scene", "scene");
const DEPTH: Column = Column::given("depth", "depth");
const NEIGHBOURS: Column = Column::given("neighbours", "k");
const VDLS: Column = Column::given("vdls", "VDLs");
const ASKED: Column = Column::given("photons_asked", "photons");
const KEPT: Column = Column::here("photons_kept", "photons kept", "");
const EMITTED: Column = Column::here("photons_emitted", "emitted", "");
const PHOTON_SECONDS: Column = Column::here("photon_seconds", "tracing photons", "s");
const VOXEL_SECONDS: Column = Column::here("voxel_seconds", "voxels", "s");
const GATHER_SECONDS: Column = Column::here("gather_thread_seconds", "gather", "thread s");
const CLUSTER_SECONDS: Column = Column::here("cluster_thread_seconds", "cluster", "thread s");
const SECONDS: Column = Column::here("seconds", "gather + cluster", "s");
const PAPER_SECONDS: Column = Column::paper("paper_seconds", "paper", "s");
const CELLS: Column = Column::here("cells", "cells", "");
const SPREAD: Column = Column::here("spread_deg", "spread", "°");
const PAPER_SPREAD: Column = Column::paper("paper_spread_deg", "paper's spread", "°");
const LOOK_UPS: Column = Column::here("look_ups_per_second", "look-ups", "1/s");
const PAPER_FRAMES: Column = Column::paper("paper_frames_per_second", "paper's GPU", "frames/s");

/// What was read and traced last: rows that follow each other mostly ask for the same.
#[derive(Default)]
struct Bench {
    prepared: Option<(String, Prepared)>,
    photons: Option<(String, u32, Photons)>,
}

impl Bench {
    fn prepared(&mut self, subject: &Subject) -> Result<&Prepared, ReportError> {
        Ok(self.with_photons(subject, None)?.0)
    }

    /// The scene, and about `kept_count` photons of it.
    fn with_photons(
        &mut self,
        subject: &Subject,
        kept_count: Option<u32>,
    ) -> Result<(&Prepared, Option<&Photons>), ReportError> {
        let name = &subject.name;
        let prepared = match self.prepared.take().filter(|(known, _)| known == name) {
            Some(known) => known,
            None => (name.clone(), subject.prepare()?),
        };
        let prepared = &self.prepared.insert(prepared).1;
        let Some(kept_count) = kept_count else { return Ok((prepared, None)) };
        let same = |(known, count, _): &(String, u32, Photons)| known == name && *count == kept_count;
        let photons = match self.photons.take().filter(same) {
            Some(known) => known,
            None => (name.clone(), kept_count, Photons::about(&prepared.world, kept_count)),
        };
        Ok((prepared, Some(&self.photons.insert(photons).2)))
    }

    /// Builds an octree and fills the columns that all figures share.
    fn measure(
        &mut self,
        subject: &Subject,
        kept_count: u32,
        shape: Shape,
        effort: Effort,
    ) -> Result<(Cells, Built, &Prepared), ReportError> {
        let empty = || ReportError::Empty { name: subject.name.clone(), missing: "surface" };
        let (prepared, photons) = self.with_photons(subject, Some(kept_count))?;
        let photons = photons.ok_or_else(empty)?;
        let built = build(&prepared.world, photons, shape, effort.octree_builds).ok_or_else(empty)?;
        let counts = built.octree.counts();
        let mut cells: Cells = [
            (SCENE, Cell::from(subject.name.as_str())),
            (DEPTH, f64::from(shape.depth).into()),
            (NEIGHBOURS, f64::from(shape.neighbour_count).into()),
            (VDLS, f64::from(shape.vdl_count).into()),
            (ASKED, f64::from(kept_count).into()),
            (KEPT, (photons.kept_count as f64).into()),
            (EMITTED, (photons.tracing.paths().path_count() as f64).into()),
            (PHOTON_SECONDS, photons.seconds.into()),
            (VOXEL_SECONDS, built.voxel_seconds.into()),
            (GATHER_SECONDS, counts.gather_seconds.into()),
            (CLUSTER_SECONDS, counts.cluster_seconds.into()),
            (SECONDS, built.build_seconds.into()),
            (CELLS, (built.octree.leaf_count() as f64).into()),
            // The angle at the centre of a unit circle that a chord of this length is seen under.
            (SPREAD, f64::from(built.octree.spread_degrees()).into()),
        ]
        .map(|(column, cell)| (column.key.to_string(), cell))
        .into();
        accuracy::add(&mut cells, subject, prepared, built.octree.clone(), effort.passes)?;
        Ok((cells, built, prepared))
    }
}

/// Measures the three figures.
pub(super) fn measure(
    notebook: &mut Notebook,
    subjects: &[Subject],
    effort: Effort,
) -> Result<(), ReportError> {
    // The command line's first scene; of the paper's own list the dragon, which is its last.
    let dragon = subjects.iter().find(|subject| subject.name == "dragon-room").or(subjects.first());
    let dragon = dragon.ok_or_else(|| ReportError::NoScene { wanted: SCENES.join(".glb, ") + ".glb" })?;
    let mut bench = Bench::default();
    for subject in subjects {
        let prepared = bench.prepared(subject)?;
        accuracy::explain(notebook, subject, prepared);
    }
    notebook.note(
        "Photons kept are those in the maps: light that reached a surface by way of others. How many must be emitted for \
         them is found by a pilot run; the flux of a photon goes in steps of 2^¼, so the number kept is within a tenth of \
         what was asked for.",
    );
    notebook.note(format!(
        "Seconds are of the wall clock with all threads; thread seconds add up over threads. Every octree is built {} times \
         and its fastest build is shown; photons are traced once.",
        effort.octree_builds
    ));
    figure_13(notebook, &mut bench, subjects, effort)?;
    figure_14(notebook, &mut bench, dragon, effort)?;
    figure_17(notebook, &mut bench, dragon, effort)
}

fn with_accuracy(columns: &[Column]) -> Vec<Column> {
    columns.iter().chain(&accuracy::COLUMNS).copied().collect()
}

fn paper(cells: &mut Cells, column: Column, value: Option<f64>) {
    cells.insert(column.key.into(), value.into());
}

fn figure_13(
    notebook: &mut Notebook,
    bench: &mut Bench,
    subjects: &[Subject],
    effort: Effort,
) -> Result<(), ReportError> {
    let about = "Seconds of gathering and clustering by the octree's depth; 600,000 photons, 300 gathered, 4 VDLs. The \
                 paper's scenes are others of the same name and about the same kind."
        .into();
    let columns = with_accuracy(&[
        SCENE,
        DEPTH,
        KEPT,
        PHOTON_SECONDS,
        VOXEL_SECONDS,
        GATHER_SECONDS,
        CLUSTER_SECONDS,
        SECONDS,
        PAPER_SECONDS,
        CELLS,
    ]);
    notebook.begin(Table::new("figure-13", "Figure 13: preprocessing by depth", about, &columns));
    for subject in subjects {
        let paper_seconds = FIGURE_13.iter().find(|(name, _)| *name == subject.name);
        for (index, depth) in [4, 5, 6].into_iter().enumerate() {
            notebook.row(&format!("{} depth {depth}", subject.name), || {
                let shape = Shape { depth: depth - effort.levels_less, neighbour_count: 300, vdl_count: 4 };
                let (mut cells, ..) = bench.measure(subject, effort.photons(PHOTON_COUNT), shape, effort)?;
                paper(&mut cells, PAPER_SECONDS, paper_seconds.map(|(_, seconds)| seconds[index]));
                Ok(cells)
            })?;
        }
    }
    Ok(())
}

fn figure_14(
    notebook: &mut Notebook,
    bench: &mut Bench,
    subject: &Subject,
    effort: Effort,
) -> Result<(), ReportError> {
    let about = format!(
        "Seconds of gathering and clustering by photons and by neighbours gathered (k); {}, depth 5, 4 VDLs. The paper's \
         scene is its dragon.",
        subject.name
    );
    let columns =
        with_accuracy(&[ASKED, NEIGHBOURS, KEPT, GATHER_SECONDS, CLUSTER_SECONDS, SECONDS, PAPER_SECONDS]);
    notebook.begin(Table::new("figure-14", "Figure 14: neighbours and photons", about, &columns));
    for (index, count) in FIGURE_14_PHOTONS.into_iter().enumerate() {
        for (neighbour_count, seconds) in FIGURE_14 {
            notebook.row(&format!("{} photons {count} k {neighbour_count}", subject.name), || {
                let shape = Shape { depth: 5 - effort.levels_less, neighbour_count, vdl_count: 4 };
                let (mut cells, ..) = bench.measure(subject, effort.photons(count), shape, effort)?;
                paper(&mut cells, PAPER_SECONDS, Some(seconds[index]));
                Ok(cells)
            })?;
        }
    }
    Ok(())
}

fn figure_17(
    notebook: &mut Notebook,
    bench: &mut Bench,
    subject: &Subject,
    effort: Effort,
) -> Result<(), ReportError> {
    let about = format!(
        "Quality by the number of virtual directional lights (VDLs); {}, depth 6, 600,000 photons, 300 gathered. Spread: \
         2 asin(c/2), c the root mean square of the chord between photons and their light's direction. Look-ups are those \
         of a picture's pixels at the surfaces that the camera sees, on the CPU with all threads.",
        subject.name
    );
    let columns =
        with_accuracy(&[VDLS, KEPT, SECONDS, PAPER_SECONDS, SPREAD, PAPER_SPREAD, LOOK_UPS, PAPER_FRAMES]);
    notebook.begin(Table::new("figure-17", "Figure 17: clusters and quality", about, &columns));
    for (vdl_count, [seconds, spread, frames]) in FIGURE_17 {
        notebook.row(&format!("{} VDLs {vdl_count}", subject.name), || {
            let shape = Shape { depth: 6 - effort.levels_less, neighbour_count: 300, vdl_count };
            let (mut cells, built, prepared) =
                bench.measure(subject, effort.photons(PHOTON_COUNT), shape, effort)?;
            let look_ups = look_ups_per_second(prepared, &*built.octree);
            cells.insert(LOOK_UPS.key.into(), look_ups.into());
            paper(&mut cells, PAPER_SECONDS, Some(seconds));
            paper(&mut cells, PAPER_SPREAD, Some(spread));
            paper(&mut cells, PAPER_FRAMES, Some(frames));
            Ok(cells)
        })?;
    }
    Ok(())
}
