// Shows meshes and points that one can turn, on a plain 2D canvas: every pixel is filled here, against a depth buffer,
// so the page looks the same with and without a graphics card. No library, no network.
"use strict";

const SEEN = [58, 118, 201], GUESSED = [236, 157, 56], POINT = [32, 40, 56], POINT_DARK = [235, 240, 248];
const TRUTH = [86, 170, 112], GRIPPER = [120, 126, 140], GRID = [128, 134, 146];
const PARTS = [[76, 120, 168], [245, 133, 24], [84, 162, 75], [178, 121, 162], [228, 87, 86], [114, 183, 178],
  [238, 202, 59], [157, 117, 93], [130, 140, 160], [255, 157, 166]];
const LIGHT = unit([-0.35, 0.55, 0.76]); // in the eye's frame: x right, y up, z towards the eye
const LARGEST_PIXELS = 1.6e6;

function unit(v) { const n = Math.hypot(...v) || 1; return v.map((x) => x / n); }

function decode(text, kind) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new kind(bytes.buffer);
}

function vertexNormals(v, f) {
  const n = new Float32Array(v.length);
  for (let i = 0; i < f.length; i += 3) {
    const a = 3 * f[i], b = 3 * f[i + 1], c = 3 * f[i + 2];
    const ux = v[b] - v[a], uy = v[b + 1] - v[a + 1], uz = v[b + 2] - v[a + 2];
    const wx = v[c] - v[a], wy = v[c + 1] - v[a + 1], wz = v[c + 2] - v[a + 2];
    const x = uy * wz - uz * wy, y = uz * wx - ux * wz, z = ux * wy - uy * wx;
    for (const k of [a, b, c]) { n[k] += x; n[k + 1] += y; n[k + 2] += z; }
  }
  return n;
}

// A mesh whose faces share no vertices, so that each is shaded flat.
function flat(mesh) {
  const v = new Float32Array(3 * mesh.f.length), f = new Uint32Array(mesh.f.length);
  for (let i = 0; i < mesh.f.length; i++) {
    f[i] = i;
    for (let k = 0; k < 3; k++) v[3 * i + k] = mesh.v[3 * mesh.f[i] + k];
  }
  return { v, f };
}

function makeMesh(data, colourOf, options = {}) {
  let mesh = { v: decode(data.v, Float32Array), f: decode(data.f, Uint32Array) };
  const source = options.flat ? mesh.f : null;
  if (options.flat) mesh = flat(mesh);
  const c = new Uint8Array(mesh.v.length);
  for (let i = 0; i < mesh.v.length / 3; i++) c.set(colourOf(source ? source[i] : i), 3 * i);
  return { ...mesh, c, n: vertexNormals(mesh.v, mesh.f), ghost: !!options.ghost };
}

function layersOf(item) {
  const layers = { points: [], completed: [], parts: [], truth: [], gripper: [] };
  if (item.cloud) layers.points.push({ p: decode(item.cloud, Float32Array) });
  if (item.completed) {
    const seen = decode(item.completed.seen, Uint8Array);
    const [sure, guessed] = item.colours || [SEEN, GUESSED];
    layers.completed.push(makeMesh(item.completed, (i) => (seen[i] ? sure : guessed)));
  }
  if (item.parts) {
    const part = decode(item.parts.part, Uint16Array);
    layers.parts.push(makeMesh(item.parts, (i) => PARTS[part[i] % PARTS.length], { flat: true }));
  }
  if (item.truth) layers.truth.push(makeMesh(item.truth, () => TRUTH, { ghost: true }));
  if (item.gripper) layers.gripper.push(makeMesh(item.gripper, () => GRIPPER, { flat: true }));
  return layers;
}

// Points of a whole scan, written in centimetres, with the grey of each: low is light, high is dark.
function scanOf(text) {
  const p = Float32Array.from(decode(text, Int16Array), (x) => x / 100), grey = new Uint8Array(p.length / 3);
  for (let i = 0; i < grey.length; i++) grey[i] = 172 - 106 * Math.pow(Math.min(1, Math.max(0, p[3 * i + 2] / 4)), 0.7);
  return { p, grey };
}

class Viewer {
  constructor(canvas, scene) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.items = scene.items.map((item) => ({ layers: layersOf(item), at: item.at, reach: item.reach }));
    this.floor = scene.floor;
    this.scan = scene.scan ? scanOf(scene.scan) : null;
    this.look = scene.look || null;
    // Several grippers would hide what they are about to grasp.
    this.shown = { scan: true, points: !this.scan, completed: true, parts: false, truth: false, gripper: scene.items.length === 1 };
    this.start = scene.azimuth;
    this.select(-1);
    this.reset();
    this._listen();
  }

  select(index) {
    this.chosen = index < 0 ? this.items : [this.items[index]];
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const item of this.chosen) for (let k = 0; k < 3; k++) {
      low[k] = Math.min(low[k], item.at[k] - item.reach); high[k] = Math.max(high[k], item.at[k] + item.reach);
    }
    this.target = low.map((x, k) => (x + high[k]) / 2);
    this.radius = this.chosen.length === 1 ? this.chosen[0].reach : Math.hypot(...low.map((x, k) => high[k] - x)) / 2;
    if (this.look && index < 0) { this.target = this.look.at; this.radius = this.look.radius; }
    this.zoom = 1;
    this.draw();
  }

  reset() {
    this.azimuth = this.start; this.elevation = 0.42; this.zoom = 1;
    this.draw();
  }

  show(layer, on) { this.shown[layer] = on; this.draw(); }

  draw(coarse = false) {
    if (this.waiting) { this.waiting = { coarse: this.waiting.coarse && coarse }; return; }
    this.waiting = { coarse };
    requestAnimationFrame(() => { const how = this.waiting; this.waiting = null; this._paint(how.coarse); });
  }

  _paint(coarse) {
    const box = this.canvas.getBoundingClientRect();
    if (!box.width || !box.height) return;
    // Drawn at twice the size and shown smaller when at rest: that smooths the edges.
    let scale = coarse ? 1 : 2 * Math.min(window.devicePixelRatio || 1, 1.5);
    scale = Math.min(scale, Math.sqrt((coarse ? 0.35 : 1) * LARGEST_PIXELS / (box.width * box.height)));
    const w = Math.max(1, Math.round(box.width * scale)), h = Math.max(1, Math.round(box.height * scale));
    if (this.canvas.width !== w || this.canvas.height !== h) { this.canvas.width = w; this.canvas.height = h; }
    const image = this.context.createImageData(w, h);
    const frame = { w, h, scale, rgba: new Uint32Array(image.data.buffer), z: new Float32Array(w * h) };
    frame.eye = this._eye(w, h);
    if (this.floor !== null) this._grid(frame);
    const order = ["completed", "parts", "gripper", "truth"];
    for (const item of this.chosen) for (const name of order) {
      if (this.shown[name]) for (const mesh of item.layers[name]) fillMesh(frame, mesh);
    }
    const night = matchMedia("(prefers-color-scheme: dark)").matches;
    if (this.scan && this.shown.scan) fillScan(frame, this.scan, night);
    const dark = night && !this.shown.completed && !this.shown.parts;
    for (const item of this.chosen) {
      if (this.shown.points) for (const cloud of item.layers.points) fillPoints(frame, cloud.p, dark ? POINT_DARK : POINT);
    }
    this.context.putImageData(image, 0, 0);
  }

  // Rows of the eye's frame (right, up, back), where it is, and the focal length in pixels.
  _eye(w, h) {
    const [ca, sa, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation), Math.sin(this.elevation)];
    const back = [ce * ca, ce * sa, se], right = [-sa, ca, 0];
    const up = [-se * ca, -se * sa, ce];
    const alone = this.chosen.length === 1, room = alone && this.shown.gripper ? 1 : 0; // the gripper stands out above
    const distance = ((alone ? 4.2 : 2.9) + 2.2 * room) * this.radius / this.zoom;
    const focal = 1.62 * Math.min(w, 1.25 * h);
    return { right, up, back, focal, at: this.target.map((x, k) => x + (k === 2 ? 0.4 * room * this.radius : 0) + distance * back[k]) };
  }

  _grid(frame) {
    const step = this.radius > 0.25 ? 0.1 : 0.05, reach = Math.ceil(1.5 * this.radius / step) * step;
    const [cx, cy] = this.target.map((x) => Math.round(x / step) * step);
    for (let t = -reach; t <= reach + 1e-9; t += step) {
      line(frame, [cx + t, cy - reach, this.floor], [cx + t, cy + reach, this.floor]);
      line(frame, [cx - reach, cy + t, this.floor], [cx + reach, cy + t, this.floor]);
    }
  }

  _listen() {
    const touches = new Map();
    let spread = 0;
    const c = this.canvas;
    const turn = (dx, dy) => {
      this.azimuth -= 0.008 * dx;
      this.elevation = Math.max(-1.5, Math.min(1.5, this.elevation + 0.008 * dy));
    };
    const rest = () => { clearTimeout(this.timer); this.timer = setTimeout(() => this.draw(), 160); };
    c.addEventListener("pointerdown", (e) => { c.setPointerCapture(e.pointerId); touches.set(e.pointerId, [e.clientX, e.clientY]); spread = 0; });
    c.addEventListener("pointermove", (e) => {
      const last = touches.get(e.pointerId);
      if (!last) return;
      touches.set(e.pointerId, [e.clientX, e.clientY]);
      if (touches.size === 1) turn(e.clientX - last[0], e.clientY - last[1]);
      else {
        const [a, b] = [...touches.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
        if (spread) this._zoomBy(now / spread);
        spread = now;
      }
      this.draw(true); rest();
    });
    for (const name of ["pointerup", "pointercancel"]) c.addEventListener(name, (e) => { touches.delete(e.pointerId); spread = 0; });
    c.addEventListener("wheel", (e) => { e.preventDefault(); this._zoomBy(Math.exp(-0.0012 * e.deltaY)); this.draw(true); rest(); }, { passive: false });
    c.addEventListener("dblclick", () => this.reset());
    c.addEventListener("keydown", (e) => {
      const steps = { ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12] };
      if (steps[e.key]) turn(...steps[e.key]);
      else if (e.key === "+" || e.key === "=") this._zoomBy(1.15);
      else if (e.key === "-") this._zoomBy(1 / 1.15);
      else return;
      e.preventDefault(); this.draw(true); rest();
    });
    new ResizeObserver(() => this.draw()).observe(c);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  _zoomBy(factor) { this.zoom = Math.max(0.3, Math.min(8, this.zoom * factor)); }
}

// Screen x, y and inverse depth of points; inverse depth 0 marks one behind the eye.
function place(frame, v) {
  const { right, up, back, at, focal } = frame.eye, out = new Float32Array(v.length);
  const cx = frame.w / 2, cy = frame.h / 2;
  for (let i = 0; i < v.length; i += 3) {
    const x = v[i] - at[0], y = v[i + 1] - at[1], z = v[i + 2] - at[2];
    const depth = -(x * back[0] + y * back[1] + z * back[2]);
    if (depth < 1e-3) continue;
    const inverse = 1 / depth;
    out[i] = cx + focal * inverse * (x * right[0] + y * right[1] + z * right[2]);
    out[i + 1] = cy - focal * inverse * (x * up[0] + y * up[1] + z * up[2]);
    out[i + 2] = inverse;
  }
  return out;
}

function shades(frame, mesh) {
  const { right, up, back } = frame.eye, n = mesh.n, out = new Float32Array(n.length / 3);
  for (let i = 0; i < n.length; i += 3) {
    const length = Math.hypot(n[i], n[i + 1], n[i + 2]) || 1;
    const x = (n[i] * right[0] + n[i + 1] * right[1] + n[i + 2] * right[2]) / length;
    const y = (n[i] * up[0] + n[i + 1] * up[1] + n[i + 2] * up[2]) / length;
    const z = (n[i] * back[0] + n[i + 1] * back[1] + n[i + 2] * back[2]) / length;
    const lit = Math.max(0, x * LIGHT[0] + y * LIGHT[1] + z * LIGHT[2]);
    out[i / 3] = 0.46 + 0.12 * Math.max(0, n[i + 2] / length) + 0.5 * lit;
  }
  return out;
}

function fillMesh(frame, mesh) {
  const { w, h, z, rgba } = frame, s = place(frame, mesh.v), shade = shades(frame, mesh), { f, c, ghost } = mesh;
  const dots = Math.max(1, Math.round(frame.scale)); // a ghost leaves out every other dot of a checkerboard
  for (let i = 0; i < f.length; i += 3) {
    const ia = f[i], ib = f[i + 1], ic = f[i + 2], a = 3 * ia, b = 3 * ib, d = 3 * ic;
    const za = s[a + 2], zb = s[b + 2], zc = s[d + 2];
    if (za === 0 || zb === 0 || zc === 0) continue;
    const ax = s[a], ay = s[a + 1], bx = s[b], by = s[b + 1], dx = s[d], dy = s[d + 1];
    const area = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax);
    if (area >= 0) continue; // the back of a face, as y points down
    const x0 = Math.max(0, Math.ceil(Math.min(ax, bx, dx))), x1 = Math.min(w - 1, Math.floor(Math.max(ax, bx, dx)));
    const y0 = Math.max(0, Math.ceil(Math.min(ay, by, dy))), y1 = Math.min(h - 1, Math.floor(Math.max(ay, by, dy)));
    for (let y = y0; y <= y1; y++) {
      for (let x = x0; x <= x1; x++) {
        const u = ((bx - x) * (dy - y) - (by - y) * (dx - x)) / area;
        const v = ((dx - x) * (ay - y) - (dy - y) * (ax - x)) / area;
        const t = 1 - u - v;
        if (u < 0 || v < 0 || t < 0) continue;
        const depth = u * za + v * zb + t * zc, at = y * w + x;
        if (depth <= z[at] || (ghost && ((Math.floor(x / dots) + Math.floor(y / dots)) & 1))) continue;
        const lit = u * shade[ia] + v * shade[ib] + t * shade[ic];
        const r = Math.min(255, lit * (u * c[a] + v * c[b] + t * c[d]));
        const g = Math.min(255, lit * (u * c[a + 1] + v * c[b + 1] + t * c[d + 1]));
        const l = Math.min(255, lit * (u * c[a + 2] + v * c[b + 2] + t * c[d + 2]));
        z[at] = depth;
        rgba[at] = 0xff000000 | (l << 16) | (g << 8) | r;
      }
    }
  }
}

function fillPoints(frame, p, colour) {
  const { w, h, z, rgba } = frame, s = place(frame, p), paint = 0xff000000 | (colour[2] << 16) | (colour[1] << 8) | colour[0];
  const size = Math.max(1, Math.round(0.9 * frame.scale)), half = size >> 1;
  for (let i = 0; i < s.length; i += 3) {
    if (s[i + 2] === 0) continue;
    const depth = s[i + 2] * 1.004; // a point that lies in a surface is drawn upon it
    const left = Math.round(s[i]) - half, top = Math.round(s[i + 1]) - half;
    for (let y = Math.max(0, top); y < Math.min(h, top + size); y++) {
      for (let x = Math.max(0, left); x < Math.min(w, left + size); x++) {
        const at = y * w + x;
        if (depth > z[at]) { z[at] = depth; rgba[at] = paint; }
      }
    }
  }
}

function fillScan(frame, scan, night) {
  const { w, h, z, rgba } = frame, s = place(frame, scan.p), size = Math.max(1, Math.round(0.8 * frame.scale));
  for (let i = 0; i < s.length; i += 3) {
    const depth = s[i + 2];
    if (depth === 0) continue;
    const grey = night ? 300 - scan.grey[i / 3] : scan.grey[i / 3], paint = 0xff000000 | (grey << 16) | (grey << 8) | grey;
    const left = Math.round(s[i]), top = Math.round(s[i + 1]);
    for (let y = Math.max(0, top); y < Math.min(h, top + size); y++) {
      for (let x = Math.max(0, left); x < Math.min(w, left + size); x++) {
        const at = y * w + x;
        if (depth > z[at]) { z[at] = depth; rgba[at] = paint; }
      }
    }
  }
}

function line(frame, from, to) {
  const { w, h, z, rgba } = frame, s = place(frame, Float32Array.from([...from, ...to]));
  if (s[2] === 0 || s[5] === 0) return;
  const steps = Math.min(8000, Math.ceil(Math.max(Math.abs(s[3] - s[0]), Math.abs(s[4] - s[1]))));
  const paint = 0x58000000 | (GRID[2] << 16) | (GRID[1] << 8) | GRID[0], thick = Math.max(1, Math.round(frame.scale * 0.8));
  for (let i = 0; i <= steps; i++) {
    const t = i / Math.max(1, steps), x = Math.round(s[0] + t * (s[3] - s[0])), y = Math.round(s[1] + t * (s[4] - s[1]));
    const depth = s[2] + t * (s[5] - s[2]);
    for (let k = 0; k < thick; k++) {
      if (x < 0 || x >= w || y + k < 0 || y + k >= h) continue;
      const at = (y + k) * w + x;
      if (depth > z[at]) { z[at] = depth; rgba[at] = paint; }
    }
  }
}

function button(text, pressed, onClick) {
  const made = document.createElement("button");
  made.type = "button"; made.textContent = text; made.setAttribute("aria-pressed", pressed);
  made.addEventListener("click", () => onClick(made));
  return made;
}

function start(scene, section) {
  const viewer = new Viewer(section.querySelector("canvas"), scene);
  const choose = section.querySelector(".choose"), layers = section.querySelector(".layers");
  const pick = (index, made) => {
    for (const other of choose.children) other.setAttribute("aria-pressed", other === made);
    viewer.select(index);
  };
  if (scene.items.length > 1) choose.append(button("All", true, (made) => pick(-1, made)));
  scene.items.forEach((item, i) => choose.append(button(item.name, scene.items.length === 1, (made) => pick(i, made))));
  const names = { scan: "Scan", points: "Seen points", completed: "Completed", parts: "Convex parts", truth: "Truth", gripper: "Best grasp" };
  for (const [layer, label] of Object.entries(names)) {
    if (layer === "scan" ? !viewer.scan : !viewer.items.some((item) => item.layers[layer].length)) continue;
    const made = button(label, viewer.shown[layer], () => {
      const on = made.getAttribute("aria-pressed") !== "true";
      made.setAttribute("aria-pressed", on);
      viewer.show(layer, on);
    });
    made.dataset.layer = layer;
    layers.append(made);
  }
  return viewer;
}

const scenes = JSON.parse(document.getElementById("scenes").textContent);
const viewers = scenes.map((scene, i) => start(scene, document.getElementById(`scene-${i}`)));
