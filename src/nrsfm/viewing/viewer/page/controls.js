// The panel, the transport and the legend: they show what the view is, and change it.

import { KEYS } from "./keys.js";
import { legendOf, themeOf } from "./look.js";

const element = (id) => document.getElementById(id);
const number = (value) => value.toLocaleString("en");

export class Controls {
  constructor(view, speeds) {
    this.view = view;
    this.scene = view.scene;
    this.look = view.stage.look;
    element("speed").append(...speeds.map((speed) => new Option(`${speed}×`, speed, speed === 1, speed === 1)));
    this.words();
    this.listen();
  }

  words() {
    const { scene } = this;
    element("title").textContent = scene.title || "Reconstruction";
    const parts = [`${number(scene.frames)} frame${scene.frames === 1 ? "" : "s"}`, scene.points < scene.of ? `${number(scene.points)} of ${number(scene.of)} points` : `${number(scene.points)} points`];
    if (scene.method) parts.push(`method ${scene.method}`);
    element("facts").textContent = parts.join(" · ");
    element("scrub").max = scene.frames - 1;
    const [warnings, facts] = ["warning", "fact"].map((kind) => scene.notes.filter((note) => note.kind === kind));
    element("warnings").hidden = !warnings.length;
    element("warnings").append(...warnings.map(({ text }) => paragraph(text, "p")));
    element("facts-section").hidden = !facts.length;
    element("notes").append(...facts.map(({ text }) => paragraph(text, "li")));
    element("tracks-words").textContent = scene.tracks.measured ? "Tracks over the input" : "Reprojected points over it";
    element("picture-words").textContent = scene.pictures
      ? scene.tracks.measured ? "input and its tracks" : "input and the reprojected points"
      : scene.tracks.measured ? "input tracks" : "reprojected points";
    for (const entry of scene.colours) {
      const option = new Option(entry.missing ? `${entry.label} (${entry.missing})` : entry.label, entry.name);
      option.disabled = Boolean(entry.missing);
      element("colour").append(option);
    }
    element("keys").append(...KEYS.flatMap(([keys, words]) => [term(keys), paragraph(words, "dd")]));
  }

  listen() {
    const { view } = this;
    element("play").onclick = () => view.play();
    element("back").onclick = () => (view.play(false), view.go(view.frame - 1));
    element("next").onclick = () => (view.play(false), view.go(view.frame + 1));
    element("scrub").oninput = (event) => view.go(Number(event.target.value));
    element("scrub").onpointerdown = () => view.play(false);
    element("speed").onchange = (event) => view.setSpeed(Number(event.target.value));
    element("size").oninput = (event) => this.set({ size: Number(event.target.value) });
    element("colour").onchange = (event) => this.colour(event.target.value);
    element("cameras").onchange = (event) => this.set({ cameras: event.target.checked });
    element("show-input").onchange = (event) => this.input(event.target.checked);
    element("show-tracks").onchange = (event) => this.tracks(event.target.checked);
    element("front").onclick = () => this.turn(0, 0);
    element("side").onclick = () => this.turn(-1.2, 0.1);
    element("over").onclick = () => this.set({ over: !this.look.over });
    element("theme").onclick = () => this.theme();
    matchMedia("(prefers-color-scheme: dark)").onchange = () => this.readTheme();
  }

  // The state at the beginning: what suits the data, and what the address asks for.
  begin(asked) {
    const { scene } = this;
    const there = (name) => scene.colours.some((entry) => entry.name === name && !entry.missing);
    if (["light", "dark"].includes(asked.get("theme"))) document.documentElement.dataset.theme = asked.get("theme");
    const shapes = [["points", "Points", true], ["surface", "Surface", scene.triangles > 0]];
    if (scene.lines) shapes.push(["lines", "Lines", true]);
    this.segments("shape", shapes, (shape) => this.set({ shape }));
    this.segments("reference", [["object", "Object", true], ["camera", "Camera", true]], (reference) => this.refer(reference));
    const usual = there("texture") ? "texture" : scene.triangles || scene.lines ? "plain" : "depth";
    const colour = asked.get("colour");
    this.colour(there(colour) ? colour : usual);
    const shape = asked.get("shape");
    this.set({
      shape: shapes.some(([name, , can]) => name === shape && can) ? shape : scene.lines ? "lines" : scene.triangles ? "surface" : "points",
      reference: asked.get("reference") === "camera" ? "camera" : "object",
      cameras: asked.get("cameras") === "1",
      over: asked.get("over") === "1",
    });
    this.input(asked.has("input") ? asked.get("input") === "1" : Boolean(scene.pictures) || scene.tracks.measured);
    this.tracks(asked.get("tracks") !== "0");
    if (asked.has("frame")) this.view.go(Number(asked.get("frame")) || 0);
    if (this.look.reference === "camera") this.turn(0, 0);
    if (asked.has("yaw")) this.turn(Number(asked.get("yaw")) || 0, 0.16);
    this.readTheme();
  }

  segments(id, choices, choose) {
    element(id).replaceChildren(
      ...choices.map(([name, label, can]) => {
        const button = paragraph(label, "button");
        Object.assign(button, { value: name, disabled: !can, onclick: () => choose(name) });
        button.setAttribute("role", "radio");
        if (!can) button.title = "No faces are known: see --faces";
        return button;
      }),
    );
  }

  set(change) {
    Object.assign(this.look, change);
    const { look } = this;
    for (const id of ["shape", "reference"])
      for (const button of element(id).children) button.setAttribute("aria-checked", String(button.value === look[id]));
    element("cameras").checked = look.cameras;
    element("over").setAttribute("aria-pressed", String(look.over));
    element("size-line").hidden = look.shape === "surface";
    element("reference-note").textContent = look.reference === "camera"
      ? "The camera stands still, as in the video; the object turns before it."
      : look.cameras && this.scene.cameras.kind === "orthographic"
        ? "The object stands still. Orthographic cameras have a direction and no distance: they are drawn at one distance."
        : "The object stands still; the camera moves around it.";
    this.view.change();
  }

  // As the camera sees it means from the front; another side can be chosen from there.
  refer(reference) {
    if (reference === "camera") this.view.stage.reset(0, 0);
    this.set({ reference });
  }

  colour(name) {
    const found = this.scene.colours.find((entry) => entry.name === name && !entry.missing);
    if (!found) return;
    element("colour").value = name;
    this.set({ colour: found });
    const legend = legendOf(this.scene, found);
    element("colour-note").textContent = found.note ?? "";
    element("legend").hidden = !legend;
    element("legend").parentElement.classList.toggle("with-legend", Boolean(legend));
    if (!legend) return;
    element("legend-name").textContent = legend.name;
    element("legend-bar").style.background = legend.background;
    element("legend-ticks").replaceChildren(...legend.ticks.map((text) => paragraph(text, "span")));
    element("legend-note").textContent = legend.note;
  }

  input(on) {
    this.inputShown = on;
    element("show-input").checked = on;
    element("input").hidden = !on;
    element("app").classList.toggle("with-input", on);
    element("tracks-line").hidden = !on;
    this.view.picture.drawn = -1;
    this.view.change();
  }

  tracks(on) {
    this.view.picture.showTracks = on;
    element("show-tracks").checked = on;
    this.view.picture.drawn = -1;
    this.view.change();
  }

  turn(yaw, pitch) {
    this.view.stage.reset(yaw, pitch);
    this.view.change();
  }

  theme() {
    document.documentElement.dataset.theme = this.dark ? "light" : "dark";
    this.readTheme();
  }

  readTheme() {
    const chosen = document.documentElement.dataset.theme;
    this.dark = chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    element("theme").textContent = this.dark ? "Light" : "Dark";
    this.view.stage.theme = themeOf(element("scene"), this.scene.plain, this.dark);
    this.view.change();
  }

  playing(on) {
    element("play").setAttribute("aria-pressed", String(on));
    element("play").setAttribute("aria-label", on ? "Pause" : "Play");
  }

  speed(speed) {
    element("speed").value = speed;
  }

  // Called for every picture: it touches the page only where something is new.
  update(frame, rate, loaded) {
    const { scene } = this;
    if (Number(element("scrub").value) !== frame) element("scrub").value = frame;
    const error = scene.errors?.[frame];
    const more = [];
    if (this.view.playing && rate !== null) more.push(`${rate.toFixed(0)} frames/s`);
    if (error !== undefined && error !== null) more.push(`e3D ${error.toFixed(3)}`);
    const text = `${frame}|${more}`;
    if (text !== this.written) {
      this.written = text;
      const current = paragraph(String(frame), "b");
      const rest = paragraph(more.length ? ` · ${more.join(" · ")}` : "", "span");
      rest.className = "more";
      element("where").replaceChildren(current, ` / ${scene.frames - 1}`, rest);
    }
    if (loaded !== this.loaded) {
      this.loaded = loaded;
      const whole = loaded >= Math.min(scene.frames, this.view.store.most);
      element("loaded").style.width = whole ? "0" : `${(100 * loaded) / scene.frames}%`;
    }
  }
}

function paragraph(text, tag) {
  const made = document.createElement(tag);
  made.textContent = text;
  return made;
}

function term(keys) {
  const made = document.createElement("dt");
  keys.forEach((key, k) => made.append(...(k ? [" "] : []), paragraph(key, "kbd")));
  return made;
}
