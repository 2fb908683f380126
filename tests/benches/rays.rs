//! How fast rays find surfaces: our trees beside obvhs's own traversal and Embree, on the same triangles and rays.
//!
//! `cargo bench -p lumicast-tests --bench rays [-- NAME …]`; the names are `sponza`, `dragon`, `boulder` and
//! `updates`, all of them without arguments. `batches` asks instead whether sorting incoherent rays pays, on the subjects
//! named beside it or on all. Prints Markdown. Everyone takes turns and the best of five counts: the
//! machine may be shared. Embree needs `apt-get install libembree-dev g++`; without it its columns stay empty.

#[path = "rays/answer.rs"]
mod answer;
#[path = "rays/batches.rs"]
mod batches;
#[path = "rays/embree.rs"]
mod embree;
#[path = "rays/obvhs_tree.rs"]
mod obvhs_tree;
#[path = "rays/ours.rs"]
mod ours;
#[path = "rays/ray_set.rs"]
mod ray_set;
#[path = "rays/subject.rs"]
mod subject;
#[path = "rays/table.rs"]
mod table;
#[path = "rays/updates.rs"]
mod updates;

use answer::{Answer, Pools, Timed, arithmetic};
use embree::{Embree, Width};
use obvhs_tree::ObvhsTree;
use ours::{Tree, VARIANTS, Variant};
use ray_set::Kind;
use subject::Subject;
use table::{Cell, Row, Table};

/// Rounds of queries; the best counts.
const ROUNDS: usize = 5;
/// Rounds of building, which takes longer and varies less.
const BUILD_ROUNDS: usize = 3;
/// What two implementations may differ by: an edge hit by the one and missed by the other, and rounding.
const AGREEMENT: f64 = 1e-4;

fn main() {
    let (modes, named): (Vec<String>, Vec<String>) = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with("--"))
        .partition(|argument| argument == "batches");
    let is_wanted = |name: &str| named.is_empty() || named.iter().any(|wanted| wanted == name);
    let subjects = subject::NAMES.into_iter().filter(|name| is_wanted(name)).filter_map(Subject::named);
    let pools = Pools::new();
    if !modes.is_empty() {
        subjects.for_each(|subject| batches::measure(&subject, &pools));
        return;
    }
    println!(
        "Rays in million a second, builds in milliseconds, {} rays a kind. T = threads, Embree-1 = single rays, \
         Embree-8 = packets of eight. Ratios are ours to Embree with 1T / 2T; above 1 ours is better. Embree runs in its default mode, \
         which is not watertight; rows of the two-level tree stand beside its tree over one flat mesh.",
        ray_set::RAY_COUNT
    );
    subjects.for_each(|subject| measure(&subject, &pools));
    if is_wanted("updates") {
        updates::measure(&pools);
    }
}

fn measure(subject: &Subject, pools: &Pools) {
    let flat = Tree::new("", &subject.flat, subject.view);
    let instanced = subject.instanced.as_ref().map(|scene| Tree::new("two-level", scene, subject.view));
    let trees: Vec<&Tree> = [Some(&flat), instanced.as_ref()].into_iter().flatten().collect();
    let mesh = flat.mesh_in_render();
    let mut embree = Embree::start(&mesh, &flat.rays);

    println!("\n### {}: {} triangles\n", subject.name, mesh.triangles.len());
    let (builds, obvhs) = Builds::measure(&trees, &mesh, embree.as_mut(), pools);
    let mut table = Table::default();
    let mut complaints = Vec::new();
    let mut calibration = [Timed::NEVER; 2];
    for kind in Kind::ALL {
        let queries = Queries::measure(kind, &trees, &obvhs, embree.as_mut(), pools);
        queries.add_to(&mut table);
        complaints.extend(queries.disagreements());
        calibration.iter_mut().zip(queries.arithmetic).for_each(|(best, timed)| best.or_better(timed));
    }
    builds.add_to(&mut table, &trees, &obvhs, mesh.triangles.len());
    let embree_tree = embree.as_mut().and_then(Embree::describe);
    table.push(Row {
        label: "SAH cost".into(),
        embree_1: [Cell::number(embree_tree.as_ref().map(|tree| tree.sah_cost), 2), Cell::Empty],
        ..Row::default()
    });
    table.print();
    if let Some(tree) = embree_tree {
        println!(
            "\nEmbree built {}; its SAH cost counts 1 a node and 1 a block of triangles, over the root's area.",
            tree.kind
        );
    }
    // Where others use the machine, or its two cores are two threads of one, this says how far ×threads can go.
    println!(
        "\nPure arithmetic ran {:.2} times as fast with two threads as with one in the same rounds.",
        calibration[0].seconds / calibration[1].seconds
    );
    match complaints.as_slice() {
        [] => println!("\nAll agree on hits and mean distances."),
        complaints => complaints.iter().for_each(|complaint| println!("\nWARNING {complaint}")),
    }
}

/// What building took.
struct Builds {
    /// Seconds with one and with two threads, of every tree of ours.
    ours: Vec<[f64; 2]>,
    obvhs: f64,
    embree: Option<[f64; 2]>,
    embree_bytes: Option<f64>,
}

impl Builds {
    fn measure(
        trees: &[&Tree],
        mesh: &ours::RenderMesh,
        mut embree: Option<&mut Embree>,
        pools: &Pools,
    ) -> (Builds, ObvhsTree) {
        let mut obvhs = ObvhsTree::build(mesh, &pools.of[0]);
        let mut builds = Builds {
            ours: vec![[f64::INFINITY; 2]; trees.len()],
            obvhs: obvhs.build_seconds,
            embree: embree.is_some().then_some([f64::INFINITY; 2]),
            embree_bytes: None,
        };
        for _ in 0..BUILD_ROUNDS {
            for (tree, best) in trees.iter().zip(&mut builds.ours) {
                for (pool, best) in pools.of.iter().zip(best) {
                    *best = best.min(pool.install(|| tree.build_seconds()));
                }
            }
            obvhs = ObvhsTree::build(mesh, &pools.of[0]);
            builds.obvhs = builds.obvhs.min(obvhs.build_seconds);
            if let (Some(embree), Some(best)) = (embree.as_deref_mut(), &mut builds.embree) {
                for (threads, best) in (1..).zip(best) {
                    let built = embree.build(threads);
                    *best = best.min(built.seconds);
                    builds.embree_bytes = Some(built.bytes);
                }
            }
        }
        (builds, obvhs)
    }

    fn add_to(&self, table: &mut Table, trees: &[&Tree], obvhs: &ObvhsTree, triangle_count: usize) {
        let milliseconds = |seconds: f64| Cell::Number(1e3 * seconds, 1);
        let per_triangle = |bytes: f64| bytes / triangle_count as f64;
        for (tree, ours) in trees.iter().zip(&self.ours) {
            let is_first = tree.name.is_empty();
            table.push(Row {
                label: table::label("build, ms", tree.name, ""),
                ours: ours.map(milliseconds),
                scaling: Cell::ratio(ours[0] / ours[1]),
                obvhs: if is_first { milliseconds(self.obvhs) } else { Cell::Empty },
                embree_1: match self.embree {
                    Some(embree) if is_first => embree.map(milliseconds),
                    _ => Default::default(),
                },
                to_embree_1: match self.embree {
                    Some(embree) => [0, 1].map(|i| Cell::ratio(embree[i] / ours[i])),
                    None => Default::default(),
                },
                ..Row::default()
            });
        }
        for tree in trees {
            let is_first = tree.name.is_empty();
            let ours = per_triangle(tree.bytes() as f64);
            let embree = self.embree_bytes.map(per_triangle);
            table.push(Row {
                label: table::label("bytes a triangle", tree.name, ""),
                ours: [Cell::Number(ours, 1), Cell::Empty],
                obvhs: if is_first { Cell::Number(per_triangle(obvhs.bytes()), 1) } else { Cell::Empty },
                embree_1: [Cell::number(embree.filter(|_| is_first), 1), Cell::Empty],
                to_embree_1: [embree.map_or(Cell::Empty, |embree| Cell::ratio(embree / ours)), Cell::Empty],
                ..Row::default()
            });
        }
    }
}

/// What one kind of ray took, the best of all rounds.
struct Queries<'a> {
    kind: Kind,
    /// With one and with two threads, of every tree of ours and every way to ask it.
    ours: Vec<(&'a Tree<'a>, &'static Variant, [Timed; 2])>,
    obvhs: Timed,
    /// By width, then with one and with two threads.
    embree: Option<[[Timed; 2]; 2]>,
    /// With one and with two threads.
    arithmetic: [Timed; 2],
}

impl<'a> Queries<'a> {
    fn measure(
        kind: Kind,
        trees: &[&'a Tree<'a>],
        obvhs: &ObvhsTree,
        mut embree: Option<&mut Embree>,
        pools: &Pools,
    ) -> Queries<'a> {
        let asked = |tree: &&'a Tree<'a>| {
            let tree = *tree;
            let variants = VARIANTS.iter().filter(move |variant| variant.kinds.contains(&kind));
            variants.map(move |variant| (tree, variant, [Timed::NEVER; 2]))
        };
        let mut queries = Queries {
            kind,
            ours: trees.iter().flat_map(asked).collect(),
            obvhs: Timed::NEVER,
            embree: embree.is_some().then_some([[Timed::NEVER; 2]; 2]),
            arithmetic: [Timed::NEVER; 2],
        };
        // The rays of the flat tree, whose triangles the others hold.
        let rays = trees[0].rays.of(kind);
        for _ in 0..ROUNDS {
            for (tree, variant, best) in &mut queries.ours {
                for (pool, best) in pools.of.iter().zip(best) {
                    let answer = |rays: &[_]| (variant.answer)(&tree.accel, kind, rays);
                    best.or_better(Timed::of(pool, tree.rays.of(kind), answer));
                }
            }
            for (pool, best) in pools.of.iter().zip(&mut queries.arithmetic) {
                best.or_better(Timed::of(pool, rays, arithmetic));
            }
            queries.obvhs.or_better(Timed::of(&pools.of[0], rays, |rays| obvhs.answer(kind, rays)));
            if let (Some(embree), Some(best)) = (embree.as_deref_mut(), &mut queries.embree) {
                for (width, best) in Width::ALL.into_iter().zip(best) {
                    for (threads, best) in (1..).zip(best) {
                        best.or_better(embree.query(kind, width, threads));
                    }
                }
            }
        }
        queries
    }

    fn add_to(&self, table: &mut Table) {
        let rate = |timed: Timed| Cell::Number(timed.rays_per_second() / 1e6, 2);
        for (place, (tree, variant, ours)) in self.ours.iter().enumerate() {
            let to_embree = |width: usize| match &self.embree {
                Some(embree) => [0, 1].map(|i| Cell::ratio(embree[width][i].seconds / ours[i].seconds)),
                None => Default::default(),
            };
            // The others' figures stand once, beside our first way to ask.
            let others = self.embree.filter(|_| place == 0);
            let [embree_1, embree_8] =
                others.map_or_else(Default::default, |embree| embree.map(|e| e.map(rate)));
            table.push(Row {
                label: table::label(self.kind.name(), tree.name, variant.name),
                ours: ours.map(rate),
                scaling: Cell::ratio(ours[0].seconds / ours[1].seconds),
                obvhs: if place == 0 { rate(self.obvhs) } else { Cell::Empty },
                embree_1,
                embree_8,
                to_embree_1: to_embree(0),
                to_embree_8: to_embree(1),
            });
        }
    }

    /// One sentence for everyone whose hits are not those of our first tree.
    fn disagreements(&self) -> Vec<String> {
        let Some((_, _, [reference, _])) = self.ours.first() else { return Vec::new() };
        let mut others = vec![("obvhs".to_string(), self.obvhs.answer)];
        for (tree, variant, timed) in &self.ours {
            let who = table::label("ours", tree.name, variant.name);
            others.extend(timed.iter().map(|timed| (who.clone(), timed.answer)));
        }
        for (width, timed) in Width::ALL.iter().zip(self.embree.iter().flatten()) {
            others.extend(timed.iter().map(|timed| (width.name().to_string(), timed.answer)));
        }
        let kind = self.kind.name();
        let same = |answer: &Answer| answer.agrees_with(&reference.answer, ray_set::RAY_COUNT, AGREEMENT);
        let sentence = |who: &str, answer: &Answer| {
            format!("{kind}: {who} finds {answer}, our first tree {}", reference.answer)
        };
        let mut found: Vec<String> = others
            .iter()
            .filter(|(_, answer)| !same(answer))
            .map(|(who, answer)| sentence(who, answer))
            .collect();
        // One thread or two: mostly the same sentence.
        found.dedup();
        found
    }
}
