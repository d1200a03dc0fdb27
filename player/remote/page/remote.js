"use strict";
// The remote of a show. Requests and properties are those of the control socket (docs/unattended.md); which controls
// there are stands in the page, the player says what each takes.

const PICTURE_MS = 250, DRAG_MS = 80, RETRY_MS = 1500, WINDOW_S = 10, REACH_PX = 44;
const LATE = ["<1", "2", "4", "8", "16", "32", "64", ">64", "drop"]; // labels in ms

const $ = (id) => document.getElementById(id);
const make = (tag, settings = {}, ...children) => {
  const element = Object.assign(document.createElement(tag), settings);
  element.append(...children);
  return element;
};

let socket, number = 0, known = {}, shown = "camera", over = false;
let serial = { camera: -1, screen: -1 };
const waiting = new Map(), values = {}, watchers = {}, held = new Set();

// The connection

// answered: the player has just served a page, so a refused socket means a wrong token, not a player that is starting
function connect(answered = false) {
  const token = location.hash.slice(1);
  if (!token) return ask("");
  let opened = false;
  socket = new WebSocket(location.origin.replace(/^http/, "ws") + "/socket", ["counterlight", token]);
  socket.onopen = () => { opened = true; over = false; say(""); document.body.classList.remove("away"); };
  socket.onmessage = (message) => hear(JSON.parse(message.data));
  socket.onclose = () => {
    document.body.classList.add("away");
    badge(over ? "ended" : "no connection", "");
    waiting.forEach((answer) => answer({ error: "no connection", data: null }));
    waiting.clear();
    serial = { camera: -1, screen: -1 };
    if (opened) setTimeout(connect, RETRY_MS);
    else if (answered) ask("The player does not take this token, or has no room for one more.");
    else fetch("/").then(() => connect(true), () => setTimeout(connect, RETRY_MS));
  };
}

function ask(why) {
  if (why) $("why").textContent = why;
  $("token").value = "";
  if (!$("door").open) $("door").showModal();
}

function send(...command) {
  if (!socket || socket.readyState !== WebSocket.OPEN) return Promise.resolve({ error: "no connection", data: null });
  number += 1;
  socket.send(JSON.stringify({ command, request_id: number }));
  return new Promise((answer) => waiting.set(number, answer));
}

async function run(...command) {
  const answer = await send(...command);
  if (answer.error !== "success") say(answer.message || answer.error, true);
  else if (typeof answer.data === "string") say(answer.data);
  return answer;
}

const set = (name, value) => run("set_property", name, value);

function hear(message) {
  if (message.event === "known") learn(message.properties);
  else if (message.event === "properties") Object.entries(message.values).forEach(take);
  else if (message.event === "shutdown") over = true;
  else if (waiting.has(message.request_id)) {
    waiting.get(message.request_id)(message);
    waiting.delete(message.request_id);
  }
}

function take([name, value]) {
  values[name] = value;
  (watchers[name] || []).forEach((watch) => watch(value));
}

const watch = (name, act) => (watchers[name] ||= []).push(act);
const say = (text, wrong = false) => { $("message").textContent = text; $("message").classList.toggle("wrong", wrong); };
const badge = (text, kind) => { $("health").textContent = text; $("health").className = `badge ${kind}`; };

// A control for each property that the page names

function learn(properties) {
  known = properties;
  document.querySelectorAll("[data-property]").forEach((place) => {
    const info = known[place.dataset.property];
    watchers[place.dataset.property] = (watchers[place.dataset.property] || []).filter((act) => !act.ofControl);
    place.replaceChildren();
    if (!info || !info.writable) return;
    const act = { flag: flag, choice: choice, integer: range, number: range }[info.type](place, info);
    act.ofControl = true;
    watch(info.name, act);
    if (info.name in values) act(values[info.name]);
  });
}

function label(place, info, control) {
  control.id = `set-${info.name}`;
  const words = info.name.replaceAll("-", " ");
  place.append(make("label", { htmlFor: control.id, title: info.help, textContent: words[0].toUpperCase() + words.slice(1) }));
}

function flag(place, info) {
  const box = make("input", { type: "checkbox", onchange: () => set(info.name, box.checked) });
  label(place, info, box);
  place.append(box);
  return (value) => { place.hidden = value === null; box.checked = Boolean(value); };
}

function choice(place, info) {
  const list = make("select", { onchange: () => set(info.name, list.value) },
    ...info.choices.map((word) => make("option", { value: word, textContent: word })));
  label(place, info, list);
  place.append(list);
  return (value) => { list.value = value; };
}

function range(place, info) {
  const top = info.max === null ? 100 : info.max, whole = info.type === "integer";
  const steep = info.min > 0 && top / info.min > 1000; // such a range is gone through by factors
  const at = steep ? Math.log10 : (value) => value, from = steep ? (place) => 10 ** place : (place) => place;
  const slider = make("input", { type: "range", min: at(info.min), max: at(top), step: whole ? 1 : (at(top) - at(info.min)) / 200 });
  const said = make("output");
  const words = info.choices.map((word) => make("button", { textContent: word, onclick: () => set(info.name, word) }));
  const value = () => Number(from(Number(slider.value)).toPrecision(3));
  label(place, info, slider);
  place.append(make("div", { className: "number" }, slider, ...words), said);
  const tell = throttle(() => set(info.name, value()), DRAG_MS);
  hold(slider, info.name);
  slider.oninput = () => { said.textContent = text(value(), info.unit); tell(); };
  slider.ondblclick = () => { if (info.min < 0) set(info.name, 0); };
  return (current) => {
    place.hidden = current === null; // no sound, say
    words.forEach((button) => button.setAttribute("aria-pressed", button.textContent === current));
    if (held.has(info.name)) return;
    if (typeof current === "number") slider.value = at(current);
    said.textContent = text(current, info.unit);
  };
}

const text = (value, unit) => (typeof value === "number" ? `${Number(value.toPrecision(3))}${unit === "%" ? " %" : ""}` : String(value ?? ""));

// While a finger holds a slider, what the player says of it is not put in its place.
function hold(slider, name) {
  slider.onpointerdown = () => held.add(name);
  slider.onpointerup = slider.onpointercancel = slider.onblur = () => held.delete(name);
}

function throttle(act, milliseconds) {
  let due = 0, timer = null;
  return (...words) => {
    clearTimeout(timer);
    const wait = due - Date.now();
    if (wait > 0) { timer = setTimeout(() => { due = Date.now() + milliseconds; act(...words); }, wait); return; }
    due = Date.now() + milliseconds;
    act(...words);
  };
}

// What plays

const clock = (seconds) => {
  const whole = Math.floor(seconds || 0), minutes = Math.floor(whole / 60), rest = String(whole % 60).padStart(2, "0");
  return minutes < 60 ? `${minutes}:${rest}` : `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, "0")}:${rest}`;
};
const base = (path) => path.split("/").pop();
const seek = $("seek"), goTo = throttle(() => set("time-pos", Number(seek.value)), 200);

hold(seek, "time-pos");
seek.oninput = () => { $("now").textContent = clock(Number(seek.value)); goTo(); };
watch("duration", (seconds) => { seek.disabled = !seconds; seek.max = seconds || 1; $("end").textContent = seconds ? clock(seconds) : ""; });
watch("time-pos", (seconds) => { if (!held.has("time-pos")) { seek.value = seconds || 0; $("now").textContent = clock(seconds); } });
watch("pause", (paused) => { document.body.classList.toggle("paused", paused); $("pause").ariaLabel = paused ? "Play" : "Pause"; });
watch("path", (path) => { $("medium").textContent = path ? base(path) : "Counterlight"; document.title = $("medium").textContent; });
watch("message", (message) => { if (message) say(message); });
watch("playlist", listMedia);
watch("playlist-playing-pos", () => listMedia(values.playlist || []));
$("pause").onclick = () => set("pause", !values.pause);

const MOST_LISTED = 500;
let lifted = null; // position of the medium that is dragged
function listMedia(media) {
  if (lifted !== null) return; // until it is dropped
  const first = Math.max(0, Math.min((values["playlist-playing-pos"] || 0) - MOST_LISTED / 2, media.length - MOST_LISTED));
  $("playlist").replaceChildren(...media.slice(first, first + MOST_LISTED).map((path, index) => {
    const button = make("button", { textContent: base(path), title: path, onclick: () => set("playlist-pos", first + index) });
    const place = first + index, grip = make("span", { className: "grip", title: "Drag to move" });
    button.setAttribute("aria-current", place === values["playlist-playing-pos"]);
    const remove = make("button", { className: "remove", textContent: "×", title: "Remove", onclick: () => run("playlist-remove", place) });
    remove.setAttribute("aria-label", `Remove ${base(path)}`);
    const row = make("li", {}, grip, button, remove);
    grip.onpointerdown = (event) => { lifted = place; row.classList.add("lifted"); grip.setPointerCapture(event.pointerId); event.preventDefault(); };
    grip.onpointermove = (event) => { if (lifted !== null) dropAt(event.clientY); };
    grip.onpointerup = grip.onpointercancel = (event) => {
      if (lifted === null) return;
      const [from, to] = [lifted, first + dropAt(event.clientY)];
      lifted = null;
      if (event.type === "pointerup" && to !== from && to !== from + 1) run("playlist-move", from, to);
      listMedia(values.playlist || []);
    };
    return row;
  }));
}

// The row before which a lifted medium would be dropped, marked.
function dropAt(y) {
  const rows = [...$("playlist").children];
  const below = rows.findIndex((row) => { const box = row.getBoundingClientRect(); return y < box.top + box.height / 2; });
  const at = below < 0 ? rows.length : below;
  rows.forEach((row, index) => {
    row.classList.toggle("before", index === at);
    row.classList.toggle("after", at === rows.length && index === at - 1);
  });
  return at;
}

// Files below the folders that the player may play from

async function browse(folder, above) {
  const { data } = await run("browse", ...(folder ? [folder] : []));
  if (!data) return;
  $("folder").textContent = folder || "Folders";
  const up = above ? [entry("‹ Back", () => browse(...above))] : [];
  const folders = data.folders.map((path) => entry(`${folder ? base(path) : path} ›`, () => browse(path, [folder, above])));
  const files = data.files.map((path) => make("li", {},
    make("button", { textContent: base(path), title: `Play ${path}`, onclick: () => run("loadfile", path, "replace") }),
    make("button", { textContent: "Next", title: "Play after the present medium", onclick: () => run("loadfile", path, "insert-next") }),
    make("button", { textContent: "Add", title: "Put at the end of the list", onclick: () => run("loadfile", path, "append") })));
  $("files").replaceChildren(...up, ...folders, ...files);
  if (!$("browser").open) $("browser").showModal();
}
const entry = (textContent, onclick) => make("li", {}, make("button", { textContent, onclick }));
$("browse").onclick = () => browse("");
$("close-browser").onclick = () => $("browser").close();

$("load").onsubmit = (event) => {
  event.preventDefault();
  if ($("path").value) run("loadfile", $("path").value, event.submitter?.value || "replace");
};

// Buttons that run a command, and those that are a flag

document.querySelectorAll("[data-run]").forEach((button) => {
  button.onclick = async () => {
    if (button.dataset.sure && !confirm(button.dataset.sure)) return;
    const [name, ...words] = button.dataset.run.split(" ");
    await run(name, ...words.map((word) => (isNaN(word) ? word : Number(word))));
    if (name === "place" && !values.corners) run("place-fit"); // so that there are corners to drag
    if (name === "place") show("camera");
  };
});
document.querySelectorAll("[data-flag]").forEach((button) => {
  const name = button.dataset.flag;
  button.onclick = () => set(name, !values[name]);
  watch(name, (on) => { button.setAttribute("aria-pressed", on); veil(); });
});
$("door").onclose = () => { if ($("token").value.trim()) { location.hash = $("token").value.trim(); location.reload(); } };
$("measure").onclick = async () => {
  const { data } = await run("get_property", "psnr");
  say(data === null ? "Not known without compensation, or for maps without refinement." : `Predicted: ${data.toFixed(1)} dB against the picture that is wanted.`);
};

// Previews: the next is asked for when the last has come, and only while somebody looks

function show(name) {
  shown = name;
  document.querySelectorAll("[data-preview]").forEach((tab) => tab.setAttribute("aria-selected", tab.dataset.preview === name));
  outline();
}
document.querySelectorAll("[data-preview]").forEach((tab) => { tab.onclick = () => show(tab.dataset.preview); });

let painted = "";
async function look() {
  if (!document.hidden && socket?.readyState === WebSocket.OPEN) {
    const name = shown, answer = await send("preview", name, painted === name ? serial[name] : -1);
    if (answer.data && name === shown) {
      serial[name] = answer.data.serial;
      painted = name;
      $("preview").src = `data:image/jpeg;base64,${answer.data.jpeg}`;
    }
  }
  setTimeout(look, PICTURE_MS);
}

function veil() {
  $("veil").textContent = values.blackout ? "the screen is black" : values.checking ? "the room is being checked" : "";
  frame.classList.toggle("dark", Boolean(values.blackout || values.checking));
}
watch("checking", (on) => { $("check").disabled = Boolean(on); veil(); });

// Placement: corners in shares of the camera's view

const frame = $("frame"), handles = [0, 1, 2, 3].map(() => make("i"));
$("handles").append(...handles);
let grip = null; // how far the finger is from what it holds
const drag = throttle((x, y) => send("place-drag", x, y), DRAG_MS);

function outline() {
  const corners = values.corners, placing = Boolean(values.placing);
  document.body.classList.toggle("placing-now", placing);
  frame.classList.toggle("placing", placing && Boolean(corners) && shown === "camera");
  if (!corners) return;
  $("quad").setAttribute("points", corners.map(([x, y]) => `${x},${y}`).join(" "));
  corners.forEach(([x, y], index) => {
    handles[index].style.left = `${100 * Math.min(Math.max(x, 0), 1)}%`;
    handles[index].style.top = `${100 * Math.min(Math.max(y, 0), 1)}%`;
  });
}
watch("corners", outline);
watch("placing", outline);

const inView = (event) => {
  const box = frame.getBoundingClientRect();
  return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height, box];
};
frame.onpointerdown = (event) => {
  if (!frame.classList.contains("placing")) return;
  const [x, y, box] = inView(event);
  const away = values.corners.map(([a, b]) => Math.hypot(
    (Math.min(Math.max(a, 0), 1) - x) * box.width, (Math.min(Math.max(b, 0), 1) - y) * box.height));
  const nearest = away.indexOf(Math.min(...away)), near = away[nearest] < REACH_PX;
  grip = near ? [values.corners[nearest][0] - x, values.corners[nearest][1] - y] : [0, 0];
  frame.setPointerCapture(event.pointerId);
  send("place-grab", x + grip[0], y + grip[1]);
};
frame.onpointermove = (event) => {
  if (!grip) return;
  const [x, y] = inView(event);
  drag(x + grip[0], y + grip[1]);
};
frame.onpointerup = frame.onpointercancel = (event) => {
  if (!grip) return;
  const [x, y] = inView(event), at = [x + grip[0], y + grip[1]];
  grip = null;
  drag(...at);
  setTimeout(() => send("place-release"), 2 * DRAG_MS);
};

// How the show goes

let past = [];
function weigh() {
  const late = values["late-frames"];
  if (!late) return;
  const counts = [...late, values.dropped || 0], now = Date.now() / 1000;
  if (past.length && counts.some((count, index) => count < past[0].counts[index])) past = []; // another player
  past = [...past.filter(({ at }) => now - at < WINDOW_S), { at: now, counts }];
  const recent = counts.map((count, index) => count - past[0].counts[index]);
  const latest = values.recent || { shown: 0, late: 0, dropped: 0, requested: 0, fps: 0 };
  const all = latest.shown + latest.dropped, behind = latest.late + latest.dropped;
  const share = all ? behind / all : 0, still = !latest.requested;
  if (!document.body.classList.contains("away")) {
    badge(values.pause ? "paused" : still ? "still" : share < 0.02 ? "on time" : share < 0.2 ? "late at times" : "too slow",
      values.pause || still ? "" : share < 0.02 ? "good" : share < 0.2 ? "fair" : "bad");
  }
  const most = Math.max(1, ...recent);
  $("late").replaceChildren(...recent.map((count, index) => {
    const bar = make("i");
    bar.style.height = `${50 * count / most}px`;
    return make("div", { title: `${count} frames` }, bar, LATE[index]);
  }));
  $("late").ariaLabel = `Frames of the last ${WINDOW_S} s by how many milliseconds late they were: ${recent.join(", ")}`;
  tellFacts(latest, behind, all);
}

function tellFacts(latest, behind, all) {
  const drift = values.drift, monitor = values.monitor;
  const rows = {
    Rate: latest.requested ? `${latest.fps.toFixed(1)} of ${Number(latest.requested.toPrecision(3))} frames per second` : "no frame is due",
    Frames: `${values.frames} shown, ${values.dropped} dropped`,
    "Last 10 s": `${all ? Math.round(100 * behind / all) : 0} % late or dropped (${latest.dropped} dropped)`,
    Steps: `${values.steps}`,
    Monitor: `${monitor}${values.fullscreen ? ", full screen" : ", in a window"}`,
    Drift: values.checking ? "the room is being checked" : drift ? driftText(drift) : "nobody has checked the room",
  };
  $("facts").replaceChildren(...Object.entries(rows).flatMap(([name, said]) => [make("dt", { textContent: name }), make("dd", { textContent: said })]));
}

const driftText = ({ checked, moved = [], gain = [] }) => {
  const shifts = moved.map(([x, y]) => `${Math.hypot(x, y).toFixed(2)} px`).join(", ");
  const light = gain.flat().map((factor) => `${Math.round(100 * factor)} %`).join(", ");
  return `${[shifts && `moved by ${shifts}`, light && `light ${light}`].filter(Boolean).join("; ")} (${new Date(checked).toLocaleString()})`;
};

// What the camera has found during the show: the state, and a line over the evening for each figure

const HISTORY_MS = 20000;
const TRENDS = { // column of the history, name of the figure now, its text, least range of the line
  Drift: [1, "moved_px", (value) => `${value.toFixed(2)} px`, 1],
  Lamp: [2, "gain", (value) => `${(100 * value).toFixed(1)} %`, 0.1],
  "Added light": [3, "added_light", (value) => `${(100 * value).toFixed(2)} %`, 0.01],
  Confidence: [4, "confidence", (value) => `${Math.round(100 * value)} %`, 1],
};
const CALM = ["holding", "correcting", "frozen"], AT_WORK = ["starting", "looking"];
const trends = Object.fromEntries(Object.keys(TRENDS).map((name) => {
  const line = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
  const chart = document.createElementNS("http://www.w3.org/2000/svg", "svg"), now = make("output");
  chart.setAttribute("viewBox", "0 -2 100 24");
  chart.setAttribute("preserveAspectRatio", "none");
  chart.append(line);
  $("trends").append(make("span", { textContent: name }), chart, now);
  return [name, { line, now }];
}));

watch("watch-state", (watching) => {
  $("watch").hidden = !watching;
  if (!watching) return;
  $("watch-state").textContent = watching.state;
  $("watch-state").className = `badge ${CALM.includes(watching.state) ? "good" : AT_WORK.includes(watching.state) ? "fair" : "bad"}`;
  $("watch-reason").textContent = watching.reason;
  Object.entries(TRENDS).forEach(([name, [, figure, said]]) => {
    trends[name].now.textContent = typeof watching[figure] === "number" ? said(watching[figure]) : "";
  });
});

async function recall() {
  if (document.hidden || !values["watch-state"]) return;
  const { data } = await send("get_property", "watch-history");
  if (!data?.length) return;
  const first = data[0][0], span = Math.max(data.at(-1)[0] - first, 1);
  Object.entries(TRENDS).forEach(([name, [column, , , range]]) => {
    const all = data.map((row) => row[column]), low = Math.min(...all), high = Math.max(...all, low + range);
    trends[name].line.setAttribute("points", data.map((row) =>
      `${(100 * (row[0] - first) / span).toFixed(2)},${(20 * (high - row[column]) / (high - low)).toFixed(2)}`).join(" "));
  });
}
setInterval(recall, HISTORY_MS);

watch("projectors", (lamps) => {
  $("lamps").hidden = !lamps?.length;
  $("projectors").replaceChildren(...(lamps || []).flatMap(({ address, power, faults, trouble, ...lamp }, number) => {
    const hours = lamp["lamp-hours"].map((count) => `${count} h of lamp`);
    const said = trouble || [power || "being asked", ...hours, ...faults].join(", ");
    const on = power === "on" || power === "warming up";
    const turn = make("button", { textContent: on ? "Off" : "On", onclick: () => {
      if (!on || confirm(`Switch ${address} off?`)) run("projector", on ? "off" : "on", number);
    } });
    return [make("dt", { textContent: address }), make("dd", { className: trouble || faults.length ? "fault" : "" }, make("span", { textContent: said }), turn)];
  }));
});

watch("events", (events) => {
  $("log").replaceChildren(...[...(events || [])].reverse().map(({ time, text }) => {
    const at = new Date(1000 * time);
    return make("li", {}, make("time", { dateTime: at.toISOString(), textContent: at.toLocaleTimeString() }), text);
  }));
});

$("seek").disabled = true;
show("camera");
setInterval(weigh, 1000);
window.onhashchange = () => location.reload();
connect();
look();
