"use strict";
// The page shows what the commands wrote, and computes nothing. All text is set as text, never as markup.

const $ = (id) => document.getElementById(id);
let state = null, shown = "", tab = "", polling = 0, last = "";

function make(tag, text, more) {
  const out = document.createElement(tag);
  if (text !== undefined && text !== null) out.textContent = text;
  for (const [key, value] of Object.entries(more || {})) {
    if (key === "on") out.addEventListener("click", value);
    else if (key === "class") out.className = value;
    else out.setAttribute(key, value);
  }
  return out;
}

const number = (v, digits = 1) => (v === null || v === undefined ? "–" : Number(v).toFixed(digits));
const micro = (v) => (v === null || v === undefined ? "–" : Math.abs(v) >= 1000 ? `${(v / 1000).toPrecision(3)}\u00a0mm` : `${Number(v).toPrecision(3)}\u00a0µm`);

async function ask(path, options) {
  let answer;
  try {
    answer = await fetch(path, options);
  } catch {
    say("The program does not answer: it has ended, or was ended in the terminal. Start it again with the same folder; nothing is lost.");
    return null;
  }
  const content = await answer.json();
  if (!answer.ok) say(content.problem);
  return answer.ok ? content : null;
}

function say(problem) {
  $("problem").textContent = problem || "";
  $("problem").hidden = !problem;
}

async function act(path) {
  say("");
  await ask(path, { method: "POST", body: "" });
  await refresh();
}

const run = (action, more) => act(`run?${new URLSearchParams({ action, ...more })}`);

async function refresh() {
  clearTimeout(polling);
  const content = await ask("state");
  if (content) {
    const text = JSON.stringify(content);
    if (text !== last) {
      last = text;
      state = content;
      draw();
    }
  }
  const busy = content && content.jobs.some((j) => j.state === "runs" || j.state === "waits");
  polling = setTimeout(refresh, busy ? 400 : 1000);
}

function draw() {
  const begun = state.data && state.robot;
  $("start").hidden = Boolean(begun);
  $("loop").hidden = !begun;
  const parts = [state.data, state.robot].filter(Boolean).join(" · ");
  const rows = state.inspect.rows ? `: ${state.inspect.fit} rows to fit, ${state.inspect.check} held out` : "";
  $("files").textContent = parts ? parts + rows : "No data yet.";
  drawWork();
  if (!begun) return;
  drawHistory();
  drawChart();
  drawDownloads();
  drawVerdict();
  drawMap();
  drawCandidates();
  drawPicture();
}

function drawWork() {
  const running = state.jobs.find((j) => j.state === "runs");
  const waiting = state.jobs.filter((j) => j.state === "waits").length;
  $("work").textContent = running ? `${running.says} … ${number(running.seconds, 0)} s${waiting ? `, ${waiting} more` : ""}` : "";
  $("cancel").hidden = !running;
  const ended = [...state.jobs].reverse().find((j) => j.state === "failed" || j.state === "done"); // those behind one that fails are cancelled
  if (ended && ended.state === "failed" && shown !== `failed${ended.number}`) {
    shown = `failed${ended.number}`;
    say(`${ended.says} did not end well.\n${ended.said.trim()}`);
    if (!state.steps.length && /\.csv$/i.test(state.data)) $("problem").append(make("p"), make("button", "Name the columns", { on: nameColumns }));
  }
}

function drawHistory() {
  const list = state.steps.map((step, i) => {
    const item = make("li");
    const button = make("button", `${i + 1} · ${step.title}`, { on: () => act(`at?step=${i}`) });
    if (i === state.at) button.setAttribute("aria-current", "step");
    const f = step.figures;
    button.append(make("small", `${micro(f.rms)} fit · ${micro(f.rms_check)} held\u00a0out`));
    if (f.u95) button.append(make("small", `95\u00a0% of landings: ${micro(f.u95)}`));
    item.append(button);
    return item;
  });
  $("history").replaceChildren(...list);
  $("back").hidden = state.at < 0 || state.at === state.steps.length - 1;
}

function drawChart() {
  const NS = "http://www.w3.org/2000/svg", W = 220, H = 132, left = 34, top = 20, bottom = 18;
  const draw = (tag, more, text) => {
    const out = document.createElementNS(NS, tag);
    for (const [k, v] of Object.entries(more)) out.setAttribute(k, v);
    if (text) out.textContent = text;
    return out;
  };
  const steps = state.steps.map((s) => s.figures).filter((f) => f.rms);
  const svg = draw("svg", { viewBox: `0 0 ${W} ${H}` });
  const most = Math.max(1, ...steps.flatMap((f) => [f.rms, f.rms_check || 0, f.u95 || 0]));
  const x = (i) => left + 8 + (steps.length > 1 ? (i * (W - left - 20)) / (steps.length - 1) : 0);
  const y = (v) => top + (1 - v / most) * (H - bottom - top);
  for (const v of [0, most / 2, most]) {
    svg.append(draw("line", { x1: left, x2: W, y1: y(v), y2: y(v), stroke: "currentColor", "stroke-opacity": 0.2 }));
    svg.append(draw("text", { x: left - 4, y: y(v) + 3, "text-anchor": "end" }, v ? Number(v).toPrecision(2) : "0"));
  }
  const series = [["rms", "fit", "#4a90d9"], ["rms_check", "held out", "#e07b2f"], ["u95", "95 % land", "#8a8f98"]];
  series.forEach(([key, name, colour], n) => {
    const points = steps.map((f, i) => [i, f[key]]).filter(([, v]) => v);
    svg.append(draw("polyline", { points: points.map(([i, v]) => `${x(i)},${y(v)}`).join(" "), fill: "none", stroke: colour, "stroke-width": 2 }));
    points.forEach(([i, v]) => svg.append(draw("circle", { cx: x(i), cy: y(v), r: 3, fill: colour })));
    svg.append(draw("text", { x: left + n * 58, y: H - 4, class: key }, name));
  });
  svg.append(draw("text", { x: left - 4, y: 9, "text-anchor": "end" }, "µm"));
  $("chart").setAttribute("aria-label", `Error by step in µm: ${steps.map((f) => `${micro(f.rms)} fit, ${micro(f.rms_check)} held out`).join("; ")}`);
  $("chart").replaceChildren(svg);
}

function drawDownloads() {
  const link = (href, text, name) => {
    const item = make("li");
    item.append(make("a", text, { href, download: name }));
    return item;
  };
  const step = state.steps[state.at];
  const list = [];
  if (step) list.push(link(`file?name=${encodeURIComponent(step.model)}`, `model of this step (${step.model})`, step.model));
  if (state.files.includes("commands.csv")) list.push(link("file?name=commands.csv", "commands with their uncertainty", "commands.csv"));
  if (state.files.includes("plan.csv")) list.push(link("file?name=plan.csv", "rows to measure next", "plan.csv"));
  list.push(link("session.sh", "this session as a shell script", "session.sh"), link("session.py", "and as Python", "session.py"));
  $("downloads").replaceChildren(...list);
  const computed = [...state.jobs].reverse().find((j) => j.words[1] === "compensate" && j.state === "done");
  $("commands").textContent = computed ? computed.said.trim() : "";  // also how many targets were refused
}

function drawVerdict() {
  const found = state.written.diagnose;
  $("verdict").textContent = found ? found.sentence : "Not looked for yet.";
  const out = [];
  for (const next of (found && found.next) || []) {
    if (next.do === "add") out.push(make("button", `Add ${next.effect}`, { class: "main", on: () => run("add", { effect: next.effect }) }));
    if (next.do === "next") {
      const between = next.between.join(",");
      out.push(make("button", `Plan what tells ${next.between.join(" from ")}`, { on: () => run("plan", { between }) }));
    }
  }
  if (found && (found.verdict === "unexplained" || (found.laws || []).length)) out.push(make("button", "Search for a law", { on: () => run("propose", {}) }));
  if (!found && state.steps.length) out.push(make("button", "Look for what is missing", { on: () => run("diagnose", {}) }));
  if (!state.steps.length) out.push(make("button", "Fit", { class: "main", on: () => run("begin", {}) }));
  const laws = state.written.laws;
  for (const law of ((laws && laws.laws) || []).slice(0, 3)) {
    const line = make("p", `Law: ${law.words} `);
    if (/^laws\/[^+]+:\w+$/.test(law.spec)) {
      for (const [action, text] of [["look", "Look"], ["try", "Try"], ["add", "Add"]]) {
        line.append(make("button", text, { "aria-label": `${text} ${law.spec}`, on: () => withCode(law.spec, () => { if (action === "look") tab = "look"; run(action, { effect: law.spec }); }) }), " ");
      }
    }
    out.push(line);
  }
  const code = state.steps.length ? (state.steps[state.at].code || []).find((spec) => !state.agreed.includes(spec)) : null;
  if (code) out.unshift(make("p", "This model has a law whose code has not been looked at since the program was started."), make("button", "Show its code", { on: () => withCode(code, refresh) }));
  const tried = state.written.try;
  if (tried && tried.after) {
    const rest = tried.held_out && tried.held_out.confirmed ? "held-out poses confirm it" : "held-out poses do not confirm it";
    out.push(make("p", `Tried ${tried.effect}: ${micro(tried.before.rms_pos_um)} → ${micro(tried.after.rms_pos_um)} RMS; ${rest}. Nothing is kept.`));
  }
  $("advice").replaceChildren(...out);
}

function drawMap() {
  const cells = (state.written.diagnose || state.written.compare || {}).heatmap || [];
  const variables = [...new Set(cells.map((c) => c.variable))].slice(0, 9); // the hottest come first
  const channels = [...new Set(cells.filter((c) => variables.includes(c.variable)).map((c) => c.channel))];
  const called = { actuator: "motors", body: "plate", parallelogram: "pairs", rod: "rods", tool: "tool" };
  const table = make("table");
  const head = make("tr");
  head.append(make("th", ""), ...channels.map((c) => make("th", called[c] || c, { class: "cell", title: c })));
  table.append(head);
  for (const variable of variables) {
    const row = make("tr");
    row.append(make("th", variable, { scope: "row" }));
    for (const channel of channels) {
      const cell = cells.find((c) => c.channel === channel && c.variable === variable);
      const item = make("td", cell ? number(cell.s) : "", { class: "cell" });
      if (cell) {
        const heat = cell.p < 0.05 ? Math.min(1, -Math.log10(cell.p + 1e-9) / 3.6) : 0;
        item.style.background = `rgba(224, 110, 30, ${0.75 * heat})`;
        item.replaceChildren(make("button", number(cell.s), { class: "cell", "aria-label": `Draw ${called[channel] || channel} by ${variable}`, on: () => { tab = "cell"; run("cell", { cell: `${channel}:${variable}` }); } }));
        item.title = `p ${cell.p < 0.001 ? "< 0.001" : number(cell.p, 3)}; beside the hottest ${number(cell.s_left)}`;
      }
      row.append(item);
    }
    table.append(row);
  }
  $("map").replaceChildren(...(cells.length ? [table, make("p", "Noise units; orange where that is more than chance. A click draws the points.", { class: "quiet" })] : [make("p", "–")]));
}

function drawCandidates() {
  const found = state.written.diagnose;
  const list = ((found && found.candidates) || []).slice(0, 10);
  const table = make("table");
  const head = make("tr");
  head.append(make("th", "effect"), make("th", "s", { class: "number" }), make("th", "p", { class: "number" }), make("th", ""), make("th", ""));
  table.append(head);
  for (const c of list) {
    const row = make("tr"), buttons = make("td", "", { class: "buttons" });
    for (const [action, text] of [["look", "Look"], ["try", "Try"], ["add", "Add"]]) {
      buttons.append(make("button", text, { "aria-label": `${text} ${c.spec}`, on: () => { if (action === "look") tab = "look"; run(action, { effect: c.spec }); } }));
    }
    row.append(
      make("td", c.spec, { title: c.note || "" }), make("td", number(c.s), { class: "number" }),
      make("td", c.p < 0.001 ? "< 0.001" : number(c.p, 3), { class: "number" }),
      make("td", c.adequate ? "explains" : "", { class: "yes" }), buttons,
    );
    table.append(row);
  }
  $("candidates").replaceChildren(...(list.length ? [table] : [make("p", "–")]));
}

function drawPicture() {
  const step = state.steps[state.at];
  const stem = step ? step.model.replace(/\.toml$/, "") : "";
  const pictures = [["fit", "Fit", `${stem}.html`], ["robot", "Robot in 3D", `${stem}.rrd`], ["compare", "Compare", `${stem}.compare.html`], ["diagnose", "Diagnosis", `${stem}.diagnose.html`], ["look", "Look", `${stem}.look.html`], ["cell", "Points", `${stem}.cell.html`], ["try", "Tried", `${stem}.try.html`]]
    .filter(([id, , name]) => state.files.includes(name) && (id !== "robot" || state.viewer));
  if (!pictures.some(([id]) => id === tab)) tab = pictures.length ? pictures[0][0] : "";
  const tabs = pictures.map(([id, text]) => make("button", text, { role: "tab", "aria-selected": String(id === tab), on: () => { tab = id; drawPicture(); } }));
  $("tabs").replaceChildren(...tabs);
  const chosen = pictures.find(([id]) => id === tab);
  if (step && !state.files.includes(`${stem}.rrd`)) {
    $("tabs").append(make("button", "Draw the robot in 3D", { on: () => { tab = "robot"; run("view", {}); } }));
  }
  const robot = chosen && chosen[0] === "robot";
  let source = chosen ? `file?name=${encodeURIComponent(chosen[2])}` : "about:blank";
  if (robot) {
    const recording = new URL(`recording/${encodeURIComponent(chosen[2])}`, location.href).href;
    source = `${state.viewer}?url=${encodeURIComponent(recording)}&hide_welcome_screen=1`;
  }
  const version = `${source}#${robot ? "" : state.commands.length}`;
  const frame = $("picture");
  if (frame.dataset.version !== version) {
    const fresh = frame.cloneNode(false); // what a frame may do is decided when it is made
    fresh.dataset.version = version;
    if (robot) fresh.setAttribute("sandbox", "allow-scripts allow-same-origin");
    else fresh.setAttribute("sandbox", "");
    fresh.src = source;
    frame.replaceWith(fresh);
  }
}

const named = (file) => file.name.replace(/[^A-Za-z0-9 ._-]/g, "_");
const upload = (file, as) => ask(`upload?${new URLSearchParams({ name: named(file), ...(as ? { as } : {}) })}`, { method: "POST", body: file });

// A data file for a session that has one already: more rows of the same robot, or a new beginning.
function question(file) {
  const close = () => { $("question").hidden = true; };
  $("question").replaceChildren(
    make("p", `${file.name}: are these further measurements, to be joined to ${state.data}?`),
    make("button", "Join them and fit all again", { class: "main", on: async () => { close(); await run("more", { rows: named(file) }); } }),
    make("button", "Begin anew with them", { on: async () => { close(); if (await upload(file)) { await refresh(); await run("begin", {}); } } }),
    make("button", "Neither", { on: close }),
  );
  $("question").hidden = false;
  $("question").querySelector("button").focus();
}

// A law is a short program: it is shown before it runs.
async function withCode(spec, next) {
  if (state.agreed.includes(spec)) return next();
  const found = await ask(`code?${new URLSearchParams({ spec })}`);
  if (!found) return;
  const close = () => { $("question").hidden = true; };
  $("question").replaceChildren(
    make("p", `${spec} is a program that runs on this computer. Read it first:`), make("pre", found.text),
    make("button", "Run it", { class: "main", on: async () => { close(); if (await ask(`agree?${new URLSearchParams({ spec, digest: found.digest })}`, { method: "POST", body: "" })) { await refresh(); next(); } } }),
    make("button", "Leave it", { on: close }),
  );
  $("question").hidden = false;
}

// Columns whose names are unknown are named by hand, as a line '# columns = …' above the header does.
async function nameColumns() {
  const found = await ask("columns");
  if (!found) return;
  const inputs = found.columns.map((name) => make("input", null, { value: name, list: "known", "aria-label": `Name of column ${name}` }));
  const list = make("datalist", null, { id: "known" });
  list.append(...found.known.map((name) => make("option", null, { value: name })));
  const table = make("table");
  found.columns.forEach((name, i) => {
    const row = make("tr"), cell = make("td");
    cell.append(inputs[i]);
    row.append(make("td", name), cell);
    table.append(row);
  });
  $("question").replaceChildren(
    make("p", `What do the columns of ${state.data} hold? The unit stands in the name: q1_deg, x_mm.`), list, table,
    make("button", "Read it so", { class: "main", on: async () => { const names = inputs.map((i) => i.value).join(","); $("question").hidden = true; await act(`columns?${new URLSearchParams({ names })}`); } }),
    make("button", "Leave it", { on: () => { $("question").hidden = true; } }),
  );
  $("question").hidden = false;
  inputs[0].focus();
}

async function hand(list, as) {
  say("");
  for (const file of list) {
    if (!as && state && state.steps.length && /\.(csv|parquet)$/i.test(file.name) && file.name !== state.data) {
      if (await upload(file, "rows")) question(file);
      return null;
    }
    if (!(await upload(file, as))) return null;
  }
  await refresh();
  if (!as && state.data && state.robot && !state.steps.length) await run("begin", {});
  return list.length ? named(list[0]) : null;
}

$("drop").addEventListener("click", () => $("choose").click());
$("drop").addEventListener("keydown", (e) => { if (e.key === "Enter" || e.key === " ") $("choose").click(); });
$("choose").addEventListener("change", () => hand($("choose").files));
for (const name of ["dragover", "drop", "dragleave"]) {
  document.addEventListener(name, (e) => {
    e.preventDefault();
    $("drop").classList.toggle("over", name === "dragover");
    if (name === "drop") hand(e.dataTransfer.files);
  });
}
$("example").addEventListener("click", () => act("example"));
$("cancel").addEventListener("click", () => act("cancel"));
$("back").addEventListener("click", () => act("back"));
$("targets").addEventListener("click", () => $("target-file").click());
$("target-file").addEventListener("change", async () => {
  const name = await hand($("target-file").files, "targets");
  if (name) await run("compensate", { targets: name, tool: $("tool").value });
});
refresh();
