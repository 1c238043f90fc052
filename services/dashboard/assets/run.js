// The dashboard's page: takes the events of /api/stream into `run`; the other scripts draw it.
"use strict";

const HISTORY = 120; // ticks in the strip
const AGREED = 40; // ticks of agreement per member
const BARS = 60; // answers in the latency chart
const TRAIL = 30; // answers behind the newest
const LOGGED = 40;
const RETRY_MS = 1500; // after a lost connection
const SILENT_MS = 6000; // without an event: the status comes every second
const DOWN_MS = 1500; // a process that died is shown as down for at least so long
const BACK_MS = 4000; // for so long a process that is back is shown as such

const at = (id) => document.getElementById(id);
const make = (tag, text, className) => {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  if (className) element.className = className;
  return element;
};

let graph = null; // what does not change
let run = fresh();
let token = null;
let source = null;
let heard = 0;
let ended = false;
const dirty = new Set();

function fresh() {
  return {
    answers: [], scores: [], status: null, frames: new Map(), processes: new Map(), log: [],
    references: new Map(), agreed: [], changes: new Set(),
  };
}

// ---- the connection

function connect() {
  source = new EventSource("api/stream");
  const on = (name, take) => source.addEventListener(name, (event) => {
    heard = Date.now();
    take(JSON.parse(event.data));
    schedule();
  });
  on("graph", begin);
  on("history", (history) => {
    history.answers.forEach(answer);
    history.scores.forEach(scores);
    history.frames.forEach(frame);
    history.processes.forEach((moved) => process(moved, true));
    if (history.status) status(history.status);
    link("live", "live");
    banner(null);
  });
  on("answer", answer);
  on("scores", scores);
  on("frame", frame);
  on("process", (moved) => process(moved, false));
  on("status", (now) => {
    status(now);
    link("live", "live");
    banner(null);
  });
  on("lost", (why) => {
    link("lost", "no answer");
    banner(`The instance does not answer: ${why}`);
  });
  on("end", () => {
    ended = true;
    link("ended", "ended");
    banner("The run has ended. What is shown is its last state; a new run at this address is shown as soon as it is there.");
  });
  source.onerror = () => {
    source.close();
    if (!ended) {
      link("lost", "connection lost");
      banner("The connection to the run is lost; trying again. What is shown is the last known state.");
    }
    setTimeout(connect, RETRY_MS);
  };
}

setInterval(() => {
  const open = source && source.readyState === EventSource.OPEN;
  if (open && !ended && Date.now() - heard > SILENT_MS) {
    link("lost", "silent");
    banner("Nothing has been heard of the run for a while.");
  }
}, 1000);

function link(state, text) {
  at("link").dataset.state = state;
  at("link").textContent = text;
}

function banner(text) {
  at("banner").hidden = text === null;
  at("banner").textContent = text ?? "";
}

// ---- what comes

function begin(described) {
  graph = described;
  run = fresh();
  ended = false;
  run.agreed = graph.members.map(() => []);
  document.title = `${graph.name} – evpr`;
  at("name").textContent = graph.name;
  at("version").textContent = `evpr ${graph.version}`;
  buildWindows();
  buildPictures();
  buildMembers();
  buildSettings();
  at("route").hidden = graph.route.length < 2;
  at("place").hidden = at("similarity").hidden = at("latency").hidden = at("fusion").hidden = graph.references === 0;
  mark("place", "strip", "members", "latency", "processes", "log", "frames", "facts");
}

function keep(list, item, most) {
  list.push(item);
  if (list.length > most) list.splice(0, list.length - most);
}

function answer(line) {
  keep(run.answers, line, HISTORY);
  run.references.set(line.tick, line.reference);
  if (run.references.size > 4 * HISTORY) run.references.delete(run.references.keys().next().value);
  mark("place", "latency", "strip", "facts", "trouble");
}

function scores(row) {
  row.shades = Uint8Array.from(row.shades.match(/../g) ?? [], (hex) => parseInt(hex, 16));
  keep(run.scores, row, HISTORY);
  const right = run.references.get(row.tick);
  row.places.forEach((place, member) => {
    const known = place >= 0 && right !== null && right !== undefined;
    const how = known ? (Math.abs(place - right) <= graph.exclusion ? "yes" : "no") : "none";
    if (run.agreed[member]) keep(run.agreed[member], how, AGREED);
  });
  mark("strip", "members");
}

function frame(about) {
  run.frames.set(`${about.reconstruction}/${about.window}`, about);
  mark("frames");
}

function process(moved, old) {
  const words = { down: "died; it is started again", back: "is back", given_up: "is given up; the run goes on without it" };
  note(moved.at_unix_ms, `${moved.process} ${words[moved.moved]}`, moved.moved);
  const before = run.processes.get(moved.process);
  // A death that is over in no time is still to be seen.
  const wait = moved.moved === "back" && before ? Math.max(before.at + DOWN_MS - Date.now(), 0) : 0;
  const state = { moved: moved.moved, at: old ? 0 : Date.now() + wait };
  const show = () => {
    run.processes.set(moved.process, state);
    mark("processes");
    schedule();
  };
  if (wait > 0) setTimeout(() => run.processes.get(moved.process) === before && show(), wait);
  else show();
  if (moved.moved === "back") setTimeout(() => { mark("processes"); schedule(); }, wait + BACK_MS + 50);
}

function status(now) {
  run.status = now;
  for (const change of now.changes) {
    const key = `${change.at_unix_ms} ${change.what}`;
    if (change.from_tick === null || run.changes.has(key)) continue;
    run.changes.add(key);
    note(change.at_unix_ms, `${change.what}, from tick ${change.from_tick} on, by ${change.who}`, "change");
  }
  mark("processes", "members", "latency", "facts", "settings");
}

function note(ms, text, kind) {
  run.log.push({ ms, text, kind });
  run.log.sort((a, b) => b.ms - a.ms);
  run.log.length = Math.min(run.log.length, LOGGED);
  mark("log");
}
