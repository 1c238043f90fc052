// Settings, the token, and the beginning.
"use strict";

// ---- settings, and changing things

const mayChange = () => Boolean(graph && graph.control && token && !ended);

function buildSettings() {
  at("rule").replaceChildren(...graph.rules.map((name) => make("option", name)));
  at("length-field").hidden = !graph.has_length;
  at("deadline-field").hidden = !graph.has_deadline;
  const on = (id, body) => { at(id).onchange = () => change("set", body(at(id)), at(id)); };
  on("length", (field) => ({ length: field.valueAsNumber }));
  on("rule", (field) => ({ rule: field.value }));
  on("min-confidence", (field) => ({ min_confidence: field.valueAsNumber }));
  on("deadline", (field) => ({ deadline: `${field.value}ms` }));
  access();
}

function access() {
  const words = !graph.control
    ? "Read-only: the run was started without --allow-control."
    : token
      ? "Changes hold from the next tick on, and leave a line in the log."
      : "Read-only without the token that evpr run printed.";
  at("access").textContent = words;
  at("unlock").hidden = !graph.control || Boolean(token);
  for (const id of ["length", "rule", "min-confidence", "deadline"]) at(id).disabled = !mayChange();
  mark("members");
}

function drawSettings() {
  const { fuse, governor } = run.status;
  const set = (id, value) => { if (document.activeElement !== at(id)) at(id).value = value; };
  set("length", fuse.length);
  set("rule", fuse.rule);
  set("min-confidence", fuse.min_confidence);
  set("deadline", fuse.deadline_ms);
  at("governor").hidden = !governor;
  if (governor) {
    const p95 = governor.p95_ms === null ? "–" : `${governor.p95_ms.toFixed(1)} ms`;
    const shed = governor.shed.length ? `shed: ${governor.shed.join(", ")}` : "nobody is shed";
    at("governor").textContent = `Governor: p95 ${p95} of ${governor.budget_ms} ms; ${shed}.`;
  }
}

async function change(what, body, field) {
  field.setAttribute("aria-busy", "true");
  try {
    const response = await fetch(`api/${what}`, {
      method: "POST",
      headers: { "Content-Type": "application/json", Authorization: `Bearer ${token}` },
      body: JSON.stringify(body),
    });
    const reply = await response.json();
    if (response.status === 401) forget();
    if (!response.ok) note(Date.now(), `Not changed: ${reply.error}`, "down");
    refused(response.ok ? null : `Not changed: ${reply.error}`);
  } catch {
    refused("Not changed: the run does not answer.");
  }
  field.removeAttribute("aria-busy");
  mark("members");
  if (run.status) mark("settings");
  schedule();
}

function refused(text) {
  at("refused").textContent = text ?? "";
}

function forget() {
  token = null;
  sessionStorage.removeItem("token");
  access();
}

function learn(text) {
  token = text;
  sessionStorage.setItem("token", text);
  if (graph) {
    access();
    schedule();
  }
}

at("unlock").onsubmit = (event) => {
  event.preventDefault();
  const text = at("token").value.trim();
  at("token").value = "";
  if (text) learn(text);
};
at("settings").onsubmit = (event) => event.preventDefault();

// ---- the beginning

// What is drawn by whom.
const drawings = {
  facts: drawFacts, place: drawPlace, strip: drawStrip, frames: drawFrames, members: drawMembers, trouble: drawTrouble,
  latency: drawLatency, settings: drawSettings, processes: drawProcesses, log: drawLog,
};

function everything() {
  ramp = null;
  if (!graph) return;
  mark("place", "strip", "members", "latency");
  schedule();
}
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", everything);
window.addEventListener("resize", everything);

// The token comes behind the #, which is not sent to anybody, and does not stay in the address.
const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) {
  history.replaceState(null, "", location.pathname);
  learn(given);
} else {
  token = sessionStorage.getItem("token");
}
connect();
