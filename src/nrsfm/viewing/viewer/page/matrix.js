// 4 × 4 matrices as WebGL wants them: 16 numbers, column after column.

export function multiply(a, b) {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column++)
    for (let row = 0; row < 4; row++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
      out[4 * column + row] = sum;
    }
  return out;
}

// From a 3 × 3 matrix whose rows are listed one after the other, with signs for the rows.
export function fromRows(rows, at = 0, signs = [1, 1, 1]) {
  const out = new Float32Array(16);
  for (let row = 0; row < 3; row++)
    for (let column = 0; column < 3; column++) out[4 * column + row] = signs[row] * rows[at + 3 * row + column];
  out[15] = 1;
  return out;
}

export function translation(x, y, z) {
  return new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1]);
}

// First about the vertical axis, then about the horizontal one.
export function turntable(yaw, pitch) {
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return new Float32Array([cy, sp * sy, -cp * sy, 0, 0, cp, sp, 0, sy, -sp * cy, cp * cy, 0, 0, 0, 0, 1]);
}

// slope: half the height of the view over the distance; height: half of it, for parallel rays.
export function perspective(slope, aspect, near, far) {
  const out = new Float32Array(16);
  out[0] = 1 / (slope * aspect);
  out[5] = 1 / slope;
  out[10] = (near + far) / (near - far);
  out[11] = -1;
  out[14] = (2 * near * far) / (near - far);
  return out;
}

export function parallel(height, aspect, near, far) {
  const out = new Float32Array(16);
  out[0] = 1 / (height * aspect);
  out[5] = 1 / height;
  out[10] = 2 / (near - far);
  out[14] = (near + far) / (near - far);
  out[15] = 1;
  return out;
}
