//! The server of the page: loopback only, with a random token in every address.

use std::net::{Ipv4Addr, TcpListener};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use serde_json::{Value, json};

use super::attributes::{Attribute, Condition};
use super::cloud::{self, ProfileLine, Refused, Search};
use super::compare;
use super::http::{self, HttpResponse, Request, Status};
use super::job_text;
use super::page;
use super::query::Query;
use super::session::Session;
use super::shots;

/// Bytes of the token.
const TOKEN_BYTES: usize = 16;

/// Headers of every answer: nothing is stored, framed, sniffed or sent elsewhere.
const HEADERS: [(&str, &str); 6] = [
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; \
         connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("cache-control", "no-store"),
    ("cross-origin-resource-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
    ("referrer-policy", "no-referrer"),
    ("x-content-type-options", "nosniff"),
];

/// A running server.
pub(super) struct RunningServer {
    /// Address of the page.
    pub(super) address: String,
}

/// Starts the server; `port` 0 chooses a free one.
///
/// # Errors
/// If the port is in use, or the system has no random numbers.
pub(super) fn start(session: &Arc<Session>, port: u16) -> Result<RunningServer, String> {
    let refused =
        |error: std::io::Error| format!("cannot listen on port {port}: {error}; choose another --port");
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(refused)?;
    let port = listener.local_addr().map_err(refused)?.port();
    let token = token()?;
    let gate = RequestGate { token: token.clone(), port };
    let session = Arc::clone(session);
    http::serve(listener, move |request| answer(&gate, &session, request)).map_err(refused)?;
    Ok(RunningServer { address: format!("http://127.0.0.1:{port}/{token}/") })
}

/// Random text that nobody can guess.
fn token() -> Result<String, String> {
    let mut bytes = [0; TOKEN_BYTES];
    getrandom::fill(&mut bytes).map_err(|error| format!("the system has no random numbers: {error}"))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Token and port that a request must have.
struct RequestGate {
    token: String,
    port: u16,
}

impl RequestGate {
    /// Target below the token, with its query; `None` if the request is not of this page.
    ///
    /// `Host` and `Origin` must be the page's: a foreign page that the browser shows, also under a name
    /// that resolves to this computer, has others.
    fn path<'r>(&self, request: &'r Request) -> Option<&'r str> {
        let target = request.target.as_str();
        // A target may be a complete address; its host then counts in addition to the header.
        let (authority, path) = match target.strip_prefix("http://") {
            Some(address) => {
                let (authority, path) = address.split_once('/')?;
                (Some(authority), path)
            }
            None => (None, target.strip_prefix('/')?),
        };
        let mut hosts = request.all("host");
        let is_own_host = hosts.next().is_some_and(|host| self.is_own(host))
            && hosts.next().is_none()
            && authority.is_none_or(|host| self.is_own(host));
        let mut origins = request.all("origin");
        let is_own_origin = origins
            .next()
            .is_none_or(|origin| origin.strip_prefix("http://").is_some_and(|host| self.is_own(host)))
            && origins.next().is_none();
        let is_own_site = request.all("sec-fetch-site").all(|from| matches!(from, "same-origin" | "none"));
        let (token, path) = path.split_once('/')?;
        (is_own_host && is_own_origin && is_own_site && is_equal(token, &self.token)).then_some(path)
    }

    /// Whether a host, with its port unless this is 80, is the page's host.
    fn is_own(&self, host: &str) -> bool {
        let (name, port) = host.split_once(':').unwrap_or((host, "80"));
        let is_name = ["127.0.0.1", "localhost"].iter().any(|own| own.eq_ignore_ascii_case(name));
        is_name && port == self.port.to_string()
    }
}

/// Compares in a time that does not depend on the first difference.
fn is_equal(a: &str, b: &str) -> bool {
    a.len() == b.len() && a.bytes().zip(b.bytes()).fold(0, |differences, (a, b)| differences | (a ^ b)) == 0
}

/// Content of an answer.
struct AnswerContent {
    status: Status,
    kind: &'static str,
    body: Vec<u8>,
}

impl AnswerContent {
    fn ok(kind: &'static str, body: impl Into<Vec<u8>>) -> AnswerContent {
        AnswerContent { status: Status::OK, kind, body: body.into() }
    }

    fn json(value: &Value) -> AnswerContent {
        AnswerContent::ok("application/json", value.to_string())
    }

    fn binary(body: Vec<u8>) -> AnswerContent {
        AnswerContent::ok("application/octet-stream", body)
    }

    fn error(status: Status, problem: &str) -> AnswerContent {
        AnswerContent { status, ..AnswerContent::json(&json!({ "error": problem })) }
    }
}

impl From<String> for AnswerContent {
    fn from(problem: String) -> AnswerContent {
        AnswerContent::error(Status::BAD_REQUEST, &problem)
    }
}

impl From<Refused> for AnswerContent {
    fn from(refused: Refused) -> AnswerContent {
        match refused {
            Refused::Outdated => {
                AnswerContent::error(Status::GONE, "the points have changed; read them again")
            }
            Refused::Wrong(problem) => problem.into(),
        }
    }
}

/// Answers a request; a panic becomes an error.
fn answer(gate: &RequestGate, session: &Session, request: &Request) -> HttpResponse {
    let answer = match gate.path(request) {
        None => AnswerContent::error(Status::FORBIDDEN, "open the address that wavex printed"),
        Some(_) if request.method != "GET" => {
            AnswerContent::error(Status::METHOD_NOT_ALLOWED, "only GET is answered")
        }
        Some(target) => {
            let (path, query) = target.split_once('?').unwrap_or((target, ""));
            let routed = catch_unwind(AssertUnwindSafe(|| route(session, path, query)));
            match routed {
                Ok(Ok(answer) | Err(answer)) => answer,
                Err(_) => AnswerContent::error(
                    Status::INTERNAL,
                    "an internal error; please report this bug in wavex",
                ),
            }
        }
    };
    let headers = [("content-type", answer.kind)].into_iter().chain(HEADERS).collect();
    HttpResponse { status: answer.status, headers, body: answer.body }
}

/// Status and content of the answer to a request for an address below the token.
pub(super) fn content(session: &Session, address: &str) -> (u16, Vec<u8>) {
    let (path, query) = address.split_once('?').unwrap_or((address, ""));
    let (Ok(answer) | Err(answer)) = route(session, path, query);
    (answer.status.0, answer.body)
}

/// Answers a request of the page.
fn route(session: &Session, path: &str, query: &str) -> Result<AnswerContent, AnswerContent> {
    let query = Query::parse(query)?;
    let generation = || query.number::<u32>("generation");
    let attribute = || Attribute::named(query.get("attribute").unwrap_or("height_m"));
    let set = || query.all("set");
    Ok(match path {
        "info" => AnswerContent::json(&cloud::info(session)),
        "tree" => AnswerContent::json(&cloud::tree(session, generation()?)?),
        "points" => AnswerContent::binary(cloud::positions(
            session,
            generation()?,
            query.number("first")?,
            query.number("count")?,
        )?),
        "values" => AnswerContent::binary(cloud::values(
            session,
            generation()?,
            query.number("first")?,
            query.number("count")?,
            attribute()?,
        )?),
        "point" => AnswerContent::json(&cloud::point(session, generation()?, query.number("index")?)?),
        "profile" => AnswerContent::binary(cloud::profile(
            session,
            generation()?,
            &profile_line(&query)?,
            attribute()?,
        )?),
        "ground" => AnswerContent::json(&cloud::ground_line(session, generation()?, &profile_line(&query)?)?),
        "find" => {
            let search = Search {
                sort: Attribute::named(query.get("sort").unwrap_or("deviation_ratio"))?,
                is_descending: query.get("descending") == Some("true"),
                conditions: Condition::parse(query.get("where").unwrap_or_default())?,
                flag: query.get("flag").filter(|name| !name.is_empty()).map(flag).transpose()?,
                limit: query.get("limit").map_or(Ok(500), |_| query.number("limit"))?,
            };
            AnswerContent::json(&cloud::find(session, generation()?, &search)?)
        }
        "shot" => {
            AnswerContent::json(&shots::shot(session, query.number("input")?, query.number("shot")?, &set())?)
        }
        "line" => AnswerContent::json(&shots::line(session, query.number("input")?, query.number("shot")?)?),
        "compare" if query.get("shot").is_some() => {
            let of_line = [(query.number("input")?, [query.number("shot")?].into())].into();
            AnswerContent::json(&compare::compare(session, &of_line, true, &set())?)
        }
        "compare" => {
            let rectangle = [query.place("from")?, query.place("to")?];
            let within = cloud::shots_within(session, generation()?, rectangle)?;
            AnswerContent::json(&compare::compare(session, &within, false, &set())?)
        }
        "job" => AnswerContent::ok("text/plain; charset=utf-8", job_text::job(session, &set())?),
        "layer" => {
            let name = query.get("name").unwrap_or_default();
            let layer = session.layers.iter().find(|layer| layer.name() == name);
            let layer = layer.ok_or_else(|| format!("{name}: no such layer"))?;
            AnswerContent::ok("image/png", layer.png())
        }
        name => match page::file(name) {
            Some((kind, body)) => AnswerContent::ok(kind, body),
            None => AnswerContent::error(Status::NOT_FOUND, "no such page"),
        },
    })
}

fn profile_line(query: &Query) -> Result<ProfileLine, String> {
    let ends = [query.place("from")?, query.place("to")?];
    Ok(ProfileLine { ends, width_m: query.number("width_m")? })
}

/// Bit of a flag by its name.
fn flag(name: &str) -> Result<u16, String> {
    use wavex_line::scan_line::flags::NAMES;
    let found = NAMES.iter().find(|(_, known)| *known == name).map(|(bit, _)| *bit);
    found.ok_or_else(|| format!("{name}: no such flag"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gate() -> RequestGate {
        RequestGate { token: "0123456789abcdef".into(), port: 8123 }
    }

    #[test]
    fn only_the_own_page_passes() {
        let passes = |list: &[(&str, &str)], target: &str| {
            let headers =
                list.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
            let request = Request { target: target.to_owned(), headers, ..Request::default() };
            gate().path(&request).map(str::to_owned)
        };
        let own = [("host", "127.0.0.1:8123")];
        assert_eq!(passes(&own, "/0123456789abcdef/info"), Some("info".into()));
        assert_eq!(passes(&[("host", "Localhost:8123")], "/0123456789abcdef/"), Some(String::new()));
        let same = [own[0], ("origin", "http://127.0.0.1:8123"), ("sec-fetch-site", "same-origin")];
        assert_eq!(passes(&same, "/0123456789abcdef/info"), Some("info".into()));
        let complete = "http://localhost:8123/0123456789abcdef/info?a=1";
        assert_eq!(passes(&own, complete), Some("info?a=1".into()));
        for path in [
            "/info",
            "/",
            "",
            "/0123456789abcdee/info",
            "/0123456789abcdef",
            "/0123456789abcdef0/info",
            "0123456789abcdef/info",
            "http://evil.example/0123456789abcdef/info",
            "https://127.0.0.1:8123/0123456789abcdef/info",
        ] {
            assert_eq!(passes(&own, path), None, "{path}");
        }
        for foreign in [
            &[("host", "evil.example:8123")][..],
            &[("host", "127.0.0.1:80")],
            &[("host", "127.0.0.1")],
            &[own[0], own[0]],
            &[],
            &[own[0], ("origin", "http://evil.example")],
            &[own[0], ("origin", "null")],
            &[own[0], same[1], ("origin", "http://evil.example")],
            &[own[0], ("sec-fetch-site", "cross-site")],
            &[own[0], ("sec-fetch-site", "same-site")],
        ] {
            assert_eq!(passes(foreign, "/0123456789abcdef/info"), None, "{foreign:?}");
        }
        let at_80 = RequestGate { port: 80, ..gate() };
        assert!(at_80.is_own("localhost") && at_80.is_own("127.0.0.1:80") && !at_80.is_own("localhost:8123"));
    }

    #[test]
    fn tokens_differ_and_are_long() {
        let (a, b) = (token().unwrap(), token().unwrap());
        assert_eq!(a.len(), 2 * TOKEN_BYTES);
        assert_ne!(a, b);
    }
}
