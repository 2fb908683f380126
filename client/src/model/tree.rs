//! The scene as lines of a tree: sections, nodes by hierarchy, search. And where nodes and lights stand in the world.
//!
//! A scene may have a million nodes: the lines are made once per scene, search and opened branch, and the panel draws
//! those in sight. A server that sends circles gets a tree without them, not an endless loop.

use super::Selected;
use glam::{DMat4, DVec3};
use lumicast_protocol::{Id, LightSource, SceneDescription};
use std::collections::{HashMap, HashSet};

/// Deepest walk from a node to the world: the protocol's limit of hierarchies is 256, servers may be configured higher.
const DEPTH_MAX: usize = 4096;

/// A group of lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[allow(missing_docs, reason = "named as what they hold")]
pub enum Section {
    Cameras,
    Lights,
    Nodes,
    Materials,
    Meshes,
}

impl Section {
    /// Title of the group.
    pub fn title(self) -> &'static str {
        match self {
            Self::Cameras => "Cameras",
            Self::Lights => "Lights",
            Self::Nodes => "Nodes",
            Self::Materials => "Materials",
            Self::Meshes => "Meshes",
        }
    }
}

/// What can be opened and closed.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Branch {
    /// A group.
    Section(Section),
    /// A node with nodes below it.
    Node(Id),
}

/// A line of the tree.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Steps to the right.
    pub depth: usize,
    /// What is written.
    pub label: String,
    /// What a click selects; `None` for a group.
    pub selects: Option<Selected>,
    /// What a click on its arrow opens or closes, and whether it is open.
    pub branch: Option<(Branch, bool)>,
}

/// Which branches are not as they start: groups start open, nodes closed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Folding {
    toggled: HashSet<Branch>,
}

impl Folding {
    /// Opens what is closed and closes what is open.
    pub fn toggle(&mut self, branch: Branch) {
        if !self.toggled.remove(&branch) {
            self.toggled.insert(branch);
        }
    }

    fn is_open(&self, branch: &Branch) -> bool {
        // Few have much to do with meshes: their section starts closed.
        let starts_open = matches!(branch, Branch::Section(section) if *section != Section::Meshes);
        starts_open != self.toggled.contains(branch)
    }
}

/// The lines of a scene. With a search: all groups open, nodes flat, only what contains it (in any case of letters).
pub fn rows(scene: &SceneDescription, folding: &Folding, search: &str) -> Vec<Row> {
    let search = search.trim().to_lowercase();
    let mut lines = Lines { rows: vec![], folding, search: &search };
    let ids = scene.cameras.iter().map(|camera| Selected::Camera(camera.id.clone()));
    lines.flat(Section::Cameras, ids);
    let lights = scene.lights.iter().map(|light| Selected::Light(light.id.clone()));
    lines.flat(Section::Lights, lights.chain([Selected::Environment]));
    if search.is_empty() {
        lines.hierarchy(scene);
    } else {
        lines.flat(Section::Nodes, scene.nodes.iter().map(|node| Selected::Node(node.id.clone())));
    }
    let materials = scene.materials.iter().map(|material| Selected::Material(material.id.clone()));
    lines.flat(Section::Materials, materials);
    lines.flat(Section::Meshes, scene.meshes.iter().map(|mesh| Selected::Mesh(mesh.id.clone())));
    lines.rows
}

/// What is written for a thing.
pub fn label(selected: &Selected) -> &str {
    match selected {
        Selected::Node(id)
        | Selected::Mesh(id)
        | Selected::Material(id)
        | Selected::Light(id)
        | Selected::Camera(id) => id,
        Selected::Environment => "environment",
    }
}

struct Lines<'a> {
    rows: Vec<Row>,
    folding: &'a Folding,
    search: &'a str,
}

impl Lines<'_> {
    fn flat(&mut self, section: Section, things: impl Iterator<Item = Selected>) {
        let found: Vec<Selected> = things
            .filter(|thing| self.search.is_empty() || label(thing).to_lowercase().contains(self.search))
            .collect();
        if self.section(section, found.len()) {
            self.rows.extend(found.into_iter().map(|thing| Row {
                depth: 1,
                label: label(&thing).to_owned(),
                selects: Some(thing),
                branch: None,
            }));
        }
    }

    /// The line of a group; whether what it holds follows.
    fn section(&mut self, section: Section, count: usize) -> bool {
        if count == 0 {
            return false;
        }
        let branch = Branch::Section(section);
        let open = !self.search.is_empty() || self.folding.is_open(&branch);
        let label = format!("{}  {count}", section.title());
        self.rows.push(Row { depth: 0, label, selects: None, branch: Some((branch, open)) });
        open
    }

    fn hierarchy(&mut self, scene: &SceneDescription) {
        if !self.section(Section::Nodes, scene.nodes.len()) {
            return;
        }
        let index_of: HashMap<&Id, usize> =
            scene.nodes.iter().enumerate().map(|(index, node)| (&node.id, index)).collect();
        let mut children: Vec<Vec<usize>> = vec![vec![]; scene.nodes.len()];
        let mut roots = vec![];
        for (index, node) in scene.nodes.iter().enumerate() {
            match node.parent.as_ref().and_then(|parent| index_of.get(parent)) {
                Some(parent) => children[*parent].push(index),
                None => roots.push(index),
            }
        }
        // A stack instead of recursion: hierarchies may be deep. Circles hang under no root and are never met.
        let mut stack: Vec<(usize, usize)> = roots.into_iter().rev().map(|index| (index, 1)).collect();
        while let Some((index, depth)) = stack.pop() {
            let id = &scene.nodes[index].id;
            let below = &children[index];
            let branch = Branch::Node(id.clone());
            let open = self.folding.is_open(&branch);
            self.rows.push(Row {
                depth,
                label: id.to_string(),
                selects: Some(Selected::Node(id.clone())),
                branch: (!below.is_empty()).then_some((branch, open)),
            });
            if open {
                stack.extend(below.iter().rev().map(|child| (*child, depth + 1)));
            }
        }
    }
}

/// `world_from_node`; `None` for an unknown node or a circle.
fn world_from_node(scene: &SceneDescription, id: &Id) -> Option<DMat4> {
    let mut world_from_node = DMat4::IDENTITY;
    let mut above = Some(id);
    for _ in 0..DEPTH_MAX {
        let Some(id) = above else { return Some(world_from_node) };
        let node = scene.nodes.iter().find(|node| node.id == *id)?;
        world_from_node = DMat4::from_cols_array(&node.transform.matrix()) * world_from_node;
        above = node.parent.as_ref();
    }
    None
}

/// Where a node's origin is in the world, metres.
pub fn node_place(scene: &SceneDescription, id: &Id) -> Option<DVec3> {
    world_from_node(scene, id).map(|matrix| matrix.w_axis.truncate()).filter(|place| place.is_finite())
}

/// Where a light is in the world, metres; directional lights are nowhere.
pub fn light_place(scene: &SceneDescription, id: &Id) -> Option<DVec3> {
    let light = scene.lights.iter().find(|light| light.id == *id)?;
    let (LightSource::Point { position, .. } | LightSource::Spot { position, .. }) = light.source else {
        return None;
    };
    let world_from_parent = match &light.parent {
        Some(parent) => world_from_node(scene, parent)?,
        None => DMat4::IDENTITY,
    };
    Some(world_from_parent.transform_point3(DVec3::from(position))).filter(|place| place.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumicast_protocol::{NodeDescription, Transform};

    fn node(id: &str, parent: Option<&str>, x: f64) -> NodeDescription {
        let id_of = |text: &str| Id::new(text).unwrap();
        NodeDescription {
            id: id_of(id),
            parent: parent.map(id_of),
            transform: Transform::from_translation([x, 0.0, 0.0]),
            mesh: None,
        }
    }

    fn scene(nodes: Vec<NodeDescription>) -> SceneDescription {
        SceneDescription { nodes, ..crate::model::tests::scene(1) }
    }

    fn labels(rows: &[Row]) -> Vec<&str> {
        rows.iter().map(|row| row.label.as_str()).collect()
    }

    #[test]
    fn nodes_stand_under_their_parents_once_opened() {
        let scene = scene(vec![
            node("root", None, 1.0),
            node("arm", Some("root"), 2.0),
            node("hand", Some("arm"), 4.0),
        ]);
        let mut folding = Folding::default();
        let closed = rows(&scene, &folding, "");
        assert_eq!(
            labels(&closed),
            ["Cameras  2", "front", "back", "Lights  2", "lamp", "environment", "Nodes  3", "root"]
        );
        folding.toggle(Branch::Node(Id::new("root").unwrap()));
        folding.toggle(Branch::Node(Id::new("arm").unwrap()));
        let open = rows(&scene, &folding, "");
        assert_eq!(labels(&open)[7..], ["root", "arm", "hand"]);
        assert_eq!(open.last().unwrap().depth, 3);
        assert_eq!(node_place(&scene, &Id::new("hand").unwrap()), Some(DVec3::new(7.0, 0.0, 0.0)));
    }

    #[test]
    fn search_finds_what_is_closed_in_any_case() {
        let scene = scene(vec![node("root", None, 0.0), node("Hand", Some("root"), 0.0)]);
        assert_eq!(labels(&rows(&scene, &Folding::default(), " hAnD ")), ["Nodes  1", "Hand"]);
        assert!(rows(&scene, &Folding::default(), "nothing like it").is_empty());
    }

    #[test]
    fn circles_and_orphans_end() {
        let scene =
            scene(vec![node("a", Some("b"), 1.0), node("b", Some("a"), 1.0), node("c", Some("gone"), 1.0)]);
        assert_eq!(labels(&rows(&scene, &Folding::default(), "")).last(), Some(&"c"));
        assert_eq!(node_place(&scene, &Id::new("a").unwrap()), None);
        assert_eq!(node_place(&scene, &Id::new("c").unwrap()), None);
    }

    #[test]
    fn two_hundred_thousand_nodes_become_lines_in_a_moment() {
        let mut nodes = vec![node("root", None, 0.0)];
        nodes.extend((0..200_000).map(|i| node(&format!("n{i}"), Some("root"), 0.0)));
        let scene = scene(nodes);
        let mut folding = Folding::default();
        folding.toggle(Branch::Node(Id::new("root").unwrap()));
        assert_eq!(rows(&scene, &folding, "").len(), 200_000 + 8);
    }
}
