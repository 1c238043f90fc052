//! The report of an evaluation, in a browser: nothing is missing, nothing overflows, nothing is asked of anybody.

use super::browser::{Browser, Page, View};
use super::support::{Bench, Said, text};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Every section of the page, and how many pictures (charts and frames) and rows of tables it has at least when
/// everything is given.
const SECTIONS: [(&str, usize, usize); 16] = [
    ("summary", 0, 0),
    ("ensembles", 2, 10),
    ("parts", 3, 0),
    ("sequences", 1, 2),
    ("binning", 2, 1),
    ("lens", 0, 5),
    ("runtime", 1, 5),
    ("matrices", 10, 0),
    ("queries", 12, 0),
    ("route", 4, 0),
    ("precision", 2, 0),
    ("calibration", 2, 0),
    ("tolerance", 2, 0),
    ("likeness", 4, 0),
    ("differences", 0, 5),
    ("best", 0, 10),
];

/// Two pairs of the simulated street's drives.
const PAIRS: &str = "[[pair]]\nname = \"day-day2\"\nreference = \"demo-report/traverses/day\"\n\
    query = \"demo-report/traverses/day2\"\nground_truth = \"positions\"\ntolerance_m = 5.0\ncondition = \"by day\"\n\
    [[pair]]\nname = \"day-night\"\nreference = \"demo-report/traverses/day\"\n\
    query = \"demo-report/traverses/night\"\nground_truth = \"positions\"\ntolerance_m = 5.0\ncondition = \"by night\"\n";

fn drives() -> Bench {
    let bench = Bench::new();
    let said = bench.run(&["demo", "--quick", "--quiet"]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    bench
}

fn evaluated(bench: &Bench, args: &[&str]) -> Said {
    let said = bench.run(&[&["evaluate", "--quiet"], args].concat());
    assert_eq!((said.code(), said.stderr.as_str()), (0, ""));
    said
}

fn number(value: &Value) -> usize {
    value.as_u64().unwrap() as usize
}

/// What the sections hold, by their ids in the page's order.
fn sections(page: &Page<'_>) -> Vec<Value> {
    let found = page.evaluate(
        "[...document.querySelectorAll('main > section')].map(s => ({
            id: s.id,
            title: s.querySelector('h2')?.innerText ?? '',
            linked: document.querySelector(`nav a[href='#${s.id}']`)?.innerText ?? '',
            pictures: [...s.querySelectorAll('svg, img')].filter(e => e.getBoundingClientRect().height > 20).length,
            rows: s.querySelectorAll('tbody tr').length,
            empty: [...s.querySelectorAll('tbody tr, svg, .tiles div')].filter(e => !e.textContent.trim()).length,
            lacks: [...s.querySelectorAll('.lacks')].map(e => e.innerText),
            letters: s.innerText.length,
        }))",
    );
    found.as_array().unwrap().clone()
}

/// What must hold of the page in every view.
fn assert_sound(page: &Page<'_>, view: View) {
    page.look(view);
    // Two frames later it is laid out anew.
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(0))))");
    assert_eq!(page.overflowing(view), Vec::<String>::new(), "{view:?}");
    // Images of charts and frames: all can be decoded and are drawn.
    let images = page.evaluate(
        "Promise.all([...document.querySelectorAll('img, svg image')].map(async e => {
            const image = new Image();
            image.src = e.getAttribute('src') ?? e.getAttribute('href');
            try { await image.decode(); } catch { return `${e.outerHTML.slice(0, 80)} is no image`; }
            const r = e.getBoundingClientRect();
            return r.width < 4 || r.height < 4 || image.naturalWidth < 1 ? `${e.outerHTML.slice(0, 80)} is not seen` : '';
        })).then(all => ({count: all.length, bad: all.filter(Boolean)}))",
    );
    assert_eq!(images["bad"].as_array().unwrap().len(), 0, "{images:#}");
    // Letters of charts: inside of their chart, and large enough to be read or in a chart that can be enlarged.
    let letters = page.evaluate(
        "[...document.querySelectorAll('svg text')].flatMap(t => {
            const r = t.getBoundingClientRect(), s = t.ownerSVGElement.getBoundingClientRect();
            const out = r.left < s.left - 1 || r.right > s.right + 1 || r.top < s.top - 1 || r.bottom > s.bottom + 1;
            return out ? [`${t.textContent} of ${t.ownerSVGElement.getAttribute('aria-label')}`] : [];
        })",
    );
    assert_eq!(letters, serde_json::json!([]), "{view:?}: letters are cut off");
    // The ground is that of the scheme, and what is written on it can be told from it.
    let contrast = page.evaluate(
        "(() => {
            const light = c => { const [r, g, b] = c.match(/[0-9.]+/g).map(Number); return 0.3 * r + 0.6 * g + 0.1 * b; };
            const ground = light(getComputedStyle(document.body).backgroundColor);
            const ink = [...document.querySelectorAll('p, td, th, h1, h2, h3, figcaption, svg text')]
                .map(e => light(getComputedStyle(e)[e instanceof SVGElement ? 'fill' : 'color']));
            return {ground, least: Math.min(...ink.map(i => Math.abs(i - ground)))};
        })()",
    );
    assert_eq!(
        contrast["ground"].as_f64().unwrap() < 128.0,
        view.dark,
        "{contrast}"
    );
    assert!(contrast["least"].as_f64().unwrap() > 80.0, "{contrast}");
}

fn assert_asks_nobody(page: &Page<'_>) {
    let outside: Vec<String> = page
        .requests()
        .into_iter()
        .filter(|r| !r.starts_with("data:") && !r.ends_with("/report.html"))
        .collect();
    assert_eq!(outside, Vec::<String>::new());
    assert_eq!(page.complaints(), Vec::<String>::new());
}

const VIEWS: [View; 4] = [
    View::DESKTOP,
    View::PHONE,
    View {
        dark: true,
        ..View::DESKTOP
    },
    View {
        dark: true,
        ..View::PHONE
    },
];

/// Every figure is a PNG of its own as well, not all of one colour.
fn assert_figures(folder: &Path, at_least: usize) {
    let files: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    assert!(files.len() >= at_least, "{files:?}");
    for file in files {
        let bytes = fs::read(&file).unwrap();
        assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n"), "{}", file.display());
        assert!(
            bytes.len() > 1_000,
            "{} has {} bytes",
            file.display(),
            bytes.len()
        );
    }
}

#[test]
fn a_report_shows_everything_at_any_width() {
    let Some(browser) = Browser::start("a_report_shows_everything_at_any_width") else {
        return;
    };
    let bench = drives();
    bench.file("pairs.toml", PAIRS);
    evaluated(
        &bench,
        &[
            "--pairs",
            "pairs.toml",
            "--out",
            "out",
            "--method",
            "paper,seqslam,none",
            "--length",
            "5,10",
            "--likeness",
            "--costs",
            "demo-report/results.json",
            "--config",
            "demo-report/demo.toml",
        ],
    );
    let page = browser.open_file(&bench.path("out/report.html"), View::DESKTOP);
    let found = sections(&page);
    let ids: Vec<&str> = found.iter().map(|s| s["id"].as_str().unwrap()).collect();
    assert_eq!(ids, SECTIONS.map(|s| s.0));
    for ((id, pictures, rows), section) in SECTIONS.into_iter().zip(&found) {
        assert!(number(&section["pictures"]) >= pictures, "{section:#}");
        assert!(number(&section["rows"]) >= rows, "{section:#}");
        assert_eq!(section["empty"], 0, "{section:#}");
        assert!(number(&section["letters"]) > 60, "{section:#}");
        assert_eq!(section["title"], section["linked"], "{section:#}");
        // All drives are cut by time, and nothing else was left out.
        let lacks = section["lacks"].as_array().unwrap();
        assert_eq!(lacks.len(), usize::from(id == "binning"), "{section:#}");
        assert!(
            lacks.iter().all(|l| l.as_str().unwrap().contains("count")),
            "{section:#}"
        );
    }
    for view in VIEWS {
        assert_sound(&page, view);
    }
    assert_asks_nobody(&page);
    assert_figures(&bench.path("out/figures"), 30);
}

#[test]
fn a_report_says_what_to_give_for_what_it_lacks() {
    let Some(browser) = Browser::start("a_report_says_what_to_give_for_what_it_lacks") else {
        return;
    };
    let bench = drives();
    // Right pairs in a file: no positions are needed for them, and none are given.
    let traverses = bench.path("demo-report/traverses");
    for name in ["day", "day2"] {
        let ticks = traverses.join(name).join("ticks.csv");
        let bare: String = fs::read_to_string(&ticks)
            .unwrap()
            .lines()
            .enumerate()
            .map(|(at, line)| {
                let fields: Vec<&str> = line.split(',').collect();
                if at == 0 {
                    format!("{line}\n")
                } else {
                    format!("{},,\n", fields[..3].join(","))
                }
            })
            .collect();
        fs::write(&ticks, bare).unwrap();
    }
    bench.file(
        "right.csv",
        "query_id,reference_id\n0,0\n1,1\n2,2\n3,3\n4,4\n5,5\n6,6\n7,7\n",
    );
    let (day, day2) = (traverses.join("day"), traverses.join("day2"));
    let pair = [
        "-r",
        text(&day),
        "-q",
        text(&day2),
        "-g",
        "right.csv",
        "--out",
        "out",
    ];
    evaluated(
        &bench,
        &[&pair[..], &["--subsets", "combined", "--length", "3"]].concat(),
    );
    let page = browser.open_file(&bench.path("out/report.html"), View::PHONE);
    let found = sections(&page);
    let ids: Vec<&str> = found.iter().map(|s| s["id"].as_str().unwrap()).collect();
    assert_eq!(ids, SECTIONS.map(|s| s.0));
    for (id, words) in [
        ("ensembles", "condition ="),
        ("parts", "--subsets"),
        ("sequences", "--method paper,seqslam"),
        ("binning", "--subsets"),
        ("lens", "--length 10"),
        ("runtime", "--costs"),
        ("queries", "--config"),
        ("route", "[positions]"),
        ("likeness", "--likeness"),
        ("differences", "several"),
    ] {
        let section = found.iter().find(|s| s["id"] == id).unwrap();
        assert!(section["lacks"].to_string().contains(words), "{section:#}");
    }
    for view in VIEWS {
        assert_sound(&page, view);
    }
    assert_asks_nobody(&page);
    assert_figures(&bench.path("out/figures"), 5);

    // A recording that is gone costs the frames, not the report.
    let manifest = day2.join("traverse.json");
    let gone = fs::read_to_string(&manifest)
        .unwrap()
        .replace("street (day2, seed 1)", "gone.aedat4");
    fs::write(&manifest, gone).unwrap();
    evaluated(
        &bench,
        &[
            &pair[..],
            &[
                "--subsets",
                "combined",
                "--length",
                "3",
                "--config",
                "demo-report/demo.toml",
            ],
        ]
        .concat(),
    );
    let html = fs::read_to_string(bench.path("out/report.html")).unwrap();
    assert!(html.contains("There are no frames: the recording gone.aedat4 is not there"));
}
