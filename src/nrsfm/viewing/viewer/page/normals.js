// The normals of a frame: the mean of those of the triangles at a point, by area, as numbers from -127 to 127.

export function normalsOf(positions, faces) {
  const points = positions.length / 4;
  const sums = new Float32Array(3 * points);
  for (let t = 0; t < faces.length; t += 3) {
    const [a, b, c] = [faces[t], faces[t + 1], faces[t + 2]];
    const ux = positions[4 * b] - positions[4 * a], uy = positions[4 * b + 1] - positions[4 * a + 1],
      uz = positions[4 * b + 2] - positions[4 * a + 2];
    const vx = positions[4 * c] - positions[4 * a], vy = positions[4 * c + 1] - positions[4 * a + 1],
      vz = positions[4 * c + 2] - positions[4 * a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (let k = 0; k < 3; k++) {
      const i = 3 * (k === 0 ? a : k === 1 ? b : c);
      sums[i] += x; sums[i + 1] += y; sums[i + 2] += z;
    }
  }
  const out = new Int8Array(4 * points);
  for (let i = 0, j = 0; j < sums.length; i += 4, j += 3) {
    const scale = 127 / (Math.hypot(sums[j], sums[j + 1], sums[j + 2]) || 1);
    out[i] = sums[j] * scale; out[i + 1] = sums[j + 1] * scale; out[i + 2] = sums[j + 2] * scale;
  }
  return out;
}
