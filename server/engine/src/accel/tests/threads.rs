//! Trees depend on nothing but the mesh: not on how many threads build them.

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

/// Every triangle is in one leaf, and in one only.
#[test]
fn leaves_hold_every_triangle_once() {
    for count in [1, 7, 100, PARALLEL_MIN - 1, PARALLEL_MIN, 3 * PARALLEL_MIN] {
        let mut numbers = Numbers(62);
        let scene = scene_of(|grey| soup(&mut numbers, count, 2.0, 0.1, grey));
        let mesh = scene.meshes().values().next().unwrap();
        let bottom = BottomTree::build(mesh);
        let nodes = bottom.tree().nodes().iter();
        let leaves = nodes.flat_map(|node| node.used().map(|slot| node.child(slot)));
        let leaves = leaves.filter(|child| child & LEAF != 0);
        let mut held: Vec<u32> = leaves.flat_map(|leaf| bottom.triangles_of(leaf & !LEAF)).collect();
        held.sort_unstable();
        assert!(held.into_iter().eq(0..mesh.triangles().len() as u32), "{count} triangles");
    }
}
