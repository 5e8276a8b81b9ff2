// The player of moving shapes in a page that opens without a network. It draws with what the viewer draws with
// (nrsfm/viewing/viewer/page), and plays frames that it works out itself. Without WebGL the page's picture stays.

import { SPEEDS, legendOf, themeOf } from "./look.js";
import { START, Stage } from "./stage.js";
import { Shapes } from "./shapes.js";
import { interleaved, readNumbers } from "./numbers.js";
import { listenToPointers } from "./pointers.js";

const figure = document.getElementById("player");
const part = (name) => figure.querySelector(`[data-part="${name}"]`);
const still = matchMedia("(prefers-reduced-motion: reduce)");
const dark = matchMedia("(prefers-color-scheme: dark)");
const FEW = 150; // points that lie apart are drawn smaller
const limited = (value, low, high) => Math.min(Math.max(value, low), high);

class Player {
  constructor(about, numbers) {
    Object.assign(this, { about, numbers, frame: 0, offset: 0, clock: 0, speed: 1, playing: false, inView: false });
    Object.assign(this, { counts: { draws: 0, shown: 0 }, spent: [], finest: 1, charts: [] });
    this.stage = this.prepared();
    this.shapes = new Shapes(about, numbers, (entry) => this.stage.forget(entry));
    this.fillControls();
    this.listen();
    this.readTheme();
    this.go(0);
  }

  prepared() {
    const { about, numbers } = this, stage = new Stage(part("canvas"), about);
    if (numbers.faces) stage.setFaces(interleaved(numbers.faces, 3, Uint32Array));
    if (numbers.edges) stage.setEdges(interleaved(numbers.edges, 2, Uint32Array));
    for (const { name, kind } of about.colours)
      if (kind === "fixed") stage.setFixed(name, interleaved(numbers[name], 3, Uint8Array, 255));
    return stage;
  }

  // After the browser has taken the graphics card away, and given it back.
  restore() {
    const { yaw, pitch, zoom, pan, look, theme } = this.stage;
    Object.assign(this.stage, this.prepared(), { yaw, pitch, zoom, pan, look, theme });
    this.shapes.frames.clear();
    this.drawn = null;
    this.change();
  }

  fillControls() {
    const { about } = this;
    part("speed").append(...SPEEDS.map((speed) => new Option(`${speed}×`, speed, speed === 1, speed === 1)));
    this.outlines = [["surface", "Surface", about.triangles], ["lines", "Lines", about.lines], ["points", "Points", 1]].filter((entry) => entry[2]);
    this.choices("shape", this.outlines, (shape) => this.set({ shape }));
    part("shape").hidden = this.outlines.length < 2;
    this.choices("reference", [["object", "Object still"], ["camera", "Camera still"]], (reference) => this.refer(reference));
    part("colour").append(...about.colours.map(({ name, label }) => new Option(label, name)));
    const there = (name) => about.colours.some((entry) => entry.name === name);
    const usual = there("texture") ? "texture" : about.triangles || about.lines ? "plain" : "depth";
    this.set({ shape: this.outlines[0][0], size: about.points < FEW ? 0.75 : 1, colour: about.colours.find((entry) => entry.name === usual) });
  }

  choices(id, entries, choose) {
    part(id).append(...entries.map(([value, label]) => {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", value, textContent: label, onclick: () => choose(value) });
      return button;
    }));
  }

  set(change) {
    const { look } = this.stage;
    Object.assign(look, change);
    for (const id of ["shape", "reference"])
      for (const button of part(id).children) button.setAttribute("aria-pressed", String(button.value === look[id]));
    part("cameras").setAttribute("aria-pressed", String(look.cameras));
    part("colour").value = look.colour.name;
    const legend = legendOf(this.about, look.colour);
    part("legend").hidden = !legend;
    if (legend) {
      part("legend-name").textContent = legend.name + (legend.note ? `, ${legend.note}` : "");
      part("legend-bar").style.background = legend.background;
      part("legend-low").textContent = legend.ticks[0];
      part("legend-high").textContent = legend.ticks[2];
    }
    this.change();
  }

  // As the camera sees it means from the front; another side can be chosen from there.
  refer(reference) {
    this.set({ reference });
    this.home();
  }

  home() {
    const front = this.stage.look.reference === "camera";
    this.stage.reset(front ? 0 : START.yaw, front ? 0 : START.pitch);
    this.change();
  }

  colour(name) {
    const found = this.about.colours.find((entry) => entry.name === name);
    if (found) this.set({ colour: found });
  }

  readTheme() {
    this.stage.theme = themeOf(part("stage"), this.about.plain, dark.matches);
    this.change();
  }

  listen() {
    const { canvas } = this.stage;
    part("play").onclick = () => this.play();
    part("back").onclick = () => this.step(-1);
    part("next").onclick = () => this.step(1);
    part("scrub").oninput = (event) => (this.play(false), this.go(Number(event.target.value)));
    part("speed").onchange = (event) => (this.speed = Number(event.target.value));
    part("colour").onchange = (event) => this.colour(event.target.value);
    part("cameras").onclick = () => this.set({ cameras: !this.stage.look.cameras });
    part("reset").onclick = () => this.home();
    dark.onchange = () => this.readTheme();
    still.onchange = () => still.matches && this.play(false);
    new ResizeObserver(() => this.change()).observe(canvas);
    new IntersectionObserver((entries) => {
      this.inView = entries.at(-1).isIntersecting;
      if (this.inView) this.change();
    }).observe(canvas);
    figure.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.restore());
    // The wheel scrolls the page until the picture has been clicked on.
    listenToPointers(this, (event) => document.activeElement === canvas || event.ctrlKey);
    for (const chart of document.querySelectorAll("svg[data-frames]")) this.follow(chart);
  }

  // A chart over frames shows where the player is, and takes it elsewhere.
  follow(chart) {
    const [left, right, top, bottom] = chart.dataset.plot.split(" ").map(Number);
    const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
    for (const [name, value] of [["class", "now"], ["y1", top], ["y2", bottom]]) line.setAttribute(name, value);
    chart.append(line);
    const last = Math.max(this.about.frames - 1, 1);
    this.charts.push((frame) => {
      const x = left + ((right - left) * frame) / last;
      line.setAttribute("x1", x);
      line.setAttribute("x2", x);
    });
    chart.classList.add("seeks");
    chart.addEventListener("click", (event) => {
      const box = chart.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * chart.viewBox.baseVal.width;
      this.play(false);
      this.go(limited(Math.round(((x - left) / (right - left)) * last), 0, this.about.frames - 1));
    });
  }

  // The viewer's keys, where they have a meaning here; and keys to turn and to zoom with.
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { stage, about } = this, { look } = stage;
    const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const tag = event.target.tagName; // controls have keys of their own
    if (tag === "SELECT" || (tag === "INPUT" && /^(Arrow|Home|End|Page)/.test(name))) return;
    if (name === " " && (tag === "BUTTON" || tag === "SUMMARY")) return;
    const turn = (x, y) => {
      stage.yaw += 0.12 * x;
      stage.pitch = limited(stage.pitch + 0.12 * y, -1.55, 1.55);
      this.change();
    };
    const show = (shape) => this.outlines.some((entry) => entry[0] === shape) && this.set({ shape });
    const resize = (by) => this.set({ size: limited(look.size * by, 0.3, 3) });
    const actions = {
      " ": () => this.play(),
      ArrowLeft: () => this.step(event.shiftKey ? -10 : -1),
      ArrowRight: () => this.step(event.shiftKey ? 10 : 1),
      ArrowUp: () => this.faster(1),
      ArrowDown: () => this.faster(-1),
      Home: () => (this.play(false), this.go(0)),
      End: () => (this.play(false), this.go(about.frames - 1)),
      s: () => show("surface"), p: () => show("points"), l: () => show("lines"),
      f: () => this.refer(look.reference === "camera" ? "object" : "camera"),
      c: () => this.set({ cameras: !look.cameras }),
      o: () => this.set({ parallel: !look.parallel }),
      u: () => this.set({ over: !look.over }),
      r: () => this.home(),
      a: () => turn(-1, 0), d: () => turn(1, 0), w: () => turn(0, -1), x: () => turn(0, 1),
      z: () => ((stage.zoom = limited(stage.zoom * (event.shiftKey ? 1 / 1.15 : 1.15), 0.15, 40)), this.change()),
      "+": () => resize(1.15), "=": () => resize(1.15), "-": () => resize(1 / 1.15),
    };
    const colour = /^[1-9]$/.test(name) ? about.colours[name - 1] : null;
    const action = colour ? () => this.colour(colour.name) : actions[name];
    if (!action) return;
    event.preventDefault();
    action();
  }

  faster(by) {
    this.speed = SPEEDS[limited(SPEEDS.indexOf(this.speed) + by, 0, SPEEDS.length - 1)];
    part("speed").value = this.speed;
  }

  step(by) {
    this.play(false);
    this.go(this.frame + by);
  }

  play(on = !this.playing) {
    on = on && this.about.frames > 1;
    if (on === this.playing) return;
    this.playing = on;
    this.clock = performance.now();
    this.offset = this.frame;
    part("play").setAttribute("aria-label", on ? "Pause" : "Play");
    figure.classList.toggle("playing", on);
    this.change();
  }

  go(frame) {
    const { frames } = this.about;
    this.frame = ((Math.round(frame) % frames) + frames) % frames;
    this.offset = this.frame;
    this.clock = performance.now();
    this.change();
  }

  change() {
    if (this.asked) return;
    clearTimeout(this.waiting);
    this.asked = true;
    requestAnimationFrame((now) => this.tick(now));
  }

  // A frame is shown when its time has come; where drawing is too slow frames are left out and the speed stays right.
  tick(now) {
    this.asked = false;
    const { about, stage, shapes } = this, { canvas } = stage;
    const running = this.playing && this.inView;
    if (running) {
      this.offset += (Math.max(now - this.clock, 0) / 1000) * about.fps * this.speed;
      this.frame = Math.floor(this.offset) % about.frames;
    }
    this.clock = now;
    if (running && stage.quality > 1) stage.quality = 1;
    const { yaw, pitch, zoom, pan, look, theme, quality } = stage;
    const what = JSON.stringify([this.frame, yaw, pitch, zoom, pan, look, theme, quality, canvas.clientWidth, canvas.clientHeight]);
    if (what !== this.drawn && canvas.clientWidth && !stage.gl.isContextLost()) {
      stage.draw(this.frame, shapes.get(this.frame), shapes.rowOffset(about.rows.indexOf(look.colour.name)));
      if (running) this.measure(now);
      this.counts.draws++;
      if (this.frame !== this.lastShown) this.counts.shown++;
      this.lastShown = this.frame;
      this.drawn = what;
      this.showFrame();
    }
    if (running) this.change();
    else if (!this.playing) this.refine();
  }

  // What stands still may be drawn slowly, and finely: a machine without a graphics card has no smooth edges otherwise.
  refine() {
    const { stage } = this;
    if (stage.quality < 1) (stage.quality = 1), this.change();
    clearTimeout(this.waiting);
    if (!stage.software || stage.quality > 1) return;
    this.waiting = setTimeout(() => {
      if (!this.playing) (stage.quality = 2), this.change();
    }, 300);
  }

  // Without a graphics card, a coarser picture keeps up with time; as fine a one as does is found by trying.
  measure(now) {
    const { stage, shapes } = this;
    if (shapes.worked) this.spent = []; // frames that are shown for the first time take longer
    shapes.worked = false;
    this.spent.push(now);
    if (this.spent.length < 20) return;
    const each = (this.spent.at(-1) - this.spent[0]) / (this.spent.length - 1);
    const wanted = 1000 / Math.min(60, this.about.fps * this.speed);
    if (each > 1.2 * wanted && stage.quality > 0.5) {
      this.finest = 0.9 * stage.quality;
      stage.quality = Math.max(0.5, 0.75 * stage.quality);
    } else if (each < 1.08 * wanted) stage.quality = Math.min(this.finest, 1.15 * stage.quality);
    this.spent = [];
  }

  showFrame() {
    const scrub = part("scrub");
    if (Number(scrub.value) !== this.frame) scrub.value = this.frame;
    part("where").textContent = `${this.frame} / ${this.about.frames - 1}`;
    for (const move of this.charts) move(this.frame);
  }
}

async function begin() {
  try {
    const about = JSON.parse(document.getElementById("player-about").textContent);
    const numbers = await readNumbers(about.parts, document.getElementById("player-data").textContent);
    about.rotations = numbers.rotations;
    about.cameras.places = numbers.places;
    const player = new Player(about, numbers);
    figure.classList.add("ready");
    globalThis.nrsfmPlayer = player;
    if (!still.matches) player.play(true);
    player.change();
  } catch (error) {
    part("message").textContent = `${error.message} The picture shows one frame.`;
    part("message").hidden = false;
    figure.classList.remove("ready");
  }
}

if (figure) begin();
