//! The dashboard's page in a headless Chromium.

use super::browser::{Browser, Page, View};
use super::dashboard::{Site, steered};
use super::members::plan;
use super::support::{Bench, Running, TICKS, assert_ticks, run_args};
use nix::sys::signal::Signal;
use serde_json::Value;

/// Has the page note every state that a process's row is in.
fn note_states(page: &Page<'_>, process: &str) {
    page.evaluate(&format!(
        "(() => {{
            window.states = [];
            const look = () => {{
                const row = document.querySelector('tr[data-process=\"{process}\"]');
                if (row && states.at(-1) !== row.dataset.state) states.push(row.dataset.state);
            }};
            new MutationObserver(look).observe(document.querySelector('#process-rows'), {{childList: true}});
        }})()"
    ));
}

const LIVE: &str = "document.querySelector('#link').dataset.state === 'live'";

#[test]
fn the_page_shows_the_run_and_steers_it() {
    let Some(browser) = Browser::start("the_page_shows_the_run_and_steers_it") else {
        return;
    };
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    // Slow, and without an end before that of the test.
    let args = run_args(&config, &query, &map, &steered(&["--pace", "0.5"])).join(" ");
    let args: Vec<&str> = args.split(' ').collect();
    let mut running = Running::start(&bench, &args);
    let site = Site::of(&running);
    assert!(running.read_to(3));
    let page = browser.open(&site.url(), View::DESKTOP);
    page.wait_for(LIVE);
    assert!(!page.evaluate("location.href").as_str().unwrap().contains("token"));

    // It goes on by itself.
    page.wait_for("document.querySelector('#reference').textContent !== '–'");
    page.evaluate("window.before = document.querySelector('#facts').textContent");
    page.wait_for("document.querySelector('#facts').textContent !== before");
    let images = "[...document.querySelectorAll('#pictures img')]";
    page.wait_for(&format!(
        "{images}.length === 2 && {images}.every(i => !i.hidden && i.naturalWidth === 64)"
    ));
    let painted = |canvas: &str| {
        format!(
            "document.querySelector('{canvas}').getContext('2d').getImageData(0, 0, 2000, 300).data.some(v => v > 0)"
        )
    };
    for canvas in ["#strip", "#line", "#bars", "#member-rows canvas"] {
        page.wait_for(&painted(canvas));
    }

    // It fits, in light and dark, on a desk and on a phone.
    let ground = "getComputedStyle(document.body).backgroundColor";
    let light = page.evaluate(ground);
    for view in [
        View::DESKTOP.dark(),
        View::PHONE.dark(),
        View::PHONE,
        View::DESKTOP,
    ] {
        page.look(view);
        page.wait_for(&format!("innerWidth === {}", view.width));
        assert_eq!(page.overflowing(view), Vec::<String>::new(), "{view:?}");
        assert_eq!(page.evaluate(ground) == light, !view.dark, "{view:?}");
    }

    // A member goes off, and another gets a weight.
    let member = "event_count@50ms/patch_norm";
    let switch = format!("tr[data-member=\"{member}\"] .switch");
    page.click(&switch);
    page.wait_for(&format!(
        "document.querySelector('{switch}').getAttribute('aria-checked') === 'false'"
    ));
    let log = "document.querySelector('#log').textContent";
    page.wait_for(&format!("{log}.includes('{member}: disabled')"));
    let status: Value = serde_json::from_str(&bench.run(&["status", "--json"]).stdout).unwrap();
    let change = &status["changes"][0];
    assert!(
        change["who"].as_str().unwrap().starts_with("http 127.0.0.1:"),
        "{change}"
    );
    let from = change["from_tick"].as_u64().unwrap();
    assert!(running.read_to(from));
    let names = |answer: &Value| answer["members"].as_array().unwrap().len();
    assert_eq!(names(running.answers.last().unwrap()), 7);
    page.evaluate("(() => { const e = document.querySelector('#length'); e.focus(); e.select(); })()");
    page.write("7");
    page.evaluate("document.querySelector('#length').blur()");
    page.wait_for(&format!("{log}.includes('length 7')"));
    page.evaluate("(() => { const e = document.querySelector('#length'); e.focus(); e.select(); })()");
    page.write("7000");
    page.evaluate("document.querySelector('#length').blur()");
    page.wait_for("document.querySelector('#refused').textContent.includes('7000 is not a sequence length')");

    // A process dies and comes back.
    let process = "extract/raw_pixels";
    note_states(&page, process);
    for pid in running.services("extract") {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap();
        let number = plan(&bench, &config, &query, &map).extract_service(1).to_string();
        let words: Vec<_> = line.split(|b| *b == 0).map(String::from_utf8_lossy).collect();
        if words.windows(2).any(|w| w[0] == "--service" && w[1] == number) {
            Running::signal(pid, Signal::SIGKILL);
        }
    }
    page.wait_for("states.includes('down') && states.at(-1) === 'ready'");
    page.wait_for(&format!(
        "{log}.includes('{process} died') && {log}.includes('{process} is back')"
    ));
    let restarts =
        format!("document.querySelector('tr[data-process=\"{process}\"]').lastChild.textContent === '1'");
    page.wait_for(&restarts);

    // Nothing came from elsewhere. The refused change is logged by the browser itself.
    let elsewhere = format!("http://{}/", site.host);
    let elsewhere: Vec<String> = page
        .requests()
        .into_iter()
        .filter(|url| !url.starts_with(&elsewhere) && !url.starts_with("data:"))
        .collect();
    assert_eq!(elsewhere, Vec::<String>::new());
    let refused = |line: &String| line.contains("400 (Bad Request)") && line.contains("/api/set");
    let complaints: Vec<String> = page
        .complaints()
        .into_iter()
        .filter(|line| !refused(line))
        .collect();
    assert_eq!(complaints, Vec::<String>::new());

    // The run ends, and another begins at the same address.
    Running::signal(running.pid(), Signal::SIGINT);
    page.wait_for("document.querySelector('#banner').textContent.includes('The run has ended')");
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_ticks(&answers, answers.len() as u64);
    let again: Vec<&str> = args
        .iter()
        .map(|a| {
            if *a == "127.0.0.1:0" {
                site.host.as_str()
            } else {
                a
            }
        })
        .collect();
    let mut running = Running::start(&bench, &again);
    page.wait_for(LIVE);
    page.wait_for("document.querySelector('#banner').hidden");
    // It has another token, which the page is not told.
    page.click(&switch);
    page.wait_for("document.querySelector('#refused').textContent.includes('the token is wrong')");
    assert!(running.read_to(3));
    Running::signal(running.pid(), Signal::SIGINT);
    let (_, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn the_page_cannot_steer_without_the_token() {
    let Some(browser) = Browser::start("the_page_cannot_steer_without_the_token") else {
        return;
    };
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let mut running = Running::start(
        &bench,
        &run_args(&config, &query, &map, &steered(&["--pace", "0.5"])),
    );
    let site = Site::of(&running);
    assert!(running.read_to(1));
    let page = browser.open(&format!("http://{}/", site.host), View::PHONE);
    page.wait_for(LIVE);
    let switch = "document.querySelector('#member-rows .switch')";
    page.wait_for(&format!(
        "{switch}.getAttribute('aria-checked') === 'true' && {switch}.disabled"
    ));
    assert_eq!(page.evaluate("document.querySelector('#length').disabled"), true);
    // Written into the page, it will do.
    page.click("#token");
    page.write(site.token.as_ref().unwrap());
    page.click("#unlock button");
    page.wait_for(&format!(
        "!{switch}.disabled && document.querySelector('#unlock').hidden"
    ));
    page.click("#member-rows .switch");
    page.wait_for(&format!("{switch}.getAttribute('aria-checked') === 'false'"));
    assert_eq!(page.complaints(), Vec::<String>::new());
    Running::signal(running.pid(), Signal::SIGINT);
    let (_, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
}
