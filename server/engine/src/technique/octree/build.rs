//! From photons to leaves: a gather and a clustering for every group of surfaces in every cell, a bounded piece at a time.

use std::{sync::Arc, time::Instant};

use glam::Vec3;
use rayon::prelude::*;

use super::{
    LeafGather, LeafKind, LeafSet, LightOctree, OctreeSettings, RADIUS_MAX_EVEN, SHEET_CELLS,
    cluster::{Clustering, Spread, Vdl},
    cube::Cube,
    drawing::evenness_of,
    gathers::{Gathers, LOOK_CELLS, key_of},
    harmonics::Harmonics,
    lights::{self, RiseOfSpread, ShadedVdl, Softness},
    parting::{NearWalls, Parting, parted},
    reused::Reused,
    tree::Nodes,
    voxels::{Expected, VoxelSet, Voxels},
};
use crate::{
    accel::Ray,
    technique::{Gather, GatherBounds, MAPPED, PhotonProduct, Walls},
    transport::{PathClass, World},
};

/// Cells built in one step: some 3 ms on two threads, and 30 of the coarsest in scenes of many triangles, where pictures wait for it after
/// edits: of 1,024 it takes 0.2 s.
const STEP_CELLS: usize = 128;

/// Where so many photons would fall in even light and none does, it is dark.
const DARK_COUNT: f32 = 8.0;

/// The light of one group of a cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct SetLight {
    /// By class, in the order of [`MAPPED`].
    pub(super) vdls: [Vec<Vdl>; 2],
    /// By class, where that is what is kept.
    pub(super) harmonics: Option<[Harmonics; 2]>,
    /// By class: photons of its gather, as many as can be told.
    pub(super) found: [u16; 2],
    /// By class: of those that came or went since, so many were not looked at.
    pub(super) owed: [u16; 2],
    /// By class: how far from the group's middle its photons lie, m.
    pub(super) radius_m: [f32; 2],
    /// By class: nothing farther than this from the group's middle had any influence, m.
    pub(super) reach_m: [f32; 2],
    /// By class.
    pub(super) spread: [Spread; 2],
    /// Nothing stands near.
    pub(super) is_alone: bool,
    /// The nearest walls around it.
    pub(super) walls: Option<NearWalls>,
}

impl SetLight {
    /// No photon lies within the farthest reach: the same whether there are others farther away or none.
    fn dark(radius_max_m: f32) -> SetLight {
        SetLight { radius_m: [radius_max_m; 2], reach_m: [radius_max_m; 2], ..SetLight::default() }
    }

    /// Luminance of its indirect irradiance, W/m².
    fn irradiance(&self, normal: Vec3) -> f32 {
        match &self.harmonics {
            Some([indirect, _]) => indirect.irradiance(normal).luminance(),
            None => self.vdls[0].iter().map(|vdl| vdl.irradiance.luminance()).sum(),
        }
    }
}

/// An octree in the making.
#[derive(Debug)]
pub(super) struct Building {
    settings: OctreeSettings,
    photons: Arc<PhotonProduct>,
    pub(super) voxels: Arc<Voxels>,
    /// Where cells are all as large.
    radius_max_m: f32,
    /// Light of the cells so far, group by group.
    light: Vec<SetLight>,
    next_cell: usize,
    pub(super) reused: Option<Reused>,
    pub(super) counts: BuildCounts,
}

/// What building one octree took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BuildCounts {
    /// Groups of surfaces whose light was gathered.
    pub gathered: u64,
    /// Groups whose light was taken over.
    pub kept: u64,
    /// Photons that gathers returned.
    pub photons: u64,
    /// Seconds spent on cutting up the geometry.
    pub voxel_seconds: f64,
    /// Seconds of all threads spent on finding photons, and on clustering them.
    pub gather_seconds: f64,
    /// See `gather_seconds`.
    pub cluster_seconds: f64,
}

/// How far the octree has got that is being made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OctreeUnderWay {
    /// Its cells.
    pub(crate) cells: f64,
    /// Share of them that are built.
    pub(crate) share: f64,
    /// What went before the first of them: cutting up the geometry.
    pub(crate) voxel_seconds: f64,
}

impl Building {
    /// Of `photons` at `depth`; light of `before` that is still right is taken over.
    pub(super) fn begin(
        world: &World,
        photons: &Arc<PhotonProduct>,
        settings: OctreeSettings,
        depth: u32,
        before: Option<&Arc<LightOctree>>,
    ) -> Option<Building> {
        let cube = Cube::around(world, depth)?;
        let surfaces = photons.maps.surfaces();
        let known = before.map(|octree| &*octree.voxels);
        let expected = Expected::by(&settings, &cube);
        let start = Instant::now();
        let is_of_these = |octree: &&Arc<LightOctree>| {
            octree.owes() && octree.photons.generation == photons.generation && octree.voxels.cube == cube
        };
        let voxels = match before.filter(is_of_these) {
            Some(octree) => octree.voxels.clone(),
            None => Arc::new(Voxels::of(world.accel(), surfaces, cube.clone(), expected, known)),
        };
        let voxel_seconds = start.elapsed().as_secs_f64();
        let radius_max_m = radius_max_m(&voxels, expected);
        let is_like = |octree: &&Arc<LightOctree>| {
            octree.voxels.cube == cube && octree.radius_max_m == radius_max_m && octree.settings == settings
        };
        let reused = before.filter(is_like).and_then(|octree| {
            Reused::of(octree, photons, voxels.moved_since(&octree.voxels, world.accel()))
        });
        let light = Vec::with_capacity(voxels.sets.len());
        Some(Building {
            settings,
            photons: photons.clone(),
            voxels,
            radius_max_m,
            light,
            next_cell: 0,
            reused,
            counts: BuildCounts { voxel_seconds, ..BuildCounts::default() },
        })
    }

    /// Cells twice as large would have shown all that its photons can.
    pub(super) fn is_deeper_than_needed(&self) -> bool {
        self.settings.is_enough(2.0 * self.voxels.cube.cell_m(), self.radius_max_m)
    }

    /// It is built of these photons.
    pub(super) fn is_of(&self, photons: &PhotonProduct) -> bool {
        self.photons.generation == photons.generation
    }

    /// How far it has got.
    pub(super) fn under_way(&self) -> OctreeUnderWay {
        let cells = self.voxels.codes.len() as f64;
        OctreeUnderWay {
            cells,
            share: self.next_cell as f64 / cells.max(1.0),
            voxel_seconds: self.counts.voxel_seconds,
        }
    }

    /// Builds some more cells; true when all are built.
    pub(super) fn advance(&mut self, world: &World) -> bool {
        let end = (self.next_cell + STEP_CELLS).min(self.voxels.codes.len());
        let this = &*self;
        let built: Vec<(Vec<SetLight>, BuildCounts)> = (self.next_cell..end)
            .into_par_iter()
            .map_init(Workbench::default, |bench, cell| this.light_of_cell(world, cell, bench))
            .collect();
        for (light, counts) in built {
            self.light.extend(light);
            self.counts.gathered += counts.gathered;
            self.counts.kept += counts.kept;
            self.counts.photons += counts.photons;
            self.counts.gather_seconds += counts.gather_seconds;
            self.counts.cluster_seconds += counts.cluster_seconds;
        }
        self.next_cell = end;
        end == self.voxels.codes.len()
    }

    fn light_of_cell(
        &self,
        world: &World,
        cell: usize,
        bench: &mut Workbench,
    ) -> (Vec<SetLight>, BuildCounts) {
        let mut counts = BuildCounts::default();
        let sets = self.voxels.sets_of(cell);
        if let Some(kept) = self.kept_of_cell(cell, sets) {
            counts.kept = kept.len() as u64;
            return (kept, counts);
        }
        let code = self.voxels.codes[cell];
        let light = (0u64..)
            .zip(sets)
            .map(|(place, set)| {
                counts.gathered += 1;
                self.light_of_set(world, set, key_of(code, place), bench, &mut counts)
            })
            .collect();
        (light, counts)
    }

    fn light_of_set(
        &self,
        world: &World,
        set: &VoxelSet,
        key: u64,
        bench: &mut Workbench,
        counts: &mut BuildCounts,
    ) -> SetLight {
        let sides = self.voxels.sides_of(set);
        if !self.photons.maps.has_any(sides) {
            return SetLight::dark(self.radius_max_m * set.scale);
        }
        let start = Instant::now();
        let bounds = self.gathers().bounds_of(world, set, key);
        let walls = bounds.walls;
        counts.gather_seconds += start.elapsed().as_secs_f64();
        let mut light = SetLight {
            is_alone: set.is_alone,
            walls: NearWalls::of(&walls, set.centre, LOOK_CELLS * self.voxels.cube.cell_m() * set.scale),
            ..SetLight::default()
        };
        for (index, class) in MAPPED.into_iter().enumerate() {
            let start = Instant::now();
            self.photons.maps.gather(class, sides, &bounds, &mut bench.gather);
            light.reach_m[index] = bench.gather.reach_m;
            if let Some(dark_m2) = bench.gather.dark_m2.filter(|_| class == PathClass::Indirect) {
                // Nothing falls before the walls. Where a few photons might have, that is known; in a niche it is not.
                light.walls = Some(NearWalls::WITHIN);
                if self.even_count(dark_m2 / (set.scale * set.scale)) < DARK_COUNT {
                    let without = GatherBounds { walls: Walls::default(), ..bounds };
                    self.photons.maps.gather(class, sides, &without, &mut bench.gather);
                }
            }
            let gathered = Instant::now();
            light.radius_m[index] = bench.gather.radius_m;
            counts.photons += bench.gather.photons.len() as u64;
            light.found[index] = u16::try_from(bench.gather.photons.len()).unwrap_or(u16::MAX);
            counts.gather_seconds += (gathered - start).as_secs_f64();
            if bench.gather.photons.is_empty() {
                continue;
            }
            if self.settings.leaf == LeafKind::Harmonics {
                let of_class = Harmonics::project(&bench.gather.photons, set.normal);
                light.harmonics.get_or_insert_default()[index] = of_class;
                counts.cluster_seconds += gathered.elapsed().as_secs_f64();
                continue;
            }
            let spread = bench.clustering.cluster(
                &bench.gather.photons,
                set.normal,
                self.settings.vdl_count.get(),
                key ^ index as u64,
                &mut light.vdls[index],
            );
            light.spread[index] = spread;
            counts.cluster_seconds += gathered.elapsed().as_secs_f64();
        }
        let is_dark = light.harmonics.is_none() && light.vdls.iter().all(Vec::is_empty);
        if is_dark {
            let within = light.walls.filter(|walls| *walls == NearWalls::WITHIN);
            return SetLight { walls: within, ..SetLight::dark(self.radius_max_m * set.scale) };
        }
        light
    }

    /// Photons that fall on so much area, as if cells were all as large, if all lie evenly on everything.
    fn even_count(&self, area_m2: f32) -> f32 {
        let even_m = self.radius_max_m / RADIUS_MAX_EVEN;
        self.settings.neighbours_min.get() as f32 * area_m2 / (std::f32::consts::PI * even_m * even_m)
    }

    pub(super) fn gathers(&self) -> Gathers<'_> {
        Gathers { voxels: &self.voxels, settings: &self.settings, radius_max_m: self.radius_max_m }
    }

    /// What keeps each group from others with other light.
    fn partings(&self, world: &World) -> Vec<Parting> {
        let sets = self.light.iter().zip(&self.voxels.sets);
        let irradiance: Vec<f32> = sets.map(|(light, set)| light.irradiance(set.normal)).collect();
        let walls: Vec<Option<NearWalls>> = self.light.iter().map(|light| light.walls).collect();
        let is_between = |[from, to]: [Vec3; 2]| {
            let ray = Ray { t_max: 1.0, ..Ray::new(from, to - from) };
            world.accel().is_occluded(&ray, |_| true)
        };
        parted(&self.voxels, &walls, &irradiance, is_between)
    }

    /// The finished octree.
    pub(super) fn finish(self, world: &World) -> LightOctree {
        let partings = self.partings(world);
        let mut sets = Vec::with_capacity(self.light.len());
        let mut gathers = Vec::with_capacity(self.light.len());
        let mut vdls: Vec<Vdl> = Vec::new();
        let mut shaded = Vec::new();
        let mut harmonics = Vec::new();
        let mut walls = Vec::new();
        let mut owed = Vec::with_capacity(self.light.len());
        for ((light, set), wall) in self.light.into_iter().zip(&self.voxels.sets).zip(partings) {
            if self.settings.leaf == LeafKind::Harmonics {
                harmonics.push(light.harmonics.unwrap_or_default());
            }
            let first = light.vdls.map(|of_class| {
                let first = vdls.len() as u32;
                vdls.extend(of_class);
                first
            });
            let chord_rms = light.spread.map(|spread| spread.chord_rms);
            let rise = light.spread.map(|spread| spread.rise);
            let softness = chord_rms.map(Softness::of);
            let first_block = shaded.len() as u32;
            let mut spread = [RiseOfSpread::default(); 2];
            for (class, end) in [(0, first[1] as usize), (1, vdls.len())] {
                let of_class = &vdls[first[class] as usize..end];
                let softness = softness[class];
                let ready = of_class.iter().map(|vdl| ShadedVdl::of(vdl, set.normal, softness));
                let evenness = evenness_of(chord_rms[class], of_class.len());
                let lights = ready.clone();
                spread[class] = RiseOfSpread::of(light.spread[class], evenness, lights, set.normal, softness);
                lights::push(&mut shaded, ready);
            }
            let place = walls.len() as u32;
            walls.extend(light.walls);
            sets.push(LeafSet {
                sheet: set.normal.extend(set.normal.dot(set.centre)),
                first_vdl: first,
                end_vdl: vdls.len() as u32,
                first_block,
                softness,
                blur_m: light.radius_m[0],
                is_alone: light.is_alone,
                spread,
                wall,
            });
            owed.push(light.owed);
            gathers.push(LeafGather {
                found: light.found,
                radius_m: light.radius_m,
                reach_m: light.reach_m,
                chord_rms,
                rise,
                walls: light.walls.map(|_| place),
            });
        }
        // Harmonics do not say of which class they are empty.
        let has_caustics =
            !harmonics.is_empty() || sets.iter().any(|set: &LeafSet| set.first_vdl[1] < set.end_vdl);
        let sheet_m = SHEET_CELLS * self.voxels.cube.cell_m();
        let nodes = Nodes::over(&self.voxels.codes, self.voxels.cube.depth);
        LightOctree {
            settings: self.settings,
            photons: self.photons,
            voxels: self.voxels,
            radius_max_m: self.radius_max_m,
            per_sheet_m2: 1.0 / (sheet_m * sheet_m),
            nodes,
            sets,
            gathers,
            owes: owed.iter().any(|owed| *owed != [0; 2]),
            owed,
            walls,
            vdls,
            shaded,
            harmonics,
            counts: self.counts,
            has_caustics,
        }
    }
}

/// How far a gather looks at most, where cells are all as large.
fn radius_max_m(voxels: &Voxels, expected: Expected) -> f32 {
    radius_max_in_cells_m(voxels.area_m2, voxels.cube.cell_m(), expected)
}

/// The same, of that much surface in cells of that width.
fn radius_max_in_cells_m(area_m2: f64, cell_m: f32, expected: Expected) -> f32 {
    let even_m2 = expected.area_of_a_gather_m2(area_m2) / std::f64::consts::PI;
    (RADIUS_MAX_EVEN * even_m2.sqrt() as f32).max(cell_m * 0.5)
}

impl LightOctree {
    /// Cells, about, of each of the octrees that these settings would have built of the same scene one after the other: a surface is met
    /// by four times as many that are half as wide. Without the bound on pieces, which only the largest scenes meet.
    pub(crate) fn cells_by(&self, settings: &OctreeSettings) -> Vec<f64> {
        let expected = Expected::by(settings, &self.voxels.cube);
        let mut cells = Vec::new();
        for depth in settings.depth_first.min(settings.depth)..=settings.depth {
            let halvings = depth as i32 - self.depth() as i32;
            cells.push(self.leaf_count() as f64 * 4f64.powi(halvings));
            let cell_m = self.voxels.cube.cell_m() * 0.5f32.powi(halvings);
            if settings.is_enough(cell_m, radius_max_in_cells_m(self.voxels.area_m2, cell_m, expected)) {
                break;
            }
        }
        cells
    }
}

/// Memory that gathers and clusterings use again.
#[derive(Debug, Default)]
struct Workbench {
    gather: Gather,
    clustering: Clustering,
}
