//! Scenes that need no file.

use lumicast_engine::scene::{Scene, SceneError, samples};

/// A scene by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BuiltinScene {
    /// A Cornell box with a matt and a mirror block and a glass ball.
    CornellBox,
    /// A room of white boxes under a square lamp.
    Boxes,
}

impl BuiltinScene {
    /// Every one.
    pub const ALL: [BuiltinScene; 2] = [BuiltinScene::CornellBox, BuiltinScene::Boxes];

    /// The scene of a name.
    pub fn named(name: &str) -> Option<BuiltinScene> {
        Self::ALL.into_iter().find(|scene| scene.name() == name)
    }

    /// All names, for messages.
    pub fn names() -> String {
        Self::ALL.map(BuiltinScene::name).join(" and ")
    }

    /// As on the command line behind `builtin:`, and in requests.
    pub fn name(self) -> &'static str {
        match self {
            BuiltinScene::CornellBox => "cornell-box",
            BuiltinScene::Boxes => "boxes",
        }
    }

    /// Makes it.
    pub fn load(self) -> Result<Scene, SceneError> {
        match self {
            BuiltinScene::CornellBox => samples::cornell_box(),
            BuiltinScene::Boxes => samples::boxes(),
        }
    }
}
