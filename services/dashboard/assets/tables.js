// Frames, members, processes, and what has happened.
"use strict";

// ---- frames

function buildWindows() {
  const choice = at("window");
  const chosen = choice.value;
  choice.replaceChildren(...graph.windows.map((name, index) => {
    const option = make("option", name);
    option.value = index;
    return option;
  }));
  // The longest, unless somebody has chosen another.
  choice.value = graph.windows[chosen] && chosen !== "" ? chosen : graph.windows.length - 1;
  choice.parentElement.hidden = graph.windows.length < 2;
  choice.onchange = () => { mark("frames"); schedule(); };
}

let pictures = [];
function buildPictures() {
  pictures = graph.reconstructions.map((name) => {
    const figure = make("figure");
    const box = make("div", undefined, "frame");
    const image = make("img");
    image.alt = `Newest frame of ${name}`;
    image.hidden = true;
    const none = make("div", "no frame yet", "none");
    const about = make("span", "", "faint");
    const caption = make("figcaption");
    caption.append(name, " ", about);
    box.append(image, none);
    figure.append(box, caption);
    return { figure, box, image, none, about, shown: null, loading: false };
  });
  at("pictures").replaceChildren(...pictures.map((p) => p.figure));
}

function drawFrames() {
  const chosen = at("window").value;
  pictures.forEach((picture, reconstruction) => {
    const about = run.frames.get(`${reconstruction}/${chosen}`);
    if (!about) {
      picture.image.hidden = true;
      picture.none.hidden = false;
      picture.none.textContent = "no frame yet";
      picture.about.textContent = "";
      return;
    }
    picture.about.textContent = `tick ${about.tick}, ${count(about.events)} events`;
    picture.none.hidden = about.reason === null;
    picture.none.textContent = about.reason ?? "";
    const key = `${chosen}/${about.tick}`;
    // One at a time: a slow line gets fewer pictures, not later ones.
    if (about.reason !== null || picture.loading || picture.shown === key) return;
    picture.loading = true;
    const next = new Image();
    const done = (good) => {
      picture.loading = false;
      picture.shown = key;
      if (good) {
        picture.image.src = next.src;
        picture.image.hidden = false;
        picture.box.style.aspectRatio = `${next.naturalWidth} / ${next.naturalHeight}`;
      }
      mark("frames");
      schedule();
    };
    next.onload = () => done(true);
    next.onerror = () => done(false);
    next.src = `api/frame/${reconstruction}/${chosen}?tick=${about.tick}`;
  });
}

// ---- members

let memberRows = [];
function buildMembers() {
  memberRows = graph.members.map((member) => {
    const row = make("tr");
    row.dataset.member = member.name;
    const button = make("button", undefined, "switch");
    button.type = "button";
    button.setAttribute("role", "switch");
    button.setAttribute("aria-label", member.name);
    button.onclick = () => change("members", { members: [member.name], enabled: button.getAttribute("aria-checked") !== "true" }, button);
    const name = make("td", undefined, "name");
    const [front, extractor] = [member.name.slice(0, member.name.lastIndexOf("/")), member.name.slice(member.name.lastIndexOf("/") + 1)];
    const small = make("small");
    const [method, window] = front.split("@");
    name.append(method, small);
    const parts = `${window ?? ""} · ${extractor}`;
    const canvas = make("canvas", undefined, "cells");
    canvas.setAttribute("role", "img");
    const share = make("td", "", "number");
    const weight = make("input");
    weight.type = "number";
    weight.min = 0;
    weight.step = 0.1;
    weight.setAttribute("aria-label", `weight of ${member.name}`);
    weight.onchange = () => change("members", { members: [member.name], weight: weight.valueAsNumber }, weight);
    const cost = make("td", "", "number wide");
    const cell = (child, className) => {
      const td = make("td", undefined, className);
      td.append(child);
      return td;
    };
    row.append(cell(button), name, cell(canvas), share, cell(weight, "number"), cost);
    return { row, button, small, parts, canvas, share, weight, cost };
  });
  at("member-rows").replaceChildren(...memberRows.map((m) => m.row));
}

function drawMembers() {
  const states = run.status ? run.status.members : [];
  const on = states.filter((m) => m.enabled).length;
  at("members-of").textContent = states.length ? `${on} of ${states.length} on` : "";
  const [yes, no, none] = [color("--mark"), color("--answer"), color("--line")];
  memberRows.forEach((member, index) => {
    const state = states[index];
    if (state) {
      member.button.setAttribute("aria-checked", state.enabled);
      member.row.classList.toggle("off", !state.enabled);
      if (document.activeElement !== member.weight) member.weight.value = state.weight;
      const cost = state.reconstruct_ms + state.extract_ms;
      member.cost.textContent = state.enabled && cost > 0 ? cost.toFixed(2) : "–";
    }
    member.button.disabled = member.weight.disabled = !mayChange();
    const agreed = run.agreed[index];
    const known = agreed.filter((how) => how !== "none");
    const good = known.filter((how) => how === "yes").length;
    member.share.textContent = known.length ? `${Math.round((100 * good) / known.length)} %` : "–";
    member.canvas.setAttribute("aria-label", `agreed ${good} times of ${known.length}`);
    const { context, width, height } = sheet(member.canvas);
    const step = width / AGREED;
    agreed.forEach((how, i) => {
      const x = (AGREED - agreed.length + i) * step;
      context.fillStyle = how === "yes" ? yes : how === "no" ? no : none;
      const tall = how === "yes" ? height : how === "no" ? height * 0.4 : 2;
      context.fillRect(x, height - tall, Math.max(step - 0.8, 0.8), tall);
    });
  });
  drawTrouble();
}

// What kept a member's row away from the newest answer.
function drawTrouble() {
  const missing = run.answers.at(-1)?.missing ?? {};
  memberRows.forEach((member, index) => {
    const state = run.status?.members[index];
    const name = graph.members[index].name;
    const why = state && state.shed ? "shed by the governor" : missing[name];
    member.small.textContent = why ? `${member.parts} · ${why}` : member.parts;
    member.small.classList.toggle("trouble", Boolean(missing[name]));
  });
}

// ---- processes and the log

function drawProcesses() {
  if (!run.status) return;
  const table = run.status.services.map((service) => {
    const moved = run.processes.get(service.name);
    const recent = moved && moved.moved === "back" && Date.now() - moved.at < BACK_MS;
    const down = moved && moved.moved !== "back";
    const state = down ? moved.moved : recent ? "back" : service.state;
    const row = make("tr");
    row.dataset.process = service.name;
    row.dataset.state = state;
    row.classList.toggle("bad", ["down", "given_up", "restarting"].includes(state));
    const chip = make("span", state === "given_up" ? "given up" : state, "chip");
    chip.dataset.state = state;
    const doing = make("td");
    doing.append(chip, " ", make("span", state === "ready" ? service.doing : "", "faint"));
    row.append(make("td", service.name, "name"), doing);
    const some = (times, key) => (times.last_10s.count ? time(times.last_10s[key]) : "–");
    const cells = [
      count(service.received_per_s), count(service.emitted_per_s), count(service.dropped), some(service.waiting, "p99_us"),
      some(service.processing, "p50_us"), some(service.processing, "p99_us"), `${service.cpu_percent.toFixed(0)} %`,
      (service.rss_bytes / 2 ** 20).toFixed(0), service.restarts,
    ];
    cells.forEach((text, index) => {
      const alarming = (index === 2 && service.dropped > 0) || (index === 8 && service.restarts > 0);
      row.append(make("td", text, alarming ? "number drops" : "number"));
    });
    return row;
  });
  at("process-rows").replaceChildren(...table);
}

function drawLog() {
  const items = run.log.map((entry) => {
    const item = make("li");
    const when = make("time", clock(entry.ms));
    item.append(when, make("span", entry.text, entry.kind));
    return item;
  });
  at("log").replaceChildren(...(items.length ? items : [make("li", "Nothing yet: no process died, and nothing was changed.", "faint")]));
}
