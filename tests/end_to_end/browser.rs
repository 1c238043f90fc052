//! A headless Chromium that shows pages to the tests. It is driven over its own pipe with the DevTools protocol
//! (`--remote-debugging-pipe`: JSON messages, each ended by a NUL), so no port is opened and nothing is polled.

use super::support::{Watchdog, text};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

/// Longest life of a browser: a test with one ends as a failure then, before the test runner ends it.
const LIFETIME: Duration = Duration::from_secs(200);
/// Names under which it is installed.
const NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];
/// The pipe's ends are handed over as standard input and output, and moved to where Chromium looks for them.
const HAND_OVER: &str = "exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1";

/// How a page is looked at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    /// CSS pixels.
    pub(crate) width: u32,
    /// CSS pixels.
    pub(crate) height: u32,
    /// Whether the user prefers dark pages.
    pub(crate) dark: bool,
}

impl View {
    pub(crate) const DESKTOP: Self = Self {
        width: 1280,
        height: 900,
        dark: false,
    };
    pub(crate) const PHONE: Self = Self {
        width: 390,
        height: 844,
        dark: false,
    };

    /// The same by night.
    pub(crate) fn dark(self) -> Self {
        Self { dark: true, ..self }
    }

    /// A phone lays a page out as wide as its contents, which is how overflow shows there.
    fn is_phone(self) -> bool {
        self.width < 600
    }
}

/// A browser of its own, with a profile of its own; killed when it is dropped.
pub(crate) struct Browser {
    child: Child,
    pipe: RefCell<Pipe>,
    _watchdog: Watchdog,
    /// Removed last.
    _profile: tempfile::TempDir,
}

struct Pipe {
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    calls: u64,
    /// What it said by itself, in the order of its saying.
    events: Vec<Value>,
}

impl Pipe {
    fn receive(&mut self) -> Value {
        let mut message = Vec::new();
        self.from.read_until(0, &mut message).unwrap();
        assert_eq!(message.pop(), Some(0), "the browser has ended");
        serde_json::from_slice(&message).unwrap()
    }

    fn call(&mut self, session: Option<&str>, method: &str, params: &Value) -> Value {
        self.calls += 1;
        let mut message = json!({"id": self.calls, "method": method, "params": params});
        if let Some(session) = session {
            message["sessionId"] = session.into();
        }
        let mut message = message.to_string().into_bytes();
        message.push(0);
        self.to.write_all(&message).unwrap();
        loop {
            let mut said = self.receive();
            if said["id"] == self.calls {
                assert!(said["error"].is_null(), "{method} {params}: {}", said["error"]);
                return said["result"].take();
            }
            self.events.push(said);
        }
    }

    /// Waits until there is such an event, unless there was one.
    fn event(&mut self, wanted: impl Fn(&Value) -> bool) {
        if !self.events.iter().any(&wanted) {
            loop {
                let said = self.receive();
                let found = wanted(&said);
                self.events.push(said);
                if found {
                    break;
                }
            }
        }
    }
}

/// Where the browser is, or None with a note that names the test.
fn installed(test: &str) -> Option<std::path::PathBuf> {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found = NAMES.iter().find_map(|name| {
        std::env::split_paths(&folders)
            .map(|folder| folder.join(name))
            .find(|path| path.is_file())
    });
    if found.is_none() {
        println!("skipped: {test}: none of {} is on the path", NAMES.join(", "));
    }
    found
}

impl Browser {
    /// Starts one; None, with a note that names the test, where none is installed.
    pub(crate) fn start(test: &str) -> Option<Self> {
        let program = installed(test)?;
        let profile = tempfile::Builder::new().prefix("evb").tempdir().unwrap();
        let mut command = Command::new("sh");
        command.args(["-c", HAND_OVER]).arg(program);
        command.args([
            "--headless",
            "--remote-debugging-pipe",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--disable-background-networking",
            "--disable-breakpad",
            "--disable-component-update",
            "--disable-default-apps",
            "--disable-extensions",
            "--disable-sync",
            "--disable-background-timer-throttling",
            "--disable-renderer-backgrounding",
            "--disable-backgrounding-occluded-windows",
            "--hide-scrollbars",
            "--mute-audio",
            "--no-default-browser-check",
            "--no-first-run",
            // Whatever a page may ask for, nothing outside this machine is reached.
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost, EXCLUDE 127.0.0.1",
        ]);
        command.arg(format!("--user-data-dir={}", profile.path().display()));
        if nix::unistd::geteuid().is_root() {
            command.arg("--no-sandbox");
        }
        for folder in ["HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"] {
            command.env(folder, profile.path());
        }
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .process_group(0)
            .spawn()
            .unwrap();
        let pipe = Pipe {
            to: child.stdin.take().unwrap(),
            from: BufReader::new(child.stdout.take().unwrap()),
            calls: 0,
            events: Vec::new(),
        };
        Some(Self {
            _watchdog: Watchdog::over_within(child.id(), LIFETIME),
            child,
            pipe: RefCell::new(pipe),
            _profile: profile,
        })
    }

    /// Opens an address, and returns when it has loaded.
    pub(crate) fn open(&self, address: &str, view: View) -> Page<'_> {
        let call = |method: &str, params: &Value| self.pipe.borrow_mut().call(None, method, params);
        let target = call(
            "Target.createTarget",
            &json!({"url": "about:blank", "newWindow": true}),
        );
        let attached = call(
            "Target.attachToTarget",
            &json!({"targetId": target["targetId"], "flatten": true}),
        );
        let page = Page {
            browser: self,
            session: attached["sessionId"].as_str().unwrap().to_owned(),
        };
        for domain in ["Page", "Network", "Runtime", "Log"] {
            page.call(&format!("{domain}.enable"), &json!({}));
        }
        page.call("Page.setLifecycleEventsEnabled", &json!({"enabled": true}));
        page.call("Emulation.setFocusEmulationEnabled", &json!({"enabled": true}));
        page.look(view);
        page.go(address);
        page
    }

    /// Opens a file.
    pub(crate) fn open_file(&self, path: &Path, view: View) -> Page<'_> {
        let path = path.canonicalize().unwrap();
        self.open(&format!("file://{}", text(&path)), view)
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Its own group: the browser and everything it started.
        let group = nix::unistd::Pid::from_raw(self.child.id() as i32);
        let _ = nix::sys::signal::killpg(group, nix::sys::signal::SIGKILL);
        let _ = self.child.wait();
    }
}

/// A page in a window of its own. Scripts are JavaScript expressions; one that is a promise is waited for.
pub(crate) struct Page<'b> {
    browser: &'b Browser,
    session: String,
}

impl Page<'_> {
    /// Calls a method of the DevTools protocol for this page.
    pub(crate) fn call(&self, method: &str, params: &Value) -> Value {
        let mut pipe = self.browser.pipe.borrow_mut();
        pipe.call(Some(&self.session), method, params)
    }

    /// Looks at it in another way, from now on.
    pub(crate) fn look(&self, view: View) {
        self.call(
            "Emulation.setDeviceMetricsOverride",
            &json!({"width": view.width, "height": view.height, "deviceScaleFactor": 1, "mobile": view.is_phone()}),
        );
        let scheme = if view.dark { "dark" } else { "light" };
        self.call(
            "Emulation.setEmulatedMedia",
            &json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]}),
        );
    }

    /// Goes to an address, and returns when it has loaded.
    pub(crate) fn go(&self, address: &str) {
        let went = self.call("Page.navigate", &json!({"url": address}));
        assert!(
            went["errorText"].is_null(),
            "{address} cannot be loaded: {}",
            went["errorText"]
        );
        let loaded = |e: &Value| {
            let p = &e["params"];
            e["method"] == "Page.lifecycleEvent"
                && (&p["loaderId"], &p["name"]) == (&went["loaderId"], &json!("load"))
        };
        self.browser.pipe.borrow_mut().event(loaded);
    }

    /// What an expression gives; it must be something that JSON can say.
    pub(crate) fn evaluate(&self, script: &str) -> Value {
        let mut gave = self.call(
            "Runtime.evaluate",
            &json!({"expression": script, "awaitPromise": true, "returnByValue": true, "userGesture": true}),
        );
        let thrown = &gave["exceptionDetails"];
        assert!(thrown.is_null(), "{script}\n{thrown:#}");
        gave["result"]["value"].take()
    }

    /// Waits, in the page, until a condition holds: it is looked at whenever the document changes or a frame is drawn.
    pub(crate) fn wait_for(&self, condition: &str) {
        self.evaluate(&format!(
            "new Promise((done, fail) => {{
                const watch = new MutationObserver(look);
                function look() {{
                    try {{ if (!({condition})) return false; }} catch (e) {{ watch.disconnect(); fail(e); return true; }}
                    watch.disconnect();
                    done(true);
                    return true;
                }}
                function frame() {{ if (!look()) requestAnimationFrame(frame); }}
                watch.observe(document, {{subtree: true, childList: true, attributes: true, characterData: true}});
                frame();
            }})"
        ));
    }

    /// Clicks with the mouse in the middle of the first element that this selects, which must not be covered.
    pub(crate) fn click(&self, selector: &str) {
        let selector = json!(selector);
        let at = self.evaluate(&format!(
            "(() => {{
                const e = document.querySelector({selector});
                if (!e) throw new Error('nothing is ' + {selector});
                e.scrollIntoView({{block: 'center', inline: 'center', behavior: 'instant'}});
                const r = e.getBoundingClientRect(), x = r.x + r.width / 2, y = r.y + r.height / 2;
                const top = document.elementFromPoint(x, y);
                if (!top || !(e.contains(top) || top.contains(e)))
                    throw new Error({selector} + ' is covered by ' + (top ? top.outerHTML.slice(0, 200) : 'nothing'));
                return {{x, y}};
            }})()"
        ));
        for kind in ["mousePressed", "mouseReleased"] {
            self.call(
                "Input.dispatchMouseEvent",
                &json!({"type": kind, "x": at["x"], "y": at["y"], "button": "left", "clickCount": 1}),
            );
        }
    }

    /// Writes into the element that has the focus.
    pub(crate) fn write(&self, text: &str) {
        self.call("Input.insertText", &json!({"text": text}));
    }

    /// A PNG of what is seen, or of the page from top to bottom.
    pub(crate) fn screenshot(&self, whole: bool) -> Vec<u8> {
        let mut params = json!({"format": "png"});
        if whole {
            let metrics = self.call("Page.getLayoutMetrics", &json!({}));
            let size = &metrics["cssContentSize"];
            params["captureBeyondViewport"] = true.into();
            params["clip"] =
                json!({"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1});
        }
        let shot = self.call("Page.captureScreenshot", &params);
        STANDARD.decode(shot["data"].as_str().unwrap()).unwrap()
    }

    /// Of the events of this page, those by this name.
    fn events(&self, method: &str) -> Vec<Value> {
        // A call first: what was said before its answer has been read then.
        self.evaluate("0");
        let pipe = self.browser.pipe.borrow();
        let mine = pipe
            .events
            .iter()
            .filter(|e| e["sessionId"] == self.session.as_str());
        mine.filter(|e| e["method"] == method)
            .map(|e| e["params"].clone())
            .collect()
    }

    /// The addresses of everything that it asked for, its own included, in order.
    pub(crate) fn requests(&self) -> Vec<String> {
        let sent = self.events("Network.requestWillBeSent");
        sent.iter()
            .map(|e| e["request"]["url"].as_str().unwrap().to_owned())
            .collect()
    }

    /// What it complained of: errors and warnings on the console, exceptions, and what could not be loaded.
    pub(crate) fn complaints(&self) -> Vec<String> {
        let spoken = self.events("Runtime.consoleAPICalled");
        let loud = spoken
            .iter()
            .filter(|e| ["error", "warning", "assert"].contains(&e["type"].as_str().unwrap()))
            .map(|e| format!("console: {}", e["args"]));
        let thrown = self.events("Runtime.exceptionThrown");
        let thrown = thrown
            .iter()
            .map(|e| format!("exception: {}", e["exceptionDetails"]));
        let logged = self.events("Log.entryAdded");
        let logged = logged
            .iter()
            .filter(|e| e["entry"]["level"] == "error")
            .map(|e| format!("log: {} {}", e["entry"]["text"], e["entry"]["url"]));
        loud.chain(thrown).chain(logged).collect()
    }

    /// What sticks out of the window to the side: visible elements that no container scrolls or clips. Empty when the
    /// page fits.
    pub(crate) fn overflowing(&self, view: View) -> Vec<String> {
        let found = self.evaluate(&format!(
            "(() => {{
                const width = {}, out = [];
                const held = e => {{
                    for (let p = e.parentElement; p && p !== document.body; p = p.parentElement)
                        if (getComputedStyle(p).overflowX !== 'visible' && p.getBoundingClientRect().right <= width + 0.5)
                            return true;
                    return false;
                }};
                for (const e of document.body.querySelectorAll('*')) {{
                    const r = e.getBoundingClientRect();
                    if (r.width > 0 && r.height > 0 && (r.right > width + 0.5 || r.left < -0.5) && !held(e))
                        out.push(`${{e.outerHTML.slice(0, 120)}} from ${{r.left}} to ${{r.right}}`);
                }}
                const all = document.documentElement.scrollWidth;
                if (all > width) out.push(`the page is ${{all}} wide`);
                return out;
            }})()",
            view.width
        ));
        let found = found.as_array().unwrap().iter();
        found.map(|e| e.as_str().unwrap().to_owned()).collect()
    }
}

/// A page with a bit of everything that the functions above look for.
const PAGE: &str = r##"<!doctype html><html><head><meta name="viewport" content="width=device-width, initial-scale=1">
<style>body { margin: 0; background: #fff } @media (prefers-color-scheme: dark) { body { background: #000 } }
#wide { width: 500px } .scroll { overflow-x: auto }</style></head><body>
<input id="name"><button id="go">go</button><p id="said"></p><div class="scroll"><div style="width: 900px">held</div></div>
<script>
document.querySelector("#go").addEventListener("click", event => {
  if (!event.isTrusted) return;
  const name = document.querySelector("#name").value;
  const image = new Image();
  image.src = "absent.png";
  image.addEventListener("error", () => { document.querySelector("#said").innerHTML = `<b id="wide">${name}</b>`; console.error("said", name); });
});
</script></body></html>"##;

#[test]
fn a_page_is_seen_clicked_and_written_into() {
    let Some(browser) = Browser::start("a_page_is_seen_clicked_and_written_into") else {
        return;
    };
    let bench = super::support::Bench::new();
    let file = bench.file("page.html", PAGE);
    let page = browser.open_file(&file, View::PHONE.dark());
    let color = "getComputedStyle(document.body).backgroundColor";
    assert_eq!(page.evaluate(color), "rgb(0, 0, 0)");
    assert_eq!(page.evaluate("innerWidth"), 390);
    assert_eq!(
        page.evaluate("Promise.resolve({a: [1, 2]})"),
        json!({"a": [1, 2]})
    );
    assert_eq!(
        (page.complaints(), page.overflowing(View::PHONE)),
        (Vec::new(), Vec::new())
    );
    page.click("#name");
    page.write("evpr");
    page.click("#go");
    page.wait_for("document.querySelector('#said').textContent === 'evpr'");
    page.evaluate("document.querySelector('#wide').style.display = 'block'");

    let wide = page.overflowing(View::PHONE);
    assert!(wide[0].contains("id=\"wide\"") && wide.len() == 2, "{wide:?}");
    let requests = page.requests();
    assert!(
        requests[0].ends_with("page.html") && requests[1].ends_with("absent.png"),
        "{requests:?}"
    );
    let complaints = page.complaints().join("\n");
    assert!(
        complaints.contains("\"evpr\"") && complaints.contains("absent.png"),
        "{complaints}"
    );

    page.look(View::DESKTOP);
    assert_eq!(page.evaluate(color), "rgb(255, 255, 255)");
    let size = |shot: Vec<u8>| {
        let decoder = png::Decoder::new(std::io::Cursor::new(shot));
        decoder.read_info().unwrap().info().size()
    };
    assert_eq!(size(page.screenshot(false)), (1280, 900));
    page.evaluate("document.body.style.height = '3000px'");
    assert_eq!(size(page.screenshot(true)), (1280, 3000));

    let other = browser.open_file(&file, View::DESKTOP);
    assert_eq!(
        (other.complaints(), other.requests().len()),
        (Vec::new(), 1),
        "pages are apart"
    );
}
