// The page: what is shown, the clock that plays it, and the loop that draws only when something has changed.

import { Controls } from "./controls.js";
import { Picture } from "./picture.js";
import { SPEEDS } from "./look.js";
import { Stage } from "./stage.js";
import { Store, fetchArray } from "./store.js";
import { listenToKeys } from "./keys.js";
import { listenToPointers } from "./pointers.js";

const element = (id) => document.getElementById(id);

class View {
  constructor(scene, tracks) {
    this.scene = scene;
    this.stage = new Stage(element("scene"), scene);
    this.store = new Store(scene, {
      onArrival: () => this.change(),
      onLoss: () => this.say("The viewer has ended. Start nrsfm view again and reload this page."),
      onDrop: (entry) => this.stage.forget(entry),
    });
    this.picture = new Picture(element("picture"), scene, tracks, () => this.change());
    this.frame = 0;
    this.playing = false;
    this.speed = 1;
    this.changed = true;
    this.shown = -1;
    this.rate = { since: 0, frames: 0, value: null };
    this.counts = { distinct: 0, draws: 0 }; // what was drawn since the beginning, for whoever wants to measure
    Object.assign(this, { played: 0, late: 0, calm: 0, falls: 0 });
    this.controls = new Controls(this, SPEEDS);
  }

  change() {
    this.changed = true;
  }

  say(text, bad = true) {
    element("message").textContent = text;
    element("message").classList.toggle("bad", bad && Boolean(text));
  }

  play(on = !this.playing) {
    this.playing = on && this.scene.frames > 1;
    this.anchor = null;
    this.rate = { since: 0, frames: 0, value: null };
    if (!this.playing) this.setQuality(1);
    this.controls.playing(this.playing);
    this.change();
  }

  go(frame) {
    this.frame = ((Math.round(frame) % this.scene.frames) + this.scene.frames) % this.scene.frames;
    this.anchor = null;
    this.change();
  }

  setSpeed(speed) {
    this.speed = speed;
    this.anchor = null;
    this.rate = { since: 0, frames: 0, value: null };
    this.controls.speed(speed);
  }

  faster(step) {
    const at = SPEEDS.indexOf(this.speed) + step;
    if (at >= 0 && at < SPEEDS.length) this.setSpeed(SPEEDS[at]);
  }

  // The clock: a frame is due when its time has come; where one is not here yet, time waits for it.
  advance(now) {
    const each = 1000 / (this.scene.fps * this.speed);
    if (!this.anchor) this.anchor = { time: now, frame: this.frame };
    const due = (this.anchor.frame + Math.floor((now - this.anchor.time) / each + 1e-6)) % this.scene.frames;
    if (due === this.frame) return;
    if (!this.store.get(due)) {
      this.anchor = { time: now, frame: this.frame };
      return;
    }
    this.frame = due;
    this.changed = true;
  }

  tick(now) {
    if (this.playing) this.advance(now);
    if (this.changed) {
      this.lastChange = now;
      if (!this.playing && this.stage.quality > 1) this.stage.quality = 1;
      this.draw(now);
    } else if (!this.playing && this.stage.software && this.stage.quality === 1 && now - this.lastChange > 300) {
      this.stage.quality = 2; // what stands still may be drawn slowly, and finely
      this.draw(now);
    }
    requestAnimationFrame((time) => this.tick(time));
  }

  draw(now) {
    this.changed = false;
    const entry = this.store.get(this.frame);
    const row = this.scene.rows.indexOf(this.stage.look.colour.name);
    this.stage.draw(this.frame, entry, this.store.rowOffset(Math.max(row, 0)));
    if (this.controls.inputShown) this.picture.draw(this.frame);
    this.counts.draws++;
    if (entry && this.shown !== this.frame) {
      this.counts.distinct++;
      this.shown = this.frame;
      if (this.playing) this.measure(now);
    }
    this.controls.update(this.frame, this.rate.value, this.store.frames.size);
  }

  // Frames that were really shown in a second. Where they are too few the picture gets coarser while it plays, and finer
  // again after a while in time, a longer one each time that was in vain. The first round does not count: it uploads.
  measure(now) {
    const { rate, stage } = this;
    if (!rate.since) Object.assign(rate, { since: now, frames: 0 });
    else rate.frames++;
    this.played++;
    const span = now - rate.since;
    if (span < 1000) return;
    rate.value = (1000 * rate.frames) / span;
    Object.assign(rate, { since: now, frames: 0 });
    if (this.played < 1.2 * Math.min(this.scene.frames, this.store.most)) return;
    const late = rate.value < 0.97 * Math.min(this.scene.fps * this.speed, 60);
    this.late = late ? this.late + 1 : 0;
    this.calm = late ? 0 : this.calm + 1;
    if (this.late > 1 && stage.quality > 0.5) {
      this.setQuality(Math.max(0.5, stage.quality - 0.17));
      [this.late, this.falls] = [0, this.falls + 1];
    } else if (this.calm > 3 * (1 + this.falls) && stage.quality < 1) {
      this.setQuality(Math.min(1, stage.quality + 0.17));
      this.calm = 0;
    }
  }

  setQuality(quality) {
    this.stage.quality = quality;
  }
}

async function begin() {
  const answer = await fetch("scene.json");
  if (!answer.ok) throw new Error(await answer.text());
  const scene = await answer.json();
  document.title = scene.title ? `${scene.title} – nrsfm view` : "nrsfm view";
  const tracks = await fetchArray("tracks", Float32Array);
  const view = new View(scene, tracks);
  if (scene.triangles) view.stage.setFaces(await fetchArray("faces", Uint32Array));
  if (scene.lines) view.stage.setEdges(await fetchArray("edges", Uint32Array));
  for (const { name, kind, missing } of scene.colours)
    if (kind === "fixed" && !missing) view.stage.setFixed(name, await fetchArray(`colours/${name}`, Uint8Array));
  view.controls.begin(new URLSearchParams(location.hash.slice(1)));
  view.say("", false);
  listenToKeys(view);
  listenToPointers(view);
  new ResizeObserver(() => view.change()).observe(element("scene"));
  globalThis.nrsfmView = view;
  requestAnimationFrame((now) => view.tick(now));
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches || location.hash.includes("paused");
  if (!still) view.play(true);
}

begin().catch((error) => {
  element("message").textContent = error.message || String(error);
  element("message").classList.add("bad");
});
