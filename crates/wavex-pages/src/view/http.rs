//! HTTP/1.1 on the loopback interface: requests without bodies, each within time limits.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time to wait for the next request of a connection.
const IDLE: Duration = Duration::from_secs(20);
/// Time from the first to the last byte of a request.
const REQUEST: Duration = Duration::from_secs(5);
/// Time from the first to the last byte of an answer.
const ANSWER: Duration = Duration::from_secs(60);
/// Most connections at the same time.
const MAX_CONNECTIONS: usize = 256;
/// Longest request, bytes.
const MAX_REQUEST_BYTES: usize = 16 << 10;
/// Most headers of a request.
const MAX_HEADERS: usize = 64;

/// A request.
#[derive(Debug, Default)]
pub(super) struct Request {
    pub(super) method: String,
    /// Target as sent.
    pub(super) target: String,
    /// Names in lower case, and values.
    pub(super) headers: Vec<(String, String)>,
    /// Whether the connection continues after the answer.
    pub(super) keeps_alive: bool,
}

impl Request {
    /// Values of the headers of a name in lower case.
    pub(super) fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a str> {
        self.headers.iter().filter(move |(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    fn new(parsed: &httparse::Request) -> Request {
        let headers = parsed.headers.iter().map(|header| {
            (header.name.to_ascii_lowercase(), String::from_utf8_lossy(header.value).into_owned())
        });
        let mut request = Request {
            method: parsed.method.unwrap_or_default().to_owned(),
            target: parsed.path.unwrap_or_default().to_owned(),
            headers: headers.collect(),
            keeps_alive: false,
        };
        let has_body =
            request.all("transfer-encoding").chain(request.all("content-length")).any(|value| value != "0");
        let closes = request.all("connection").any(|value| value.to_ascii_lowercase().contains("close"));
        // Bodies are not read, so nothing may follow them.
        request.keeps_alive = parsed.version == Some(1) && request.method == "GET" && !has_body && !closes;
        request
    }
}

/// Status of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Status(pub(super) u16, &'static str);

impl Status {
    pub(super) const OK: Status = Status(200, "OK");
    pub(super) const BAD_REQUEST: Status = Status(400, "Bad Request");
    pub(super) const FORBIDDEN: Status = Status(403, "Forbidden");
    pub(super) const NOT_FOUND: Status = Status(404, "Not Found");
    pub(super) const METHOD_NOT_ALLOWED: Status = Status(405, "Method Not Allowed");
    const TIMEOUT: Status = Status(408, "Request Timeout");
    pub(super) const GONE: Status = Status(410, "Gone");
    const TOO_LARGE: Status = Status(431, "Request Header Fields Too Large");
    pub(super) const INTERNAL: Status = Status(500, "Internal Server Error");
}

/// An answer.
pub(super) struct HttpResponse {
    pub(super) status: Status,
    pub(super) headers: Vec<(&'static str, &'static str)>,
    pub(super) body: Vec<u8>,
}

/// An open connection.
struct Connection {
    stream: TcpStream,
    /// Whether it waits for a request or a part of one.
    waits: AtomicBool,
}

/// Open connections, oldest first.
type OpenConnections = Mutex<VecDeque<Arc<Connection>>>;

/// Serves until the process ends, one thread per connection.
///
/// With the most connections open, a new one replaces the oldest that waits for a request.
pub(super) fn serve(
    listener: TcpListener,
    respond: impl Fn(&Request) -> HttpResponse + Send + Sync + 'static,
) -> io::Result<()> {
    let (open, respond) = (Arc::<OpenConnections>::default(), Arc::new(respond));
    let accept = move || {
        for stream in listener.incoming().flatten() {
            let Some(connection) = admit(&open, stream) else { continue };
            let (all, respond) = (Arc::clone(&open), Arc::clone(&respond));
            let own = Arc::clone(&connection);
            let talk = move || {
                // A client that is gone needs no answer.
                let _gone = converse(&own, &*respond);
                close(&all, &own);
            };
            if std::thread::Builder::new().name("wavex view client".into()).spawn(talk).is_err() {
                close(&open, &connection);
            }
        }
    };
    std::thread::Builder::new().name("wavex view server".into()).spawn(accept).map(drop)
}

/// Adds a connection, if there is room.
fn admit(open: &OpenConnections, stream: TcpStream) -> Option<Arc<Connection>> {
    let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
    if open.len() >= MAX_CONNECTIONS {
        let oldest = open.iter().position(|connection| connection.waits.load(Ordering::Relaxed))?;
        if let Some(oldest) = open.remove(oldest) {
            let _gone = oldest.stream.shutdown(Shutdown::Both);
        }
    }
    let _slower = stream.set_nodelay(true);
    let connection = Arc::new(Connection { stream, waits: AtomicBool::new(true) });
    open.push_back(Arc::clone(&connection));
    Some(connection)
}

fn close(open: &OpenConnections, connection: &Arc<Connection>) {
    let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
    open.retain(|other| !Arc::ptr_eq(other, connection));
    let _gone = connection.stream.shutdown(Shutdown::Both);
}

/// Answers the requests of a connection, in order.
fn converse(connection: &Connection, respond: &dyn Fn(&Request) -> HttpResponse) -> io::Result<()> {
    // Bytes received and not yet used: a client may send requests before it has the answers.
    let mut received = Vec::new();
    loop {
        connection.waits.store(true, Ordering::Relaxed);
        let request = receive(&connection.stream, &mut received)?;
        connection.waits.store(false, Ordering::Relaxed);
        let (response, keeps_alive) = match request {
            None => return Ok(()),
            Some(Ok(request)) => (respond(&request), request.keeps_alive),
            Some(Err(status)) => (HttpResponse { status, headers: Vec::new(), body: Vec::new() }, false),
        };
        send(&connection.stream, &response, keeps_alive)?;
        if !keeps_alive {
            return Ok(());
        }
    }
}

/// Receives the next request, or the status of a wrong one; `None` if the client is gone or idle.
fn receive(mut stream: &TcpStream, received: &mut Vec<u8>) -> io::Result<Option<Result<Request, Status>>> {
    let mut until = Instant::now() + if received.is_empty() { IDLE } else { REQUEST };
    loop {
        if !received.is_empty() {
            let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
            let mut parsed = httparse::Request::new(&mut headers);
            match parsed.parse(received) {
                Ok(httparse::Status::Complete(length)) => {
                    let request = Request::new(&parsed);
                    received.drain(..length);
                    return Ok(Some(Ok(request)));
                }
                Ok(httparse::Status::Partial) if received.len() < MAX_REQUEST_BYTES => {}
                Ok(httparse::Status::Partial) | Err(httparse::Error::TooManyHeaders) => {
                    return Ok(Some(Err(Status::TOO_LARGE)));
                }
                Err(_) => return Ok(Some(Err(Status::BAD_REQUEST))),
            }
        }
        let mut bytes = [0; 4096];
        let length = match remaining(until) {
            Some(left) => {
                stream.set_read_timeout(Some(left))?;
                stream.read(&mut bytes)
            }
            None => Err(ErrorKind::TimedOut.into()),
        };
        match length {
            Ok(0) => return Ok(None),
            Ok(length) => {
                if received.is_empty() {
                    until = Instant::now() + REQUEST;
                }
                received.extend(bytes.iter().take(length));
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => {
                return Ok((!received.is_empty()).then_some(Err(Status::TIMEOUT)));
            }
            Err(error) => return Err(error),
        }
    }
}

fn send(mut stream: &TcpStream, response: &HttpResponse, keeps_alive: bool) -> io::Result<()> {
    let HttpResponse { status: Status(code, reason), headers, body } = response;
    let connection = if keeps_alive { "keep-alive" } else { "close" };
    let mut head =
        format!("HTTP/1.1 {code} {reason}\r\ncontent-length: {}\r\nconnection: {connection}\r\n", body.len());
    headers.iter().for_each(|(name, value)| head += &format!("{name}: {value}\r\n"));
    head += "\r\n";
    let until = Instant::now() + ANSWER;
    for mut bytes in [head.as_bytes(), body.as_slice()] {
        while !bytes.is_empty() {
            stream.set_write_timeout(Some(remaining(until).ok_or(ErrorKind::TimedOut)?))?;
            match stream.write(bytes) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(length) => bytes = bytes.get(length..).unwrap_or_default(),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }
    Ok(())
}

/// Remaining time; `None` from its end on.
fn remaining(until: Instant) -> Option<Duration> {
    until.checked_duration_since(Instant::now()).filter(|left| !left.is_zero())
}
