"use strict";
/* One panel: what a filter believes, drawn over the truth. */

const NAMES = { fastslam1: "FastSLAM 1.0", fastslam2: "FastSLAM 2.0", ekf: "EKF-SLAM" };
const VERDICTS = ["not judged yet", "ok", "degraded", "lost"];
const STRIP_HEIGHT = 34, STRIP_POINTS = 240;

/* Colours as the style sheet has them, for light and dark. */
function colours() {
  const style = getComputedStyle(document.documentElement);
  const names = ["ground", "ink", "quiet", "line", "truth", "odometry", "particle", "own", "best", "match", "wrong"];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

/* The part of the world that is shown; grows with what must be seen. */
class View {
  constructor(half_m) {
    this.box = [-half_m, -half_m, half_m, half_m];
  }

  include(points, margin_m = 2) {
    for (let i = 0; i + 1 < points.length; i += 2) {
      const [x, y] = [points[i], points[i + 1]];
      if (!Number.isFinite(x) || !Number.isFinite(y)) continue;
      this.box[0] = Math.min(this.box[0], x - margin_m);
      this.box[1] = Math.min(this.box[1], y - margin_m);
      this.box[2] = Math.max(this.box[2], x + margin_m);
      this.box[3] = Math.max(this.box[3], y + margin_m);
    }
  }

  /* From metres to pixels of a canvas: scale and offsets; y points up. */
  onto(width, height) {
    const [x0, y0, x1, y1] = this.box;
    const scale = Math.min(width / (x1 - x0), height / (y1 - y0));
    return { scale, dx: width / 2 - scale * (x0 + x1) / 2, dy: height / 2 + scale * (y0 + y1) / 2 };
  }
}

class Panel {
  constructor(filter, index, parent) {
    this.filter = filter;
    this.index = index;
    this.strip = [];
    this.layer = document.createElement("canvas");
    this.drawn = {};
    this.scans = 0;
    this.article = document.createElement("article");
    this.article.innerHTML = `<header><h2>${NAMES[filter]}</h2><span class="facts"></span></header>
      <canvas class="world" role="img" aria-label="map of ${NAMES[filter]}"></canvas>
      <canvas class="strip" role="img" aria-label="effective particles over time"></canvas>`;
    parent.append(this.article);
    this.facts = this.article.querySelector(".facts");
    [this.world, this.stripCanvas] = this.article.querySelectorAll("canvas");
    if (filter === "ekf") this.stripCanvas.remove();
  }

  /* Called after a scan: what changes only then. */
  learn(map) {
    const [landmarks, own, best, paths, matches, pose] = map;
    Object.assign(this, { landmarks, own, best, matches, pose });
    this.scans += 1;
    this.paths = new Path2D();
    let pen = false;
    for (let i = 0; i < paths.length; i += 2) {
      if (Number.isNaN(paths[i])) pen = false;
      else if (pen) this.paths.lineTo(paths[i], paths[i + 1]);
      else {
        this.paths.moveTo(paths[i], paths[i + 1]);
        pen = true;
      }
    }
  }

  /* What is believed now. */
  believe([status, particles], truth) {
    this.status = status;
    this.particles = particles;
    const [x, y] = status;
    const [effective, count, landmarks, resamplings, redraws, verdict, mapError] = status.slice(6);
    const parts = [];
    if (!Number.isNaN(truth[0])) parts.push(`off by ${Math.hypot(x - truth[0], y - truth[1]).toFixed(2)} m`);
    if (!Number.isNaN(mapError)) parts.push(`map by ${mapError.toFixed(2)} m`);
    parts.push(`${landmarks} landmarks`);
    if (this.filter !== "ekf") parts.push(`resampled ${resamplings} ×`);
    if (redraws > 0) parts.push(`drawn anew ${redraws} ×`);
    parts.push(`it says: ${VERDICTS[verdict]}`);
    write(this.facts, parts.join(" · "));
    this.latest = { share: effective / count, resamplings };
  }

  /* One point of the strip per scan. */
  note() {
    const before = this.strip.at(-1);
    this.strip.push({ ...this.latest, resampled: before !== undefined && this.latest.resamplings > before.resamplings });
    if (this.strip.length > STRIP_POINTS) this.strip.shift();
  }

  draw(scene, view, show, colour) {
    const { context, width, height } = sized(this.world, mapHeight(this.world.clientWidth));
    context.fillStyle = colour.ground;
    context.fillRect(0, 0, width, height);
    const at = view.onto(width, height);
    this.at = at;
    const px = 1 / at.scale;
    context.save();
    context.transform(at.scale, 0, 0, -at.scale, at.dx, at.dy);
    if (show.odometry) this.drawOdometry(context, scene, px, colour);
    if (show.truth) this.drawTruth(context, scene, px, colour);
    if (this.landmarks) {
      this.drawLayer(context, show, colour);
      this.drawRobots(context, show, px, colour);
    }
    context.restore();
    if (this.filter !== "ekf" && this.isStale("strip", [this.scans, this.strip.length, width, colour.particle])) this.drawStrip(colour);
  }

  /* Whether a part must be drawn anew: whether anything that it depends on has changed. */
  isStale(part, facts) {
    const key = facts.join();
    if (this.drawn[part] === key) return false;
    this.drawn[part] = key;
    return true;
  }

  /* What only scans change is drawn once per scan, beside the page, and copied into every frame. */
  drawLayer(context, show, colour) {
    const { width, height } = this.world;
    const { a, b, c, d, e, f } = context.getTransform();
    const facts = [this.scans, width, height, a, e, f, ...Object.values(show), ...Object.values(colour)];
    if (this.isStale("beliefs", facts)) {
      Object.assign(this.layer, { width, height });
      const beside = this.layer.getContext("2d");
      beside.setTransform(a, b, c, d, e, f);
      this.drawBeliefs(beside, show, 1 / this.at.scale, colour);
    }
    context.save();
    context.resetTransform();
    context.drawImage(this.layer, 0, 0);
    context.restore();
  }

  drawOdometry(context, scene, px, colour) {
    line(context, scene.reported, colour.odometry, 1.5 * px, [4 * px, 4 * px]);
    robot(context, scene.now.slice(3, 6), colour.odometry, px, false);
  }

  drawTruth(context, scene, px, colour) {
    line(context, scene.path, colour.truth, px, []);
    context.strokeStyle = colour.truth;
    context.lineWidth = 1.2 * px;
    context.beginPath();
    for (let i = 0; i < scene.landmarks.length; i += 2) {
      context.moveTo(scene.landmarks[i] + 4 * px, scene.landmarks[i + 1]);
      context.arc(scene.landmarks[i], scene.landmarks[i + 1], 4 * px, 0, 2 * Math.PI);
    }
    context.stroke();
  }

  drawBeliefs(context, show, px, colour) {
    if (show.paths) {
      context.strokeStyle = colour.particle;
      context.globalAlpha = 0.25;
      context.lineWidth = px;
      context.setLineDash([]);
      context.stroke(this.paths);
      context.globalAlpha = 1;
    }
    if (show.own) dots(context, this.own, 2, 1.8 * px, colour.own, 0.55);
    line(context, this.best, colour.best, 1.6 * px, []);
    if (show.matches) this.drawMatches(context, px, colour);
    this.drawLandmarks(context, show.ellipses, px, colour);
  }

  drawRobots(context, show, px, colour) {
    if (this.filter !== "ekf") dots(context, this.particles, 4, 2.6 * px, colour.particle, 0.8);
    robot(context, this.status, colour.best, px, true);
    if (this.truth !== undefined && show.truth) robot(context, this.truth, colour.truth, px, false);
  }

  drawMatches(context, px, colour) {
    context.lineWidth = 1.2 * px;
    for (let i = 0; i < this.matches.length; i += 5) {
      const [endX, endY, x, y, mistaken] = this.matches.slice(i, i + 5);
      context.strokeStyle = mistaken ? colour.wrong : colour.match;
      context.globalAlpha = mistaken ? 1 : 0.55;
      context.setLineDash(mistaken ? [] : [3 * px, 2 * px]);
      context.beginPath();
      context.moveTo(this.pose[0], this.pose[1]);
      context.lineTo(endX, endY);
      if (!Number.isNaN(x)) context.lineTo(x, y);
      context.stroke();
    }
    context.globalAlpha = 1;
    context.setLineDash([]);
  }

  drawLandmarks(context, ellipses, px, colour) {
    for (let i = 0; i < this.landmarks.length; i += 7) {
      const [x, y, xx, xy, yy, , confirmed] = this.landmarks.slice(i, i + 7);
      context.globalAlpha = confirmed ? 1 : 0.4;
      context.fillStyle = context.strokeStyle = colour.best;
      context.fillRect(x - 2 * px, y - 2 * px, 4 * px, 4 * px);
      if (ellipses) ellipse(context, [x, y], [xx, xy, yy], px);
    }
    context.globalAlpha = 1;
  }

  drawStrip(colour) {
    const { context, width, height } = sized(this.stripCanvas, STRIP_HEIGHT);
    context.clearRect(0, 0, width, height);
    context.fillStyle = colour.particle;
    const step = width / STRIP_POINTS;
    this.strip.forEach(({ share, resampled }, i) => {
      const top = height - 2 - share * (height - 6);
      context.globalAlpha = 0.6;
      context.fillRect(i * step, top, Math.max(step - 0.3, 0.7), height - 2 - top);
      context.globalAlpha = 1;
      if (!resampled) return;
      context.fillStyle = colour.best;
      context.fillRect(i * step, 0, Math.max(step, 1.5), 4);
      context.fillStyle = colour.particle;
    });
  }
}

/* Writes a text where it is another one: the page is laid out anew for each. */
function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/* A map is a square, unless the window is too low for one. */
function mapHeight(width) {
  return Math.round(Math.min(width, Math.max(0.72 * window.innerHeight, 280)));
}

/* A context in CSS pixels for a canvas of this height; the width is that of the page. */
function sized(canvas, height) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = canvas.clientWidth;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    canvas.style.height = `${height}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height };
}

function line(context, points, colour, width, dash) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.beginPath();
  for (let i = 0; i < points.length; i += 2) context.lineTo(points[i], points[i + 1]);
  context.stroke();
  context.setLineDash([]);
}

function dots(context, points, stride, size, colour, alpha) {
  context.fillStyle = colour;
  context.globalAlpha = alpha;
  for (let i = 0; i < points.length; i += stride) context.fillRect(points[i] - size / 2, points[i + 1] - size / 2, size, size);
  context.globalAlpha = 1;
}

function robot(context, [x, y, heading], colour, px, filled) {
  if (Number.isNaN(x)) return;
  context.save();
  context.translate(x, y);
  context.rotate(heading);
  context.beginPath();
  context.moveTo(12 * px, 0);
  context.lineTo(-8 * px, 7 * px);
  context.lineTo(-8 * px, -7 * px);
  context.closePath();
  context.lineWidth = 2 * px;
  context.strokeStyle = context.fillStyle = colour;
  if (filled) {
    context.globalAlpha = 0.8;
    context.fill();
  } else context.stroke();
  context.restore();
}

/* Two standard deviations. */
function ellipse(context, [x, y], [xx, xy, yy], px) {
  const middle = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy);
  const [long, short] = [Math.sqrt(middle + apart), Math.sqrt(Math.max(middle - apart, 0))];
  context.lineWidth = 1.2 * px;
  context.beginPath();
  context.ellipse(x, y, 2 * long, 2 * short, Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
  context.stroke();
}
