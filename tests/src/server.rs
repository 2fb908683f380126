//! The real `lumicast serve` in a process of its own.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use crate::http::{self, Request, Response};
use crate::{PATIENCE, program};

/// A running server; killed when dropped. What it wrote to standard error is shown when a test fails.
#[derive(Debug)]
pub struct Server {
    child: Child,
    address: SocketAddr,
    started_in: Duration,
    stderr: Arc<Mutex<String>>,
}

impl Server {
    /// Starts `lumicast serve --listen 127.0.0.1:0 ARGS` and waits until it says that it is ready.
    ///
    /// # Panics
    /// When it ends or says nothing.
    pub fn start<S: AsRef<OsStr>>(args: &[S]) -> Server {
        Server::start_with(args, &[])
    }

    /// The same with more variables in its environment.
    ///
    /// # Panics
    /// When it ends or says nothing.
    pub fn start_with<S: AsRef<OsStr>>(args: &[S], environment: &[(&str, &str)]) -> Server {
        let started = Instant::now();
        let mut child = Command::new(program("lumicast"))
            .args(["serve", "--listen", "127.0.0.1:0"])
            .args(args)
            .envs(environment.iter().copied())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("lumicast starts");
        let stderr = Arc::new(Mutex::new(String::new()));
        let (lines, line) = mpsc::channel();
        let out = child.stdout.take().expect("standard output is piped");
        let errors = child.stderr.take().expect("standard error is piped");
        // Both are read to their end, so that the server never waits for us.
        thread::spawn(move || {
            for text in BufReader::new(out).lines().map_while(Result::ok) {
                let _ = lines.send(text);
            }
        });
        thread::spawn({
            let stderr = stderr.clone();
            move || keep(errors, &stderr)
        });
        let mut server = Server {
            child,
            address: SocketAddr::from(([127, 0, 0, 1], 0)),
            started_in: Duration::ZERO,
            stderr,
        };
        let deadline = started + PATIENCE;
        loop {
            let Ok(text) = line.recv_timeout(deadline.saturating_duration_since(Instant::now())) else {
                panic!("the server did not become ready: {}", server.stderr());
            };
            if let Some(address) = address_of(&text) {
                server.address = address;
                server.started_in = started.elapsed();
                return server;
            }
        }
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Its address as people write it.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// From starting the process to its saying that it is ready.
    pub fn started_in(&self) -> Duration {
        self.started_in
    }

    /// What it has written to standard error so far.
    pub fn stderr(&self) -> String {
        self.stderr.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Memory that it holds in RAM, from `/proc`; `None` where there is no such thing.
    pub fn resident_bytes(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
        Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
    }

    /// `GET path`.
    ///
    /// # Panics
    /// When no answer comes; so do the other requests.
    pub fn get(&self, path: &str) -> Response {
        self.send(&Request { method: "GET", path, headers: &[], body: &[] })
    }

    /// `POST path` with JSON and headers.
    pub fn post(&self, path: &str, headers: &[(&str, &str)], body: &str) -> Response {
        let headers = [&[("content-type", "application/json")], headers].concat();
        self.send(&Request { method: "POST", path, headers: &headers, body: body.as_bytes() })
    }

    fn send(&self, request: &Request<'_>) -> Response {
        http::send(self.address, request)
            .unwrap_or_else(|error| panic!("{} {}: {error}", request.method, request.path))
    }

    /// Whether it still runs.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if thread::panicking() {
            eprintln!("--- standard error of the server ---\n{}", self.stderr());
        }
    }
}

/// The address in `Lumicast 0.1.0 at http://127.0.0.1:40123/`.
fn address_of(line: &str) -> Option<SocketAddr> {
    line.strip_prefix("Lumicast ")?.split_once(" at http://")?.1.trim_end_matches('/').parse().ok()
}

fn keep(mut from: impl Read, into: &Mutex<String>) {
    let mut bytes = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        into.lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push_str(&String::from_utf8_lossy(&bytes[..count]));
    }
}
