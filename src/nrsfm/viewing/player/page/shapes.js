// The frames, worked out when they are asked for, and kept as long as there is room:
// x_f = reach (base · 2/65535 − 1) + Σ_k w_fk factor_k T_k, in units of half the box. See nrsfm/viewing/player/pack.py.

const ROOM = 200e6; // bytes

export class Shapes {
  constructor(about, numbers, onDrop) {
    Object.assign(this, { about, numbers, onDrop, frames: new Map() });
    this.base = Float32Array.from(numbers.base, (value) => about.reach * (value / 32767.5 - 1));
    this.modes = Array.from({ length: about.modes }, (_, k) => numbers[`mode ${k}`]);
    this.sum = new Float32Array(3 * about.points);
    this.padded = 4 * Math.ceil(about.points / 4);
    this.bytes = 8 * about.points + this.padded * about.rows.length;
    this.most = Math.max(2, Math.floor(ROOM / (this.bytes + 4 * about.points)));
  }

  // x, y, z and 0 of every point as 16-bit numbers, of which 32767 is half the box; then a step of its scale for each.
  get(frame) {
    const found = this.frames.get(frame);
    if (found) return found;
    this.worked = true;
    while (this.frames.size >= this.most) {
      const [oldest, entry] = this.frames.entries().next().value;
      this.onDrop(entry);
      this.frames.delete(oldest);
    }
    const data = new ArrayBuffer(this.bytes);
    const entry = { data, positions: new Int16Array(data, 0, 4 * this.about.points) };
    this.mix(frame, entry.positions);
    this.about.rows.forEach((name, row) => this.steps(name, frame, new Uint8Array(data, this.rowOffset(row), this.about.points)));
    this.frames.set(frame, entry);
    return entry;
  }

  rowOffset(row) {
    return 8 * this.about.points + Math.max(row, 0) * this.padded;
  }

  mix(frame, out) {
    const { about, sum, modes, numbers } = this, points = about.points;
    sum.set(this.base);
    for (let k = 0; k < modes.length; k++) add(sum, modes[k], numbers.weights[frame * modes.length + k] * about.factors[k]);
    for (let axis = 0; axis < 3; axis++)
      for (let i = 0, p = axis * points; i < points; i++) {
        const value = 32767 * sum[p + i];
        out[4 * i + axis] = value > 32767 ? 32767 : value < -32767 ? -32767 : Math.round(value);
      }
  }

  // From the few levels that the page holds to steps of the colour map; 255 is not known.
  steps(name, frame, out) {
    const { levels, every, points } = this.about, at = Math.floor(frame / every) * points;
    const step = Uint8Array.from({ length: levels + 1 }, (_, k) => (k === levels ? 255 : Math.round((k * 254) / (levels - 1))));
    for (let i = 0; i < points; i++) out[i] = step[this.numbers[name][at + i]];
  }
}

function add(sum, mode, weight) {
  for (let i = 0; i < sum.length; i++) sum[i] += weight * mode[i];
}
