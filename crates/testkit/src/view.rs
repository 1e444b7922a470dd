//! A running `wavex view` and a client that asks it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// Longest time to wait for the server.
const PATIENCE: Duration = Duration::from_secs(60);

/// A running view; ends on drop.
#[derive(Debug)]
pub struct Viewer {
    child: Child,
    /// `127.0.0.1:PORT`.
    pub host: String,
    /// Token of its addresses.
    pub token: String,
}

/// Answer to a request.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// Status, such as 200.
    pub status: u16,
    /// Headers, in lower case.
    pub headers: String,
    /// Content.
    pub body: Vec<u8>,
}

impl Reply {
    /// The content as JSON.
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).expect("an answer in JSON")
    }
}

impl Viewer {
    /// Starts `wavex view` with these arguments in a folder, and waits for its address.
    pub fn start(command: &mut Command) -> Viewer {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("wavex starts");
        let mut address = String::new();
        let output = child.stdout.take().expect("an output");
        BufReader::new(output).read_line(&mut address).expect("an address");
        let rest = address.trim().strip_prefix("http://").unwrap_or_else(|| panic!("an address: {address}"));
        let (host, token) = rest.split_once('/').expect("a token");
        Viewer { child, host: host.to_owned(), token: token.trim_matches('/').to_owned() }
    }

    /// Sends bytes and returns all that comes back.
    pub fn raw(&self, bytes: &[u8]) -> Vec<u8> {
        let mut stream = TcpStream::connect(&self.host).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a time limit");
        let _ = stream.write_all(bytes);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    /// Asks with these header lines, each with its line end.
    pub fn ask_with(&self, path: &str, headers: &str) -> Reply {
        let answer =
            self.raw(format!("GET {path} HTTP/1.1\r\n{headers}connection: close\r\n\r\n").as_bytes());
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n").expect("headers");
        let headers = String::from_utf8_lossy(&answer[..end]).to_lowercase();
        let status = headers.split(' ').nth(1).and_then(|word| word.parse().ok()).expect("a status");
        let mut body = answer[end + 4..].to_vec();
        if headers.contains("transfer-encoding: chunked") {
            body = unchunked(&body);
        }
        Reply { status, headers, body }
    }

    /// Asks for an address below the token, as the page does.
    pub fn ask(&self, path: &str) -> Reply {
        self.ask_with(&format!("/{}/{path}", self.token), &format!("host: {}\r\n", self.host))
    }

    /// Asks for JSON, which must be there.
    pub fn json(&self, path: &str) -> Value {
        let reply = self.ask(path);
        assert_eq!(reply.status, 200, "{path}: {}", String::from_utf8_lossy(&reply.body));
        reply.json()
    }

    /// Waits until everything has been read; returns `info`.
    pub fn ready(&self) -> Value {
        let begin = Instant::now();
        loop {
            let info = self.json("info");
            if info["state"] != "reading" {
                return info;
            }
            assert!(begin.elapsed() < PATIENCE, "still reading: {info}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Sends the signal of Ctrl-C.
    pub fn interrupt(&self) {
        let id = self.child.id().to_string();
        let sent = Command::new("kill").args(["-INT", &id]).status().expect("kill runs");
        assert!(sent.success());
    }

    /// Whether the server runs.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Joins the chunks of a body.
fn unchunked(mut rest: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    while let Some(end) = rest.windows(2).position(|two| two == b"\r\n") {
        let size = usize::from_str_radix(&String::from_utf8_lossy(&rest[..end]), 16).expect("a size");
        let start = end + 2;
        if size == 0 {
            break;
        }
        body.extend(&rest[start..start + size]);
        rest = &rest[start + size + 2..];
    }
    body
}

/// Numbers of a binary answer.
pub fn numbers(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|four| f32::from_le_bytes(four.try_into().expect("four bytes"))).collect()
}
