// Looks at the page in headless Chromium: screenshots at desktop and phone width, and frames per second.
//
//     node --experimental-websocket crates/fastslam-wasm/page/look.mjs target/web/fastslam.html OUT_FOLDER [SECONDS]
//
// Fails where the page writes an error or shows one. CHROMIUM names the browser. From Node 22 the flag is not needed.

import { spawn } from "node:child_process";
import { mkdirSync, mkdtempSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [page, out, seconds = "20"] = process.argv.slice(2);
const later = (ms) => new Promise((done) => setTimeout(done, ms));

// A browser with one tab, spoken to by its debugging protocol.
class Browser {
  static async start() {
    const browser = new Browser();
    browser.profile = mkdtempSync(join(tmpdir(), "look-"));
    const flags = ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--remote-debugging-port=0"];
    browser.process = spawn(process.env.CHROMIUM ?? "chromium", [...flags, `--user-data-dir=${browser.profile}`, "about:blank"],
      { stdio: "ignore" });
    browser.problems = [];
    for (let tries = 0; ; tries++) {
      await later(200);
      try {
        const [port] = readFileSync(join(browser.profile, "DevToolsActivePort"), "utf8").split("\n");
        const tabs = await (await fetch(`http://127.0.0.1:${port}/json`)).json();
        await browser.connect(tabs.find((tab) => tab.type === "page").webSocketDebuggerUrl);
        return browser;
      } catch (error) {
        if (tries > 100) throw error;
      }
    }
  }

  async connect(url) {
    this.socket = new WebSocket(url);
    this.answers = new Map();
    this.socket.onmessage = ({ data }) => {
      const { id, result, error, method, params } = JSON.parse(data);
      if (id !== undefined) this.answers.get(id)?.({ result, error });
      else if (method === "Runtime.exceptionThrown") this.problems.push(params.exceptionDetails.exception?.description ?? "exception");
      else if (method === "Log.entryAdded" && params.entry.level === "error") this.problems.push(params.entry.text);
    };
    await new Promise((open) => this.socket.onopen = open);
    for (const part of ["Page", "Runtime", "Log"]) await this.call(`${part}.enable`);
  }

  async call(method, params = {}) {
    const id = this.answers.size + 1;
    const answer = new Promise((done) => this.answers.set(id, done));
    this.socket.send(JSON.stringify({ id, method, params }));
    const { result, error } = await answer;
    if (error) throw new Error(`${method}: ${error.message}`);
    return result;
  }

  async evaluate(expression) {
    const { result, exceptionDetails } = await this.call("Runtime.evaluate", { expression, returnByValue: true, awaitPromise: true });
    if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? expression);
    return result.value;
  }

  async open(file, width, height, mobile) {
    await this.call("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: mobile ? 2 : 1, mobile });
    await this.call("Emulation.setTouchEmulationEnabled", { enabled: mobile });
    await this.call("Page.navigate", { url: pathToFileURL(resolve(file)).href });
    for (let tries = 0; !(await this.evaluate("document.readyState === 'complete' && state.scene !== undefined").catch(() => false)); tries++) {
      if (tries > 300) throw new Error("the page did not start");
      await later(200);
    }
  }

  async shoot(name, whole = true) {
    const { data } = await this.call("Page.captureScreenshot", { captureBeyondViewport: whole });
    writeFileSync(join(out, name), Buffer.from(data, "base64"));
  }

  // Its processes write to the profile until they have ended, those below it a little longer.
  async stop() {
    this.socket?.close();
    const ended = new Promise((done) => this.process.once("exit", done));
    this.process.kill();
    await ended;
    rmSync(this.profile, { recursive: true, force: true, maxRetries: 20, retryDelay: 100 });
  }
}

// Seconds of processor time that a process and those below it have used so far (Linux).
function processorTime(root) {
  const found = new Map();
  for (const pid of readdirSync("/proc").filter((name) => /^\d+$/.test(name))) {
    try {
      const stat = readFileSync(`/proc/${pid}/stat`, "utf8");
      const fields = stat.slice(stat.lastIndexOf(")") + 2).split(" ");
      found.set(Number(pid), { parent: Number(fields[1]), ticks: Number(fields[11]) + Number(fields[12]) });
    } catch { /* it has ended */ }
  }
  const below = (pid) => pid === root || (found.has(pid) && pid > 1 && below(found.get(pid).parent));
  return [...found].filter(([pid]) => below(pid)).reduce((sum, [, { ticks }]) => sum + ticks / 100, 0);
}

// Frames of some seconds, and the processor time meanwhile, of the whole browser with what draws for it.
async function spent(browser, seconds) {
  const since = await browser.evaluate("performance.now()");
  const before = processorTime(browser.process.pid);
  await later(1000 * seconds);
  const used_ms = 1000 * (processorTime(browser.process.pid) - before);
  return { frames: await browser.evaluate(`state.frames.filter(([at]) => at > ${since}).length`), used_ms, seconds };
}

// What a frame and a second of driving cost: of this other processes take less away than of frames per second. A robot
// that stands is drawn and not filtered.
async function costs(browser) {
  const driving = await spent(browser, 8);
  await browser.evaluate("state.auto = false");
  const standing = await spent(browser, 8);
  const frame = standing.used_ms / standing.frames;
  const filter = (driving.used_ms - driving.frames * frame) / driving.seconds;
  return `processor time of the browser: ${frame.toFixed(1)} ms a frame drawn, ${filter.toFixed(0)} ms a second of driving; ` +
    `at 60 frames/s ${((60 * frame + filter) / 10).toFixed(0)} % of a core`;
}

// Frames per second of the last 5 s, and milliseconds of work in a frame: median and 99th percentile.
const PACE = `(() => {
  const last = state.frames.filter(([at]) => at > state.frames.at(-1)[0] - 5000);
  const work = last.map(([, ms]) => ms).sort((a, b) => a - b);
  const frames = (last.length - 1) / (last.at(-1)[0] - last[0][0]) * 1000;
  return { frames, median: work[work.length >> 1], p99: work[Math.floor(work.length * 0.99)] };
})()`;
const show = ({ frames, median, p99 }) =>
  `${frames.toFixed(1)} frames/s, work ${median.toFixed(1)} ms (99th percentile ${p99.toFixed(1)})`;

mkdirSync(out, { recursive: true });
const browser = await Browser.start();
try {
  await browser.open(page, 1280, 900, false);
  await later(1000 * Number(seconds));
  await browser.shoot("desktop.png");
  console.log(`desktop, two filters, 40 landmarks: ${show(await browser.evaluate(PACE))}`);
  await browser.evaluate("Object.assign(SET, { filters: ['fastslam2'], particles: 100, landmarks: 100 }); showControls(); begin()");
  await later(1000 * Number(seconds));
  console.log(`desktop, FastSLAM 2.0, 100 particles, 100 landmarks: ${show(await browser.evaluate(PACE))}`);
  console.log(await costs(browser));
  for (const number of [4, 6, 7]) {
    await browser.evaluate(`showLesson(${number}); begin()`);
    await later(1000 * Number(seconds));
    if (number === 6) await browser.evaluate("byId('redraw').click()");
    await browser.shoot(`lesson-${number + 1}.png`, false);
  }
  await browser.open(page, 390, 844, true);
  await later(1000 * Number(seconds));
  await browser.shoot("phone.png");
  const { x, y } = await browser.evaluate("(({ x, y, width, height }) => ({ x: x + width * 0.3, y: y + height * 0.3 }))(state.panels[0].world.getBoundingClientRect())");
  await browser.call("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: [{ x, y }] });
  await later(1500);
  const goal = await browser.evaluate("state.goal");
  await browser.call("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
  const problem = await browser.evaluate("byId('problem').hidden ? null : byId('problem').textContent");
  if (goal === null) browser.problems.push("a touch on the map did not drive the robot");
  if (problem !== null) browser.problems.push(problem);
} finally {
  await browser.stop();
}
console.log(`${browser.problems.length} problems, pictures in ${out}`);
for (const problem of browser.problems) console.log(problem);
process.exitCode = browser.problems.length > 0 ? 1 : 0;
