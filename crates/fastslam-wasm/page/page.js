"use strict";
/* Joins the filter, the panels and whoever drives. */

const SET = { seed: 1, side_m: 40, ...LESSONS[0].set };
const SHOW = {};
const TICK_S = 0.05, TICKS_PER_SCAN = 5;
const KEYS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1],
  KeyW: [1, 0], KeyS: [-1, 0], KeyA: [0, 1], KeyD: [0, -1] };
const byId = (id) => document.getElementById(id);

const state = { engine: null, panels: [], view: null, log: null, lesson: 0, auto: true, held: new Set(), goal: null,
  owed: 0, ticks: 0, before: 0, playing: true, colour: colours(), frames: [] };

/* The settings as the filter wants them. */
function settings() {
  const { sensor_noise, ...rest } = SET;
  return { ...rest, range_std_m: 0.2 * sensor_noise, bearing_std_rad: 0.03 * sensor_noise };
}

function complain(error) {
  byId("problem").hidden = error === null;
  if (error !== null) byId("problem").textContent = error.message || String(error);
}

/* Begins anew with what is set. */
function begin() {
  complain(null);
  try {
    if (state.log) {
      const about = state.engine.ask("load", { files: state.log, settings: settings() });
      byId("notes").textContent = about.notes.join(". ") + ".";
      state.playing = true;
    } else state.engine.ask("begin", { settings: settings() });
  } catch (error) {
    state.log = null;
    byId("notes").textContent = "";
    state.engine.ask("begin", { settings: settings() });
    complain(error);
  }
  Object.assign(state, { owed: 0, ticks: 0, goal: null });
  state.view = new View(state.log ? 5 : SET.side_m / 2 + 1);
  byId("panels").replaceChildren();
  byId("panels").style.setProperty("--columns", SET.filters.length);
  state.panels = SET.filters.map((filter, i) => new Panel(filter, i, byId("panels")));
  for (const id of ["auto", "other"]) byId(id).disabled = state.log !== null;
  const drawn = SET.redraws !== "never" && SET.filters.some((filter) => filter !== "ekf");
  byId("redraw").disabled = !drawn;
  look(true);
}

/* Reads what there is to draw. */
function look(scanned) {
  const [now, landmarks, path, reported] = state.engine.ask("world");
  state.scene = { now, landmarks, path, reported };
  state.view.include(reported.slice(-2));
  for (const panel of state.panels) {
    if (scanned) {
      panel.learn(state.engine.ask("map", { filter: panel.index }));
      if (state.log) state.view.include(panel.best.slice(-2), 10);
    }
    panel.believe(state.engine.ask("now", { filter: panel.index }), now);
    panel.truth = Number.isNaN(now[0]) ? undefined : now.slice(0, 3);
    if (scanned) panel.note();
  }
}

/* Speed and turn of the keys that are held. */
function keyed() {
  const sum = [0, 0];
  for (const key of state.held) [0, 1].forEach((k) => sum[k] += KEYS[key][k]);
  return { speed: 3 * sum[0], turn: 1.2 * sum[1] };
}

function drive(ticks) {
  const { speed, turn } = keyed();
  let answer = null;
  if (speed !== 0 || turn !== 0) answer = state.engine.ask("drive", { speed, turn, ticks });
  else if (state.goal) answer = state.engine.ask("towards", { place: state.goal, ticks });
  else if (state.auto) answer = state.engine.ask("autopilot", { ticks });
  if (answer === null) return;
  const failure = answer.failures.find((text) => text !== null);
  if (failure) complain(`A filter gave up: ${failure}`);
}

function move(seconds) {
  if (state.log) {
    if (!state.playing) return;
    state.playing = state.engine.ask("replay", { seconds: seconds * 10 ** Number(byId("pace").value) });
    look(true);
    return;
  }
  state.owed = Math.min(state.owed + seconds / TICK_S, 10);
  const ticks = Math.floor(state.owed);
  if (ticks < 1) return;
  state.owed -= ticks;
  drive(ticks);
  const [now] = state.engine.ask("world");
  const done = Math.round(now[6] / TICK_S);
  const scanned = Math.floor(done / TICKS_PER_SCAN) > Math.floor(state.ticks / TICKS_PER_SCAN);
  state.ticks = done;
  look(scanned);
}

function frame(now_ms) {
  const seconds = Math.min((now_ms - state.before) / 1000, 0.2);
  state.before = now_ms;
  const start = performance.now();
  try {
    move(seconds);
    for (const panel of state.panels) panel.draw(state.scene, state.view, SHOW, state.colour);
  } catch (error) {
    complain(new Error(`The filter stopped (${error.message}). Press “From the start”.`));
    return;
  }
  const { now } = state.scene;
  write(byId("clock"), state.log ? `${now[6].toFixed(0)} s of ${now[7].toFixed(0)} s` : `${now[6].toFixed(0)} s`);
  state.frames.push([now_ms, performance.now() - start]);
  if (state.frames.length > 600) state.frames.shift();
  requestAnimationFrame(frame);
}

/* Sliders that are powers of ten, and how their values are written. */
const LOGARITHMIC = new Set(["particles", "odometry_noise", "sensor_noise", "believed_noise"]);
const written = (name, value) => name === "reach_m" ? `${value} m` :
  name === "particles" || name === "landmarks" ? `${value}` : `${value.toFixed(2)} ×`;

function readControl(control) {
  const name = control.dataset.set;
  if (control.type === "checkbox") SET[name] = control.checked;
  else if (control.type !== "range") SET[name] = control.value;
  else if (name === "particles") SET[name] = Math.round(10 ** Number(control.value));
  else SET[name] = LOGARITHMIC.has(name) ? 10 ** Number(control.value) : Number(control.value);
}

function showControls() {
  for (const control of document.querySelectorAll("[data-set]")) {
    const name = control.dataset.set, value = SET[name];
    if (control.type === "checkbox") control.checked = value;
    else if (control.type !== "range") control.value = value;
    else {
      control.value = LOGARITHMIC.has(name) ? Math.log10(value) : value;
      control.parentElement.querySelector("output").textContent = written(name, value);
    }
  }
  for (const box of document.querySelectorAll("[data-filter]")) box.checked = SET.filters.includes(box.dataset.filter);
}

function showLesson(number) {
  state.lesson = Math.max(0, Math.min(number, LESSONS.length - 1));
  const lesson = LESSONS[state.lesson];
  byId("title").textContent = lesson.title;
  byId("text").textContent = lesson.text;
  byId("back").disabled = state.lesson === 0;
  byId("next").disabled = state.lesson === LESSONS.length - 1;
  Object.assign(SET, LESSONS[0].set, lesson.set);
  // A phone has room for one map; the lesson's others can be ticked.
  if (window.innerWidth < 640) SET.filters = lesson.set.filters.slice(-1);
  showControls();
}

function steer(panel, event) {
  const box = panel.world.getBoundingClientRect();
  const { scale, dx, dy } = panel.at;
  state.goal = [(event.clientX - box.left - dx) / scale, -(event.clientY - box.top - dy) / scale];
}

function setAuto(on) {
  state.auto = on;
  byId("auto").setAttribute("aria-pressed", String(on));
}

function listenToDriver() {
  window.addEventListener("keydown", (event) => {
    if (!(event.code in KEYS) || event.target.matches("input, select")) return;
    event.preventDefault();
    setAuto(false);
    state.held.add(event.code);
  });
  window.addEventListener("keyup", (event) => state.held.delete(event.code));
  window.addEventListener("blur", () => state.held.clear());
  byId("panels").addEventListener("pointerdown", (event) => {
    const panel = state.panels.find((candidate) => candidate.world === event.target);
    if (!panel || state.log) return;
    setAuto(false);
    event.target.setPointerCapture(event.pointerId);
    steer(panel, event);
  });
  byId("panels").addEventListener("pointermove", (event) => {
    const panel = state.panels.find((candidate) => candidate.world === event.target);
    if (panel && state.goal) steer(panel, event);
  });
  for (const end of ["pointerup", "pointercancel"]) window.addEventListener(end, () => state.goal = null);
}

function listenToControls() {
  for (const control of document.querySelectorAll("[data-set]")) {
    control.addEventListener(control.type === "range" ? "input" : "change", () => {
      readControl(control);
      showControls();
      begin();
    });
  }
  for (const box of document.querySelectorAll("[data-filter]")) {
    box.addEventListener("change", () => {
      const boxes = [...document.querySelectorAll("[data-filter]")].filter((candidate) => candidate.checked);
      if (boxes.length > 0) SET.filters = boxes.map((candidate) => candidate.dataset.filter);
      showControls();
      begin();
    });
  }
  for (const box of document.querySelectorAll("[data-show]")) {
    SHOW[box.dataset.show] = box.checked;
    box.addEventListener("change", () => SHOW[box.dataset.show] = box.checked);
  }
  byId("files").addEventListener("change", (event) => load([...event.target.files]));
  const pace = byId("pace");
  const showPace = () => pace.parentElement.querySelector("output").textContent = `${(10 ** Number(pace.value)).toFixed(0)} ×`;
  pace.addEventListener("input", showPace);
  showPace();
}

function listenToButtons() {
  const turnTo = (number) => {
    state.log = null;
    showLesson(number);
    begin();
  };
  byId("back").addEventListener("click", () => turnTo(state.lesson - 1));
  byId("next").addEventListener("click", () => turnTo(state.lesson + 1));
  byId("auto").addEventListener("click", () => setAuto(!state.auto));
  byId("again").addEventListener("click", begin);
  byId("other").addEventListener("click", () => {
    SET.seed += 1;
    begin();
  });
  byId("redraw").addEventListener("click", () => {
    for (const panel of state.panels) if (panel.filter !== "ekf") state.engine.ask("draw_anew", { filter: panel.index });
    look(true);
  });
}

/* Reads the files of a log; which is which their names say. */
async function load(files) {
  const named = (part) => files.find((file) => file.name.toLowerCase().includes(part));
  const chosen = { odometry: named("odometry"), sightings: named("sighting"), settings: named(".y") };
  if (!chosen.odometry || !chosen.sightings) {
    complain(new Error("Choose odometry.csv and sightings.csv together (and log.yaml, if there is one)."));
    return;
  }
  const texts = Object.entries(chosen).map(async ([name, file]) => [name, file ? await file.text() : ""]);
  state.log = Object.fromEntries(await Promise.all(texts));
  begin();
}

/* The filter's code: within the page where it was put together, else beside it. */
async function code() {
  const inside = byId("wasm").textContent.trim();
  if (!inside) return (await fetch("fastslam.wasm")).arrayBuffer();
  const text = atob(inside);
  return Uint8Array.from(text, (letter) => letter.charCodeAt(0));
}

async function start() {
  state.engine = await Engine.from(await code());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => state.colour = colours());
  listenToDriver();
  listenToControls();
  listenToButtons();
  showLesson(0);
  begin();
  state.before = performance.now();
  requestAnimationFrame(frame);
}

start().catch(complain);
