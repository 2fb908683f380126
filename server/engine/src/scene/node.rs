//! Nodes: the hierarchy that places meshes, lights and cameras.

use glam::DAffine3;

use super::Id;

/// One placed thing of the hierarchy.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// The node that this one hangs on; the world for `None`.
    pub parent: Option<Id>,
    /// From this node's space to its parent's; finite and invertible.
    pub parent_from_node: DAffine3,
    /// The mesh shown here.
    pub mesh: Option<Id>,
}
