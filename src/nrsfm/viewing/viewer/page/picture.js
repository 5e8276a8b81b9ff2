// The input's frame, with tracks and the way they came over it, on a plain canvas.

const AHEAD = 6, KEPT = 24, TRAIL = 6;

export class Picture {
  constructor(canvas, scene, tracks, onArrival) {
    Object.assign(this, { canvas, scene, tracks, onArrival });
    this.context = canvas.getContext("2d");
    this.images = new Map();
    this.pending = new Set();
    this.count = scene.tracks.count;
    this.colours = placeColours(scene, tracks);
    this.showTracks = true;
    this.drawn = -1; // the frame whose picture is on the canvas
  }

  get(frame) {
    if (!this.scene.pictures) return null;
    for (let k = 0; k < AHEAD; k++) this.fetch((frame + k) % this.scene.frames);
    return this.images.get(frame);
  }

  async fetch(frame) {
    if (this.images.has(frame) || this.pending.has(frame) || this.pending.size >= 3) return;
    this.pending.add(frame);
    try {
      const answer = await fetch(`image/${frame}`);
      if (!answer.ok) throw new Error(await answer.text());
      this.images.set(frame, await createImageBitmap(await answer.blob()));
      while (this.images.size > KEPT) {
        const oldest = this.images.keys().next().value;
        this.images.get(oldest).close();
        this.images.delete(oldest);
      }
      this.onArrival(frame);
    } catch (error) {
      this.failed = String(error.message || error);
    } finally {
      this.pending.delete(frame);
    }
  }

  draw(frame, ink) {
    const { canvas, context } = this;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const image = this.get(frame);
    if (this.scene.pictures && !image && this.drawn >= 0) return; // rather the last frame than a flicker
    context.clearRect(0, 0, width, height);
    const [left, top, wide, tall] = this.scene.pictures
      ? [-0.5, -0.5, this.scene.pictures.width, this.scene.pictures.height]
      : this.scene.tracks.box;
    const scale = Math.min(width / wide, height / tall);
    const [dx, dy] = [(width - wide * scale) / 2 - left * scale, (height - tall * scale) / 2 - top * scale];
    if (image) {
      context.drawImage(image, dx + left * scale, dy + top * scale, wide * scale, tall * scale);
      this.drawn = frame;
    }
    if (this.showTracks) this.drawTracks(frame, scale, dx, dy, ratio, ink, Boolean(image));
  }

  drawTracks(frame, scale, dx, dy, ratio, ink, over) {
    const { context, tracks, count } = this;
    const size = ratio * (count > 150 ? 2.6 : 4.5);
    context.lineWidth = ratio;
    for (let i = 0; i < count; i++) {
      const now = 3 * (frame * count + i);
      if (!(tracks[now] === tracks[now])) continue; // not seen
      const x = dx + tracks[now] * scale, y = dy + tracks[now + 1] * scale;
      if (tracks[now + 2] > 0) {
        context.strokeStyle = "#e0593c";
        context.beginPath();
        context.moveTo(x - size, y - size); context.lineTo(x + size, y + size);
        context.moveTo(x - size, y + size); context.lineTo(x + size, y - size);
        context.stroke();
        continue;
      }
      context.strokeStyle = context.fillStyle = this.colours[i];
      context.globalAlpha = 0.5;
      context.beginPath();
      context.moveTo(x, y);
      for (let back = 1; back <= Math.min(TRAIL, frame); back++) {
        const then = now - 3 * count * back;
        if (!(tracks[then] === tracks[then]) || tracks[then + 2] > 0) break;
        context.lineTo(dx + tracks[then] * scale, dy + tracks[then + 1] * scale);
      }
      context.stroke();
      context.globalAlpha = 1;
      if (over) {
        context.fillStyle = "rgb(0 0 0 / 0.55)";
        context.fillRect(x - size / 2 - ratio * 0.5, y - size / 2 - ratio * 0.5, size + ratio, size + ratio);
        context.fillStyle = this.colours[i];
      }
      context.fillRect(x - size / 2, y - size / 2, size, size);
    }
  }
}

// A hue by direction from the middle, so that neighbours look alike and points can be followed.
function placeColours(scene, tracks) {
  const { count, box } = scene.tracks;
  const middle = 3 * Math.floor(scene.frames / 2) * count;
  return Array.from({ length: count }, (_, i) => {
    let at = middle + 3 * i;
    for (let f = 0; !(tracks[at] === tracks[at]) && f < scene.frames; f++) at = 3 * (f * count + i);
    const x = (tracks[at] - box[0]) / box[2] - 0.5, y = (tracks[at + 1] - box[1]) / box[3] - 0.5;
    const hue = (Math.atan2(y, x) * 180) / Math.PI;
    return tracks[at] === tracks[at] ? `hsl(${hue.toFixed(0)} 85% ${(62 + 10 * Math.cos(12 * Math.hypot(x, y))).toFixed(0)}%)` : "#888";
  });
}
