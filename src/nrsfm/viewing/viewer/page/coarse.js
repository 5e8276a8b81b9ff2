// A surface with about half as many triangles: pairs of neighbouring points become one, the closest pairs first, where
// the first of them is. Meant for a picture whose triangles are hardly larger than its pixels, while it moves.

import { inGoodOrder } from "./order.js";

// positions: four numbers for each point, of which three are its place.
export function coarser(faces, positions) {
  const points = positions.length / 4;
  const lengths = new Float64Array(faces.length);
  for (let k = 0; k < faces.length; k++) {
    const a = 4 * faces[k], b = 4 * faces[next(k)];
    lengths[k] = (positions[a] - positions[b]) ** 2 + (positions[a + 1] - positions[b + 1]) ** 2 + (positions[a + 2] - positions[b + 2]) ** 2;
  }
  const stands = new Int32Array(points).fill(-1); // the point that stands for each
  for (const k of Uint32Array.from(lengths.keys()).sort((i, j) => lengths[i] - lengths[j] || i - j)) {
    const a = faces[k], b = faces[next(k)];
    if (stands[a] < 0 && stands[b] < 0) stands[a] = stands[b] = a;
  }
  const kept = new Uint32Array(faces.length);
  let count = 0;
  for (let k = 0; k < faces.length; k += 3) {
    const [a, b, c] = [faces[k], faces[k + 1], faces[k + 2]].map((point) => (stands[point] < 0 ? point : stands[point]));
    if (a === b || b === c || c === a) continue;
    kept.set([a, b, c], count);
    count += 3;
  }
  return inGoodOrder(kept.slice(0, count), points);
}

// The next corner of the same triangle.
function next(corner) {
  return corner % 3 === 2 ? corner - 2 : corner + 1;
}
