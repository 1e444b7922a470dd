//! Attacks on the server of `wavex view`.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use wavex_testkit::view::Viewer;
use wavex_testkit::{TestFolder, wavex};

const JOB: &str = "[[stage]]\ntype = 'simulate'\nlines = 4\nshots_per_line = 200\n\
                   [[stage]]\ntype = 'calibrate'\nwaveforms = 500\n\
                   [[stage]]\ntype = 'decompose'\n\
                   [[stage]]\ntype = 'georeference'\n";

/// A view of a small simulated flight, and its folder.
fn viewer() -> (TestFolder, Viewer) {
    let place = TestFolder::with(&[("secret.txt", b"secret"), ("job.toml", JOB.as_bytes())]);
    let mut command: Command = wavex();
    let viewer = Viewer::start(command.current_dir(place.path("")).args(["view", "--no-open", "job.toml"]));
    viewer.ready();
    (place, viewer)
}

#[test]
fn foreign_pages_names_and_tokens_are_refused() {
    let (_place, viewer) = viewer();
    let path = format!("/{}/info", viewer.token);
    let host = format!("host: {}\r\n", viewer.host);
    assert_eq!(viewer.ask_with(&path, &host).status, 200);
    let port = viewer.host.split(':').nth(1).unwrap();
    for headers in [
        format!("host: wavex.example:{port}\r\n"),
        "host: 127.0.0.1\r\n".to_owned(),
        format!("{host}origin: https://evil.example\r\n"),
        format!("{host}origin: null\r\n"),
        format!("{host}origin: http://{}\r\norigin: https://evil.example\r\n", viewer.host),
        format!("{host}{host}"),
        format!("{host}sec-fetch-site: cross-site\r\n"),
    ] {
        let reply = viewer.ask_with(&path, &headers);
        assert_eq!(reply.status, 403, "{headers}");
        assert!(!reply.headers.contains("access-control"));
    }
    for path in ["/", "/info", "/00000000000000000000000000000000/info", "//info", "/favicon.ico"] {
        assert_eq!(viewer.ask_with(path, &host).status, 403, "{path}");
    }
    let reply = viewer.ask("info");
    for header in ["content-security-policy: default-src 'none'", "nosniff", "no-store", "no-referrer"] {
        assert!(reply.headers.contains(header), "{}", reply.headers);
    }
}

#[test]
fn no_address_reaches_the_file_system() {
    let (_place, viewer) = viewer();
    for path in [
        "../secret.txt",
        "..%2fsecret.txt",
        "%2e%2e/secret.txt",
        "secret.txt",
        "/etc/passwd",
        "page/../../secret.txt",
        "layer?name=../secret",
        "layer?name=/etc/passwd",
        "index.html/../../../etc/passwd",
    ] {
        let reply = viewer.ask(path);
        assert!(matches!(reply.status, 400 | 403 | 404), "{path}: {}", reply.status);
        assert!(!String::from_utf8_lossy(&reply.body).contains("root:"));
    }
}

#[test]
fn wrong_and_huge_requests_get_an_answer_of_bounded_size() {
    let (_place, mut viewer) = viewer();
    let generation = viewer.json("info")["generation"].clone();
    for path in [
        format!("points?generation={generation}&first=0&count=18446744073709551615"),
        format!("points?generation={generation}&first=18446744073709551615&count=100000"),
        format!("points?generation={generation}&first=0&count=100001"),
        format!("values?generation={generation}&first=0&count=1&attribute=../x"),
        format!("point?generation={generation}&index=4294967295"),
        format!("profile?generation={generation}&from=nan,0&to=1,1&width_m=1"),
        format!("profile?generation={generation}&from=0,0&to=0,0&width_m=1"),
        format!("ground?generation={generation}&from=0,0&to=0,0&width_m=1"),
        format!("ground?generation={generation}&from=0,0&to=1,1"),
        format!("profile?generation={generation}&from=0,0&to=1,1&width_m=-1"),
        format!("find?generation={generation}&sort=nothing"),
        format!("find?generation={generation}&flag=nothing"),
        "shot?input=99&shot=1".to_owned(),
        "shot?input=0&shot=18446744073709551615".to_owned(),
        "shot?input=0&shot=1&set=simulate.truth%3D/tmp/x".to_owned(),
        "shot?input=0&shot=1&set=decompose.detection_sigma%3D-1".to_owned(),
        "shot?input=0&shot=1&set=decompose.nothing%3D1".to_owned(),
        "shot".to_owned(),
        "tree?generation=x".to_owned(),
        format!("info?{}", "a=1&".repeat(100)),
    ] {
        let reply = viewer.ask(&path);
        assert_eq!(reply.status, 400, "{path}");
        assert!(reply.json()["error"].as_str().is_some_and(|text| text.len() > 5), "{path}");
    }
    assert_eq!(viewer.ask("tree?generation=4000000000").status, 410);
    let far = format!("profile?generation={generation}&from=-1e300,0&to=1e300,1e300&width_m=1e300");
    assert!(matches!(viewer.ask(&far).status, 200 | 400));
    assert!(matches!(viewer.ask(&far.replace("profile?", "ground?")).status, 200 | 400));
    let all = format!("find?generation={generation}&sort=height_m&limit=999999999999");
    assert!(viewer.json(&all)["found"].as_array().unwrap().len() <= 5000);
    let host = format!("host: {}\r\n", viewer.host);
    for request in [
        format!(
            "POST /{}/info HTTP/1.1\r\n{host}content-length: 5\r\nconnection: close\r\n\r\nhello",
            viewer.token
        ),
        format!("CONNECT {} HTTP/1.1\r\n{host}\r\n", viewer.host),
        "OPTIONS * HTTP/1.1\r\n\r\n".to_owned(),
        format!("GET /{}/info HTTP/1.1\r\n\r\n", viewer.token),
        format!("GET /{}/info HTTP/9.9\r\n{host}\r\n", viewer.token),
        format!("GET /{} HTTP/1.1\r\n{host}\r\n", "x".repeat(1 << 20)),
        format!("GET / HTTP/1.1\r\n{host}{}\r\n", "a: b\r\n".repeat(20_000)),
        "\u{0}\u{1}\u{2}\r\n\r\n".to_owned(),
    ] {
        let answer = viewer.raw(request.as_bytes());
        assert!(!String::from_utf8_lossy(&answer).starts_with("HTTP/1.1 200"), "{request:.60}");
    }
    assert!(viewer.is_running());
    assert_eq!(viewer.ask("info").status, 200);
}

#[test]
fn requests_sent_together_and_complete_addresses_are_answered() {
    let (_place, viewer) = viewer();
    let Viewer { host, token, .. } = &viewer;
    let [next, last] = ["", "connection: close\r\n"].map(|end| format!("host: {host}\r\n{end}\r\n"));
    let requests = format!(
        "GET /{token}/info HTTP/1.1\r\n{next}GET http://{host}/{token}/info HTTP/1.1\r\n{next}\
         GET http://evil.example/{token}/info HTTP/1.1\r\n{last}"
    );
    let answers = String::from_utf8(viewer.raw(requests.as_bytes())).unwrap();
    let statuses: Vec<&str> = answers.split("HTTP/1.1 ").skip(1).map(|answer| &answer[..3]).collect();
    assert_eq!(statuses, ["200", "200", "403"], "{answers}");
}

#[test]
fn more_slow_clients_than_connections_stop_nobody() {
    let (_place, viewer) = viewer();
    let mut slow: Vec<TcpStream> = (0..300).map(|_| TcpStream::connect(&viewer.host).unwrap()).collect();
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(6) {
        // Those that have been replaced cannot be written to.
        slow.iter_mut().for_each(|stream| drop(stream.write_all(b"G")));
        let asked = Instant::now();
        assert_eq!(viewer.ask("info").status, 200);
        assert!(asked.elapsed() < Duration::from_secs(2), "{:?}", asked.elapsed());
        std::thread::sleep(Duration::from_millis(200));
    }
    // A request that is still incomplete after its time limit is refused.
    let last = slow.last_mut().unwrap();
    last.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let mut answer = Vec::new();
    let _replaced = last.read_to_end(&mut answer);
    assert!(!String::from_utf8_lossy(&answer).contains("200 OK"));
}

#[test]
fn slow_and_many_clients_do_not_stop_the_others() {
    let (_place, mut viewer) = viewer();
    let slow: Vec<TcpStream> = (0..100)
        .map(|_| {
            let mut stream = TcpStream::connect(&viewer.host).unwrap();
            stream.write_all(b"GET /").unwrap();
            stream
        })
        .collect();
    assert_eq!(viewer.ask("info").status, 200);
    let paths = ["shot?input=0&shot=7", "line?input=0&shot=300"];
    let client = &viewer;
    let replies: Vec<u16> = std::thread::scope(|scope| {
        let ask = |i: usize| scope.spawn(move || client.ask(paths[i % 2]).status);
        let running: Vec<_> = (0..100).map(ask).collect();
        running.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(replies, vec![200; 100]);
    // A client that does not read its answer.
    let mut deaf = TcpStream::connect(&viewer.host).unwrap();
    let request = format!("GET /{}/main.js HTTP/1.1\r\nhost: {}\r\n\r\n", viewer.token, viewer.host);
    deaf.write_all(request.repeat(50).as_bytes()).unwrap();
    assert_eq!(viewer.ask("info").status, 200);
    drop(slow);
    deaf.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let _ = deaf.read(&mut [0; 100]);
    assert!(viewer.is_running());
}

#[cfg(unix)]
#[test]
fn a_signal_ends_the_view() {
    let place = TestFolder::with(&[("job.toml", JOB.as_bytes())]);
    let mut command: Command = wavex();
    let mut viewer =
        Viewer::start(command.current_dir(place.path("")).args(["view", "--no-open", "job.toml"]));
    viewer.ready();
    viewer.interrupt();
    let ends = (0..100).any(|_| {
        std::thread::sleep(Duration::from_millis(50));
        !viewer.is_running()
    });
    assert!(ends, "Ctrl-C ends it");
}

/// Nothing is written, so nothing is lost.
#[cfg(unix)]
#[test]
fn a_signal_ends_a_view_that_computes() {
    let slow =
        JOB.replace("lines = 4\n", "lines = 5000\n").replace("waveforms = 500\n", "waveforms = 500000\n");
    let place = TestFolder::with(&[("job.toml", slow.as_bytes())]);
    let mut command: Command = wavex();
    command.current_dir(place.path("")).args(["-q", "view", "--no-open", "job.toml"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(child.try_wait().unwrap(), None, "it ended before it was interrupted");
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!((output.status.code(), said.as_str()), (Some(0), ""));
}
