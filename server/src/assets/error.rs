//! Why a file could not become a scene, or a scene a file.

use lumicast_engine::scene::SceneError;

/// A refused file: names the file, the object in it and the field, and says what to do.
#[derive(Debug, thiserror::Error)]
pub enum AssetError {
    /// The file system said no.
    #[error("{file}: cannot be read: {source}")]
    Read {
        /// The file.
        file: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Neither glTF nor OBJ.
    #[error("{file}: not a scene file: expected glTF 2.0 (.glb, .gltf) or Wavefront (.obj)")]
    UnknownKind {
        /// The file.
        file: String,
    },
    /// Something in the file that cannot be read or makes no sense.
    #[error("{file}: {object}: {field}: {problem}")]
    Bad {
        /// The file.
        file: String,
        /// The object in the file, such as `accessor 3`.
        object: String,
        /// The field at fault.
        field: &'static str,
        /// What is wrong, and what to do where that is not plain.
        problem: String,
    },
    /// A limit of [`super::AssetLimits`].
    #[error(
        "{file}: {object}: {value} {what}, the limit is {limit}; `lumicast serve --set {setting}=…` raises it, if the file can be trusted"
    )]
    OverLimit {
        /// The file.
        file: String,
        /// The object that breaks the limit.
        object: String,
        /// What is counted.
        what: &'static str,
        /// How many there are.
        value: u64,
        /// The limit.
        limit: u64,
        /// The limit's name in the config.
        setting: &'static str,
    },
    /// `extensionsRequired` names something that is not read here.
    #[error("{file}: extensionsRequired: the file needs {name}, which is not read here: export it without")]
    RequiredExtension {
        /// The file.
        file: String,
        /// The extension.
        name: String,
    },
    /// An address that leaves the scene's folder or names nothing in it.
    #[error("{file}: {object}: uri {uri:?} {problem}")]
    Uri {
        /// The file.
        file: String,
        /// Who refers to it.
        object: String,
        /// The address, cut to 200 characters.
        uri: String,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// A file that the scene refers to and that is not there or cannot be read.
    #[error("{file}: {object}: uri {uri:?} cannot be read: {source}")]
    Missing {
        /// The file.
        file: String,
        /// Who refers to it.
        object: String,
        /// The address, cut to 200 characters.
        uri: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The scene builder refused a value.
    #[error("{file}: {source}")]
    Scene {
        /// The file.
        file: String,
        /// Object, field and value.
        source: SceneError,
    },
}

impl AssetError {
    /// The field at fault, when one is.
    pub fn field(&self) -> Option<&'static str> {
        match self {
            AssetError::Bad { field, .. } => Some(field),
            AssetError::OverLimit { what, .. } => Some(what),
            AssetError::RequiredExtension { .. } => Some("extensionsRequired"),
            AssetError::Uri { .. } | AssetError::Missing { .. } => Some("uri"),
            AssetError::Scene { source, .. } => source.field(),
            AssetError::Read { .. } | AssetError::UnknownKind { .. } => None,
        }
    }

    /// The error with its file named; one that names its own already stays as it is.
    pub(in crate::assets) fn in_file(mut self, name: &str) -> AssetError {
        match &mut self {
            AssetError::Read { file, .. }
            | AssetError::UnknownKind { file }
            | AssetError::Bad { file, .. }
            | AssetError::OverLimit { file, .. }
            | AssetError::RequiredExtension { file, .. }
            | AssetError::Uri { file, .. }
            | AssetError::Missing { file, .. }
            | AssetError::Scene { file, .. } => {
                if file.is_empty() {
                    *file = name.into();
                }
            }
        }
        self
    }
}

/// The file is named at the edge by `in_file`.
impl From<SceneError> for AssetError {
    fn from(source: SceneError) -> AssetError {
        AssetError::Scene { file: String::new(), source }
    }
}

/// An [`AssetError::Bad`] whose file is named at the edge.
pub(in crate::assets) fn bad(
    object: impl Into<String>,
    field: &'static str,
    problem: impl Into<String>,
) -> AssetError {
    AssetError::Bad { file: String::new(), object: object.into(), field, problem: problem.into() }
}

/// A bound with the name under which the config holds it.
#[derive(Clone, Copy, Debug)]
pub(in crate::assets) struct Bound {
    pub(in crate::assets) what: &'static str,
    pub(in crate::assets) limit: u64,
    pub(in crate::assets) setting: &'static str,
}

impl Bound {
    /// Refuses `value` above the bound.
    pub(in crate::assets) fn check(self, object: impl Into<String>, value: u64) -> Result<(), AssetError> {
        let Bound { what, limit, setting } = self;
        if value <= limit {
            return Ok(());
        }
        Err(AssetError::OverLimit { file: String::new(), object: object.into(), what, value, limit, setting })
    }
}
