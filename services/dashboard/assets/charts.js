// The charts: where the run is, how alike places look, how long answers take.
"use strict";

// ---- drawing: once per frame of the screen, and only what has changed

function mark(...parts) {
  parts.forEach((part) => dirty.add(part));
}

let scheduled = false;
function schedule() {
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame(() => {
    scheduled = false;
    const parts = [...dirty];
    dirty.clear();
    if (graph) parts.forEach((part) => drawings[part]());
  });
}

const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// A canvas with as many pixels as the screen has there, and its size in CSS pixels.
function sheet(id) {
  const canvas = typeof id === "string" ? at(id) : id;
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

function time(us) {
  if (us >= 1e6) return `${(us / 1e6).toFixed(us >= 1e7 ? 0 : 1)} s`;
  if (us >= 1e3) return `${(us / 1e3).toFixed(us >= 1e4 ? 0 : 1)} ms`;
  return `${Math.round(us)} µs`;
}

const count = (value) => (value >= 1e4 ? `${(value / 1e3).toFixed(value >= 1e5 ? 0 : 1)}k` : value >= 10 ? value.toFixed(0) : value > 0 ? value.toFixed(1) : "0");
const clock = (ms) => new Date(ms).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });

function duration(seconds) {
  const [h, m, s] = [Math.floor(seconds / 3600), Math.floor(seconds / 60) % 60, Math.floor(seconds) % 60];
  return h ? `${h} h ${m} min` : m ? `${m} min ${s} s` : `${s} s`;
}

function drawFacts() {
  const now = run.status;
  const newest = run.answers.at(-1);
  const facts = [];
  if (now) facts.push(["state", now.state], ["delivery", now.delivery]);
  if (newest) facts.push(["tick", newest.tick]);
  if (now) facts.push(["answers", now.answers], ["places", now.matches], ["up", duration(now.uptime_s)]);
  at("facts").replaceChildren(...facts.map(([name, value]) => {
    const pair = make("div");
    pair.append(make("dt", name), make("dd", value));
    return pair;
  }));
  const progress = at("progress");
  progress.hidden = !now || !now.progress_permille;
  progress.value = now ? now.progress_permille : 0;
  progress.title = `${(progress.value / 10).toFixed(0)} % of the recording`;
}

function drawPlace() {
  const newest = run.answers.at(-1);
  const found = newest && newest.reference !== null;
  at("reference").textContent = found ? newest.reference : "–";
  at("reference-of").textContent = `of ${graph.references} places`;
  at("confidence").textContent = found ? newest.confidence.toFixed(2) : "–";
  at("confidence-bar").style.width = `${100 * (found ? newest.confidence : 0)}%`;
  const placed = found && newest.position;
  at("position").textContent = placed ? newest.position.map((m) => m.toFixed(1)).join(", ") : "–";
  at("position").parentElement.hidden = graph.route.length === 0;
  at("reason").textContent = newest && !found ? `No place at tick ${newest.tick}: ${newest.reason}.` : "";
  drawLine(newest, found);
  drawCourse();
  if (!at("route").hidden) drawRoute();
}

// Even steps of 1, 2 or 5 times a power of ten, no more than `most`.
function steps(range, most) {
  const rough = Math.max(range / most, 1e-9);
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((n) => n * power).find((step) => step >= rough);
}

function drawLine(newest, found) {
  const { context, width, height } = sheet("line");
  const last = Math.max(graph.references - 1, 1);
  const pad = 14;
  const x = (reference) => pad + (reference / last) * (width - 2 * pad);
  const base = height - 22;
  context.strokeStyle = color("--line");
  context.lineWidth = 3;
  context.lineCap = "round";
  context.beginPath();
  context.moveTo(x(0), base);
  context.lineTo(x(last), base);
  context.stroke();
  context.fillStyle = color("--faint");
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "center";
  const step = Math.max(steps(last, width / 70), 1);
  for (let tick = 0; tick <= last; tick += step) context.fillText(tick, x(tick), height - 4);
  run.answers.slice(-TRAIL).forEach((past, index, all) => {
    if (past.reference === null) return;
    context.globalAlpha = 0.15 + 0.5 * (index / all.length);
    context.fillStyle = color("--mark");
    context.beginPath();
    context.arc(x(past.reference), base, 3.5, 0, 7);
    context.fill();
  });
  context.globalAlpha = 1;
  if (!found) return;
  for (const rival of newest.top.slice(1)) {
    context.strokeStyle = color("--faint");
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(x(rival.reference), base - 4);
    context.lineTo(x(rival.reference), base - 14);
    context.stroke();
  }
  context.fillStyle = color("--answer");
  context.beginPath();
  context.moveTo(x(newest.reference), base - 2);
  context.lineTo(x(newest.reference) - 8, base - 22);
  context.arc(x(newest.reference), base - 24, 8.2, Math.PI - 0.25, 0.25);
  context.fill();
}

function drawRoute() {
  const { context, width, height } = sheet("route");
  const [east, north] = [graph.route.map((p) => p.east_m), graph.route.map((p) => p.north_m)];
  const [left, right, low, high] = [Math.min(...east), Math.max(...east), Math.min(...north), Math.max(...north)];
  const pad = 18;
  const scale = Math.min((width - 2 * pad) / Math.max(right - left, 1e-6), (height - 2 * pad - 14) / Math.max(high - low, 1e-6));
  const x = (e) => width / 2 + (e - (left + right) / 2) * scale;
  const y = (n) => (height - 14) / 2 - (n - (low + high) / 2) * scale;
  context.strokeStyle = color("--line");
  context.lineWidth = 4;
  context.lineJoin = context.lineCap = "round";
  context.beginPath();
  graph.route.forEach((p, i) => (i ? context.lineTo(x(p.east_m), y(p.north_m)) : context.moveTo(x(p.east_m), y(p.north_m))));
  context.stroke();
  const placed = run.answers.slice(-TRAIL).filter((a) => a.reference !== null && a.position);
  placed.forEach((past, index) => {
    const newest = index === placed.length - 1;
    context.globalAlpha = newest ? 1 : 0.12 + 0.5 * (index / placed.length);
    context.fillStyle = color(newest ? "--answer" : "--mark");
    context.beginPath();
    context.arc(x(past.position[0]), y(past.position[1]), newest ? 7 : 3.5, 0, 7);
    context.fill();
  });
  context.globalAlpha = 1;
  const metres = steps((width * 0.4) / scale, 1.0001) / 2;
  const length = metres * scale;
  if (length < width - 2 * pad) {
    context.strokeStyle = context.fillStyle = color("--faint");
    context.lineWidth = 1.5;
    context.strokeRect(pad, height - 6, length, 0);
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "left";
    context.fillText(`${metres >= 1 ? metres : metres.toFixed(2)} m`, pad + length + 6, height - 2);
  }
}

// The confidence of the last answers, and the least that is asked for.
function drawCourse() {
  const { context, width, height } = sheet("course");
  const [left, above] = [30, 18];
  const y = (confidence) => height - 4 - confidence * (height - above - 4);
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "right";
  for (const level of [0, 0.5, 1]) {
    context.fillStyle = color("--faint");
    context.fillText(level, left - 6, y(level) + 4);
    context.fillStyle = color("--line");
    context.fillRect(left, y(level), width - left, 1);
  }
  context.fillStyle = color("--faint");
  context.fillText("confidence of the last answers", width, above - 6);
  const least = run.status ? run.status.fuse.min_confidence : 0;
  if (least > 0) {
    context.fillStyle = color("--answer");
    context.fillRect(left, y(least), width - left, 1);
  }
  const shown = run.answers.slice(-BARS);
  const each = (width - left) / BARS;
  context.fillStyle = color("--mark");
  shown.forEach((past, index) => {
    if (past.reference === null) return;
    const x = left + (BARS - shown.length + index) * each;
    context.fillRect(x, y(past.confidence), Math.max(each - 1.5, 1), y(0) - y(past.confidence));
  });
}

// ---- the strip

let ramp = null;
function shades() {
  if (ramp) return ramp;
  const stop = (name) => color(name).match(/[0-9a-f]{2}/gi).map((hex) => parseInt(hex, 16));
  const stops = [stop("--ramp0"), stop("--ramp1"), stop("--ramp2")];
  ramp = new Uint8ClampedArray(256 * 4);
  for (let shade = 1; shade < 256; shade++) {
    // Most scores are low: the square lets the high ones stand out.
    const value = ((shade - 1) / 254) ** 2 * 2;
    const [from, share] = value < 1 ? [0, value] : [1, Math.min(value - 1, 1)];
    for (let c = 0; c < 3; c++) ramp[4 * shade + c] = stops[from][c] + (stops[from + 1][c] - stops[from][c]) * share;
    ramp[4 * shade + 3] = 255;
  }
  return ramp;
}

const rows = document.createElement("canvas");
function drawStrip() {
  const { context, width, height } = sheet("strip");
  if (!run.scores.length) {
    context.fillStyle = color("--faint");
    context.font = "14px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText("no scores yet", width / 2, height / 2);
    return;
  }
  const columns = run.scores.at(-1).shades.length;
  if (rows.width !== columns || rows.height !== HISTORY) [rows.width, rows.height] = [columns, HISTORY];
  const image = new ImageData(columns, HISTORY);
  const lut = shades();
  const top = HISTORY - run.scores.length;
  run.scores.forEach((row, index) => {
    for (let column = 0; column < columns; column++) {
      const shade = 4 * row.shades[column];
      image.data.set(lut.subarray(shade, shade + 4), 4 * ((top + index) * columns + column));
    }
  });
  rows.getContext("2d").putImageData(image, 0, 0);
  context.imageSmoothingEnabled = false;
  context.drawImage(rows, 0, 0, width, height);
  context.fillStyle = color("--answer");
  run.scores.forEach((row, index) => {
    const reference = run.references.get(row.tick);
    if (reference === null || reference === undefined) return;
    const x = ((reference + 0.5) / graph.references) * width;
    const y = ((top + index + 0.5) / HISTORY) * height;
    const size = index === run.scores.length - 1 ? 4.5 : 1.8;
    context.beginPath();
    context.arc(x, Math.min(y, height - size), size, 0, 7);
    context.fill();
  });
}

// ---- latency

const STAGES = [["reconstruct", "--stage1"], ["extract", "--stage2"], ["fuse", "--stage3"]];

function drawLatency() {
  const { context, width, height } = sheet("bars");
  const shown = run.answers.slice(-BARS).map((a) => a.latency_us).filter((l) => l.total !== null);
  const most = Math.max(...shown.map((l) => l.total), 1);
  const [left, above] = [52, 8];
  const step = steps(most, 3);
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "right";
  const full = Math.ceil(most / step) * step;
  const y = (us) => height - (us / full) * (height - above);
  for (let us = step; us <= full; us += step) {
    context.fillStyle = color("--faint");
    context.fillText(time(us), left - 6, y(us) + 4);
    context.fillStyle = color("--line");
    context.fillRect(left, y(us), width - left, 1);
  }
  const each = (width - left) / BARS;
  shown.forEach((latency, index) => {
    let sum = 0;
    for (const [stage, name] of STAGES) {
      const us = latency[stage] ?? 0;
      context.fillStyle = color(name);
      const x = left + (BARS - shown.length + index) * each;
      context.fillRect(x, y(sum + us), Math.max(each - 1.5, 1), y(sum) - y(sum + us));
      sum += us;
    }
  });
  if (!run.status) return;
  const table = [...STAGES, ["total", null]].map(([stage, name]) => {
    const row = make("tr");
    const title = make("td");
    if (name) {
      const swatch = make("i", undefined, "swatch");
      swatch.style.background = `var(${name})`;
      title.append(swatch);
    }
    title.append(stage);
    row.append(title);
    const recent = run.status.latency[stage].last_10s;
    for (const key of ["p50_us", "p90_us", "p99_us", "max_us"]) {
      row.append(make("td", recent.count ? time(recent[key]) : "–", "number"));
    }
    return row;
  });
  at("latency-rows").replaceChildren(...table);
}
