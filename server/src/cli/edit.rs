//! `lumicast edit`: sends a batch to a server and says what it made.

use super::output::print_line;
use clap::Args;
use http_body_util::{BodyExt, Full};
use hyper::body::Bytes;
use hyper::{Method, Request, StatusCode, Uri, header};
use hyper_util::rt::TokioIo;
use lumicast_protocol::{EditReply, Problem};
use std::error::Error;
use std::io::Read;
use tokio::net::TcpStream;

/// Arguments of `lumicast edit`.
#[derive(Debug, Args)]
pub(super) struct EditArgs {
    /// URL of a scene, such as http://127.0.0.1:7171/v1/scenes/cornell-box.
    url: String,
    /// File with the batch as JSON; `-`: standard input.
    file: String,
    /// Only if the scene is at this revision.
    #[arg(long, value_name = "REVISION")]
    if_match: Option<u64>,
    /// Under the same key a repetition makes no second revision.
    #[arg(long, value_name = "KEY")]
    idempotency_key: Option<String>,
    /// Prints JSON: the server's answer, or the problem.
    #[arg(long)]
    json: bool,
}

impl EditArgs {
    /// Sends and prints.
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let uri = edits_uri(&self.url)?;
        let batch = match self.file.as_str() {
            "-" => {
                let mut batch = Vec::new();
                std::io::stdin().read_to_end(&mut batch)?;
                batch
            }
            file => std::fs::read(file).map_err(|error| format!("{file}: {error}"))?,
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (status, body) = runtime.block_on(self.post(&uri, batch))?;
        let text = String::from_utf8_lossy(&body);
        if status != StatusCode::OK {
            if self.json {
                print_line(&text)?;
            }
            return Err(told(status, &body).into());
        }
        let reply: EditReply = serde_json::from_slice(&body)
            .map_err(|error| format!("the answer of {uri} is no edit reply ({error}): {text:.200}"))?;
        match self.json {
            true => Ok(print_line(&text)?),
            false => Ok(print_line(&format!("revision {}", reply.revision))?),
        }
    }

    async fn post(&self, uri: &Uri, batch: Vec<u8>) -> Result<(StatusCode, Bytes), Box<dyn Error>> {
        let host = uri.host().unwrap_or_default();
        let port = uri.port_u16().unwrap_or(80);
        let bare = host.trim_matches(['[', ']']);
        let stream = TcpStream::connect((bare, port))
            .await
            .map_err(|error| format!("cannot connect to {host}:{port}: {error}"))?;
        let (mut sender, connection) = hyper::client::conn::http1::handshake(TokioIo::new(stream)).await?;
        // Ends with the runtime; what goes wrong on it shows at the request.
        tokio::spawn(connection);
        let mut request = Request::builder()
            .method(Method::POST)
            .uri(uri.path())
            .header(header::HOST, uri.authority().map_or(host, |authority| authority.as_str()))
            .header(header::CONTENT_TYPE, "application/json");
        if let Some(revision) = self.if_match {
            request = request.header(header::IF_MATCH, format!("\"{revision}\""));
        }
        if let Some(key) = &self.idempotency_key {
            request = request.header("idempotency-key", key);
        }
        let response = sender.send_request(request.body(Full::new(Bytes::from(batch)))?).await?;
        let status = response.status();
        Ok((status, response.into_body().collect().await?.to_bytes()))
    }
}

/// The URL to post to: a scene's own URL gets `/edits`.
fn edits_uri(url: &str) -> Result<Uri, String> {
    let trimmed = url.trim_end_matches('/');
    let whole = if trimmed.ends_with("/edits") { trimmed.into() } else { format!("{trimmed}/edits") };
    let uri: Uri = whole.parse().map_err(|error| format!("{url:?} is no URL: {error}"))?;
    match uri.scheme_str() {
        Some("http") if uri.path().starts_with("/v1/scenes/") => Ok(uri),
        Some("http") => Err(format!("{url:?} names no scene: http://HOST:PORT/v1/scenes/ID is expected")),
        Some("https") => {
            Err("https is the proxy's: send to the server behind it over http, or use curl".into())
        }
        _ => Err(format!("{url:?} does not begin with http://")),
    }
}

/// A refusal in one line.
fn told(status: StatusCode, body: &[u8]) -> String {
    match serde_json::from_slice::<Problem>(body) {
        Ok(problem) => format!("{} ({}): {}", problem.title, problem.status, problem.detail),
        Err(_) => format!("the server answered {status}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_url_of_a_scene_or_of_its_edits_will_do() {
        let expected = "http://127.0.0.1:7171/v1/scenes/box/edits";
        for url in ["http://127.0.0.1:7171/v1/scenes/box", "http://127.0.0.1:7171/v1/scenes/box/", expected] {
            assert_eq!(edits_uri(url).unwrap(), expected);
        }
        for bad in ["127.0.0.1:7171", "https://a/v1/scenes/b", "http://a/", "ftp://a/v1/scenes/b"] {
            assert!(edits_uri(bad).is_err(), "{bad}");
        }
    }
}
