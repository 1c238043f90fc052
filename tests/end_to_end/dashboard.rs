//! The dashboard over HTTP: what it says, whom it lets change something, and that nobody waits for it.

use super::members::{assert_as_offline, plan};
use super::support::{Bench, Running, TICKS, assert_ticks, run_args, text, timeless};
use evpr_core::member::MemberSet;
use evpr_core::message::FuseSettings;
use evpr_core::plan::Rule;
use nix::sys::signal::Signal;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};

/// A dashboard, as somebody with its address knows it.
pub(crate) struct Site {
    /// Such as `127.0.0.1:4711`.
    pub(crate) host: String,
    pub(crate) token: Option<String>,
}

/// What came back.
struct Reply {
    code: u16,
    head: String,
    body: Vec<u8>,
}

impl Reply {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| {
            panic!("{e}: {} {}", self.head, String::from_utf8_lossy(&self.body));
        })
    }

    fn error(&self) -> String {
        self.json()["error"].as_str().unwrap().to_owned()
    }
}

impl Site {
    /// Waits until a run says where its dashboard is.
    pub(crate) fn of(running: &Running) -> Self {
        let line = running
            .line("dashboard: http://")
            .expect("the run says where its dashboard is");
        let address = line.trim_start_matches("dashboard: http://");
        let (host, rest) = address.split_once('/').unwrap();
        Self {
            host: host.to_owned(),
            token: rest.strip_prefix("#token=").map(str::to_owned),
        }
    }

    /// The page's address.
    pub(crate) fn url(&self) -> String {
        let token = self.token.as_ref().map(|token| format!("#token={token}"));
        format!("http://{}/{}", self.host, token.unwrap_or_default())
    }

    fn send(&self, request: &str) -> TcpStream {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        stream
    }

    fn ask(&self, request: &str) -> Reply {
        let mut stream = BufReader::new(self.send(request));
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            assert!(stream.read_line(&mut head).unwrap() > 0, "cut off: {head}");
        }
        let mut body = Vec::new();
        stream.read_to_end(&mut body).unwrap();
        let code = head.split(' ').nth(1).unwrap().parse().unwrap();
        Reply { code, head, body }
    }

    fn get(&self, path: &str) -> Reply {
        let host = &self.host;
        self.ask(&format!(
            "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        ))
    }

    fn post_with(&self, path: &str, headers: &str, body: &str) -> Reply {
        let length = body.len();
        self.ask(&format!(
            "POST {path} HTTP/1.1\r\n{headers}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
        ))
    }

    fn headers(&self) -> String {
        let token = self.token.as_ref().unwrap();
        format!(
            "Host: {}\r\nContent-Type: application/json\r\nAuthorization: Bearer {token}\r\n",
            self.host
        )
    }

    fn post(&self, path: &str, body: &Value) -> Reply {
        self.post_with(path, &self.headers(), &body.to_string())
    }

    /// Changes something, and gives the tick from which on it holds.
    fn change(&self, path: &str, body: &Value) -> u64 {
        let reply = self.post(path, body);
        let said = reply.json();
        assert_eq!(reply.code, 200, "{body}: {said}");
        said["from_tick"]
            .as_u64()
            .unwrap_or_else(|| panic!("no tick in {said}"))
    }

    fn stream(&self) -> TcpStream {
        self.send(&format!(
            "GET /api/stream HTTP/1.1\r\nHost: {}\r\n\r\n",
            self.host
        ))
    }
}

/// Reads events until each of these has come, and gives the first of each.
fn events(stream: TcpStream, names: &[&str]) -> Vec<Value> {
    let mut found: Vec<Option<Value>> = vec![None; names.len()];
    let mut name = String::new();
    for line in BufReader::new(stream).lines() {
        let line = line.unwrap();
        if let Some(event) = line.strip_prefix("event: ") {
            name = event.to_owned();
        } else if let Some(data) = line.strip_prefix("data: ")
            && let Some(slot) = names.iter().position(|n| *n == name)
        {
            found[slot].get_or_insert_with(|| serde_json::from_str(data).unwrap());
            if found.iter().all(Option::is_some) {
                return found.into_iter().flatten().collect();
            }
        }
    }
    panic!("the stream ended: {found:?}");
}

const SERVE: [&str; 2] = ["--dashboard", "127.0.0.1:0"];

/// What starts a run with a dashboard that may steer it.
pub(crate) fn steered<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&SERVE[..], &["--allow-control"], more].concat()
}

#[test]
fn the_run_is_shown_as_it_goes_on() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let more = [&SERVE[..], &["--pace", "3"]].concat();
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &more));
    let site = Site::of(&running);
    assert_eq!(site.token, None);
    assert!(running.read_to(3));
    let page = site.get("/");
    assert_eq!(page.code, 200);
    for words in [
        "content-security-policy: default-src 'none'",
        "nosniff",
        "no-store",
        "text/html",
    ] {
        assert!(page.head.contains(words), "{words}: {}", page.head);
    }
    assert!(
        !String::from_utf8_lossy(&page.body).contains("http"),
        "nothing from elsewhere"
    );
    assert!(site.get("/run.js").head.contains("text/javascript"));
    assert!(site.get("/dashboard.css").head.contains("text/css"));

    let names = ["graph", "history", "answer", "scores", "frame", "status"];
    let [graph, history, answer, scores, frame, status] =
        <[Value; 6]>::try_from(events(site.stream(), &names)).unwrap();
    assert_eq!(graph["references"], TICKS);
    assert_eq!(graph["windows"], json!(["50ms", "100ms"]));
    assert_eq!(graph["members"].as_array().unwrap().len(), 8);
    assert_eq!(
        (&graph["control"], &graph["has_deadline"]),
        (&false.into(), &false.into())
    );
    assert!(history["answers"].is_array());
    let tick = answer["tick"].as_u64().unwrap();
    assert!(running.read_to(tick));
    assert_eq!(answer, running.answers[tick as usize], "the very answer");
    // 300 places, each a column of two digits, and every member's own place.
    assert_eq!(scores["shades"].as_str().unwrap().len(), 2 * TICKS as usize);
    let places = scores["places"].as_array().unwrap();
    assert_eq!(places.len(), 8);
    assert!(
        places
            .iter()
            .all(|p| (-1..TICKS as i64).contains(&p.as_i64().unwrap())),
        "{scores}"
    );
    let picture = format!("/api/frame/{}/{}", frame["reconstruction"], frame["window"]);
    let picture = site.get(&picture);
    assert!(picture.head.contains("image/png"), "{}", picture.head);
    let picture = png::Decoder::new(&picture.body[..])
        .read_info()
        .unwrap()
        .info()
        .size();
    assert_eq!(picture, (64, 48));
    let of = |status: &Value| status["services"].as_array().unwrap().last().unwrap()["name"].clone();
    assert_eq!(
        (of(&status), of(&site.get("/api/status").json())),
        ("dashboard".into(), "dashboard".into())
    );

    for (path, code) in [
        ("/api/frame/9/9", 404),
        ("/api/frame/0/x", 400),
        ("/nothing", 404),
        ("/api/set", 405),
    ] {
        assert_eq!(site.get(path).code, code, "{path}");
    }
    let body = json!({"members": ["all"], "enabled": false}).to_string();
    let headers = format!("Host: {}\r\nContent-Type: application/json\r\n", site.host);
    let reply = site.post_with("/api/members", &headers, &body);
    assert_eq!((reply.code, reply.error().contains("read-only")), (403, true));
    // A name that somebody else could have made to point here.
    let host = site.ask("GET /api/status HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n");
    assert_eq!(
        (host.code, host.error().contains("by the machine's address")),
        (403, true)
    );
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn the_run_is_steered_with_the_token_and_not_without() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let recorded = bench.path("recorded");
    assert_eq!(bench.record(&config, &query, &recorded).code(), 0);
    let plan = plan(&bench, &config, &query, &map);
    let run = ["run", "-c", text(&config), "-i", text(&query), "-m", text(&map)];
    let mut running = Running::start(&bench, &[&run[..], &steered(&["--pace", "3"])].concat());
    let site = Site::of(&running);
    let token = site.token.clone().unwrap();
    assert_eq!(token.len(), 32);

    let member = &plan.members[2].name;
    assert!(running.read_to(10));
    let off = site.change("/api/members", &json!({"members": [member], "enabled": false}));
    assert!(running.read_to(off + 5));
    let short = site.change("/api/set", &json!({"length": 3, "rule": "median"}));
    assert!(running.read_to(short + 5));
    let sure = site.change("/api/set", &json!({"min_confidence": 0.5}));
    assert!(running.read_to(sure + 5));
    let on = site.change(
        "/api/members",
        &json!({"members": [member], "enabled": true, "weight": 1.0}),
    );

    let off_body = json!({"members": ["all"], "enabled": false}).to_string();
    let refused = |headers: &str, body: &str, code: u16, words: &str| {
        let reply = site.post_with("/api/members", headers, body);
        assert_eq!(reply.code, code, "{headers}{body}: {}", reply.error());
        assert!(reply.error().contains(words), "{words}: {}", reply.error());
    };
    let good = site.headers();
    refused(
        &good.replace(&token, "0123456789abcdef0123456789abcdef"),
        &off_body,
        401,
        "the token is wrong",
    );
    refused(
        &good.replace("Authorization", "X-Other"),
        &off_body,
        401,
        "a token is needed",
    );
    refused(
        &(good.clone() + "Origin: http://evil.example\r\n"),
        &off_body,
        403,
        "another site",
    );
    refused(
        &good.replace(&site.host, "evil.example"),
        &off_body,
        403,
        "address",
    );
    refused(
        &good.replace("application/json", "text/plain"),
        &off_body,
        415,
        "JSON",
    );
    refused(
        &good,
        "{\"members\":[\"all\"],\"enabled\":fal",
        400,
        "cannot understand",
    );
    refused(
        &good,
        &json!({"members": ["all"], "on": false}).to_string(),
        400,
        "unknown field",
    );
    refused(
        &good,
        &json!({"members": ["nobody"], "enabled": false}).to_string(),
        400,
        "there is no member \"nobody\"",
    );
    refused(
        &good,
        &json!({"members": ["all"], "weight": -1.0}).to_string(),
        400,
        "-1 is not a weight",
    );
    refused(
        &good,
        &json!({"members": ["all"], "weight": null}).to_string(),
        400,
        "nothing to change",
    );
    refused(&good, &"x".repeat(100_000), 413, "at most");
    let settings = |body: Value, words: &str| {
        let reply = site.post("/api/set", &body);
        assert_eq!(reply.code, 400, "{body}");
        assert!(reply.error().contains(words), "{words}: {}", reply.error());
    };
    settings(json!({"length": 0}), "is not a sequence length");
    settings(json!({"rule": "best"}), "there is no rule \"best\"");
    settings(json!({"min_confidence": 7}), "is not a confidence");
    settings(json!({"deadline": "300ms"}), "lossless delivery has no deadline");
    settings(json!({"deadline": "soon"}), "is not a duration");
    settings(json!({}), "nothing to change");

    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    let enabled = |tick: u64| -> MemberSet {
        let all = 0..plan.members.len();
        all.filter(|m| *m != 2 || !(off..on).contains(&tick)).collect()
    };
    assert_as_offline(&plan, &recorded, &answers, &enabled, |tick| {
        let mut settings = FuseSettings::default();
        if tick >= short {
            (settings.length, settings.rule) = (3, Rule::Median.code());
        }
        if tick >= sure {
            (settings.min_confidence, settings.sets_min_confidence) = (0.5, 1);
        }
        settings
    });
    let audit = format!("by uid {} pid ", nix::unistd::getuid());
    for (what, from) in [
        (format!("{member}: disabled"), off),
        ("length 3, rule median".to_owned(), short),
        ("min_confidence 0.5".to_owned(), sure),
        (format!("{member}: enabled, weight 1"), on),
    ] {
        let lines = said.stderr.lines().filter(|l| {
            l.contains("http 127.0.0.1:")
                && l.contains(&audit)
                && l.contains(&format!(": {what} from tick {from} on"))
        });
        assert_eq!(lines.count(), 1, "{what} from tick {from}: {}", said.stderr);
    }
    assert!(
        said.stderr
            .contains("may not change anything: the token is wrong"),
        "{}",
        said.stderr
    );
    assert_eq!(said.stderr.matches(&token).count(), 1, "the token is said once");
}

#[test]
fn a_deadline_is_changed_over_http() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    bench.delay("extract/raw_pixels", 3_600_000);
    let token = bench.file("token", "a-token-of-my-own\n");
    let token_file = [
        "--token-file",
        text(&token),
        "--pace",
        "1",
        "--delivery",
        "latest",
    ];
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &steered(&token_file)));
    let site = Site {
        token: Some("a-token-of-my-own".to_owned()),
        ..Site::of(&running)
    };
    assert!(running.read_to(5));
    let from = site.change("/api/set", &json!({"deadline": "1.2s"}));
    assert!(running.read_to(from + 3));
    let late = running.answers[from as usize]["latency_us"]["total"]
        .as_f64()
        .unwrap();
    assert!(late >= 1.2e6, "{late}");
    assert_eq!(site.get("/api/status").json()["fuse"]["deadline_ms"], 1200.0);
    Running::signal(running.pid(), Signal::SIGINT);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_ticks(&answers, answers.len() as u64);
    assert!(!said.stderr.contains("a-token-of-my-own"), "{}", said.stderr);
}

#[test]
fn a_dashboard_that_dies_or_hangs_and_clients_that_do_not_read_disturb_nothing() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let alone = Running::start(&bench, &run_args(&config, &query, &map, &[]));
    let (expected, said) = alone.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);

    let mut running = Running::start(
        &bench,
        &run_args(&config, &query, &map, &steered(&["--pace", "8"])),
    );
    let site = Site::of(&running);
    assert!(running.read_to(5));
    // They say half a request, or want everything and read nothing of it.
    let deaf: Vec<TcpStream> = (0..10).map(|_| site.stream()).collect();
    let silent: Vec<TcpStream> = (0..4).map(|_| site.send("GET / HT")).collect();
    assert!(running.read_to(40));
    assert_eq!(site.get("/api/status").code, 200);
    for pid in running.services("dashboard") {
        Running::signal(pid, Signal::SIGKILL);
    }
    // The address stays, and the next dashboard answers there.
    assert_eq!(site.get("/").code, 200);
    assert_eq!(
        site.post("/api/set", &json!({"length": 0})).code,
        400,
        "the token stays, too"
    );
    let status = site.get("/api/status").json();
    assert_eq!(
        status["services"].as_array().unwrap().last().unwrap()["restarts"],
        1
    );
    assert!(running.read_to(150));
    for pid in running.services("dashboard") {
        Running::signal(pid, Signal::SIGSTOP);
    }
    let (answers, said) = running.finish();
    drop((deaf, silent));
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    let same = |answers: &[Value]| answers.iter().map(timeless).collect::<Vec<_>>();
    assert_eq!(same(&answers), same(&expected));
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn an_unpaced_run_is_not_held_up() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let (expected, _) = Running::start(&bench, &run_args(&config, &query, &map, &[])).finish();
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &SERVE));
    let site = Site::of(&running);
    let deaf = site.stream();
    running.read_to(0);
    for pid in running.services("dashboard") {
        Running::signal(pid, Signal::SIGSTOP);
    }
    let (answers, said) = running.finish();
    drop(deaf);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let same = |answers: &[Value]| answers.iter().map(timeless).collect::<Vec<_>>();
    assert_eq!(same(&answers), same(&expected));
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn what_cannot_be_served_is_refused_before_anything_starts() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let refused = |more: &[&str], code: i32, words: &str| {
        let said = bench.run(&run_args(&config, &query, &map, more));
        assert_eq!(said.code(), code, "{more:?}: {}", said.stderr);
        assert!(said.stderr.contains(words), "{more:?}: {}", said.stderr);
        assert_eq!(said.stdout, "", "{more:?}");
    };
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    refused(
        &["--dashboard", &address],
        1,
        "give --dashboard another address or port",
    );
    refused(&["--dashboard", "nowhere"], 2, "invalid");
    refused(&["--allow-control"], 2, "--dashboard");
    refused(
        &[&SERVE[..], &["--token-file", "t"]].concat(),
        2,
        "--allow-control",
    );
    refused(
        &steered(&["--token-file", "absent"]),
        1,
        "absent: the token cannot be read",
    );
    let short = bench.file("short", "secret\n");
    refused(
        &steered(&["--token-file", text(&short)]),
        1,
        "16 to 128 characters",
    );

    let mut running = Running::start(
        &bench,
        &run_args(&config, &query, &map, &[&SERVE[..], &["--pace", "6"]].concat()),
    );
    let site = Site::of(&running);
    assert!(running.read_to(5));
    refused(&SERVE, 1, "is running already");
    refused(
        &["--name", "other", "--dashboard", &site.host],
        1,
        "give --dashboard another address or port",
    );
    assert_eq!(site.get("/api/status").code, 200);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
}
