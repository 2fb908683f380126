//! Where a server is: from what a person types to the URLs that are opened.

use lumicast_protocol::SceneId;

/// What a server listens on if nobody says otherwise.
pub const DEFAULT_ADDRESS: &str = "http://127.0.0.1:7171";
const DEFAULT_PORT: u16 = 7171;
/// Longer texts are no addresses.
const TEXT_BYTES_MAX: usize = 2048;

/// Why a text is no address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    /// Nothing there.
    #[error("type the address of a server, for example {DEFAULT_ADDRESS}")]
    Empty,
    /// Something before `://` that no server of ours speaks.
    #[error("{scheme}:// is not spoken here; use http, https, ws or wss")]
    Scheme {
        /// What was there.
        scheme: String,
    },
    /// No proper host or port.
    #[error("{authority:?} is no host with an optional port, such as example.org:7171")]
    Authority {
        /// What was there.
        authority: String,
    },
    /// The path names a scene that cannot be one.
    #[error("the address names a scene: {0}")]
    Scene(#[from] lumicast_protocol::IdError),
}

/// A server: host, port, and the path it may stand under behind a proxy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServerAddress {
    secure: bool,
    /// `host:port`, with the port left out where the scheme's own is meant.
    authority: String,
    /// Empty or `/some/path`, without a slash at the end.
    path: String,
}

impl ServerAddress {
    /// Reads `HOST[:PORT]`, or an `http`, `https`, `ws` or `wss` URL, also that of a scene (`…/v1/scenes/ID`), which then
    /// comes back too. Without scheme and port: port 7171.
    pub fn parse(text: &str) -> Result<(Self, Option<SceneId>), AddressError> {
        let text = text.trim();
        if text.is_empty() {
            return Err(AddressError::Empty);
        }
        let (scheme, rest) = text.split_once("://").unwrap_or(("", text));
        let secure = match scheme.to_ascii_lowercase().as_str() {
            "" | "http" | "ws" => false,
            "https" | "wss" => true,
            _ => return Err(AddressError::Scheme { scheme: scheme.chars().take(20).collect() }),
        };
        let rest = rest.split(['?', '#']).next().unwrap_or_default();
        let (authority, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
        if text.len() > TEXT_BYTES_MAX || !is_authority(authority) {
            return Err(AddressError::Authority { authority: authority.chars().take(100).collect() });
        }
        let bare_host = scheme.is_empty() && port_of(authority).is_none();
        let authority = if bare_host { format!("{authority}:{DEFAULT_PORT}") } else { authority.to_owned() };
        let (path, scene) = match path.split_once("/v1/scenes") {
            Some((before, scene)) => (before, scene.trim_matches('/')),
            None => (path, ""),
        };
        let scene = scene.strip_suffix("/ws").unwrap_or(scene);
        let scene = if scene.is_empty() { None } else { Some(SceneId::new(scene)?) };
        Ok((Self { secure, authority, path: path.trim_end_matches('/').to_owned() }, scene))
    }

    /// For HTTP requests: `path` begins with a slash.
    pub fn http(&self, path: &str) -> String {
        let scheme = if self.secure { "https" } else { "http" };
        format!("{scheme}://{}{}{path}", self.authority, self.path)
    }

    /// The WebSocket of a scene.
    pub fn socket(&self, scene: &SceneId) -> String {
        let scheme = if self.secure { "wss" } else { "ws" };
        format!("{scheme}://{}{}/v1/scenes/{scene}/ws", self.authority, self.path)
    }

    /// As a person reads it.
    pub fn label(&self) -> String {
        format!("{}{}", self.authority, self.path)
    }
}

fn port_of(authority: &str) -> Option<&str> {
    // In `[::1]` every colon stands inside the brackets.
    let after_host = authority.rsplit_once(']').map_or(authority, |(_, after)| after);
    after_host.rsplit_once(':').map(|(_, port)| port)
}

fn is_authority(authority: &str) -> bool {
    let port = port_of(authority);
    let host = port.map_or(authority, |port| &authority[..authority.len() - port.len() - 1]);
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-._[]:".contains(c);
    !host.is_empty() && authority.chars().all(allowed) && port.is_none_or(|port| port.parse::<u16>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_people_type_becomes_the_urls_they_mean() {
        for (text, http, scene) in [
            ("localhost", "http://localhost:7171/x", None),
            (" 127.0.0.1:8080 ", "http://127.0.0.1:8080/x", None),
            ("http://example.org", "http://example.org/x", None),
            ("https://example.org/light/", "https://example.org/light/x", None),
            ("[::1]", "http://[::1]:7171/x", None),
            ("[::1]:99", "http://[::1]:99/x", None),
            ("http://h:1/v1/scenes/cornell-box", "http://h:1/x", Some("cornell-box")),
            ("ws://h:1/p/v1/scenes/a.b/ws?x=1", "http://h:1/p/x", Some("a.b")),
            ("http://h:1/v1/scenes", "http://h:1/x", None),
        ] {
            let (address, found) = ServerAddress::parse(text).unwrap();
            assert_eq!(address.http("/x"), http, "{text}");
            assert_eq!(found.as_deref(), scene, "{text}");
        }
        let (address, scene) = ServerAddress::parse("wss://h/v1/scenes/a").unwrap();
        assert_eq!(address.socket(&scene.unwrap()), "wss://h/v1/scenes/a/ws");
    }

    #[test]
    fn what_is_no_address_is_refused_with_a_reason() {
        for text in [
            "",
            "  ",
            "ftp://h",
            "http://",
            ":7171",
            "h:port",
            "h:99999",
            "a b",
            "http://h/v1/scenes/..",
            "h@i",
        ] {
            assert!(ServerAddress::parse(text).is_err(), "{text:?}");
        }
    }
}
