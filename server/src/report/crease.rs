//! Table 8.2 of [Larsen2004], measured again: irradiance from one photon map, and from one for each crease surface.

use std::{num::NonZeroUsize, sync::Arc, time::Instant};

use glam::Vec3;
use kiddo::ImmutableKdTree;
use lumicast_engine::{
    math::Rgb,
    technique::{
        Bias, Card, Gather, GatherBounds, MAPPED, PhotonProduct, ScatteredLight, SecondaryLight, Surfaces,
        TriangleSide, Walls,
    },
    transport::{PathClass, Surface, World},
};

use super::{
    Effort, ReportError, accuracy,
    light::Photons,
    maps::{cells, median, nearest},
    notebook::Notebook,
    subject::{Prepared, Subject},
    table::{Column, Table},
};

/// The scene most like the paper's; the built-in box where it is not there.
pub(super) const SCENES: [&str; 1] = ["cornell-bumpy-13k"];

/// Photons in the maps.
const PHOTON_COUNT: u32 = 50_000;

/// Photons of an estimate: those of the paper's figure 8.5, since its table names no number.
const NEIGHBOUR_COUNT: NonZeroUsize = NonZeroUsize::new(500).unwrap();

const SCENE: Column = Column::given("scene", "scene");
const WAY: Column = Column::given("maps", "photon maps");
const TREES: Column = Column::here("trees", "trees", "");
const KEPT: Column = Column::here("photons_kept", "photons kept", "");
const BUILD_SECONDS: Column = Column::here("build_seconds", "building", "s");
const PAPER_BUILD: Column = Column::paper("paper_build_seconds", "paper's balancing", "s");
const ESTIMATES: Column = Column::here("estimates", "estimates", "");
const ESTIMATE_SECONDS: Column = Column::here("estimate_seconds", "estimating", "s");
const PAPER_ESTIMATE: Column = Column::paper("paper_estimate_seconds", "paper", "s");

static CARD: Card =
    Card { name: "photon maps", classes: &[PathClass::Indirect, PathClass::Caustic], bias: Bias::Biased };

/// Irradiance by class, in the order of [`MAPPED`], from photons.
trait Estimate: Send + Sync {
    /// At `p` on one side of a triangle that faces `n` there, W/m².
    fn irradiance(&self, place: TriangleSide, p: Vec3, n: Vec3) -> [Rgb; 2];
}

/// A photon of a tree.
#[derive(Clone, Copy)]
struct Photon {
    position: Vec3,
    direction: Vec3,
    flux: Rgb,
    /// Place in [`MAPPED`].
    class: usize,
}

/// Trees over photons: one over all, or one for each side of every crease surface.
struct Trees {
    /// `None`: one for all.
    surfaces: Option<Arc<Surfaces>>,
    trees: Vec<Option<(ImmutableKdTree<f32, 3>, Vec<Photon>)>>,
}

impl Trees {
    fn place(surfaces: Option<&Surfaces>, place: TriangleSide) -> usize {
        surfaces.map_or(0, |surfaces| surfaces.side(place).index())
    }

    /// The photons of maps, shared out.
    fn shared_out(photons: &Photons, surfaces: Option<&Surfaces>) -> Vec<Vec<Photon>> {
        let mut parts = vec![Vec::new(); surfaces.map_or(1, |surfaces| 2 * surfaces.count() as usize)];
        for (hit, flux) in photons.tracing.paths().hits().filter(|(hit, _)| hit.is_on_diffuse()) {
            let Some(class) = MAPPED.iter().position(|class| *class == hit.class()) else { continue };
            let Some(place) = hit.side() else { continue };
            let photon = Photon { position: hit.position, direction: hit.direction(), flux, class };
            parts[Trees::place(surfaces, place)].push(photon);
        }
        parts
    }

    /// The trees, and seconds that building them took, on one thread.
    fn over(parts: Vec<Vec<Photon>>, surfaces: Option<Arc<Surfaces>>) -> (Trees, f64) {
        let start = Instant::now();
        let build = |photons: Vec<Photon>| {
            let positions: Vec<[f32; 3]> = photons.iter().map(|photon| photon.position.to_array()).collect();
            // Without photons there is nothing to find.
            let tree =
                (!positions.is_empty()).then(|| ImmutableKdTree::new_from_slice(&positions).ok())??;
            Some((tree, photons))
        };
        let trees = parts.into_iter().map(build).collect();
        (Trees { surfaces, trees }, start.elapsed().as_secs_f64())
    }

    fn count(&self) -> usize {
        self.trees.iter().flatten().count()
    }
}

impl Estimate for Trees {
    /// E = Σ Φ / (π r²) over the photons that come from above the surface, r the distance of the farthest [Jensen1996].
    fn irradiance(&self, place: TriangleSide, p: Vec3, n: Vec3) -> [Rgb; 2] {
        let mut sums = [Rgb::BLACK; 2];
        let at = Trees::place(self.surfaces.as_deref(), place);
        let Some((tree, photons)) = self.trees.get(at).and_then(Option::as_ref) else { return sums };
        let mut radius2 = 0.0f32;
        for (distance2, item) in nearest(tree, p.to_array(), NEIGHBOUR_COUNT) {
            let photon = &photons[item as usize];
            radius2 = radius2.max(distance2);
            if photon.direction.dot(n) > 0.0 {
                sums[photon.class] += photon.flux;
            }
        }
        let per_area = if radius2 > 0.0 { 1.0 / (std::f32::consts::PI * radius2) } else { 0.0 };
        sums.map(|sum| sum * per_area)
    }
}

/// The engine's own maps with the exact area of their surfaces.
struct Product {
    product: Arc<PhotonProduct>,
    /// The whole scene's: no gather is cut short.
    radius_max_m: f32,
}

impl Estimate for Product {
    fn irradiance(&self, place: TriangleSide, p: Vec3, n: Vec3) -> [Rgb; 2] {
        let maps = &self.product.maps;
        let side = maps.surfaces().side(place);
        let bounds = GatherBounds {
            centre: p,
            normal: n,
            radius_m: f32::INFINITY,
            count_min: NEIGHBOUR_COUNT,
            count_max: NEIGHBOUR_COUNT,
            radius_max_m: self.radius_max_m,
            count_narrow: NEIGHBOUR_COUNT,
            walls: Walls::default(),
        };
        let mut gather = Gather::default();
        MAPPED.map(|class| {
            maps.gather(class, &[side], &bounds, &mut gather);
            gather.irradiance()
        })
    }
}

/// An estimate asked anew at every pixel, for pictures.
struct Shown<E>(E);

impl<E> std::fmt::Debug for Shown<E> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Shown")
    }
}

impl<E: Estimate> SecondaryLight for Shown<E> {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn has_caustics(&self) -> bool {
        true
    }

    fn scattered(&self, surface: &Surface, wo: Vec3, _draw: Option<[f32; 3]>) -> ScatteredLight {
        let n_geo = surface.point.n_geo;
        let is_front = wo.dot(n_geo) >= 0.0;
        let on = surface.point.on;
        let place = TriangleSide { instance: on.instance, triangle: on.triangle, is_front };
        let n = if is_front { n_geo } else { -n_geo };
        let [indirect, caustic] = self.0.irradiance(place, surface.point.position, n);
        let f = surface.bsdf.diffuse_of_even_light(surface.frame.to_local(wo));
        ScatteredLight { indirect: f * indirect, caustic: f * caustic, ..ScatteredLight::default() }
    }
}

/// The middle and normal of the front of every triangle.
fn middles(world: &World) -> Vec<(TriangleSide, Vec3, Vec3)> {
    let mut middles = Vec::new();
    for (instance_index, instance) in (0u32..).zip(world.accel().instances()) {
        for (triangle, vertices) in (0u32..).zip(instance.mesh().triangles()) {
            let [a, b, c] = vertices.map(|vertex| instance.vertex_in_render(vertex));
            let n = ((b - a).cross(c - a) * instance.handedness()).normalize_or_zero();
            let place = TriangleSide { instance: instance_index, triangle, is_front: true };
            middles.push((place, (a + b + c) / 3.0, n));
        }
    }
    middles
}

/// Measures the table.
pub(super) fn measure(
    notebook: &mut Notebook,
    subjects: &[Subject],
    effort: Effort,
) -> Result<(), ReportError> {
    let about = format!(
        "50,000 photons, irradiance from the {NEIGHBOUR_COUNT} nearest at the middle of every triangle's front; one thread, \
         medians of {} runs. The first two rows take Σ Φ / (π r²) as the paper does; the third asks the engine's maps, which \
         divide by the exact area of their surface within r, and whose trees are those of the second row. Errors are of \
         pictures with the estimate made anew at every pixel, {} samples each. The paper's scene is another box with bumps, \
         its number of estimates unknown.",
        effort.repeats, effort.map_passes
    );
    let own =
        [SCENE, WAY, TREES, KEPT, BUILD_SECONDS, PAPER_BUILD, ESTIMATES, ESTIMATE_SECONDS, PAPER_ESTIMATE];
    let columns: Vec<Column> = own.iter().chain(&accuracy::COLUMNS).copied().collect();
    notebook.begin(Table::new(
        "table-8.2",
        "Table 8.2: one map or one for each crease surface",
        about,
        &columns,
    ));
    for subject in subjects {
        let prepared = subject.prepare()?;
        accuracy::explain(notebook, subject, &prepared);
        let photons = Photons::about(&prepared.world, effort.photons(PHOTON_COUNT));
        let scene = Scene { subject, prepared: &prepared, photons: &photons, effort };
        let surfaces = photons.product().maps.surfaces();
        let of_trees = |name: &str, surfaces: Option<Arc<Surfaces>>, paper: [f64; 2]| {
            let parts = Trees::shared_out(&photons, surfaces.as_deref());
            let builds =
                (0..effort.repeats).map(|_| Trees::over(parts.clone(), surfaces.clone()).1).collect();
            let (trees, _) = Trees::over(parts, surfaces);
            let way =
                Way { name, trees: trees.count(), build_seconds: median(builds), paper: paper.map(Some) };
            scene.row(way, trees)
        };
        notebook.row(&format!("{} one map", subject.name), || of_trees("one", None, [0.56, 13.80]))?;
        notebook.row(&format!("{} several maps", subject.name), || {
            of_trees("several", Some(surfaces.clone()), [0.08, 5.88])
        })?;
        notebook.row(&format!("{} several maps with exact areas", subject.name), || {
            let maps = &photons.product().maps;
            let trees = MAPPED.into_iter().map(|class| maps.map_count(class)).sum();
            let way = Way { name: "several, exact areas", trees, build_seconds: None, paper: [None; 2] };
            let radius_max_m = 2.0 * prepared.world.accel().radius();
            scene.row(way, Product { product: photons.product().clone(), radius_max_m })
        })?;
    }
    Ok(())
}

/// What the rows of one scene share.
struct Scene<'a> {
    subject: &'a Subject,
    prepared: &'a Prepared,
    photons: &'a Photons,
    effort: Effort,
}

/// One way to keep photons.
struct Way<'a> {
    name: &'a str,
    trees: usize,
    build_seconds: Option<f64>,
    /// Seconds of balancing and of estimating.
    paper: [Option<f64>; 2],
}

impl Scene<'_> {
    /// Times the estimates, draws a picture, and fills the row.
    fn row<E: Estimate + 'static>(
        &self,
        way: Way<'_>,
        estimate: E,
    ) -> Result<super::table::Cells, ReportError> {
        let middles = middles(&self.prepared.world);
        let run = |_| {
            let start = Instant::now();
            for (place, p, n) in &middles {
                std::hint::black_box(estimate.irradiance(*place, *p, *n));
            }
            start.elapsed().as_secs_f64()
        };
        let estimate_seconds = median((0..self.effort.repeats).map(run).collect());
        let mut cells = cells([
            (SCENE, self.subject.name.as_str().into()),
            (WAY, way.name.into()),
            (TREES, (way.trees as f64).into()),
            (KEPT, (self.photons.kept_count as f64).into()),
            (BUILD_SECONDS, way.build_seconds.into()),
            (PAPER_BUILD, way.paper[0].into()),
            (ESTIMATES, (middles.len() as f64).into()),
            (ESTIMATE_SECONDS, estimate_seconds.into()),
            (PAPER_ESTIMATE, way.paper[1].into()),
        ]);
        let light = Arc::new(Shown(estimate));
        accuracy::add(&mut cells, self.subject, self.prepared, light, self.effort.map_passes)?;
        Ok(cells)
    }
}
