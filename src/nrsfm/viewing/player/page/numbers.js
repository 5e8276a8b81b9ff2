// The numbers that the page holds: base64, deflated, planes of bytes, differences. See nrsfm/viewing/player/codec.py.

export async function readNumbers(parts, text) {
  if (typeof DecompressionStream === "undefined") throw new Error("This browser is too old for the player.");
  const packed = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const raw = new Uint8Array(await new Response(stream).arrayBuffer());
  return Object.fromEntries(parts.map((part) => [part.name, joined(raw, part)]));
}

const TYPES = { u8: Uint8Array, i8: Int8Array, u16: Uint16Array, i16: Int16Array, u32: Uint32Array, f32: Float32Array };

// Planes of bytes to numbers, and differences to sums, with the overflow that they were made with.
function joined(raw, { type, rows, columns, along, at }) {
  const size = rows * columns, out = new TYPES[type](size);
  const bytes = out.BYTES_PER_ELEMENT, view = new Uint8Array(out.buffer);
  for (let b = 0; b < bytes; b++) for (let i = 0, p = at + b * size; i < size; i++) view[i * bytes + b] = raw[p + i];
  if (along === "rows") for (let i = columns; i < size; i++) out[i] += out[i - columns];
  if (along === "columns")
    for (let r = 0; r < rows; r++) for (let i = r * columns + 1; i < (r + 1) * columns; i++) out[i] += out[i - 1];
  return out;
}

// Rows of the same numbers, one after the other, to groups of one of each; a last one may be filled in.
export function interleaved(planar, width, Kind, filled) {
  const count = planar.length / width, wide = filled === undefined ? width : width + 1;
  const out = new Kind(wide * count).fill(filled ?? 0);
  for (let k = 0; k < width; k++) for (let i = 0; i < count; i++) out[wide * i + k] = planar[k * count + i];
  return out;
}
