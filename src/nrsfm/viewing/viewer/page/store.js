// Frames of the sequence: fetched in the order of playing, kept as long as there is room.

const AT_ONCE = 4;
const ROOM = 700e6; // bytes

export class Store {
  constructor(scene, { onArrival, onLoss, onDrop }) {
    this.count = scene.frames;
    this.points = scene.points;
    this.padded = 4 * Math.ceil(scene.points / 4);
    this.bytes = 8 * scene.points + this.padded * scene.rows.length;
    this.most = Math.max(8, Math.min(this.count, Math.floor(ROOM / (this.bytes + 4 * scene.points))));
    this.frames = new Map();
    this.pending = new Set();
    this.current = 0;
    this.dead = false;
    Object.assign(this, { onArrival, onLoss, onDrop });
  }

  // The frame, if it is here; either way it is what is wanted next.
  get(frame) {
    this.current = frame;
    this.fill();
    return this.frames.get(frame);
  }

  rowOffset(row) {
    return 8 * this.points + row * this.padded;
  }

  fill() {
    for (let ahead = 0; ahead < this.most && this.pending.size < AT_ONCE && !this.dead; ahead++) {
      const frame = (this.current + ahead) % this.count;
      if (!this.frames.has(frame) && !this.pending.has(frame)) this.fetch(frame);
    }
  }

  async fetch(frame) {
    this.pending.add(frame);
    try {
      // A second try, because a connection that was kept open may just have been closed.
      const answer = await fetch(`frame/${frame}`).catch(() => fetch(`frame/${frame}`));
      if (!answer.ok) throw new Error(await answer.text());
      const data = await answer.arrayBuffer();
      if (data.byteLength !== this.bytes) throw new Error(`frame ${frame} came incomplete`);
      this.makeRoom();
      this.frames.set(frame, { data, positions: new Int16Array(data, 0, 4 * this.points) });
      this.pending.delete(frame);
      this.onArrival(frame);
      this.fill();
    } catch (error) {
      this.pending.delete(frame);
      if (!this.dead) this.onLoss(error);
      this.dead = true;
    }
  }

  makeRoom() {
    while (this.frames.size >= this.most) {
      let [worst, far] = [null, -1];
      for (const frame of this.frames.keys()) {
        const ahead = (frame - this.current + this.count) % this.count;
        if (ahead > far) [worst, far] = [frame, ahead];
      }
      this.onDrop(this.frames.get(worst));
      this.frames.delete(worst);
    }
  }
}

export async function fetchArray(path, Kind) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(await answer.text());
  return new Kind(await answer.arrayBuffer());
}
