//! The page in a real browser: Chromium with its driver, headless. If they are absent, the tests
//! pass with a message. Pictures of each state go to the folder `page` of
//! `CARGO_TARGET_TMPDIR`.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::PathBuf,
    process::{Command, Stdio},
};

use serde_json::{Value, json};

use crate::{
    serve_stop::stop_beside_load,
    serve_support::{Served, config, exchange, submit, token},
    support::{Files, Ports, Running, poll},
};

pub(crate) const DESKTOP: (u32, u32) = (1280, 1000);
const PHONE: (u32, u32) = (390, 844);
/// The name of an element in answers (WebDriver, 11).
const ELEMENT: &str = "element-6066-11e4-a52e-4f735466cecf";

/// A browser with one window, controlled through WebDriver (W3C).
pub(crate) struct Browser {
    driver: String,
    session: String,
    _process: Running,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Returns `None` if this machine has no driver.
    pub(crate) fn start(dark: bool) -> Option<Self> {
        let driver = Command::new("chromedriver")
            .arg("--port=0")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let Ok(driver) = driver else {
            eprintln!(
                "SKIPPED: no chromedriver on this machine; Debian has it in the package \
                chromium-driver"
            );
            return None;
        };
        let mut process = Running(driver);
        let lines = BufReader::new(process.0.stdout.as_mut().unwrap())
            .lines()
            .map_while(Result::ok);
        // It first reports that port 0 was requested.
        let port = |line: String| {
            line.split_once("successfully on port ")
                .and_then(|(_, port)| port.trim_end_matches('.').parse::<u16>().ok())
        };
        let driver = format!("127.0.0.1:{}", lines.filter_map(port).next()?);
        let profile = tempfile::tempdir().unwrap();
        let arguments = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--disable-dev-shm-usage",
            "--hide-scrollbars",
            if dark {
                "--blink-settings=preferredColorScheme=0"
            } else {
                "--blink-settings=preferredColorScheme=1"
            },
            &format!("--user-data-dir={}", profile.path().display()),
        ];
        let wanted = json!({ "capabilities": { "alwaysMatch": { "goog:chromeOptions": { "args": arguments } } } });
        let answer = exchange(&driver, "POST", "/session", &wanted.to_string());
        if answer.status != 200 {
            eprintln!(
                "SKIPPED: chromedriver cannot start a browser: {}",
                answer.text()
            );
            return None;
        }
        let session = format!(
            "/session/{}",
            answer.json()["value"]["sessionId"].as_str().unwrap()
        );
        Some(Self {
            driver,
            session,
            _process: process,
            _profile: profile,
        })
    }

    #[track_caller]
    fn say(&self, path: &str, body: &Value) -> Value {
        let answer = exchange(
            &self.driver,
            "POST",
            &format!("{}{path}", self.session),
            &body.to_string(),
        );
        assert_eq!(answer.status, 200, "{path}: {}", answer.text());
        answer.json()["value"].take()
    }

    pub(crate) fn go(&self, url: &str, size: (u32, u32)) {
        self.size(size);
        self.say("/url", &json!({ "url": url }));
    }

    fn size(&self, (width, height): (u32, u32)) {
        self.say("/window/rect", &json!({ "width": width, "height": height }));
    }

    pub(crate) fn script(&self, text: &str) -> Value {
        self.say("/execute/sync", &json!({ "script": text, "args": [] }))
    }

    /// Runs a script that passes its result to its last argument.
    fn script_async(&self, text: &str) -> Value {
        self.say("/execute/async", &json!({ "script": text, "args": [] }))
    }

    /// Returns the text of an element that is shown.
    pub(crate) fn text(&self, css: &str) -> String {
        let script = format!(
            "const e = document.querySelector({css:?}); return e && e.offsetParent !== null ? \
            e.innerText : \"\""
        );
        self.script(&script).as_str().unwrap_or_default().to_owned()
    }

    #[track_caller]
    fn element(&self, css: &str) -> String {
        let found = self.say(
            "/element",
            &json!({ "using": "css selector", "value": css }),
        );
        format!("/element/{}", found[ELEMENT].as_str().unwrap())
    }

    /// Clicks as a person does, who sees the present page: an element that was drawn again since
    /// it was found is located again.
    #[track_caller]
    pub(crate) fn click(&self, css: &str) {
        // Not behind the head of the page, which is fixed.
        let middle = format!(
            "const e = document.querySelector({css:?}); if (e) e.scrollIntoView({{ block: 'center' }})"
        );
        self.script(&middle);
        for _ in 0..50 {
            let answer = exchange(
                &self.driver,
                "POST",
                &format!("{}{}/click", self.session, self.element(css)),
                "{}",
            );
            if answer.status == 200 {
                return;
            }
            assert!(
                answer.text().contains("stale element reference"),
                "{css}: {}",
                answer.text()
            );
            poll_once();
        }
        panic!("{css}: drawn anew at each click");
    }

    #[track_caller]
    fn keys(&self, css: &str, keys: &str) {
        self.say(
            &format!("{}/value", self.element(css)),
            &json!({ "text": keys }),
        );
    }

    #[track_caller]
    pub(crate) fn wait(&self, css: &str, wanted: &str) {
        self.wait_until(css, wanted, |text| text.contains(wanted));
    }

    /// Waits for at least a number of points: between two checks of a slow browser a sweep may
    /// have advanced by several.
    #[track_caller]
    fn wait_points(&self, css: &str, before: &str, least: u64) {
        self.wait_until(css, &format!("{before}{least} or more"), |text| {
            text.match_indices(before).any(|(at, _)| {
                let number = text[at + before.len()..]
                    .split(|c: char| !c.is_ascii_digit())
                    .next();
                number.and_then(|number| number.parse().ok()) >= Some(least)
            })
        });
    }

    #[track_caller]
    fn wait_until(&self, css: &str, wanted: &str, holds: impl Fn(&str) -> bool) {
        let mut last = String::new();
        for _ in 0..1500 {
            last = self.text(css);
            if holds(&last) {
                return;
            }
            poll_once();
        }
        self.picture("failed", DESKTOP);
        panic!("{css}: expected {wanted:?}, found {last:?}");
    }

    /// Checks the present page with axe-core against WCAG 2.2 AA; skipped if axe-core is not
    /// available (`EIS_BENCH_AXE` names its file).
    #[track_caller]
    fn assert_accessible(&self, name: &str) {
        let Some(path) = std::env::var_os("EIS_BENCH_AXE") else {
            eprintln!("{name}: not looked at by axe-core: EIS_BENCH_AXE names no file of it");
            return;
        };
        let axe = fs::read_to_string(path).unwrap();
        self.script(&format!("{axe}; window.axe = axe;"));
        let found = self.script_async(
            "const done = arguments[arguments.length - 1];
            const tags = ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa'];
            axe.run(document, { runOnly: tags }).then((found) => done(found.violations.map((one) =>
                `${one.id}: ${one.nodes[0].html.slice(0, 200)}`)));",
        );
        assert_eq!(found, serde_json::json!([]), "{name}");
    }

    /// Takes a picture of the whole page at one size, and asserts that nothing overflows at its
    /// side.
    pub(crate) fn picture(&self, name: &str, size: (u32, u32)) {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("page");
        fs::create_dir_all(&folder).unwrap();
        self.size(size);
        let height = self
            .script("return document.documentElement.scrollHeight")
            .as_u64()
            .unwrap();
        self.size((size.0, u32::try_from(height).unwrap().clamp(size.1, 5000)));
        self.script("window.scrollTo(0, 0)");
        let answer = exchange(
            &self.driver,
            "GET",
            &format!("{}/screenshot", self.session),
            "",
        );
        let bytes = base64(answer.json()["value"].as_str().unwrap());
        let kind = if size == PHONE { "phone" } else { "desktop" };
        fs::write(folder.join(format!("{name}-{kind}.png")), bytes).unwrap();
        let wide = self.script("return [document.documentElement.scrollWidth, window.innerWidth]");
        assert!(
            wide[0].as_u64() <= wide[1].as_u64(),
            "{name} at {size:?}: {wide}"
        );
        self.size(size);
    }

    /// Submits the chosen experiment and confirms that a current will flow.
    fn submit_in_panel(&self) {
        self.click("#submit button[type=submit]");
        self.confirm();
    }

    fn confirm(&self) {
        self.wait("#ask", "a current will flow");
        self.click("#ask .go");
    }

    /// Takes pictures of the page and judges it.
    fn inspect(&self, name: &str) {
        self.pictures(name);
        self.assert_accessible(name);
    }

    #[track_caller]
    fn assert_text(&self, css: &str, words: &str) {
        let text = self.text(css);
        assert!(text.contains(words), "{words}: {text}");
    }

    fn pictures(&self, name: &str) {
        self.picture(name, PHONE);
        self.picture(name, DESKTOP);
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        exchange(&self.driver, "DELETE", &self.session, "");
    }
}

/// RFC 4648, without line ends.
fn base64(text: &str) -> Vec<u8> {
    let (mut bytes, mut bits, mut count) = (Vec::new(), 0_u32, 0);
    for letter in text.bytes() {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => break,
        };
        (bits, count) = (bits << 6 | u32::from(value), count + 6);
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    bytes
}

fn poll_once() {
    let mut first = true;
    poll("a moment", || {
        if std::mem::replace(&mut first, false) {
            None
        } else {
            Some(())
        }
    });
}

#[test]
#[ignore = "long drill"]
fn a_run_is_submitted_watched_growing_and_stopped_with_the_button() {
    let Some(browser) = Browser::start(false) else {
        return;
    };
    let files = Files::short(12);
    let ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    browser.go(&served.url(), DESKTOP);
    browser.wait("#state", "Idle");
    browser.wait("#link", "connected");
    browser.inspect("idle");
    browser.click("#showplan");
    browser.wait("#plan", "EIS sweep of the cell");
    browser.click("#submit button[type=submit]");
    browser.wait("#ask", "On the bench demo a current will flow.");
    browser.inspect("asking-current");
    browser.click("#ask .go");
    browser.wait("#said", "demo-1 is in the queue");
    browser.wait("#state", "Running");
    browser.wait_points(".cv-legend", "shunt (", 3);
    browser.wait_points(".cv-legend", "spectrum (", 4);
    let drawn = browser.script("return document.querySelectorAll('.cv-plot .cv-mark').length");
    assert!(
        drawn.as_u64().unwrap() >= 3,
        "Nyquist, |Z| and phase: {drawn}"
    );
    for words in ["EIS sweep of the cell", "of 12,", "about"] {
        browser.assert_text("#runbody", words);
    }
    browser.assert_text("#instrumentrows", "● ON");
    browser.assert_text("#limits", "V left to the ");
    browser.inspect("running");
    // The first run comes to its end, the second is stopped.
    browser.wait("#runs", "✓ finished");
    browser.wait("#reading", "old reading");
    assert_eq!(
        browser.script("return document.querySelector('#reading').className"),
        "figures old"
    );
    browser.inspect("finished");
    browser.submit_in_panel();
    browser.wait_points(".cv-legend", "fake cell (", 2);
    browser.click("#stop");
    browser.wait("#stopped", "outputs read off at");
    ports.assert_outputs_off();
    browser.click("#stopped summary");
    let message = browser.text("#stopped");
    for words in ["supply4q", "load", "generator", "off, read back"] {
        assert!(message.contains(words), "{message}");
    }
    // Folded again: the head of the page hides the content behind it.
    browser.click("#stopped summary");
    browser.wait("#state", "Idle");
    browser.wait("#held", "stopped by local");
    browser.inspect("stopped");
    // On a phone the actions for a run are within the window.
    browser.size(PHONE);
    let right = browser.script(
        "return document.querySelector('#runs tr:last-child td:last-child \
    button').getBoundingClientRect().right",
    );
    assert!(right.as_f64().unwrap() <= f64::from(PHONE.0), "{right}");
    browser.size(DESKTOP);
    // Two runs over each other.
    browser.click("#runs tr:nth-child(1) input");
    browser.click("#runs tr:nth-child(2) input");
    browser.wait(".cv-legend", "demo-1: spectrum (12 points)");
    browser.wait(".cv-legend", "demo-2: ");
    browser.inspect("compared");
    // With the keyboard alone.
    browser.keys("#why", "looked at");
    browser.click("#held button");
    browser.submit_in_panel();
    browser.wait("#state", "Running");
    browser.wait_points("#runbody", "point ", 2);
    browser.keys("body", "\u{e00c}");
    browser.wait("#said", "Esc once more");
    browser.keys("body", "\u{e00c}");
    browser.wait("#stopped", "outputs read off at");
    ports.assert_outputs_off();
}

#[test]
#[ignore = "drill"]
fn nothing_that_starts_a_current_starts_at_one_click() {
    let Some(browser) = Browser::start(false) else {
        return;
    };
    let files = Files::short(4);
    let text = files.text(crate::support::EXPERIMENT);
    let beyond = "amplitude = \"1 A\"";
    assert!(text.contains(beyond), "{text}");
    files.write(
        "experiments/beyond.toml",
        &text.replace(beyond, "amplitude = \"60 A\""),
    );
    let _ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    let queue = || served.get("/queue")["items"].as_array().unwrap().len();
    let is_off = |css: &str| {
        let script = format!("return document.querySelector({css:?}).disabled");
        browser.script(&script) == true
    };
    browser.go(&served.url(), DESKTOP);
    browser.wait("#state", "Idle");
    // Of two experiments, none is chosen.
    browser.wait("#experiment", "choose …");
    assert!(is_off("#submit [type=submit]") && is_off("#showplan"));
    let choose = |name: &str| {
        browser.script(&format!(
            "const e = document.querySelector('#experiment'); e.value = {name:?}; \
            e.dispatchEvent(new Event('change'))"
        ));
    };
    // A plan that the bench refuses cannot be started.
    choose("beyond");
    browser.click("#submit [type=submit]");
    browser.wait_until("#ask", "the reason", |text| text.contains('▲'));
    let starts = browser.script("return document.querySelectorAll('#ask .go').length");
    assert_eq!(starts, 0, "{}", browser.text("#ask"));
    choose("demo");
    browser.click("#submit [type=submit]");
    browser.wait("#ask", "On the bench demo a current will flow.");
    let words = browser.text("#ask");
    for part in ["For about ", "Charge moved: ", "A left", "Not now"] {
        assert!(words.contains(part), "{part}: {words}");
    }
    let held = browser.script("return document.activeElement.textContent");
    assert_eq!(held, "Not now", "a held key starts nothing");
    assert_eq!(queue(), 0);
    browser.click("#ask .go ~ button");
    assert_eq!((browser.text("#ask").as_str(), queue()), ("", 0));
    browser.submit_in_panel();
    browser.wait("#state", "Running");
    browser.wait_points("#runbody", "point ", 2);
    browser.click("#stop");
    browser.wait("#stopped", "outputs read off at");
    browser.wait("#held", "stopped by local");
    // A stopped run waits to go on; the release starts it.
    browser.click("#runs button");
    browser.wait("#ask", "demo-1 goes on at the first unfinished point.");
    assert_eq!(queue(), 0);
    browser.confirm();
    browser.wait("#items", "demo-1 on demo, to go on");
    browser.keys("#why", "looked at");
    browser.click("#held button");
    browser.wait("#ask", "It starts: demo-1.");
    browser.wait("#held", "No run starts on demo");
    browser.confirm();
    browser.wait("#state", "Running");
}

#[test]
#[ignore = "drill"]
fn an_order_that_no_fit_has_is_refused_and_the_order_is_chosen_by_default() {
    let Some(browser) = Browser::start(false) else {
        return;
    };
    let (_files, served) = crate::serve_find::with_a_run();
    browser.go(
        &format!("{}#/analyses?kind=fit&runs=demo-1&rc=9", served.url()),
        DESKTOP,
    );
    browser.wait("#view", "Numbers from 1 to 8");
    browser.click("#view form button[type=submit]");
    browser.wait("#view", "write numbers from 1 to 8");
    assert_eq!(served.get("/analyses").as_array().map_or(0, Vec::len), 0);
    browser.go(&format!("{}#/run/demo-1", served.url()), DESKTOP);
    browser.take("Fit", false);
    let order = poll("the fit", || {
        let answer = served.ask("GET", "/api/v1/analyses/fit-1/files/order.json", ("", ""));
        (answer.status == 200).then(|| answer.json())
    });
    assert_eq!(order["recommended"], 4);
}

/// Draws with the mouse over a stretch of the first strip, 100 to 160 pixels from its left.
const DRAW_OVER: &str = "
    const over = document.querySelector('#strips .u-over');
    const box = over.getBoundingClientRect();
    const mouse = (kind, x, target) => target.dispatchEvent(new MouseEvent(kind, {
        clientX: box.left + x, clientY: box.top + 20, movementX: 9, bubbles: true, button: 0,
        buttons: 1 }));
    mouse('mousemove', 100, over);
    mouse('mousedown', 100, over);
    mouse('mousemove', 160, over);
    mouse('mouseup', 160, document);
";

#[test]
#[ignore = "drill"]
fn a_run_is_seen_over_time_and_a_stretch_of_it_exactly() {
    let Some(browser) = Browser::start(false) else {
        return;
    };
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    browser.go(&served.url(), DESKTOP);
    browser.wait("#state", "Idle");
    browser.submit_in_panel();
    browser.wait("#runs", "✓ finished");
    browser.click("#whole");
    browser.wait("#timesaid", "every peak is kept");
    let count = |css: &str| {
        browser
            .script(&format!("return document.querySelectorAll({css:?}).length"))
            .as_u64()
            .unwrap()
    };
    assert_eq!(count("#strips canvas"), 5);
    let words = browser.text("#timesaid");
    for part in [
        "voltage -0.0",
        " V; current -5.",
        " A; temperature 2",
        " readings",
    ] {
        assert!(words.contains(part), "{part}: {words}");
    }
    let key = browser.text("#timekey");
    for sign in ["stage", "point", "step", "end", "limit of this step"] {
        assert!(key.contains(sign), "{sign}: {key}");
    }
    browser.click("#time summary");
    let marks = browser.text("#timemarks");
    for mark in [
        "stage, EIS sweep of the cell",
        "point, cell, ",
        "end, finished",
    ] {
        assert!(marks.contains(mark), "{mark}: {marks}");
    }
    browser.inspect("time");
    // A point is described in its own line, and stays selected when the plot is drawn again.
    browser.keys(".cv-area", "\u{e014}");
    browser.wait(".cv-status", "Hz; Re ");
    browser.script("window.dispatchEvent(new Event('resize'))");
    browser.wait(".cv-status", " ± ");
    let whole = browser.text("#timesaid");
    browser.script(DRAW_OVER);
    browser.wait_until("#timesaid", "a part, exactly", |now| {
        now != whole && now.contains(" readings.")
    });
    browser.click("#zoomout");
    browser.wait("#timesaid", "every peak is kept");
    let pressed = browser.script("return document.querySelector('#whole').ariaPressed");
    assert_eq!(pressed, "true");
}

/// Time from the click to the banner that reports the outputs as off, ms.
const STOP_AND_WAIT: &str = "
    const done = arguments[arguments.length - 1];
    const since = performance.now();
    document.querySelector('#stopped').replaceChildren();
    document.querySelector('#stop').click();
    const look = () => document.querySelector('#stopped').innerText.includes('outputs read off at')
        ? done(performance.now() - since) : setTimeout(look, 5);
    look();
";

#[test]
#[ignore = "drill"]
fn the_button_in_the_tenth_tab_is_heard_as_soon_as_in_the_first() {
    let Some(browser) = Browser::start(false) else {
        return;
    };
    let open = |served: &Served| {
        for tab in 0..10 {
            if tab > 0 {
                let handle = browser.say("/window/new", &json!({ "type": "tab" }))["handle"].take();
                browser.say("/window", &json!({ "handle": handle }));
            }
            browser.go(&served.url(), DESKTOP);
            browser.wait("#link", "connected");
        }
    };
    stop_beside_load("in the tenth tab of a browser", open, |_| {
        browser.wait("#state", "Running");
        let took = browser.script_async(STOP_AND_WAIT);
        1e-3 * took.as_f64().unwrap()
    });
}

/// Script that returns the text of the page for a bench in work with these outputs and current.
const RUNNING: &str = "
    const [outputs, current_a, fresh] = arguments;
    const done = arguments[3];
    import('/bench.js').then(({ drawNow }) => {
        const instruments = Object.entries(outputs).map(([role, output]) => ({ role, output }));
        drawNow({ state: 'running', instruments, reading: { fixture: 'cell', current_a, fresh }, \
soc: null, limits: [] });
        done(document.querySelector('#state').textContent);
    });
";

#[test]
fn what_the_page_says_of_a_current_follows_from_outputs_through_which_one_can_flow() {
    let Some(browser) = Browser::start(false) else {
        return;
    };
    let files = Files::short(2);
    config(&files, "");
    let served = Served::start(&files);
    browser.go(&served.url(), DESKTOP);
    browser.wait("#link", "connected");
    let off = json!({
        "supply4q": false, "generator": false, "load": false, "supply": false, "chiller": true,
        "scope": null
    });
    let with = |role: &str, output: Value| {
        let mut outputs = off.clone();
        outputs[role] = output;
        outputs
    };
    for (outputs, current_a, fresh, words) in [
        (
            off.clone(),
            json!(0.02),
            true,
            "▶ Running: every output is off",
        ),
        (
            with("load", json!(true)),
            json!(0.02),
            true,
            "▶ Running: current may flow",
        ),
        (
            with("load", json!(null)),
            json!(0.02),
            true,
            "▶ Running: current may flow",
        ),
        (
            off.clone(),
            json!(-3.0),
            true,
            "▲ Running: 3.00 A flow, although every output reports off",
        ),
        (
            off.clone(),
            json!(0.02),
            false,
            "▶ Running: every output reports off; no current has been read yet",
        ),
        (
            off.clone(),
            json!(null),
            true,
            "▶ Running: every output reports off; no current has been read yet",
        ),
    ] {
        let message = browser.say(
            "/execute/async",
            &json!({ "script": RUNNING, "args": [outputs, current_a, fresh] }),
        );
        assert_eq!(message, words, "{outputs}, {current_a} A, fresh: {fresh}");
    }
}

/// Accelerates the time of the page: its timers end earlier, and its clock runs faster, by one
/// factor.
const HURRY: &str = "
    const factor = 8;
    const [once, often, now, began] = [window.setTimeout.bind(window), \
window.setInterval.bind(window), Date.now.bind(Date), Date.now()];
    window.setTimeout = (work, ms, ...more) => once(work, (ms || 0) / factor, ...more);
    window.setInterval = (work, ms, ...more) => often(work, (ms || 0) / factor, ...more);
    Date.now = () => began + factor * (now() - began);
";

#[test]
#[ignore = "long drill"]
fn ten_tabs_still_share_one_stream_after_a_server_that_did_not_answer() {
    let Some(browser) = Browser::start(false) else {
        return;
    };
    let files = Files::short(2);
    config(&files, "[limits]\nrequests_per_s = 1000\nburst = 4000");
    let served = Served::start(&files);
    for tab in 0..10 {
        if tab > 0 {
            let handle = browser.say("/window/new", &json!({ "type": "tab" }))["handle"].take();
            browser.say("/window", &json!({ "handle": handle }));
        }
        let hurry = json!({
            "cmd": "Page.addScriptToEvaluateOnNewDocument", "params": { "source": HURRY }
        });
        browser.say("/goog/cdp/execute", &hurry);
        browser.go(&served.url(), DESKTOP);
        browser.wait("#link", "connected");
    }
    let listeners = || {
        // Every event is received, so that the time between two messages of the server does not
        // count as silence.
        served.post("/benches/demo/hold", "").expect(200);
        let text = served.ask("GET", "/metrics", ("", "")).expect(200).text();
        let row = text
            .lines()
            .find(|line| line.starts_with("eis_bench_event_listeners "))
            .unwrap()
            .to_owned();
        row.rsplit_once(' ').unwrap().1.parse::<f64>().unwrap() as usize
    };
    assert_eq!(listeners(), 1);
    let process = i32::try_from(served.process.0.id()).unwrap();
    crate::guardian::signal(process, nix::sys::signal::Signal::SIGSTOP);
    // For the tabs that is more than a minute and a half.
    let since_s = instruments::clock::unix_time_s();
    while instruments::clock::unix_time_s() - since_s < 14.0 {
        poll_once();
    }
    crate::guardian::signal(process, nix::sys::signal::Signal::SIGCONT);
    let (mut most, since_s) = (0, instruments::clock::unix_time_s());
    while instruments::clock::unix_time_s() - since_s < 8.0 {
        let found = listeners();
        // The page learns with the next message that the abandoned ones are gone.
        most = if instruments::clock::unix_time_s() - since_s < 3.0 {
            0
        } else {
            most.max(found)
        };
        poll_once();
    }
    browser.wait("#link", "connected");
    assert_eq!(most, 1);
}

#[test]
#[ignore = "drill"]
fn a_trip_a_token_and_a_lost_connection_are_seen_in_the_dark() {
    let Some(browser) = Browser::start(true) else {
        return;
    };
    let files = Files::short(4).edit(
        crate::support::CELL,
        "temperature_max = \"60 °C\"",
        "temperature_max = \"20 °C\"",
    );
    let _ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let all = token(&files, "ann", "read,operate,energise,clear-trip");
    let look = token(&files, "bob", "read");
    let clear = token(&files, "cat", "clear-trip");
    let mut served = Served::start(&files);
    browser.go(&served.url(), DESKTOP);
    browser.wait("#login", "Sign in");
    // The button is there before anything else, and stops: it is pressed on the bench's machine.
    browser.click("#stop");
    browser.wait("#stopsaid", "Stopped. demo: outputs read off at");
    browser.inspect("login");
    browser.keys("#token", "eb_wrong\u{e007}");
    browser.wait("#loginsaid", "expected a token of this server");
    browser.keys("#token", &format!("{clear}\u{e007}"));
    browser.wait("#link", "this token cannot read; STOP works");
    browser.click("#stop");
    browser.wait("#stopped", "outputs read off at");
    browser.click("#leave");
    browser.wait("#login", "Sign in");
    browser.keys("#token", &format!("{look}\u{e007}"));
    browser.wait("#state", "Idle");
    browser.wait("#maynot", "needs the scope energise; yours has: read");
    let offered = browser.script("return document.querySelector('#submit [type=submit]').disabled");
    assert_eq!(offered, true, "who may only look cannot submit");
    assert_ne!(browser.text("#stop"), "", "everybody may stop");
    browser.click("#leave");
    browser.wait("#login", "Sign in");
    browser.keys("#token", &format!("{all}\u{e007}"));
    browser.wait("#state", "Idle");
    browser.keys("#why", "looked at");
    browser.click("#held button");
    browser.wait("#said", "The queue goes on");
    browser.submit_in_panel();
    browser.wait("#trip", "temperature");
    browser.wait("#runs", "✕");
    browser.inspect("tripped");
    // The latch cannot be cleared before a person has described the findings.
    browser.click("#trip button");
    assert!(browser.text("#trip").contains("demo is latched"));
    browser.keys("#found", "Ann: the limit in the cell file was too low");
    browser.click("#trip button");
    browser.wait("#said", "demo is cleared");
    browser.wait("#state", "Idle");
    served.process.0.kill().unwrap();
    served.process.0.wait().unwrap();
    browser.wait("#link", "connection lost");
    browser.inspect("lost");
}

/// Marks the link or button that is shown under this name, or begins with it.
const FIND: &str = "
    const [name] = arguments;
    const all = [...document.querySelectorAll('a, button, summary')];
    const fits = (node) => {
        const text = (node.getAttribute('aria-label') || node.textContent).trim();
        return node.checkVisibility() && !node.disabled && (text === name || text.startsWith(name));
    };
    document.querySelectorAll('[data-found]').forEach((node) => delete node.dataset.found);
    // First search the open part, because a bench may have the name of a run.
    const found = all.filter(fits).find((node) => node.closest('#view')) || all.find(fits);
    if (found) found.dataset.found = 'yes';
    return Boolean(found);
";

/// Checks whether the marked element has the focus.
const FOCUSED: &str = "return Boolean(document.activeElement.dataset.found)";

/// Greatest number of controls before the wanted one, by Tab.
const MOST_STOPS: usize = 300;

impl Browser {
    /// Presses keys, wherever the focus is.
    fn press(&self, key: &str) {
        let keys = json!([{ "type": "keyDown", "value": key }, { "type": "keyUp", "value": key }]);
        let source = json!({ "type": "key", "id": "keys", "actions": keys });
        self.say("/actions", &json!({ "actions": [source] }));
    }

    /// Takes the link or button of a name, by mouse or by keyboard alone.
    #[track_caller]
    fn take(&self, name: &str, by_keyboard: bool) {
        let found =
            || self.say("/execute/sync", &json!({ "script": FIND, "args": [name] })) == true;
        crate::support::poll(name, || found().then_some(()));
        if !by_keyboard {
            return self.click("[data-found]");
        }
        for _ in 0..MOST_STOPS {
            if self.script(FOCUSED) == true {
                return self.press("\u{e007}");
            }
            self.press("\u{e004}");
            // Elements that were drawn again in the meantime are marked again.
            found();
        }
        self.picture("failed", DESKTOP);
        panic!("{name}: not reached by Tab");
    }
}

fn a_newcomers_way(dark: bool, size: (u32, u32), by_keyboard: bool) {
    let Some(browser) = Browser::start(dark) else {
        return;
    };
    let files = Files::short(4);
    let ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    let name = |step: &str| {
        let way = if by_keyboard { "keyboard" } else { "mouse" };
        format!("way-{way}-{step}")
    };
    let look = |step: &str| {
        browser.picture(&name(step), size);
        browser.assert_accessible(&name(step));
    };
    let take = |name: &str| browser.take(name, by_keyboard);
    browser.go(&served.url(), size);
    browser.wait("#state", "Idle");
    look("begin");
    // An experiment from a form, with its plan.
    take("New experiment");
    browser.wait("#view", "Begin with an experiment of this server");
    look("new");
    take("demo");
    browser.wait(".fm-side", "No mistake found");
    look("form");
    take("Submit …");
    browser.wait("#view .confirm", "current will flow");
    look("confirm");
    take("Yes, submit to demo");
    browser.wait(".fm-side", "demo-1");
    // It is watched, paused and continued; then it is stopped.
    browser.script("location.hash = '#demo'");
    browser.wait("#state", "Running");
    browser.wait_points("#runbody", "point ", 2);
    look("running");
    take("Pause after this step");
    browser.wait("#state", "Paused");
    look("paused");
    take("Go on");
    browser.wait("#ask", "demo-1 goes on where it paused.");
    take("Yes, go on with demo-1");
    browser.wait("#state", "Running");
    take("■ STOP");
    browser.wait("#stopped", "outputs read off at");
    ports.assert_outputs_off();
    look("stopped");
    let asked = browser.script("return document.querySelector('#why').required");
    assert_eq!(
        asked, true,
        "a queue is never released without a confirmation"
    );
    browser.keys("#why", "looked at: it was stopped on purpose");
    take("Let the queue go on");
    // The same actions, starting from the run.
    take("Catalogue");
    browser.wait("#view", "demo-1");
    look("runs");
    take("demo-1");
    browser.wait("#view", "Repeat as it was");
    look("run");
    take("Repeat as it was");
    browser.wait(".fm-side", "No mistake found");
    take("Submit …");
    take("Yes, submit to demo");
    browser.wait(".fm-side", "demo-2");
    let mut run = 2;
    loop {
        browser.script(&format!("location.hash = '#/run/demo-{run}'"));
        browser.wait("#view", "✓ finished");
        // What its model lacks, and which experiment would show it.
        take("Diagnose");
        browser.wait("#view", "Cannot tell");
        browser.wait("#view", "What to do next");
        look("diagnosis");
        take("Show its plan");
        take("Queue it");
        browser.wait_until("#view", "a plan, or why there is none", |text| {
            text.contains("Yes, queue it on demo") || text.contains("No plan: ")
        });
        if browser.text("#view").contains("Yes, queue it on demo") {
            break;
        }
        // The noise of a few points may resemble an effect, for which a sweep is recommended that
        // is too slow for a simulated bench: then the run is repeated.
        assert!(run < 5, "no experiment that can be queued after {run} runs");
        run += 1;
        browser.script(&format!("location.hash = '#/run/demo-{}'", run - 1));
        take("Repeat as it was");
        browser.wait(".fm-side", "No mistake found");
        take("Submit …");
        take("Yes, submit to demo");
        browser.wait(".fm-side", &format!("demo-{run}"));
    }
    look("next");
    take("Yes, queue it on demo");
    browser.wait("#view", "Queued on demo as");
    take("■ STOP");
    browser.wait("#stopped", "outputs read off at");
}

#[test]
#[ignore = "long drill"]
fn a_newcomer_comes_to_the_queued_next_experiment_by_mouse() {
    a_newcomers_way(false, DESKTOP, false);
}

#[test]
#[ignore = "long drill"]
fn a_newcomer_comes_to_the_queued_next_experiment_by_keyboard_on_a_phone_in_the_dark() {
    a_newcomers_way(true, PHONE, true);
}

#[test]
#[ignore = "drill"]
fn a_person_clamps_two_cells_and_answers_on_the_phone() {
    let Some(browser) = Browser::start(true) else {
        return;
    };
    let files = crate::serve_ask::files();
    let _ports = Ports::serve(&files, 50.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    browser.go(&served.url(), PHONE);
    browser.wait("#link", "connected");
    let run = submit(&served, r#"{"experiment":"demo"}"#);
    browser.wait("#question", "Clamp cell A (serial number S-1)");
    browser.wait("#state", "Waits for a person");
    browser.wait("#overview", "waits for a person");
    browser.pictures("asking");
    browser.size(PHONE);
    browser.assert_accessible("asking");
    browser.click("#question button");
    browser.wait("#question", "First tick that it is done.");
    browser.keys("#question-serial", "S-2");
    browser.click("#question-done");
    browser.click("#question button");
    browser.wait("#question", "this is another cell");
    browser.script("document.querySelector('#question-serial').value = ''");
    browser.keys("#question-serial", "S-1\n");
    browser.wait("#question", "Clamp cell B into the jig");
    browser.click("#question-done");
    browser.click("#question button");
    assert_eq!(served.ended(&run)["finished"], true);
    browser.wait("#state", "Idle");
    assert_eq!(browser.text("#question"), "");
}

/// Script that returns the link targets in the rows of the table of the ageing.
const AGEING_ROWS: &str = "return [...document.querySelectorAll('#view section:has(#fd-ageing) \
tbody a')].map((link) => link.getAttribute('href'))";

#[test]
#[ignore = "drill"]
fn a_cell_is_followed_over_its_runs_and_spectra_of_several_runs_are_compared() {
    let Some(browser) = Browser::start(false) else {
        return;
    };
    let files = Files::short(4);
    config(&files, "");
    let served = Served::start(&files);
    for _ in 0..2 {
        served.ended(&submit(&served, r#"{"experiment":"demo"}"#));
    }
    poll("both runs in the catalogue", || {
        let answer = served.ask("GET", "/api/v1/catalog/runs", ("", ""));
        let runs = answer.json()["runs"].as_array().map_or(0, Vec::len);
        (runs == 2).then_some(())
    });
    // The address of before leads to the catalogue.
    let before = format!("{}/#/cells", served.url());
    browser.go(&before, DESKTOP);
    browser.wait("#view", "1 cell found");
    browser.click("#view tbody th a");
    browser.wait("#view", "2 fitted models of 2 runs");
    let links = browser.script(AGEING_ROWS);
    assert_eq!(links, json!(["#/run/demo-2", "#/run/demo-1"]));
    browser.inspect("ageing");
    browser.click("#views a[href='#/catalog']");
    browser.wait("#view", "2 runs found");
    browser.click("#view input[value=spectra]");
    browser.wait("#view", "2 spectra found");
    let address = browser.script("return location.hash");
    assert_eq!(address, "#/catalog?of=spectra");
    browser.click("#view tbody tr:nth-child(1) input");
    browser.click("#view tbody tr:nth-child(2) input");
    browser.wait("#view", "2 spectra of 2 ticked");
    browser.wait(".cv-legend", "demo-1: spectrum (4 points)");
    browser.wait(".cv-legend", "demo-2: spectrum (4 points)");
    browser.inspect("catalogue");
}

#[test]
#[ignore = "drill"]
fn every_part_of_the_page_is_accessible_with_what_people_have_written_in_it() {
    let Some(browser) = Browser::start(false) else {
        return;
    };
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    served.ended(&crate::serve_support::submit(
        &served,
        r#"{"experiment":"demo"}"#,
    ));
    let script = "<img src=x onerror=document.title='run'>\"'`";
    let note = json!({ "text": script }).to_string();
    served.post("/runs/demo-1/notes", &note).expect(201);
    served
        .post("/cells/Molicel%20P45B/notes", &note)
        .expect(201);
    for kind in ["fit", "kk", "diagnose"] {
        let body = json!({ "kind": kind, "runs": ["demo-1"] }).to_string();
        served.post("/analyses", &body).expect(201);
    }
    let wanted = r#"{"run":"demo-1","budget_minutes":1,"budget_ah":1}"#;
    served.post("/investigations", wanted).expect(201);
    for (place, (address, words)) in [
        ("#demo", "Idle"),
        ("#/new", "Begin with"),
        ("#/new/experiment/demo", "No mistake found"),
        ("#/catalog", "demo-1"),
        ("#/catalog?of=spectra", "1 spectrum found"),
        ("#/catalog?of=cells", "Molicel"),
        ("#/run/demo-1", "onerror"),
        ("#/run/demo-1?spectrum=spectrum&freq_hz=300", "channel 4"),
        ("#/cell/Molicel%20P45B", "onerror"),
        ("#/cell/Molicel%20P45B", "1 fitted model of 1 run"),
        ("#/analyses", "kk-2"),
        ("#/analysis/fit-1", "✓ done"),
        ("#/analysis/kk-2", "✓ done"),
        ("#/analysis/diagnose-3", "Cannot tell"),
        ("#/analysis/investigation-1", "Ended:"),
        ("#/pack", "Lowest voltage"),
        ("#/files", "p45b"),
        ("#/files/cells/p45b", "Capacity"),
        ("#/files/benches/demo", "The file in force is shown"),
        ("#/notices", "demo-1 on demo: finished"),
    ]
    .into_iter()
    .enumerate()
    {
        browser.go(&format!("{}/{address}", served.url()), DESKTOP);
        browser.script("location.reload()");
        let part = if address.starts_with("#/") {
            "#view"
        } else {
            "#state"
        };
        browser.wait(part, words);
        let name = format!("part-{place:02}");
        browser.inspect(&name);
        assert_ne!(
            browser.script("return document.title"),
            "run",
            "{address}: a script ran"
        );
    }
}
