//! Trees depend on nothing but the mesh: not on how many threads build them.

use obvhs::aabb::Aabb;

use super::*;
use crate::accel::{node::LEAF, tree::PARALLEL_MIN};

/// One thread, two or five build the same nodes and packets, to the last bit, for a mesh small enough for one thread and for
/// one whose subtrees are shared out.
#[test]
fn every_number_of_threads_builds_the_same_tree() {
    for count in [PARALLEL_MIN / 4, PARALLEL_MIN * 5 / 2] {
        let mut numbers = Numbers(61);
        let scene = scene_of(|grey| soup(&mut numbers, count, 2.0, 0.1, grey));
        let mesh = scene.meshes().values().next().unwrap();
        let built_by = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            format!("{:?}", pool.install(|| BottomTree::build(mesh)))
        };
        let expected = built_by(1);
        for threads in [2, 5] {
            // Not assert_eq, which would print megabytes.
            assert!(built_by(threads) == expected, "{count} triangles, {threads} threads");
        }
    }
}

/// Every triangle is in one leaf that can be reached from the root, and in one only; children lie behind their parents
/// and within the bounds that lead to them.
#[test]
fn leaves_hold_every_triangle_once() {
    for count in [1, 7, 100, PARALLEL_MIN - 1, PARALLEL_MIN, 3 * PARALLEL_MIN] {
        let mut numbers = Numbers(62);
        let scene = scene_of(|grey| soup(&mut numbers, count, 2.0, 0.1, grey));
        let mesh = scene.meshes().values().next().unwrap();
        let mut held = triangles_below_the_root(&BottomTree::build(mesh), mesh);
        held.sort_unstable();
        assert!(held.into_iter().eq(0..mesh.triangles().len() as u32), "{count} triangles");
    }
}

fn triangles_below_the_root(bottom: &BottomTree, mesh: &Mesh) -> Vec<u32> {
    let tree = bottom.tree();
    let mut held = Vec::new();
    let mut pending = vec![(0, *tree.bounds())];
    while let Some((index, bounds)) = pending.pop() {
        let node = tree.node(index);
        assert!(is_within(&node.union(), &bounds), "node {index}");
        for slot in node.used() {
            let (child, bounds) = (node.child(slot), node.bounds(slot));
            if child & LEAF == 0 {
                assert!(child > index, "{child} lies before its parent {index}");
                pending.push((child, bounds));
                continue;
            }
            for triangle in bottom.triangles_of(child & !LEAF) {
                let corners = mesh.triangles()[triangle as usize];
                let corners = corners.map(|vertex| mesh.positions()[vertex as usize].into());
                assert!(is_within(&Aabb::from_points(&corners), &bounds), "triangle {triangle}");
                held.push(triangle);
            }
        }
    }
    held
}

fn is_within(inner: &Aabb, outer: &Aabb) -> bool {
    inner.min.cmpge(outer.min).all() && inner.max.cmple(outer.max).all()
}

/// A tree whose subtrees were laid out by several threads answers as a loop over its triangles does.
#[test]
fn trees_that_threads_share_out_are_hit_as_a_loop_hits_them() {
    let mut numbers = Numbers(63);
    let count = PARALLEL_MIN * 5 / 4;
    let accel = Accel::build(&scene_of(|grey| soup(&mut numbers, count, 2.0, 0.1, grey)));
    let hits = assert_as_a_loop(&accel, &random_rays(&mut numbers, 400, 2.0), |_| true);
    assert!(hits > 100, "triangles must be hit to test anything: {hits}");
}
